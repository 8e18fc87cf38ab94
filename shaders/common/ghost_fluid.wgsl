// Ghost fluid method (Gibou et al. 2002): distance of the surface from an active cell (distance inside < 0) towards
// an air cell (distance outside >= 0), as a fraction of dx.
// The floor bounds the matrix entries and the velocities of small-aperture faces. Matrix and velocity update share these
// functions, so that the projected field is divergence-free.
#import valid

// Surfaces of zero pressure: stages::ActiveSettings on the host.
struct ActiveSettings {
    // Smallest theta of full-aperture and of closing faces.
    theta_floor: f32,
    closing_theta_floor: f32,
    // 0 or 1: whether sides of the domain are open.
    open_sides: u32,
    pad: f32,
}

// Floor of theta on a face with an aperture.
fn face_theta_floor(settings: ActiveSettings, aperture: f32) -> f32 {
    return max(settings.theta_floor, settings.closing_theta_floor * (1.0 - aperture / SLIVER));
}

fn ghost_theta(inside: f32, outside: f32, theta_floor: f32) -> f32 {
    return max(inside / (inside - outside), theta_floor);
}
