//! Work and precision on states of scenes: every precision, preconditioner, form of the corrections and tolerance from the same state.

use std::time::Instant;

use serde::Serialize;

use crate::Error;
use crate::effects::Effects;
use crate::gpu::AdapterChoice;
use crate::reference::{Formulation as Form, SolidSolver, larger, solve, solve_coupled};
use crate::scene::{Formulation, Precision, Preconditioner, Scene, Solver};
use crate::sim::{GpuPath, Snapshot, reference_path};
use crate::step::Stage;

use crate::state::{SolveReport, State};

use super::super::bench_solve::{Ended, is_solved, name, preconditioner_name};
use super::super::statistics::Spread;
use super::super::stored;
use super::sub_step::{Answer, Done, Mask, reference_step, repeat_shuffled, sub_step};
use super::{Choice, EXACT, Heard, MOST_ITERATIONS, Options, Progress, ensure_truth, recommended};

/// Errors that a recommendation is made for.
const TARGETS: [f64; 5] = [1e-2, 1e-4, 1e-6, 1e-8, 1e-10];

/// A row of accuracy.csv.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the scene.
    pub scene: String,
    /// Frame that the state is of.
    pub frame: u64,
    /// Cells of the domain.
    pub cells: usize,
    /// Of the pressure.
    pub unknowns: usize,
    /// Of the solids.
    pub solid_unknowns: usize,
    /// `f32`, `mixed` or `f64`.
    pub precision: &'static str,
    /// `multigrid` or `jacobi`.
    pub preconditioner: &'static str,
    /// `two-field` or `condensed`; `apart` where liquid and solids do not touch or one is not there.
    pub formulation: &'static str,
    /// Relative, of the true residuals.
    pub tolerance: f64,
    /// `converged`, or how else the solve ended; `converged_to_rounding` above the tolerance, where rounding lets it no further.
    pub status: &'static str,
    /// Conjugate-gradient iterations, summed over rounds and contacts; of both systems where they are solved apart.
    pub iterations: u32,
    /// Of the solve.
    pub seconds_median: f64,
    /// Least.
    pub seconds_min: f64,
    /// Largest.
    pub seconds_max: f64,
    /// True relative residual of the pressure, f64.
    pub residual_p: f64,
    /// That of the solids' rows.
    pub residual_v: f64,
    /// Largest error of the pressure over the largest pressure, against the solution of the stored system.
    pub error_p: f64,
    /// The same of the velocities of the nodes.
    pub error_v: f64,
    /// Largest error of the pressure over the largest pressure, against the sub-step of the f64 path.
    pub step_error_p: f64,
    /// The same of the velocities of the nodes.
    pub step_error_v: f64,
    /// The same of the velocities on the faces of the liquid's cells, after the projection.
    pub step_error_u: f64,
    /// True relative residual that the solution of the stored system keeps, the larger where solves are apart.
    pub truth_residual: f64,
    /// Largest divergence after the projection, 1/s; volume control is off, but sources make some.
    pub divergence: f64,
    /// Largest speed of the liquid over g dt: of a liquid at rest, how well pressure balances gravity.
    pub speed_over_g_dt: f64,
}

/// The cheapest solved row that is as accurate as a target; of those that time does not tell apart the one of fewest bytes a
/// number, then of the loosest tolerance, then of fewest iterations. Or that of the next lower target, where it asks no more.
#[derive(Clone, Debug, Serialize)]
pub struct Best {
    /// Name of the scene.
    pub scene: String,
    /// Frame that the state is of.
    pub frame: u64,
    /// What both errors against the stored system's solution are to stay below.
    pub target: f64,
    /// As in [`Row`].
    pub precision: &'static str,
    /// As in [`Row`].
    pub preconditioner: &'static str,
    /// As in [`Row`].
    pub formulation: &'static str,
    /// As in [`Row`].
    pub tolerance: f64,
    /// As in [`Row`].
    pub iterations: u32,
    /// As in [`Row`].
    pub seconds_median: f64,
    /// As in [`Row`].
    pub seconds_min: f64,
    /// As in [`Row`].
    pub seconds_max: f64,
    /// As in [`Row`].
    pub error_p: f64,
    /// As in [`Row`].
    pub error_v: f64,
    /// As in [`Row`]: what no tighter tolerance makes smaller.
    pub step_error_p: f64,
    /// As in [`Row`].
    pub step_error_v: f64,
    /// As in [`Row`].
    pub step_error_u: f64,
}

