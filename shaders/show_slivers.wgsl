// advect_velocity with cut cells, between advect_slivers and advect_beside_slivers: replaces the velocity of
// small-aperture faces by the blended one (see shown).
// Only full-aperture faces have weight, by their aperture minus SLIVER, so the result is continuous in the apertures.
// They are not written, so the kernel works in place. One thread per quad of the band.
// level. band_args, band_list: the band. valid: see valid. open: face apertures. velocity: faces, m/s.
#import dispatch
#import layout
#import shown
#import slivers
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> valid: array<u32>;
@group(0) @binding(4) var<storage, read> open: array<f32>;
@group(0) @binding(5) var<storage, read_write> velocity: array<f32>;

fn weight(axis: u32, face: u32) -> f32 {
    return open[face] - SLIVER;
}

fn trust(sum: f32) -> f32 {
    return min(sum / SLIVER, 1.0);
}

@compute @workgroup_size(WG_SIZE)
fn show_slivers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    var slivers = slivers_of(quad);
    while slivers != 0u {
        let bit = firstTrailingBit(slivers);
        slivers &= slivers - 1u;
        velocity[sliver_face(quad, bit)] = shown(quad, bit);
    }
}
