//! What the grid costs in accuracy, beside what tolerance and precision do: problems known exactly, on grids.

use serde::Serialize;

use crate::Error;
use crate::reference::larger;
use crate::scene::{Precision, Scene, Solver};
use crate::sim::{GpuPath, reference_path};
use crate::state::{SolveReport, State};

use super::super::bench_solve::{Ended, is_solved, name};
use super::super::statistics::Spread;
use super::exact::Exact;
use super::sub_step::{Done, Mask, reference_step, repeat_shuffled, sub_step};
use super::{Choice, EXACT, Heard, MOST_ITERATIONS, Options, ensure_truth, recommended};

/// Errors that a recommendation is made for.
const TARGETS: [f64; 10] = [1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 1e-5, 1e-6, 1e-8];
/// An error is that of the grid up to so much of it.
const OF_THE_GRID: f64 = 1.1;

/// A row of accuracy_grids.csv.
#[derive(Clone, Debug, Serialize)]
pub struct GridRow {
    /// `elastic_block`, `pool_at_rest` or `dam_release`.
    pub problem: &'static str,
    /// Cells along 1 m.
    pub grid: usize,
    /// Of the pressure.
    pub unknowns: usize,
    /// Of the solids.
    pub solid_unknowns: usize,
    /// `f32`, `mixed` or `f64`.
    pub precision: &'static str,
    /// Relative, of the true residuals.
    pub tolerance: f64,
    /// `converged`, or how else the solve ended; `converged_to_rounding` above the tolerance, where rounding lets it no further.
    pub status: &'static str,
    /// Conjugate-gradient iterations.
    pub iterations: u32,
    /// Of the solve.
    pub seconds_median: f64,
    /// Least.
    pub seconds_min: f64,
    /// Largest.
    pub seconds_max: f64,
    /// Largest error of the pressure over the largest pressure.
    pub error_p: f64,
    /// The same on the f64 path, of a solve to 1e-13: what the grid alone costs.
    pub grid_error_p: f64,
    /// Largest speed of what should be at rest, liquid and solids, over g dt; empty where it should move.
    pub error_u: Option<f64>,
    /// The same on the f64 path.
    pub grid_error_u: Option<f64>,
}

/// The cheapest solved row of a problem that is as accurate as a target; of those that time does not tell apart the one of the coarsest
/// grid, then of fewest bytes a number, then of the loosest tolerance. Or that of the next lower target, where it asks no more.
#[derive(Clone, Debug, Serialize)]
pub struct GridBest {
    /// As in [`GridRow`].
    pub problem: &'static str,
    /// What `error_p` and `error_u` are to stay below.
    pub target: f64,
    /// As in [`GridRow`].
    pub grid: usize,
    /// As in [`GridRow`].
    pub precision: &'static str,
    /// As in [`GridRow`].
    pub tolerance: f64,
    /// As in [`GridRow`].
    pub seconds_median: f64,
    /// As in [`GridRow`].
    pub seconds_min: f64,
    /// As in [`GridRow`].
    pub seconds_max: f64,
    /// As in [`GridRow`].
    pub error_p: f64,
    /// As in [`GridRow`].
    pub error_u: Option<f64>,
}

/// The loosest tolerance that leaves a grid's error as it is.
#[derive(Clone, Debug, Serialize)]
pub struct Enough {
    /// As in [`GridRow`].
    pub problem: &'static str,
    /// As in [`GridRow`].
    pub grid: usize,
    /// As in [`GridRow`].
    pub precision: &'static str,
    /// As in [`GridRow`].
    pub grid_error_p: f64,
    /// As in [`GridRow`].
    pub grid_error_u: Option<f64>,
    /// As in [`GridRow`]; empty where none of those tried does.
    pub tolerance: Option<f64>,
    /// As in [`GridRow`].
    pub seconds_median: Option<f64>,
    /// As in [`GridRow`].
    pub seconds_min: Option<f64>,
    /// As in [`GridRow`].
    pub seconds_max: Option<f64>,
}

impl GridRow {
    /// Of the solve.
    pub(super) fn seconds(&self) -> Spread {
        Spread {
            median: self.seconds_median,
            min: self.seconds_min,
            max: self.seconds_max,
        }
    }

