// extrapolate with cut cells: exchanges velocities and blended velocities of valid small-aperture faces before the
// layers. A second call after slip, with other marks in valid, restores them.
// One thread per quad of the band.
// level. band_args, band_list: the band. valid: see valid. open: face apertures. velocity: faces, m/s. velocity_next:
// from blend_slivers.
#import dispatch
#import layout
#import slivers
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> valid: array<u32>;
@group(0) @binding(4) var<storage, read> open: array<f32>;
@group(0) @binding(5) var<storage, read_write> velocity: array<f32>;
@group(0) @binding(6) var<storage, read_write> velocity_next: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn swap_slivers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    var slivers = slivers_of(quad);
    while slivers != 0u {
        let face = sliver_face(quad, firstTrailingBit(slivers));
        slivers &= slivers - 1u;
        let other = velocity_next[face];
        if other != NO_VELOCITY {
            velocity_next[face] = bitcast<u32>(velocity[face]);
            velocity[face] = bitcast<f32>(other);
        }
    }
}
