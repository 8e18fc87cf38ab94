//! `bench solve`: the solve against the grid, of the pressure on the base block, and of liquid and solids on the base scene.
//!
//! A run counts from the recording of the set-up of hierarchy and, with solids, of their elements to the residual check in f64. The first run of
//! each row, which compiles, is not timed. Reference solvers on the CPU take turns with the device in a shuffled order.

mod capacity;
mod reference_solvers;

use std::collections::BTreeSet;
use std::time::Instant;

use super::bytes::{Corrections, SolidBytes, SolveBytes};
use super::chart::{Chart, Page, exact, lines};
use super::ended::{Ended, precision_name, preconditioner_name};
use super::statistics::{Spread, exponent, grouped};
use super::table::{Row, Table, columns, row};
use super::{
    Bench, Case, GROWTH, Listener, Machine, Results, Run, Settings, TRAFFIC, growth, replace,
    rounds, rows,
};
use crate::Error;
use crate::fields::SolverBuffers;
use crate::gpu::{Buffer, Gpu, Real, Recorder, Traffic};
use crate::linalg::SymbolicCholesky;
use crate::measure::base_scene::{DeviceScene, block_fields};
use crate::reference::CoupledSystem;
use crate::reference::base_block::{BaseBlock, THETA_FLOOR};
use crate::reference::base_scene::{BaseBeam, BaseScene};
use crate::scene::{self, Solver};
use crate::solver::PressureSolver;
use crate::stages::{Everywhere, PressureSystem};
use crate::state::SolveStatus;
use crate::step::Stage;

pub use capacity::{Capacity, LARGEST_GRID, PER_CELL, largest_grid};
pub use reference_solvers::{Assembled, ReferenceSolver};

/// Bytes.
pub const GIB: f64 = (1_u64 << 30) as f64;
/// Cells along an edge of the thesis's grids for each brick across its beams.
const CELLS_PER_BRICK: usize = 20;

/// Unknowns of a solve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Formulation {
    /// Pressures, without solids.
    Pressure,
    /// Pressures and velocities of solids, thesis (5.25) in factored form.
    TwoField,
    /// Pressures of the same scene alone: Schur complement.
    Condensed,
}

impl Formulation {
    fn name(self) -> &'static str {
        match self {
            Formulation::Pressure => "pressure",
            Formulation::TwoField => "two-field",
            Formulation::Condensed => "condensed",
        }
    }
}

/// Systems to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Forms.
    pub formulations: Vec<Formulation>,
    /// Cells along an edge of the block.
    pub grids: Vec<usize>,
    /// Bricks across the beam, which is seven times as long; `None` for the beam that belongs to the grid.
    pub bricks: Vec<Option<usize>>,
    /// Settings of the solver.
    pub solvers: Vec<Solver>,
    /// Reference solvers.
    pub against: Vec<ReferenceSolver>,
    /// Factors of more bytes are not computed.
    pub largest_factor: f64,
}

columns! {
    /// Identity of a system and its solver.
    SYSTEM {
        scene = "" "`base_block`, or `base_scene` with solids";
        grid + "" "cells along an edge";
        active_cells + "" "unknowns of the pressure";
        solid_nodes + "" "nodes of the solids";
        bricks - "" "bricks across the beam; empty for the one that belongs to the grid";
        formulation + "" "`pressure`, `two-field` or `condensed`";
        preconditioner + "" "`multigrid`, `jacobi` or `block_jacobi`";
        precision + "" "`f32`, `mixed` or `f64`";
        tolerance + "" "relative, of the true residual";
    }
    /// A solve on the device.
    SOLVE {
        status + "" "`converged`, `converged_to_rounding` or why not";
        iterations + "" "over all refinement steps";
        rounds - "" "refinement steps";
        runs - "" "timed runs";
        seconds ~ "s" "seconds of a solve";
        residual_p + "" "true relative residual of the pressure";
        residual_v + "" "the same of the solids' velocity; 0 without solids";
        cells_per_second - "1/s" "active cells over the median seconds";
        bytes - "B" "least memory traffic";
        share_of_copy_bandwidth - "" "`bytes` per second over the copy bandwidth";
    }
    /// The same system on the CPU.
    AGAINST {
        device_seconds ~ "s" "seconds on the device";
        rival + "" "`ic0_cg`, `cholesky` or `multigrid_cg`";
        threads - "" "threads that it may use";
        rows - "" "unknowns: of thesis (5.25) with solids; of multigrid the pressures";
        entries - "" "entries of the matrix";
        factor_bytes - "B" "bytes of the factor";
        status - "" "as in solve.csv";
        iterations - "" "of conjugate gradients; empty for a factor";
        turns - "" "timed runs";
        seconds ~ "s" "from the assembled B, S and J to the residual check: matrix, factor or hierarchy included";
        residual_p - "" "true relative residual of the pressure";
        residual_v - "" "the same of the velocities";
        ratio ~ "" "its seconds over the device's of the same round";
        note + "" "why there is no ratio";
    }
    /// A series of solves.
    SERIES {
        formulation + "" "as in solve.csv";
        solver + "" "preconditioner, or the reference solver";
        precision + "" "`f64` of reference solvers";
    }
    ITERATIONS { iterations - "" "exponent of the iterations; empty for direct solvers"; }
}

