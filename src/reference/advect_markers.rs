//! `advect_markers`: explicit midpoint rule through the MAC field, then out of walls and obstacles.

use glam::DVec3;
use rayon::prelude::*;

use super::sample::normal;
use crate::grid::Grid;

/// Markers stay this far inside the domain, in cells.
const WALL_GAP: f64 = 0.01;
/// A marker that entered an obstacle is put this far outside it, in cells.
const SOLID_GAP: f64 = 0.1;
/// How often it is tried.
const PUSHES: usize = 2;

/// Moves markers (m) by dt through `faces` (m/s). A marker still inside an obstacle after two pushes is dropped; returns the
/// others in order, and the number dropped. `solid_distance`: per cell, m.
pub fn advect_markers(
    grid: &Grid,
    faces: &[Vec<f64>; 3],
    solid_distance: &[f64],
    markers: &[[f64; 3]],
    dt: f64,
) -> (Vec<[f64; 3]>, u64) {
    let moved: Vec<_> = markers
        .par_iter()
        .map(|&x| advect(grid, faces, solid_distance, x.into(), dt))
        .collect();
    let kept: Vec<[f64; 3]> = moved.into_iter().flatten().map(DVec3::into).collect();
    let dropped = (markers.len() - kept.len()) as u64;
    (kept, dropped)
}

fn advect(
    grid: &Grid,
    faces: &[Vec<f64>; 3],
    solid_distance: &[f64],
    x: DVec3,
    dt: f64,
) -> Option<DVec3> {
    let middle = x + 0.5 * dt * grid.velocity_at(faces, x);
    let inside = |x: DVec3| {
        x.clamp(
            DVec3::splat(WALL_GAP * grid.dx),
            grid.size() - WALL_GAP * grid.dx,
        )
    };
    let mut x = inside(x + dt * grid.velocity_at(faces, middle));
    for _ in 0..PUSHES {
        let depth = grid.sample_cells(solid_distance, x);
        if depth >= 0.0 {
            return Some(x);
        }
        if let Some(outwards) = normal(grid, solid_distance, x) {
            x = inside(x + (SOLID_GAP * grid.dx - depth) * outwards);
        }
    }
    (grid.sample_cells(solid_distance, x) >= 0.0).then_some(x)
}
