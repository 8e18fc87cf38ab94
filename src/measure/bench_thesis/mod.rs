//! `bench thesis`: tables of the thesis's chapter 6 beside what they are here.
//!
//! Table 6.1 (`scenes`): grids, meshes and sub-steps of the scenes. Tables 6.2 to 6.4 (`systems`): matrices and solves of the
//! formulations on states of the dam break. Tables 6.5 and 6.6 (`accuracy`): errors of a sub-step whose answer is known.

mod accuracy;
mod condition;
mod parts;
mod picture;
mod scenes;
mod systems;

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::Error;
use crate::gpu::{AdapterChoice, Gpu};
use crate::output::FolderLock;
use crate::scene::Precision;

use super::bench_solve::name;
use super::table::{Machine, remove_earlier, write_csv, write_json, write_svg};

pub use accuracy::{Order, Row};
pub use condition::{Condition, Conditions, conditions};
pub use parts::Part;
pub use scenes::SceneRow;
pub use systems::{Growth, Mean, SystemRow};

/// Relative, of the true residuals.
const TOLERANCE: f64 = 1e-10;
const MOST_ITERATIONS: u32 = 20_000;
/// Runs are not repeated that have taken so long, s.
const PATIENCE: f64 = 20.0;

/// A table of the thesis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ThesisTable {
    /// Cells, nodes and elements of the scenes, with the seconds of a step.
    T6_1,
    /// Nonzeros, condition numbers and solves of the indefinite and the positive definite form.
    T6_2,
    /// Seconds per frame with velocities and with stresses as unknowns.
    T6_3,
    /// Nonzeros of both.
    T6_4,
    /// Errors of a soft block, narrower than at rest.
    T6_5,
    /// Of a stiff one, wider than at rest.
    T6_6,
}

impl ThesisTable {
    /// Its number.
    pub fn number(self) -> &'static str {
        match self {
            ThesisTable::T6_1 => "6.1",
            ThesisTable::T6_2 => "6.2",
            ThesisTable::T6_3 => "6.3",
            ThesisTable::T6_4 => "6.4",
            ThesisTable::T6_5 => "6.5",
            ThesisTable::T6_6 => "6.6",
        }
    }

    /// Whether it is of states of the dam break.
    fn of_systems(self) -> bool {
        matches!(
            self,
            ThesisTable::T6_2 | ThesisTable::T6_3 | ThesisTable::T6_4
        )
    }

    /// Grids that are measured where none are asked for: those of the thesis that take minutes on two cores. Scenes have their own.
    fn grids(self) -> &'static [usize] {
        match self {
            ThesisTable::T6_1 => &[],
            ThesisTable::T6_2 => &[40, 60],
            ThesisTable::T6_3 | ThesisTable::T6_4 => &[50, 60],
            ThesisTable::T6_5 | ThesisTable::T6_6 => &[5, 10, 20, 40, 80],
        }
    }

    fn ensure_grid(self, grid: usize) -> Result<(), Error> {
        let (fits, problem, cure) = match self.of_systems() {
            true => (
                (8..=256).contains(&grid),
                "the dam break is too coarse or too large",
                "give cells from 8 to 256, such as those of the thesis: 40 to 90",
            ),
            false => (
                (5..=320).contains(&grid) && grid.is_multiple_of(5),
                "the liquid's surface at 0.8 m and the walls do not lie on faces of such cells",
                "give multiples of 5 up to 320",
            ),
        };
        if fits {
            return Ok(());
        }
        let what = format!("--grids {grid} for table {}", self.number());
        Err(Error::input(what, problem, cure))
    }
}

/// What to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Tables.
    pub tables: Vec<ThesisTable>,
    /// Cells along an edge of the dam break, or along the tank's height of 1 m, ascending; each table's own where there are none.
    pub grids: Vec<usize>,
    /// Folder of the scenes of table 6.1.
    pub scenes: PathBuf,
    /// What their cells are multiplied by along each axis.
    pub scale: f64,
    /// Sub-steps of each that are timed, from its start, after one that compiles.
    pub steps: usize,
    /// Frames of the dam break whose states are taken, ascending.
    pub frames: Vec<u64>,
    /// Of the device, beside the f64 path; those that the adapter lacks are left out.
    pub precisions: Vec<Precision>,
    /// Timed runs per row; no more are begun where they have taken 20 s.
    pub repeats: usize,
    /// Where.
    pub adapter: AdapterChoice,
    /// Whether the rows of tables 6.2 to 6.4 that earlier runs have left in the folder stay, and only the others are measured. Those runs must have
    /// had the sources, machine, precisions and repeats of this one; tables, grids and frames may be others.
    pub resume: bool,
}

impl Options {
    fn grids_of(&self, table: ThesisTable) -> Vec<usize> {
        match self.grids.is_empty() || table == ThesisTable::T6_1 {
            true => table.grids().to_vec(),
            false => self.grids.clone(),
        }
    }
}

