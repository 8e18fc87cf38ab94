// Part of the cells below the zero level of the interpolant (reference/level_cells.rs): clamp(1/2 - 2 phi, 0, 1) in the centres of
// the eighths, with phi in cells.
// The importing kernel declares level: Layout, step: Step and liquid_distance: array<vec4<f32>>, m, cell centres.
#import layout
#import step

// Level beyond which the surface does not cut a cell, cells.
const UNCUT = 1.0;

// Cells beyond a wall are those at the wall.
fn distance_at(cell: vec3<i32>) -> f32 {
    let at = vec3<u32>(clamp(cell, vec3<i32>(), vec3<i32>(level.cells) - 1));
    return liquid_distance[level.stride_z * (at.z + 1u) + level.stride_y * at.y + at.x / 4u][at.x % 4u];
}

// Weights of the cell at a step of -1, 0 or 1 in the lower and the upper half along an axis.
fn half_weights(step_by: i32) -> vec2<f32> {
    let sides = vec2<f32>(f32(step_by < 0), f32(step_by > 0));
    return select(0.25 * sides, vec2<f32>(0.75), step_by == 0);
}

fn interpolant_part(cell: vec3<i32>) -> f32 {
    let own = distance_at(cell) / step.dx;
    if abs(own) >= UNCUT {
        return f32(own < 0.0);
    }
    // In the lower and the upper half along x, of the quarters along y and z.
    var low: vec4<f32>;
    var high: vec4<f32>;
    for (var z = -1; z <= 1; z++) {
        for (var y = -1; y <= 1; y++) {
            let wy = half_weights(y);
            let wz = half_weights(z);
            let weights = vec4<f32>(wy * wz.x, wy * wz.y);
            let row = cell + vec3<i32>(0, y, z);
            let middle = 0.75 * distance_at(row);
            low += weights * (0.25 * distance_at(row - vec3<i32>(1, 0, 0)) + middle);
            high += weights * (middle + 0.25 * distance_at(row + vec3<i32>(1, 0, 0)));
        }
    }
    let per_cell = 2.0 / step.dx;
    let one = vec4<f32>(1.0);
    let parts = clamp(0.5 - per_cell * low, vec4<f32>(), one) + clamp(0.5 - per_cell * high, vec4<f32>(), one);
    return dot(parts, vec4<f32>(0.125));
}

// Of the lanes of a quad at a cell.
fn interpolant_parts(cell: vec3<i32>) -> vec4<f32> {
    var parts: vec4<f32>;
    for (var l = 0; l < 4; l++) {
        parts[l] = interpolant_part(cell + vec3<i32>(l, 0, 0));
    }
    return parts;
}
