// Neighbours of the four cells of a quad across open faces, as level_cells, from the same words.
// The importing kernel declares level, step and valid: array<u32>.
#import lanes
#import layout
#import step
#import valid

// Lanes with a cell across an open face, which may be in a body: bits 0 to 3 on the -x side, then on the +x, -y, +y, -z and +z side.
fn cells_across(quad: u32) -> u32 {
    let here = valid[quad] >> OPEN;
    let x = here & 15u;
    let after = x >> 1u | (valid[quad + 1u] >> OPEN & 1u) << 3u;
    let y = here >> 4u & 15u | (valid[quad + level.stride_y] >> (OPEN + 4u) & 15u) << 4u;
    let z = here >> 8u & 15u | (valid[quad + level.stride_z] >> (OPEN + 8u) & 15u) << 4u;
    let sides = x | after << 4u | y << 8u | z << 16u;
    if step.open_sides == 0u {
        return sides;
    }
    let cell = quad_cell(level, quad);
    let n = vec3<i32>(level.cells);
    let lanes = vec4<i32>(cell.x) + LANES;
    let inside = lane_bits(lanes > vec4<i32>()) | lane_bits(lanes + 1 < vec4<i32>(n.x)) << 4u
        | select(0u, 15u, cell.y > 0) << 8u | select(0u, 15u, cell.y + 1 < n.y) << 12u
        | select(0u, 15u, cell.z > 0) << 16u | select(0u, 15u, cell.z + 1 < n.z) << 20u;
    return sides & inside;
}
