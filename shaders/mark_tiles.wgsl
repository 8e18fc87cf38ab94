// band, second of four: the tiles that hold a marker. One thread per tile.
// level, tiles. occupied: see classes. marks: per tile, 0 or 1.
#import dispatch
#import layout
#import tiles
#import classes

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> tiles: Tiles;
@group(0) @binding(2) var<storage, read> occupied: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read_write> marks: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn mark_tiles(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= tiles.n.x * tiles.n.y * tiles.n.z {
        return;
    }
    let tile = vec3<u32>(index % tiles.n.x, index / tiles.n.x % tiles.n.y, index / (tiles.n.x * tiles.n.y));
    // A row of a tile is two quads.
    let end = min(8u * tile.yz + 8u, level.cells.yz);
    var any = vec2<u32>();
    for (var z = 8u * tile.z; z < end.y; z++) {
        for (var y = 8u * tile.y; y < end.x; y++) {
            any |= occupied[(level.stride_z * (z + 1u) + level.stride_y * y) / 2u + tile.x];
        }
    }
    marks[index] = select(0u, 1u, lanes_of(any.x | any.y, MARKED) != 0u);
}
