//! Part of `advect_level`: the level of liquid that leaves walls and bodies.
//!
//! Beyond a wall the level continues unchanged, so transport alone never moves the surface off it. A separated cell has its surface between
//! its centre and the wall. With s the distance of the centre from the wall, g that of the surface, and n the normal into the liquid (lengths
//! in cells),
//!
//! ```text
//! g = max(phi + s, 0) clamp(2 (phi(x) - phi(x + n dx)), 0, 1)
//! bound = g - s + n . u dt / dx
//! ```
//!
//! Liquid that falls along a wall is separated without leaving it: the bound is set where the gap exceeds a fiftieth of the way that the
//! liquid moves.
//!
//! The last factor in g is 1 where the surface already left the wall, also where the slope of the level is not quite 1. It is 0 in a film,
//! whose nearest surface is its other one.
//!
//! `bound_level` raises the level to this bound, and `redistance` counts the cell as one at the interface. Cells with their centre in a body
//! have the extended level of the cell beside them, which is bounded in their place.
//!
//! The volume of such a cell counts as full until its surface is within a quarter of a cell of its centre.

use glam::DVec3;
use rayon::prelude::*;

use super::air_at_bodies::air_at_bodies;
use super::level_cells::LevelCells;
use crate::grid::Axis;

/// Distance from a body up to which cells belong to its surface, cells.
const BODY_REACH: f64 = 1.25;
/// Distance of a centre from a wall of the domain, cells.
const AT_WALL: f64 = 0.5;
/// Gap over the way of the liquid up to which it moves along the wall.
const ALONG_WALL: f64 = 0.02;

/// Bounds of the level (cells) from below after dt (s) in the velocity of the faces (m/s); minus infinity where no liquid leaves a wall.
/// `separated`: the cells of the last sub-step; empty for none.
fn separated_level(cells: LevelCells, faces: &[Vec<f64>; 3], separated: &[bool], level: &[f64], dt: f64) -> Vec<f64> {
    let LevelCells { grid, cut } = cells;
    if separated.is_empty() {
        return vec![f64::NEG_INFINITY; level.len()];
    }
    let bound = |cell: usize| {
        let distance = cut.solid_distance[cell] / grid.dx;
        if level[cell] >= 0.0 || !cells.is_open(cell) {
            return f64::NEG_INFINITY;
        }
        let ijk = grid.cell_at(cell);
        let x = grid.cell_centre(ijk);
        let motion = dt / grid.dx * grid.cell_velocity(faces, cell);
        let from_wall = |n: DVec3, s: f64| {
            let inner = grid.sample_cells(level, x + grid.dx * n);
            let gap = (level[cell] + s).max(0.0) * (2.0 * (level[cell] - inner)).clamp(0.0, 1.0);
            let opened = gap + n.dot(motion);
            if opened > ALONG_WALL * motion.length() { opened - s } else { f64::NEG_INFINITY }
        };
        let mut bound = f64::NEG_INFINITY;
        let mut leaves_body = separated[cell];
        for (axis, side) in Axis::ALL.into_iter().flat_map(|axis| [(axis, 0), (axis, 1)]) {
            let mut face = ijk;
            face[axis.index()] += side;
            match grid.face_sides(axis, face)[side] {
                Some(other) => leaves_body |= separated[other] && !cells.is_open(other),
                None if separated[cell] && cut.open[axis.index()][grid.face(axis, face)] <= 0.0 => {
                    let n = DVec3::AXES[axis.index()] * [1.0, -1.0][side];
                    bound = bound.max(from_wall(n, AT_WALL));
                }
                None => {}
            }
        }
        let n = (leaves_body && distance < BODY_REACH).then(|| body_normal(cells, x));
        n.filter(|n| *n != DVec3::ZERO).map_or(bound, |n| bound.max(from_wall(n, distance)))
    };
    (0..level.len()).into_par_iter().map(bound).collect()
}

/// Direction away from the nearest body at x (m); 0 where the distance has no gradient.
fn body_normal(cells: LevelCells, x: DVec3) -> DVec3 {
    let LevelCells { grid, cut } = cells;
    let slope = |b: usize| {
        let half = DVec3::AXES[b] * (0.5 * grid.dx);
        grid.sample_cells(&cut.solid_distance, x + half) - grid.sample_cells(&cut.solid_distance, x - half)
    };
    DVec3::from([0, 1, 2].map(slope)).normalize_or_zero()
}

/// Bounds of the level (cells) at walls and bodies after dt (s) in the velocity of the faces (m/s), minus infinity elsewhere: those of `separated`
/// cells and, if all bodies are at rest (`still_bodies`), of [`air_at_bodies`].
pub fn separation_bounds(
    cells: LevelCells,
    faces: &[Vec<f64>; 3],
    separated: &[bool],
    level: &[f64],
    (dt, still_bodies): (f64, bool),
) -> Vec<f64> {
    let mut bounds = separated_level(cells, faces, separated, level, dt);
    if still_bodies {
        air_at_bodies(cells, faces, level, dt, &mut bounds);
    }
    bounds
}

/// The level (cells), raised to [`separation_bounds`].
pub fn raise_separated(bounds: &[f64], level: &mut [f64]) {
    level.iter_mut().zip(bounds).for_each(|(phi, bound)| *phi = phi.max(*bound));
}