impl Row {
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
            cells: self.cells,
            precision: self.precision,
            tolerance: self.tolerance,
            iterations: self.iterations,
        }
    }
}

/// A sub-step from a state.
struct Case<'a> {
    scene: &'a Scene,
    state: &'a State,
    /// On the f64 path.
    exact: Answer,
    /// Its velocities on the faces, m/s.
    faces: [Vec<f64>; 3],
    mask: Mask,
    dt: f64,
}

/// A way to solve it.
struct Way {
    precision: Precision,
    preconditioner: Preconditioner,
    path: GpuPath,
    /// The solution of the system that it stores.
    truth: Answer,
    /// The residual that it keeps.
    truth_residual: f64,
}

/// All rows of a state. Its sub-steps are without volume control, which asks for divergence: what is left of it is then the solve's.
pub(super) fn measure(
    scene: &Scene,
    state: &State,
    options: &Options,
    tell: &mut dyn FnMut(Heard),
) -> Result<Vec<Row>, Error> {
    let mut scene = scene.clone();
    if let Some(liquid) = &mut scene.liquid {
        liquid.volume_control = false;
    }
    let scene = &scene;
    let case = Case::new(scene, state)?;
    let on = format!("{}, frame {}", scene.name, state.frame);
    let (mut solvers, mut ways, mut refused) = (Vec::new(), Vec::new(), None);
    let together = Effects::of(scene).coupling;
    for &precision in &options.precisions {
        for &preconditioner in &options.preconditioners {
            for &formulation in &options.formulations {
                let apart = !together && formulation != options.formulations[0];
                let condensed = together && formulation == Formulation::Condensed;
                // The two-field form alone has blocks of nodes, the condensed one no f32: as in a scene.
                let blocks = preconditioner == Preconditioner::BlockJacobi;
                let without = blocks && (condensed || !together);
                if apart || without || condensed && precision == Precision::F32 {
                    continue;
                }
                solvers.push(Solver {
                    precision,
                    preconditioner,
                    formulation: if together {
                        formulation
                    } else {
                        Formulation::Auto
                    },
                    max_iterations: options.max_iterations,
                    ..scene.solver
                });
            }
        }
    }
    let (n, clock) = (solvers.len(), Instant::now());
    for (number, solver) in solvers.into_iter().enumerate() {
        match Way::new(&case, solver, &options.adapter) {
            Ok(mut way) => {
                if ways.is_empty() {
                    let tolerance = options.tolerances[0];
                    way.path.set_tolerance(tolerance);
                    let done = sub_step(&mut way.path, case.state, case.density())?;
                    let seconds = Spread::of(vec![done.seconds]);
                    tell(Heard::First(&case.row(&way, tolerance, seconds, &done)));
                }
                ways.push(way);
            }
            // The adapter has no f64, or solids are too large for the form.
            Err(error @ Error::Limit { .. }) => refused = Some(error),
            Err(error) => return Err(error),
        }
        tell(Heard::Progress(Progress {
            on: on.clone(),
            work: "solvers made",
            done: number + 1,
            of: n,
            seconds: clock.elapsed().as_secs_f64(),
        }));
    }
    if ways.is_empty() {
        return Err(refused.unwrap_or_else(|| {
            Error::input(
                scene.file.display().to_string(),
                "none of the precisions and preconditioners asked for can solve it",
                "block_jacobi is for solids in liquid, and f32 not for the condensed form: add others",
            )
        }));
    }
    let found = repeat_shuffled((on, ways.len()), options, tell, |way, tolerance| {
        let path = &mut ways[way].path;
        path.set_tolerance(tolerance);
        sub_step(path, case.state, case.density())
    })?;
    let rows = found
        .into_iter()
        .map(|((way, tolerance), (seconds, done))| {
            case.row(&ways[way], options.tolerances[tolerance], seconds, &done)
        });
    Ok(rows.collect())
}