fn bench() -> Bench {
    let against: &[&str] = &[
        "grid",
        "bricks",
        "formulation",
        "preconditioner",
        "precision",
        "tolerance",
        "rival",
    ];
    // One solve has several rivals.
    let key = &against[..against.len() - 1];
    Bench {
        name: "solve",
        tables: vec![
            Table::new("solve", &[SYSTEM, SOLVE, TRAFFIC], key),
            Table::new("solve_against", &[SYSTEM, AGAINST], against),
            Table::new("solve_growth", &[SERIES, GROWTH, ITERATIONS], &[]),
        ],
        derive,
        pictures: &[("solve", draw)],
    }
}

/// Measures all systems: solve.csv, solve_against.csv, solve_growth.csv, solve.json, solve.svg.
///
/// # Errors
/// Before any work [`Error::Limit`] and [`Error::Memory`] where there is no room for a grid; [`Error::Output`]; [`Error::Check`] where a solve
/// does not repeat.
pub fn measure(
    gpu: &Gpu,
    options: &Options,
    settings: &Settings,
    listener: Listener,
) -> Result<Results, Error> {
    let capacity = Capacity::new(gpu.report());
    options
        .grids
        .iter()
        .try_for_each(|&grid| capacity.check(grid, &options.solvers))?;
    let machine = Machine::new(gpu, settings.repeats)?;
    let request = (
        &options.against,
        options.largest_factor,
        options.solvers.first().map(|solver| solver.max_iterations),
    );
    let mut run = Run::start(bench(), machine, &request, settings, listener)?;
    let mut cases = Vec::new();
    for &grid in &options.grids {
        for &formulation in &options.formulations {
            let beams = match formulation {
                Formulation::Pressure => &[None][..],
                _ => &options.bricks,
            };
            for &bricks in beams {
                for solver in &options.solvers {
                    let key = row! {
                        scene: if formulation == Formulation::Pressure { "base_block" } else { "base_scene" },
                        grid: grid, bricks: bricks, formulation: formulation.name(), tolerance: solver.tolerance,
                        preconditioner: preconditioner_name(solver.preconditioner), precision: precision_name(solver.precision),
                    };
                    let measured = key.clone();
                    cases.push(Case {
                        key: ("solve", key),
                        measure: Box::new(move |run| {
                            system(gpu, run, formulation, &measured, solver, options)
                        }),
                    });
                }
            }
        }
    }
    run.cases(cases)?;
    Ok(run.results)
}

/// Bricks across the beam that the thesis has on about so many cells along an edge.
pub(super) fn bricks_across(grid: usize) -> usize {
    match grid {
        ..50 => 2,
        50..70 => 3,
        _ => 4,
    }
}

/// End of a solve on the device.
struct Solved {
    ended: Ended,
    rounds: u32,
    unknowns: usize,
    /// Whether the corrections were those of the Schur complement.
    condensed: bool,
}

/// The pressure system of the base block on the device.
struct Block {
    _fields: [Buffer<f32>; 3],
    buffers: SolverBuffers,
    everywhere: Everywhere,
    system: PressureSystem,
    solver: PressureSolver,
}

