// Trilinear interpolation of a cell-centred distance and the exact gradient of the interpolant, clamped to the range
// of the cells. The importing kernel declares level: Layout and distances: array<f32>, m.
#import corner
#import layout

// at: position in cells, x / dx. Returns the distance, m, and its gradient per cell, m.
fn sample_distance(at: vec3<f32>) -> vec4<f32> {
    let corner = centres_around(at);
    let f = corner.f;
    let row = 4u * level.stride_y;
    let i = corner.low;
    let k = i + 4u * level.stride_z;
    // The gradient across a grid one cell thick is zero.
    let thick = vec3<f32>(level.cells > vec3<u32>(1u));
    let a = vec4<f32>(distances[i], distances[i + row], distances[k], distances[k + row]);
    let b = vec4<f32>(distances[i + 1u], distances[i + row + 1u], distances[k + 1u], distances[k + row + 1u]);
    let along_x = mix(a, b, f.x);
    let along_xy = mix(along_x.xz, along_x.yw, f.y);
    let slope_x = mix((b - a).xz, (b - a).yw, f.y);
    let slope_y = along_x.yw - along_x.xz;
    let slope = vec3<f32>(mix(slope_x.x, slope_x.y, f.z), mix(slope_y.x, slope_y.y, f.z), along_xy.y - along_xy.x);
    return vec4<f32>(mix(along_xy.x, along_xy.y, f.z), slope * thick);
}
