// The importing kernel declares level: Layout.
#import layout

// Padded index of a cell.
fn index_of(cell: vec3<u32>) -> u32 {
    return 4u * (level.stride_z * (cell.z + 1u) + level.stride_y * cell.y) + cell.x;
}
