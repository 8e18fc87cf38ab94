// advect_velocity with cut cells, first: advects small-aperture faces through the unblended velocities (see advect),
// so that a squeezed film keeps its speed.
// One thread per quad of the band.
// level, step. band_args, band_list: the band. velocity: faces, m/s (velocity_quads: the same). valid: see valid.
// open: face apertures. velocity_next: u* of small-aperture faces, m/s. flags: see active.
#import advect
#import dispatch
#import lanes
#import layout
#import slivers
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> velocity: array<f32>;
@group(0) @binding(5) var<storage, read> velocity_quads: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> valid: array<u32>;
@group(0) @binding(7) var<storage, read> open: array<f32>;
@group(0) @binding(8) var<storage, read_write> velocity_next: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> flags: array<u32>;

fn makes(axis: u32, quad: u32) -> vec4<bool> {
    return bit_lanes(slivers_of(quad) >> (4u * axis));
}

fn put(axis: u32, quad: u32, made: vec4<bool>, result: vec4<f32>) {
    let here = axis * level.quads + quad;
    velocity_next[here] = select(velocity_next[here], result, made);
}

@compute @workgroup_size(WG_SIZE)
fn advect_slivers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index < band_args[3] && slivers_of(band_list[index]) != 0u {
        advect_quad(band_list[index]);
    }
}
