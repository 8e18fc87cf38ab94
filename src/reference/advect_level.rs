//! `advect_level`: transport of the level set by MacCormack's method (Selle et al. 2008), semi-Lagrangian with the
//! midpoint rule in both passes.
//!
//! ```text
//! a(x) = phi(x - dt u)                            linear interpolation at the departure point
//! phi*(x) = a(x) + (phi(x) - a(x + dt u)) / 2     within the range of the taps of a(x), widened by 0.1 cells; else a(x)
//! ```
//!
//! The second pass returns the advected level to its start. Half the difference is the error of a. The method is of second
//! order, and a plane that moves uniformly stays exact. The widened range preserves the height of crests.
//!
//! Liquid does not enter through open sides. The level beyond them is at least the distance to the side. Sources and sinks
//! then set the level in their cells ([`fill_sources`](super::fill_sources), [`empty_level_sinks`](super::empty_level_sinks)).

use glam::DVec3;
use rayon::prelude::*;

use super::ballistic::Ballistic;
use crate::grid::{Axis, Grid, Sides};

/// Overshoot beyond the taps, cells.
const OVERSHOOT: f64 = 0.1;

/// The level (cells) after dt (s) in the velocity of the faces (m/s), with what falls freely.
pub fn advect_level(
    grid: &Grid,
    open_sides: Sides,
    faces: &[Vec<f64>; 3],
    ballistic: &Ballistic,
    level: &[f64],
    dt: f64,
) -> Vec<f64> {
    let centre = |cell: usize| grid.cell_centre(grid.cell_at(cell));
    let carried = carry_level(grid, open_sides, faces, ballistic, level, dt);
    let correct = |cell: usize| {
        let x = centre(cell);
        let origin = ballistic.origin_about(grid, grid.traced(faces, x, -dt));
        let end = grid.traced(faces, x, dt) + ballistic.shift_about(grid, x);
        let returned = grid.sample_cells(&carried, end);
        let corrected = carried[cell] + 0.5 * (level[cell] - returned);
        let taps = grid.centres_around(origin).values(level);
        let low = taps.into_iter().fold(f64::INFINITY, f64::min);
        let high = taps.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let within = low - OVERSHOOT <= corrected && corrected <= high + OVERSHOOT;
        match within && beyond_side(grid, open_sides, origin) < 0.0 {
            true => corrected,
            false => carried[cell],
        }
    };
    let cells = (0..grid.n_cells()).into_par_iter();
    cells.map(correct).collect()
}

/// The first order of the transport: a, cells.
pub fn carry_level(
    grid: &Grid,
    open_sides: Sides,
    faces: &[Vec<f64>; 3],
    ballistic: &Ballistic,
    level: &[f64],
    dt: f64,
) -> Vec<f64> {
    let carry = |cell: usize| {
        let x = grid.cell_centre(grid.cell_at(cell));
        let x = ballistic.origin_about(grid, grid.traced(faces, x, -dt));
        grid.sample_cells(level, x).max(beyond_side(grid, open_sides, x))
    };
    (0..grid.n_cells()).into_par_iter().map(carry).collect()
}

/// Distance of a point (m) beyond an open side, cells; minus infinity within the domain.
fn beyond_side(grid: &Grid, open_sides: Sides, x: DVec3) -> f64 {
    let beyond = |axis: Axis| {
        let (at, size) = (x[axis.index()], grid.size()[axis.index()]);
        let sides = [(0, -at), (1, at - size)];
        sides
            .into_iter()
            .filter(move |&(side, beyond)| beyond > 0.0 && open_sides.has(axis, side))
            .map(|(_, beyond)| beyond / grid.dx)
    };
    let all = Axis::ALL.into_iter().flat_map(beyond);
    all.fold(f64::NEG_INFINITY, f64::max)
}
