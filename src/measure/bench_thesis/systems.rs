//! Tables 6.2, 6.3 and 6.4: the matrices of the formulations and the time that their solves take, on states of the dam break.
//!
//! The scene is `scenes/conditioning_40.toml` with other grids and beams. It runs on the device; the system of the sub-step that follows
//! a frame is then assembled by the f64 path and solved in each formulation, all to the same true residuals of the indefinite system,
//! matrices and factors included; and the device does that sub-step, its matrices and hierarchy included.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use serde::{Deserialize, Deserializer, Serialize};

use super::condition::conditions;
use super::parts::ANEW;
use super::{MOST_ITERATIONS, Options, PATIENCE, TOLERANCE, ThesisTable};
use crate::Error;
use crate::elastic::Solids;
use crate::measure::bench_accuracy::sub_step;
use crate::measure::bench_solve::{Ended, bricks_across, is_solved, name};
use crate::measure::statistics::{Spread, exponent};
use crate::reference::{
    BlockPattern, CoupledSystem, Formulation as Form, Reference, SolidSolver, StepSystem,
    StressVariables, solid_matrices, solve_coupled,
};
use crate::scene::{Formulation, Precision, Scene, SolidMesh, Solver};
use crate::sim::{Backend, GpuPath, Simulation, reference_path, solids_of};
use crate::state::{SolveReport, State, StepReport};

const SCENE: &str = include_str!("../../../scenes/conditioning_40.toml");
/// The share of the mass in Z1 that the thesis "exclusively used".
const SIGMA: f64 = 0.9;
/// Its factor before the velocities (5.36), Pa s/m.
const ALPHA: f64 = 1e-3;
/// Bricks across the beams of tables 6.3 and 6.4: 135 and 725 nodes.
const BEAMS: [usize; 2] = [2, 4];

/// Cells along an edge, and nonzeros, logarithms of condition numbers and seconds of a solve, indefinite and positive definite.
const PRINTED_6_2: [(usize, [[f64; 2]; 3]); 3] = [
    (40, [[157498.0, 185503.0], [8.347, 10.497], [1.635, 1.813]]),
    (60, [[499787.0, 610697.0], [8.579, 11.311], [16.121, 8.292]]),
    (
        80,
        [[1177419.0, 1439173.0], [8.819, 11.497], [100.875, 28.020]],
    ),
];

/// Cells along an edge, and with 135 nodes, then with 725: seconds per frame in velocities and in stresses.
const PRINTED_6_3: [(usize, [[f64; 2]; 2]); 5] = [
    (50, [[5.33, 6.69], [14.15, 27.68]]),
    (60, [[9.51, 9.90], [19.76, 32.02]]),
    (70, [[15.75, 15.32], [29.89, 36.98]]),
    (80, [[23.54, 22.21], [44.04, 47.87]]),
    (90, [[35.93, 31.56], [59.09, 58.76]]),
];

/// The same of nonzeros.
const PRINTED_6_4: [(usize, [[f64; 2]; 2]); 5] = [
    (50, [[317505.0, 814424.0], [624387.0, 5654643.0]]),
    (60, [[501430.0, 998372.0], [807789.0, 5838273.0]]),
    (70, [[795668.0, 1218020.0], [1095644.0, 6130135.0]]),
    (80, [[1128123.0, 1545752.0], [1425174.0, 6456548.0]]),
    (90, [[1565587.0, 1985347.0], [1856102.0, 6890398.0]]),
];

/// A name in a row. By its own name, for serde would borrow a `&str` from the file.
type Word = &'static str;

