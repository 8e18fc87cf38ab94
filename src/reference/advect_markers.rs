//! `advect_markers`: explicit midpoint rule through the MAC field, out of the domain through open sides, else out of walls and
//! obstacles.
//!
//! Markers carry the surface, which stands h = r - 0.2 dx above the outermost of them, r the radius of their spheres. Moved by the
//! velocity where they are, they would move it too little: by exp(-h k) in a wave with wave number k, whose period is then longer by
//! about h k / 2, 5 % at 40 cells a wavelength and 10 % at 20. So markers near the surface move with the velocity up there, continued along
//! n = grad d, the normal, shorter where two sides of the liquid are close:
//!
//! ```text
//! v(x) = u(x) + w h/dx (u(x) - u(x - dx n))    w = 1 where d >= - dx, 0 at - 2 dx, linear between
//! ```
//!
//! with the signed distance d of `surface_distance`. Both samples lie in the liquid, unless it is a sheet or a drop; a sample on the
//! surface would see as much of the air, where velocities are continued without a slope. What is added moves a marker by half a cell
//! at most: so far beyond what others cross there are velocities.

use glam::DVec3;
use rayon::prelude::*;

use super::sample::{gradient, normal};
use crate::grid::{Axis, Grid, Sides};

/// Markers stay this far inside the domain, in cells.
const WALL_GAP: f64 = 0.01;
/// A marker that entered an obstacle is put this far outside it, in cells.
const SOLID_GAP: f64 = 0.1;
/// How often it is tried.
const PUSHES: usize = 2;
/// By how much less than the radius of their spheres the surface stands above the outermost markers on average, in cells. Markers
/// are seeded as deep with the default radius (`geometry/liquid.rs`).
const SPHERE_GAP: f64 = 0.2;
/// From this far below the surface on markers move with its velocity, in cells, and over how many less and less.
const SURFACE_LAYER: [f64; 2] = [1.0, 1.0];
/// How much further than others they move in a sub-step at most, in cells.
const MOST_AHEAD: f64 = 0.5;

/// The surface that markers carry.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// From `surface_distance`: per cell, m.
    pub distance: &'a [f64],
    /// Of the spheres around markers, m.
    pub radius: f64,
}

/// Markers that are no longer there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lost {
    /// Still inside an obstacle after two pushes.
    pub dropped: u64,
    /// Gone through an open side of the domain.
    pub left: u64,
}

/// What becomes of a marker.
enum Fate {
    Kept(DVec3),
    Dropped,
    Left,
}

/// Moves markers (m) by dt through `faces` (m/s). One that ends beyond an open side has left; one still inside an obstacle after
/// two pushes is dropped. Returns the others in order, and the numbers of those. `solid_distance`: per cell, m.
pub fn advect_markers(
    grid: &Grid,
    open_sides: Sides,
    faces: &[Vec<f64>; 3],
    solid_distance: &[f64],
    surface: &Surface,
    markers: &[[f64; 3]],
    dt: f64,
) -> (Vec<[f64; 3]>, Lost) {
    let moved: Vec<Fate> = markers
        .par_iter()
        .map(|&x| {
            let x = DVec3::from(x);
            let layer = Layer::at(grid, surface, x, dt);
            let velocity = |x| layer.velocity_at(grid, faces, x);
            let middle = x + 0.5 * dt * velocity(x);
            let end = x + dt * velocity(middle);
            settle(grid, open_sides, solid_distance, end)
        })
        .collect();
    let mut kept = Vec::with_capacity(markers.len());
    let mut lost = Lost::default();
    for fate in moved {
        match fate {
            Fate::Kept(x) => kept.push(x.into()),
            Fate::Dropped => lost.dropped += 1,
            Fate::Left => lost.left += 1,
        }
    }
    (kept, lost)
}

/// The volume to hold (m^3) once some of the markers have left and others are there still: each takes the mean volume of all.
/// What flows through the faces of open sides would be another measure; it does not add up to the volume that there was, so the
/// last liquid in a tank would be filled up or drained for all that went before.
pub fn volume_without(volume_0: f64, left: u64, kept: usize) -> f64 {
    match left {
        0 => volume_0,
        _ => volume_0 * kept as f64 / (kept as f64 + left as f64),
    }
}

/// What the surface is to a marker.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layer {
    /// A cell out of the liquid at most, m.
    pub(crate) up: DVec3,
    /// By which share of the difference over that way the surface is ahead.
    pub(crate) ahead: f64,
    /// By how much at most, m/s.
    pub(crate) most: f64,
}

impl Layer {
    /// For a marker that starts at x (m) on a sub-step of dt (s).
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

    /// v, m/s.
    pub(crate) fn velocity_at(&self, grid: &Grid, faces: &[Vec<f64>; 3], x: DVec3) -> DVec3 {
        let here = grid.velocity_at(faces, x);
        let below = grid.velocity_at(faces, x - self.up);
        here + (self.ahead * (here - below)).clamp_length_max(self.most)
    }
}

/// Where a marker comes to lie that has moved to `end`.
fn settle(grid: &Grid, open_sides: Sides, solid_distance: &[f64], end: DVec3) -> Fate {
    let inside = |x: DVec3| {
        x.clamp(
            DVec3::splat(WALL_GAP * grid.dx),
            grid.size() - WALL_GAP * grid.dx,
        )
    };
    let beyond = |axis: Axis| {
        let (at, size) = (end[axis.index()], grid.size()[axis.index()]);
        (at < 0.0 && open_sides.has(axis, 0)) || (at > size && open_sides.has(axis, 1))
    };
    if Axis::ALL.into_iter().any(beyond) {
        return Fate::Left;
    }
    let mut x = inside(end);
    for _ in 0..PUSHES {
        let depth = grid.sample_cells(solid_distance, x);
        if depth >= 0.0 {
            return Fate::Kept(x);
        }
        if let Some(outwards) = normal(grid, solid_distance, x) {
            x = inside(x + (SOLID_GAP * grid.dx - depth) * outwards);
        }
    }
    if grid.sample_cells(solid_distance, x) >= 0.0 {
        Fate::Kept(x)
    } else {
        Fate::Dropped
    }
}
