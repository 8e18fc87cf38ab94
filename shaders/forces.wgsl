// forces: u* += dt g on every face of the band. One thread per quad.
// level, step. band_args, band_list: the band. velocity_next: faces, m/s, in place.
#import dispatch
#import layout
#import lanes
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read_write> velocity_next: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn forces(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let cell = quad_cell(level, quad);
    for (var axis = 0u; axis < 3u; axis++) {
        let gain = step.dt * step.gravity[axis];
        if gain != 0.0 {
            let exists = lanes_inside(cell, face_extents(level, axis));
            velocity_next[axis * level.quads + quad] += select(vec4<f32>(), vec4<f32>(gain), exists);
        }
    }
}
