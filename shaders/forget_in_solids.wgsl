// redistance and liquid_distance with a level and bodies, before the extension: the level is unknown in cells with their
// centre in a body. One thread per quad of the band.
// band_args, band_list: the band. solid_distance: m, cell centres. new_level: cells. next_level: cells, out.
#import dispatch
#import unknown

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read> solid_distance: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> new_level: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> next_level: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn forget_in_solids(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    next_level[quad] = select(new_level[quad], vec4<f32>(UNKNOWN), solid_distance[quad] < vec4<f32>());
}
