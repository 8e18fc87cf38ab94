//! `forces`: gravity.

use glam::DVec3;

/// u += dt g on every face, m/s.
pub fn forces(faces: &mut [Vec<f64>; 3], gravity: DVec3, dt: f64) {
    for (axis, values) in faces.iter_mut().enumerate() {
        values.iter_mut().for_each(|u| *u += dt * gravity[axis]);
    }
}
