// filter_level, last of two: moves the filtered level of quads near the surface back to its array. One thread per quad
// of the band.
// band_args, band_list: the band. next_level: cells. new_level: cells, in place.
#import dispatch
#import filter_width

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read> next_level: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> new_level: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn keep_filtered(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    if any(near_surface(new_level[quad])) {
        new_level[quad] = next_level[quad];
    }
}
