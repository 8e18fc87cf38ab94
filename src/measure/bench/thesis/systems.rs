//! Tables 6.2, 6.3 and 6.4: matrices of the formulations and times of their solves, on states of the dam break.
//!
//! The scene is `scenes/conditioning_40.toml` with other grids and beams; it runs on the device. The f64 path assembles the system of the sub-step
//! after a frame. Each formulation solves it to the same true residuals of the indefinite system; the time includes matrices and factors. The device
//! computes that sub-step; the time includes its matrices and hierarchy.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;
use std::time::Instant;

use super::{MOST_ITERATIONS, Options, TOLERANCE};
use crate::Error;
use crate::measure::bench::ended::{Ended, is_solved};
use crate::measure::bench::solve::bricks_across;
use crate::measure::bench::statistics::{Spread, exponent, grouped};
use crate::measure::bench::sub_step::{open_paths, stage_seconds, sub_step};
use crate::measure::bench::table::{Row, Value, columns, row};
use crate::measure::bench::{Case as BenchCase, Run, rounds};
use crate::reference::{
    CoupledSystem, Formulation as Form, Reference, SolidSolver, StepSystem, StressVariables, conditions, solve_coupled,
};
use crate::scene::{Formulation, Precision, Scene, SolidMesh, Solver};
use crate::sim::{Backend, Simulation, reference_path};
use crate::state::{SolveReport, State};
use crate::step::Stage;

const SCENE: &str = include_str!("../../../../scenes/conditioning_40.toml");
/// Share of the mass in Z1 that the thesis "exclusively used".
const SIGMA: f64 = 0.9;
/// The thesis's factor of the velocities (5.36), Pa s/m.
const ALPHA: f64 = 1e-3;
/// Bricks across the beams of tables 6.3 and 6.4: 135 and 725 nodes.
const BEAMS: [usize; 2] = [2, 4];

/// Cells along an edge, and nonzeros, logarithms of condition numbers and seconds of a solve, indefinite and positive definite.
const PRINTED_6_2: [(usize, [[f64; 2]; 3]); 3] = [
    (40, [[157498.0, 185503.0], [8.347, 10.497], [1.635, 1.813]]),
    (60, [[499787.0, 610697.0], [8.579, 11.311], [16.121, 8.292]]),
    (80, [[1177419.0, 1439173.0], [8.819, 11.497], [100.875, 28.020]]),
];

/// Cells along an edge, and with 135 nodes, then with 725: seconds per frame in velocities and in stresses.
const PRINTED_6_3: [(usize, [[f64; 2]; 2]); 5] = [
    (50, [[5.33, 6.69], [14.15, 27.68]]),
    (60, [[9.51, 9.90], [19.76, 32.02]]),
    (70, [[15.75, 15.32], [29.89, 36.98]]),
    (80, [[23.54, 22.21], [44.04, 47.87]]),
    (90, [[35.93, 31.56], [59.09, 58.76]]),
];

/// The same for nonzeros.
const PRINTED_6_4: [(usize, [[f64; 2]; 2]); 5] = [
    (50, [[317505.0, 814424.0], [624387.0, 5654643.0]]),
    (60, [[501430.0, 998372.0], [807789.0, 5838273.0]]),
    (70, [[795668.0, 1218020.0], [1095644.0, 6130135.0]]),
    (80, [[1128123.0, 1545752.0], [1425174.0, 6456548.0]]),
    (90, [[1565587.0, 1985347.0], [1856102.0, 6890398.0]]),
];

