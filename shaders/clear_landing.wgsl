// landing, second of four: clears the sums of the faces in the band, where any marker lands. One thread per quad of the band.
// level. band_args, band_list: the band. marker_counts: see marker_counts. landing_momentum, landing_weight: see landing; out.
#import dispatch
#import layout
#import marker_counts

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> marker_counts: array<u32>;
@group(0) @binding(4) var<storage, read_write> landing_momentum: array<vec4<i32>>;
@group(0) @binding(5) var<storage, read_write> landing_weight: array<vec4<i32>>;

@compute @workgroup_size(WG_SIZE)
fn clear_landing(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] || marker_counts[LANDED] == 0u {
        return;
    }
    for (var axis = 0u; axis < 3u; axis++) {
        let quad = axis * level.quads + band_list[index];
        landing_momentum[quad] = vec4<i32>();
        landing_weight[quad] = vec4<i32>();
    }
}
