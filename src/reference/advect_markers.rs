//! `advect_markers`: explicit midpoint rule through the MAC field, out of the domain through open sides, else out of walls and
//! obstacles.

use glam::DVec3;
use rayon::prelude::*;

use super::sample::normal;
use crate::grid::{Axis, Grid, Sides};

/// Markers stay this far inside the domain, in cells.
const WALL_GAP: f64 = 0.01;
/// A marker that entered an obstacle is put this far outside it, in cells.
const SOLID_GAP: f64 = 0.1;
/// How often it is tried.
const PUSHES: usize = 2;

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
    markers: &[[f64; 3]],
    dt: f64,
) -> (Vec<[f64; 3]>, Lost) {
    let moved: Vec<Fate> = markers
        .par_iter()
        .map(|&x| advect(grid, open_sides, faces, solid_distance, x.into(), dt))
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

fn advect(
    grid: &Grid,
    open_sides: Sides,
    faces: &[Vec<f64>; 3],
    solid_distance: &[f64],
    x: DVec3,
    dt: f64,
) -> Fate {
    let middle = x + 0.5 * dt * grid.velocity_at(faces, x);
    let inside = |x: DVec3| {
        x.clamp(
            DVec3::splat(WALL_GAP * grid.dx),
            grid.size() - WALL_GAP * grid.dx,
        )
    };
    let end = x + dt * grid.velocity_at(faces, middle);
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
