// redistance, with separation, after start_redistance: cells where liquid leaves a wall are at the interface. One thread per quad of the band.
// band_args, band_list: the band. separation_bounds, new_level: cells. eikonal_now, eikonal_next: the distance, cells, with a minus where it
// stays; in place.
#import dispatch
#import level_values

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read> separation_bounds: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> new_level: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> eikonal_now: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> eikonal_next: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn start_separated(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let phi = new_level[quad];
    let leaves = (separation_bounds[quad] > vec4<f32>(NO_BOUND)) & (phi < vec4<f32>());
    if !any(leaves) {
        return;
    }
    let distance = select(eikonal_now[quad], max(phi, vec4<f32>(-REACH)), leaves);
    eikonal_now[quad] = distance;
    eikonal_next[quad] = distance;
}
