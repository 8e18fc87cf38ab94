//! `liquid_distance`: the union of spheres around the markers (Zhu and Bridson 2005), extended into the obstacles.
//!
//! phi = min(2 dx, distance to the nearest marker) - r at cell centres. Deep inside, where all 27 cells around hold a marker, are
//! beyond the domain or have their centre in an obstacle, phi = -dx. The values inside obstacles say nothing about the
//! liquid, yet ghost-fluid faces in cut cells need them: they are discarded and made again from the liquid's side, from the known
//! neighbours n of a cell across faces that are open by w_n, o_n cells away, and theirs across w_nm:
//!
//! ```text
//! phi = sum_n w_n (phi_n - g . o_n) / sum_n w_n    within the range of the phi_n
//! g = sum_nm w_n w_nm o_nm (phi_m - phi_n) / (1 + sum_nm w_n w_nm)    per axis, over the pairs along it
//! ```
//!
//! The mean alone puts the surface too high where more is open below a centre than above: films of a tenth of a cell then stood
//! up to half a cell above the level, and fell. Slopes put it right; the 1 is worth one open pair that knows of no slope, since few
//! pairs tell more of the bumps of spheres than of the surface. Without the range, what is made of noise grows from pass to pass.
//! Deciding by whether a cell holds a marker, or pushing values down with a minimum, moved water at rest by up to 76 g dt.

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use crate::geometry::CutCells;
use crate::grid::{Axis, Grid};

/// Markers further away than this do not count, in cells.
const REACH: f64 = 2.0;
/// How many cells deep the distance is extended into obstacles.
const EXTENSION_PASSES: usize = 3;

/// phi per cell from markers (m), with `radius` in m, extended into the obstacles.
pub fn liquid_distance(grid: &Grid, cut: &CutCells, markers: &[[f64; 3]], radius: f64) -> Vec<f64> {
    let mut phi = union_of_spheres(grid, &cut.solid_distance, markers, radius);
    extend(grid, cut, &mut phi);
    phi
}

/// phi per cell, not yet extended.
fn union_of_spheres(
    grid: &Grid,
    solid_distance: &[f64],
    markers: &[[f64; 3]],
    radius: f64,
) -> Vec<f64> {
    let bins = Bins::new(grid, markers);
    let full = |ijk: IVec3| {
        inside(grid, ijk)
            .is_none_or(|cell| !bins.markers(cell).is_empty() || solid_distance[cell] < 0.0)
    };
    let reach = REACH * grid.dx;
    let cells = (0..grid.n_cells()).into_par_iter();
    let phi = cells.map(|cell| {
        let ijk = IVec3::from(grid.cell_at(cell).map(|n| n as i32));
        if block(1).all(|offset| full(ijk + offset)) {
            return -grid.dx;
        }
        let centre = grid.cell_centre(grid.cell_at(cell));
        // What is within two cells of the centre lies in the 5 x 5 x 5 cells around it.
        let near = block(REACH.ceil() as i32).filter_map(|offset| inside(grid, ijk + offset));
        let distances = near
            .flat_map(|cell| bins.markers(cell))
            .map(|&marker| centre.distance(DVec3::from(markers[marker])));
        distances.fold(reach, f64::min) - radius
    });
    phi.collect()
}

/// Discards phi where the centre lies in an obstacle and makes it again from the neighbours; air where none is reached.
fn extend(grid: &Grid, cut: &CutCells, phi: &mut [f64]) {
    let outside = |distance: &f64| *distance >= 0.0;
    let mut known: Vec<bool> = cut.solid_distance.iter().map(outside).collect();
    let mut unknown: Vec<usize> = (0..phi.len()).filter(|&cell| !known[cell]).collect();
    for _ in 0..EXTENSION_PASSES {
        let values: Vec<_> = unknown
            .par_iter()
            .map(|&cell| from_neighbours(grid, cut, phi, &known, cell))
            .collect();
        for (&cell, value) in unknown.iter().zip(&values) {
            if let Some(value) = *value {
                phi[cell] = value;
                known[cell] = true;
            }
        }
        unknown.retain(|&cell| !known[cell]);
    }
    unknown.iter().for_each(|&cell| phi[cell] = grid.dx);
}