    fn choice(&self) -> Choice {
        Choice {
            seconds: self.seconds(),
            cells: self.grid,
            precision: self.precision,
            tolerance: self.tolerance,
            iterations: self.iterations,
        }
    }

    /// The larger of both errors.
    fn error(&self) -> f64 {
        larger(self.error_p, self.error_u.unwrap_or(0.0))
    }

    fn solved(&self) -> bool {
        is_solved(self.status)
    }

    fn is_of_the_grid(&self) -> bool {
        let of_u = self.error_u.zip(self.grid_error_u);
        self.solved()
            && self.error_p <= OF_THE_GRID * self.grid_error_p
            && of_u.is_none_or(|(error, grid)| error <= OF_THE_GRID * grid)
    }
}

/// One problem on one grid.
struct Case {
    problem: Exact,
    grid: usize,
    scene: Scene,
    state: State,
    mask: Mask,
    /// On the f64 path: of the pressure, and of speeds.
    errors: [f64; 2],
}

/// All rows of a problem on a grid.
pub(super) fn measure(
    problem: Exact,
    grid: usize,
    options: &Options,
    tell: &mut dyn FnMut(Heard),
) -> Result<Vec<GridRow>, Error> {
    let mut case = Case::new(problem, grid)?;
    let mut paths = Vec::new();
    for &precision in &options.precisions {
        case.scene.solver.precision = precision;
        case.scene.solver.max_iterations = options.max_iterations;
        match GpuPath::open(&case.scene, &options.adapter) {
            Ok(mut path) => {
                // The first compiles.
                path.set_tolerance(options.tolerances[0]);
                sub_step(&mut path, &case.state, case.density())?;
                paths.push((precision, path));
            }
            Err(Error::Limit { .. }) if precision == Precision::F64 => {}
            Err(error) => return Err(error),
        }
    }
    let on = format!("{}, {grid} cells along 1 m", problem.name());
    let found = repeat_shuffled((on, paths.len()), options, tell, |path, tolerance| {
        let path = &mut paths[path].1;
        path.set_tolerance(tolerance);
        sub_step(path, &case.state, case.density())
    })?;
    let rows = found
        .into_iter()
        .map(|((path, tolerance), (seconds, done))| {
            let (precision, _) = paths[path];
            case.row(precision, options.tolerances[tolerance], seconds, &done)
        });
    Ok(rows.collect())
}

impl Case {
    fn new(problem: Exact, grid: usize) -> Result<Case, Error> {
        let solver = Solver {
            precision: Precision::F64,
            tolerance: EXACT,
            max_iterations: MOST_ITERATIONS,
            ..Solver::default()
        };
        let scene = problem.scene(grid, solver)?;
        let state = problem.state(&scene)?;
        let mut path = reference_path(&scene)?;
        let done = reference_step(&mut path, &state)?;
        let what = format!("{}, {grid} cells along 1 m, the f64 path", problem.name());
        ensure_truth(&what, state.step, done.report.solves())?;
        let mask = Mask::of(&path);
        let mut case = Case {
            problem,
            grid,
            scene,
            state,
            mask,
            errors: [0.0; 2],
        };
        case.errors = case.errors_of(&done);
        Ok(case)
    }

    /// kg/m^3
    fn density(&self) -> f64 {
        let liquid = self.scene.liquid.as_ref();
        liquid.map_or(0.0, |liquid| liquid.density)
    }

    /// Of the pressure over the largest, and of speeds over g dt; not a number where one is not.
    fn errors_of(&self, done: &Done) -> [f64; 2] {
        let grid = self.scene.grid();
        let cells = done
            .answer
            .pressure
            .iter()
            .zip(&self.mask.cells)
            .enumerate();
        let off = cells
            .filter(|(_, (_, counts))| **counts)
            .filter_map(|(cell, (p, _))| {
                let exact = self
                    .problem
                    .pressure(grid.cell_centre(grid.cell_at(cell)))?;
                Some((p - exact).abs())
            });
        let faces = done
            .faces
            .iter()
            .flatten()
            .zip(self.mask.faces.iter().flatten());
        let liquid = faces.filter(|(_, counts)| **counts).map(|(u, _)| u.abs());
        let solids = done.answer.velocity.as_flattened().iter().map(|v| v.abs());
        let speed = liquid.chain(solids).fold(0.0, larger);
        let fall = self.scene.domain.gravity.length() * self.scene.time.fixed_step.unwrap_or(0.0);
        [off.fold(0.0, larger) / self.problem.scale(), speed / fall]
    }