/// The tables and where they were measured.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// Where and, of the last run, when.
    #[serde(flatten)]
    pub machine: Machine,
    /// Of the device, as rows name them, in the order of their names.
    pub precisions: Vec<&'static str>,
    /// Timed runs per row.
    pub repeats: usize,
    /// The runs that measured the rows, first to last: several where rows were kept.
    pub parts: Vec<Part>,
    /// Of table 6.1: a row per scene and precision.
    pub scenes: Vec<SceneRow>,
    /// Of tables 6.5 and 6.6: a row per table, grid, patch pressure and path.
    pub rows: Vec<Row>,
    /// A row per series of at least two grids, and the thesis's own.
    pub orders: Vec<Order>,
    /// Of tables 6.2 to 6.4: a row per table, grid, beam, state and solver.
    pub systems: Vec<SystemRow>,
    /// Their numbers beside the printed ones.
    pub means: Vec<Mean>,
    /// A row per number that is measured on at least two grids.
    pub growth: Vec<Growth>,
}

impl Table {
    /// Without rows.
    fn new(machine: Machine, precisions: Vec<&'static str>, repeats: usize) -> Table {
        Table {
            machine,
            precisions,
            repeats,
            parts: Vec::new(),
            scenes: Vec::new(),
            rows: Vec::new(),
            orders: Vec::new(),
            systems: Vec::new(),
            means: Vec::new(),
            growth: Vec::new(),
        }
    }
}

/// A row as it is measured.
#[derive(Clone, Copy, Debug)]
pub enum Told<'a> {
    /// Of table 6.1.
    Scene(&'a SceneRow),
    /// Of tables 6.2 to 6.4.
    System(&'a SystemRow),
    /// Of tables 6.5 and 6.6.
    Accuracy(&'a Row),
}

/// Measures all rows and writes into `out`, anew after each: thesis.json, for table 6.1 thesis_scenes.csv, for tables 6.2 to 6.4
/// thesis_systems.csv, thesis_means.csv and thesis_growth.csv, for tables 6.5 and 6.6 thesis.csv and thesis_orders.csv, and for all but table 6.1
/// thesis.svg. What an earlier run has left of these is removed first, but with `resume`. `tell` hears of each row.
///
/// # Errors
/// [`Error::Input`] for grids and frames that the problems do not have, scenes that are not there, and rows to resume from that are not of these
/// sources and machine, these precisions and repeats; [`Error::Output`], and what the simulations say.
pub fn bench_thesis(
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(Told),
) -> Result<Table, Error> {
    for &table in &options.tables {
        for grid in options.grids_of(table) {
            table.ensure_grid(grid)?;
        }
    }
    if options.tables.iter().any(|table| table.of_systems()) {
        for &frame in &options.frames {
            systems::ensure_frame(frame)?;
        }
    }
    let gpu = Gpu::new(&options.adapter)?;
    let scenes = scenes::load(options, gpu.has_f64())?;
    let _held = FolderLock::take(out)?;
    let precisions = options.precisions.iter();
    let mut precisions: Vec<&'static str> = precisions.map(|&precision| name(precision)).collect();
    precisions.sort_unstable();
    precisions.dedup();
    let machine = Machine::new(&gpu, options.repeats)?;
    let mut table = Table::new(machine, precisions, options.repeats);
    match options.resume {
        true => {
            table.take_up(out)?;
            remove_earlier(out, &parts::NOT_KEPT)?;
        }
        false => remove_earlier(out, &parts::FILES)?,
    }
    let kept = table.systems.clone();
    scenes::measure(&scenes, options, &mut |row| {
        tell(Told::Scene(&row));
        table.scenes.push(row);
        table.write_measured(options, out)
    })?;
    systems::measure(options, &kept, &mut |rows| {
        rows.iter().for_each(|row| tell(Told::System(row)));
        table.systems.extend(rows);
        table.write_measured(options, out)
    })?;
    accuracy::measure(options, &mut |row| {
        tell(Told::Accuracy(&row));
        table.rows.push(row);
        table.write_measured(options, out)
    })?;
    // Also where nothing was left to measure.
    table.write(options, out)?;
    Ok(table)
}

impl Table {
    /// Writes what there is with rows of this run, which is a part from the first of them on.
    fn write_measured(&mut self, options: &Options, out: &Path) -> Result<(), Error> {
        let part = Part::of(&self.machine);
        if self.parts.last() != Some(&part) {
            self.parts.push(part);
        }
        self.write(options, out)
    }

    /// Makes again what follows from the rows, and writes what there is.
    fn write(&mut self, options: &Options, out: &Path) -> Result<(), Error> {
        self.systems
            .sort_by_key(|row| (row.table, row.grid, row.nodes, row.frame));
        self.means = systems::means(&self.systems);
        self.growth = systems::growth(&self.means);
        self.orders = accuracy::orders(&self.rows, &options.tables);
        // First, for rows cannot be resumed from without it.
        write_json(self, &out.join("thesis.json"))?;
        write_csv(&self.scenes, &out.join("thesis_scenes.csv"))?;
        write_csv(&self.systems, &out.join("thesis_systems.csv"))?;
        write_csv(&self.means, &out.join("thesis_means.csv"))?;
        write_csv(&self.growth, &out.join("thesis_growth.csv"))?;
        write_csv(&self.rows, &out.join("thesis.csv"))?;
        write_csv(&self.orders, &out.join("thesis_orders.csv"))?;
        let charts = picture::charts(self, &options.tables);
        if charts.is_empty() {
            return Ok(());
        }
        write_svg(&out.join("thesis.svg"), picture::size(&charts), |page| {
            picture::draw(&charts, page)
        })
    }
}
