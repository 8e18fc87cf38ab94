//! `surface_distance`: how far the surface is, for the markers below it.
//!
//! The liquid distance phi says in cells of air how far the spheres of the markers are. In cells of liquid it says no more than that:
//! it is - r at a marker and - dx wherever no empty cell is near. There the distance is made again from the air: around the centre
//! of a cell n of air, no liquid is within phi_n, so that of a cell c of liquid is
//!
//! ```text
//! d_c = max(- 2 dx, max_n (phi_n - |x_c - x_n|))    over the cells of air in the 5 x 5 x 5 around it
//! ```
//!
//! Cells whose centre is in an obstacle or a solid say nothing: far inside, phi takes them for air. Theirs is made again, too, so that
//! no surface is seen where liquid ends at a wall.

use glam::IVec3;
use rayon::prelude::*;

use crate::grid::Grid;

/// How deep it is known, in cells.
const REACH: i32 = 2;

/// Signed distance to the surface at cell centres, m, negative in the liquid, where it is at least -2 dx; in air that of
/// `liquid_distance` (m). `solid_distance`: to obstacles and solids, m.
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
        let offsets = around()
            .flat_map(|z| around().flat_map(move |y| around().map(move |x| IVec3::new(x, y, z))));
        let told = offsets.filter_map(|offset| {
            let there = inside(here + offset)
                .then(|| grid.cell((here + offset).to_array().map(|n| n as usize)))
                .filter(|&there| air(there))?;
            Some(liquid_distance[there] - grid.dx * offset.as_dvec3().length())
        });
        told.fold(-f64::from(REACH) * grid.dx, f64::max)
    });
    distances.collect()
}
