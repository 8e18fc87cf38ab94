//! `advect_velocity`: semi-Lagrangian with a midpoint trace-back (Stam 1999), per face: u(x_f) := u at where x_f came from.

use rayon::prelude::*;

use crate::grid::{Axis, Grid};

/// The face velocities (m/s) carried along by themselves for dt (s).
pub fn advect_velocity(grid: &Grid, faces: &[Vec<f64>; 3], dt: f64) -> [Vec<f64>; 3] {
    Axis::ALL.map(|axis| {
        let carried = (0..grid.n_faces(axis)).into_par_iter().map(|face| {
            let x = grid.face_centre(axis, grid.face_at(axis, face));
            let middle = x - 0.5 * dt * grid.velocity_at(faces, x);
            let origin = x - dt * grid.velocity_at(faces, middle);
            grid.sample(axis, &faces[axis.index()], origin)
        });
        carried.collect()
    })
}
