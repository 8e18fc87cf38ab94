// extrapolate, where bodies cut the grid: before the layers valid slivers put on what blend_slivers made and lay their own velocity
// aside; after slip, when the marks in valid are others, the same kernel gives it back. One thread per quad of the band.
// level. band_args, band_list: the band. valid: see valid. open: fractions of the faces. velocity: faces, m/s. velocity_next: as blend_slivers
// left it.
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
