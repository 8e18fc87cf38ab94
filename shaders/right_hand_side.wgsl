// right_hand_side: b = - sum over faces of s_f open_f u*_f, m/s (thesis 4.38 over dx^2; E is the negative
// divergence), plus the source V_c c / dx^2 of volume control in components with a free surface.
// One thread per active quad.
// level, step. args, list: active quads. flags: see active. velocity: u*, faces, m/s. open: face apertures.
// solid_distance: m. report: rate c. rhs: b.
#import dispatch
#import layout
#import lanes
#import filled
#import flux
#import report
#import active
#import real

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> list: array<u32>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read> velocity: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> open: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> solid_distance: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read> report: array<u32>;
@group(0) @binding(9) var<storage, read_write> rhs: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn right_hand_side(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= args[3] {
        return;
    }
    let quad = active_quad(list[index]);
    var b = net_inflow(quad);
    let rate = bitcast<f32>(report[RATE]);
    if rate != 0.0 {
        let grows = bit_lanes(~flags[quad] >> SURFACELESS);
        b += Real(rate) * Real(step.dx) * select(Real4(), open_volume(quad), grows);
    }
    rhs[quad] = select(Real4(), b, bit_lanes(flags[quad]));
}