columns! {
    SYSTEMS {
        + table "" "number of the table";
        + grid "" "cells along an edge";
        + nodes "" "of the beam";
        - elements "" "of the beam";
        + frame "" "frame of the state";
        - dt "s" "length of the sub-step";
        - sub_steps_per_frame "" "up to this one";
        + formulation "" "`indefinite`, `two-field`, `stress` or `condensed`";
        + solver "" "its solver";
        + backend "" "`cpu` or `gpu`";
        + precision "" "`f32`, `mixed` or `f64`";
        - unknowns, solid_unknowns "" "of the pressure, and of the solids";
        + nonzeros "" "entries of the matrix, both triangles";
        + log10_condest "" "condition number for the 1-norm, as `condest`: alpha = 0.001, sigma = 0.9";
        - log10_condition "" "for the 2-norm";
        - log10_condition_exact "" "the same from all eigenvalues, of small matrices";
        + status "" "`converged`, `converged_to_rounding` or why not";
        + iterations "" "over all refinement steps";
        - residual_p, residual_v "" "true relative residuals of the pressure and of the velocities";
        ~ seconds "s" "of the solve: on the CPU from the assembled B, J and S, on the device from the liquid distance on";
        ~ frame_seconds "s" "sub-steps per frame times a sub-step: the device's, or this solve with the other stages of the f64 path";
    }
    /// Means over the states; of seconds over those with a converged solve.
    MEANS {
        + table "" "number of the table";
        + grid "" "cells along an edge";
        + nodes "" "of the beam";
        - elements "" "of the beam";
        + formulation, solver, backend, precision "" "as in thesis_systems.csv";
        + quantity "" "`nonzeros`, `log10_condest`, `log10_condition`, `seconds` or `frame_seconds`";
        - states "" "number of states";
        + mean "" "mean over the states, of seconds of the medians of repeats";
        - low, high "" "the same of the least and of the largest of the repeats";
        - least, largest "" "least and largest of the states";
        + thesis "" "printed: of the positive definite form for solves that the thesis does not have; empty for MINRES and 2-norms";
        + ratio "" "over the printed one; of condition numbers, not of their logarithms";
    }
    /// Powers of the cells along an edge, by least squares of the logarithms.
    GROWTH {
        + table "" "number of the table";
        + nodes "" "of the beam; empty where it is refined with the grid";
        + formulation, solver, backend, precision "" "as in thesis_systems.csv";
        + quantity "" "as in thesis_means.csv; of condition numbers, not of their logarithms";
        - coarsest, finest "" "cells along an edge of the coarsest and the finest grid";
        - states "" "states of each mean, at least";
        + exponent "" "the power";
        + thesis "" "of the printed numbers on these grids";
    }
}

/// Grid and bricks across the beam.
type Size = (usize, usize);

/// A state of a run, and the system of the sub-step after it.
struct Case<'a> {
    size: Size,
    dam: &'a Simulation,
    state: &'a State,
    system: CoupledSystem,
    stress: StressVariables,
    dt: f64,
    /// The f64 path after that sub-step.
    path: Reference,
}

/// A case per grid, beam, state and table; those of a grid and a beam share a simulation.
pub(super) fn cases(options: &Options) -> Vec<BenchCase<'_>> {
    let mut sizes: BTreeMap<Size, Vec<&str>> = BTreeMap::new();
    for table in &options.tables {
        for grid in options.grids(table) {
            let beams = match table.as_str() {
                "6.2" => vec![bricks_across(grid)],
                "6.3" | "6.4" => BEAMS.to_vec(),
                _ => Vec::new(),
            };
            for across in beams {
                sizes.entry((grid, across)).or_default().push(table);
            }
        }
    }
    let last = Rc::new(RefCell::new(None));
    let mut cases = Vec::new();
    for (size, tables) in sizes {
        for &frame in &options.frames {
            for &table in &tables {
                // Nodes of a beam k bricks across and 7 k along.
                let nodes = (size.1 + 1).pow(2) * (7 * size.1 + 1);
                let (key, last) = (row! { table, grid: size.0, nodes, frame }, Rc::clone(&last));
                cases.push(BenchCase::new("thesis_systems", key, move |run| {
                    let dam = dam_break(last.take(), size, frame, options)?;
                    let state = dam.state()?;
                    let rows = Case::new(size, &dam, &state)?.rows(run, table, options)?;
                    last.replace(Some((size, dam)));
                    Ok(rows.into_iter().map(|row| ("thesis_systems", row)).collect())
                }));
            }
        }
    }
    cases
}

/// The dam break with a beam of k bricks across and 7 k along on n^3 cells, after a frame. `last`: the simulation of the case before, which resumes if
/// it can.
fn dam_break(last: Option<(Size, Simulation)>, size: Size, frame: u64, options: &Options) -> Result<Simulation, Error> {
    let mut dam = match last {
        Some((reached, dam)) if reached == size && dam.clock().frame <= frame => dam,
        _ => Simulation::new(&scene(size)?, &Backend::Gpu(options.adapter.clone()))?,
    };
    while dam.clock().frame < frame {
        dam.step()?;
    }
    Ok(dam)
}

