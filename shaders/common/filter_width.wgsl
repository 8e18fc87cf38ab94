// Distance from the surface up to which filter_level acts, cells: WIDTH of reference/filter_level.rs.
const FILTER_WIDTH = 1.5;

fn near_surface(phi: vec4<f32>) -> vec4<bool> {
    return abs(phi) <= vec4<f32>(FILTER_WIDTH);
}
