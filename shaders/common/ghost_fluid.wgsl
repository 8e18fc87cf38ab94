// Ghost fluid method (Gibou et al. 2002): where the liquid surface cuts the line between an active cell (distance inside < 0)
// and an air cell (distance outside >= 0), as a fraction of dx from the active cell. The floor bounds the matrix entries; matrix
// and velocity update share this function, or the projected field would not be divergence-free.
fn ghost_theta(inside: f32, outside: f32, theta_floor: f32) -> f32 {
    return max(inside / (inside - outside), theta_floor);
}
