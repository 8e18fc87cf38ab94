//! `liquid_distance`: the union of spheres around the markers (Zhu and Bridson 2005), extended into the obstacles. A level
//! set is only extended.
//!
//! phi = min(2 dx, distance to the nearest marker) - r at cell centres. Deep inside phi = -dx. A cell is deep if each of
//! the 27 cells around it contains a marker, is outside the domain or has its centre in an obstacle. Values inside
//! obstacles are undefined, but ghost-fluid faces in cut cells need them. They are recomputed from known neighbours n at
//! offset o_n across faces of aperture w_n, and from their neighbours across w_nm:
//!
//! ```text
//! phi = sum_n w_n (phi_n - g . o_n) / sum_n w_n    within the range of the phi_n
//! g = sum_nm w_n w_nm o_nm (phi_m - phi_n) / (1 + sum_nm w_n w_nm)    per axis, over the pairs along it
//! ```
//!
//! A mean without slopes places the surface too high where more is open below a centre than above: films of a tenth of a
//! cell would be up to half a cell above the level. The 1 in the denominator is one open pair of slope 0: a few pairs
//! alone measure the bumps of the spheres, not the surface. Levels have smooth slopes: for them it is 0, and the result
//! may leave the range by a cell. Cells of bodies that no open face leads to take a level over closed faces, all with w = 1:
//! transport and volumes interpolate between centres on both sides of a face. With air there, every sub-step removed liquid beside
//! moving bodies. The limitation to the range prevents growth of noise from pass to pass. Two alternatives
//! move water at rest by up to 76 g dt: a decision by markers in the cell, and a minimum over neighbours.

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use crate::geometry::CutCells;
use crate::grid::{Axis, Grid};

/// Largest distance of a marker that counts, cells.
const REACH: f64 = 2.0;
/// Depth of the extension into obstacles, cells.
const EXTENSION_PASSES: usize = 3;

/// phi per cell (m) from markers (m) with spheres of `radius` (m), extended into the obstacles.
pub fn liquid_distance(grid: &Grid, cut: &CutCells, markers: &[[f64; 3]], radius: f64) -> Vec<f64> {
    let mut phi = union_of_spheres(grid, &cut.solid_distance, markers, radius);
    extend_spheres(grid, cut, |_| true, &mut phi);
    phi
}

/// Extends the distance (m) of spheres into obstacles. Cells that do not take part contribute nothing; in obstacles they become air, dx.
pub fn extend_spheres(grid: &Grid, cut: &CutCells, takes_part: impl Fn(usize) -> bool + Sync, phi: &mut [f64]) {
    let rule = Extension { flat_pairs: 1.0, overshoot: 0.0, through_closed: false, air: grid.dx };
    extend(grid, cut, rule, takes_part, phi);
}

/// phi per cell (m) before the extension. `solid_distance`: per cell, m; `markers` and `radius` in m.
pub fn union_of_spheres(grid: &Grid, solid_distance: &[f64], markers: &[[f64; 3]], radius: f64) -> Vec<f64> {
    let bins = Bins::new(grid, markers);
    let full =
        |ijk: IVec3| inside(grid, ijk).is_none_or(|cell| !bins.markers(cell).is_empty() || solid_distance[cell] < 0.0);
    let reach = REACH * grid.dx;
    let cells = (0..grid.n_cells()).into_par_iter();
    let phi = cells.map(|cell| {
        let ijk = IVec3::from(grid.cell_at(cell).map(|n| n as i32));
        if block(1).all(|offset| full(ijk + offset)) {
            return -grid.dx;
        }
        let centre = grid.cell_centre(grid.cell_at(cell));
        // All points within two cells of the centre are in the 5 x 5 x 5 cells around it.
        let near = block(REACH.ceil() as i32).filter_map(|offset| inside(grid, ijk + offset));
        let distances =
            near.flat_map(|cell| bins.markers(cell)).map(|&marker| centre.distance(DVec3::from(markers[marker])));
        distances.fold(reach, f64::min) - radius
    });
    phi.collect()
}

/// Constants of the extension into obstacles.
#[derive(Clone, Copy)]
struct Extension {
    /// Pairs of slope 0 in the mean of the slopes.
    flat_pairs: f64,
    /// Distance beyond the range of the neighbours, in units of phi.
    overshoot: f64,
    /// Whether closed faces count as open, all with aperture 1, where no open face leads to a known cell.
    through_closed: bool,
    /// Value of cells that no pass reaches.
    air: f64,
}

/// Extends a level (cells) into obstacles, with its slope: it has no bumps.
pub fn extend_level(grid: &Grid, cut: &CutCells, level: &mut [f64]) {
    let rule = Extension { flat_pairs: 0.0, overshoot: 1.0, through_closed: true, air: 1.0 };
    extend(grid, cut, rule, |_| true, level);
}