/// A row of thesis_systems.csv. What a table does not have is empty.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SystemRow {
    /// Number of the table.
    #[serde(deserialize_with = "word")]
    pub table: Word,
    /// Cells along an edge.
    pub grid: usize,
    /// Of the beam.
    pub nodes: usize,
    /// Of the beam.
    pub elements: usize,
    /// Frame that the state is of.
    pub frame: u64,
    /// Length of the sub-step, s.
    pub dt: f64,
    /// Sub-steps per frame up to this one.
    pub sub_steps_per_frame: f64,
    /// `indefinite`, `two-field`, `stress` or `condensed`.
    #[serde(deserialize_with = "word")]
    pub formulation: Word,
    /// How it is solved.
    #[serde(deserialize_with = "word")]
    pub solver: Word,
    /// `cpu` or `gpu`.
    #[serde(deserialize_with = "word")]
    pub backend: Word,
    /// `f32`, `mixed` or `f64`.
    #[serde(deserialize_with = "word")]
    pub precision: Word,
    /// Cells with a pressure.
    pub unknowns: usize,
    /// Free components of the nodes' velocities.
    pub solid_unknowns: usize,
    /// Entries of the matrix, both triangles.
    pub nonzeros: Option<usize>,
    /// Logarithm to base 10 of its condition number for the 1-norm, as the thesis has it by `condest`: alpha = 0.001, sigma = 0.9.
    pub log10_condest: Option<f64>,
    /// The same for the 2-norm.
    pub log10_condition: Option<f64>,
    /// That for the 2-norm from all eigenvalues, of matrices so small that these can be had.
    pub log10_condition_exact: Option<f64>,
    /// That for the 2-norm with alpha = 1: SI units.
    pub log10_condition_unscaled: Option<f64>,
    /// How the solve ended.
    #[serde(deserialize_with = "word_if_any")]
    pub status: Option<Word>,
    /// In all rounds.
    pub iterations: Option<u32>,
    /// True relative residual of the pressure's rows.
    pub residual_p: Option<f64>,
    /// Of the velocities' rows.
    pub residual_v: Option<f64>,
    /// Of the solve, matrices and preconditioners included: on the CPU from the assembled B, J and S on; on the device from when the liquid distance
    /// is there, so that active cells, turns of the elements and right-hand sides count, too.
    pub seconds_median: Option<f64>,
    /// Least.
    pub seconds_min: Option<f64>,
    /// Largest.
    pub seconds_max: Option<f64>,
    /// Sub-steps per frame times the seconds of a sub-step: the device's, or this solve with the other stages of the f64 path. Median.
    pub frame_seconds: Option<f64>,
    /// Least.
    pub frame_seconds_min: Option<f64>,
    /// Largest.
    pub frame_seconds_max: Option<f64>,
}

/// A row of thesis_means.csv: a number of a table, as a mean over the states; seconds over those whose solve passed.
#[derive(Clone, Debug, Serialize)]
pub struct Mean {
    /// Number of the table.
    pub table: &'static str,
    /// Cells along an edge.
    pub grid: usize,
    /// Of the beam.
    pub nodes: usize,
    /// Of the beam.
    pub elements: usize,
    /// As in [`SystemRow`].
    pub formulation: &'static str,
    /// As in [`SystemRow`].
    pub solver: &'static str,
    /// As in [`SystemRow`].
    pub backend: &'static str,
    /// As in [`SystemRow`].
    pub precision: &'static str,
    /// `nonzeros`, `log10_condest`, `log10_condition`, `seconds` of a solve or `frame_seconds`.
    pub quantity: &'static str,
    /// How many states.
    pub states: usize,
    /// Mean over them, of seconds of the medians of repeats.
    pub mean: f64,
    /// The same of the least of the repeats: with `high` what running it again changes.
    pub low: f64,
    /// Of the largest.
    pub high: f64,
    /// Least of the states.
    pub least: f64,
    /// Largest.
    pub largest: f64,
    /// Printed: of the positive definite form for solves that the thesis does not have; empty for MINRES and for 2-norms, for it prints neither.
    pub thesis: Option<f64>,
    /// Over the printed one; of condition numbers, not of their logarithms.
    pub ratio: Option<f64>,
}

/// A row of thesis_growth.csv: a number of a table goes with the cells along an edge to this power, by least squares on logarithms.
#[derive(Clone, Debug, Serialize)]
pub struct Growth {
    /// Number of the table.
    pub table: &'static str,
    /// Of the beam; empty where it is refined with the grid.
    pub nodes: Option<usize>,
    /// As in [`SystemRow`].
    pub formulation: &'static str,
    /// As in [`SystemRow`].
    pub solver: &'static str,
    /// As in [`SystemRow`].
    pub backend: &'static str,
    /// As in [`SystemRow`].
    pub precision: &'static str,
    /// As in [`Mean`]; of condition numbers, not of their logarithms.
    pub quantity: &'static str,
    /// Cells along an edge of the coarsest grid.
    pub coarsest: usize,
    /// Of the finest.
    pub finest: usize,
    /// States that each mean is over, at least.
    pub states: usize,
    /// The power.
    pub exponent: f64,
    /// Of the printed numbers on these grids.
    pub thesis: Option<f64>,
}

