//! `landing`: markers that land transfer their momentum to the liquid.
//!
//! Spray with liquid in the eight cells whose centres surround it lands. It becomes a part of the liquid around it, by the tent
//! weights w of the faces, in an inelastic impact before the projection:
//!
//! ```text
//! u_f := (M_f u_f + m P_f) / (M_f + m W_f)    P_f = sum of w v, W_f = sum of w, m = 1/8
//! ```
//!
//! over the open faces with liquid on a side; other faces have an extrapolated velocity. The weights of these faces are scaled to the
//! sum 1. M_f is the mean of the liquid in the cells on both sides, volumes of a cell. The sum of M_f u_f is the momentum of the liquid
//! (see [`super::diagnose`]), so momentum is conserved. The new velocity of a face is between those of liquid and markers. The weights
//! are added as integers, in units of 2^-16, and velocities in cells per sub-step, so that their order has no effect. The target of the
//! component beside a marker grows by the volume of the marker.

use std::collections::BTreeMap;

use glam::DVec3;

use super::marker_band::Markers;
use super::occupancy::PER_CELL;
use super::spray::flies;
use crate::grid::{Axis, Grid};

/// Fixed point of weights and velocities.
const ONE: f64 = (1 << 16) as f64;
/// Largest velocity that counts, cells per sub-step.
const LARGEST: f64 = 64.0;
/// Least sum of the weights of the faces that take momentum. The momentum of a marker with less is lost.
const LEAST_WEIGHT: f64 = 1.0 / 256.0;

/// Ends the flight of spray with liquid around it. `liquid_distance` in m. Returns the markers that land.
pub fn land(grid: &Grid, liquid_distance: &[f64], markers: &mut Markers) -> Vec<usize> {
    let lands = |&marker: &usize| markers.spray[marker] && !flies(grid, liquid_distance, markers.position[marker]);
    let landed: Vec<usize> = (0..markers.spray.len()).filter(lands).collect();
    landed.iter().for_each(|&marker| markers.spray[marker] = false);
    landed
}

/// Adds the momentum of markers that land to the faces (m/s). `open`: face apertures; `volumes`: liquid in the cells, volumes of a
/// cell; `dt` in s.
pub fn take_landing(
    grid: &Grid,
    open: &[Vec<f64>; 3],
    (liquid_distance, volumes): (&[f64], &[f64]),
    (markers, landed): (&Markers, &[usize]),
    dt: f64,
    faces: &mut [Vec<f64>; 3],
) {
    let speed = grid.dx / dt;
    for axis in Axis::ALL {
        let a = axis.index();
        let mut sums = BTreeMap::<usize, [i64; 2]>::new();
        for &marker in landed {
            let way = (markers.velocity[marker][a] / speed).clamp(-LARGEST, LARGEST);
            let x = markers.position[marker].into();
            for (face, weight) in landing_faces(grid, &open[a], liquid_distance, axis, x) {
                let [momentum, sum] = sums.entry(face).or_default();
                *momentum += (ONE * weight * way).round() as i64;
                *sum += (ONE * weight).round() as i64;
            }
        }
        for (face, sums) in sums {
            let [momentum, weight] = sums.map(|sum| sum as f64 / ONE / PER_CELL);
            if weight > 0.0 {
                let mass = face_mass(grid, volumes, axis, face);
                let u = &mut faces[a][face];
                *u = (mass * *u + speed * momentum) / (mass + weight);
            }
        }
    }
}

/// The faces of an axis around a point (m) that take its momentum, with their weights.
pub fn landing_faces(grid: &Grid, open: &[f64], liquid_distance: &[f64], axis: Axis, x: DVec3) -> Vec<(usize, f64)> {
    let takes = |&(face, _): &(usize, f64)| {
        let mut sides = grid.face_sides(axis, grid.face_at(axis, face)).into_iter().flatten();
        open[face] > 0.0 && sides.any(|cell| liquid_distance[cell] < 0.0)
    };
    let around = grid.faces_around(axis, x).weights().into_iter();
    let taking: Vec<(usize, f64)> = around.filter(takes).collect();
    let sum: f64 = taking.iter().map(|(_, weight)| weight).sum();
    match sum >= LEAST_WEIGHT {
        true => taking.into_iter().map(|(face, weight)| (face, weight / sum)).collect(),
        false => Vec::new(),
    }
}

/// M_f: mean of the liquid on both sides of a face, volumes of a cell.
pub fn face_mass(grid: &Grid, volumes: &[f64], axis: Axis, face: usize) -> f64 {
    let sides = grid.face_sides(axis, grid.face_at(axis, face)).into_iter();
    sides.flatten().map(|cell| 0.5 * volumes[cell]).sum()
}
