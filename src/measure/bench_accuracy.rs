//! `bench accuracy`: what accuracy costs in time, on chosen states of chosen scenes.
//!
//! A scene runs to a frame; the sub-step that follows is then done again and again from the same state, in every precision, with every
//! preconditioner, in every form of the corrections and to every tolerance, repeats in a shuffled order. The solve is timed on the host
//! from when the right-hand sides are in place to when the answer is. Its errors are those against two truths: the direct solution in f64
//! of the system that the device stores in that precision, which is what the solver could do better, and the same sub-step on the f64 path,
//! which is what the whole path could do better. Systems of more than 60,000 unknowns have no direct solution: theirs is refined to 1e-13.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::Instant;

use plotters::prelude::*;
use serde::Serialize;

use crate::Error;
use crate::effects::Effects;
use crate::gpu::{AdapterChoice, Gpu};
use crate::grid::Axis;
use crate::reference::{Formulation as Form, SolidSolver, solve, solve_coupled};
use crate::scene::{CouplingScheme, Formulation, Precision, Preconditioner, Scene, Solver};
use crate::sim::{Backend, GpuPath, Simulation, Snapshot, reference_path};
use crate::stages::{Diagnose, RightHandSide};
use crate::state::{SolveStatus, State, StepReport};

use super::bench_solve::{name, preconditioner_name};
use super::statistics::Spread;
use super::stored;
use super::table::{Machine, write_csv, write_json, write_svg};

/// Of the truths.
const EXACT: f64 = 1e-13;
const MOST_ITERATIONS: u32 = 20_000;
/// Errors that a recommendation is made for.
const TARGETS: [f64; 5] = [1e-2, 1e-4, 1e-6, 1e-8, 1e-10];
/// Of the shuffling: the same order in every run.
const SEED: u64 = 20;

/// What to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Scenes, scaled.
    pub scenes: Vec<Scene>,
    /// Frames of each from whose states a sub-step is done, ascending.
    pub frames: Vec<u64>,
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
    /// `converged`, or how else the solve ended.
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
    /// Largest divergence after the projection, 1/s.
    pub divergence: f64,
    /// Largest speed of the liquid over g dt: of a liquid at rest, how well pressure balances gravity.
    pub speed_over_g_dt: f64,
}

/// The cheapest row that is as accurate as a target.
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
    pub error_p: f64,
    /// As in [`Row`].
    pub error_v: f64,
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
}

/// A pressure per cell, Pa, and velocities of the nodes, m/s.
pub(super) struct Answer {
    pub(super) pressure: Vec<f64>,
    pub(super) velocity: Vec<[f64; 3]>,
}

/// A sub-step from a state.
struct Case<'a> {
    scene: &'a Scene,
    state: &'a State,
    /// On the f64 path.
    exact: Answer,
    /// Its velocities on the faces, m/s.
    faces: [Vec<f64>; 3],
    /// Its unknowns.
    active: Vec<bool>,
    dt: f64,
}

/// A way to solve it.
struct Way {
    precision: Precision,
    preconditioner: Preconditioner,
    path: GpuPath,
    /// The solution of the system that it stores.
    truth: Answer,
}

/// What a sub-step came to.
pub(super) struct Done {
    /// Of the solve.
    pub(super) seconds: f64,
    pub(super) report: StepReport,
    pub(super) answer: Answer,
    pub(super) faces: [Vec<f64>; 3],
}

