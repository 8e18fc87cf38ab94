//! `extrapolate`: velocities beyond the liquid, for the next advection, and free slip along obstacles.
//!
//! Layer by layer a face without a valid velocity takes the mean over the nearest of its 26 neighbours of the same axis that
//! have one: those beside it, else those across an edge, else those across a corner. A layer so reaches one cell along every
//! diagonal too: a sub-step goes up to cfl cells along each axis at once, and through neighbours beside a face alone liquid
//! that moves along a diagonal ran into faces that no layer had reached. What no layer reaches is 0, and so are domain walls, but not
//! open sides.
//!
//! Slivers show a part of their velocity only to what is extended from them ([`super::slivers`]), and have their own again afterwards.
//!
//! Closed faces in and just outside obstacles and solids get the normal velocity of these: 0 where they stand still.

use glam::DVec3;
use rayon::prelude::*;

use super::slivers;
use crate::geometry::{CutCells, SolidClip};
use crate::grid::{Axis, Grid};

/// Layers beyond those that a step of `cfl` cells crosses.
const SPARE_LAYERS: usize = 2;
/// Below it a gradient of the distance has no direction.
const SMALLEST_GRADIENT: f64 = 1e-6;
/// Faces closer than this to an obstacle, or in it, slip along it; in cells.
const SLIP_REACH: f64 = 0.5;

/// How many layers a step at most `cfl` cells long needs.
pub fn n_layers(cfl: f64) -> usize {
    cfl.ceil() as usize + SPARE_LAYERS
}

/// Solids and obstacles as walls that move.
#[derive(Clone, Copy, Debug)]
pub struct MovingWalls<'a> {
    /// Where they are.
    pub clip: &'a SolidClip,
    /// Nodes of the solids' surface triangles.
    pub triangles: &'a [[u32; 3]],
    /// Velocity of all nodes, m/s.
    pub velocity: &'a [[f64; 3]],
}

impl MovingWalls<'_> {
    /// Velocity of what moves beside a cell, m/s: of the nearest place on a solid or of an obstacle, whichever is nearer.
    fn at_cell(&self, cell: usize) -> Option<DVec3> {
        let Some(nearest) = self.clip.nearest(cell) else {
            return self.clip.obstacles().wall(cell);
        };
        let corners = self.triangles[nearest.triangle].iter().zip(nearest.weights);
        let parts =
            corners.map(|(&node, weight)| weight * DVec3::from(self.velocity[node as usize]));
        Some(parts.sum::<DVec3>())
    }

    /// The same beside a face: the mean over the cells at both sides that have one.
    fn at_face(&self, grid: &Grid, axis: Axis, face: [usize; 3]) -> DVec3 {
        let sides = grid.face_sides(axis, face).into_iter().flatten();
        let velocities = sides.filter_map(|cell| self.at_cell(cell));
        let (sum, count) = velocities.fold((DVec3::ZERO, 0), |(sum, n), v| (sum + v, n + 1));
        sum / f64::from(count.max(1))
    }
}

/// Extends `faces` (m/s) by `layers` from where they are `valid`, and constrains them.
pub fn extrapolate(
    grid: &Grid,
    cut: &CutCells,
    walls: Option<MovingWalls>,
    valid: [Vec<bool>; 3],
    layers: usize,
    faces: &mut [Vec<f64>; 3],
) {
    let mut blended = [const { Vec::new() }; 3];
    for (axis, valid) in Axis::ALL.into_iter().zip(valid) {
        let (a, values) = (axis.index(), &mut faces[axis.index()]);
        blended[a] = slivers::shown_to_air(grid, axis, &cut.open[a], &valid, values);
        slivers::swap(&mut blended[a], values);
        extend(grid, axis, valid, layers, values);
    }
    close_walls(grid, &cut.open, faces);
    slip(grid, cut, walls, faces);
    for (blended, values) in blended.iter_mut().zip(faces) {
        slivers::swap(blended, values);
    }
}

