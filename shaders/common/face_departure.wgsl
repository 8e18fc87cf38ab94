// Departure points of faces, semi-Lagrangian with the midpoint rule (Stam 1999). Ballistic liquid departs from g dt^2 / 2 higher up, see
// ballistic. The importing kernel declares the variables of ballistic and of trace.
#import ballistic
#import step
#import trace

// Departure point (cells) of a face at a position with its velocity.
fn departure(at: vec3<f32>, here: vec3<f32>) -> vec3<f32> {
    let origin = traced(at, here, -step.dt * step.inv_dx);
    if is_ballistic(origin - fall()) {
        return origin - fall();
    }
    return origin;
}
