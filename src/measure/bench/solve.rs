//! `bench solve`: the solve against the grid, of the pressure on the base block, and of liquid and solids on the base scene.
//!
//! The time of a solve begins with recording the set-up of the hierarchy and, with solids, of their elements. It ends with the residual check in f64.
//! The first run of each row, which compiles, is not timed. Device and reference solvers on the CPU alternate in a shuffled order.

mod capacity;
mod reference_solvers;

use std::time::Instant;

use super::bytes::SolveBytes;
use super::chart::{Chart, Page, lines};
use super::ended::Ended;
use super::statistics::{Spread, exponent, grouped};
use super::table::{Row, Table, columns, row};
use super::{
    Bench, Case, GROWTH, Listener, Machine, Results, Rows, Run, Settings, TRAFFIC, Timed, allocated_bytes, growth,
    replace, rounds, rows, traffic_counts,
};
use crate::Error;
use crate::fields::SolverBuffers;
use crate::gpu::{Gpu, Recorder, Traffic};
use crate::linalg::SymbolicCholesky;
use crate::measure::base_scene::{DeviceScene, block_fields};
use crate::reference::base_block::{BaseBlock, THETA_FLOOR};
use crate::reference::base_scene::{BaseBeam, BaseScene};
use crate::scene::{self, Solver, names};
use crate::solver::{CoupledOutcome, Outcome as SolveOutcome, PressureSolver};
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

names! { Formulation: "pressure" => Pressure, "two-field" => TwoField, "condensed" => Condensed; }

/// Systems to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Forms.
    pub formulations: Vec<Formulation>,
    /// Cells along an edge of the block.
    pub grids: Vec<usize>,
    /// Bricks across the beam, which is seven times as long; `None`: the beam of the grid.
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
        + scene "" "`base_block`, or `base_scene` with solids";
        + grid "" "cells along an edge";
        + active_cells "" "unknowns of the pressure";
        + solid_nodes "" "nodes of the solids";
        - bricks "" "bricks across the beam; empty for the beam of the grid";
        + formulation "" "`pressure`, `two-field` or `condensed`";
        + preconditioner "" "`multigrid`, `jacobi` or `block_jacobi`";
        + precision "" "`f32`, `mixed` or `f64`";
        + tolerance "" "relative, of the true residual";
    }
    /// A solve on the device.
    SOLVE {
        + status "" "`converged`, `converged_to_rounding` or why not";
        + iterations "" "over all refinement steps";
        - rounds "" "refinement steps";
        - runs "" "timed runs";
        ~ seconds "s" "seconds of a solve";
        + residual_p, residual_v "" "true relative residuals of the pressure and of the solids' velocity; 0 without solids";
        - cells_per_second "1/s" "active cells over the median seconds";
        - bytes "B" "least memory traffic; empty with solids";
        - share_of_copy_bandwidth "" "`bytes` per second over the copy bandwidth";
    }
    /// The same system on the CPU.
    AGAINST {
        ~ device_seconds "s" "seconds on the device";
        + rival "" "`ic0_cg`, `cholesky` or `multigrid_cg`";
        - threads "" "threads that it may use";
        - rows "" "unknowns: of thesis (5.25) with solids; of multigrid the pressures";
        - entries "" "entries of the matrix";
        - factor_bytes "B" "bytes of the factor";
        - status "" "as in solve.csv";
        - iterations "" "of conjugate gradients; empty for a factor";
        - turns "" "timed runs";
        ~ seconds "s" "from the assembled B, S and J to the residual check: matrix, factor or hierarchy included";
        - residual_p, residual_v "" "as in solve.csv";
        ~ ratio "" "its seconds over the device's of the same round";
        + note "" "why there is no ratio";
    }
    /// A series of solves.
    SERIES {
        + formulation "" "as in solve.csv";
        + solver "" "preconditioner, or the reference solver";
        + precision "" "`f64` of reference solvers";
    }
    ITERATIONS { - iterations "" "exponent of the iterations; empty for direct solvers"; }
}

