//! `spray`: markers that fly as free bodies.
//!
//! A marker with no liquid in the eight cells whose centres surround it is spray. It moves as a free body and has no part in
//! the level, since the pressure does not reach it. All other markers have the velocity of the grid. At the start of its
//! flight the target of the component beside it shrinks by the volume of the marker, an eighth of a cell. [`super::landing`]
//! ends flights.

use glam::DVec3;
use rayon::prelude::*;

use super::liquid_components::label_at;
use super::marker_band::Markers;
use super::occupancy::{PER_CELL, tent};
use crate::grid::Grid;
use crate::state::Diagnosis;

/// Whether no cell around a point (m) contains liquid. `liquid_distance` in m.
pub(super) fn flies(grid: &Grid, liquid_distance: &[f64], x: [f64; 3]) -> bool {
    let around = tent(grid, x.into()).into_iter();
    around.map(|(cell, _)| liquid_distance[cell]).all(|phi| phi >= 0.0)
}

/// Updates velocities and spray. `liquid_distance` in m, `faces` in m/s. Returns the markers that start to fly.
pub fn spray(grid: &Grid, liquid_distance: &[f64], faces: &[Vec<f64>; 3], markers: &mut Markers) -> Vec<usize> {
    let pairs = markers.position.par_iter().zip(&markers.spray);
    let moving = markers.velocity.par_iter_mut().zip(pairs);
    moving
        .filter(|(_, (_, spray))| !**spray)
        .for_each(|(velocity, (x, _))| *velocity = grid.velocity_at(faces, DVec3::from(*x)).to_array());
    let starts = |&marker: &usize| !markers.spray[marker] && flies(grid, liquid_distance, markers.position[marker]);
    let started: Vec<usize> = (0..markers.spray.len()).into_par_iter().filter(starts).collect();
    started.iter().for_each(|&marker| markers.spray[marker] = true);
    started
}

/// Adds the spray to sums over the cells: an eighth of a cell for each marker. `density` in kg/m^3, `gravity` in m/s^2.
pub fn add_spray<'a>(
    grid: &Grid,
    (density, gravity): (f64, DVec3),
    spray: impl Iterator<Item = ([f64; 3], [f64; 3])> + 'a,
    sums: &mut Diagnosis,
) {
    let volume = grid.cell_volume() / PER_CELL;
    let mass = density * volume;
    for (x, v) in spray {
        let (x, v) = (DVec3::from(x), DVec3::from(v));
        sums.volume += volume;
        sums.kinetic_energy += 0.5 * mass * v.length_squared();
        sums.potential_energy -= mass * gravity.dot(x);
        for axis in 0..3 {
            sums.momentum[axis] += mass * v[axis];
        }
    }
}

/// Moves the volume of markers that changed between spray and the targets of the components (m^3).
pub fn move_spray_volume(grid: &Grid, label: &[u32], markers: &Markers, changed: &[usize], volume_0: &mut [f64]) {
    let one = grid.cell_volume() / PER_CELL;
    for &marker in changed {
        let near = label_at(grid, label, markers.position[marker].into());
        if near > 0 {
            volume_0[near as usize - 1] += if markers.spray[marker] { -one } else { one };
        }
    }
}
