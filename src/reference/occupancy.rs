//! `occupancy`: fraction of each cell's surroundings that markers fill.
//!
//! ```text
//! F_c = sum_p w((x_p - x_c) / dx) / (8 T_c)    w(d) = prod_a max(0, 1 - |d_a|)
//! T_c = integral of w over the open volume
//! ```
//!
//! over the markers that are no spray, 8 a cell. Weights beyond a wall of the domain count for the cell at the wall.
//! The weights are added as integers, round(2^20 w), so that their order has no effect. T is 1 away from bodies, and
//! the sum over eighths of cells beside them, each with the open fraction at its centre. F is unknown where T < 0.2.
//! Markers fill a band below the surface only: deeper cells count as full.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use rayon::prelude::*;

use super::level_cells::BAND;
use crate::grid::Grid;

/// Fixed point of the weights.
const ONE: f64 = (1 << 20) as f64;
/// Markers of a full cell.
pub(super) const PER_CELL: f64 = 8.0;
/// Least open part of the surroundings of a cell with a known occupancy.
const LEAST_OPEN: f64 = 0.2;
/// Depth below which cells count as full, cells: less than that of the band by the reach of the weights.
const FULL_BELOW: f64 = BAND - 1.5;
/// Occupancy of cells where it is unknown.
pub const UNKNOWN: f64 = -1.0;

/// F per cell, at least 0, or [`UNKNOWN`]. `markers` in m; `level` after its transport, cells; `solid_distance` in m.
pub fn occupancy(grid: &Grid, solid_distance: &[f64], level: &[f64], markers: &[[f64; 3]], spray: &[bool]) -> Vec<f64> {
    let weights = marker_weights(grid, markers, spray);
    let cells = (0..grid.n_cells()).into_par_iter();
    let fraction = cells.map(|cell| {
        let open = open_surroundings(grid, solid_distance, cell);
        let known = open >= LEAST_OPEN;
        let fraction = match known {
            true => weights[cell] as f64 / (ONE * PER_CELL * open),
            false => UNKNOWN,
        };
        match level[cell] < -FULL_BELOW {
            true => fraction.max(1.0),
            false => fraction,
        }
    });
    fraction.collect()
}

/// Sum of the tent weights of the markers per cell, in units of 2^-20.
pub fn marker_weights(grid: &Grid, markers: &[[f64; 3]], spray: &[bool]) -> Vec<u64> {
    let sums: Vec<AtomicU64> = (0..grid.n_cells()).map(|_| AtomicU64::new(0)).collect();
    markers.par_iter().zip(spray).filter(|(_, spray)| !**spray).for_each(|(&x, _)| {
        for (cell, weight) in tent(grid, x.into()) {
            sums[cell].fetch_add((ONE * weight).round() as u64, Ordering::Relaxed);
        }
    });
    sums.into_iter().map(AtomicU64::into_inner).collect()
}

/// The cells around a point (m) with their tent weights. Cells beyond a wall are those at the wall.
pub(super) fn tent(grid: &Grid, x: DVec3) -> [(usize, f64); 8] {
    let at = x / grid.dx - 0.5;
    let low = at.floor();
    let upper = at - low;
    std::array::from_fn(|corner| {
        let mut weight = 1.0;
        let ijk = std::array::from_fn(|b| {
            let up = (corner >> b & 1) as f64;
            weight *= if up > 0.0 { upper[b] } else { 1.0 - upper[b] };
            (low[b] + up).clamp(0.0, (grid.cells[b] - 1) as f64) as usize
        });
        (grid.cell(ijk), weight)
    })
}

/// T: the open part of the tent around a cell.
fn open_surroundings(grid: &Grid, solid_distance: &[f64], cell: usize) -> f64 {
    // A body farther than the corners of the tent closes none of it.
    let far = 2.0 * grid.dx;
    if solid_distance[cell] >= far {
        return 1.0;
    }
    if solid_distance[cell] <= -far {
        return 0.0;
    }
    let centre = grid.cell_centre(grid.cell_at(cell));
    let integral = |eighth: usize| match eighth {
        1 | 2 => 0.375,
        _ => 0.125,
    };
    let eighths = (0..64).map(|number| [number % 4, number / 4 % 4, number / 16]);
    let open = eighths.map(|eighth| {
        let offset = DVec3::from(eighth.map(|e| 0.5 * e as f64 - 0.75));
        let distance = grid.sample_cells(solid_distance, centre + grid.dx * offset);
        let open = (0.5 + 2.0 * distance / grid.dx).clamp(0.0, 1.0);
        open * eighth.map(integral).iter().product::<f64>()
    });
    open.sum()
}
