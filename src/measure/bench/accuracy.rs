//! `bench accuracy`: error against time of the solve.
//!
//! States of scenes (`states`): the sub-step after a frame is repeated from the same state with every precision, preconditioner, form and tolerance, in
//! a shuffled order. The time of the solve includes its set-up. Errors refer to two exact solutions: that of the system which the device stores, and
//! that of the same sub-step on the f64 path. Exact solutions are by sparse factors, with liquid above 60,000 unknowns by conjugate gradients. They
//! are refined to 1e-13, or as far as rounding allows; above 1e-10 the bench fails.
//!
//! Problems on grids (`exact`): their pressure is known, so errors are those of grid and solve together.

mod exact;
mod states;

use std::cmp::Ordering;

use super::chart::{Chart, Page, lines};
use super::ended::is_solved;
use super::statistics::grouped;
use super::table::{Row, Table, columns, row};
use super::{Bench, Case, Listener, Machine, Results, Run, Settings, hashes, replace, rows};
use crate::Error;
use crate::effects::Effects;
use crate::gpu::{AdapterChoice, Gpu};
use crate::reference::larger;
use crate::scene::{CouplingScheme, Precision, Preconditioner, Scene, Solver};
use crate::state::{SolveReport, SolveStatus};

pub use exact::{Exact, dam_release};

/// Relative residual of the exact solutions.
const EXACT: f64 = 1e-13;
const MOST_ITERATIONS: u32 = 20_000;

/// Settings of the exact solutions.
fn exact(solver: Solver) -> Solver {
    Solver { precision: Precision::F64, tolerance: EXACT, max_iterations: MOST_ITERATIONS, ..solver }
}

/// Largest residual of an exact solution that did not converge. Forces of stiff solids cancel, so rounding in f64 can exceed [`EXACT`].
const ROUNDED: f64 = 1e-10;
/// Target errors with a recommendation, on states and on grids.
const TARGETS: [&[f64]; 2] =
    [&[1e-2, 1e-4, 1e-6, 1e-8, 1e-10], &[1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 1e-5, 1e-6, 1e-8]];
/// Largest ratio of an error to that of the grid alone at which the solve does not matter.
const GRID_ERROR: f64 = 1.1;
/// Ratio to the fastest median within which rows count as equally fast.
const AS_FAST: f64 = 1.25;

/// Scenes, problems and solvers to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Scenes, scaled.
    pub scenes: Vec<Scene>,
    /// Frames whose states the solves start from.
    pub frames: Vec<u64>,
    /// Cells along 1 m of the problems with known solutions: multiples of 10.
    pub grids: Vec<usize>,
    /// Precisions; those that the adapter lacks are skipped.
    pub precisions: Vec<Precision>,
    /// Preconditioners.
    pub preconditioners: Vec<Preconditioner>,
    /// Relative tolerances of the true residuals.
    pub tolerances: Vec<f64>,
    /// Most iterations over all refinement steps.
    pub max_iterations: u32,
    /// Adapter.
    pub adapter: AdapterChoice,
}

columns! {
    STATE {
        + scene "" "name of the scene";
        + frame "" "frame of the state";
    }
    CELLS { - cells "" "cells of the domain"; }
    SIZES {
        - unknowns, solid_unknowns "" "of the pressure, and of the solids";
    }
    PROBLEM {
        + problem "" "`pool_at_rest` or `dam_release`";
        + grid "" "cells along 1 m";
    }
    TARGET { + target "" "bound of the errors"; }
    PRECISION { + precision "" "`f32`, `mixed` or `f64`"; }
    FORM {
        + preconditioner "" "`multigrid`, `jacobi` or `block_jacobi`";
        + formulation "" "`two-field`, `condensed`, or `apart` where liquid and solids do not touch";
    }
    TOLERANCE { + tolerance "" "relative, of the true residuals"; }
    STATUS { + status "" "`converged`, `converged_to_rounding` or why not"; }
    TIME {
        + iterations "" "conjugate-gradient iterations, over all refinement steps";
        ~ seconds "s" "seconds of the solve";
    }
    ERRORS {
        + error_p, error_v "" "largest error of p and of the nodes' v over the largest value, against the exact solution of the stored system";
        - step_error_p, step_error_v, step_error_u "" "against the sub-step on the f64 path; u of the faces, after the projection";
    }
    RESIDUALS {
        - residual_p, residual_v "" "true relative residuals of the pressure and of the velocities";
        - truth_residual "" "residual of the exact solution";
        - divergence "1/s" "largest after the projection, without volume control";
        - speed_over_g_dt "" "of a liquid at rest: imbalance of pressure and gravity";
    }
    GRID_ERRORS {
        + error_p "" "largest error of p over the largest p";
        + grid_error_p "" "the same on the f64 path to 1e-13: error of the grid alone";
        + error_u "" "largest speed of the liquid at rest over g dt";
        - grid_error_u "" "the same on the f64 path";
    }
}

