//! The rows of a comparison: per quantity the worst place of all sub-steps.

use std::fmt;

use glam::DVec3;

use crate::grid::{Axis, Grid};

/// Where a number is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// One number for all.
    Whole,
    /// A cell and its centre, m.
    Cell([usize; 3], DVec3),
    /// A face and its centre, m.
    Face(Axis, [usize; 3], DVec3),
    /// A marker and where it started, m.
    Marker(usize, DVec3),
    /// A node of a solid and where it is at rest, m.
    Node(usize, DVec3),
    /// An element of a solid.
    Element(usize),
    /// A column of probes.csv.
    Column(usize),
}

impl Place {
    /// The place of a cell with a host index.
    pub(super) fn cell(grid: &Grid, cell: usize) -> Place {
        let ijk = grid.cell_at(cell);
        Place::Cell(ijk, grid.cell_centre(ijk))
    }

    /// The place of a face with a host index.
    pub(super) fn face(grid: &Grid, axis: Axis, face: usize) -> Place {
        let ijk = grid.face_at(axis, face);
        Place::Face(axis, ijk, grid.face_centre(axis, ijk))
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let at = |x: &DVec3| format!("({:.4}, {:.4}, {:.4}) m", x.x, x.y, x.z);
        match self {
            Place::Whole => Ok(()),
            Place::Cell(ijk, x) => write!(f, "cell {ijk:?} at {}", at(x)),
            Place::Face(axis, ijk, x) => write!(f, "{axis:?} face {ijk:?} at {}", at(x)),
            Place::Marker(index, x) => write!(f, "marker {index} from {}", at(x)),
            Place::Node(node, x) => write!(f, "node {node}, at rest at {}", at(x)),
            Place::Element(element) => write!(f, "element {element}"),
            Place::Column(column) => write!(f, "column {column}"),
        }
    }
}

/// A number of both paths: worst first by difference over bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Worst {
    /// On the GPU.
    pub gpu: f64,
    /// In the twin.
    pub twin: f64,
    /// What rounding explains.
    pub bound: f64,
    /// Where.
    pub place: Place,
    /// Sub-step, from 0.
    pub step: u64,
}

impl Worst {
    /// Difference over bound; above 1 is a breach. Infinite where a side or the bound is not finite.
    pub fn ratio(&self) -> f64 {
        let difference = (self.gpu - self.twin).abs();
        if difference == 0.0 {
            0.0
        } else if !difference.is_finite() || !self.bound.is_finite() {
            f64::INFINITY
        } else {
            difference / self.bound
        }
    }
}

/// Share of a row's numbers that may be excused.
///
/// A decision hangs on a rounding where a position lies within its error of a plane of the grid. A position of n cells is off by
/// 3 n 2^-24 cells, so a marker lies that near to one of three planes with a probability of 18 n 2^-24: 1e-4 on 100 cells. The
/// distance of a cell depends on some 216 markers, so 2 % of cells have such a marker. The cap allows for one in ten of these to be the nearest.
/// Thirteen runs of the scenes that the tests compare excuse none.
pub const MOST_EXCUSED: f64 = 2e-3;

/// A quantity of a stage.
#[derive(Clone, Debug)]
pub struct Row {
    /// The stage, by its canonical noun.
    pub stage: &'static str,
    /// What it makes.
    pub quantity: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Numbers compared, in all sub-steps.
    pub count: u64,
    /// Numbers left out, because a decision hangs on a rounding and either outcome is right.
    pub excused: u64,
    /// Largest difference anywhere.
    pub largest: f64,
    /// The one with the largest difference over bound.
    pub worst: Option<Worst>,
    sum_of_squares: f64,
}

/// A flag as a number of a row.
pub(super) fn number(flag: bool) -> f64 {
    f64::from(u8::from(flag))
}

impl Row {
    fn new(stage: &'static str, quantity: &'static str, unit: &'static str) -> Row {
        Row {
            stage,
            quantity,
            unit,
            count: 0,
            excused: 0,
            largest: 0.0,
            worst: None,
            sum_of_squares: 0.0,
        }
    }

    /// Root of the mean square of the differences.
    pub fn rms(&self) -> f64 {
        if self.count == 0 {
            0.0
        } else {
            (self.sum_of_squares / self.count as f64).sqrt()
        }
    }

