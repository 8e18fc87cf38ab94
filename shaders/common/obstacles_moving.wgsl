#import real

// J v of the obstacles over dx^2 per quad, m/s.
@group(0) @binding(15) var<storage, read> obstacle_flux: array<vec4<f32>>;

// Prescribed boundary flux of obstacles in the cells of a quad, m/s.
fn taken_by_obstacles(quad: u32) -> Real4 {
    return Real4(obstacle_flux[quad]);
}