impl Options {
    fn check(&self) -> Result<(), Error> {
        let weak = |scene: &&Scene| Effects::of(scene).coupling && scene.solver.coupling != CouplingScheme::Strong;
        if let Some(scene) = self.scenes.iter().find(weak) {
            let (problem, cure) = ("the errors are those of strong coupling", "add --set solver.coupling=strong");
            return Err(Error::input(scene.file.display().to_string(), problem, cure));
        }
        let fits = |grid: &usize| (10..=320).contains(grid) && grid.is_multiple_of(10);
        if let Some(grid) = self.grids.iter().find(|grid| !fits(grid)) {
            let problem = "walls and surfaces of the problems do not lie on faces of such cells";
            return Err(Error::input(format!("--grids {grid}"), problem, "give multiples of 10 up to 320"));
        }
        if self.scenes.is_empty() && self.grids.is_empty() {
            let cure = "give a scene file or more, or grids: --grids 10,20,40";
            return Err(Error::input("bench accuracy", "nothing to measure", cure));
        }
        Ok(())
    }
}

/// Measures all states and problems: accuracy.csv, accuracy_best.csv, accuracy_grids.csv, accuracy_grids_best.csv, accuracy_grids_enough.csv,
/// accuracy.json, accuracy.svg, accuracy_grids.svg.
///
/// # Errors
/// [`Error::Input`] for scenes of weak or damping-only coupling and grids that the problems do not fit; [`Error::Output`]; [`Error::Stage`]
/// without an exact solution; errors of the simulations.
pub fn measure(options: &Options, settings: &Settings, listener: Listener) -> Result<Results, Error> {
    options.check()?;
    let state = &["scene", "frame", "precision", "preconditioner", "formulation", "tolerance"];
    let problem = &["problem", "grid", "precision", "tolerance"];
    let bench = Bench {
        name: "accuracy",
        tables: vec![
            Table::new(
                "accuracy",
                &[STATE, CELLS, SIZES, PRECISION, FORM, TOLERANCE, STATUS, TIME, ERRORS, RESIDUALS],
                state,
            ),
            Table::new("accuracy_best", &[STATE, TARGET, PRECISION, FORM, TOLERANCE, TIME, ERRORS], &[]),
            Table::new("accuracy_grids", &[PROBLEM, SIZES, PRECISION, TOLERANCE, STATUS, TIME, GRID_ERRORS], problem),
            Table::new("accuracy_grids_best", &[PROBLEM, TARGET, PRECISION, TOLERANCE, TIME, GRID_ERRORS], &[]),
            Table::new("accuracy_grids_enough", &[PROBLEM, PRECISION, TOLERANCE, TIME, GRID_ERRORS], &[]),
        ],
        derive,
        pictures: &[("accuracy", draw_states), ("accuracy_grids", draw_grids)],
    };
    let machine = Machine::new(&Gpu::new(&options.adapter)?, settings.repeats)?;
    let Options { precisions, preconditioners, tolerances, max_iterations, .. } = options;
    let solvers = (precisions, preconditioners, tolerances, max_iterations);
    let mut run = Run::start(bench, machine, &(hashes(&options.scenes), solvers), settings, listener)?;
    let mut cases = Vec::new();
    for scene in &options.scenes {
        for &frame in &options.frames {
            let key = row! { scene: scene.name.as_str(), frame };
            cases.push(Case::new("accuracy", key, move |run| states::measure(run, scene, frame, options)));
        }
    }
    for &(_, problem) in Exact::NAMES {
        for &grid in &options.grids {
            let key = row! { problem: problem.name(), grid };
            cases.push(Case::new("accuracy_grids", key, move |run| problem.measure(run, grid, options)));
        }
    }
    run.cases(cases)?;
    Ok(run.results)
}

/// Refuses an exact solution that did not converge. `step`: number of sub-steps before it.
pub fn ensure_truth(what: &str, step: u64, solves: impl IntoIterator<Item = SolveReport>) -> Result<(), Error> {
    let failed = |solve: &SolveReport| {
        let passed = [SolveStatus::Converged, SolveStatus::Incompatible].contains(&solve.status);
        // A residual of NaN fails.
        !(passed || solve.residual <= ROUNDED)
    };
    let Some(solve) = solves.into_iter().find(failed) else { return Ok(()) };
    let (status, residual) = (solve.status.name(), solve.residual);
    Err(Error::Stage {
        stage: "solve",
        step,
        problem: format!(
            "{what}: the reference solution in f64 ended with {status} at a relative residual of {residual:.1e}, above {ROUNDED:e}\n  cure: \
             shorter sub-steps (time.fixed_step), or loads and stiffnesses nearer to each other"
        ),
    })
}

/// Order of preference: fewer cells, which all stages depend on; the narrower precision, which more adapters have; the looser tolerance; fewer
/// iterations; less time.
fn better(a: &Row, b: &Row) -> Ordering {
    let size = |row: &Row| (row.count("cells"), row.count("grid"), width(row));
    let less = |name| a.number(name).total_cmp(&b.number(name));
    let order = size(a).cmp(&size(b)).then(less("tolerance").reverse());
    order.then(less("iterations")).then(less("seconds_median"))
}

/// Rank of the precision.
fn width(row: &Row) -> Option<usize> {
    Precision::NAMES.iter().position(|(name, _)| *name == row.text("precision"))
}