    /// Largest difference over bound.
    pub fn ratio(&self) -> f64 {
        self.worst.map_or(0.0, |worst| worst.ratio())
    }

    /// Numbers that may be excused: [`MOST_EXCUSED`] of all, or one where that is less.
    pub fn most_excused(&self) -> u64 {
        let all = (self.count + self.excused) as f64;
        ((MOST_EXCUSED * all) as u64).max(1)
    }

    /// Whether more is excused than may be, or nothing is left that was compared.
    pub fn excuses_too_much(&self) -> bool {
        self.excused > self.most_excused() || (self.count == 0 && self.excused > 0)
    }

    /// Whether a difference is larger than rounding explains, or too many are excused.
    pub fn breached(&self) -> bool {
        self.ratio() > 1.0 || self.excuses_too_much()
    }

    /// Takes a pair in.
    pub(super) fn add(&mut self, pair: Worst) {
        let difference = (pair.gpu - pair.twin).abs();
        self.count += 1;
        self.sum_of_squares += difference * difference;
        if difference > self.largest || difference.is_nan() {
            self.largest = difference;
        }
        if self.worst.is_none_or(|worst| pair.ratio() > worst.ratio()) {
            self.worst = Some(pair);
        }
    }
}

/// The rows, in order of first appearance.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    pub(super) rows: Vec<Row>,
    pub(super) step: u64,
}

impl Table {
    /// A row, made when first asked for.
    pub(super) fn row(
        &mut self,
        stage: &'static str,
        quantity: &'static str,
        unit: &'static str,
    ) -> &mut Row {
        let known = |row: &Row| row.stage == stage && row.quantity == quantity;
        let index = self.rows.iter().position(known).unwrap_or_else(|| {
            self.rows.push(Row::new(stage, quantity, unit));
            self.rows.len() - 1
        });
        &mut self.rows[index]
    }

    /// Takes (GPU, twin, bound, place) into a row.
    pub(super) fn add(
        &mut self,
        [stage, quantity, unit]: [&'static str; 3],
        pairs: impl IntoIterator<Item = (f64, f64, f64, Place)>,
    ) {
        let step = self.step;
        let row = self.row(stage, quantity, unit);
        for (gpu, twin, bound, place) in pairs {
            row.add(Worst {
                gpu,
                twin,
                bound,
                place,
                step,
            });
        }
    }

    /// Takes yes-or-no answers into a row: they must agree everywhere.
    pub(super) fn add_flags(
        &mut self,
        [stage, quantity]: [&'static str; 2],
        pairs: impl IntoIterator<Item = (bool, bool, Place)>,
    ) {
        let pairs = pairs
            .into_iter()
            .map(|(gpu, twin, place)| (number(gpu), number(twin), 0.0, place));
        self.add([stage, quantity, "flag"], pairs);
    }

    /// Takes one number of all: GPU, twin, bound.
    pub(super) fn whole(&mut self, row: [&'static str; 3], gpu: f64, twin: f64, bound: f64) {
        self.add(row, [(gpu, twin, bound, Place::Whole)]);
    }

    /// Takes the (GPU, twin, bound) of each cell that has them.
    pub(super) fn cells(
        &mut self,
        grid: &Grid,
        row: [&'static str; 3],
        numbers: impl Fn(usize) -> Option<(f64, f64, f64)>,
    ) {
        let cells = (0..grid.n_cells()).filter_map(|cell| {
            let (gpu, twin, bound) = numbers(cell)?;
            Some((gpu, twin, bound, Place::cell(grid, cell)))
        });
        self.add(row, cells);
    }

    /// Takes the (GPU, twin, bound) of each face that has them, by axis and index.
    pub(super) fn faces(
        &mut self,
        grid: &Grid,
        row: [&'static str; 3],
        numbers: impl Fn(usize, usize) -> Option<(f64, f64, f64)>,
    ) {
        for axis in Axis::ALL {
            let faces = (0..grid.n_faces(axis)).filter_map(|face| {
                let (gpu, twin, bound) = numbers(axis.index(), face)?;
                Some((gpu, twin, bound, Place::face(grid, axis, face)))
            });
            self.add(row, faces);
        }
    }
}
