// band, last of four: a flag per quad in a dilated tile. What a quad that leaves the band still holds is put back to air:
// liquid distance + dx, no valid face. One thread per row of a tile, two quads, over the whole domain.
// level, step, tiles. dilated: per tile, 0 or 1. flags: per quad, in place. liquid_distance: m. valid, valid_next: see valid.
#import dispatch
#import layout
#import step
#import tiles
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<uniform> tiles: Tiles;
@group(0) @binding(3) var<storage, read> dilated: array<u32>;
@group(0) @binding(4) var<storage, read_write> flags: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> liquid_distance: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> valid: array<vec2<u32>>;
@group(0) @binding(7) var<storage, read_write> valid_next: array<vec2<u32>>;

@compute @workgroup_size(WG_SIZE)
fn flag_band(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let row = linear_index(workgroup, lane);
    if 2u * row >= level.quads {
        return;
    }
    let cell = quad_cell(level, 2u * row);
    var flag = 0u;
    // The slabs before the first and behind the last faces along z are never in the band.
    if cell.z >= 0 && cell.z <= i32(level.cells.z) {
        let tile = vec3<u32>(cell) / 8u;
        flag = dilated[tiles.n.x * (tiles.n.y * tile.z + tile.y) + tile.x];
    }
    let before = flags[row];
    if all(before == vec2<u32>(flag)) {
        return;
    }
    flags[row] = vec2<u32>(flag);
    if flag == 0u {
        liquid_distance[2u * row] = vec4<f32>(step.dx);
        liquid_distance[2u * row + 1u] = vec4<f32>(step.dx);
        valid[row] &= vec2<u32>(~VALID);
        valid_next[row] &= vec2<u32>(~VALID);
    }
}
