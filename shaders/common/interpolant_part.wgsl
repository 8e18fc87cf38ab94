// Part of the cells below the zero level of the interpolant (reference/level_cells.rs): clamp(1/2 - 2 phi, 0, 1) in the centres of
// the eighths, with phi in cells.
// The importing kernel declares level: Layout, step: Step and liquid_distance: array<vec4<f32>>, m, cell centres.
#import lanes
#import layout
#import step

// Level beyond which the surface does not cut a cell, cells.
const UNCUT = 1.0;

// Weights of the cell at a step of -1, 0 or 1 in the lower and the upper half along an axis.
fn half_weights(step_by: i32) -> vec2<f32> {
    let sides = vec2<f32>(f32(step_by < 0), f32(step_by > 0));
    return select(0.25 * sides, vec2<f32>(0.75), step_by == 0);
}

fn outer(lanes: vec4<f32>, weights: vec4<f32>) -> mat4x4<f32> {
    return mat4x4<f32>(lanes * weights.x, lanes * weights.y, lanes * weights.z, lanes * weights.w);
}

// The sum over four eighths of a cell, of which the columns are phi, m.
fn filled_eighths(phi: mat4x4<f32>) -> vec4<f32> {
    let per_cell = 2.0 / step.dx;
    var sum: vec4<f32>;
    for (var n = 0u; n < 4u; n++) {
        sum += clamp(0.5 - per_cell * phi[n], vec4<f32>(), vec4<f32>(1.0));
    }
    return sum;
}

// Of the lanes of a quad. Cells beyond a wall are those at the wall.
fn interpolant_parts(quad: u32) -> vec4<f32> {
    let own = liquid_distance[quad];
    let uncut = abs(own) >= vec4<f32>(UNCUT * step.dx);
    let whole = vec4<f32>(own < vec4<f32>());
    if all(uncut) {
        return whole;
    }
    let cell = quad_cell(level, quad);
    let top = vec3<i32>(level.cells) - 1;
    let at_top = vec4<i32>(cell.x) + LANES >= vec4<i32>(top.x);
    // In the lower and the upper half along x, of the quarters along y and z.
    var low: mat4x4<f32>;
    var high: mat4x4<f32>;
    for (var z = -1; z <= 1; z++) {
        for (var y = -1; y <= 1; y++) {
            let wy = half_weights(y);
            let wz = half_weights(z);
            let weights = vec4<f32>(wy * wz.x, wy * wz.y);
            let at = vec2<u32>(clamp(cell.yz + vec2<i32>(y, z), vec2<i32>(), top.yz));
            let row = level.stride_z * (at.y + 1u) + level.stride_y * at.x + u32(cell.x) / 4u;
            let here = liquid_distance[row];
            let before = vec4<f32>(select(liquid_distance[row - 1u].w, here.x, cell.x == 0), here.xyz);
            let after = select(vec4<f32>(here.yzw, liquid_distance[row + 1u].x), here, at_top);
            low += outer(0.25 * before + 0.75 * here, weights);
            high += outer(0.75 * here + 0.25 * after, weights);
        }
    }
    return select(0.125 * (filled_eighths(low) + filled_eighths(high)), whole, uncut);
}
