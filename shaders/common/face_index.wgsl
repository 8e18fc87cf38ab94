// Index of faces in a field with sections of x, y and z faces. The importing kernel declares level.
#import layout

// The unit vector of an axis.
fn along(axis: u32) -> vec3<i32> {
    return vec3<i32>(vec3<u32>(axis) == vec3<u32>(0u, 1u, 2u));
}

// Index of the minus face of a cell.
fn face_index(axis: u32, cell: vec3<i32>) -> u32 {
    return 4u * axis * level.quads + cell_index(level, vec3<u32>(cell));
}
