// Ghost fluid method (Gibou et al. 2002): distance of the surface from an active cell (distance inside < 0) towards
// an air cell (distance outside >= 0), as a fraction of dx.
// The floor bounds the matrix entries. Matrix and velocity update share this function, so that the projected field is
// divergence-free.
fn ghost_theta(inside: f32, outside: f32, theta_floor: f32) -> f32 {
    return max(inside / (inside - outside), theta_floor);
}
