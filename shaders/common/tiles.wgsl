// Tiles of 8 x 8 x 8 cells that cover every cell and every face: fields::Tiles on the host.
struct Tiles {
    n: vec3<u32>,
    // Tiles by which the band extends beyond tiles with liquid.
    reach: u32,
    // Distance of air from the surface outside the band, cells.
    air: u32,
    // Cells by which liquid may move in a sub-step.
    moves: u32,
    pad_0: u32,
    pad_1: u32,
}

// Cells along the edge of a tile: two quads.
const TILE = 8u;

// Bits of the word per tile: in the band now, and in the last sub-step.
const NOW = 1u;
const BEFORE = 2u;

fn tile_at(tiles: Tiles, index: u32) -> vec3<u32> {
    return vec3<u32>(index % tiles.n.x, index / tiles.n.x % tiles.n.y, index / (tiles.n.x * tiles.n.y));
}

fn tile_index(tiles: Tiles, tile: vec3<u32>) -> u32 {
    return tiles.n.x * (tiles.n.y * tile.z + tile.y) + tile.x;
}