impl<'a> Case<'a> {
    fn new(scene: &'a Scene, state: &'a State) -> Result<Case<'a>, Error> {
        let mut exact = scene.clone();
        exact.solver.precision = Precision::F64;
        exact.solver.tolerance = EXACT;
        exact.solver.max_iterations = MOST_ITERATIONS;
        let mut reference = reference_path(&exact)?;
        reference.reset(state.clone())?;
        let dt = reference.next_time_step().dt;
        let done = reference_step(&mut reference, state)?;
        let case = Case {
            scene,
            state,
            exact: done.answer,
            faces: done.faces,
            mask: Mask::of(&reference),
            dt,
        };
        case.ensure_truth("the f64 path", done.report.solves())?;
        Ok(case)
    }

    /// Refuses as a truth what was not solved for; `of`: where its system is from.
    fn ensure_truth(
        &self,
        of: &str,
        solves: impl IntoIterator<Item = SolveReport>,
    ) -> Result<(), Error> {
        let what = format!("{}, frame {}, {of}", self.scene.name, self.state.frame);
        ensure_truth(&what, self.state.step, solves)
    }

    /// kg/m^3
    fn density(&self) -> f64 {
        self.scene
            .liquid
            .as_ref()
            .map_or(0.0, |liquid| liquid.density)
    }

    fn row(&self, way: &Way, tolerance: f64, seconds: Spread, done: &Done) -> Row {
        let report = &done.report;
        let liquid = report.liquid.map(|liquid| (liquid.solve, liquid.diagnosis));
        let solid = report.solid.map(|solid| solid.solve);
        let solves = [liquid.map(|(solve, _)| solve), solid];
        let touching = report.coupling.is_some_and(|both| both.touching);
        let iterations = solves.map(|solve| solve.map_or(0, |solve| solve.iterations));
        let reports: Vec<SolveReport> = solves.into_iter().flatten().collect();
        let of_cells = |a: &[f64], b: &[f64]| {
            let pairs = a.iter().zip(b).zip(&self.mask.cells);
            relative(
                pairs
                    .filter(|(_, counts)| **counts)
                    .map(|((a, b), _)| (*a, *b)),
            )
        };
        let of_nodes = |a: &[[f64; 3]], b: &[[f64; 3]]| {
            let pairs = a.as_flattened().iter().zip(b.as_flattened());
            relative(pairs.map(|(a, b)| (*a, *b)))
        };
        let gravity = self.scene.domain.gravity.length();
        Row {
            scene: self.scene.name.clone(),
            frame: self.state.frame,
            cells: self.scene.grid().n_cells(),
            unknowns: solves[0].map_or(0, |solve| solve.unknowns),
            solid_unknowns: solves[1].map_or(0, |solve| solve.unknowns),
            precision: name(way.precision),
            preconditioner: preconditioner_name(way.preconditioner),
            formulation: match (touching, report.coupling) {
                (true, Some(both)) if both.condensed => "condensed",
                (true, _) => "two-field",
                (false, _) => "apart",
            },
            tolerance,
            status: Ended::of_reports(&reports).name(tolerance),
            // Where both are solved together each has all of them.
            iterations: match touching {
                true => iterations[0],
                false => iterations.iter().sum(),
            },
            seconds_median: seconds.median,
            seconds_min: seconds.min,
            seconds_max: seconds.max,
            residual_p: solves[0].map_or(0.0, |solve| solve.residual),
            residual_v: solves[1].map_or(0.0, |solve| solve.residual),
            error_p: of_cells(&done.answer.pressure, &way.truth.pressure),
            error_v: of_nodes(&done.answer.velocity, &way.truth.velocity),
            step_error_p: of_cells(&done.answer.pressure, &self.exact.pressure),
            step_error_v: of_nodes(&done.answer.velocity, &self.exact.velocity),
            step_error_u: self.of_faces(&done.faces),
            truth_residual: way.truth_residual,
            divergence: liquid.map_or(0.0, |(_, diagnosis)| diagnosis.divergence),
            speed_over_g_dt: match gravity > 0.0 {
                true => {
                    liquid.map_or(0.0, |(_, diagnosis)| diagnosis.max_speed) / (gravity * self.dt)
                }
                false => 0.0,
            },
        }
    }

    /// Error of the velocities on the faces that count.
    fn of_faces(&self, found: &[Vec<f64>; 3]) -> f64 {
        let axes = found.iter().zip(&self.faces).zip(&self.mask.faces);
        let pairs = axes.flat_map(|((found, exact), counts)| {
            let pairs = found.iter().zip(exact).zip(counts);
            pairs
                .filter(|(_, counts)| **counts)
                .map(|((a, b), _)| (*a, *b))
        });
        relative(pairs)
    }
}

