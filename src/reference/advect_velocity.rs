//! `advect_velocity`: semi-Lagrangian with a midpoint trace-back (Stam 1999). Each face receives u at the departure
//! point.
//!
//! Faces of full aperture sample blended velocities ([`shown_to_whole`]). Small-aperture faces sample the unblended
//! ones in proportion to their closed part. A film that a body squeezes out so keeps its speed without transferring
//! it to the neighbouring faces.

use glam::DVec3;
use rayon::prelude::*;

use super::ballistic::Ballistic;
use super::slivers::{shown_to_whole, wholeness};
use crate::grid::{Axis, Grid};

/// The face velocities (m/s) advected by themselves for dt (s). What is at rest stays, ballistic or not. `open`: face
/// apertures.
pub fn advect_velocity(
    grid: &Grid,
    open: &[Vec<f64>; 3],
    faces: &[Vec<f64>; 3],
    ballistic: &Ballistic,
    dt: f64,
) -> [Vec<f64>; 3] {
    let shown = shown_to_whole(grid, open, faces);
    Axis::ALL.map(|axis| {
        let a = axis.index();
        let carried = (0..grid.n_faces(axis)).into_par_iter().map(|face| {
            let x = grid.face_centre(axis, grid.face_at(axis, face));
            let carry = |field: &[Vec<f64>; 3]| {
                let here = grid.velocity_at(field, x);
                if here == DVec3::ZERO {
                    return 0.0;
                }
                let middle = x - 0.5 * dt * here;
                let origin = x - dt * grid.velocity_at(field, middle);
                grid.sample(axis, &field[a], ballistic.origin(grid, origin))
            };
            match wholeness(open[a][face]) {
                0.0 => carry(faces),
                1.0 => carry(&shown),
                part => (1.0 - part) * carry(faces) + part * carry(&shown),
            }
        });
        carried.collect()
    })
}
