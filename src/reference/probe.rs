//! `probe`: measurements of a state, for both backends.

use glam::DVec3;

use super::active_cells::theta;
use crate::grid::{Axis, Grid};
use crate::scene::{ProbeKind, Up};
use crate::state::State;

/// Value of a probe, one number or three for a velocity, in SI units.
///
/// - Height: last sign change, going up, of phi interpolated to the line along gravity's axis. The top of the domain
///   if phi is negative up to it, 0 without liquid.
/// - Pressure: trilinear between cell centres, 0 in air. Inactive cells of the liquid (inside obstacles) do not
///   count; beyond the outermost centres the nearest pressure.
/// - Velocity: trilinear between faces.
/// - Front: largest coordinate of the liquid along the axis, over active cells; 0 without liquid.
/// - Probes of solids and of forces on them: none here; see [`crate::elastic::Solids::probe`].
pub fn probe(grid: &Grid, state: &State, kind: &ProbeKind) -> Vec<f64> {
    match *kind {
        ProbeKind::Height { foot, up } => vec![height(grid, &state.liquid_distance, foot, up)],
        ProbeKind::Pressure { point } => vec![pressure(grid, state, point)],
        ProbeKind::Velocity { point } => {
            grid.velocity_at(&state.velocity, point).to_array().to_vec()
        }
        ProbeKind::Front { axis } => vec![front(grid, state, Axis::ALL[axis])],
        ProbeKind::Node { .. } | ProbeKind::Solid { .. } | ProbeKind::Force { .. } => Vec::new(),
    }
}

fn height(grid: &Grid, liquid_distance: &[f64], foot: DVec3, up: Up) -> f64 {
    let n = grid.cells[up.axis];
    // Rows count upwards.
    let phi = |row: usize| {
        let j = if up.falling { n - 1 - row } else { row };
        let mut centre = foot;
        centre[up.axis] = (j as f64 + 0.5) * grid.dx;
        grid.sample_cells(liquid_distance, centre)
    };
    match (0..n).rev().find(|&j| phi(j) < 0.0) {
        None => 0.0,
        Some(top) if top + 1 == n => n as f64 * grid.dx,
        Some(j) => (j as f64 + 0.5 + theta(phi(j), phi(j + 1), 0.0)) * grid.dx,
    }
}

fn pressure(grid: &Grid, state: &State, point: DVec3) -> f64 {
    let mut sum = 0.0;
    let mut weights = 0.0;
    for (cell, weight) in grid.centres_around(point).weights() {
        if state.active[cell] || state.liquid_distance[cell] >= 0.0 {
            sum += weight * state.pressure[cell];
            weights += weight;
        }
    }
    if weights > 0.0 { sum / weights } else { 0.0 }
}

fn front(grid: &Grid, state: &State, axis: Axis) -> f64 {
    let a = axis.index();
    let reach = |cell: usize| {
        let mut ijk = grid.cell_at(cell);
        let index = ijk[a] as f64;
        if ijk[a] + 1 == grid.cells[a] {
            return index + 1.0;
        }
        ijk[a] += 1;
        let phi = [
            state.liquid_distance[cell],
            state.liquid_distance[grid.cell(ijk)],
        ];
        // If the liquid continues, the next cell reaches further, or an obstacle ends it at the face.
        index
            + 0.5
            + if phi[1] >= 0.0 {
                theta(phi[0], phi[1], 0.0)
            } else {
                0.5
            }
    };
    (0..grid.n_cells())
        .filter(|&cell| state.active[cell])
        .map(reach)
        .fold(0.0, f64::max)
        * grid.dx
}