impl Block {
    fn new(gpu: &Gpu, block: &BaseBlock, rhs: &[f64], solver: &Solver) -> Result<Block, Error> {
        let grid = &block.grid;
        let fields = block_fields(gpu, block, &block.open)?;
        let [open, velocity, distance] = &fields;
        let buffers = SolverBuffers::new(gpu, grid, solver.precision)?;
        let everywhere = Everywhere::new(gpu, grid)?;
        let area = grid.dx * grid.dx;
        let rhs: Vec<f64> = rhs.iter().map(|value| value / area).collect();
        buffers
            .rhs
            .upload(gpu, &grid.padded().pad(grid.cells, &rhs, |value| value));
        Ok(Block {
            system: PressureSystem::new(
                gpu,
                &buffers,
                open,
                distance,
                everywhere.within(),
                THETA_FLOOR,
            )?,
            solver: PressureSolver::new(gpu, &buffers, velocity, open, solver)?,
            _fields: fields,
            buffers,
            everywhere,
        })
    }

    fn solve(&self, gpu: &Gpu) -> Result<Solved, Error> {
        let mut recorder = Recorder::new(gpu);
        let within = self.everywhere.within();
        recorder.stage(Stage::ActiveCells.name(), |pass| {
            self.system.record(pass, &self.buffers, within)
        });
        let (outcome, _) = self.solver.solve(gpu, recorder, &self.buffers)?;
        Ok(Solved {
            ended: Ended::from(&outcome),
            rounds: outcome.refinements,
            unknowns: outcome.unknowns as usize,
            condensed: false,
        })
    }
}

/// A reference solver and its system.
struct Reference<'a> {
    solver: ReferenceSolver,
    system: Assembled<'a>,
    settings: Solver,
    rows: usize,
    entries: Option<usize>,
    factor_bytes: Option<f64>,
    /// Why it does not solve.
    note: String,
}

impl<'a> Reference<'a> {
    fn new(
        solver: ReferenceSolver,
        system: Assembled<'a>,
        settings: &Solver,
        largest: f64,
    ) -> Result<Self, Error> {
        let mut reference = Reference {
            solver,
            system,
            settings: *settings,
            rows: system.n_pressures(),
            entries: None,
            factor_bytes: None,
            note: String::new(),
        };
        if solver != ReferenceSolver::Multigrid {
            let matrix = system.definite().matrix()?;
            let entries = match solver {
                ReferenceSolver::Cholesky => SymbolicCholesky::new(&matrix)?.n_factor_entries(),
                _ => matrix.n_entries(),
            };
            let bytes = 8.0 * entries as f64;
            reference.rows = matrix.n_rows();
            reference.entries = Some(matrix.n_entries());
            reference.factor_bytes = Some(bytes);
            if bytes > largest {
                reference.note = format!("factor of {:.1} GiB left out", bytes / GIB);
            }
        }
        // The device's limit is its own.
        reference.settings.max_iterations = (10 * reference.rows) as u32;
        Ok(reference)
    }
}

