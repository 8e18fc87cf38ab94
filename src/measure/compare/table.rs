//! Rows of a comparison: per quantity the worst place of all sub-steps.

use std::fmt;

use glam::DVec3;

use crate::grid::{Axis, Grid};

/// Place of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// One number for all.
    Whole,
    /// A cell and its centre, m.
    Cell([usize; 3], DVec3),
    /// A face and its centre, m.
    Face(Axis, [usize; 3], DVec3),
    /// A marker and its start, m.
    Marker(usize, DVec3),
    /// A node of a solid and its position at rest, m.
    Node(usize, DVec3),
    /// An element of a solid.
    Element(usize),
    /// A column of probes.csv.
    Column(usize),
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

/// The same number on both paths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Worst {
    /// Value on the GPU.
    pub gpu: f64,
    /// Value of the twin.
    pub twin: f64,
    /// Largest difference that rounding explains.
    pub bound: f64,
    /// Its place.
    pub place: Place,
    /// Sub-step, from 0.
    pub step: u64,
}

impl Worst {
    /// Difference over bound; above 1 is a breach. Infinite if a value or the bound is not finite.
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
/// A decision depends on rounding where a position lies within its error of a plane of the grid. A position of n cells is off by 3 n 2^-24
/// cells, so a marker lies that near to one of three planes with a probability of 18 n 2^-24: 1e-4 on 100 cells. The distance of a cell depends
/// on some 216 markers, so 2 % of the cells have such a marker. The cap allows one in ten of these to be the nearest. Thirteen runs of the
/// scenes that the tests compare excuse none.
pub const MOST_EXCUSED: f64 = 2e-3;

/// A quantity of a stage.
#[derive(Clone, Debug, Default)]
pub struct Row {
    /// Name of the stage.
    pub stage: &'static str,
    /// Name of the quantity.
    pub quantity: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Numbers compared in all sub-steps.
    pub count: u64,
    /// Numbers left out: a decision depends on rounding, and either outcome is right.
    pub excused: u64,
    /// Largest difference.
    pub largest: f64,
    /// Number with the largest difference over bound.
    pub worst: Option<Worst>,
    sum_of_squares: f64,
}

/// A flag as a number of a row.
pub(super) fn number(flag: bool) -> f64 {
    f64::from(u8::from(flag))
}

impl Row {
    /// Root mean square of the differences.
    pub fn rms(&self) -> f64 {
        (self.sum_of_squares / self.count.max(1) as f64).sqrt()
    }

    /// Largest difference over bound.
    pub fn ratio(&self) -> f64 {
        self.worst.map_or(0.0, |worst| worst.ratio())
    }

    /// Largest allowed number of excused values: [`MOST_EXCUSED`] of all, at least one.
    pub fn most_excused(&self) -> u64 {
        let all = (self.count + self.excused) as f64;
        ((MOST_EXCUSED * all) as u64).max(1)
    }

    /// Whether too many numbers are excused, or none is left to compare.
    pub fn excuses_too_much(&self) -> bool {
        self.excused > self.most_excused() || (self.count == 0 && self.excused > 0)
    }

