//! `right_hand_side`: (E u*)_c = - sum over faces of s_f A_f u*_f (thesis 4.38), where E is the negative divergence. It
//! has volume control, and mean 0 over enclosed components.

use super::active_cells::ActiveCells;
use super::pressure_system::remove_means;
use crate::grid::{Axis, Grid};
use crate::linalg::norm;

/// Control times over which volume control spreads the correction. Spray fills up to 40 % more volume as a union of
/// spheres, faster than a slow control corrects. A dam break of 64x32x32 cells reached 1.15 of its volume with 4 of them
/// and at most 1 % in each, 1.012 with half of one.
const CONTROL_TIMES: f64 = 0.5;
/// Smallest number of sub-steps over which the correction is spread; fewer would overshoot.
const STEPS: f64 = 1.5;
/// Largest relative change of volume per control time.
const LARGEST_CHANGE: f64 = 0.1;

/// The right-hand side and the scale of its rounding error.
#[derive(Clone, Debug)]
pub struct RightHandSide {
    /// E u* per cell, m^3/s; 0 in inactive cells.
    pub values: Vec<f64>,
    /// s_p = || |E| |u*| ||, m^3/s.
    pub scale: f64,
}

/// Source term of volume control.
#[derive(Clone, Copy, Debug)]
pub struct VolumeSource<'a> {
    /// Relative rate from [`volume_rate`], 1/s.
    pub rate: f64,
    /// Open volume per cell, m^3.
    pub open_volumes: &'a [f64],
}

/// Growth rate that restores `volume` to `volume_0` (m^3), 1/s. The deficit is spread over half a control time (s) or one
/// and a half sub-steps (of `dt` seconds), at most 10 % per control time; 0 without liquid.
pub fn volume_rate(volume_0: f64, volume: f64, control_time: f64, dt: f64) -> f64 {
    if volume <= 0.0 || volume_0 <= 0.0 {
        return 0.0;
    }
    ((volume_0 / volume - 1.0) / (CONTROL_TIMES * control_time).max(STEPS * dt))
        .clamp(-LARGEST_CHANGE / control_time, LARGEST_CHANGE / control_time)
}

/// Computes the right-hand side from u* (m/s, per face) and the apertures of all faces.
pub fn right_hand_side(
    grid: &Grid,
    open: &[Vec<f64>; 3],
    velocity: &[Vec<f64>; 3],
    active: &ActiveCells,
    source: Option<VolumeSource>,
) -> RightHandSide {
    let mut in_closed = vec![false; grid.n_cells()];
    let without_surface = active.closed.iter().chain(&active.sealed);
    without_surface.flatten().for_each(|&cell| in_closed[cell] = true);
    let mut values = vec![0.0; grid.n_cells()];
    let mut magnitudes = vec![0.0; grid.n_cells()];
    for cell in active.stencil.active_cells() {
        let (inflow, magnitude) = inflow(grid, open, velocity, cell);
        values[cell] = inflow;
        magnitudes[cell] = magnitude;
        if let Some(source) = source.filter(|_| !in_closed[cell]) {
            values[cell] += source.rate * source.open_volumes[cell];
        }
    }
    remove_means(&active.closed, &mut values);
    RightHandSide { values, scale: norm(&magnitudes) }
}

/// (E u)_c, and the sum of its absolute terms, m^3/s.
pub(super) fn inflow(grid: &Grid, open: &[Vec<f64>; 3], velocity: &[Vec<f64>; 3], cell: usize) -> (f64, f64) {
    let area = grid.dx * grid.dx;
    let ijk = grid.cell_at(cell);
    let mut inflow = 0.0;
    let mut magnitude = 0.0;
    for axis in Axis::ALL {
        let a = axis.index();
        let mut plus = ijk;
        plus[a] += 1;
        let [minus, plus] = [ijk, plus].map(|ijk| {
            let face = grid.face(axis, ijk);
            area * open[a][face] * velocity[a][face]
        });
        inflow += minus - plus;
        magnitude += minus.abs() + plus.abs();
    }
    (inflow, magnitude)
}
