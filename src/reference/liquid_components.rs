//! `liquid_components`: connected components of the liquid, and their target volumes.
//!
//! Cells with phi < 0 belong to one component where open faces join them. Three layers of air beside them have its label
//! too, the smaller of two. V_k is the sum over its cells of their open volume times their filled part.
//!
//! The target volumes V0 of the components before the sub-step are distributed to those after it by the overlap of their
//! advected cells. With l(c) the old component at the departure point of cell c and w_c the volume in c,
//!
//! ```text
//! V0_k = sum over c in k of V0_l(c) w_c / W_l(c),    W_l = sum over c with l(c) = l of w_c
//! ```
//!
//! The target of a component without a successor, and rounding errors, are shared among all by volume. The targets and
//! the spray, an eighth of a cell a marker, sum to the target of the whole liquid.
//!
//! Without open sides a target is at most 4 V_k. The rest is shared among all in the next sub-step. Else what a wall that
//! moves uncovers, liquid with hardly any volume, would keep a part of the target for ever.

use glam::DVec3;
use rayon::prelude::*;

use super::ballistic::Ballistic;
use super::level_cells::interpolant_part;
use super::occupancy::tent;
use crate::grid::{Axis, Grid};

/// Layers of air with the label of the liquid beside them.
const AIR_LAYERS: usize = 3;
/// Largest target of a component, over its volume. The volume of drops of one cell may be a quarter of their target.
pub const LARGEST_TARGET: f64 = 4.0;

/// The components of the liquid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Components {
    /// Component of each cell, from 1 in the order of their first cells; 0 for none.
    pub label: Vec<u32>,
    /// Volume of each component, m^3.
    pub volume: Vec<f64>,
    /// Whether a component has no free surface and no open side.
    pub enclosed: Vec<bool>,
}

/// Labels the components. `open`: face apertures; `level` in cells; `open_volumes` in m^3.
pub fn liquid_components(grid: &Grid, open: &[Vec<f64>; 3], open_volumes: &[f64], level: &[f64]) -> Components {
    let mut label = vec![0; grid.n_cells()];
    let mut enclosed = Vec::new();
    for first in 0..grid.n_cells() {
        if label[first] == 0 && level[first] < 0.0 && has_open_face(grid, open, first) {
            let number = enclosed.len() as u32 + 1;
            enclosed.push(flood(grid, open, level, &mut label, (first, number)));
        }
    }
    for _ in 0..AIR_LAYERS {
        label = dilated(grid, open, &label);
    }
    let mut volume = vec![0.0; enclosed.len()];
    for (cell, &label) in label.iter().enumerate() {
        if label > 0 {
            volume[label as usize - 1] += open_volumes[cell] * interpolant_part(grid, level, cell);
        }
    }
    Components { label, volume, enclosed }
}

/// Faces of a cell with their aperture and the cell beyond, `None` on sides of the domain.
fn faces<'a>(grid: &'a Grid, open: &'a [Vec<f64>; 3], cell: usize) -> impl Iterator<Item = (f64, Option<usize>)> + 'a {
    let sides = Axis::ALL.into_iter().flat_map(|axis| [0, 1].map(|side| (axis, side)));
    sides.map(move |(axis, side)| {
        let mut face = grid.cell_at(cell);
        face[axis.index()] += side;
        let aperture = open[axis.index()][grid.face(axis, face)];
        (aperture, grid.face_sides(axis, face)[side])
    })
}

fn has_open_face(grid: &Grid, open: &[Vec<f64>; 3], cell: usize) -> bool {
    faces(grid, open, cell).any(|(aperture, _)| aperture > 0.0)
}

/// Labels the component of a cell with a number. Returns whether it is enclosed.
fn flood(grid: &Grid, open: &[Vec<f64>; 3], level: &[f64], label: &mut [u32], (first, number): (usize, u32)) -> bool {
    let mut enclosed = true;
    label[first] = number;
    let mut queue = vec![first];
    while let Some(cell) = queue.pop() {
        for (aperture, neighbour) in faces(grid, open, cell) {
            match neighbour {
                _ if aperture <= 0.0 => {}
                Some(neighbour) if level[neighbour] < 0.0 => {
                    if label[neighbour] == 0 {
                        label[neighbour] = number;
                        queue.push(neighbour);
                    }
                }
                _ => enclosed = false,
            }
        }
    }
    enclosed
}