/// Measures all rows and writes accuracy.csv, accuracy_best.csv, accuracy.json and accuracy.svg into `out`; `tell` hears of each row.
///
/// # Errors
/// [`Error::Input`] for scenes of weak or damping-only coupling, [`Error::Output`], and what the simulations say.
pub fn bench_accuracy(
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(&Row),
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
    if options.scenes.is_empty() {
        return Err(Error::input(
            "bench accuracy",
            "no scene to measure",
            "give one scene file or more",
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
            for row in measure(scene, &state, options)? {
                tell(&row);
                rows.push(row);
            }
        }
    }
    let best = recommend(&rows);
    let table = Table {
        machine,
        rows,
        best,
    };
    write_csv(&table.rows, &out.join("accuracy.csv"))?;
    write_csv(&table.best, &out.join("accuracy_best.csv"))?;
    write_json(&table, &out.join("accuracy.json"))?;
    let states = states(&table.rows).len() as u32;
    write_svg(&out.join("accuracy.svg"), (1200, 480 * states), |page| {
        draw(&table.rows, page)
    })?;
    Ok(table)
}

/// All rows of a state.
fn measure(scene: &Scene, state: &State, options: &Options) -> Result<Vec<Row>, Error> {
    let case = Case::new(scene, state)?;
    let (mut ways, mut refused) = (Vec::new(), None);
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
                let solver = Solver {
                    precision,
                    preconditioner,
                    formulation: if together {
                        formulation
                    } else {
                        Formulation::Auto
                    },
                    max_iterations: options.max_iterations,
                    ..scene.solver
                };
                match Way::new(&case, solver, &options.adapter) {
                    Ok(way) => ways.push(way),
                    // The adapter has no f64, or solids are too large for the form.
                    Err(error @ Error::Limit { .. }) => refused = Some(error),
                    Err(error) => return Err(error),
                }
            }
        }
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
    let mut jobs: Vec<(usize, usize)> = Vec::new();
    for way in 0..ways.len() {
        for tolerance in 0..options.tolerances.len() {
            jobs.extend(vec![(way, tolerance); options.repeats.max(1)]);
        }
    }
    fastrand::Rng::with_seed(SEED).shuffle(&mut jobs);
    let mut found: BTreeMap<(usize, usize), (Vec<f64>, Done)> = BTreeMap::new();
    for job in jobs {
        let way = &mut ways[job.0];
        way.path.set_tolerance(options.tolerances[job.1]);
        let done = sub_step(&mut way.path, case.state, case.density())?;
        found
            .entry(job)
            .and_modify(|(seconds, _)| seconds.push(done.seconds))
            .or_insert_with(|| (vec![done.seconds], done));
    }
    let rows = found
        .into_iter()
        .map(|((way, tolerance), (seconds, done))| {
            case.row(
                &ways[way],
                options.tolerances[tolerance],
                Spread::of(seconds),
                &done,
            )
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
        let time_step = reference.next_time_step();
        reference.step(time_step)?;
        let State {
            pressure,
            node_velocity: velocity,
            velocity: faces,
            active,
            ..
        } = reference.state().clone();
        Ok(Case {
            scene,
            state,
            exact: Answer { pressure, velocity },
            faces,
            active,
            dt: time_step.dt,
        })
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
        let mut statuses = solves.into_iter().flatten().map(|solve| solve.status);
        let failed = statuses.find(|status| *status != SolveStatus::Converged);
        let active = |cell: usize| self.active.get(cell).is_some_and(|active| *active);
        let of_cells = |a: &[f64], b: &[f64]| {
            let pairs = a.iter().zip(b).enumerate();
            let pairs = pairs.filter(|(cell, _)| active(*cell));
            relative(pairs.map(|(_, (a, b))| (*a, *b)))
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
            status: failed.unwrap_or(SolveStatus::Converged).name(),
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
            divergence: liquid.map_or(0.0, |(_, diagnosis)| diagnosis.divergence),
            speed_over_g_dt: match gravity > 0.0 {
                true => {
                    liquid.map_or(0.0, |(_, diagnosis)| diagnosis.max_speed) / (gravity * self.dt)
                }
                false => 0.0,
            },
        }
    }

    /// Error of the velocities on the faces of active cells.
    fn of_faces(&self, found: &[Vec<f64>; 3]) -> f64 {
        let grid = self.scene.grid();
        let pairs = Axis::ALL.into_iter().flat_map(|axis| {
            let (found, exact) = (&found[axis.index()], &self.faces[axis.index()]);
            let of_liquid = move |face: &usize| {
                let sides = grid.face_sides(axis, grid.face_at(axis, *face)).into_iter();
                sides.flatten().any(|cell| self.active[cell])
            };
            let faces = (0..found.len()).filter(of_liquid);
            faces.map(|face| (found[face], exact[face]))
        });
        relative(pairs)
    }
}

