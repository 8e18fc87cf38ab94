//! `advect_velocity`: semi-Lagrangian with a midpoint trace-back (Stam 1999). Each face receives u at the departure
//! point.
//!
//! Faces of full aperture sample blended velocities ([`shown_to_whole`]). Small-aperture faces sample the unblended ones in
//! proportion to their closed part. So a film that a body squeezes out does not transfer its speed to the neighbouring faces.
//!
//! Or MacCormack's method (Selle et al. 2008), of second order. The second pass returns the advected velocity a to its start:
//!
//! ```text
//! a(x) = u(x - dt u),    u*(x) = a(x) + (u(x) - a(x + dt u)) / 2
//! ```
//!
//! A u* beyond the range of the taps of a(x) is limited. First it is clamped to the range, which is widened on each side by r/2 of it.
//! Then the part 1 - r of a(x) is blended in. The relaxation r is 1 in sub-steps with a [Courant number](super::TimeStep::courant) of up to 1.5, and 0 from 3,
//! where relaxed limits lose liquid. With r = 0 maxima of the speed shrink: a jet of four cells that a plate turns loses 10 % of its momentum.
//!
//! Extrapolated velocities are included: without them a wave of 20 cells loses four times as much. Small-aperture faces have
//! the first order.

use glam::DVec3;
use rayon::prelude::*;

use super::ballistic::Ballistic;
use super::slivers::{shown_to_whole, wholeness};
use crate::grid::{Axis, Grid};

/// Overshoot of a relaxed limit beyond the taps, over their range.
const OVERSHOOT: f64 = 0.5;
/// Courant number up to which r is 1. From there it falls to 0 at twice this.
const RELAXED: f64 = 1.5;
/// Shift of the departure points that selects the taps, cells. Departure points are often on the border between two sets of taps, where a
/// rounding must not choose. It exceeds the roundings of f32 on grids of up to 2,000 cells.
const NUDGE: f64 = 1.0 / 1024.0;

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
    let carry = |field: &[Vec<f64>; 3], axis, face| carried(grid, field, ballistic, dt, (axis, face));
    Axis::ALL.map(|axis| {
        let carried = (0..grid.n_faces(axis)).into_par_iter().map(|face| {
            mixed(wholeness(open[axis.index()][face]), || carry(faces, axis, face), || carry(&shown, axis, face))
        });
        carried.collect()
    })
}

/// The same by MacCormack's method, in a sub-step with the [Courant number](super::TimeStep::courant) of the surface.
pub fn advect_velocity_maccormack(
    grid: &Grid,
    open: &[Vec<f64>; 3],
    faces: &[Vec<f64>; 3],
    ballistic: &Ballistic,
    [dt, courant]: [f64; 2],
) -> [Vec<f64>; 3] {
    let relaxation = (2.0 - courant / RELAXED).clamp(0.0, 1.0);
    let shown = shown_to_whole(grid, open, faces);
    Axis::ALL.map(|axis| {
        let a = axis.index();
        let all = || (0..grid.n_faces(axis)).into_par_iter();
        let carry = |field: &[Vec<f64>; 3], face| carried(grid, field, ballistic, dt, (axis, face));
        let first: Vec<f64> = all().map(|face| carry(&shown, face)).collect();
        let correct = |face: usize| {
            let Some(from) = origin(grid, &shown, ballistic, dt, (axis, face)) else {
                return 0.0;
            };
            let x = grid.face_centre(axis, grid.face_at(axis, face));
            let to = grid.traced(&shown, x, dt) + ballistic.shift_about(grid, x);
            let corrected = first[face] + 0.5 * (shown[a][face] - grid.sample(axis, &first, to));
            let taps = grid.faces_around(axis, from + NUDGE * grid.dx).values(&shown[a]);
            let low = taps.into_iter().fold(f64::INFINITY, f64::min);
            let high = taps.into_iter().fold(f64::NEG_INFINITY, f64::max);
            if low <= corrected && corrected <= high {
                return corrected;
            }
            let beyond = relaxation * OVERSHOOT * (high - low);
            // Velocities of a broken device may be infinite.
            match beyond.is_finite() {
                true => (1.0 - relaxation) * first[face] + relaxation * corrected.clamp(low - beyond, high + beyond),
                false => first[face],
            }
        };
        let all = all().map(|face| mixed(wholeness(open[a][face]), || carry(faces, face), || correct(face)));
        all.collect()
    })
}

/// Velocity of a face after the first order of the transport, m/s.
fn carried(grid: &Grid, field: &[Vec<f64>; 3], ballistic: &Ballistic, dt: f64, (axis, face): (Axis, usize)) -> f64 {
    let x = origin(grid, field, ballistic, dt, (axis, face));
    x.map_or(0.0, |x| grid.sample(axis, &field[axis.index()], x))
}

/// Departure point (m) of a face after dt (s), by the midpoint rule; `None` where the face is at rest.
fn origin(
    grid: &Grid,
    field: &[Vec<f64>; 3],
    ballistic: &Ballistic,
    dt: f64,
    (axis, face): (Axis, usize),
) -> Option<DVec3> {
    let x = grid.face_centre(axis, grid.face_at(axis, face));
    let moves = grid.velocity_at(field, x) != DVec3::ZERO;
    moves.then(|| ballistic.origin(grid, grid.traced(field, x, -dt)))
}

/// Part `mix` of `whole` and the rest of `part`.
fn mixed(mix: f64, part: impl FnOnce() -> f64, whole: impl FnOnce() -> f64) -> f64 {
    match mix {
        0.0 => part(),
        1.0 => whole(),
        mix => (1.0 - mix) * part() + mix * whole(),
    }
}