    /// Whether rounding does not explain a difference, or too many numbers are excused.
    pub fn breached(&self) -> bool {
        self.ratio() > 1.0 || self.excuses_too_much()
    }
}

/// A number on both paths: GPU, twin, bound.
pub(super) type Numbers = (f64, f64, f64);
/// The same with its place.
pub(super) type Pair = (f64, f64, f64, Place);

/// The components of a vector on both paths.
pub(super) fn components(gpu: [f64; 3], twin: [f64; 3], bound: f64, place: Place) -> [Pair; 3] {
    [0, 1, 2].map(|a| (gpu[a], twin[a], bound, place))
}

/// A flag on both paths, which must agree.
pub(super) fn flag(gpu: bool, twin: bool, place: Place) -> Pair {
    (number(gpu), number(twin), 0.0, place)
}

/// Name of a quantity and its unit.
pub(super) type Quantity = [&'static str; 2];

/// Rows in order of first appearance.
#[derive(Clone, Debug)]
pub(super) struct Table {
    /// The cells and faces of the numbers.
    grid: Grid,
    pub(super) rows: Vec<Row>,
    /// Current sub-step.
    pub(super) step: u64,
    /// Stage of new numbers.
    pub(super) stage: &'static str,
}

impl Table {
    pub(super) fn new(grid: Grid) -> Table {
        Table { grid, rows: Vec::new(), step: 0, stage: "" }
    }

    /// Row of a quantity of the current stage.
    pub(super) fn row(&mut self, [quantity, unit]: Quantity) -> &mut Row {
        let stage = self.stage;
        let known = |row: &Row| row.stage == stage && row.quantity == quantity;
        let index = self.rows.iter().position(known).unwrap_or_else(|| {
            self.rows.push(Row { stage, quantity, unit, ..Row::default() });
            self.rows.len() - 1
        });
        &mut self.rows[index]
    }

    /// Adds pairs to a row, and excuses those that are `None`.
    pub(super) fn add<P: Into<Option<Pair>>>(&mut self, quantity: Quantity, pairs: impl IntoIterator<Item = P>) {
        let step = self.step;
        let row = self.row(quantity);
        for pair in pairs {
            let Some((gpu, twin, bound, place)) = pair.into() else {
                row.excused += 1;
                continue;
            };
            let (pair, difference) = (Worst { gpu, twin, bound, place, step }, (gpu - twin).abs());
            row.count += 1;
            row.sum_of_squares += difference * difference;
            if difference > row.largest || difference.is_nan() {
                row.largest = difference;
            }
            if row.worst.is_none_or(|worst| pair.ratio() > worst.ratio()) {
                row.worst = Some(pair);
            }
        }
    }

    /// Adds one number without a place: GPU, twin, bound.
    pub(super) fn whole(&mut self, quantity: Quantity, gpu: f64, twin: f64, bound: f64) {
        self.add(quantity, [(gpu, twin, bound, Place::Whole)]);
    }

    /// Adds such numbers: quantity, unit, GPU, twin, bound.
    pub(super) fn wholes<const N: usize>(&mut self, numbers: [(&'static str, &'static str, f64, f64, f64); N]) {
        for (quantity, unit, gpu, twin, bound) in numbers {
            self.whole([quantity, unit], gpu, twin, bound);
        }
    }

    /// Adds the numbers of each cell that has them; `Some(None)` is excused.
    pub(super) fn cells<N>(&mut self, quantity: Quantity, numbers: impl Fn(usize) -> Option<N>)
    where
        N: Into<Option<Numbers>>,
    {
        let grid = self.grid;
        let pair = |cell, (gpu, twin, bound)| {
            let ijk = grid.cell_at(cell);
            (gpu, twin, bound, Place::Cell(ijk, grid.cell_centre(ijk)))
        };
        let cells = (0..grid.n_cells()).filter_map(|cell| Some((cell, numbers(cell)?.into())));
        self.add(quantity, cells.map(|(cell, numbers)| numbers.map(|numbers| pair(cell, numbers))));
    }

    /// Adds a flag of each cell on both paths.
    pub(super) fn cell_flags(&mut self, quantity: &'static str, gpu: &[bool], twin: &[bool]) {
        self.cells([quantity, "flag"], |cell| Some((number(gpu[cell]), number(twin[cell]), 0.0)));
    }

    /// Adds the numbers of each face that has them, by axis and index; `Some(None)` is excused.
    pub(super) fn faces<N>(&mut self, quantity: Quantity, numbers: impl Fn(usize, usize) -> Option<N>)
    where
        N: Into<Option<Numbers>>,
    {
        let grid = self.grid;
        for axis in Axis::ALL {
            let pair = |face, (gpu, twin, bound)| {
                let ijk = grid.face_at(axis, face);
                (gpu, twin, bound, Place::Face(axis, ijk, grid.face_centre(axis, ijk)))
            };
            let faces = (0..grid.n_faces(axis)).filter_map(|face| Some((face, numbers(axis.index(), face)?.into())));
            self.add(quantity, faces.map(|(face, numbers)| numbers.map(|numbers| pair(face, numbers))));
        }
    }

    /// Adds a vector per node, with a bound per node and axis. `rest`: positions at rest, m.
    pub(super) fn nodes(
        &mut self,
        rest: &[DVec3],
        quantity: Quantity,
        [gpu, twin]: [&[[f64; 3]]; 2],
        bound: impl Fn(usize, usize) -> f64,
    ) {
        let pairs = (0..gpu.len())
            .flat_map(|node| (0..3).map(move |axis| (node, axis)))
            .map(|(node, axis)| (gpu[node][axis], twin[node][axis], bound(node, axis), Place::Node(node, rest[node])));
        self.add(quantity, pairs);
    }
}
