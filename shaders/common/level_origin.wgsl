// Departure points of cell centres for the transport of a level (see reference/advect_level.rs).
// The importing kernel declares the variables of ballistic and level_path.
#import ballistic
#import level_path
#import walls

// Departure point (cells) of a centre with its velocity.
fn level_origin(at: vec3<f32>, here: vec3<f32>) -> vec3<f32> {
    let origin = traced(at, here, -step.dt * step.inv_dx);
    if is_ballistic_about(origin - fall()) {
        return origin - fall();
    }
    return origin;
}

// Distance of a position (cells) beyond an open side, cells; negative within the domain.
fn beyond_side(at: vec3<f32>) -> f32 {
    if step.open_sides == 0u {
        return -1.0;
    }
    let low = select(vec3<f32>(-1.0), -at, open_sides(step, 0u));
    let high = select(vec3<f32>(-1.0), at - vec3<f32>(level.cells), open_sides(step, 1u));
    let beyond = max(low, high);
    return max(beyond.x, max(beyond.y, beyond.z));
}
