// advect_velocity with cut cells, last: advects full-aperture faces through blended velocities (see advect).
// Small-aperture faces from half of SLIVER on mix this with the result of advect_slivers; smaller ones are unchanged.
// One thread per quad of the band and its 12 minus faces.
// level, step. band_args, band_list: the band. velocity: blended face velocities, m/s (velocity_quads: the same).
// valid: see valid. open: face apertures. velocity_next: u*, m/s (at small-aperture faces: from advect_slivers).
// flags: see active.
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

// Weight of blended velocities at the faces of an axis.
fn wholeness(axis: u32, quad: u32) -> vec4<f32> {
    if (valid[quad] & SLIVERS) == 0u {
        return vec4<f32>(1.0);
    }
    let face = 4u * (axis * level.quads + quad);
    let fractions = vec4<f32>(open[face], open[face + 1u], open[face + 2u], open[face + 3u]);
    let slivers = bit_lanes(slivers_of(quad) >> (4u * axis));
    return select(vec4<f32>(1.0), blended_part(fractions), slivers);
}
@group(0) @binding(9) var<storage, read> flags: array<u32>;

fn makes(axis: u32, quad: u32) -> vec4<bool> {
    return wholeness(axis, quad) > vec4<f32>();
}

fn put(axis: u32, quad: u32, made: vec4<bool>, result: vec4<f32>) {
    let here = axis * level.quads + quad;
    let part = wholeness(axis, quad);
    if all(part == vec4<f32>(1.0)) {
        velocity_next[here] = result;
        return;
    }
    let raw = velocity_next[here];
    velocity_next[here] = select(raw + part * (result - raw), result, part == vec4<f32>(1.0));
}

@compute @workgroup_size(WG_SIZE)
fn advect_beside_slivers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index < band_args[3] {
        advect_quad(band_list[index]);
    }
}
