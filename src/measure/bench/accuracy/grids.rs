//! Problems with a known pressure, on grids.

use super::exact::Exact;
use super::{Options, ensure_truth};
use crate::Error;
use crate::measure::bench::sub_step::{Done, Mask, open_paths, reference_step, rest_errors, solve_columns, sub_step};
use crate::measure::bench::table::row;
use crate::measure::bench::{Rows, Run, rounds};
use crate::reference::larger;
use crate::scene::{Scene, Solver};
use crate::sim::reference_path;

/// Rows of a problem on a grid.
pub(super) fn measure(run: &mut Run, problem: Exact, grid: usize, options: &Options) -> Result<Rows, Error> {
    let solver = super::exact(Solver::default());
    let scene = problem.scene(grid, solver)?;
    let state = problem.state(&scene)?;
    let mut reference = reference_path(&scene)?;
    let exact = reference_step(&mut reference, &state)?;
    let what = format!("{}, {grid} cells along 1 m", problem.name());
    ensure_truth(&format!("{what}, the f64 path"), state.step, exact.report.solves())?;
    let mask = Mask::new(&reference);
    // Nothing should move where no dam is removed.
    let rests = problem != Exact::Dam;
    let [grid_p, grid_u] = errors(problem, &scene, &mask, &exact);
    let solvers = options.precisions.iter().map(|&precision| Solver {
        precision,
        tolerance: options.tolerances[0],
        max_iterations: options.max_iterations,
        ..solver
    });
    let mut paths = open_paths(&scene, solvers, &state, &options.adapter)?;
    let n = options.tolerances.len();
    let timed = rounds(run, &format!("solves of {what}"), n * paths.len(), |job| {
        let path = &mut paths[job / n].1;
        path.set_tolerance(options.tolerances[job % n]);
        let done = sub_step(path, &state)?;
        Ok((done.seconds, done))
    })?;
    let rows = timed.into_iter().enumerate().map(|(job, timed)| {
        let (tolerance, done) = (options.tolerances[job % n], &timed.outcome);
        let [error_p, error_u] = errors(problem, &scene, &mask, done);
        let row = row! {
            problem: problem.name(), grid: grid, precision: paths[job / n].0, tolerance: tolerance, error_p: error_p,
            grid_error_p: grid_p, error_u: rests.then_some(error_u), grid_error_u: rests.then_some(grid_u),
        };
        ("accuracy_grids", row.with(solve_columns(&done.report, tolerance, timed.spread())))
    });
    Ok(rows.collect())
}

/// Errors of the pressure over the largest pressure, and of speeds over g dt.
fn errors(problem: Exact, scene: &Scene, mask: &Mask, done: &Done) -> [f64; 2] {
    let [p, v, u] = rest_errors(scene, mask, done, |x| problem.pressure(x));
    let fall = scene.domain.gravity.length() * scene.time.fixed_step.unwrap_or(0.0);
    [p / problem.scale(), larger(v, u) / fall]
}
