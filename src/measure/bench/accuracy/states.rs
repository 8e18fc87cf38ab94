//! States of scenes: the same sub-step with every precision, preconditioner, form and tolerance.

use super::{Options, ensure_truth};
use crate::Error;
use crate::effects::Effects;
use crate::measure::bench::statistics::Spread;
use crate::measure::bench::sub_step::{Done, Mask, Solution, reference_step, solve_columns, sub_step};
use crate::measure::bench::table::{Row, row};
use crate::measure::bench::{Rows, Run, rounds};
use crate::measure::stored;
use crate::reference::{Formulation as Form, SolidSolver, StepSystem, larger, solve, solve_coupled};
use crate::scene::{Formulation, Precision, Preconditioner, Scene, Solver};
use crate::sim::{Backend, GpuPath, Simulation, Snapshot, reference_path};
use crate::state::{SolveReport, State};

/// A sub-step from a state.
struct Case<'a> {
    scene: &'a Scene,
    state: &'a State,
    /// Scene and frame, for messages.
    what: String,
    /// On the f64 path.
    exact: Done,
    mask: Mask,
    dt: f64,
}

/// A path of the device with a solver.
struct Variant {
    solver: Solver,
    path: GpuPath,
    /// Exact solution of the stored system, and its residual.
    truth: (Solution, f64),
}

/// Rows of a state. The sub-steps have no volume control, which prescribes divergence.
pub(super) fn measure(run: &mut Run, scene: &Scene, frame: u64, options: &Options) -> Result<Rows, Error> {
    let mut simulation = Simulation::new(scene, &Backend::Gpu(options.adapter.clone()))?;
    while simulation.clock().frame < frame {
        simulation.step()?;
    }
    let state = &simulation.state()?;
    drop(simulation);
    let mut scene = scene.clone();
    if let Some(liquid) = &mut scene.liquid {
        liquid.volume_control = false;
    }
    let case = Case::new(&scene, state)?;
    let (mut variants, mut refused) = (Vec::new(), None);
    for solver in solvers(&scene, options) {
        match Variant::new(&case, solver, options) {
            Ok(variant) => variants.push(variant),
            // The adapter lacks f64, or the solids are too large for the form.
            Err(error @ Error::Limit { .. }) => refused = Some(error),
            Err(error) => return Err(error),
        }
    }
    if variants.is_empty() {
        let problem = "none of the precisions and preconditioners asked for can solve it";
        let cure = "block_jacobi is for solids in liquid, and f32 not for the condensed form: add others";
        return Err(refused.unwrap_or_else(|| Error::input(scene.file.display().to_string(), problem, cure)));
    }
    let n = options.tolerances.len();
    let timed = rounds(run, &format!("solves of {}", case.what), n * variants.len(), |job| {
        let path = &mut variants[job / n].path;
        path.set_tolerance(options.tolerances[job % n]);
        let done = sub_step(path, state)?;
        Ok((done.seconds, done))
    })?;
    let rows = timed.into_iter().enumerate().map(|(job, timed)| {
        ("accuracy", case.row(&variants[job / n], options.tolerances[job % n], timed.spread(), &timed.outcome))
    });
    Ok(rows.collect())
}

/// Solvers that a scene file can select: block Jacobi only in the two-field form, no condensed form in f32.
fn solvers(scene: &Scene, options: &Options) -> Vec<Solver> {
    let formulations = match Effects::of(scene).coupling {
        true => &[Formulation::Condensed, Formulation::TwoField][..],
        false => &[Formulation::Auto],
    };
    let mut solvers = Vec::new();
    for &precision in &options.precisions {
        for &preconditioner in &options.preconditioners {
            for &formulation in formulations {
                let blocks = preconditioner == Preconditioner::BlockJacobi;
                let single = precision == Precision::F32 && formulation == Formulation::Condensed;
                if !single && (!blocks || formulation == Formulation::TwoField) {
                    let max_iterations = options.max_iterations;
                    solvers.push(Solver { precision, preconditioner, formulation, max_iterations, ..scene.solver });
                }
            }
        }
    }
    solvers
}

