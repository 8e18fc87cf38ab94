//! `extrapolate`: velocities outside the liquid for the next advection, and free slip along obstacles.
//!
//! In each layer, a face without a valid velocity receives the mean over its nearest valid neighbours of the same axis.
//! These are beside it, else across an edge, else across a corner. So a layer extends by one cell along every diagonal
//! too: a sub-step may cross cfl cells along each axis at once. Faces beyond all layers are 0, and so are domain walls
//! except open sides.
//!
//! With a level, faces in the first layer continue the slope of the liquid. A valid neighbour beside them contributes u1
//! plus the slope that the monotonised central limiter (van Leer 1977) makes of the valid faces u1, u2, u3 in a row, u1 next
//! to the face:
//!
//! ```text
//! sign(a) min((|a| + |b|) / 2, 2 |a|, 2 |b|, s)     a = u1 - u2 and b = u2 - u3 of the same sign, else 0
//! ```
//!
//! s is the [largest slope](super::TimeStep::largest_slope). A constant extension lets a wave of 20 cells lose four times as much, and min(|a|, |b|) makes its period 2.3 % too long.
//! With a parabola waves of 28 cells grow, and an unlimited slope doubles the energy of a splash.
//!
//! Small-aperture faces contribute blended velocities ([`super::slivers`]) and recover their own afterwards.
//!
//! Closed faces in and just outside obstacles and solids receive the normal velocity of these, 0 for static ones. With
//! separation they keep their velocity away from walls and bodies beside air and separated cells. Interpolation with the
//! velocity of the wall would hold the markers there: at a distance d they would leave at d / dx of their speed.

use glam::DVec3;
use rayon::prelude::*;

use super::slivers;
use crate::geometry::{CutCells, SolidClip};
use crate::grid::{Axis, Grid};

/// Layers beyond those that a sub-step of `cfl` cells crosses.
const SPARE_LAYERS: usize = 2;
/// Norm below which the gradient of the distance has no direction.
const SMALLEST_GRADIENT: f64 = 1e-6;
/// Distance from an obstacle below which faces slip along it, cells.
const SLIP_REACH: f64 = 0.5;

/// Number of layers for a sub-step of at most `cfl` cells.
pub fn n_layers(cfl: f64) -> usize {
    cfl.ceil() as usize + SPARE_LAYERS
}

/// Solids and obstacles as moving walls.
#[derive(Clone, Copy, Debug)]
pub struct MovingWalls<'a> {
    /// Clipping of both.
    pub clip: &'a SolidClip,
    /// Nodes of the solids' surface triangles.
    pub triangles: &'a [[u32; 3]],
    /// Velocity of all nodes, m/s.
    pub velocity: &'a [[f64; 3]],
}

impl MovingWalls<'_> {
    /// Velocity of the closest point on a solid or obstacle beside a cell, m/s.
    fn at_cell(&self, cell: usize) -> Option<DVec3> {
        let Some(nearest) = self.clip.nearest(cell) else {
            return self.clip.obstacles().wall_velocity(cell);
        };
        let corners = self.triangles[nearest.triangle].iter().zip(nearest.weights);
        let parts = corners.map(|(&node, weight)| weight * DVec3::from(self.velocity[node as usize]));
        Some(parts.sum::<DVec3>())
    }

    /// Mean over the two cells of a face that have a closest point, m/s.
    fn at_face(&self, grid: &Grid, axis: Axis, face: [usize; 3]) -> DVec3 {
        let sides = grid.face_sides(axis, face).into_iter().flatten();
        let velocities = sides.filter_map(|cell| self.at_cell(cell));
        let (sum, count) = velocities.fold((DVec3::ZERO, 0), |(sum, n), v| (sum + v, n + 1));
        sum / f64::from(count.max(1))
    }
}

/// Extends `faces` (m/s) by `layers` from the `valid` ones and applies free slip.
pub fn extrapolate(
    grid: &Grid,
    cut: &CutCells,
    walls: Option<MovingWalls>,
    valid: [Vec<bool>; 3],
    layers: usize,
    faces: &mut [Vec<f64>; 3],
) {
    extrapolate_with_slope(grid, cut, walls, valid, (layers, 0.0), faces);
}

/// The same with the slope of the liquid in the first layer. `largest`: see [`TimeStep::largest_slope`](super::TimeStep::largest_slope).
pub fn extrapolate_with_slope(
    grid: &Grid,
    cut: &CutCells,
    walls: Option<MovingWalls>,
    valid: [Vec<bool>; 3],
    extent: (usize, f64),
    faces: &mut [Vec<f64>; 3],
) {
    extrapolate_one_sided(grid, cut, (walls, None), valid, extent, faces);
}

/// The same with walls that liquid leaves: closed faces keep a velocity away from the wall unless a cell beside them is in
/// `held`, the active cells that did not separate. `None`: no face keeps it.
pub fn extrapolate_one_sided(
    grid: &Grid,
    cut: &CutCells,
    (walls, held): (Option<MovingWalls>, Option<&[bool]>),
    valid: [Vec<bool>; 3],
    (layers, largest): (usize, f64),
    faces: &mut [Vec<f64>; 3],
) {
    let mut blended = [const { Vec::new() }; 3];
    for (axis, valid) in Axis::ALL.into_iter().zip(valid) {
        let (a, values) = (axis.index(), &mut faces[axis.index()]);
        blended[a] = slivers::shown_to_air(grid, axis, &cut.open[a], &valid, values);
        slivers::swap(&mut blended[a], values);
        extend(grid, axis, valid, (layers, largest), values);
    }
    close_walls(grid, &cut.open, held, faces);
    slip(grid, cut, (walls, held), faces);
    for (blended, values) in blended.iter_mut().zip(faces) {
        slivers::swap(blended, values);
    }
}

