// band, second of three: dilates the marked tiles by `reach` tiles. One thread per tile.
// tiles. marks: per tile, 0 or 1. dilated: see tiles; in place.
#import dispatch
#import tiles

@group(0) @binding(0) var<uniform> tiles: Tiles;
@group(0) @binding(1) var<storage, read> marks: array<u32>;
@group(0) @binding(2) var<storage, read_write> dilated: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn dilate_tiles(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= tiles.n.x * tiles.n.y * tiles.n.z {
        return;
    }
    let tile = tile_at(tiles, index);
    let low = max(tile, vec3<u32>(tiles.reach)) - tiles.reach;
    let high = min(tile + tiles.reach, tiles.n - 1u);
    var any = 0u;
    for (var z = low.z; z <= high.z; z++) {
        for (var y = low.y; y <= high.y; y++) {
            for (var x = low.x; x <= high.x; x++) {
                any |= marks[tile_index(tiles, vec3<u32>(x, y, z))];
            }
        }
    }
    dilated[index] = select(0u, NOW, any != 0u) | select(0u, BEFORE, (dilated[index] & NOW) != 0u);
}
