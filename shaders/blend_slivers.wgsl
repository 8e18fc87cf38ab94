// extrapolate with cut cells, before the layers: blended velocities of valid small-aperture faces for closed faces
// and air around them (see shown). Valid faces have their aperture as weight.
// One thread per quad of the band.
// level. band_args, band_list: the band. valid: see valid. open: face apertures. velocity: faces, m/s. velocity_next:
// at small-aperture faces the bits of the blended velocity, or NO_VELOCITY if the face is not valid.
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
@group(0) @binding(5) var<storage, read> velocity: array<f32>;
@group(0) @binding(6) var<storage, read_write> velocity_next: array<u32>;

fn is_valid(axis: u32, face: u32) -> bool {
    return (valid[face / 4u - axis * level.quads] >> (4u * axis + face % 4u) & 1u) != 0u;
}

fn weight(axis: u32, face: u32) -> f32 {
    return select(0.0, open[face], is_valid(axis, face));
}

fn trust(sum: f32) -> f32 {
    return 1.0;
}

@compute @workgroup_size(WG_SIZE)
fn blend_slivers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    var slivers = slivers_of(quad);
    while slivers != 0u {
        let bit = firstTrailingBit(slivers);
        slivers &= slivers - 1u;
        let face = sliver_face(quad, bit);
        velocity_next[face] = NO_VELOCITY;
        if is_valid(bit / 4u, face) {
            velocity_next[face] = bitcast<u32>(shown(quad, bit));
        }
    }
}
