// Padded device layout of one level: grid::Padded on the host documents it, grid::Layout fills it. A quad is 4 cells
// along x. Arrays of several levels store one after another; first is the start of this level.
struct Layout {
    cells: vec3<u32>,
    stride_y: u32,
    stride_z: u32,
    quads: u32,
    first: u32,
    total: u32,
}

// Cell of the first lane of a quad of this level (quad counted within the level). In spare rows and slabs the
// coordinates are outside 0 .. cells.
fn quad_cell(level: Layout, quad: u32) -> vec3<i32> {
    let slab = quad / level.stride_z;
    let in_slab = quad - slab * level.stride_z;
    let row = in_slab / level.stride_y;
    return vec3<i32>(vec3<u32>(4u * (in_slab - row * level.stride_y), row, slab)) - vec3<i32>(0, 0, 1);
}

// Index of a cell of this level, counted within the level.
fn cell_index(level: Layout, cell: vec3<u32>) -> u32 {
    return 4u * (level.stride_z * (cell.z + 1u) + level.stride_y * cell.y) + cell.x;
}

// Cell of a point, given in cells (x / dx).
fn cell_of(level: Layout, at: vec3<f32>) -> vec3<u32> {
    return min(vec3<u32>(max(at, vec3<f32>())), level.cells - 1u);
}