/// Measures all systems: solve.csv, solve_against.csv, solve_growth.csv, solve.json, solve.svg.
///
/// # Errors
/// Before any work [`Error::Limit`] and [`Error::Memory`] for a grid that is too large; [`Error::Output`]; [`Error::Check`] if a solve is not
/// reproducible.
pub fn measure(gpu: &Gpu, options: &Options, settings: &Settings, listener: Listener) -> Result<Results, Error> {
    let capacity = Capacity::new(gpu.report());
    options.grids.iter().try_for_each(|&grid| capacity.check(grid, &options.solvers))?;
    let against = &["grid", "bricks", "formulation", "preconditioner", "precision", "tolerance", "rival"];
    // Several reference solvers have the key of one solve.
    let key = &against[..against.len() - 1];
    let bench = Bench {
        name: "solve",
        tables: vec![
            Table::new("solve", &[SYSTEM, SOLVE, TRAFFIC], key),
            Table::new("solve_against", &[SYSTEM, AGAINST], against),
            Table::new("solve_growth", &[SERIES, GROWTH, ITERATIONS], &[]),
        ],
        derive,
        pictures: &[("solve", draw)],
    };
    let machine = Machine::new(gpu, settings.repeats)?;
    let request =
        (&options.against, options.largest_factor, options.solvers.first().map(|solver| solver.max_iterations));
    let mut run = Run::start(bench, machine, &request, settings, listener)?;
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
                        scene: if formulation == Formulation::Pressure { "base_block" } else { "base_scene" }, grid, bricks,
                        formulation: formulation.name(), tolerance: solver.tolerance, preconditioner: solver.preconditioner.name(),
                        precision: solver.precision.name(),
                    };
                    let form = match formulation {
                        Formulation::Condensed => scene::Formulation::Condensed,
                        Formulation::Pressure | Formulation::TwoField => scene::Formulation::TwoField,
                    };
                    let solver = Solver { formulation: form, ..*solver };
                    let measurement = Measurement { gpu, key: key.clone(), solver, options };
                    cases.push(Case::new("solve", key, move |run| measurement.measure(run, formulation)));
                }
            }
        }
    }
    run.cases(cases)?;
    Ok(run.results)
}

/// Bricks across the thesis's beam on grids of about this many cells along an edge.
fn bricks_across(grid: usize) -> usize {
    match grid {
        ..50 => 2,
        50..70 => 3,
        _ => 4,
    }
}

/// A system on the device.
struct Device<'a> {
    buffers: &'a SolverBuffers,
    /// Restores the right-hand sides, which a solve replaces.
    prepare: &'a dyn Fn(),
    /// Sets the system up and solves it.
    solve: &'a dyn Fn() -> Result<CoupledOutcome, Error>,
}

/// A reference solver of a system.
struct Reference {
    solver: ReferenceSolver,
    settings: Solver,
    /// Columns of the solver, its matrix and its factor.
    size: Row,
    /// Reason for not solving; empty without one.
    note: String,
}

impl Reference {
    fn new(solver: ReferenceSolver, system: Assembled, settings: &Solver, largest: f64) -> Result<Self, Error> {
        let ([mut rows, _], mut entries, mut factor_bytes) = (system.sizes(), None, None);
        if solver != ReferenceSolver::Multigrid {
            let matrix = system.definite().matrix()?;
            let factor_entries = match solver {
                ReferenceSolver::Cholesky => SymbolicCholesky::new(&matrix)?.n_factor_entries(),
                _ => matrix.n_entries(),
            };
            (rows, entries) = (matrix.n_rows(), Some(matrix.n_entries()));
            factor_bytes = Some(8.0 * factor_entries as f64);
        }
        let too_large = factor_bytes.filter(|bytes| *bytes > largest);
        let note = too_large.map_or(String::new(), |bytes| format!("factor of {:.1} GiB left out", bytes / GIB));
        let size = row! { rival: solver.name(), threads: rayon::current_num_threads(), rows, entries, factor_bytes };
        // The device's limit of iterations does not apply.
        let settings = Solver { max_iterations: (10 * rows) as u32, ..*settings };
        Ok(Reference { solver, settings, size, note })
    }

    /// Columns of `solve_against`. `status`: that of the device.
    fn row(&self, timed: Option<&Outcome>, device: &Outcome, status: &str) -> Row {
        let ended = timed.and_then(|timed| timed.outcome.0);
        let name = ended.map(|ended| ended.name(self.settings.tolerance));
        let converged = SolveStatus::Converged.name();
        let note = match name {
            None if self.note.is_empty() => "no incomplete factor without fill".to_owned(),
            None => self.note.clone(),
            Some(name) if name != converged => format!("no ratio: the reference solver {name}"),
            Some(_) if status != converged => format!("no ratio: on the device {status}"),
            Some(_) => String::new(),
        };
        let timed = timed.filter(|_| ended.is_some());
        let iterative = ended.filter(|_| self.solver != ReferenceSolver::Cholesky);
        let row = row! {
            device_seconds: device.spread(), status: name, iterations: iterative.map(|ended| ended.iterations),
            turns: timed.map_or(0, |timed| timed.runs()), seconds: timed.map(|timed| timed.spread()),
            residual_p: ended.map(|ended| ended.residuals[0]), residual_v: ended.map(|ended| ended.residuals[1]),
            ratio: timed.filter(|_| note.is_empty()).map(|timed| timed.ratio(device)), note,
        };
        row.with(self.size.clone())
    }
}

