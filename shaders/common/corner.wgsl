// The eight points around a position for trilinear interpolation, in a field of cells or faces. The importing kernel
// declares level: Layout.
#import layout

struct Corner {
    // Index of the lowest point.
    low: u32,
    // Fractions towards the upper neighbours.
    f: vec3<f32>,
    // Strides to the upper neighbours, 0 along axes one point thick.
    up: vec3<u32>,
}

// at: continuous index of the position, clamped to 0 .. top.
fn corner_at(at: vec3<f32>, top: vec3<f32>) -> Corner {
    let index = clamp(at, vec3<f32>(), top);
    let low = min(floor(index), max(top - 1.0, vec3<f32>()));
    let cell = vec3<u32>(low);
    let strides = vec3<u32>(1u, 4u * level.stride_y, 4u * level.stride_z);
    return Corner(
        strides.z * (cell.z + 1u) + strides.y * cell.y + cell.x,
        index - low,
        select(vec3<u32>(), strides, top > vec3<f32>()),
    );
}

// The corner of a lowest point alone, without fractions.
fn corner_of(low: u32, top: vec3<f32>) -> Corner {
    let strides = vec3<u32>(1u, 4u * level.stride_y, 4u * level.stride_z);
    return Corner(low, vec3<f32>(), select(vec3<u32>(), strides, top > vec3<f32>()));
}

// The cell centres around a position in cells.
fn centres_around(at: vec3<f32>) -> Corner {
    return corner_at(at - 0.5, cell_tops());
}

// Distance of the first cell centre or face of an axis from the wall along each axis, cells.
fn face_shift(axis: u32) -> vec3<f32> {
    return select(vec3<f32>(0.5), vec3<f32>(), vec3<u32>(axis) == vec3<u32>(0u, 1u, 2u));
}

// Largest index of the faces of an axis, and of cells, along each axis.
fn face_tops(axis: u32) -> vec3<f32> {
    return vec3<f32>(level.cells) - 2.0 * face_shift(axis);
}
fn cell_tops() -> vec3<f32> {
    return vec3<f32>(level.cells) - 1.0;
}

// The faces of an axis around a position in cells; indices within the section of the axis.
fn faces_around(axis: u32, at: vec3<f32>) -> Corner {
    return corner_at(at - face_shift(axis), face_tops(axis));
}

// Indices of the four points at low x and of those at high x, y fastest.
fn corner_points(corner: Corner) -> array<vec4<u32>, 2> {
    let up = corner.up;
    let near = vec4<u32>(corner.low) + vec4<u32>(0u, up.y, up.z, up.y + up.z);
    return array<vec4<u32>, 2>(near, near + up.x);
}

// Interpolated value of the points at low x and at high x.
fn mix_points(near: vec4<f32>, far: vec4<f32>, f: vec3<f32>) -> f32 {
    let along_x = mix(near, far, f.x);
    let along_xy = mix(along_x.xz, along_x.yw, f.y);
    return mix(along_xy.x, along_xy.y, f.z);
}

// Smallest and largest value of the points.
fn range_of(near: vec4<f32>, far: vec4<f32>) -> vec2<f32> {
    let low = min(near, far);
    let high = max(near, far);
    return vec2<f32>(min(min(low.x, low.y), min(low.z, low.w)), max(max(high.x, high.y), max(high.z, high.w)));
}
