// solve with separation, before a round with separated cells: the next set becomes the present one; the liquid distance with 0 in
// its cells. The stage active_cells makes of that the system in which they are no unknowns: the ghost fluid method puts p = 0
// at their centres, theta = 1.
// One thread per quad of the band.
// band_args, band_list: the band. liquid_distance: m. separated: see separation; in place. masked_distance: m, out.
#import dispatch
#import lanes
#import separation

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> separated: array<u32>;
@group(0) @binding(4) var<storage, read_write> masked_distance: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn separation_mask(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let word = separated[quad];
    let now = word >> NEXT & 15u;
    if word != 0u {
        separated[quad] = now | (word & (15u << CANDIDATES)) | (word >> NEXT_LOCKED & 15u) << LOCKED | now << NEXT;
    }
    masked_distance[quad] = select(liquid_distance[quad], vec4<f32>(), bit_lanes(now));
}