/// Limited slope beyond the neighbour `at` of the face `ijk`; 0 without valid faces in a row.
fn slope(grid: &Grid, axis: Axis, valid: &[bool], values: &[f64], [ijk, at]: [[usize; 3]; 2], largest: f64) -> f64 {
    let n = grid.faces(axis);
    let behind = |steps: usize| {
        let place = std::array::from_fn(|b| at[b].wrapping_add(at[b].wrapping_sub(ijk[b]).wrapping_mul(steps)));
        let inside = (0..3).all(|b| place[b] < n[b]);
        let face = inside.then(|| grid.face(axis, place));
        face.filter(|&face| valid[face]).map(|face| values[face])
    };
    let Some(((first, second), third)) = behind(0).zip(behind(1)).zip(behind(2)) else {
        return 0.0;
    };
    let (near, far) = (first - second, second - third);
    match near * far > 0.0 {
        true => near.signum() * limited(near.abs(), far.abs()).min(largest),
        false => 0.0,
    }
}

/// The monotonised central limiter of two slopes of the same sign.
fn limited(near: f64, far: f64) -> f64 {
    (0.5 * (near + far)).min(2.0 * near.min(far))
}

fn extend(grid: &Grid, axis: Axis, mut valid: Vec<bool>, (layers, largest): (usize, f64), values: &mut [f64]) {
    let n = grid.faces(axis);
    for layer in 0..layers {
        let slopes = layer == 0 && largest > 0.0;
        let mean = |face: usize| {
            let ijk = grid.face_at(axis, face);
            // Sums and counts of the neighbours that differ in one, two and three indices.
            let mut means = [(0.0, 0_u32); 3];
            let around = ijk.map(|index| index.saturating_sub(1)..=index + 1);
            let [is, js, ks] = std::array::from_fn(|b| around[b].clone().filter(move |&index| index < n[b]));
            for k in ks {
                for j in js.clone() {
                    for i in is.clone() {
                        let at = [i, j, k];
                        let apart = (0..3).filter(|&b| at[b] != ijk[b]).count();
                        let neighbour = grid.face(axis, at);
                        if apart > 0 && valid[neighbour] {
                            let ahead = match slopes && apart == 1 {
                                true => slope(grid, axis, &valid, values, [ijk, at], largest),
                                false => 0.0,
                            };
                            means[apart - 1].0 += values[neighbour] + ahead;
                            means[apart - 1].1 += 1;
                        }
                    }
                }
            }
            let nearest = means.into_iter().find(|&(_, count)| count > 0);
            nearest.map(|(sum, count)| (face, sum / f64::from(count)))
        };
        let unknown = (0..values.len()).into_par_iter().filter(|&face| !valid[face]);
        let reached: Vec<_> = unknown.filter_map(mean).collect();
        for (face, value) in reached {
            values[face] = value;
            valid[face] = true;
        }
    }
    values.iter_mut().zip(&valid).filter(|(_, valid)| !**valid).for_each(|(value, _)| *value = 0.0);
}

/// Whether liquid may leave the wall or body behind a closed face.
fn leaves(grid: &Grid, held: Option<&[bool]>, axis: Axis, face: [usize; 3]) -> bool {
    let mut sides = grid.face_sides(axis, face).into_iter().flatten();
    held.is_some_and(|held| !sides.any(|cell| held[cell]))
}

/// Removes velocities into closed sides of the domain, and out of those that liquid does not leave.
fn close_walls(grid: &Grid, open: &[Vec<f64>; 3], held: Option<&[bool]>, faces: &mut [Vec<f64>; 3]) {
    for axis in Axis::ALL {
        let a = axis.index();
        for (face, value) in faces[a].iter_mut().enumerate() {
            let ijk = grid.face_at(axis, face);
            let Some(side) = grid.wall(axis, ijk).filter(|_| open[a][face] <= 0.0) else {
                continue;
            };
            *value = match (leaves(grid, held, axis, ijk), side) {
                (false, _) => 0.0,
                (true, 0) => value.max(0.0),
                (true, _) => value.min(0.0),
            };
        }
    }
}

/// Direction of the interpolated distance's gradient at a face, by central differences over dx. On grid planes the
/// exact gradient jumps, so it would depend on rounding. `None` if the gradient is shorter than 1e-6.
fn direction(grid: &Grid, solid_distance: &[f64], x: DVec3) -> Option<DVec3> {
    let slope = |b: usize| {
        let half = DVec3::AXES[b] * (0.5 * grid.dx);
        (grid.sample_cells(solid_distance, x + half) - grid.sample_cells(solid_distance, x - half)) / grid.dx
    };
    let gradient = DVec3::from([0, 1, 2].map(slope));
    let length = gradient.length();
    (length >= SMALLEST_GRADIENT).then(|| gradient / length)
}

fn slip(grid: &Grid, cut: &CutCells, (walls, held): (Option<MovingWalls>, Option<&[bool]>), faces: &mut [Vec<f64>; 3]) {
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
            let wall_velocity = walls.map_or(DVec3::ZERO, |walls| walls.at_face(grid, axis, ijk));
            let away = (grid.velocity_at(faces, x) - wall_velocity).dot(n);
            let away = match leaves(grid, held, axis, ijk) {
                true => away.min(0.0),
                false => away,
            };
            Some((face, faces[a][face] - away * n[a]))
        };
        (0..grid.n_faces(axis)).into_par_iter().filter_map(constrain).collect()
    });
    for (values, constrained) in faces.iter_mut().zip(constrained) {
        constrained.into_iter().for_each(|(face, value)| values[face] = value);
    }
}