/// Rows of a system: of the device and of each reference solver.
fn system(
    gpu: &Gpu,
    run: &mut Run,
    formulation: Formulation,
    key: &Row,
    solver: &Solver,
    options: &Options,
) -> Result<Vec<(&'static str, Row)>, Error> {
    let solver = &Solver {
        formulation: match formulation {
            Formulation::Condensed => scene::Formulation::Condensed,
            Formulation::Pressure | Formulation::TwoField => scene::Formulation::TwoField,
        },
        ..*solver
    };
    let grid = key.count("grid");
    let allocated = device_bytes(gpu);
    if formulation == Formulation::Pressure {
        let block = BaseBlock::new(grid);
        let system = block.pressure_system();
        let device = Block::new(gpu, &block, &system.rhs, solver)?;
        let solve = Device {
            prepare: &|| {},
            solve: &|| device.solve(gpu),
        };
        let timed = compare(
            gpu,
            run,
            (key, solver),
            options,
            Assembled::Pressure(&system),
            solve,
        )?;
        let model = |of: &Model| of.bytes().of_pressure();
        return timed.rows(
            gpu,
            run,
            &device.buffers,
            model,
            device_bytes(gpu) - allocated,
            0,
        );
    }
    let across = if key.has("bricks") {
        key.count("bricks")
    } else {
        bricks_across(grid)
    };
    let beam = BaseBeam {
        bricks: [across, across, 7 * across],
        ..BaseBeam::default()
    };
    let scene = BaseScene::new(grid, &beam)?;
    let system = scene.coupled_system();
    let device = DeviceScene::new(gpu, &scene, &system, solver)?;
    let unknowns = system.pressure.n_unknowns();
    let assembled = Assembled::Both(&system, &scene.solids);
    let solve = Device {
        prepare: &|| device.reset(),
        solve: &|| {
            let outcome = device.solve()?;
            Ok(Solved {
                ended: Ended::from(&outcome),
                rounds: outcome.refinements,
                unknowns,
                condensed: outcome.condensed,
            })
        },
    };
    let timed = compare(gpu, run, (key, solver), options, assembled, solve)?;
    let model = |of: &Model| {
        let corrections = match of.solved.condensed {
            true => Corrections::Condensed {
                wet_nodes: wet_nodes(&system),
            },
            false => Corrections::TwoField {
                degree: device.polynomial.degree as usize,
            },
        };
        let [inner, outer] = of.widths.map(|bytes| bytes as usize);
        of.bytes()
            .of_both(&SolidBytes::new(&scene.solids, [outer, inner]), corrections)
    };
    timed.rows(
        gpu,
        run,
        &device.liquid,
        model,
        device_bytes(gpu) - allocated,
        scene.solids.rest.len(),
    )
}

fn wet_nodes(system: &CoupledSystem) -> usize {
    let nodes = system.coupling.pairs().iter().map(|pair| pair.node);
    nodes.collect::<BTreeSet<usize>>().len()
}

/// Timed solves of a system, of the device first.
struct Compared<'a> {
    key: &'a Row,
    solver: &'a Solver,
    references: Vec<Reference<'a>>,
    /// Of the device, then of the references that solve.
    timed: Vec<super::Timed<(Option<Ended>, Traffic)>>,
    idle: Spread,
    solved: Solved,
}

/// A solve on the device.
#[derive(Clone, Copy)]
struct Device<'d> {
    /// Not timed.
    prepare: &'d dyn Fn(),
    solve: &'d dyn Fn() -> Result<Solved, Error>,
}

/// Solves on the device and with the reference solvers, in rounds.
fn compare<'a>(
    gpu: &Gpu,
    run: &mut Run,
    (key, solver): (&'a Row, &'a Solver),
    options: &Options,
    system: Assembled<'a>,
    device: Device,
) -> Result<Compared<'a>, Error> {
    let references = options.against.iter();
    let references =
        references.map(|&other| Reference::new(other, system, solver, options.largest_factor));
    let references: Vec<Reference> = references.collect::<Result<_, _>>()?;
    let solving: Vec<&Reference> = references
        .iter()
        .filter(|reference| reference.note.is_empty())
        .collect();
    let what = format!("grid {} {}", key.count("grid"), key.text("formulation"));
    // The first compiles.
    (device.prepare)();
    let solved = (device.solve)()?;
    let mut idle = Vec::new();
    let timed = rounds(
        run,
        &format!("solves of {what}"),
        1 + solving.len(),
        |job| {
            (device.prepare)();
            gpu.wait("bench")?;
            let (before, clock) = (gpu.traffic(), Instant::now());
            if let Some(job) = job.checked_sub(1) {
                let Reference {
                    solver,
                    system,
                    settings,
                    ..
                } = solving[job];
                let reports = system.solve(*solver, settings)?;
                let ended = reports.map(|reports| Ended::of_reports(&reports));
                return Ok((clock.elapsed().as_secs_f64(), (ended, Traffic::default())));
            }
            let again = (device.solve)()?;
            let seconds = clock.elapsed().as_secs_f64();
            solved.ended.ensure_repeated(again.ended, &what)?;
            let traffic = gpu.traffic().since(before);
            idle.push(traffic.idle_seconds);
            Ok((seconds, (Some(again.ended), traffic)))
        },
    )?;
    let idle = Spread::of(idle);
    Ok(Compared {
        key,
        solver,
        references,
        timed,
        idle,
        solved,
    })
}