/// A known cell across an open face.
struct Neighbour {
    cell: usize,
    axis: usize,
    /// The way there along the axis, cells.
    way: f64,
    open: f64,
}

/// The known cells across the open faces of a cell.
fn neighbours<'a>(
    grid: &'a Grid,
    cut: &'a CutCells,
    known: &'a [bool],
    cell: usize,
) -> impl Iterator<Item = Neighbour> + 'a {
    let faces = Axis::ALL
        .into_iter()
        .flat_map(|axis| [0, 1].map(|side| (axis, side)));
    faces.filter_map(move |(axis, side)| {
        let mut face = grid.cell_at(cell);
        face[axis.index()] += side;
        let neighbour = grid.face_sides(axis, face)[side].filter(|&cell| known[cell])?;
        let open = cut.open[axis.index()][grid.face(axis, face)];
        (open > 0.0).then_some(Neighbour {
            cell: neighbour,
            axis: axis.index(),
            way: if side == 1 { 1.0 } else { -1.0 },
            open,
        })
    })
}

/// phi at a centre in an obstacle, from the known neighbours; none where there is none.
fn from_neighbours(
    grid: &Grid,
    cut: &CutCells,
    phi: &[f64],
    known: &[bool],
    cell: usize,
) -> Option<f64> {
    let near: Vec<Neighbour> = neighbours(grid, cut, known, cell).collect();
    let [mut slope, mut pairs] = [[0.0; 3]; 2];
    for n in &near {
        for m in neighbours(grid, cut, known, n.cell) {
            let weight = n.open * m.open;
            slope[m.axis] += weight * m.way * (phi[m.cell] - phi[n.cell]);
            pairs[m.axis] += weight;
        }
    }
    let slope = [0, 1, 2].map(|a| slope[a] / (1.0 + pairs[a]));
    let open: f64 = near.iter().map(|n| n.open).sum();
    let sum: f64 = near
        .iter()
        .map(|n| n.open * (phi[n.cell] - n.way * slope[n.axis]))
        .sum();
    let values = near.iter().map(|n| phi[n.cell]);
    let low = values.clone().fold(f64::INFINITY, f64::min);
    let high = values.fold(f64::NEG_INFINITY, f64::max);
    (open > 0.0).then(|| (sum / open).clamp(low, high))
}

/// Offsets of the cells up to `n` away along every axis.
fn block(n: i32) -> impl Iterator<Item = IVec3> {
    (-n..=n)
        .flat_map(move |z| (-n..=n).flat_map(move |y| (-n..=n).map(move |x| IVec3::new(x, y, z))))
}

/// The cell, unless it is beyond the domain.
fn inside(grid: &Grid, ijk: IVec3) -> Option<usize> {
    let n = IVec3::from(grid.cells.map(|n| n as i32));
    (ijk.cmpge(IVec3::ZERO).all() && ijk.cmplt(n).all())
        .then(|| grid.cell(ijk.to_array().map(|n| n as usize)))
}

/// Markers sorted by cell, in their order within one.
struct Bins {
    start: Vec<usize>,
    order: Vec<usize>,
}

impl Bins {
    fn new(grid: &Grid, markers: &[[f64; 3]]) -> Bins {
        let cell_of = |marker: &[f64; 3]| {
            let ijk: [usize; 3] =
                std::array::from_fn(|b| ((marker[b] / grid.dx) as usize).min(grid.cells[b] - 1));
            grid.cell(ijk)
        };
        let mut start = vec![0; grid.n_cells() + 1];
        markers
            .iter()
            .for_each(|marker| start[cell_of(marker) + 1] += 1);
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
