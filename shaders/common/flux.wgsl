// Inflow of cells. The importing kernel declares level: Layout, velocity: array<vec4<f32>>, faces, m/s, and open:
// array<vec4<f32>>, face apertures, negative on faces of sources, whose flux counts all the same.
#import layout
#import lanes
#import real

fn between(area_minus: vec4<f32>, u_minus: vec4<f32>, area_plus: vec4<f32>, u_plus: vec4<f32>) -> Real4 {
    return Real4(abs(area_minus)) * Real4(u_minus) - Real4(abs(area_plus)) * Real4(u_plus);
}

// - sum over faces of s_f open_f u_f for the cells of a quad, m/s.
fn net_inflow(quad: u32) -> Real4 {
    let y = level.quads + quad;
    let z = 2u * level.quads + quad;
    let above = y + level.stride_y;
    let behind = z + level.stride_z;
    let area = open[quad];
    let u = velocity[quad];
    return between(area, u, shift_down(area, open[quad + 1u]), shift_down(u, velocity[quad + 1u]))
        + between(open[y], velocity[y], open[above], velocity[above])
        + between(open[z], velocity[z], open[behind], velocity[behind]);
}
