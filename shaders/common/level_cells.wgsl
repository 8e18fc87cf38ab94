// Neighbours of cells for the stages of a level set: across open faces, mirrored at walls and bodies (see
// reference/level_cells.rs). A cell is its index in the device layout.
// The importing kernel declares level, step, valid: array<u32> (open faces, see valid) and occupied: array<u32> (lanes that are outside the domain
// or have their centre in a body, see classes).
#import layout
#import level_values
#import step
#import valid

// Whether a cell is in the domain and its centre outside all bodies.
fn is_open(cell: u32) -> bool {
    return (occupied[cell / 4u] >> (cell % 4u) & 1u) == 0u;
}

fn inside_domain(cell: u32) -> bool {
    let at = quad_cell(level, cell / 4u) + vec3<i32>(i32(cell % 4u), 0, 0);
    return all(at >= vec3<i32>()) && all(at < vec3<i32>(level.cells));
}

// The cell across the minus (0) or plus (1) face along an axis, of bodies and beyond open sides too; the cell itself at walls and closed faces.
fn across_face(cell: u32, axis: u32, side: u32) -> u32 {
    let strides = vec3<u32>(1u, 4u * level.stride_y, 4u * level.stride_z);
    let plus = cell + side * strides[axis];
    let is_open_face = (valid[plus / 4u] >> (OPEN + 4u * axis + plus % 4u) & 1u) != 0u;
    return select(cell, plus - (1u - side) * strides[axis], is_open_face);
}

// The same; the cell itself at open sides too.
fn across(cell: u32, axis: u32, side: u32) -> u32 {
    let other = across_face(cell, axis, side);
    return select(cell, other, step.open_sides == 0u || inside_domain(other));
}

// The same; the cell itself at bodies too, which mirrors a field there.
fn beside(cell: u32, axis: u32, side: u32) -> u32 {
    let other = across_face(cell, axis, side);
    return select(cell, other, is_open(other));
}

// The cell at distance two, mirrored likewise.
fn beyond(cell: u32, axis: u32, side: u32) -> u32 {
    let near = beside(cell, axis, side);
    if near == cell {
        return beside(cell, axis, 1u - side);
    }
    return beside(near, axis, side);
}
