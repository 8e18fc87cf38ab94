// Neighbours of the four cells of a quad with their centre outside bodies, as level_cells, and from the same words.
// The importing kernel declares level, valid: array<u32> and occupied: array<u32>.
#import lanes
#import layout
#import valid

fn rooms(quad: u32) -> u32 {
    return ~occupied[quad] & 15u;
}

// The lanes of one side of four in a word of sides, -x, +x, -y, +y, -z and +z.
fn side_lanes(sides: u32, side: u32) -> vec4<bool> {
    return bit_lanes(sides >> (4u * side));
}

// Lanes with such a neighbour on the minus (bits 0 to 3) and plus side (4 to 7) along an axis with a stride in quads. Beyond open sides there is
// no room.
fn rooms_along(axis: u32, stride: u32, quad: u32) -> u32 {
    let here = valid[quad] >> (OPEN + 4u * axis) & 15u;
    let next = valid[quad + stride] >> (OPEN + 4u * axis) & 15u;
    let before = rooms(quad - stride);
    let after = rooms(quad + stride);
    if axis == 0u {
        let own = rooms(quad);
        return (here & (own << 1u | before >> 3u)) | ((here >> 1u | next << 3u) & (own >> 1u | after << 3u) & 15u) << 4u;
    }
    return (here & before) | (next & after) << 4u;
}

// Lanes with such a neighbour on each side.
fn rooms_beside(quad: u32) -> u32 {
    return rooms_along(0u, 1u, quad) | rooms_along(1u, level.stride_y, quad) << 8u
        | rooms_along(2u, level.stride_z, quad) << 16u;
}
