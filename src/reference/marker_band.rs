//! `marker_band`: deletes and seeds markers, so that they fill a band of three cells below the surface.
//!
//! A marker at x is deleted where phi(x) < -3, unless it is spray or the excess of its cell is above 0.2. Each cell has
//! eight sites, with another jitter in every sub-step. A site that was below the band and is in it now gets a marker:
//!
//! ```text
//! phi*(x) < -3 <= phi(x)
//! ```
//!
//! with the level phi* after its transport and phi after all changes. Transport does not change the level of a point, so
//! these sites lie in the liquid that entered the band. Their density is that of the band, without a count of markers.

use glam::DVec3;
use rayon::prelude::*;

use super::level_cells::{BAND, hash};
use crate::grid::Grid;

/// Excess above which markers below the band stay: they have to expand first.
const KEPT_EXCESS: f64 = 0.2;
/// Sites along each edge of a cell.
const PER_EDGE: usize = 2;
/// Margin without jitter on each side of a site, as a fraction of its edge.
const MARGIN: f64 = 0.02;
/// Distance of a cell from the band above which no site of it is in the band, cells.
const MARGIN_OF_CELLS: f64 = 2.0;

/// Markers of a level.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Markers {
    /// Positions, m.
    pub position: Vec<[f64; 3]>,
    /// Velocities, m/s.
    pub velocity: Vec<[f64; 3]>,
    /// Whether a marker flies.
    pub spray: Vec<bool>,
}

impl Markers {
    /// Removes the markers that do not pass. Returns the number removed.
    pub fn retain(&mut self, keep: &[bool]) -> usize {
        let before = self.position.len();
        let mut index = 0;
        let mut next = || {
            index += 1;
            keep[index - 1]
        };
        self.position.retain(|_| next());
        let mut kept = keep.iter();
        self.velocity.retain(|_| kept.next() == Some(&true));
        let mut kept = keep.iter();
        self.spray.retain(|_| kept.next() == Some(&true));
        before - self.position.len()
    }

    /// Appends markers of the liquid at positions (m).
    pub fn extend(&mut self, grid: &Grid, faces: &[Vec<f64>; 3], positions: &[[f64; 3]]) {
        let velocity = |&x: &[f64; 3]| grid.velocity_at(faces, x.into()).to_array();
        self.position.extend(positions);
        self.velocity.extend(positions.iter().map(velocity));
        self.spray.resize(self.position.len(), false);
    }
}

/// Levels around the maintenance, cells.
#[derive(Clone, Copy, Debug)]
pub struct Levels<'a> {
    /// After the transport.
    pub carried: &'a [f64],
    /// After all changes.
    pub level: &'a [f64],
}

/// Deletes and seeds markers. `numbers`: seed and number of the sub-step; `solid_distance` in m; `faces` in m/s. Returns the
/// numbers of deleted and seeded markers.
pub fn marker_band(
    grid: &Grid,
    solid_distance: &[f64],
    Levels { carried, level }: Levels,
    excess: &[f64],
    numbers: [u32; 2],
    faces: &[Vec<f64>; 3],
    markers: &mut Markers,
) -> [usize; 2] {
    let stays = |(x, &spray): (&[f64; 3], &bool)| {
        let x = DVec3::from(*x);
        spray || grid.sample_cells(level, x) >= -BAND || excess.get(cell_of(grid, x)).is_some_and(|&e| e > KEPT_EXCESS)
    };
    let markers_now = markers.position.par_iter().zip(&markers.spray);
    let keep: Vec<bool> = markers_now.map(stays).collect();
    let deleted = markers.retain(&keep);
    let enters = |x: DVec3| grid.sample_cells(carried, x) < -BAND && grid.sample_cells(level, x) >= -BAND;
    let may = |cell: usize| level[cell] >= -BAND - MARGIN_OF_CELLS && carried[cell].min(level[cell]) <= -1.0;
    let seeded = sites_where(grid, solid_distance, numbers, may, enters);
    markers.extend(grid, faces, &seeded);
    [deleted, seeded.len()]
}

/// Markers of the band of an initial level (cells), m. `inside`: whether a point (m) is in the liquid. The level between the
/// cells would not do: it misses an eighth of a ball of radius 2 cells.
pub fn first_markers(
    grid: &Grid,
    solid_distance: &[f64],
    level: &[f64],
    inside: impl Fn(DVec3) -> bool + Sync,
    seed: u32,
) -> Vec<[f64; 3]> {
    let within = |x: DVec3| grid.sample_cells(level, x) >= -BAND && inside(x);
    let may = |cell: usize| (-BAND - MARGIN_OF_CELLS..MARGIN_OF_CELLS).contains(&level[cell]);
    sites_where(grid, solid_distance, [seed, u32::MAX], may, within)
}

/// The sites outside bodies that pass, m, in the order of the cells that may contain some.
fn sites_where(
    grid: &Grid,
    solid_distance: &[f64],
    numbers: [u32; 2],
    may: impl Fn(usize) -> bool + Sync,
    passes: impl Fn(DVec3) -> bool + Sync,
) -> Vec<[f64; 3]> {
    let of_cell = |cell: usize| {
        let sites = (0..PER_EDGE.pow(3)).map(|number| site(grid, numbers, cell, number));
        let free = |&x: &DVec3| passes(x) && grid.sample_cells(solid_distance, x) >= 0.0;
        sites.filter(free).map(|x| x.to_array()).collect::<Vec<_>>()
    };
    let cells = (0..grid.n_cells()).into_par_iter().filter(|&cell| may(cell));
    let sites: Vec<Vec<[f64; 3]>> = cells.map(of_cell).collect();
    sites.concat()
}

/// A jittered site of a cell, m.
fn site(grid: &Grid, [seed, step]: [u32; 2], cell: usize, number: usize) -> DVec3 {
    let jitter = |axis: u32| {
        let bits = hash(&[seed, step, cell as u32, number as u32, axis]);
        // The upper 24 bits, scaled to [0, 1).
        f64::from(bits >> 8) / f64::from(1 << 24)
    };
    let within = DVec3::from([0, 1, 2].map(|axis| {
        let part = (number >> axis & 1) as f64;
        (part + MARGIN + (1.0 - 2.0 * MARGIN) * jitter(axis)) / PER_EDGE as f64
    }));
    let corner = DVec3::from(grid.cell_at(cell).map(|n| n as f64));
    (corner + within) * grid.dx
}

/// The cell of a point (m).
pub fn cell_of(grid: &Grid, x: impl Into<DVec3>) -> usize {
    let x = x.into();
    grid.cell(std::array::from_fn(|a| ((x[a] / grid.dx) as usize).min(grid.cells[a] - 1)))
}
