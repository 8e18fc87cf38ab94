// Traces along the velocity by the midpoint rule. The importing kernel declares the variables of sample_velocity.
#import sample_velocity

// End (cells) of a trace from a position (cells) with its velocity (m/s). way: time over cell width, s/m, negative for a
// trace back.
fn traced(at: vec3<f32>, here: vec3<f32>, way: f32) -> vec3<f32> {
    return at + way * sample_velocity(at + 0.5 * way * here);
}