/// Grid and bricks across the beam.
type Size = (usize, usize);

/// A state of a run, and the system of the sub-step that follows.
struct Case<'a> {
    size: Size,
    scene: &'a Scene,
    solids: &'a Solids,
    state: &'a State,
    system: CoupledSystem,
    stress: StressVariables,
    dt: f64,
    /// The f64 path, which has done that sub-step.
    path: Reference,
}

/// A text of a table that was written before. It stays as long as the process, as those do that rows have from here: they are few.
fn word<'de, D: Deserializer<'de>>(from: D) -> Result<&'static str, D::Error> {
    Ok(String::deserialize(from)?.leak())
}

fn word_if_any<'de, D: Deserializer<'de>>(from: D) -> Result<Option<&'static str>, D::Error> {
    let text = Option::<String>::deserialize(from)?;
    Ok(text.map(|text| &*text.leak()))
}

/// The rows of an earlier run's thesis_systems.csv.
///
/// # Errors
/// [`Error::Input`] where it cannot be read.
pub(super) fn kept(path: &Path) -> Result<Vec<SystemRow>, Error> {
    let rows = csv::Reader::from_path(path).and_then(|reader| reader.into_deserialize().collect());
    rows.map_err(|problem| {
        Error::input(
            path.display().to_string(),
            format!("cannot be read: {problem}"),
            ANEW,
        )
    })
}

/// Gives `take` all rows of the tables asked for that are not kept: those of a table and a state at a time.
pub(super) fn measure(
    options: &Options,
    kept: &[SystemRow],
    take: &mut dyn FnMut(Vec<SystemRow>) -> Result<(), Error>,
) -> Result<(), Error> {
    let mut sizes: BTreeMap<Size, Vec<ThesisTable>> = BTreeMap::new();
    for &table in &options.tables {
        for grid in options.grids_of(table) {
            let beams = match table {
                ThesisTable::T6_2 => vec![bricks_across(grid)],
                ThesisTable::T6_3 | ThesisTable::T6_4 => BEAMS.to_vec(),
                ThesisTable::T6_1 | ThesisTable::T6_5 | ThesisTable::T6_6 => Vec::new(),
            };
            for across in beams {
                sizes.entry((grid, across)).or_default().push(table);
            }
        }
    }
    for (size, tables) in sizes {
        let scene = scene(size)?;
        let solids = solids_of(&scene)?;
        let is_kept = |table: ThesisTable, frame: u64| {
            let of = (table.number(), size.0, solids.rest.len(), frame);
            let mut rows = kept.iter();
            rows.any(|row| (row.table, row.grid, row.nodes, row.frame) == of)
        };
        let missing = |frame: u64| {
            let tables = tables.iter().copied();
            tables.filter(move |&table| !is_kept(table, frame))
        };
        let frames = options.frames.iter().copied();
        let frames: Vec<u64> = frames
            .filter(|&frame| missing(frame).next().is_some())
            .collect();
        if frames.is_empty() {
            continue;
        }
        let mut simulation = Simulation::new(&scene, &Backend::Gpu(options.adapter.clone()))?;
        for frame in frames {
            while simulation.clock().frame < frame {
                simulation.step()?;
            }
            let state = simulation.state()?;
            let case = Case::new(size, &scene, &solids, &state)?;
            for table in missing(frame) {
                take(case.rows(table, options)?)?;
            }
        }
    }
    Ok(())
}

/// The dam break with a beam of k bricks across and 7 k along on n^3 cells.
fn scene((n, across): Size) -> Result<Scene, Error> {
    let cells = vec![format!("domain.cells=[{n}, {n}, {n}]")];
    let file = "scenes/conditioning_40.toml";
    let mut scene = Scene::parse(file.as_ref(), SCENE, &cells, 1.0)?;
    scene.name = format!("conditioning_{n}_{across}");
    if let SolidMesh::Box { cells, .. } = &mut scene.solids[0].mesh {
        *cells = [across, 7 * across, across];
    }
    Ok(scene)
}

/// Whether a frame lies within the scene.
pub(super) fn ensure_frame(frame: u64) -> Result<(), Error> {
    let last = scene((8, 2))?.n_frames();
    if (1..=last).contains(&frame) {
        return Ok(());
    }
    Err(Error::input(
        format!("--frames {frame}"),
        format!("the dam break has frames 1 to {last}"),
        "give frames of these, such as 10,40,80",
    ))
}