/// Sizes that decide the bytes of a solve.
struct Model<'a> {
    solved: &'a Solved,
    solver: &'a Solver,
    not_uniform: f64,
    /// Bytes of a scalar of the corrections, and of the outer loop.
    widths: [f64; 2],
}

impl Model<'_> {
    fn bytes(&self) -> SolveBytes {
        SolveBytes {
            unknowns: self.solved.unknowns as f64,
            not_uniform: self.not_uniform,
            iterations: f64::from(self.solved.ended.iterations),
            rounds: f64::from(self.solved.rounds),
            widths: self.widths,
            preconditioner: self.solver.preconditioner,
        }
    }
}

impl Compared<'_> {
    fn rows(
        self,
        gpu: &Gpu,
        run: &Run,
        buffers: &SolverBuffers,
        bytes: impl Fn(&Model) -> f64,
        device_bytes: u64,
        solid_nodes: usize,
    ) -> Result<Vec<(&'static str, Row)>, Error> {
        let Compared {
            key,
            solver,
            references,
            timed,
            idle,
            solved,
        } = self;
        let width = |real: Real| real.bytes() as f64;
        let model = Model {
            solved: &solved,
            solver,
            not_uniform: not_uniform(gpu, buffers)?,
            widths: [width(buffers.variant.inner), width(buffers.variant.real)],
        };
        let bytes = model.bytes().of_set_up() + bytes(&model);
        let (
            Ended {
                iterations,
                residuals,
                ..
            },
            seconds,
        ) = (solved.ended, timed[0].spread());
        let status = solved.ended.name(solver.tolerance);
        let (_, traffic) = &timed[0].outcome;
        let system = key
            .clone()
            .with(row! { active_cells: solved.unknowns, solid_nodes: solid_nodes });
        let device = system.clone().with(row! {
            status: status, iterations: iterations, rounds: solved.rounds, runs: timed[0].runs(), seconds: seconds,
            residual_p: residuals[0], residual_v: residuals[1], cells_per_second: solved.unknowns as f64 / seconds.median,
            bytes: bytes, share_of_copy_bandwidth: run.results.machine.share(bytes, seconds.median),
            waits: traffic.waits, submissions: traffic.submissions, dispatches: traffic.dispatches, bytes_up: traffic.bytes_up,
            bytes_down: traffic.bytes_down, idle_seconds: idle.median, device_bytes: device_bytes,
        });
        let mut rows = vec![("solve", device)];
        let mut others = timed[1..].iter();
        for reference in &references {
            let own = if reference.note.is_empty() {
                others.next()
            } else {
                None
            };
            let row = against(reference, own, &timed[0], status);
            rows.push(("solve_against", system.clone().with(row)));
        }
        Ok(rows)
    }
}

/// Columns of a reference solver beside the device, whose solve ended with `status`.
fn against<T>(
    reference: &Reference,
    timed: Option<&super::Timed<(Option<Ended>, Traffic)>>,
    device: &super::Timed<T>,
    status: &str,
) -> Row {
    let ended = timed.and_then(|timed| timed.outcome.0);
    let name = ended.map(|ended| ended.name(reference.settings.tolerance));
    let converged = SolveStatus::Converged.name();
    let note = match name {
        None if reference.note.is_empty() => "no incomplete factor without fill".to_owned(),
        None => reference.note.clone(),
        Some(name) if name != converged => format!("no ratio: the reference solver {name}"),
        Some(_) if status != converged => format!("no ratio: on the device {status}"),
        Some(_) => String::new(),
    };
    let timed = timed.filter(|_| ended.is_some());
    let iterative = reference.solver != ReferenceSolver::Cholesky;
    row! {
        device_seconds: device.spread(), rival: reference.solver.name(), threads: rayon::current_num_threads(), rows: reference.rows,
        entries: reference.entries, factor_bytes: reference.factor_bytes, status: name,
        iterations: ended.filter(|_| iterative).map(|ended| ended.iterations), turns: timed.map_or(0, |timed| timed.runs()),
        seconds: timed.map(|timed| timed.spread()), residual_p: ended.map(|ended| ended.residuals[0]),
        residual_v: ended.map(|ended| ended.residuals[1]),
        ratio: timed.filter(|_| note.is_empty()).map(|timed| timed.ratio(device)), note: note.as_str(),
    }
}

