//! `filter_level`: damps ripples of two to four cells along the surface.
//!
//! ```text
//! phi -= m clamp((1/64) sum_a (1 - n_a^2) delta_a^4 phi, +-0.05)    n = grad phi / |grad phi|
//! ```
//!
//! where |phi| < 1.5 and the liquid is thick. The weights 1 - n_a^2 restrict the filter to directions along the surface:
//! across it, the filter would amplify or damp long waves by 4 % a period. A wave of 20 cells loses 0.1 % in 100 sub-steps.
//! m is the motion in the sub-step ([`TimeStep::motion`](super::TimeStep::motion)). Without it short sub-steps would smooth
//! a jet more.

use rayon::prelude::*;

use super::level_cells::LevelCells;
use crate::grid::Axis;

/// Distance from the surface up to which the filter acts, cells.
const WIDTH: f64 = 1.5;
/// Level up to which a stencil is valid, cells.
const VALID: f64 = 3.5;
/// Squared gradient below which there is no direction.
const LEAST_GRADIENT_SQUARED: f64 = 0.25;
/// Weight below which an axis counts as normal to the surface.
const LEAST_WEIGHT: f64 = 0.02;
const STRENGTH: f64 = 1.0 / 64.0;
/// Largest change, cells.
const LARGEST: f64 = 0.05;

/// The filtered level, cells. `thin` from [`super::thin_liquid`]; `motion`: m.
pub fn filter_level(cells: LevelCells, thin: &[bool], motion: f64, level: &[f64]) -> Vec<f64> {
    let filter = |cell: usize| {
        let skip = level[cell].abs() > WIDTH || thin[cell] || !cells.is_open(cell);
        let change = (!skip).then(|| change(cells, level, cell)).flatten();
        level[cell] - motion * change.map_or(0.0, |change| change.clamp(-LARGEST, LARGEST))
    };
    (0..level.len()).into_par_iter().map(filter).collect()
}

/// The change at a cell, cells; `None` where the stencil leaves the valid level or the gradient has no direction.
fn change(cells: LevelCells, level: &[f64], cell: usize) -> Option<f64> {
    let slopes = Axis::ALL.map(|axis| {
        let [minus, plus] = cells.beside(cell, axis);
        0.5 * (level[plus] - level[minus])
    });
    let squared: f64 = slopes.iter().map(|slope| slope * slope).sum();
    if squared < LEAST_GRADIENT_SQUARED {
        return None;
    }
    let mut sum = 0.0;
    for axis in Axis::ALL {
        let weight = 1.0 - slopes[axis.index()].powi(2) / squared;
        if weight < LEAST_WEIGHT {
            continue;
        }
        let near = cells.beside(cell, axis).map(|other| level[other]);
        let far = cells.beyond(cell, axis).map(|other| level[other]);
        if near.iter().chain(&far).any(|phi| phi.abs() > VALID) {
            return None;
        }
        sum += weight * (6.0 * level[cell] - 4.0 * (near[0] + near[1]) + far[0] + far[1]);
    }
    Some(STRENGTH * sum)
}