/// Its scene.
fn scene((n, across): Size) -> Result<Scene, Error> {
    let cells = [format!("domain.cells=[{n}, {n}, {n}]")];
    let mut scene = Scene::parse("scenes/conditioning_40.toml".as_ref(), SCENE, &cells, 1.0)?;
    scene.name = format!("conditioning_{n}_{across}");
    if let SolidMesh::Box { cells, .. } = &mut scene.solids[0].mesh {
        *cells = [across, 7 * across, across];
    }
    Ok(scene)
}

/// Refuses a frame after the end of the scene.
pub(super) fn ensure_frame(frame: u64) -> Result<(), Error> {
    let last = scene((8, 2))?.n_frames();
    if (1..=last).contains(&frame) {
        return Ok(());
    }
    let problem = format!("the dam break has frames 1 to {last}");
    Err(Error::input(format!("--frames {frame}"), problem, "give frames of these, such as 10,40,80"))
}

impl<'a> Case<'a> {
    fn new(size: Size, dam: &'a Simulation, state: &'a State) -> Result<Case<'a>, Error> {
        let (scene, solids) = (dam.scene(), dam.solids());
        let exact = Solver { precision: Precision::F64, ..scene.solver };
        let mut path = reference_path(&Scene { solver: exact, ..scene.clone() })?;
        path.reset(state.clone())?;
        let time_step = path.next_time_step();
        let mut taken = None;
        path.step_observed(time_step, &mut |system| {
            if let StepSystem::Coupled(system, ..) = system {
                taken = Some(system.clone());
            }
        })?;
        let system = taken.ok_or_else(|| {
            let problem = "the water does not touch the beam then on such a grid, and there is no system of both";
            Error::input(format!("--frames {}", state.frame), problem, "give later frames, such as 10,40,80")
        })?;
        let (deformations, dt) = (solids.deformations(&path.state().displacement), time_step.dt);
        Ok(Case {
            stress: StressVariables::new(solids, &deformations, |body| body.zeta_stiffness(dt)),
            size,
            dam,
            state,
            system,
            dt,
            path,
        })
    }

    /// Columns that all rows of the state have.
    fn row(&self, table: &str, names: [&str; 4]) -> Row {
        let ([formulation, solver, backend, precision], solids) = (names, self.dam.solids());
        row! {
            table, grid: self.size.0, nodes: solids.rest.len(), elements: solids.elements.len(), frame: self.state.frame, dt: self.dt,
            sub_steps_per_frame: self.sub_steps_per_frame(), formulation, solver, backend, precision,
            unknowns: self.system.pressure.n_unknowns(), solid_unknowns: self.system.solid.n_unknowns(),
        }
    }

    fn sub_steps_per_frame(&self) -> f64 {
        self.state.step as f64 / self.state.frame as f64
    }

    fn rows(&self, run: &mut Run, table: &str, options: &Options) -> Result<Vec<Row>, Error> {
        let blocks = self.system.blocks();
        let two_field = Form::TwoFieldIncomplete(SIGMA);
        match table {
            "6.2" => {
                let forms = [Form::IndefiniteIterative, Form::IndefiniteMinimalResidual, two_field, Form::Condensed];
                let mut rows = self.solved(run, table, &forms, options)?;
                let conditions = conditions(&self.system, SIGMA, ALPHA)?;
                let indefinite = (blocks.indefinite().n_entries(), conditions.indefinite);
                let definite = (blocks.two_field(SIGMA)?.n_entries(), conditions.two_field);
                for row in rows.iter_mut().filter(|row| row.text("backend") == "cpu") {
                    let (nonzeros, condition) = match row.text("formulation") {
                        "indefinite" => indefinite,
                        "two-field" => definite,
                        _ => continue,
                    };
                    *row = row.clone().with(row! {
                        nonzeros, log10_condest: condition.one_norm, log10_condition: condition.two_norm,
                        log10_condition_exact: condition.two_norm_exact,
                    });
                }
                Ok(rows)
            }
            "6.3" => self.solved(run, table, &[two_field, Form::StressIncomplete(&self.stress)], options),
            _ => {
                let matrices = [("two-field", blocks.two_field(SIGMA)?), ("stress", self.stress.system(&blocks)?.1)];
                let rows = matrices.map(|(form, matrix)| {
                    self.row(table, [form, "", "cpu", "f64"]).with(row! { nonzeros: matrix.n_entries() })
                });
                Ok(rows.to_vec())
            }
        }
    }

    /// A row per form on the CPU and per path of the device, solved in rounds.
    fn solved(&self, run: &mut Run, table: &str, forms: &[Form], options: &Options) -> Result<Vec<Row>, Error> {
        let (scene, solids) = (self.dam.scene(), self.dam.solids());
        let settings = |precision, formulation| Solver {
            tolerance: TOLERANCE,
            max_iterations: MOST_ITERATIONS,
            precision,
            formulation,
            ..scene.solver
        };
        let exact = settings(Precision::F64, Formulation::Auto);
        // In f32 both forms are the same.
        let forms_in = |precision| match precision {
            Precision::F32 => &[Formulation::Auto][..],
            _ => &[Formulation::Auto, Formulation::TwoField],
        };
        let solvers =
            options.precisions.iter().flat_map(|&it| forms_in(it).iter().map(move |&form| settings(it, form)));
        let mut devices = open_paths(scene, solvers, self.state, &options.adapter)?;
        let mut path = self.path.clone();
        let mut sub_steps = vec![Vec::new(); devices.len()];
        let [grid, frame] = [self.size.0, self.state.frame as usize];
        let what = format!("solves of table {table}, grid {grid}, frame {frame}");
        // Jobs: the other stages of the f64 path, the forms, the devices. Outcomes: form, solver and path, and the reports.
        let timed = rounds(run, &what, 1 + forms.len() + devices.len(), |job| {
            if job == 0 {
                path.reset(self.state.clone())?;
                let step = path.step(path.next_time_step())?;
                let others = step.seconds_total - stage_seconds(&step, &[Stage::Solve.name()]);
                return Ok((others, ([""; 4], Vec::new())));
            }
            if let Some(&form) = forms.get(job - 1) {
                let clock = Instant::now();
                let found = solve_coupled(&self.system, form, &SolidSolver::new(solids), solids, &exact)?;
                let seconds = clock.elapsed().as_secs_f64();
                let (name, solver) = match form {
                    Form::Condensed => ("condensed", "multigrid CG"),
                    form => form.name().split_once(", ").unwrap_or((form.name(), "")),
                };
                return Ok((seconds, ([name, solver, "cpu", "f64"], found.reports.to_vec())));
            }
            let device = job - 1 - forms.len();
            let (precision, path) = &mut devices[device];
            let done = sub_step(path, self.state)?;
            path.write_state(self.state)?;
            sub_steps[device].push(path.step_observed(&mut |_, _| Ok(()))?.seconds_total);
            let condensed = done.report.coupling.is_some_and(|both| both.condensed);
            let form = if condensed { "condensed" } else { "two-field" };
            let reports: Vec<SolveReport> = done.report.solves().collect();
            Ok((done.seconds, ([form, "multigrid CG", "gpu", precision.name()], reports)))
        })?;
        let others = timed[0].spread();
        let mut rows: Vec<Row> = Vec::new();
        for (job, timed) in timed.iter().enumerate().skip(1) {
            let (seconds, (names, reports)) = (timed.spread(), &timed.outcome);
            let sub_step = match job.checked_sub(1 + forms.len()) {
                None => seconds.plus(others),
                Some(device) => Spread::of(sub_steps[device].clone()),
            };
            let row = self.row(table, *names).with(row! {
                status: Ended::new(reports).name(TOLERANCE), iterations: reports[0].iterations, residual_p: reports[0].residual,
                residual_v: reports[1].residual, seconds, frame_seconds: sub_step.times(self.sub_steps_per_frame()),
            });
            // `auto` may have selected the same form.
            if !rows.iter().any(|other| series(other) == series(&row)) {
                rows.push(row);
            }
        }
        Ok(rows)
    }
}