/// Largest difference of pairs over the largest second of them; 0 where all of them are 0, not a number where one is not.
fn relative(pairs: impl Iterator<Item = (f64, f64)>) -> f64 {
    let [off, largest] = pairs.fold([0.0; 2], |[off, largest], (a, b)| {
        [larger(off, (a - b).abs()), larger(largest, b.abs())]
    });
    if off == 0.0 { 0.0 } else { off / largest }
}

impl Way {
    fn new(case: &Case, solver: Solver, adapter: &AdapterChoice) -> Result<Way, Error> {
        let mut scene = case.scene.clone();
        scene.solver = solver;
        let mut path = GpuPath::open(&scene, adapter)?;
        // Compiles, and shows the system.
        path.write_state(case.state)?;
        let dt = path.next_time_step().dt;
        let (mut inflow, mut truth) = (Vec::new(), None);
        path.step_observed(&mut |stage, path| {
            if stage == Stage::RightHandSide {
                inflow = path
                    .snapshot()?
                    .liquid
                    .map_or(Vec::new(), |liquid| liquid.rhs);
            } else if stage == Stage::Solve {
                let (answer, solves) =
                    solution(path, &path.snapshot()?, &inflow, case.density(), dt)?;
                let of = format!("stored in {}", name(solver.precision));
                let residuals = solves.iter().map(|solve| solve.residual);
                let residual = residuals.fold(0.0, larger);
                case.ensure_truth(&of, solves)?;
                truth = Some((answer, residual));
            }
            Ok(())
        })?;
        let (truth, truth_residual) = truth.expect("every sub-step has a solve");
        Ok(Way {
            precision: solver.precision,
            preconditioner: solver.preconditioner,
            path,
            truth,
            truth_residual,
        })
    }
}

/// The solution of the system that a device stores, and the reports of its solves.
fn solution(
    path: &GpuPath,
    snapshot: &Snapshot,
    inflow: &[f64],
    density: f64,
    dt: f64,
) -> Result<(Answer, Vec<SolveReport>), Error> {
    let settings = Solver {
        tolerance: EXACT,
        max_iterations: MOST_ITERATIONS,
        precision: Precision::F64,
        ..Solver::default()
    };
    if let Some((system, all)) = stored::system_of_both(path, snapshot, inflow, density, dt) {
        let solver = SolidSolver::new(&all);
        let found = solve_coupled(&system, Form::of(&system), &solver, &all, &settings)?;
        let answer = Answer {
            pressure: found.pressure,
            velocity: found.velocity,
        };
        return Ok((answer, found.reports.into()));
    }
    let mut answer = Answer {
        pressure: Vec::new(),
        velocity: Vec::new(),
    };
    let mut solves = Vec::new();
    if let Some(liquid) = &snapshot.liquid {
        let system = stored::pressure_system(path, liquid, density, dt);
        let (pressure, report) = solve(&system, &settings)?;
        answer.pressure = pressure;
        solves.push(report);
    }
    if let Some(solids) = &snapshot.solids {
        let (system, all) = stored::solid_system(path, solids, dt);
        let (velocity, report) = SolidSolver::new(&all).solve_direct(&system, &settings)?;
        answer.velocity = velocity;
        solves.push(report);
    }
    Ok((answer, solves))
}

