// Neighbours of cells for the stages of a level set: across open faces, mirrored at walls and bodies (see
// reference/level_cells.rs). A cell is its index in the device layout.
// The importing kernel declares level: Layout, open: array<f32> (face apertures) and solid_distance: array<f32> (m, cell
// centres; one quad far outside in a scene without bodies).
#import layout
#import level_values

// Whether the centre of a cell lies outside all bodies.
fn is_open(cell: u32) -> bool {
    return solid_distance[min(cell, arrayLength(&solid_distance) - 1u)] >= 0.0;
}

fn inside_domain(cell: u32) -> bool {
    let at = quad_cell(level, cell / 4u) + vec3<i32>(i32(cell % 4u), 0, 0);
    return all(at >= vec3<i32>()) && all(at < vec3<i32>(level.cells));
}

// The cell across the minus (0) or plus (1) face along an axis, of bodies too; the cell itself at walls, open sides and
// closed faces.
fn across(cell: u32, axis: u32, side: u32) -> u32 {
    let strides = vec3<u32>(1u, 4u * level.stride_y, 4u * level.stride_z);
    let plus = cell + side * strides[axis];
    if open[axis * 4u * level.quads + plus] <= 0.0 {
        return cell;
    }
    let other = plus - (1u - side) * strides[axis];
    return select(cell, other, inside_domain(other));
}

// The same; the cell itself at bodies too, which mirrors a field there.
fn beside(cell: u32, axis: u32, side: u32) -> u32 {
    let other = across(cell, axis, side);
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
