// redistance, with separation, last: cells where liquid leaves a wall keep their level. One thread per quad of the band.
// band_args, band_list: the band. separation_bounds: cells. mixed: the level before its relaxation, cells. new_level: cells, in place.
#import dispatch
#import level_values

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read> separation_bounds: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> mixed: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> new_level: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn keep_separated(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let kept = mixed[quad];
    let leaves = (separation_bounds[quad] > vec4<f32>(NO_BOUND)) & (kept < vec4<f32>());
    if any(leaves) {
        new_level[quad] = select(new_level[quad], kept, leaves);
    }
}
