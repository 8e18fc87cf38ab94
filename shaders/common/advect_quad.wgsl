// Positions and velocities of the 12 minus faces of a quad for their transport.
// The importing kernel declares level, velocity_quads (faces as vec4, m/s), and
// advect(axis, quad, cell, u, v, w) for the four faces of an axis: own component u, the other two as means over the
// cells on both sides, m/s.
#import layout
#import lanes

// Lanes of faces that exist and move. Without motion a face is unchanged; most of the band is air at rest.
fn moving(axis: u32, cell: vec3<i32>, u: vec4<f32>, v: vec4<f32>, w: vec4<f32>) -> vec4<bool> {
    let exists = lanes_inside(cell, face_extents(level, axis));
    return exists & ((u != vec4<f32>()) | (v != vec4<f32>()) | (w != vec4<f32>()));
}

// Centre of a face of the quad that starts at a cell, cells.
fn face_at(axis: u32, cell: vec3<i32>, lane: u32) -> vec3<f32> {
    let shift = select(vec3<f32>(0.5), vec3<f32>(), vec3<u32>(axis) == vec3<u32>(0u, 1u, 2u));
    return vec3<f32>(cell) + shift + vec3<f32>(f32(lane), 0.0, 0.0);
}

fn advect_quad(quad: u32) {
    let cell = quad_cell(level, quad);
    let x = quad;
    let y = level.quads + quad;
    let z = 2u * level.quads + quad;
    let sy = level.stride_y;
    let sz = level.stride_z;
    // Twice the velocity at the cell centres, here and one cell before along each axis.
    let u = velocity_quads[x];
    let v = velocity_quads[y];
    let w = velocity_quads[z];
    let cu = u + shift_down(u, velocity_quads[x + 1u]);
    let cv = v + velocity_quads[y + sy];
    let cw = w + velocity_quads[z + sz];
    let cv_x = vec4<f32>(velocity_quads[y - 1u].w + velocity_quads[y + sy - 1u].w, cv.xyz);
    let cw_x = vec4<f32>(velocity_quads[z - 1u].w + velocity_quads[z + sz - 1u].w, cw.xyz);
    let u_y = velocity_quads[x - sy];
    let cu_y = u_y + shift_down(u_y, velocity_quads[x - sy + 1u]);
    let cw_y = velocity_quads[z - sy] + velocity_quads[z - sy + sz];
    let u_z = velocity_quads[x - sz];
    let cu_z = u_z + shift_down(u_z, velocity_quads[x - sz + 1u]);
    let cv_z = velocity_quads[y - sz] + velocity_quads[y - sz + sy];
    // On a wall the single adjacent cell counts twice.
    let n = vec3<i32>(level.cells);
    let lanes = vec4<i32>(cell.x) + LANES;
    let low = lanes == vec4<i32>();
    let high = lanes == vec4<i32>(n.x);
    advect(0u, quad, cell, u,
        0.25 * (select(cv, cv_x, high) + select(cv_x, cv, low)),
        0.25 * (select(cw, cw_x, high) + select(cw_x, cw, low)));
    let low_y = cell.y == 0;
    let high_y = cell.y == n.y;
    advect(1u, quad, cell,
        0.25 * (select(cu, cu_y, high_y) + select(cu_y, cu, low_y)), v,
        0.25 * (select(cw, cw_y, high_y) + select(cw_y, cw, low_y)));
    let low_z = cell.z == 0;
    let high_z = cell.z == n.z;
    advect(2u, quad, cell,
        0.25 * (select(cu, cu_z, high_z) + select(cu_z, cu, low_z)),
        0.25 * (select(cv, cv_z, high_z) + select(cv_z, cv, low_z)), w);
}
