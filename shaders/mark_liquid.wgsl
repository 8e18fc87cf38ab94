// band with a level, first: marks the tiles that liquid may reach in this sub-step, those within `moves` cells of cells with liquid before it.
// One thread per quad of the last band.
// level, tiles. band_args, band_list: the last band. liquid_distance: m. marks: per tile, 0 or 1.
#import dispatch
#import layout
#import lanes
#import tiles

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> tiles: Tiles;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> marks: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn mark_liquid(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let cell = quad_cell(level, quad);
    let top = vec3<i32>(level.cells) - 1;
    let liquid = lane_bits(lanes_inside(cell, top + 1) & (liquid_distance[quad] < vec4<f32>()));
    if liquid == 0u {
        return;
    }
    let moves = i32(tiles.moves);
    let first = cell + vec3<i32>(i32(firstTrailingBit(liquid)), 0, 0);
    let last = cell + vec3<i32>(i32(firstLeadingBit(liquid)), 0, 0);
    let low = vec3<u32>(max(first - moves, vec3<i32>())) / TILE;
    let high = vec3<u32>(min(last + moves, top)) / TILE;
    for (var z = low.z; z <= high.z; z++) {
        for (var y = low.y; y <= high.y; y++) {
            for (var x = low.x; x <= high.x; x++) {
                let tile = tile_index(tiles, vec3<u32>(x, y, z));
                if atomicLoad(&marks[tile]) == 0u {
                    atomicStore(&marks[tile], 1u);
                }
            }
        }
    }
}