/// Preferred row among the fastest: least seconds at most the largest of the row with the least median, and at most `AS_FAST` times that median.
pub fn cheapest<'r>(rows: &[&'r Row]) -> Option<&'r Row> {
    let fastest = rows.iter().filter_map(|row| row.spread("seconds")).min_by(|a, b| a.median.total_cmp(&b.median))?;
    let most = fastest.max.min(AS_FAST * fastest.median);
    rows.iter().filter(|row| row.number("seconds_min") <= most).min_by(|a, b| better(a, b)).copied()
}

/// Cheapest row for each of the descending targets that any row meets. The row of the next lower target is preferred if it needs no more time, cells and
/// bytes per number: less accuracy should never take longer.
pub fn recommended<'r>(rows: &[&'r Row], targets: &[f64], error: impl Fn(&Row) -> f64) -> Vec<(f64, &'r Row)> {
    let mut found: Vec<(f64, &Row)> = Vec::new();
    for &target in targets.iter().rev() {
        let meeting: Vec<&Row> = rows.iter().copied().filter(|row| error(row) <= target).collect();
        let Some(mut best) = cheapest(&meeting) else { continue };
        if let Some(&(_, lower)) = found.last() {
            let needs = |row: &Row| (row.count("cells"), row.count("grid"));
            let no_more = needs(lower) <= needs(best) && width(lower) <= width(best);
            if no_more && lower.number("seconds_median") <= best.number("seconds_median") {
                best = lower;
            }
        }
        found.push((target, best));
    }
    found.reverse();
    found
}

/// The larger of both errors; NaN if one is not a number. Where a dam is removed the error of p alone.
fn error(row: &Row) -> f64 {
    let other = match row.text("problem") {
        "" => row.number("error_v"),
        _ if row.has("error_u") => row.number("error_u"),
        _ => 0.0,
    };
    larger(row.number("error_p"), other)
}

/// Rows with the least time per target, and the loosest tolerances that do not increase the errors of the grids.
pub fn derive(tables: &mut [Table]) {
    let grids = "accuracy_grids";
    for (table, best, key, targets) in [
        ("accuracy", "accuracy_best", &["scene", "frame"][..], TARGETS[0]),
        (grids, "accuracy_grids_best", &["problem"], TARGETS[1]),
    ] {
        let solved = rows(tables, table).iter().filter(|row| is_solved(row.text("status")));
        let groups = grouped(solved, |row| Some(row.only(key)));
        let found = groups.iter().flat_map(|(_, rows)| recommended(rows, targets, error));
        let found = found.map(|(target, row)| row.clone().with(row! { target })).collect();
        replace(tables, best, found);
    }
    let key = ["problem", "grid", "precision", "grid_error_p", "grid_error_u"];
    let groups = grouped(rows(tables, grids), |row| Some(row.only(&key)));
    let enough = groups.into_iter().map(|(grid, rows)| {
        let within = |row: &&&Row| {
            let small = |error: &str, grid_error: &str| {
                !row.has(error) || row.number(error) <= GRID_ERROR * row.number(grid_error)
            };
            let small = small("error_p", "grid_error_p") && small("error_u", "grid_error_u");
            is_solved(row.text("status")) && row.has("error_p") && small
        };
        let loosest = rows.iter().filter(within);
        let loosest = loosest.max_by(|a, b| a.number("tolerance").total_cmp(&b.number("tolerance")));
        loosest.map_or(grid, |row| (*row).clone())
    });
    replace(tables, "accuracy_grids_enough", enough.collect());
}

/// A chart of each error column of each group of rows, against seconds. `errors`: columns and their axes.
fn draw(
    rows: &[Row],
    group: impl Fn(&Row) -> String,
    name: impl Fn(&Row) -> String,
    errors: &[(&str, &'static str)],
) -> Page {
    let mut charts = Vec::new();
    for (title, rows) in grouped(rows, |row| Some(group(row))) {
        charts.extend(errors.iter().map(|&(column, axis)| Chart {
            title: title.clone(),
            axes: ["seconds of the solve", axis],
            lines: lines(rows.iter().copied(), &name, ["seconds", column]),
            falling: true,
        }));
    }
    Page::Charts(2, charts)
}

fn draw_states(results: &Results) -> Page {
    let errors = [
        ("error_p", "error of p"),
        ("error_v", "error of v"),
        ("step_error_u", "error of u, against the f64 path"),
        ("divergence", "divergence, 1/s"),
    ];
    let state = |row: &Row| format!("{}, frame {}", row.text("scene"), row.count("frame"));
    let name = |row: &Row| row.join(&["precision", "preconditioner", "formulation"]);
    draw(results.rows("accuracy"), state, name, &errors)
}

fn draw_grids(results: &Results) -> Page {
    let errors = [("error_p", "error of p over the largest p"), ("error_u", "speed over g dt")];
    let name = |row: &Row| format!("{} cells/m, {}", row.count("grid"), row.text("precision"));
    draw(results.rows("accuracy_grids"), |row| row.text("problem").to_owned(), name, &errors)
}
