// occupancy, first of three: clears the sums of the markers' weights. One thread per quad of the band.
// band_args, band_list: the band. marker_weights: out.
#import dispatch

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read_write> marker_weights: array<vec4<u32>>;

@compute @workgroup_size(WG_SIZE)
fn clear_weights(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index < band_args[3] {
        marker_weights[band_list[index]] = vec4<u32>();
    }
}
