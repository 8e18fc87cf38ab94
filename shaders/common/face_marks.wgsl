// Marks of the 12 minus faces of quads, bit 4 axis + lane, and those of faces around them. The importing kernel declares
// level: Layout and valid_in: array<u32> (see valid).
#import layout
#import lanes
#import valid

// The first and the last lane of each axis.
const FIRST = 0x111u;
const LAST = 0x888u;

// The marks one face before and after each lane, from those of the quads and of the quads before or after them.
fn before(here: vec4<u32>, previous: vec4<u32>) -> vec4<u32> {
    return (here << vec4<u32>(1u) & vec4<u32>(~FIRST)) | (previous >> vec4<u32>(3u) & vec4<u32>(FIRST));
}
fn after(here: vec4<u32>, next: vec4<u32>) -> vec4<u32> {
    return (here >> vec4<u32>(1u) & vec4<u32>(~LAST)) | (next << vec4<u32>(3u) & vec4<u32>(LAST));
}

fn marks(quads: vec4<u32>, exist: vec4<bool>) -> vec4<u32> {
    let words = vec4<u32>(valid_in[quads.x], valid_in[quads.y], valid_in[quads.z], valid_in[quads.w]);
    return select(vec4<u32>(), words & vec4<u32>(VALID), exist);
}

fn any_of(marks: vec4<u32>) -> u32 {
    return marks.x | marks.y | marks.z | marks.w;
}

// Faces that exist in the quad that starts at a cell; rows and slabs of spare cells would lead to other rows and slabs.
fn faces_inside(cell: vec3<i32>) -> u32 {
    return lane_bits(lanes_inside(cell, face_extents(level, 0u)))
        | lane_bits(lanes_inside(cell, face_extents(level, 1u))) << 4u
        | lane_bits(lanes_inside(cell, face_extents(level, 2u))) << 8u;
}

// Marks of the faces beside those of a quad.
struct Sides {
    // Before and after them in their row, and nothing.
    row: vec4<u32>,
    // In the rows before and after along y, and along z.
    beside: vec4<u32>,
}

fn sides_of(quad: u32, cell: vec3<i32>, here: u32) -> Sides {
    let n = vec3<i32>(level.cells);
    let y = level.stride_y;
    let z = level.stride_z;
    let in_row = vec4<bool>(cell.x > 0, cell.x + 4 <= n.x, false, false);
    let ends = marks(vec4<u32>(quad - 1u, quad + 1u, quad, quad), in_row);
    return Sides(
        vec4<u32>(before(vec4<u32>(here), ends.xxxx).x, after(vec4<u32>(here), ends.yyyy).x, 0u, 0u),
        marks(vec4<u32>(quad - y, quad + y, quad - z, quad + z), vec4<bool>(cell.y > 0, cell.y < n.y, true, true)),
    );
}
