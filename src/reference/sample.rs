//! Values between grid points: trilinear interpolation of face velocities and of the distance to the obstacles.

use glam::DVec3;

use crate::grid::{Axis, Grid};

/// The eight grid points around a position in an array of extents `n`: index of the lowest, how far to go to the upper
/// neighbour along each axis (0 where the array is one point thick), and the position between them (0 to 1).
///
/// `at` is the continuous index; it is clamped to the range of the array.
struct Corner {
    low: usize,
    up: [usize; 3],
    f: [f64; 3],
}

impl Corner {
    fn new(n: [usize; 3], at: DVec3) -> Corner {
        let stride = [1, n[0], n[0] * n[1]];
        let mut corner = Corner {
            low: 0,
            up: [0; 3],
            f: [0.0; 3],
        };
        for b in 0..3 {
            let index = at[b].clamp(0.0, (n[b] - 1) as f64);
            // The upper end belongs to the last interval.
            let low = (index as usize).min(n[b].saturating_sub(2));
            corner.low += stride[b] * low;
            corner.up[b] = if n[b] > 1 { stride[b] } else { 0 };
            corner.f[b] = index - low as f64;
        }
        corner
    }

    /// Values at the eight points, x fastest, then y, then z.
    fn values(&self, field: &[f64]) -> [f64; 8] {
        std::array::from_fn(|c| {
            let offset: usize = (0..3)
                .map(|b| if c >> b & 1 == 1 { self.up[b] } else { 0 })
                .sum();
            field[self.low + offset]
        })
    }

    fn interpolate(&self, field: &[f64]) -> f64 {
        trilinear(&self.values(field), self.f)
    }

    /// The eight (index, weight) pairs.
    fn weights(&self) -> [(usize, f64); 8] {
        std::array::from_fn(|c| {
            let mut point = (self.low, 1.0);
            for b in 0..3 {
                let upper = c >> b & 1 == 1;
                point.0 += if upper { self.up[b] } else { 0 };
                point.1 *= if upper { self.f[b] } else { 1.0 - self.f[b] };
            }
            point
        })
    }
}

/// Between eight values, x fastest, then y, then z.
fn trilinear(v: &[f64; 8], [fx, fy, fz]: [f64; 3]) -> f64 {
    let along_x = [0, 2, 4, 6].map(|c| mix(v[c], v[c + 1], fx));
    mix(
        mix(along_x[0], along_x[1], fy),
        mix(along_x[2], along_x[3], fy),
        fz,
    )
}

fn mix(low: f64, high: f64, f: f64) -> f64 {
    low + (high - low) * f
}

/// Trilinear sample of the faces normal to `axis` at x (m), clamped to the range of these faces; m/s.
pub fn sample(grid: &Grid, axis: Axis, field: &[f64], x: DVec3) -> f64 {
    let mut at = x / grid.dx - 0.5;
    at[axis.index()] += 0.5;
    Corner::new(grid.faces(axis), at).interpolate(field)
}

/// Velocity at x (m): the three samples, m/s.
pub fn velocity(grid: &Grid, faces: &[Vec<f64>; 3], x: DVec3) -> DVec3 {
    DVec3::from(Axis::ALL.map(|axis| sample(grid, axis, &faces[axis.index()], x)))
}

/// Trilinear sample of a cell-centred field at x (m), clamped to the range of the centres.
pub fn distance(grid: &Grid, cells: &[f64], x: DVec3) -> f64 {
    Corner::new(grid.cells, x / grid.dx - 0.5).interpolate(cells)
}

/// Exact gradient of the trilinear interpolant of a cell-centred field at x (m), per metre. Beyond the outermost centres it
/// is the gradient at the nearest point between centres; across a grid one cell thick it is 0.
pub fn gradient(grid: &Grid, cells: &[f64], x: DVec3) -> DVec3 {
    let corner = Corner::new(grid.cells, x / grid.dx - 0.5);
    let values = corner.values(cells);
    let slope = |b: usize| {
        let mut ends = [corner.f; 2];
        ends[0][b] = 0.0;
        ends[1][b] = 1.0;
        let [low, high] = ends.map(|f| trilinear(&values, f));
        (high - low) / grid.dx
    };
    DVec3::from([0, 1, 2].map(slope))
}

/// The unit gradient; `None` where it is shorter than 1e-6 and has no direction.
pub(super) fn normal(grid: &Grid, cells: &[f64], x: DVec3) -> Option<DVec3> {
    let gradient = gradient(grid, cells, x);
    let length = gradient.length();
    (length >= 1e-6).then(|| gradient / length)
}

/// The eight cell centres around x (m) and their trilinear weights.
pub(super) fn cell_weights(grid: &Grid, x: DVec3) -> [(usize, f64); 8] {
    Corner::new(grid.cells, x / grid.dx - 0.5).weights()
}
