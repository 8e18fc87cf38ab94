// Ways of cell centres for the transport of a level (see reference/advect_level.rs).
// The importing kernel declares the variables of ballistic and velocity: array<f32>, faces, m/s.
#import ballistic
#import layout
#import step
#import trace
#import walls

// Velocity at the centre of a cell by its index, m/s.
fn velocity_in(cell: u32) -> vec3<f32> {
    let y = 4u * level.quads + cell;
    let z = 8u * level.quads + cell;
    let low = vec3<f32>(velocity[cell], velocity[y], velocity[z]);
    let high = vec3<f32>(velocity[cell + 1u], velocity[y + 4u * level.stride_y], velocity[z + 4u * level.stride_z]);
    return 0.5 * (low + high);
}

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
