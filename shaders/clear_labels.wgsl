// liquid_components, first: no component in the tiles that have left the band, so that none is anywhere outside it.
// One thread per slab of a tile, eight rows of two quads.
// level, tiles. dilated: see tiles. component: in place.
#import dispatch
#import layout
#import tiles

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> tiles: Tiles;
@group(0) @binding(2) var<storage, read> dilated: array<u32>;
@group(0) @binding(3) var<storage, read_write> component: array<vec4<u32>>;

@compute @workgroup_size(WG_SIZE)
fn clear_labels(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    let number = index / TILE;
    if number >= tiles.n.x * tiles.n.y * tiles.n.z || dilated[number] != BEFORE {
        return;
    }
    let tile = tile_at(tiles, number);
    let z = TILE * tile.z + index % TILE;
    if z > level.cells.z {
        return;
    }
    let end = min(TILE * tile.y + TILE, level.cells.y + 1u);
    for (var y = TILE * tile.y; y < end; y++) {
        let quad = level.stride_z * (z + 1u) + level.stride_y * y + 2u * tile.x;
        component[quad] = vec4<u32>();
        component[quad + 1u] = vec4<u32>();
    }
}
