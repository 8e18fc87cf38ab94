// advect_level: the component at the departure point of every cell, see level_path.
// One thread per quad of the band.
// level, step. band_args, band_list: the band. velocity: faces before the sub-step, m/s. flags: see active. labels:
// components before the sub-step, 0 for none and outside the band of then. component_origin: out.
#import dispatch
#import label_at
#import lanes
#import layout
#import level_path
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> velocity: array<f32>;
@group(0) @binding(5) var<storage, read> flags: array<u32>;
@group(0) @binding(6) var<storage, read> labels: array<u32>;
@group(0) @binding(7) var<storage, read_write> component_origin: array<vec4<u32>>;

@compute @workgroup_size(WG_SIZE)
fn component_origins(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let cell = quad_cell(level, quad);
    let exists = lanes_inside(cell, vec3<i32>(level.cells));
    var origins = vec4<u32>();
    for (var l = 0u; l < 4u; l++) {
        if !exists[l] {
            continue;
        }
        let at = vec3<f32>(cell) + vec3<f32>(0.5 + f32(l), 0.5, 0.5);
        origins[l] = label_at(level_origin(at, velocity_in(4u * quad + l)));
    }
    component_origin[quad] = origins;
}
