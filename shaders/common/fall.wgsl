// Fall of ballistic liquid in a sub-step beyond the way of its velocity, see ballistic. The importing kernel declares step.
#import step

// g dt^2 / 2, cells.
fn fall() -> vec3<f32> {
    return (0.5 * step.dt * step.dt * step.inv_dx) * step.gravity;
}
