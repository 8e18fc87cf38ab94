//! `surface_distance`: signed distance to the surface, for the markers below it.
//!
//! The liquid distance phi measures the distance to the markers' spheres in air only. In liquid it is - r at a marker
//! and - dx far from empty cells. So the distance in liquid is recomputed from the air. No liquid is within phi_n of
//! the centre of an air cell n, hence for a liquid cell c
//!
//! ```text
//! d_c = max(- 2 dx, max_n (phi_n - |x_c - x_n|))    over the cells of air in the 5 x 5 x 5 around it
//! ```
//!
//! Cells with their centre in an obstacle or solid are excluded as sources, since phi far inside is that of air.
//! Their distance is recomputed too, so that liquid has no surface at a wall.

use glam::IVec3;
use rayon::prelude::*;

use crate::grid::Grid;

/// Largest known depth, cells.
const REACH: i32 = 2;

/// Signed distance to the surface at cell centres, m: negative in the liquid, at least -2 dx; `liquid_distance` (m)
/// in air. `solid_distance` to obstacles and solids, m.
pub fn surface_distance(grid: &Grid, solid_distance: &[f64], liquid_distance: &[f64]) -> Vec<f64> {
    let n = IVec3::from(grid.cells.map(|n| n as i32));
    let inside = |ijk: IVec3| ijk.cmpge(IVec3::ZERO).all() && ijk.cmplt(n).all();
    let around = || -REACH..=REACH;
    let air = |cell: usize| liquid_distance[cell] > 0.0 && solid_distance[cell] >= 0.0;
    let cells = (0..grid.n_cells()).into_par_iter();
    let distances = cells.map(|cell| {
        if air(cell) {
            return liquid_distance[cell];
        }
        let here = IVec3::from(grid.cell_at(cell).map(|n| n as i32));
        let offsets = around().flat_map(|z| around().flat_map(move |y| around().map(move |x| IVec3::new(x, y, z))));
        let recomputed = offsets.filter_map(|offset| {
            let there = inside(here + offset)
                .then(|| grid.cell((here + offset).to_array().map(|n| n as usize)))
                .filter(|&there| air(there))?;
            Some(liquid_distance[there] - grid.dx * offset.as_dvec3().length())
        });
        recomputed.fold(-f64::from(REACH) * grid.dx, f64::max)
    });
    distances.collect()
}