/// Form, solver and path of a row.
fn series(row: &Row) -> Row {
    row.only(&["table", "formulation", "solver", "backend", "precision"])
}

/// Value, least and largest of a quantity; seconds only of a converged solve.
fn values(row: &Row, quantity: &str) -> Option<[f64; 3]> {
    let Some(Spread { median, min, max }) = row.spread(quantity) else {
        return row.has(quantity).then(|| [row.number(quantity); 3]);
    };
    is_solved(row.text("status")).then_some([median, min, max])
}

/// Number in the thesis.
fn printed(table: &str, quantity: &str, grid: usize, nodes: usize, form: &str) -> Option<f64> {
    let other = matches!(form, "indefinite" | "stress");
    let beams = |printed: &[(usize, [[f64; 2]; 2])]| {
        let (_, on_grid) = printed.iter().find(|(cells, _)| *cells == grid)?;
        Some(on_grid[usize::from(nodes > 400)][usize::from(other)])
    };
    match table {
        "6.2" => {
            let (_, on_grid) = PRINTED_6_2.iter().find(|(cells, _)| *cells == grid)?;
            let at = ["nonzeros", "log10_condest", "seconds"].iter().position(|name| *name == quantity).unwrap_or(1);
            Some(on_grid[at][usize::from(!other)])
        }
        "6.3" => beams(&PRINTED_6_3),
        _ => beams(&PRINTED_6_4),
    }
}