fn extend(grid: &Grid, axis: Axis, mut valid: Vec<bool>, layers: usize, values: &mut [f64]) {
    let n = grid.faces(axis);
    for _ in 0..layers {
        let mean = |face: usize| {
            let ijk = grid.face_at(axis, face);
            // Sums and counts of the neighbours that differ in one, two and three indices.
            let mut means = [(0.0, 0_u32); 3];
            let around = ijk.map(|index| index.saturating_sub(1)..=index + 1);
            let [is, js, ks] =
                std::array::from_fn(|b| around[b].clone().filter(move |&index| index < n[b]));
            for k in ks {
                for j in js.clone() {
                    for i in is.clone() {
                        let at = [i, j, k];
                        let apart = (0..3).filter(|&b| at[b] != ijk[b]).count();
                        let neighbour = grid.face(axis, at);
                        if apart > 0 && valid[neighbour] {
                            means[apart - 1].0 += values[neighbour];
                            means[apart - 1].1 += 1;
                        }
                    }
                }
            }
            let nearest = means.into_iter().find(|&(_, count)| count > 0);
            nearest.map(|(sum, count)| (face, sum / f64::from(count)))
        };
        let unknown = (0..values.len())
            .into_par_iter()
            .filter(|&face| !valid[face]);
        let reached: Vec<_> = unknown.filter_map(mean).collect();
        for (face, value) in reached {
            values[face] = value;
            valid[face] = true;
        }
    }
    values
        .iter_mut()
        .zip(&valid)
        .filter(|(_, valid)| !**valid)
        .for_each(|(value, _)| *value = 0.0);
}

/// Of the faces on the sides of the domain, those that are open keep their velocities.
fn close_walls(grid: &Grid, open: &[Vec<f64>; 3], faces: &mut [Vec<f64>; 3]) {
    for axis in Axis::ALL {
        let a = axis.index();
        for (face, value) in faces[a].iter_mut().enumerate() {
            if open[a][face] <= 0.0 && grid.wall(axis, grid.face_at(axis, face)).is_some() {
                *value = 0.0;
            }
        }
    }
}

/// Direction of the gradient of the interpolated distance at a face, by central differences over dx: on grid planes, where the
/// exact gradient jumps, it does not depend on rounding. `None` where the gradient is shorter than 1e-6.
fn direction(grid: &Grid, solid_distance: &[f64], x: DVec3) -> Option<DVec3> {
    let slope = |b: usize| {
        let half = DVec3::AXES[b] * (0.5 * grid.dx);
        (grid.sample_cells(solid_distance, x + half) - grid.sample_cells(solid_distance, x - half))
            / grid.dx
    };
    let gradient = DVec3::from([0, 1, 2].map(slope));
    let length = gradient.length();
    (length >= SMALLEST_GRADIENT).then(|| gradient / length)
}

fn slip(grid: &Grid, cut: &CutCells, walls: Option<MovingWalls>, faces: &mut [Vec<f64>; 3]) {
    let constrained = Axis::ALL.map(|axis| -> Vec<(usize, f64)> {
        let a = axis.index();
        let constrain = |face: usize| {
            let ijk = grid.face_at(axis, face);
            if cut.open[a][face] > 0.0 || grid.face_sides(axis, ijk).contains(&None) {
                return None;
            }
            let x = grid.face_centre(axis, ijk);
            if grid.sample_cells(&cut.solid_distance, x) >= SLIP_REACH * grid.dx {
                return None;
            }
            let n = direction(grid, &cut.solid_distance, x)?;
            let of_wall = walls.map_or(DVec3::ZERO, |walls| walls.at_face(grid, axis, ijk));
            let into = (grid.velocity_at(faces, x) - of_wall).dot(n);
            Some((face, faces[a][face] - into * n[a]))
        };
        (0..grid.n_faces(axis))
            .into_par_iter()
            .filter_map(constrain)
            .collect()
    });
    for (values, constrained) in faces.iter_mut().zip(constrained) {
        constrained
            .into_iter()
            .for_each(|(face, value)| values[face] = value);
    }
}
