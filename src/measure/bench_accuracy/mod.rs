//! `bench accuracy`: what accuracy costs in time.
//!
//! On chosen states of chosen scenes ([`Row`]): a scene runs to a frame; the sub-step that follows is then done again and again from the same
//! state, in every precision, with every preconditioner, in every form of the corrections and to every tolerance, repeats in a shuffled
//! order. The solve is timed on the host from when the right-hand sides are in place to when the answer is. Its errors are those against two
//! truths: the direct solution in f64 of the system that the device stores in that precision, which is what the solver could do better, and the
//! same sub-step on the f64 path, which is what the whole path could do better. Systems of more than 60,000 unknowns have no direct solution:
//! theirs is refined to 1e-13.
//!
//! On grids ([`GridRow`]): problems whose pressure is known, from which errors are those of the whole simulation, grid and solve together.

mod exact;
mod grids;
mod picture;
mod states;
mod sub_step;

use std::fs;
use std::path::Path;

use serde::Serialize;

use crate::Error;
use crate::effects::Effects;
use crate::gpu::{AdapterChoice, Gpu};
use crate::scene::{CouplingScheme, Formulation, Precision, Preconditioner, Scene};
use crate::sim::{Backend, Simulation};

use super::table::{Machine, write_csv, write_json, write_svg};

pub use exact::{Exact, dam_release};
pub use grids::{Enough, GridBest, GridRow};
pub use states::{Best, Row};
pub(super) use sub_step::{Done, Mask, reference_step, sub_step};

/// Of the truths.
const EXACT: f64 = 1e-13;
const MOST_ITERATIONS: u32 = 20_000;
/// Of the shuffling: the same order in every run.
const SEED: u64 = 20;

/// What to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Scenes, scaled.
    pub scenes: Vec<Scene>,
    /// Frames of each from whose states a sub-step is done, ascending.
    pub frames: Vec<u64>,
    /// Cells along 1 m of the problems that are known exactly, ascending multiples of 10; none leaves them out.
    pub grids: Vec<usize>,
    /// What unknowns and residuals are held in; those that the adapter lacks are left out.
    pub precisions: Vec<Precision>,
    /// Preconditioners.
    pub preconditioners: Vec<Preconditioner>,
    /// Forms of the corrections where liquid and solids touch.
    pub formulations: Vec<Formulation>,
    /// Relative, of the true residuals.
    pub tolerances: Vec<f64>,
    /// Iterations in all rounds, at most.
    pub max_iterations: u32,
    /// Timed runs per row.
    pub repeats: usize,
    /// Where.
    pub adapter: AdapterChoice,
}

/// The tables and where they were measured.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// Where.
    #[serde(flatten)]
    pub machine: Machine,
    /// A row per state, way to solve and tolerance.
    pub rows: Vec<Row>,
    /// A row per state and target that any row meets.
    pub best: Vec<Best>,
    /// A row per problem, grid, precision and tolerance.
    pub grids: Vec<GridRow>,
    /// A row per problem and target that any row meets.
    pub grids_best: Vec<GridBest>,
    /// A row per problem, grid and precision.
    pub grids_enough: Vec<Enough>,
}

/// Hears of each row when it is there.
pub enum Heard<'a> {
    /// Of a state.
    State(&'a Row),
    /// Of a problem on a grid.
    Grid(&'a GridRow),
}

/// Measures all rows and writes their tables and pictures into `out`; `tell` hears of each row.
///
/// # Errors
/// [`Error::Input`] for scenes of weak or damping-only coupling and grids that the problems do not fit, [`Error::Output`], and what the simulations say.
pub fn bench_accuracy(
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(Heard),
) -> Result<Table, Error> {
    for scene in &options.scenes {
        if Effects::of(scene).coupling && scene.solver.coupling != CouplingScheme::Strong {
            return Err(Error::input(
                scene.file.display().to_string(),
                "the errors are those of strong coupling",
                "add --set solver.coupling=strong",
            ));
        }
    }
    for &grid in &options.grids {
        if !(10..=320).contains(&grid) || !grid.is_multiple_of(10) {
            return Err(Error::input(
                format!("--grids {grid}"),
                "walls and surfaces of the problems do not lie on faces of such cells",
                "give multiples of 10 up to 320",
            ));
        }
    }
    if options.scenes.is_empty() && options.grids.is_empty() {
        return Err(Error::input(
            "bench accuracy",
            "nothing to measure",
            "give a scene file or more, or grids: --grids 10,20,40",
        ));
    }
    fs::create_dir_all(out).map_err(|problem| Error::output(out, problem))?;
    let machine = Machine::new(&Gpu::new(&options.adapter)?, options.repeats)?;
    let mut rows = Vec::new();
    for scene in &options.scenes {
        let mut simulation = Simulation::new(scene, &Backend::Gpu(options.adapter.clone()))?;
        for &frame in &options.frames {
            while simulation.clock().frame < frame {
                simulation.step()?;
            }
            let state = simulation.state()?;
            for row in states::measure(scene, &state, options)? {
                tell(Heard::State(&row));
                rows.push(row);
            }
        }
    }
    let mut grids = Vec::new();
    let problems = Exact::ALL.into_iter().flat_map(|problem| {
        let grids = options.grids.iter();
        grids.map(move |&grid| (problem, grid))
    });
    for (problem, grid) in problems {
        for row in grids::measure(problem, grid, options)? {
            tell(Heard::Grid(&row));
            grids.push(row);
        }
    }
    let table = Table {
        machine,
        best: states::recommend(&rows),
        rows,
        grids_best: grids::recommend(&grids),
        grids_enough: grids::enough(&grids),
        grids,
    };
    write_json(&table, &out.join("accuracy.json"))?;
    if !table.rows.is_empty() {
        write_csv(&table.rows, &out.join("accuracy.csv"))?;
        write_csv(&table.best, &out.join("accuracy_best.csv"))?;
        let lines = states::states(&table.rows).len() as u32;
        write_svg(&out.join("accuracy.svg"), (1200, 480 * lines), |page| {
            picture::draw_states(&table.rows, page)
        })?;
    }
    if !table.grids.is_empty() {
        write_csv(&table.grids, &out.join("accuracy_grids.csv"))?;
        write_csv(&table.grids_best, &out.join("accuracy_grids_best.csv"))?;
        write_csv(&table.grids_enough, &out.join("accuracy_grids_enough.csv"))?;
        let size = (1200, 480 * Exact::ALL.len() as u32);
        write_svg(&out.join("accuracy_grids.svg"), size, |page| {
            picture::draw_grids(&table.grids, page)
        })?;
    }
    Ok(table)
}

/// Of rows that are accurate enough, as seconds (median, least), tolerance: the loosest of those whose least is not above the cheapest's
/// median. What else the machine does would choose among these.
fn cheapest<'a, T>(
    rows: impl Iterator<Item = &'a T> + Clone,
    cost: impl Fn(&T) -> ([f64; 2], f64),
) -> Option<&'a T> {
    let medians = rows.clone().map(|row| cost(row).0[0]);
    let least = medians.fold(f64::INFINITY, f64::min);
    let equal = rows.filter(|row| cost(row).0[1] <= least);
    equal.max_by(|a, b| {
        let ([a, _], a_tolerance) = cost(a);
        let ([b, _], b_tolerance) = cost(b);
        a_tolerance.total_cmp(&b_tolerance).then(b.total_cmp(&a))
    })
}