impl<'a> Case<'a> {
    fn new(scene: &'a Scene, state: &'a State) -> Result<Case<'a>, Error> {
        let mut reference = reference_path(&Scene { solver: super::exact(scene.solver), ..scene.clone() })?;
        reference.reset(state.clone())?;
        let dt = reference.next_time_step().dt;
        let exact = reference_step(&mut reference, state)?;
        let mask = Mask::new(&reference);
        let what = format!("{}, frame {}", scene.name, state.frame);
        ensure_truth(&format!("{what}, the f64 path"), state.step, exact.report.solves())?;
        Ok(Case { scene, state, what, exact, mask, dt })
    }

    fn row(&self, variant: &Variant, tolerance: f64, seconds: Spread, done: &Done) -> Row {
        let report = &done.report;
        let liquid = report.liquid.map(|liquid| liquid.diagnosis);
        let residual = |solve: Option<SolveReport>| solve.map_or(0.0, |solve| solve.residual);
        let touching = report.coupling.filter(|both| both.touching);
        let Solution { pressure, velocity } = &done.solution;
        let cells = |exact: &[f64]| relative(pressure, exact, Some(&self.mask.cells));
        let nodes = |exact: &[[f64; 3]]| relative(velocity.as_flattened(), exact.as_flattened(), None);
        let counts = self.mask.faces.concat();
        let fall = self.scene.domain.gravity.length() * self.dt;
        let speed = liquid.map_or(0.0, |diagnosis| diagnosis.max_speed);
        let (truth, truth_residual) = &variant.truth;
        let row = row! {
            scene: self.scene.name.as_str(), frame: self.state.frame, cells: self.scene.grid().n_cells(),
            precision: variant.solver.precision.name(), preconditioner: variant.solver.preconditioner.name(),
            formulation: touching.map_or("apart", |both| if both.condensed { "condensed" } else { "two-field" }), tolerance,
            residual_p: residual(report.liquid.map(|liquid| liquid.solve)), residual_v: residual(report.solid.map(|solid| solid.solve)),
            error_p: cells(&truth.pressure), error_v: nodes(&truth.velocity), step_error_p: cells(&self.exact.solution.pressure),
            step_error_v: nodes(&self.exact.solution.velocity),
            step_error_u: relative(&done.faces.concat(), &self.exact.faces.concat(), Some(&counts)), truth_residual: *truth_residual,
            divergence: liquid.map_or(0.0, |diagnosis| diagnosis.divergence),
            speed_over_g_dt: if fall > 0.0 { speed / fall } else { 0.0 },
        };
        row.with(solve_columns(report, tolerance, seconds))
    }
}

/// Largest difference over the largest exact value, of the values that count; 0 without a difference, NaN if any value is.
fn relative(found: &[f64], exact: &[f64], counts: Option<&[bool]>) -> f64 {
    let pairs = found.iter().zip(exact).enumerate().filter(|(at, _)| counts.is_none_or(|counts| counts[*at]));
    let [off, largest] =
        pairs.fold([0.0; 2], |[off, largest], (_, (a, b))| [larger(off, (a - b).abs()), larger(largest, b.abs())]);
    if off == 0.0 { 0.0 } else { off / largest }
}

impl Variant {
    fn new(case: &Case, solver: Solver, options: &Options) -> Result<Variant, Error> {
        let scene = Scene { solver, ..case.scene.clone() };
        let mut path = GpuPath::open(&scene, &options.adapter)?;
        // Compiles, and stores the system.
        path.write_state(case.state)?;
        let mut truth = (Solution { pressure: Vec::new(), velocity: Vec::new() }, 0.0);
        stored::step_observed(&mut path, &mut |path, snapshot, system| {
            let solves = solve_exactly(path, snapshot, system, &mut truth.0)?;
            truth.1 = solves.iter().map(|solve| solve.residual).fold(truth.1, larger);
            ensure_truth(&format!("{}, stored in {}", case.what, solver.precision.name()), case.state.step, solves)
        })?;
        Ok(Variant { solver, path, truth })
    }
}

/// Solves a stored system exactly; returns the reports.
fn solve_exactly(
    path: &GpuPath,
    snapshot: &Snapshot,
    system: StepSystem,
    exact: &mut Solution,
) -> Result<Vec<SolveReport>, Error> {
    let settings = super::exact(Solver::default());
    let all = || stored::on_device(path, snapshot.solids.as_ref().expect("the system has solids"));
    Ok(match system {
        StepSystem::Pressure(system, _) => {
            let (pressure, report) = solve(system, &settings)?;
            exact.pressure = pressure;
            vec![report]
        }
        StepSystem::Solid(system, _) => {
            let (velocity, report) = SolidSolver::new(&all()).solve_direct(system, &settings)?;
            exact.velocity = velocity;
            vec![report]
        }
        StepSystem::Coupled(system, ..) => {
            let all = all();
            let found = solve_coupled(system, Form::of(system), &SolidSolver::new(&all), &all, &settings)?;
            (exact.pressure, exact.velocity) = (found.pressure, found.velocity);
            found.reports.into()
        }
    })
}
