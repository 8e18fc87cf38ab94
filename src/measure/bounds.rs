//! How far f32 may be off the equations: bounds that comparisons on scenes and tests share.

use glam::DVec3;

use crate::grid::{Axis, Grid};
use crate::reference;

/// Largest relative error of a rounding to f32.
pub(super) const EPS: f64 = 1.0 / (1 << 24) as f64;

/// The error of samples, m/s, at the ends of traces by the midpoint rule through face velocities (m/s), themselves off by up to `given`,
/// for dt (s). A position in cells is rounded up to 4 times (product with 1/dx, which is rounded itself, sum, shift to the faces), and
/// so is a way in cells. A trilinear sample is rounded 10 times and moves with its position by the largest difference between
/// neighbouring faces per cell and axis.
fn trace_error(grid: &Grid, velocity: &[Vec<f64>; 3], given: f64, dt: f64) -> f64 {
    let speed = reference::max_speed(velocity);
    let slope = steepest(grid, velocity);
    let sample = |position: f64| given + sample_error(speed, slope, position);
    let cells_per_speed = dt / grid.dx;
    let position = position_error(grid, speed * cells_per_speed);
    let middle = position + 0.5 * cells_per_speed * sample(position);
    sample(position + cells_per_speed * sample(middle))
}

/// The error of faces that have carried their velocities (m/s) for dt (s), where their fractions are `open`, m/s: of slivers, and of whole
/// ones. What slivers show to these is a quotient of two sums of up to 26 products whose weights are differences from 0.2, which f32 does not
/// hold, and a part of it that such a sum decides: less than 160 roundings of the largest velocity in all. Slivers may mix both, which is
/// rounded 12 times.
pub fn advection_error(
    grid: &Grid,
    open: &[Vec<f64>; 3],
    velocity: &[Vec<f64>; 3],
    dt: f64,
) -> f64 {
    let as_they_are = trace_error(grid, velocity, 0.0, dt);
    if !open
        .iter()
        .flatten()
        .any(|&open| reference::is_sliver(open))
    {
        return as_they_are;
    }
    let shown = reference::shown_to_whole(grid, open, velocity);
    let rounding = EPS * reference::max_speed(velocity);
    let as_shown = trace_error(grid, &shown, 160.0 * rounding, dt);
    as_shown.max(as_they_are) + 12.0 * rounding
}

/// The open fractions that `advect_velocity` knows of on the device, where slivers outside of the band stay as they are: as if they were
/// closed, which shows the same and weighs as little.
pub fn open_to_advection(
    open: &[Vec<f64>; 3],
    in_band: impl Fn(Axis, usize) -> bool,
) -> [Vec<f64>; 3] {
    Axis::ALL.map(|axis| {
        let open = open[axis.index()].iter().enumerate();
        let known = |(face, &open): (usize, &f64)| match reference::is_sliver(open)
            && !in_band(axis, face)
        {
            true => 0.0,
            false => open,
        };
        open.map(known).collect()
    })
}

/// What roundings do to markers, which move with the velocity of the surface above them.
#[derive(Clone, Copy, Debug)]
pub struct MarkerError<'a> {
    grid: Grid,
    velocity: &'a [Vec<f64>; 3],
    surface: reference::Surface<'a>,
    dt: f64,
    speed: f64,
    /// Steepest of the velocity, m/s per cell and axis.
    slope: f64,
    /// And of the distance to the surface, cells per cell and axis.
    steep: f64,
}

impl<'a> MarkerError<'a> {
    /// For those that move through face velocities (m/s) below a surface for dt (s).
    pub fn new(
        grid: &Grid,
        velocity: &'a [Vec<f64>; 3],
        surface: reference::Surface<'a>,
        dt: f64,
    ) -> MarkerError<'a> {
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

    /// The error of where the one at x (m) goes, m. Beside what [`advection_error`] counts of a trace there is another sample, one cell
    /// below. The way there is a slope of the distance; that is a difference of numbers up to 4 cells with a root that may be off by four roundings, is
    /// at least -2 cells and sampled in 10 roundings; its slope changes by 4 of the steepest per cell of the position, as the two other
    /// axes' do, but jumps on planes of cell centres, where markers have to be excused. The weight of the difference changes with the
    /// distance. Where the difference is cut off, its error shrinks as it does.
    pub fn at(&self, x: DVec3) -> f64 {
        let MarkerError {
            grid,
            velocity,
            surface,
            ..
        } = self;
        let cells_per_speed = self.dt / grid.dx;
        let layer = reference::Layer::at(grid, surface, x, self.dt);
        let position = self.position();
        let rounded = EPS * (10.0 * self.steep.max(2.0) + 12.0);
        let way = 2.0 * rounded + 4.0 * self.steep * position;
        let weight = surface.radius / grid.dx * (rounded + 3.0 * self.steep * position);
        let sample = |position: f64| sample_error(self.speed, self.slope, position);
        let off = |x: DVec3, position: f64| {
            let below = grid.velocity_at(velocity, x - layer.up);
            let difference = (grid.velocity_at(velocity, x) - below).length();
            let error =
                layer.ahead * (sample(position) + sample(position + way)) + weight * difference;
            let least = layer.ahead * difference - error;
            sample(position) + error * (layer.most / least.max(layer.most)) + 6.0 * EPS * layer.most
        };
        let middle = x + 0.5 * self.dt * layer.velocity_at(grid, velocity, x);
        let at_middle = position + 0.5 * cells_per_speed * off(x, position);
        grid.dx * (position + cells_per_speed * off(middle, at_middle))
    }

    /// Of a position, cells: as in a trace, half a cell further.
    fn position(&self) -> f64 {
        position_error(&self.grid, self.speed * self.dt / self.grid.dx + 0.5)
    }
}

/// Of a position in the domain that a way of so many cells was added to, cells.
fn position_error(grid: &Grid, way: f64) -> f64 {
    let extent = grid.cells.into_iter().max().unwrap_or(1) as f64;
    EPS * 4.0 * (extent + way)
}

/// Of a velocity sample, m/s, at a position that is off, cells.
fn sample_error(speed: f64, slope: f64, position: f64) -> f64 {
    EPS * 10.0 * speed + 3.0 * slope * position
}

/// Largest difference between neighbouring faces of an axis, m/s.
fn steepest(grid: &Grid, velocity: &[Vec<f64>; 3]) -> f64 {
    let of = |axis: Axis| steepest_of(grid.faces(axis), &velocity[axis.index()]);
    Axis::ALL.into_iter().map(of).fold(0.0, f64::max)
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