/// Bytes of all buffers so far.
fn device_bytes(gpu: &Gpu) -> u64 {
    gpu.allocated().iter().map(|(_, bytes)| bytes).sum()
}

/// Share of the active quads that are not uniform.
fn not_uniform(gpu: &Gpu, buffers: &SolverBuffers) -> Result<f64, Error> {
    let flags = gpu.download(&buffers.flags)?;
    let flags = flags[..buffers.plan.levels[0].quads].iter();
    let quads = flags.clone().filter(|&&flag| flag != 0).count() as f64;
    let uniform = flags.filter(|&&flag| flag >> 31 == 1).count() as f64;
    Ok(1.0 - uniform / quads.max(1.0))
}

/// Growth of each solver along cells, nodes or both.
pub fn derive(tables: &mut [Table]) {
    let sample = |row: &Row, solver: &str, precision: &str, runs: &str| {
        let sizes = [
            "grid",
            "bricks",
            "active_cells",
            "solid_nodes",
            "formulation",
            "seconds",
            "iterations",
        ];
        row.only(&sizes)
            .with(row! { solver: row.get(solver), precision: precision, runs: row.get(runs) })
    };
    let converged = |row: &&Row| row.text("status") == SolveStatus::Converged.name();
    let device = rows(tables, "solve").iter().filter(converged);
    let device = device.map(|row| sample(row, "preconditioner", row.text("precision"), "runs"));
    let others = rows(tables, "solve_against").iter().filter(converged);
    let samples: Vec<Row> = device
        .chain(others.map(|row| sample(row, "rival", "f64", "turns")))
        .collect();
    let series = |row: &Row| row.only(&["formulation", "solver", "precision"]);
    // Of all grids with a beam the one with most nearly the thesis's cells per brick: there both are refined together.
    let off = |row: &Row| {
        let grid = row.count("grid");
        (grid.abs_diff(CELLS_PER_BRICK * bricks_across(grid)), grid)
    };
    let nearest = |row: &Row| {
        let same = |other: &&Row| {
            (series(other), other.get("solid_nodes")) == (series(row), row.get("solid_nodes"))
        };
        samples
            .iter()
            .filter(same)
            .filter(|other| !other.has("bricks"))
            .map(off)
            .min()
            == Some(off(row))
    };
    let mut all = Vec::new();
    for (along, size) in [
        ("both", "active_cells"),
        ("cells", "active_cells"),
        ("nodes", "solid_nodes"),
    ] {
        let groups = grouped(&samples, |row| {
            let (solids, own) = (row.count("solid_nodes") > 0, row.has("bricks"));
            let (belongs, fixed) = match along {
                "both" => (solids && !own && nearest(row), None),
                "cells" => (true, solids.then(|| row.count("solid_nodes"))),
                _ => (own, Some(row.count("grid"))),
            };
            belongs.then(|| (series(row).with(row! { along: along, fixed: fixed }), own))
        });
        for ((series, _), members) in groups {
            let iterations = members
                .iter()
                .map(|row| (row.number(size), row.number("iterations")));
            let iterations = row! { iterations: exponent(iterations) };
            all.extend(growth(&members, size).map(|fit| fit.with(series).with(iterations)));
        }
    }
    replace(tables, "solve_growth", all);
}

/// Seconds against unknowns, a line per solver.
fn draw(results: &Results) -> Page {
    let beam = |row: &Row| match row.has("bricks") {
        true => format!(", beam {} across", row.count("bricks")),
        false => String::new(),
    };
    let point = |row: &Row| Some([exact(row, "active_cells"), row.spread("seconds")?]);
    let device = |row: &Row| {
        let [form, kind, precision] =
            ["formulation", "preconditioner", "precision"].map(|name| row.text(name));
        format!("{form} {kind} {precision}{}", beam(row))
    };
    let mut all = lines(results.rows("solve"), device, point);
    let name = |row: &Row| {
        format!(
            "{} {} on the CPU{}",
            row.text("formulation"),
            row.text("rival"),
            beam(row)
        )
    };
    all.extend(lines(results.rows("solve_against"), name, point));
    Page::Charts(
        1,
        vec![Chart {
            title: format!("Solve, {}", results.machine.name()),
            axes: ["active cells", "seconds"],
            lines: all,
            falling: false,
        }],
    )
}
