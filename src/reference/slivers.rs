//! Slivers: faces that are less than a fifth open, and what they show of their velocity u to what is made from it. The rest is that of
//! the 26 neighbours of the same axis:
//!
//! ```text
//! u + (1 - a / 0.2) t (m - u),    m = sum_n w_n u_n / W,    W = sum_n w_n
//! ```
//!
//! a the open fraction. To air and closed faces the valid neighbours weigh by their fraction, w = a, and t = 1. To whole faces whole
//! ones weigh by what they are more open, w = max(a - 0.2, 0), and t = min(W / 0.2, 1): nothing hangs on the last bit of a fraction.
//!
//! A body that comes near another, or a wall, drives what is between them out through faces of almost no area, at any speed. Given to
//! whole faces, that is momentum out of nothing, whether `extrapolate` gives it to air and closed faces (2,000 sub-steps of a block in a tank,
//! `bench stability`, density_0.1 and young_1e7, reached 2.1 and 5.6 times the energy of the start) or `advect_velocity` to open
//! ones (inside_both: speeds doubled from sub-step to sub-step, up to 2,000 m/s). They keep it for themselves, since films that are squeezed
//! resist with it.

use rayon::prelude::*;

use crate::grid::{Axis, Grid};

/// Open fraction below which a face is one.
const SLIVER: f64 = 0.2;

/// Whether a face with an open fraction is one.
pub fn is_sliver(open: f64) -> bool {
    0.0 < open && open < SLIVER
}

/// Which part of what a face carries is made from what faces show to whole ones, the rest being made from the velocities as they are: 0 up to
/// a tenth open, 1 from a fifth on, and where it is closed.
pub(super) fn wholeness(open: f64) -> f64 {
    match is_sliver(open) {
        true => (2.0 / SLIVER * open - 1.0).max(0.0),
        false => 1.0,
    }
}

/// What faces show to whole ones that carry their velocities, m/s. Fractions of the faces are `open`.
pub fn shown_to_whole(grid: &Grid, open: &[Vec<f64>; 3], faces: &[Vec<f64>; 3]) -> [Vec<f64>; 3] {
    Axis::ALL.map(|axis| {
        let (open, faces) = (&open[axis.index()], &faces[axis.index()]);
        let weight = |face: usize| (open[face] - SLIVER).max(0.0);
        let trust = |sum: f64| (sum / SLIVER).min(1.0);
        let shown = (0..faces.len())
            .into_par_iter()
            .map(|face| match is_sliver(open[face]) {
                true => blended(grid, axis, open, faces, face, weight, trust),
                false => faces[face],
            });
        shown.collect()
    })
}

/// The slivers among the `valid` faces of an axis, and what they show to what is extrapolated from them, m/s.
pub(super) fn shown_to_air(
    grid: &Grid,
    axis: Axis,
    open: &[f64],
    valid: &[bool],
    faces: &[f64],
) -> Vec<(usize, f64)> {
    let slivers = (0..faces.len()).into_par_iter();
    let slivers = slivers.filter(|&face| valid[face] && is_sliver(open[face]));
    let weight = |face: usize| if valid[face] { open[face] } else { 0.0 };
    let shows = |face| blended(grid, axis, open, faces, face, weight, |_| 1.0);
    slivers.map(|face| (face, shows(face))).collect()
}

/// What a sliver shows, m/s, given w of a face, and t of W; its own velocity where no neighbour weighs.
fn blended(
    grid: &Grid,
    axis: Axis,
    open: &[f64],
    faces: &[f64],
    face: usize,
    weight: impl Fn(usize) -> f64,
    trust: impl Fn(f64) -> f64,
) -> f64 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for neighbour in around(grid, axis, face) {
        sum += weight(neighbour) * faces[neighbour];
        weights += weight(neighbour);
    }
    let own = faces[face];
    let mean = if weights > 0.0 { sum / weights } else { own };
    own + (1.0 - open[face] / SLIVER) * trust(weights) * (mean - own)
}

/// The neighbours of a face among those of its axis, across sides, edges and corners.
fn around(grid: &Grid, axis: Axis, face: usize) -> impl Iterator<Item = usize> + use<'_> {
    let n = grid.faces(axis);
    let ranges: [_; 3] = std::array::from_fn(|b| {
        let index = grid.face_at(axis, face)[b];
        index.saturating_sub(1)..(index + 2).min(n[b])
    });
    let [is, js, ks] = ranges;
    let rows = ks.flat_map(move |k| js.clone().map(move |j| (j, k)));
    let all = rows.flat_map(move |(j, k)| is.clone().map(move |i| grid.face(axis, [i, j, k])));
    all.filter(move |&neighbour| neighbour != face)
}

/// Lays the velocities of the slivers aside for what they show; once more, and they have them again.
pub(super) fn swap(slivers: &mut [(usize, f64)], values: &mut [f64]) {
    for (face, value) in slivers {
        std::mem::swap(value, &mut values[*face]);
    }
}
