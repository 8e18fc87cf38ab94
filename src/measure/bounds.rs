//! Error bounds of f32 kernels, shared by comparisons and tests.

use glam::DVec3;

use crate::grid::{Axis, Grid};
use crate::reference;

/// Largest relative error of a rounding to f32.
pub(super) const EPS: f64 = 1.0 / (1 << 24) as f64;

/// Error of samples, m/s, at the ends of traces by the midpoint rule over dt (s). The face velocities (m/s) have the error `given`. A position in
/// cells has up to 4 roundings (product with 1/dx, which is rounded itself, sum, shift to the faces), and so has a displacement. A trilinear
/// sample has 10 roundings, and changes per cell and axis by at most the largest difference between neighbouring faces.
fn trace_error(grid: &Grid, velocity: &[Vec<f64>; 3], given: f64, dt: f64) -> f64 {
    let [speed, slope] = [reference::max_speed(velocity), steepest(grid, velocity)];
    given + sample_error(speed, slope, end_error(grid, velocity, given, dt))
}

/// Error of the ends of these traces, cells.
fn end_error(grid: &Grid, velocity: &[Vec<f64>; 3], given: f64, dt: f64) -> f64 {
    let speed = reference::max_speed(velocity);
    let slope = steepest(grid, velocity);
    let sample = |position: f64| given + sample_error(speed, slope, position);
    let cells_per_speed = dt / grid.dx;
    let position = position_error(grid, speed * cells_per_speed);
    let middle = position + 0.5 * cells_per_speed * sample(position);
    position + cells_per_speed * sample(middle)
}

/// Error of face velocities (m/s) after advection over dt (s), with the apertures `open`. The blended neighbour velocity of small-aperture faces is a
/// quotient of two sums of up to 26 products with weights that are differences from 0.2, which f32 does not represent, and a share of it by such a
/// sum: less than 160 roundings of the largest velocity. Small-aperture faces may mix both values: 12 roundings. `given`: error of the velocities.
pub fn advection_error(grid: &Grid, open: &[Vec<f64>; 3], (velocity, given): (&[Vec<f64>; 3], f64), dt: f64) -> f64 {
    let rounding = EPS * reference::max_speed(velocity);
    let plain = trace_error(grid, velocity, given, dt);
    if !open.iter().flatten().any(|&open| reference::is_sliver(open)) {
        return plain;
    }
    let blended = reference::shown_to_whole(grid, open, velocity);
    trace_error(grid, &blended, given + 160.0 * rounding, dt).max(plain) + 12.0 * rounding
}

/// Error of face velocities (m/s) after MacCormack's method, where the limit decides alike. `carried`: after the first order, whose error
/// is that of [`advection_error`]. The correction has half the errors of the velocity and of a sample of `carried`, and three roundings of
/// values up to twice the speed. A relaxed limit has less: at most twice the error of the velocity. Limit and blend add 8 roundings of such
/// values.
pub fn maccormack_error(
    grid: &Grid,
    open: &[Vec<f64>; 3],
    (velocity, given): (&[Vec<f64>; 3], f64),
    carried: &[Vec<f64>; 3],
    dt: f64,
) -> f64 {
    let first = advection_error(grid, open, (velocity, given), dt);
    let speed = reference::max_speed(velocity);
    let cut = open.iter().flatten().any(|&open| reference::is_sliver(open));
    let given = given + if cut { 160.0 * EPS * speed } else { 0.0 };
    let blended = reference::shown_to_whole(grid, open, velocity);
    let end = end_error(grid, &blended, given, dt);
    let returned = first + sample_error(speed, steepest(grid, carried), end);
    first + 0.5 * (given + returned) + 11.0 * EPS * 2.0 * speed
}

/// Errors of a level (cells) after the first order of its transport and after the correction, where the limit decides alike. `carried`: after the
/// first order. A level is a distance with three roundings; the rest as in [`maccormack_error`].
pub fn level_error(grid: &Grid, velocity: &[Vec<f64>; 3], level: &[f64], carried: &[f64], dt: f64) -> [f64; 2] {
    let largest = level.iter().chain(carried).fold(0.0, |most, phi| f64::max(most, phi.abs()));
    let given = 3.0 * EPS * largest;
    let end = end_error(grid, velocity, 0.0, dt);
    let sample = |of: &[f64]| sample_error(largest, steepest_of(grid.cells, of), end);
    // Beyond an open side the level is the distance to it.
    let first = (given + sample(level)).max(end);
    let returned = first + sample(carried);
    [first, first + 0.5 * (given + returned) + 3.0 * EPS * 2.0 * largest]
}

/// Apertures for `advect_velocity` as on the device, which does not advect small-aperture faces outside the band: these are closed, with the same
/// blended velocity and weight.
pub fn open_to_advection(open: &[Vec<f64>; 3], in_band: impl Fn(Axis, usize) -> bool) -> [Vec<f64>; 3] {
    Axis::ALL.map(|axis| {
        let open = open[axis.index()].iter().enumerate();
        let skipped = |face, open| reference::is_sliver(open) && !in_band(axis, face);
        open.map(|(face, &open)| if skipped(face, open) { 0.0 } else { open }).collect()
    })
}