/// Recomputes phi in cells with their centre in an obstacle; air if no pass reaches them.
fn extend(grid: &Grid, cut: &CutCells, rule: Extension, takes_part: impl Fn(usize) -> bool + Sync, phi: &mut [f64]) {
    let outside = |cell: usize| cut.solid_distance[cell] >= 0.0;
    let mut known: Vec<bool> = (0..phi.len()).map(|cell| outside(cell) && takes_part(cell)).collect();
    let mut unknown: Vec<usize> = (0..phi.len()).filter(|&cell| !outside(cell)).collect();
    for _ in 0..EXTENSION_PASSES {
        let value = |&cell: &usize| {
            let through = |closed: bool| from_neighbours(grid, cut, rule, phi, &known, cell, closed);
            let value = || through(false).or_else(|| rule.through_closed.then(|| through(true)).flatten());
            takes_part(cell).then(value).flatten()
        };
        let values: Vec<_> = unknown.par_iter().map(value).collect();
        for (&cell, value) in unknown.iter().zip(&values) {
            if let Some(value) = *value {
                phi[cell] = value;
                known[cell] = true;
            }
        }
        unknown.retain(|&cell| !known[cell]);
    }
    unknown.iter().for_each(|&cell| phi[cell] = rule.air);
}

/// A known cell across an open face.
struct Neighbour {
    cell: usize,
    axis: usize,
    /// Signed offset along the axis, cells.
    way: f64,
    open: f64,
}

/// The known cells across the open faces of a cell; with `closed` across all, with aperture 1.
fn neighbours<'a>(
    grid: &'a Grid,
    cut: &'a CutCells,
    known: &'a [bool],
    cell: usize,
    closed: bool,
) -> impl Iterator<Item = Neighbour> + 'a {
    let faces = Axis::ALL.into_iter().flat_map(|axis| [0, 1].map(|side| (axis, side)));
    faces.filter_map(move |(axis, side)| {
        let mut face = grid.cell_at(cell);
        face[axis.index()] += side;
        let neighbour = grid.face_sides(axis, face)[side].filter(|&cell| known[cell])?;
        let open = if closed { 1.0 } else { cut.open[axis.index()][grid.face(axis, face)] };
        (open > 0.0).then_some(Neighbour {
            cell: neighbour,
            axis: axis.index(),
            way: if side == 1 { 1.0 } else { -1.0 },
            open,
        })
    })
}

/// phi at a centre in an obstacle from the known neighbours; `None` without any.
fn from_neighbours(
    grid: &Grid,
    cut: &CutCells,
    rule: Extension,
    phi: &[f64],
    known: &[bool],
    cell: usize,
    closed: bool,
) -> Option<f64> {
    let near: Vec<Neighbour> = neighbours(grid, cut, known, cell, closed).collect();
    let [mut slope, mut pairs] = [[0.0; 3]; 2];
    for n in &near {
        for m in neighbours(grid, cut, known, n.cell, false) {
            let weight = n.open * m.open;
            slope[m.axis] += weight * m.way * (phi[m.cell] - phi[n.cell]);
            pairs[m.axis] += weight;
        }
    }
    let slope = [0, 1, 2].map(|a| match rule.flat_pairs + pairs[a] {
        0.0 => 0.0,
        pairs => slope[a] / pairs,
    });
    let open: f64 = near.iter().map(|n| n.open).sum();
    let sum: f64 = near.iter().map(|n| n.open * (phi[n.cell] - n.way * slope[n.axis])).sum();
    let values = near.iter().map(|n| phi[n.cell]);
    let low = values.clone().fold(f64::INFINITY, f64::min);
    let high = values.fold(f64::NEG_INFINITY, f64::max);
    (open > 0.0).then(|| (sum / open).clamp(low - rule.overshoot, high + rule.overshoot))
}

/// Offsets of the cells up to `n` along every axis.
fn block(n: i32) -> impl Iterator<Item = IVec3> {
    (-n..=n).flat_map(move |z| (-n..=n).flat_map(move |y| (-n..=n).map(move |x| IVec3::new(x, y, z))))
}

/// Index of a cell; `None` outside the domain.
fn inside(grid: &Grid, ijk: IVec3) -> Option<usize> {
    let n = IVec3::from(grid.cells.map(|n| n as i32));
    (ijk.cmpge(IVec3::ZERO).all() && ijk.cmplt(n).all()).then(|| grid.cell(ijk.to_array().map(|n| n as usize)))
}

/// Markers sorted by cell, in order within each.
struct Bins {
    start: Vec<usize>,
    order: Vec<usize>,
}

impl Bins {
    fn new(grid: &Grid, markers: &[[f64; 3]]) -> Bins {
        let cell_of = |marker: &[f64; 3]| {
            let ijk: [usize; 3] = std::array::from_fn(|b| ((marker[b] / grid.dx) as usize).min(grid.cells[b] - 1));
            grid.cell(ijk)
        };
        let mut start = vec![0; grid.n_cells() + 1];
        markers.iter().for_each(|marker| start[cell_of(marker) + 1] += 1);
        (0..grid.n_cells()).for_each(|cell| start[cell + 1] += start[cell]);
        let mut next = start.clone();
        let mut order = vec![0; markers.len()];
        for (index, marker) in markers.iter().enumerate() {
            let slot = &mut next[cell_of(marker)];
            order[*slot] = index;
            *slot += 1;
        }
        Bins { start, order }
    }

    fn markers(&self, cell: usize) -> &[usize] {
        &self.order[self.start[cell]..self.start[cell + 1]]
    }
}
