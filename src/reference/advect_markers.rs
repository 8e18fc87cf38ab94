//! `advect_markers`: explicit midpoint rule in the MAC field. Markers leave through open sides and are pushed out of
//! walls and obstacles.
//!
//! Markers transport the surface, which is h = r - 0.2 dx above the outermost markers, with r the radius of their
//! spheres. The velocity at the marker is too small for the surface by exp(-h k) in a wave of wave number k. The
//! period would be too long by about h k / 2: 5 % at 40 cells a wavelength and 10 % at 20. So markers near the
//! surface move with the velocity of the surface, extrapolated along the normal n = grad d:
//!
//! ```text
//! v(x) = u(x) + w h/dx (u(x) - u(x - dx n))    w = 1 where d >= - dx, 0 at - 2 dx, linear between
//! ```
//!
//! with the signed distance d of `surface_distance`. Both samples are in the liquid, except in sheets and drops. A
//! sample on the surface would include extrapolated velocities, which have no slope. The addition is limited to half
//! a cell per sub-step: velocities are extrapolated that much further.

use glam::DVec3;
use rayon::prelude::*;

use super::ballistic::Ballistic;
use super::marker_band::Markers;
use super::sample::{gradient, normal};
use crate::grid::{Axis, Grid, Sides};

/// Distance of markers from domain walls, cells.
const WALL_GAP: f64 = 0.01;
/// Distance at which a marker is placed outside an obstacle that it entered, cells.
const SOLID_GAP: f64 = 0.1;
/// Number of push-out attempts.
const PUSHES: usize = 2;
/// Mean difference between the radius of the spheres and the height of the surface above the outermost markers,
/// cells. Seeding uses the same depth for the default radius (`geometry/liquid.rs`).
const SPHERE_GAP: f64 = 0.2;
/// Depth below the surface to which markers move with its velocity, and width of the transition below, cells.
const SURFACE_LAYER: [f64; 2] = [1.0, 1.0];
/// Largest additional displacement of markers near the surface per sub-step, cells.
const MOST_AHEAD: f64 = 0.5;

/// The surface above the markers.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Distance from `surface_distance` per cell, m.
    pub distance: &'a [f64],
    /// Radius of the spheres around markers, m.
    pub radius: f64,
}

/// Numbers of removed markers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lost {
    /// Dropped: still inside an obstacle after two pushes.
    pub dropped: u64,
    /// Left through an open side of the domain.
    pub left: u64,
}

/// Result of a marker's move.
enum Moved {
    Kept(DVec3),
    Dropped,
    Left,
}

/// Moves markers (m) by dt through `faces` (m/s). A marker beyond an open side has left; one still inside an obstacle
/// after two pushes is dropped. Returns the others in order, and the numbers of removed ones. `solid_distance` per
/// cell, m.
#[expect(clippy::too_many_arguments, reason = "fields of one stage")]
pub fn advect_markers(
    grid: &Grid,
    open_sides: Sides,
    faces: &[Vec<f64>; 3],
    solid_distance: &[f64],
    surface: &Surface,
    ballistic: &Ballistic,
    markers: &[[f64; 3]],
    dt: f64,
) -> (Vec<[f64; 3]>, Lost) {
    let results: Vec<Moved> = markers
        .par_iter()
        .map(|&x| {
            let x = DVec3::from(x);
            let layer = Layer::at(grid, surface, x, dt);
            let velocity = |x| layer.velocity_at(grid, faces, x);
            let middle = x + 0.5 * dt * velocity(x);
            let end = x + dt * velocity(middle) + ballistic.shift_from(grid, x);
            clamp_or_remove(grid, open_sides, solid_distance, end)
        })
        .collect();
    let mut inside = Vec::with_capacity(markers.len());
    let mut removed = Lost::default();
    for moved in results {
        match moved {
            Moved::Kept(x) => inside.push(x.into()),
            Moved::Dropped => removed.dropped += 1,
            Moved::Left => removed.left += 1,
        }
    }
    (inside, removed)
}

/// Most pieces of a flight.
const MOST_PIECES: f64 = 256.0;

