//! How far f32 may be off the equations: bounds that comparisons on scenes and tests share.

use crate::grid::{Axis, Grid};
use crate::reference;

/// Largest relative error of a rounding to f32.
pub(super) const EPS: f64 = 1.0 / (1 << 24) as f64;

/// What roundings do to a trace by the midpoint rule.
#[derive(Clone, Copy, Debug)]
pub struct TraceError {
    /// How far off its end may be, cells.
    pub cells: f64,
    /// How far off a velocity sample there may be, m/s.
    pub speed: f64,
}

/// The error of traces through face velocities (m/s) for dt (s). A position in cells is rounded up to 4 times (product with 1/dx,
/// which is rounded itself, sum, shift to the faces), and so is a way in cells. A trilinear sample is rounded 10 times and
/// moves with its position by the largest difference between neighbouring faces per cell and axis.
pub fn trace_error(grid: &Grid, velocity: &[Vec<f64>; 3], dt: f64) -> TraceError {
    let extent = grid.cells.into_iter().max().unwrap_or(1) as f64;
    let speed = reference::max_speed(velocity);
    let slope = steepest(grid, velocity);
    let cells_per_speed = dt / grid.dx;
    let position = EPS * 4.0 * (extent + speed * cells_per_speed);
    let sample = |position: f64| EPS * 10.0 * speed + 3.0 * slope * position;
    let middle = position + 0.5 * cells_per_speed * sample(position);
    let cells = position + cells_per_speed * sample(middle);
    TraceError {
        cells,
        speed: sample(cells),
    }
}

/// Largest difference between neighbouring faces of an axis, m/s.
fn steepest(grid: &Grid, velocity: &[Vec<f64>; 3]) -> f64 {
    let mut steepest: f64 = 0.0;
    for axis in Axis::ALL {
        let (n, values) = (grid.faces(axis), &velocity[axis.index()]);
        let strides = [1, n[0], n[0] * n[1]];
        for (face, &value) in values.iter().enumerate() {
            let ijk = grid.face_at(axis, face);
            for b in (0..3).filter(|&b| ijk[b] + 1 < n[b]) {
                steepest = steepest.max((values[face + strides[b]] - value).abs());
            }
        }
    }
    steepest
}