/// Labels of cells without one from the smallest label across an open face.
fn dilated(grid: &Grid, open: &[Vec<f64>; 3], label: &[u32]) -> Vec<u32> {
    let from_neighbours = |cell: usize| {
        let labels = faces(grid, open, cell)
            .filter(|(aperture, _)| *aperture > 0.0)
            .filter_map(|(_, neighbour)| neighbour.map(|neighbour| label[neighbour]));
        labels.filter(|&label| label > 0).min().unwrap_or_default()
    };
    let all = (0..label.len()).into_par_iter();
    all.map(|cell| match label[cell] {
        0 => from_neighbours(cell),
        own => own,
    })
    .collect()
}

/// The label with the largest weight around a point (m); 0 for none.
pub fn label_at(grid: &Grid, label: &[u32], x: DVec3) -> u32 {
    let labelled = tent(grid, x).into_iter().filter(|&(cell, _)| label[cell] > 0);
    let most = labelled.reduce(|most, next| if next.1 > most.1 { next } else { most });
    most.map_or(0, |(cell, _)| label[cell])
}

/// Components before a sub-step.
#[derive(Clone, Copy, Debug)]
pub struct Before<'a> {
    /// Component of each cell.
    pub label: &'a [u32],
    /// Face velocities, m/s.
    pub velocity: &'a [Vec<f64>; 3],
    /// Liquid that falls freely.
    pub ballistic: Ballistic<'a>,
}

/// Component before a sub-step of dt (s) at the departure point of each cell with liquid; 0 for none.
pub fn component_origins(grid: &Grid, before: Before, has_liquid: impl Fn(usize) -> bool + Sync, dt: f64) -> Vec<u32> {
    let origin = |cell: usize| {
        if !has_liquid(cell) {
            return 0;
        }
        let x = grid.cell_centre(grid.cell_at(cell));
        let x = before.ballistic.origin_about(grid, grid.traced(before.velocity, x, -dt));
        label_at(grid, before.label, x)
    };
    (0..grid.n_cells()).into_par_iter().map(origin).collect()
}

/// Target volumes of the components by the overlap of the cells, m^3. `volume_0`: those before the sub-step, m^3; `origins`:
/// see [`component_origins`]; `volumes`: liquid volume per cell, m^3, 0 in cells without a label.
pub fn shared_volumes(volume_0: &[f64], origins: &[u32], components: &Components, volumes: &[f64]) -> Vec<f64> {
    let mut overlap = vec![0.0; volume_0.len()];
    let pairs = || {
        let pairs = origins.iter().enumerate();
        pairs.filter(|&(cell, &origin)| origin > 0 && volumes[cell] > 0.0)
    };
    for (cell, &origin) in pairs() {
        overlap[origin as usize - 1] += volumes[cell];
    }
    let mut shared = vec![0.0; components.volume.len()];
    for (cell, &origin) in pairs() {
        let old = origin as usize - 1;
        let share = volume_0[old] * volumes[cell] / overlap[old];
        shared[components.label[cell] as usize - 1] += share;
    }
    shared
}

/// Shares the rest of `total` (m^3) among targets (m^3) in proportion to the volumes of their components (m^3).
pub fn balance(total: f64, volumes: &[f64], volume_0: &mut [f64]) {
    let whole: f64 = volumes.iter().sum();
    if whole > 0.0 {
        let rest = total - volume_0.iter().sum::<f64>();
        let targets = volume_0.iter_mut().zip(volumes);
        targets.for_each(|(target, volume)| *target += rest * volume / whole);
    }
}

/// Caps targets at a multiple of the volumes of their components (both m^3).
pub fn cap_targets(volumes: &[f64], targets: &mut [f64]) {
    for (target, volume) in targets.iter_mut().zip(volumes) {
        *target = target.min(LARGEST_TARGET * volume);
    }
}