/// Timed solves: the end, and on the device the traffic.
type Outcome = Timed<(Option<Ended>, Traffic)>;

/// A system to measure.
struct Measurement<'a> {
    gpu: &'a Gpu,
    /// Identity of the system.
    key: Row,
    solver: Solver,
    options: &'a Options,
}

impl Measurement<'_> {
    /// Rows of a system: of the device and of each reference solver.
    fn measure(&self, run: &mut Run, formulation: Formulation) -> Result<Rows, Error> {
        let (grid, allocated) = (self.key.count("grid"), allocated_bytes(self.gpu));
        if formulation == Formulation::Pressure {
            return self.pressure(run, &BaseBlock::new(grid), allocated);
        }
        let across = match self.key.count("bricks") {
            0 => bricks_across(grid),
            bricks => bricks,
        };
        let beam = BaseBeam { bricks: [across, across, 7 * across], ..BaseBeam::default() };
        let scene = BaseScene::new(grid, &beam)?;
        let system = scene.coupled_system();
        let device = DeviceScene::new(self.gpu, &scene, &system, &self.solver)?;
        let device = Device { buffers: &device.liquid, prepare: &|| device.reset(), solve: &|| device.solve() };
        self.rows(run, Assembled::Both(&system, &scene.solids), &device, allocated)
    }

    /// Rows of the pressure system of the base block.
    fn pressure(&self, run: &mut Run, block: &BaseBlock, allocated: u64) -> Result<Rows, Error> {
        let (gpu, grid, assembled) = (self.gpu, &block.grid, block.pressure_system());
        let [open, velocity, distance] = &block_fields(gpu, block, &block.open)?;
        let buffers = SolverBuffers::new(gpu, grid, self.solver.precision)?;
        let everywhere = Everywhere::new(gpu, grid)?;
        let within = everywhere.within();
        let area = grid.dx * grid.dx;
        let rhs: Vec<f64> = assembled.rhs.iter().map(|value| value / area).collect();
        buffers.rhs.upload(gpu, &grid.padded().pad(grid.cells, &rhs, |value| value));
        let system = PressureSystem::new(gpu, &buffers, open, distance, within, THETA_FLOOR)?;
        let solver = PressureSolver::new(gpu, &buffers, velocity, open, &self.solver)?;
        let solve = || {
            let mut recorder = Recorder::new(gpu);
            recorder.stage(Stage::ActiveCells.name(), |pass| system.record(pass, &buffers, within));
            let (liquid, _) = solver.solve(gpu, recorder, &buffers)?;
            let no_solids = SolveOutcome { residual: 0.0, ..liquid };
            Ok(CoupledOutcome { parts: [liquid, no_solids], condensed: false })
        };
        let device = Device { buffers: &buffers, prepare: &|| {}, solve: &solve };
        self.rows(run, Assembled::Pressure(&assembled), &device, allocated)
    }

    /// Solves on the device and with the reference solvers, in rounds. `allocated`: bytes of the device before the system.
    fn rows(&self, run: &mut Run, system: Assembled, device: &Device, allocated: u64) -> Result<Rows, Error> {
        let Measurement { gpu, key, solver, options } = self;
        let references = options.against.iter();
        let references = references.map(|&other| Reference::new(other, system, solver, options.largest_factor));
        let references = references.collect::<Result<Vec<_>, _>>()?;
        let solving: Vec<&Reference> = references.iter().filter(|other| other.note.is_empty()).collect();
        let what = format!("grid {} {}", key.count("grid"), key.text("formulation"));
        // The first compiles.
        (device.prepare)();
        let solved = (device.solve)()?;
        let ended = Ended::from(&solved);
        let mut idle = Vec::new();
        let timed = rounds(run, &format!("solves of {what}"), 1 + solving.len(), |job| {
            (device.prepare)();
            gpu.wait("bench")?;
            let (before, clock) = (gpu.traffic(), Instant::now());
            if let Some(reference) = job.checked_sub(1).map(|job| solving[job]) {
                let ended = system.solve(reference.solver, &reference.settings)?.map(|reports| Ended::new(&reports));
                return Ok((clock.elapsed().as_secs_f64(), (ended, Traffic::default())));
            }
            let again = Ended::from(&(device.solve)()?);
            let seconds = clock.elapsed().as_secs_f64();
            ended.ensure_repeated(again, &what)?;
            let traffic = gpu.traffic().since(before);
            idle.push(traffic.idle_seconds);
            Ok((seconds, (Some(again), traffic)))
        })?;
        let ([active_cells, nodes], seconds) = (system.sizes(), timed[0].spread());
        let key = key.clone().with(row! { active_cells, solid_nodes: nodes });
        let status = ended.name(solver.tolerance);
        let bytes = self.least_bytes(system, device.buffers, &solved.parts[0])?;
        let own = row! {
            status, iterations: ended.iterations, rounds: solved.parts[0].refinements, runs: timed[0].runs(), seconds,
            residual_p: ended.residuals[0], residual_v: ended.residuals[1], cells_per_second: active_cells as f64 / seconds.median, bytes,
            share_of_copy_bandwidth: bytes.map(|bytes| run.results.machine.share(bytes, seconds.median)), idle_seconds: Spread::of(idle).median,
            device_bytes: allocated_bytes(gpu) - allocated,
        };
        let mut rows = vec![("solve", key.clone().with(own).with(traffic_counts(&timed[0].outcome.1)))];
        let mut others = timed[1..].iter();
        for reference in &references {
            let own = reference.note.is_empty().then(|| others.next()).flatten();
            rows.push(("solve_against", key.clone().with(reference.row(own, &timed[0], status))));
        }
        Ok(rows)
    }

    /// Least memory traffic of a solve for the pressure; `None` with solids.
    fn least_bytes(
        &self,
        system: Assembled,
        buffers: &SolverBuffers,
        outcome: &SolveOutcome,
    ) -> Result<Option<f64>, Error> {
        let Assembled::Pressure(system) = system else { return Ok(None) };
        let bytes = SolveBytes {
            unknowns: system.n_unknowns() as f64,
            not_uniform: not_uniform(self.gpu, buffers)?,
            iterations: f64::from(outcome.iterations),
            refinements: f64::from(outcome.refinements),
            widths: [buffers.variant.inner, buffers.variant.real].map(|real| real.bytes() as f64),
            preconditioner: self.solver.preconditioner,
        };
        Ok(Some(bytes.total()))
    }
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
        row.clone().with(row! { solver: row.get(solver), precision, runs: row.get(runs) })
    };
    let converged = |row: &&Row| row.text("status") == SolveStatus::Converged.name();
    let device = rows(tables, "solve").iter().filter(converged);
    let device = device.map(|row| sample(row, "preconditioner", row.text("precision"), "runs"));
    let others = rows(tables, "solve_against").iter().filter(converged);
    let samples: Vec<Row> = device.chain(others.map(|row| sample(row, "rival", "f64", "turns"))).collect();
    let series = |row: &Row| row.only(&["formulation", "solver", "precision"]);
    // Per beam, the grid closest to the thesis's cells per brick: there both are refined together.
    let off = |row: &Row| {
        let grid = row.count("grid");
        (grid.abs_diff(CELLS_PER_BRICK * bricks_across(grid)), grid)
    };
    let nearest = |row: &Row| {
        let beam = |row: &Row| series(row).with(row.only(&["solid_nodes"]));
        let same = samples.iter().filter(|other| beam(other) == beam(row));
        let closest = same.filter(|other| !other.has("bricks")).map(off).min();
        closest == Some(off(row))
    };
    let mut all = Vec::new();
    for (along, size) in [("both", "active_cells"), ("cells", "active_cells"), ("nodes", "solid_nodes")] {
        let groups = grouped(&samples, |row| {
            let (solids, own) = (row.count("solid_nodes") > 0, row.has("bricks"));
            let (belongs, fixed) = match along {
                "both" => (solids && !own && nearest(row), None),
                "cells" => (true, solids.then(|| row.count("solid_nodes"))),
                _ => (own, Some(row.count("grid"))),
            };
            belongs.then(|| (series(row).with(row! { along, fixed }), own))
        });
        for ((series, _), members) in groups {
            let points = members.iter().map(|row| (row.number(size), row.number("iterations")));
            let iterations = row! { iterations: exponent(points) };
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
    let device = |row: &Row| row.join(&["formulation", "preconditioner", "precision"]) + &beam(row);
    let other = |row: &Row| format!("{} on the CPU{}", row.join(&["formulation", "rival"]), beam(row));
    let point = ["active_cells", "seconds"];
    let mut all = lines(results.rows("solve"), device, point);
    all.extend(lines(results.rows("solve_against"), other, point));
    let title = format!("Solve, {}", results.machine.name());
    Page::Charts(1, vec![Chart { title, axes: ["active cells", "seconds"], lines: all, falling: false }])
}