impl<'a> Case<'a> {
    fn new(
        size: Size,
        scene: &'a Scene,
        solids: &'a Solids,
        state: &'a State,
    ) -> Result<Case<'a>, Error> {
        let mut exact = scene.clone();
        exact.solver.precision = Precision::F64;
        let mut path = reference_path(&exact)?;
        path.reset(state.clone())?;
        let time_step = path.next_time_step();
        let mut taken = None;
        path.step_observed(time_step, &mut |system| {
            if let StepSystem::Coupled(system, ..) = system {
                taken = Some(system.clone());
            }
        })?;
        let system = taken.ok_or_else(|| {
            Error::input(
                format!("--frames {}", state.frame),
                "the water does not touch the beam then on such a grid, and there is no system of both",
                "give later frames, such as 10,40,80",
            )
        })?;
        let pattern = Arc::new(BlockPattern::new(solids));
        let deformed = solid_matrices(solids, &pattern, &path.state().displacement);
        let dt = time_step.dt;
        Ok(Case {
            stress: StressVariables::new(solids, &deformed.deformations, |body| {
                body.zeta_stiffness(dt)
            }),
            size,
            scene,
            solids,
            state,
            system,
            dt,
            path,
        })
    }

    fn sub_steps_per_frame(&self) -> f64 {
        self.state.step as f64 / self.state.frame as f64
    }

    /// A row without what is measured.
    fn row(
        &self,
        table: ThesisTable,
        [formulation, solver]: [&'static str; 2],
        [backend, precision]: [&'static str; 2],
    ) -> SystemRow {
        SystemRow {
            table: table.number(),
            grid: self.size.0,
            nodes: self.solids.rest.len(),
            elements: self.solids.elements.len(),
            frame: self.state.frame,
            dt: self.dt,
            sub_steps_per_frame: self.sub_steps_per_frame(),
            formulation,
            solver,
            backend,
            precision,
            unknowns: self.system.pressure.n_unknowns(),
            solid_unknowns: self.system.solid.n_unknowns(),
            nonzeros: None,
            log10_condest: None,
            log10_condition: None,
            log10_condition_exact: None,
            log10_condition_unscaled: None,
            status: None,
            iterations: None,
            residual_p: None,
            residual_v: None,
            seconds_median: None,
            seconds_min: None,
            seconds_max: None,
            frame_seconds: None,
            frame_seconds_min: None,
            frame_seconds_max: None,
        }
    }

    fn rows(&self, table: ThesisTable, options: &Options) -> Result<Vec<SystemRow>, Error> {
        let blocks = self.system.blocks();
        let mut rows = Vec::new();
        let two_field = Form::TwoFieldIncomplete(SIGMA);
        match table {
            ThesisTable::T6_2 => {
                rows = self.solved(
                    table,
                    &[
                        Form::IndefiniteIterative,
                        Form::IndefiniteMinimalResidual,
                        two_field,
                        Form::Condensed,
                    ],
                    options,
                )?;
                let scaled = conditions(&self.system, SIGMA, ALPHA)?;
                let unscaled = conditions(&self.system, SIGMA, 1.0)?;
                let indefinite = blocks.indefinite().n_entries();
                let definite = blocks.two_field(SIGMA)?.n_entries();
                for row in &mut rows {
                    let of_matrix = match (row.backend, row.formulation) {
                        ("cpu", "indefinite") => {
                            (indefinite, scaled.indefinite, unscaled.indefinite)
                        }
                        ("cpu", "two-field") => (definite, scaled.two_field, unscaled.two_field),
                        _ => continue,
                    };
                    row.nonzeros = Some(of_matrix.0);
                    row.log10_condest = Some(of_matrix.1.one_norm);
                    row.log10_condition = Some(of_matrix.1.two_norm);
                    row.log10_condition_exact = of_matrix.1.two_norm_exact;
                    row.log10_condition_unscaled = Some(of_matrix.2.two_norm);
                }
            }
            ThesisTable::T6_3 => {
                let forms = [two_field, Form::StressIncomplete(&self.stress)];
                rows = self.solved(table, &forms, options)?;
            }
            ThesisTable::T6_4 => {
                let matrices = [
                    ("two-field", blocks.two_field(SIGMA)?),
                    ("stress", self.stress.system(&blocks)?.1),
                ];
                for (form, matrix) in matrices {
                    let mut row = self.row(table, [form, ""], ["cpu", "f64"]);
                    row.nonzeros = Some(matrix.n_entries());
                    rows.push(row);
                }
            }
            ThesisTable::T6_1 | ThesisTable::T6_5 | ThesisTable::T6_6 => {}
        }
        Ok(rows)
    }

    /// A row per form on the CPU, and the device's; repeats go round by round.
    fn solved(
        &self,
        table: ThesisTable,
        forms: &[Form],
        options: &Options,
    ) -> Result<Vec<SystemRow>, Error> {
        let settings = |precision, formulation| Solver {
            tolerance: TOLERANCE,
            max_iterations: MOST_ITERATIONS,
            precision,
            formulation,
            ..self.scene.solver
        };
        let mut devices = Vec::new();
        for &precision in &options.precisions {
            let mut formulations = vec![Formulation::Auto];
            if precision != Precision::F32 {
                formulations.push(Formulation::TwoField);
            }
            for formulation in formulations {
                let mut scene = self.scene.clone();
                scene.solver = settings(precision, formulation);
                match GpuPath::open(&scene, &options.adapter) {
                    Ok(path) => devices.push((precision, path)),
                    Err(Error::Limit { .. }) if precision == Precision::F64 => {}
                    Err(error) => return Err(error),
                }
            }
        }
        let density = self
            .scene
            .liquid
            .as_ref()
            .map_or(0.0, |liquid| liquid.density);
        for (_, path) in &mut devices {
            // The first compiles.
            sub_step(path, self.state, density)?;
        }
        let settings = settings(Precision::F64, Formulation::Auto);
        let mut path = self.path.clone();
        let mut steps: Vec<StepReport> = Vec::new();
        let mut timed = vec![Vec::new(); forms.len()];
        let mut of_device = vec![(Vec::new(), Vec::new()); devices.len()];
        let mut reports = vec![None; forms.len()];
        let mut told = vec![None; devices.len()];
        for _ in 0..options.repeats.max(1) {
            if steps.iter().map(|step| step.seconds_total).sum::<f64>() <= PATIENCE {
                path.reset(self.state.clone())?;
                steps.push(path.step(path.next_time_step())?);
            }
            for (number, &form) in forms.iter().enumerate() {
                if timed[number].iter().sum::<f64>() > PATIENCE {
                    continue;
                }
                let clock = Instant::now();
                let solver = SolidSolver::new(self.solids);
                let found = solve_coupled(&self.system, form, &solver, self.solids, &settings)?;
                timed[number].push(clock.elapsed().as_secs_f64());
                reports[number] = Some(found.reports);
            }
            for (number, (_, path)) in devices.iter_mut().enumerate() {
                if of_device[number].0.iter().sum::<f64>() > PATIENCE {
                    continue;
                }
                let done = sub_step(path, self.state, density)?;
                path.write_state(self.state)?;
                let whole = path.step_observed(&mut |_, _| Ok(()))?.seconds_total;
                of_device[number].0.push(done.seconds);
                of_device[number].1.push(whole);
                told[number] = Some(done.report);
            }
        }
        let others = Spread::of(steps.iter().map(other_stages).collect());
        let mut rows = Vec::new();
        for ((form, seconds), reports) in forms.iter().zip(timed).zip(reports) {
            let (formulation, solver) = match form {
                Form::Condensed => ("condensed", "multigrid CG"),
                _ => form.name().split_once(", ").expect("a form has its solver"),
            };
            let mut row = self.row(table, [formulation, solver], ["cpu", "f64"]);
            let seconds = Spread::of(seconds);
            let whole = Spread {
                median: seconds.median + others.median,
                min: seconds.min + others.min,
                max: seconds.max + others.max,
            };
            row.measured(reports.expect("there is at least one"), seconds, whole);
            rows.push(row);
        }
        for (((precision, _), (solves, wholes)), report) in devices.iter().zip(of_device).zip(told)
        {
            let report = report.expect("there is at least one");
            let condensed = report.coupling.is_some_and(|both| both.condensed);
            let formulation = if condensed { "condensed" } else { "two-field" };
            let what = [formulation, "multigrid CG"];
            let mut row = self.row(table, what, ["gpu", name(*precision)]);
            let solves_of_both: Vec<SolveReport> = report.solves().collect();
            let reports = [solves_of_both[0], solves_of_both[1]];
            row.measured(reports, Spread::of(solves), Spread::of(wholes));
            // `auto` may have taken the same form.
            let same = |other: &SystemRow| {
                [other.backend, other.formulation, other.precision]
                    == [row.backend, row.formulation, row.precision]
            };
            if !rows.iter().any(same) {
                rows.push(row);
            }
        }
        Ok(rows)
    }
}

/// Of a sub-step of the f64 path but for its solve, s.
fn other_stages(step: &StepReport) -> f64 {
    let solve = step.seconds.iter().filter(|(stage, _)| *stage == "solve");
    step.seconds_total - solve.map(|(_, seconds)| seconds).sum::<f64>()
}

impl SystemRow {
    fn measured(&mut self, reports: [SolveReport; 2], seconds: Spread, sub_step: Spread) {
        self.status = Some(Ended::of_reports(&reports).name(TOLERANCE));
        self.iterations = Some(reports[0].iterations);
        self.residual_p = Some(reports[0].residual);
        self.residual_v = Some(reports[1].residual);
        self.seconds_median = Some(seconds.median);
        self.seconds_min = Some(seconds.min);
        self.seconds_max = Some(seconds.max);
        let sub_steps = self.sub_steps_per_frame;
        self.frame_seconds = Some(sub_steps * sub_step.median);
        self.frame_seconds_min = Some(sub_steps * sub_step.min);
        self.frame_seconds_max = Some(sub_steps * sub_step.max);
    }

    /// What is one line of a table and of a chart.
    fn series(&self) -> Series {
        Series {
            table: self.table,
            nodes: self.nodes,
            ways: [self.formulation, self.solver, self.backend, self.precision],
        }
    }

    /// Value, least and largest of a quantity; seconds only of a solve that passed: others end when they end.
    fn values(&self, quantity: &str) -> Option<[f64; 3]> {
        match quantity {
            "nonzeros" => self.nonzeros.map(|n| [n as f64; 3]),
            "log10_condest" => self.log10_condest.map(|c| [c; 3]),
            "log10_condition" => self.log10_condition.map(|c| [c; 3]),
            _ if !self.status.is_some_and(is_solved) => None,
            "seconds" => Some([self.seconds_median?, self.seconds_min?, self.seconds_max?]),
            _ => {
                let seconds = self.frame_seconds?;
                // Of a sub-step that was timed once there is no more.
                let [least, most] = [self.frame_seconds_min, self.frame_seconds_max];
                Some([seconds, least.unwrap_or(seconds), most.unwrap_or(seconds)])
            }
        }
    }
}

#[derive(Clone, Copy, PartialEq)]
struct Series {
    table: &'static str,
    nodes: usize,
    ways: [&'static str; 4],
}

/// What a table has.
fn quantities(table: &str) -> &'static [&'static str] {
    match table {
        "6.2" => &["nonzeros", "log10_condest", "log10_condition", "seconds"],
        "6.3" => &["frame_seconds"],
        _ => &["nonzeros"],
    }
}

/// The printed number; `column`: 0 of the thesis's own form, or 1 of what it is compared with. In table 6.2 the other way round.
fn printed(table: &str, quantity: &str, grid: usize, nodes: usize, form: &str) -> Option<f64> {
    let other = matches!(form, "indefinite" | "stress");
    let of_beams = |printed: &[(usize, [[f64; 2]; 2])]| {
        let (_, of_grid) = printed.iter().find(|(cells, _)| *cells == grid)?;
        Some(of_grid[usize::from(nodes > 400)][usize::from(other)])
    };
    match table {
        "6.2" => {
            let (_, of_grid) = PRINTED_6_2.iter().find(|(cells, _)| *cells == grid)?;
            let at = match quantity {
                "nonzeros" => 0,
                "seconds" => 2,
                _ => 1,
            };
            Some(of_grid[at][usize::from(!other)])
        }
        "6.3" => of_beams(&PRINTED_6_3),
        _ => of_beams(&PRINTED_6_4),
    }
}

/// A quantity, where its logarithm is given.
pub(super) fn plain(quantity: &str, value: f64) -> f64 {
    match quantity.starts_with("log10_") {
        true => 10.0_f64.powf(value),
        false => value,
    }
}

/// Means over the states.
pub(super) fn means(rows: &[SystemRow]) -> Vec<Mean> {
    let mut lines: Vec<(usize, Series)> = Vec::new();
    for row in rows {
        let line = (row.grid, row.series());
        if !lines.contains(&line) {
            lines.push(line);
        }
    }
    let mut means = Vec::new();
    for line in lines {
        let of_line = rows.iter().filter(|row| (row.grid, row.series()) == line);
        let of_line: Vec<&SystemRow> = of_line.collect();
        let first = of_line[0];
        for &quantity in quantities(first.table) {
            let values = of_line.iter().filter_map(|row| row.values(quantity));
            let values: Vec<[f64; 3]> = values.collect();
            // A quantity that this way does not have, or no solve that passed.
            if values.is_empty() {
                continue;
            }
            let mean_of = |at: usize| {
                let sum: f64 = values.iter().map(|of_state| of_state[at]).sum();
                sum / values.len() as f64
            };
            let mean = mean_of(0);
            let of_states = values.iter().map(|[value, ..]| *value);
            let minres = first.solver.starts_with("MINRES") && quantity == "seconds";
            let thesis = printed(
                first.table,
                quantity,
                first.grid,
                first.nodes,
                first.formulation,
            )
            .filter(|_| !minres && quantity != "log10_condition");
            means.push(Mean {
                table: first.table,
                grid: first.grid,
                nodes: first.nodes,
                elements: first.elements,
                formulation: first.formulation,
                solver: first.solver,
                backend: first.backend,
                precision: first.precision,
                quantity,
                states: values.len(),
                mean,
                low: mean_of(1),
                high: mean_of(2),
                least: of_states.clone().fold(f64::INFINITY, f64::min),
                largest: of_states.fold(0.0, f64::max),
                thesis,
                ratio: thesis.map(|thesis| plain(quantity, mean) / plain(quantity, thesis)),
            });
        }
    }
    means
}

impl Mean {
    /// The line of a chart that it is a point of. Table 6.2 refines the beam with the grid.
    pub(super) fn series(&self) -> (Option<usize>, [&'static str; 4]) {
        let ways = [self.formulation, self.solver, self.backend, self.precision];
        ((self.table != "6.2").then_some(self.nodes), ways)
    }
}

/// Growth with the grid of what is measured on two at least.
pub(super) fn growth(means: &[Mean]) -> Vec<Growth> {
    let mut growth: Vec<Growth> = Vec::new();
    for first in means {
        let with = |mean: &&Mean| {
            mean.table == first.table
                && mean.quantity == first.quantity
                && mean.series() == first.series()
        };
        let line: Vec<&Mean> = means.iter().filter(with).collect();
        let [coarsest, .., finest] = line[..] else {
            continue;
        };
        if coarsest.grid != first.grid {
            continue;
        }
        let value = |value| plain(first.quantity, value);
        let point = |mean: &&Mean| (mean.grid as f64, value(mean.mean));
        let of_thesis = line
            .iter()
            .filter_map(|mean| Some((mean.grid as f64, value(mean.thesis?))));
        let of_thesis: Vec<(f64, f64)> = of_thesis.collect();
        let points: Vec<(f64, f64)> = line.iter().map(point).collect();
        let states = line.iter().map(|mean| mean.states);
        growth.extend(exponent(points).map(|power| Growth {
            table: first.table,
            nodes: first.series().0,
            formulation: first.formulation,
            solver: first.solver,
            backend: first.backend,
            precision: first.precision,
            quantity: first.quantity,
            coarsest: coarsest.grid,
            finest: finest.grid,
            states: states.fold(usize::MAX, usize::min),
            exponent: power,
            thesis: exponent(of_thesis),
        }));
    }
    growth
}

#[cfg(test)]
mod tests {
    use super::{SystemRow, growth, means};

    fn row(grid: usize, frame: u64, formulation: &'static str, seconds: f64) -> SystemRow {
        SystemRow {
            table: "6.3",
            grid,
            nodes: 725,
            elements: 2688,
            frame,
            dt: 0.01,
            sub_steps_per_frame: 4.0,
            formulation,
            solver: "IC(0)-CG",
            backend: "cpu",
            precision: "f64",
            unknowns: 1,
            solid_unknowns: 1,
            nonzeros: None,
            log10_condest: None,
            log10_condition: None,
            log10_condition_exact: None,
            log10_condition_unscaled: None,
            status: Some("converged"),
            iterations: Some(1),
            residual_p: Some(0.0),
            residual_v: Some(0.0),
            seconds_median: Some(seconds),
            seconds_min: Some(seconds),
            seconds_max: Some(seconds),
            frame_seconds: Some(4.0 * seconds),
            frame_seconds_min: Some(2.0 * seconds),
            frame_seconds_max: Some(8.0 * seconds),
        }
    }

    #[test]
    fn means_and_powers_stand_beside_the_printed_ones() {
        let rows = [
            row(50, 10, "two-field", 1.0),
            row(50, 40, "two-field", 3.0),
            row(100, 10, "two-field", 16.0),
            row(60, 10, "stress", 2.0),
        ];
        let means = means(&rows);
        let found: Vec<_> = means
            .iter()
            .map(|mean| {
                let of_repeats = [mean.mean, mean.low, mean.high];
                (
                    mean.grid,
                    of_repeats,
                    [mean.least, mean.largest],
                    mean.thesis,
                )
            })
            .collect();
        assert_eq!(
            found,
            [
                (50, [8.0, 4.0, 16.0], [4.0, 12.0], Some(14.15)),
                (100, [64.0, 32.0, 128.0], [64.0, 64.0], None),
                (60, [8.0, 4.0, 16.0], [8.0, 8.0], Some(32.02)),
            ]
        );
        assert_eq!(means[0].ratio, Some(8.0 / 14.15));
        let growth = growth(&means);
        assert_eq!(growth.len(), 1, "stresses have one grid");
        assert!((growth[0].exponent - 3.0).abs() < 1e-12, "{growth:?}");
        assert_eq!((growth[0].nodes, growth[0].thesis), (Some(725), None));
        assert_eq!((means[0].states, growth[0].states), (2, 1));
    }

    #[test]
    fn what_the_thesis_does_not_print_stands_beside_no_number() {
        let of = |solver: &'static str| SystemRow {
            table: "6.2",
            solver,
            nonzeros: Some(157_498),
            log10_condest: Some(8.347),
            log10_condition: Some(8.0),
            ..row(40, 10, "indefinite", 1.635)
        };
        let means = means(&[of("BiCGSTAB-ILU(0)"), of("MINRES-IC(0)")]);
        let printed: Vec<_> = means
            .iter()
            .map(|mean| (mean.quantity, mean.thesis.is_some(), mean.ratio.is_some()))
            .collect();
        let of_matrix = [
            ("nonzeros", true, true),
            ("log10_condest", true, true),
            ("log10_condition", false, false),
        ];
        let [bicgstab, minres] = [true, false].map(|both| ("seconds", both, both));
        let expected: Vec<_> = of_matrix
            .into_iter()
            .chain([bicgstab])
            .chain(of_matrix)
            .chain([minres])
            .collect();
        assert_eq!(printed, expected);
    }

    #[test]
    fn seconds_of_solves_that_did_not_pass_enter_no_mean() {
        let failed = |grid, frame| SystemRow {
            status: Some("iteration_limit"),
            ..row(grid, frame, "two-field", 100.0)
        };
        let rows = [
            row(50, 10, "two-field", 1.0),
            failed(50, 40),
            SystemRow {
                status: Some("converged_to_rounding"),
                ..row(60, 10, "two-field", 2.0)
            },
            failed(100, 10),
        ];
        let of_rows = means(&rows);
        let found: Vec<_> = of_rows
            .iter()
            .map(|mean| (mean.grid, mean.states, mean.mean))
            .collect();
        assert_eq!(found, [(50, 1, 4.0), (60, 1, 8.0)]);
        let growth = growth(&of_rows);
        assert_eq!((growth.len(), growth[0].finest), (1, 60));
        // The matrix is what it is.
        let of_matrix = SystemRow {
            table: "6.2",
            nonzeros: Some(5),
            ..failed(40, 10)
        };
        let means = means(&[of_matrix]);
        let found: Vec<_> = means
            .iter()
            .map(|mean| (mean.quantity, mean.states, mean.mean))
            .collect();
        assert_eq!(found, [("nonzeros", 1, 5.0)]);
    }
}
