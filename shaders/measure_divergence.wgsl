// diagnose, second of three: the largest |E u| / dx^3 of an active cell, 1/s. One thread per active quad.
// level, step. args, list: active quads. flags: see active. velocity: faces, m/s. open: fractions. maxima: bits, second.
#import dispatch
#import layout
#import lanes
#import step
#import flux
#import active
#import real

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> list: array<u32>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read> velocity: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> open: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> maxima: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn measure_divergence(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= args[3] {
        return;
    }
    let quad = active_quad(list[index]);
    let size = abs(vec4<f32>(net_inflow(quad))) * step.inv_dx;
    let bits = bitcast<vec4<u32>>(select(vec4<f32>(), size, bit_lanes(flags[quad])));
    let largest = max(max(bits.x, bits.y), max(bits.z, bits.w));
    if largest > atomicLoad(&maxima[1]) {
        atomicMax(&maxima[1], largest);
    }
}