/// Moves the markers of a level by dt (s): those of the liquid through `faces` (m/s) by the midpoint rule, spray as free bodies,
///
/// ```text
/// x += dt v + dt^2 g / 2,    v += dt g
/// ```
///
/// without the velocity into walls and obstacles that stop it. Returns the numbers of removed markers, and how many of these
/// were spray. A flight ends where it first is in a body, looked for once a cell. `solid_distance` per cell, m.
pub fn advect_level_markers(
    grid: &Grid,
    open_sides: Sides,
    faces: &[Vec<f64>; 3],
    solid_distance: &[f64],
    (gravity, ballistic): (DVec3, &Ballistic),
    dt: f64,
    markers: &mut Markers,
) -> (Lost, Lost) {
    let fly = |x: DVec3, v: DVec3| {
        let at = |t: f64| x + t * v + 0.5 * t * t * gravity;
        let way = (at(dt) - x).length() / grid.dx;
        let n = way.ceil().clamp(1.0, MOST_PIECES);
        let pieces = (1..n as u32).map(|piece| at(dt * (f64::from(piece) / n)));
        let in_body = |x: &DVec3| grid.sample_cells(solid_distance, *x) < 0.0;
        let end = pieces.into_iter().find(in_body);
        (end.unwrap_or_else(|| at(dt)), v + dt * gravity)
    };
    let flow = |x: DVec3, v: DVec3| (grid.traced(faces, x, dt) + ballistic.shift_from(grid, x), v);
    let pairs = markers.position.par_iter().zip(&markers.velocity);
    let results: Vec<(Moved, DVec3)> = pairs
        .zip(&markers.spray)
        .map(|((&x, &v), &spray)| {
            let (x, v) = (DVec3::from(x), DVec3::from(v));
            let (end, v) = if spray { fly(x, v) } else { flow(x, v) };
            let moved = clamp_or_remove(grid, open_sides, solid_distance, end);
            (moved, stopped(grid, solid_distance, end, v))
        })
        .collect();
    let (mut removed, mut removed_spray) = (Lost::default(), Lost::default());
    let mut keep = Vec::with_capacity(results.len());
    for (marker, (moved, velocity)) in results.into_iter().enumerate() {
        let spray = u64::from(markers.spray[marker]);
        let kept = match moved {
            Moved::Kept(x) => {
                markers.position[marker] = x.into();
                markers.velocity[marker] = velocity.into();
                true
            }
            Moved::Dropped => {
                removed.dropped += 1;
                removed_spray.dropped += spray;
                false
            }
            Moved::Left => {
                removed.left += 1;
                removed_spray.left += spray;
                false
            }
        };
        keep.push(kept);
    }
    markers.retain(&keep);
    (removed, removed_spray)
}

/// Velocity of spray at `end` (m) without its part into a wall or an obstacle there, m/s.
fn stopped(grid: &Grid, solid_distance: &[f64], end: DVec3, mut v: DVec3) -> DVec3 {
    for axis in 0..3 {
        let gap = WALL_GAP * grid.dx;
        if end[axis] < gap || end[axis] > grid.size()[axis] - gap {
            v[axis] = 0.0;
        }
    }
    match normal(grid, solid_distance, end) {
        Some(outwards) if grid.sample_cells(solid_distance, end) < 0.0 => v - v.dot(outwards).min(0.0) * outwards,
        _ => v,
    }
}

/// The controlled volume (m^3) after some markers have left: each removes the mean volume per marker. Integrating the
/// flux through open sides would be inconsistent with the measured volume. Its error would accumulate in the last
/// liquid of a tank.
pub fn volume_without(volume_0: f64, left: u64, kept: usize) -> f64 {
    match left {
        0 => volume_0,
        _ => volume_0 * kept as f64 / (kept as f64 + left as f64),
    }
}

/// Surface layer at a marker.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layer {
    /// Vector out of the liquid, at most one cell long, m.
    pub(crate) up: DVec3,
    /// Factor of the velocity difference over that vector.
    pub(crate) ahead: f64,
    /// Largest addition, m/s.
    pub(crate) most: f64,
}

impl Layer {
    /// The layer for a marker that starts at x (m) in a sub-step of dt (s).
    pub(crate) fn at(grid: &Grid, surface: &Surface, x: DVec3, dt: f64) -> Layer {
        let depth = -grid.sample_cells(surface.distance, x) / grid.dx;
        let [full, fading] = SURFACE_LAYER;
        let weight = ((full + fading - depth) / fading).clamp(0.0, 1.0);
        Layer {
            up: grid.dx * gradient(grid, surface.distance, x),
            ahead: weight * (surface.radius / grid.dx - SPHERE_GAP),
            most: MOST_AHEAD * grid.dx / dt,
        }
    }

    /// Velocity of the surface above, m/s.
    pub(crate) fn velocity_at(&self, grid: &Grid, faces: &[Vec<f64>; 3], x: DVec3) -> DVec3 {
        let here = grid.velocity_at(faces, x);
        let below = grid.velocity_at(faces, x - self.up);
        here + (self.ahead * (here - below)).clamp_length_max(self.most)
    }
}

/// Clamps, pushes out or removes a marker that has moved to `end`.
fn clamp_or_remove(grid: &Grid, open_sides: Sides, solid_distance: &[f64], end: DVec3) -> Moved {
    let inside = |x: DVec3| x.clamp(DVec3::splat(WALL_GAP * grid.dx), grid.size() - WALL_GAP * grid.dx);
    let beyond = |axis: Axis| {
        let (at, size) = (end[axis.index()], grid.size()[axis.index()]);
        (at < 0.0 && open_sides.has(axis, 0)) || (at > size && open_sides.has(axis, 1))
    };
    if Axis::ALL.into_iter().any(beyond) {
        return Moved::Left;
    }
    let mut x = inside(end);
    for _ in 0..PUSHES {
        let depth = grid.sample_cells(solid_distance, x);
        if depth >= 0.0 {
            return Moved::Kept(x);
        }
        if let Some(outwards) = normal(grid, solid_distance, x) {
            x = inside(x + (SOLID_GAP * grid.dx - depth) * outwards);
        }
    }
    if grid.sample_cells(solid_distance, x) >= 0.0 { Moved::Kept(x) } else { Moved::Dropped }
}