/// Value of a quantity, from its logarithm if the column has that.
fn plain(quantity: &str, value: f64) -> f64 {
    if quantity.starts_with("log10_") { 10.0_f64.powf(value) } else { value }
}

/// Means over the states.
pub(super) fn means(rows: &[Row]) -> Vec<Row> {
    let mut means = Vec::new();
    let sizes = |row: &Row| row.only(&["grid", "nodes", "elements"]);
    for (line, rows) in grouped(rows, |row| Some(series(row).with(sizes(row)))) {
        let [table, form] = ["table", "formulation"].map(|name| line.text(name));
        let quantities: &[&str] = match table {
            "6.2" => &["nonzeros", "log10_condest", "log10_condition", "seconds"],
            "6.3" => &["frame_seconds"],
            _ => &["nonzeros"],
        };
        for &quantity in quantities {
            let values: Vec<[f64; 3]> = rows.iter().filter_map(|row| values(row, quantity)).collect();
            if values.is_empty() {
                continue;
            }
            let [mean, low, high] =
                [0, 1, 2].map(|at: usize| values.iter().map(|value| value[at]).sum::<f64>() / values.len() as f64);
            let states = Spread::of(values.iter().map(|value| value[0]).collect());
            let minres = line.text("solver").starts_with("MINRES") && quantity == "seconds";
            let [grid, nodes] = ["grid", "nodes"].map(|name| line.count(name));
            let thesis = printed(table, quantity, grid, nodes, form);
            let thesis = thesis.filter(|_| !minres && quantity != "log10_condition");
            means.push(line.clone().with(row! {
                quantity, states: values.len(), mean, low, high, least: states.min, largest: states.max, thesis,
                ratio: thesis.map(|thesis| plain(quantity, mean) / plain(quantity, thesis)),
            }));
        }
    }
    means
}

/// Growth with the grid of means on two grids at least. Table 6.2 refines the beam with the grid.
pub(super) fn growth(means: &[Row]) -> Vec<Row> {
    let groups = grouped(means, |mean| {
        let nodes = if mean.text("table") == "6.2" { Value::Null } else { mean.get("nodes") };
        Some(series(mean).with(row! { quantity: mean.get("quantity"), nodes }))
    });
    let fits = groups.into_iter().filter_map(|(line, means)| {
        let quantity = line.text("quantity");
        let point = |mean: &Row, column| (mean.number("grid"), plain(quantity, mean.number(column)));
        let power = exponent(means.iter().map(|mean| point(mean, "mean")))?;
        let printed = means.iter().filter(|mean| mean.has("thesis"));
        let thesis = exponent(printed.map(|mean| point(mean, "thesis")));
        let states = means.iter().map(|mean| mean.count("states")).min();
        let grids = means.iter().map(|mean| mean.count("grid"));
        let fit = row! { coarsest: grids.clone().min(), finest: grids.max(), states, exponent: power, thesis };
        Some(line.clone().with(fit))
    });
    fits.collect()
}
