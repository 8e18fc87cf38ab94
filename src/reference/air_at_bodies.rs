//! Part of `advect_level` with separation: air beside bodies at rest.
//!
//! Liquid that leaves a body has a velocity away from it, also at closed faces. Traced back with that velocity, air below a bar would get the
//! level of the liquid above it. The path of such air therefore ends where it enters the body. With x the centre of a cell of air, o its
//! departure point, and s the distance from bodies, in cells,
//!
//! ```text
//! bound = phi(x + t (o - x)),   s(x + t (o - x)) = 0,   if phi is not negative there
//! ```
//!
//! The root t is that of a linear interpolant between samples of s at quarters of the path: less than a cell apart at the default `cfl`.
//!
//! A body that moves carries its films along, and their paths enter it too. Scenes with such bodies have no bounds of this kind.

use rayon::prelude::*;

use super::level_cells::LevelCells;

/// Distance from bodies from which no path enters them, cells: distances are known up to 3 cells.
const PATH_REACH: f64 = 2.99;
/// Samples of a path.
const SAMPLES: u32 = 4;

/// Raises bounds of the level (cells), as of [`separation_bounds`](super::separation_bounds), in cells of air whose path back in dt (s) in the
/// velocity of the faces (m/s) enters a body.
pub fn air_at_bodies(cells: LevelCells, faces: &[Vec<f64>; 3], level: &[f64], dt: f64, bounds: &mut [f64]) {
    bounds.par_iter_mut().enumerate().for_each(|(cell, bound)| {
        if let Some(phi) = level_at_body(cells, faces, level, cell, dt) {
            *bound = bound.max(phi);
        }
    });
}

/// The level where the path of a cell of air enters a body, if that is air.
fn level_at_body(cells: LevelCells, faces: &[Vec<f64>; 3], level: &[f64], cell: usize, dt: f64) -> Option<f64> {
    let LevelCells { grid, cut } = cells;
    let distance = cut.solid_distance[cell] / grid.dx;
    if level[cell] < 0.0 || !(0.0..PATH_REACH).contains(&distance) {
        return None;
    }
    let x = grid.cell_centre(grid.cell_at(cell));
    let way = grid.traced(faces, x, -dt) - x;
    let part = |n: u32| f64::from(n) / f64::from(SAMPLES);
    let sample = |n: u32| grid.sample_cells(&cut.solid_distance, x + part(n) * way) / grid.dx;
    let first = (1..=SAMPLES).find(|&n| sample(n) < 0.0)?;
    let [outside, inside] = [if first == 1 { distance } else { sample(first - 1) }, sample(first)];
    let t = part(first - 1) + outside / (outside - inside) / f64::from(SAMPLES);
    Some(grid.sample_cells(level, x + t * way)).filter(|&phi| phi >= 0.0)
}
