//! Gradient and normal of the distance to the obstacles, between cell centres.

use glam::DVec3;

use crate::grid::{Corner, Grid};

/// Exact gradient of the trilinear interpolant of a cell-centred field at x (m), per metre. Beyond the outermost
/// centres it is evaluated at the nearest point between centres; across a grid one cell thick it is 0.
pub fn gradient(grid: &Grid, cells: &[f64], x: DVec3) -> DVec3 {
    let corner = grid.centres_around(x);
    let values = corner.values(cells);
    let slope = |b: usize| {
        let mut ends = [corner.between; 2];
        ends[0][b] = 0.0;
        ends[1][b] = 1.0;
        let [low, high] = ends.map(|between| Corner::mix(&values, between));
        (high - low) / grid.dx
    };
    DVec3::from([0, 1, 2].map(slope))
}

/// Unit gradient; `None` if the gradient is shorter than 1e-6.
pub(super) fn normal(grid: &Grid, cells: &[f64], x: DVec3) -> Option<DVec3> {
    let gradient = gradient(grid, cells, x);
    let length = gradient.length();
    (length >= 1e-6).then(|| gradient / length)
}