/// Largest difference of pairs over the largest second of them; 0 where all of them are 0.
fn relative(pairs: impl Iterator<Item = (f64, f64)>) -> f64 {
    let [off, largest] = pairs.fold([0.0; 2], |[off, largest], (a, b)| {
        [f64::max(off, (a - b).abs()), f64::max(largest, b.abs())]
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
            if stage == RightHandSide::NAME {
                inflow = path
                    .snapshot()?
                    .liquid
                    .map_or(Vec::new(), |liquid| liquid.rhs);
            } else if stage == "solve" {
                truth = Some(solution(
                    path,
                    &path.snapshot()?,
                    &inflow,
                    case.density(),
                    dt,
                )?);
            }
            Ok(())
        })?;
        Ok(Way {
            precision: solver.precision,
            preconditioner: solver.preconditioner,
            path,
            truth: truth.expect("every sub-step has a solve"),
        })
    }
}

/// The solution of the system that a device stores.
fn solution(
    path: &GpuPath,
    snapshot: &Snapshot,
    inflow: &[f64],
    density: f64,
    dt: f64,
) -> Result<Answer, Error> {
    let settings = Solver {
        tolerance: EXACT,
        max_iterations: MOST_ITERATIONS,
        precision: Precision::F64,
        ..Solver::default()
    };
    if let Some((system, all)) = stored::system_of_both(path, snapshot, inflow, density, dt) {
        let solver = SolidSolver::new(&all);
        let found = solve_coupled(&system, Form::of(&system), &solver, &all, &settings)?;
        return Ok(Answer {
            pressure: found.pressure,
            velocity: found.velocity,
        });
    }
    let mut answer = Answer {
        pressure: Vec::new(),
        velocity: Vec::new(),
    };
    if let Some(liquid) = &snapshot.liquid {
        let system = stored::pressure_system(path, liquid, density, dt);
        (answer.pressure, _) = solve(&system, &settings)?;
    }
    if let Some(solids) = &snapshot.solids {
        let (system, all) = stored::solid_system(path, solids, dt);
        (answer.velocity, _) = SolidSolver::new(&all).solve_direct(&system, &settings)?;
    }
    Ok(answer)
}

/// Does the sub-step after a state once, with liquid of this density (kg/m^3).
pub(super) fn sub_step(path: &mut GpuPath, state: &State, density: f64) -> Result<Done, Error> {
    path.write_state(state)?;
    let mut clock = None;
    let (mut seconds, mut answer, mut faces) = (0.0, None, Default::default());
    let dt = path.next_time_step().dt;
    let report = path.step_observed(&mut |stage, path| {
        path.gpu().wait("bench")?;
        if stage == RightHandSide::NAME {
            clock = Some(Instant::now());
        } else if stage == "solve" {
            seconds = clock.map_or(0.0, |clock| clock.elapsed().as_secs_f64());
            let Snapshot { liquid, solids, .. } = path.snapshot()?;
            let pressure = |liquid| stored::pressure(path, &liquid, density, dt);
            answer = Some(Answer {
                pressure: liquid.map_or(Vec::new(), pressure),
                velocity: solids.map_or(Vec::new(), |solids| solids.velocity),
            });
        } else if stage == Diagnose::NAME
            && let Some(liquid) = path.snapshot()?.liquid
        {
            faces = liquid.velocity;
        }
        Ok(())
    })?;
    Ok(Done {
        seconds,
        report,
        answer: answer.expect("every sub-step has a solve"),
        faces,
    })
}

