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
/// - Front: largest coordinate of the liquid along the axis, over active cells; 0 without liquid. Or the smallest; the
///   domain's length without liquid.
/// - Flux: sum over the faces in the rectangle of velocity, overlap, aperture (`open`), and wet part. The wet part of a
///   face is 1/2 - phi / dx, between 0 and 1, with phi the mean of the two cells beside it: exact for a surface along or
///   across the face. Between two planes of faces it is linear.
/// - Probes of solids and of forces on them: none here; see [`crate::elastic::Solids::probe`].
pub fn probe(grid: &Grid, open: &[Vec<f64>; 3], state: &State, kind: &ProbeKind) -> Vec<f64> {
    match *kind {
        ProbeKind::Height { foot, up } => vec![height(grid, &state.liquid_distance, foot, up)],
        ProbeKind::Pressure { point } => vec![pressure(grid, state, point)],
        ProbeKind::Velocity { point } => grid.velocity_at(&state.velocity, point).to_array().to_vec(),
        ProbeKind::Front { axis, lower } => vec![front(grid, state, Axis::ALL[axis], lower)],
        ProbeKind::Flux { axis, min, max } => {
            vec![flux(grid, open, state, Axis::ALL[axis], [min, max])]
        }
        ProbeKind::Node { .. }
        | ProbeKind::Solid { .. }
        | ProbeKind::SolidVelocity { .. }
        | ProbeKind::Force { .. }
        | ProbeKind::Reaction { .. } => Vec::new(),
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

fn front(grid: &Grid, state: &State, axis: Axis, lower: bool) -> f64 {
    let (a, sign) = (axis.index(), if lower { -1.0 } else { 1.0 });
    let reach = |cell: usize| {
        let mut ijk = grid.cell_at(cell);
        let centre = ijk[a] as f64 + 0.5;
        let side = usize::from(!lower);
        let next = [ijk[a].checked_sub(1), Some(ijk[a] + 1)][side];
        let Some(next) = next.filter(|&next| next < grid.cells[a]) else {
            return centre + 0.5 * sign;
        };
        ijk[a] = next;
        let phi = [state.liquid_distance[cell], state.liquid_distance[grid.cell(ijk)]];
        // If the liquid continues, the next cell reaches further, or an obstacle ends it at the face.
        centre + sign * if phi[1] >= 0.0 { theta(phi[0], phi[1], 0.0) } else { 0.5 }
    };
    let reaches = (0..grid.n_cells()).filter(|&cell| state.active[cell]);
    let reaches = reaches.map(reach);
    grid.dx
        * match lower {
            false => reaches.fold(0.0, f64::max),
            true => reaches.fold(grid.cells[a] as f64, f64::min),
        }
}

fn flux(grid: &Grid, open: &[Vec<f64>; 3], state: &State, axis: Axis, corners: [DVec3; 2]) -> f64 {
    let a = axis.index();
    let [low, high] = corners.map(|corner| corner / grid.dx);
    // Length of a cell's overlap with the rectangle along the other axes, cells.
    let overlap = |b: usize, index: usize| {
        let index = index as f64;
        (high[b].min(index + 1.0) - low[b].max(index)).max(0.0)
    };
    let through = |plane: usize| -> f64 {
        let [b, c] = [(a + 1) % 3, (a + 2) % 3];
        let mut sum = 0.0;
        for k in 0..grid.cells[c] {
            for j in 0..grid.cells[b] {
                let share = overlap(b, j) * overlap(c, k);
                if share == 0.0 {
                    continue;
                }
                let mut ijk = [plane; 3];
                (ijk[b], ijk[c]) = (j, k);
                let sides = grid.face_sides(axis, ijk);
                let distances = sides.into_iter().flatten();
                let distances: Vec<f64> = distances.map(|cell| state.liquid_distance[cell]).collect();
                let phi = distances.iter().sum::<f64>() / distances.len() as f64;
                let wet = (0.5 - phi / grid.dx).clamp(0.0, 1.0);
                let face = grid.face(axis, ijk);
                sum += state.velocity[a][face] * open[a][face] * wet * share;
            }
        }
        sum
    };
    let at = low[a];
    let below = (at.floor() as usize).min(grid.cells[a] - 1);
    let part = at - below as f64;
    ((1.0 - part) * through(below) + part * through(below + 1)) * grid.dx * grid.dx
}
