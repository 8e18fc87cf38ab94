//! `volume_shift`: moves the level of each liquid component towards its target volume.
//!
//! ```text
//! h_k = clamp(dV_k min(1, dt / t_f) / A_k, -h / 4, h),   h = min(0.16 max(1, C^2 / 9), 2),
//! A_k = sum of open fractions times clamp(1 - |phi|, 0, 1)
//! phi -= h_k
//! ```
//!
//! in cells and cell volumes. C is the Courant number of the surface: the errors of its transport are of second order. dV_k is the
//! target less the volume, less a dead band of 0.5 % of the target. The measured volume of a wave changes by that much at constant
//! true volume, and a shift by it would amplify the wave. Enclosed components have no surface to move.

use rayon::prelude::*;

use super::liquid_components::Components;
use crate::grid::Grid;

/// Part of the target within which nothing moves.
pub(super) const DEAD_BAND: f64 = 0.005;
/// Largest shift outwards in a sub-step, cells.
const LARGEST: f64 = 0.16;
/// Bound of the same in sub-steps of any length, cells: air further from liquid does not move.
const MOST: f64 = 2.0;
/// Largest shift inwards over that outwards. Twice that erases films thinner than a cell.
const INWARDS: f64 = 0.25;
/// Least A_k, cells: a smaller surface is rounding.
const LEAST_AREA: f64 = 1e-6;
/// Courant number above which the largest shift grows with its square.
const LONG: f64 = 3.0;

/// Largest shift outwards in a sub-step with the [Courant number](super::TimeStep::courant) of the surface, cells.
pub fn largest_shift(courant: f64) -> f64 {
    (LARGEST * (courant / LONG).powi(2).max(1.0)).min(MOST)
}

/// Shifts the liquid distance (m). `volume_0`: targets, m^3; `control_time` and `dt` in s; `largest` from [`largest_shift`]. Returns the shifts, cells.
pub fn volume_shift(
    grid: &Grid,
    open_volumes: &[f64],
    components: &Components,
    volume_0: &[f64],
    ([control_time, dt], largest): ([f64; 2], f64),
    liquid_distance: &mut [f64],
) -> Vec<f64> {
    let mut area = vec![0.0; volume_0.len()];
    for (cell, &label) in components.label.iter().enumerate() {
        if label > 0 {
            let near = (1.0 - (liquid_distance[cell] / grid.dx).abs()).clamp(0.0, 1.0);
            area[label as usize - 1] += open_volumes[cell] * near;
        }
    }
    let shift = |k: usize| {
        let lacks = volume_0[k] - components.volume[k];
        let dead = DEAD_BAND * volume_0[k].abs();
        let lacks = lacks.signum() * (lacks.abs() - dead).max(0.0);
        match components.enclosed[k] || area[k] <= LEAST_AREA * grid.cell_volume() {
            true => 0.0,
            false => (lacks * (dt / control_time).min(1.0) / area[k]).clamp(-INWARDS * largest, largest),
        }
    };
    let shifts: Vec<f64> = (0..volume_0.len()).map(shift).collect();
    let cells = liquid_distance.par_iter_mut().zip(&components.label);
    cells.filter(|(_, label)| **label > 0).for_each(|(phi, &label)| *phi -= grid.dx * shifts[label as usize - 1]);
    shifts
}