/// Scenes and frames, in the order of the rows.
fn states(rows: &[Row]) -> Vec<(String, u64)> {
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
fn recommend(rows: &[Row]) -> Vec<Best> {
    let mut best = Vec::new();
    for (scene, frame) in states(rows) {
        for target in TARGETS {
            let meets = |row: &&Row| {
                let error = row.error_p.max(row.error_v);
                row.scene == scene && row.frame == frame && error <= target
            };
            let meeting = rows.iter().filter(meets);
            let cheapest = meeting.min_by(|a, b| a.seconds_median.total_cmp(&b.seconds_median));
            best.extend(cheapest.map(|row| Best {
                scene: scene.clone(),
                frame,
                target,
                precision: row.precision,
                preconditioner: row.preconditioner,
                formulation: row.formulation,
                tolerance: row.tolerance,
                iterations: row.iterations,
                seconds_median: row.seconds_median,
                error_p: row.error_p,
                error_v: row.error_v,
            }));
        }
    }
    best
}

type ErrorOf = fn(&Row) -> f64;

/// Error against seconds: a line of charts per state, of the pressure and of the velocities.
fn draw(rows: &[Row], page: SVGBackend) -> Result<(), Box<dyn std::error::Error>> {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let states = states(rows);
    let charts = root.split_evenly((states.len(), 2));
    let key = |row: &Row| {
        format!(
            "{} {} {}",
            row.precision, row.preconditioner, row.formulation
        )
    };
    let mut keys: Vec<String> = rows.iter().map(key).collect();
    keys.sort();
    keys.dedup();
    let errors: [(&str, ErrorOf); 2] = [
        ("error of p", |row| row.error_p),
        ("error of v", |row| row.error_v),
    ];
    for ((scene, frame), charts) in states.iter().zip(charts.chunks(2)) {
        let here = |row: &&Row| row.scene == *scene && row.frame == *frame;
        for ((label, error), chart) in errors.iter().zip(charts) {
            let drawn = |row: &&Row| here(row) && error(row) > 0.0;
            let points = rows.iter().filter(drawn);
            let points: Vec<(f64, f64)> =
                points.map(|row| (row.seconds_median, error(row))).collect();
            if points.is_empty() {
                continue;
            }
            let range = |of: fn(&(f64, f64)) -> f64| {
                let values = || points.iter().map(of);
                let (least, most) = (
                    values().fold(f64::INFINITY, f64::min),
                    values().fold(0.0, f64::max),
                );
                least / 1.5..most * 1.5
            };
            let mut chart = ChartBuilder::on(chart)
                .caption(format!("{scene}, frame {frame}"), ("sans-serif", 18))
                .margin(12)
                .x_label_area_size(44)
                .y_label_area_size(70)
                .build_cartesian_2d(
                    range(|point| point.0).log_scale(),
                    range(|point| point.1).log_scale(),
                )?;
            chart
                .configure_mesh()
                .x_desc("seconds of the solve")
                .x_labels(6)
                .max_light_lines(1)
                .x_label_formatter(&|seconds| format!("{seconds:.1e}"))
                .y_desc(*label)
                .y_label_formatter(&|error| format!("{error:.0e}"))
                .draw()?;
            for (index, series) in keys.iter().enumerate() {
                let of_series = |row: &&Row| drawn(row) && key(row) == *series;
                let rows: Vec<&Row> = rows.iter().filter(of_series).collect();
                if rows.is_empty() {
                    continue;
                }
                let colour = Palette99::pick(index).to_rgba();
                let points = rows.iter().map(|row| (row.seconds_median, error(row)));
                chart
                    .draw_series(LineSeries::new(points, colour.stroke_width(2)).point_size(3))?
                    .label(series.as_str())
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour));
                for row in rows {
                    let y = error(row);
                    let spread = [(row.seconds_min, y), (row.seconds_max, y)];
                    chart.draw_series([PathElement::new(spread, colour)])?;
                }
            }
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::LowerLeft)
                .border_style(BLACK)
                .background_style(WHITE.mix(0.8))
                .draw()?;
        }
    }
    root.present()?;
    Ok(())
}