    fn row(&self, precision: Precision, tolerance: f64, seconds: Spread, done: &Done) -> GridRow {
        let [error_p, error_u] = self.errors_of(done);
        let solves: Vec<SolveReport> = done.report.solves().collect();
        let rests = self.problem.rests();
        GridRow {
            problem: self.problem.name(),
            grid: self.grid,
            unknowns: solves[0].unknowns,
            solid_unknowns: solves.get(1).map_or(0, |solve| solve.unknowns),
            precision: name(precision),
            tolerance,
            status: Ended::of_reports(&solves).name(tolerance),
            // Both are solved for together, and each has all of them.
            iterations: solves[0].iterations,
            seconds_median: seconds.median,
            seconds_min: seconds.min,
            seconds_max: seconds.max,
            error_p,
            grid_error_p: self.errors[0],
            error_u: rests.then_some(error_u),
            grid_error_u: rests.then_some(self.errors[1]),
        }
    }
}

/// Problems, in the order of the rows.
pub(super) fn problems(rows: &[GridRow]) -> Vec<&'static str> {
    let mut problems: Vec<&str> = rows.iter().map(|row| row.problem).collect();
    problems.dedup();
    problems
}

/// The cheapest rows for each target.
pub(super) fn recommend(rows: &[GridRow]) -> Vec<GridBest> {
    let mut best = Vec::new();
    for problem in problems(rows) {
        let candidates = rows
            .iter()
            .filter(|row| row.problem == problem && row.solved());
        let found = recommended(candidates, &TARGETS, GridRow::error, GridRow::choice);
        best.extend(found.into_iter().map(|(target, row)| GridBest {
            problem,
            target,
            grid: row.grid,
            precision: row.precision,
            tolerance: row.tolerance,
            seconds_median: row.seconds_median,
            seconds_min: row.seconds_min,
            seconds_max: row.seconds_max,
            error_p: row.error_p,
            error_u: row.error_u,
        }));
    }
    best
}

/// The loosest tolerances that leave the grids' errors as they are.
pub(super) fn enough(rows: &[GridRow]) -> Vec<Enough> {
    let same = |a: &GridRow, b: &GridRow| {
        a.problem == b.problem && a.grid == b.grid && a.precision == b.precision
    };
    let of_grids = rows.chunk_by(same).map(|rows| {
        let meeting = rows.iter().filter(|row| row.is_of_the_grid());
        let loosest = meeting.max_by(|a, b| a.tolerance.total_cmp(&b.tolerance));
        Enough {
            problem: rows[0].problem,
            grid: rows[0].grid,
            precision: rows[0].precision,
            grid_error_p: rows[0].grid_error_p,
            grid_error_u: rows[0].grid_error_u,
            tolerance: loosest.map(|row| row.tolerance),
            seconds_median: loosest.map(|row| row.seconds_median),
            seconds_min: loosest.map(|row| row.seconds_min),
            seconds_max: loosest.map(|row| row.seconds_max),
        }
    });
    of_grids.collect()
}

#[cfg(test)]
mod tests {
    use super::{GridRow, enough, recommend};

    fn row(error_p: f64, error_u: f64) -> GridRow {
        GridRow {
            problem: "pool_at_rest",
            grid: 10,
            unknowns: 1,
            solid_unknowns: 0,
            precision: "mixed",
            tolerance: 1e-6,
            status: "converged",
            iterations: 1,
            seconds_median: 1.0,
            seconds_min: 1.0,
            seconds_max: 1.0,
            error_p,
            grid_error_p: 1e-3,
            error_u: Some(error_u),
            grid_error_u: Some(1e-3),
        }
    }

    #[test]
    fn what_has_an_error_that_is_not_a_number_is_neither_best_nor_enough() {
        for error in [[f64::NAN, 0.0], [0.0, f64::NAN]] {
            let rows = [row(error[0], error[1])];
            assert!(recommend(&rows).is_empty());
            assert_eq!(enough(&rows)[0].tolerance, None);
        }
        let rows = [row(1e-3, 1e-3)];
        assert_eq!(recommend(&rows).len(), 5);
        assert_eq!(enough(&rows)[0].tolerance, Some(1e-6));
    }
}
