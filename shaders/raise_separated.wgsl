// bound_level, with separation, last: the level is at least its bound at walls and bodies. One thread per quad of the band.
// band_args, band_list: the band. separation_bounds: cells. new_level: cells, in place.
#import dispatch

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read> separation_bounds: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> new_level: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn raise_separated(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    new_level[quad] = max(new_level[quad], separation_bounds[quad]);
}
