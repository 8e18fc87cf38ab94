// advect_velocity by MacCormack's method with cut cells, last: small-aperture faces receive the result of advect_slivers,
// from half of SLIVER on mixed with that of correct_velocity. One thread per quad of the band.
// level. band_args, band_list: the band. valid: see valid. open: face apertures. sliver_velocity: from advect_slivers,
// m/s. velocity_next: u*, m/s.
#import dispatch
#import layout
#import slivers
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> valid: array<u32>;
@group(0) @binding(4) var<storage, read> open: array<f32>;
@group(0) @binding(5) var<storage, read> sliver_velocity: array<f32>;
@group(0) @binding(6) var<storage, read_write> velocity_next: array<f32>;

@compute @workgroup_size(WG_SIZE)
fn mix_slivers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    var slivers = slivers_of(quad);
    while slivers != 0u {
        let face = sliver_face(quad, firstTrailingBit(slivers));
        slivers &= slivers - 1u;
        let part = blended_part(vec4<f32>(open[face])).x;
        let raw = sliver_velocity[face];
        velocity_next[face] = raw + part * (velocity_next[face] - raw);
    }
}
