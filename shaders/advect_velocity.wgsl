// advect_velocity: semi-Lagrangian advection of the face velocities (see advect).
// One thread per quad of the band and its 12 minus faces.
// level, step. band_args, band_list: the band. velocity: faces, m/s (velocity_quads: the same). velocity_next: u*,
// m/s. flags: see active.
#import advect
#import dispatch
#import layout
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> velocity: array<f32>;
@group(0) @binding(5) var<storage, read> velocity_quads: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> velocity_next: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> flags: array<u32>;

fn makes(axis: u32, quad: u32) -> vec4<bool> {
    return vec4<bool>(true);
}

fn put(axis: u32, quad: u32, made: vec4<bool>, result: vec4<f32>) {
    velocity_next[axis * level.quads + quad] = result;
}

@compute @workgroup_size(WG_SIZE)
fn advect_velocity(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index < band_args[3] {
        advect_quad(band_list[index]);
    }
}