/// Rounding error of advected markers, which have the velocity of the surface above them.
#[derive(Clone, Copy, Debug)]
pub struct MarkerError<'a> {
    grid: Grid,
    velocity: &'a [Vec<f64>; 3],
    surface: reference::Surface<'a>,
    dt: f64,
    speed: f64,
    /// Largest slope of the velocity, m/s per cell and axis.
    slope: f64,
    /// Largest slope of the distance to the surface, cells per cell and axis.
    steep: f64,
}

impl<'a> MarkerError<'a> {
    /// Error of markers that move with face velocities (m/s) below a surface over dt (s).
    pub fn new(grid: &Grid, velocity: &'a [Vec<f64>; 3], surface: reference::Surface<'a>, dt: f64) -> MarkerError<'a> {
        MarkerError {
            grid: *grid,
            velocity,
            surface,
            dt,
            speed: reference::max_speed(velocity),
            slope: steepest(grid, velocity),
            steep: steepest_of(grid.cells, surface.distance) / grid.dx,
        }
    }

    /// Error of the end of the marker at x (m), m. Beside the terms of [`advection_error`] there is another sample, one cell below. Its direction is the
    /// slope of the distance, a difference of numbers up to 4 cells with a root that has four roundings. The distance is at least -2 cells and is sampled
    /// in 10 roundings. Its slope changes by 4 times the largest slope per cell of the position, but jumps at planes of cell centres: markers there are
    /// excused. The weight of the difference changes with the distance. A limited difference has a proportionally smaller error.
    pub fn at(&self, x: DVec3) -> f64 {
        let MarkerError { grid, velocity, surface, .. } = self;
        let cells_per_speed = self.dt / grid.dx;
        let layer = reference::Layer::at(grid, surface, x, self.dt);
        // As in a trace, half a cell further.
        let position = position_error(grid, self.speed * self.dt / grid.dx + 0.5);
        let rounded = EPS * (10.0 * self.steep.max(2.0) + 12.0);
        let direction = 2.0 * rounded + 4.0 * self.steep * position;
        let weight = surface.radius / grid.dx * (rounded + 3.0 * self.steep * position);
        let sample = |position: f64| sample_error(self.speed, self.slope, position);
        let error_at = |x: DVec3, position: f64| {
            let difference = (grid.velocity_at(velocity, x) - grid.velocity_at(velocity, x - layer.up)).length();
            let error = layer.ahead * (sample(position) + sample(position + direction)) + weight * difference;
            let least = layer.ahead * difference - error;
            sample(position) + error * (layer.most / least.max(layer.most)) + 6.0 * EPS * layer.most
        };
        let middle = x + 0.5 * self.dt * layer.velocity_at(grid, velocity, x);
        let at_middle = position + 0.5 * cells_per_speed * error_at(x, position);
        grid.dx * (position + cells_per_speed * error_at(middle, at_middle))
    }
}

/// Error of a position in the domain after a displacement of so many cells, cells.
fn position_error(grid: &Grid, displacement: f64) -> f64 {
    let extent = grid.cells.into_iter().max().unwrap_or(1) as f64;
    EPS * 4.0 * (extent + displacement)
}

/// Error of a sample at a position with an error in cells, of a field of values up to `speed` with a largest slope per cell and axis.
fn sample_error(speed: f64, slope: f64, position: f64) -> f64 {
    EPS * 10.0 * speed + 3.0 * slope * position
}

/// Largest difference between neighbouring faces of an axis, m/s.
fn steepest(grid: &Grid, velocity: &[Vec<f64>; 3]) -> f64 {
    Axis::ALL.map(|axis| steepest_of(grid.faces(axis), &velocity[axis.index()])).into_iter().fold(0.0, f64::max)
}

/// Largest difference between neighbours of a lattice of n values per axis.
fn steepest_of(n: [usize; 3], values: &[f64]) -> f64 {
    let strides = [1, n[0], n[0] * n[1]];
    let mut steepest: f64 = 0.0;
    for (index, &value) in values.iter().enumerate() {
        let ijk = [index % n[0], index / n[0] % n[1], index / strides[2]];
        for b in (0..3).filter(|&b| ijk[b] + 1 < n[b]) {
            steepest = steepest.max((values[index + strides[b]] - value).abs());
        }
    }
    steepest
}

/// Error of the end of a marker that moves with face velocities (m/s) over dt (s), m.
pub(super) fn marker_error(grid: &Grid, velocity: &[Vec<f64>; 3], dt: f64) -> f64 {
    let moved = dt / grid.dx * reference::max_speed(velocity);
    grid.dx * position_error(grid, moved) + dt * trace_error(grid, velocity, 0.0, dt)
}
