// band, last of three: flags of the quads whose tile enters or leaves the band.
// Quads that leave are reset to air: liquid distance + dx, with a level + 5 dx, no valid face, no cell that liquid leaves
// walls in. Their velocity remains until write_back, since advection may read it. Clears the marks for the next sub-step.
// One thread per slab of a tile, eight rows of two quads.
// level, step, tiles. dilated: see tiles. marks: per tile. band_flags: per quad, 0 or 1, in place. liquid_distance:
// m. valid, valid_next: see valid.
#import dispatch
#import layout
#import step
#import tiles
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<uniform> tiles: Tiles;
@group(0) @binding(3) var<storage, read> dilated: array<u32>;
@group(0) @binding(4) var<storage, read_write> marks: array<u32>;
@group(0) @binding(5) var<storage, read_write> band_flags: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> liquid_distance: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> valid: array<vec2<u32>>;
@group(0) @binding(8) var<storage, read_write> valid_next: array<vec2<u32>>;

@compute @workgroup_size(WG_SIZE)
fn flag_band(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    let number = index / TILE;
    if number >= tiles.n.x * tiles.n.y * tiles.n.z {
        return;
    }
    if index % TILE == 0u {
        marks[number] = 0u;
    }
    let tile = tile_at(tiles, number);
    let word = dilated[number];
    let z = TILE * tile.z + index % TILE;
    if word == 0u || word == (NOW | BEFORE) || z > level.cells.z {
        return;
    }
    let end = min(TILE * tile.y + TILE, level.cells.y + 1u);
    for (var y = TILE * tile.y; y < end; y++) {
        let row = (level.stride_z * (z + 1u) + level.stride_y * y) / 2u + tile.x;
        band_flags[row] = vec2<u32>(word & NOW);
        if word == BEFORE {
            liquid_distance[2u * row] = vec4<f32>(f32(tiles.air) * step.dx);
            liquid_distance[2u * row + 1u] = vec4<f32>(f32(tiles.air) * step.dx);
            valid[row] &= vec2<u32>(~(VALID | LEAVING));
            valid_next[row] &= vec2<u32>(~(VALID | LEAVING));
        }
    }
}