/// Scenes and frames, in the order of the rows.
pub(super) fn states(rows: &[Row]) -> Vec<(String, u64)> {
    let mut states: Vec<(String, u64)> = Vec::new();
    for row in rows {
        let state = (row.scene.clone(), row.frame);
        if !states.contains(&state) {
            states.push(state);
        }
    }
    states
}

/// The cheapest rows for each target.
pub(super) fn recommend(rows: &[Row]) -> Vec<Best> {
    let mut best = Vec::new();
    for (scene, frame) in states(rows) {
        let candidates = rows
            .iter()
            .filter(|row| row.scene == scene && row.frame == frame && is_solved(row.status));
        let error = |row: &Row| larger(row.error_p, row.error_v);
        let found = recommended(candidates, &TARGETS, error, Row::choice);
        best.extend(found.into_iter().map(|(target, row)| Best {
            scene: scene.clone(),
            frame,
            target,
            precision: row.precision,
            preconditioner: row.preconditioner,
            formulation: row.formulation,
            tolerance: row.tolerance,
            iterations: row.iterations,
            seconds_median: row.seconds_median,
            seconds_min: row.seconds_min,
            seconds_max: row.seconds_max,
            error_p: row.error_p,
            error_v: row.error_v,
            step_error_p: row.step_error_p,
            step_error_v: row.step_error_v,
            step_error_u: row.step_error_u,
        }));
    }
    best
}

#[cfg(test)]
mod tests {
    use super::{Row, recommend, relative};

    fn row(error_p: f64, error_v: f64) -> Row {
        Row {
            scene: "dam_break".to_owned(),
            frame: 10,
            cells: 1,
            unknowns: 1,
            solid_unknowns: 1,
            precision: "mixed",
            preconditioner: "multigrid",
            formulation: "condensed",
            tolerance: 1e-6,
            status: "converged",
            iterations: 1,
            seconds_median: 1.0,
            seconds_min: 1.0,
            seconds_max: 1.0,
            residual_p: 0.0,
            residual_v: 0.0,
            error_p,
            error_v,
            step_error_p: 0.0,
            step_error_v: 0.0,
            step_error_u: 0.0,
            truth_residual: 0.0,
            divergence: 0.0,
            speed_over_g_dt: 0.0,
        }
    }

    #[test]
    fn what_is_not_a_number_is_no_error() {
        let of = |pairs: [(f64, f64); 2]| relative(pairs.into_iter());
        assert_eq!(of([(1.0, 2.0), (4.0, 4.0)]), 0.25);
        assert_eq!(of([(0.0, 0.0); 2]), 0.0);
        for nan in [(f64::NAN, 1.0), (1.0, f64::NAN)] {
            assert!(of([nan, (4.0, 4.0)]).is_nan() && of([(4.0, 4.0), nan]).is_nan());
        }
    }

    #[test]
    fn what_has_an_error_that_is_not_a_number_is_not_recommended() {
        for error in [[f64::NAN, 0.0], [0.0, f64::NAN]] {
            assert!(recommend(&[row(error[0], error[1])]).is_empty());
        }
        assert_eq!(recommend(&[row(1e-5, 1e-7)]).len(), 2);
    }
}
