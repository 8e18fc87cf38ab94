//! `bench solve`: the solve against the grid, of the pressure on the pressure-only base block, and of liquid and solids on the base scene.
//!
//! A run is timed from the recording of the set-up of hierarchy and, with solids, of their elements to the verdict on the host, in f64 as in every
//! sub-step. The first run of each row, which compiles, is not counted. Solvers on the CPU take turns with the device.

mod against;
mod bytes;
mod capacity;
mod ended;
mod growth;
mod picture;
mod rival;

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Instant;

use serde::Serialize;

use crate::Error;
use crate::gpu::{Buffer, Gpu, Real, Recorder, Traffic};
use crate::grid::Axis;
use crate::linalg::{self, Csr};
use crate::output::{FolderLock, write_atomically};
use crate::reference::base_block::{BaseBlock, THETA_FLOOR};
use crate::reference::base_scene::{BaseBeam, BaseScene};
use crate::reference::{CoupledSystem, SIGMA};
use crate::scene::{self, Precision, Preconditioner, Solver};
use crate::solver::{
    CoupledOutcome, Everywhere, Outcome, PressureSolver, PressureSystem, SolverBuffers,
};
use crate::state::SolveStatus;

use super::base_scene::DeviceScene;
use super::solid_bytes::SolidBytes;
use super::statistics::Spread;
use super::table::{Machine, remove_earlier, write_csv, write_json, write_svg};

pub use against::{Against, GIB};
use against::{Contest, FEWEST, LONG_ENOUGH};
pub(super) use bytes::{Corrections, SolveBytes};
use capacity::Capacity;
pub use capacity::{LARGEST_GRID, largest_grid};
pub(super) use ended::{Ended, is_solved};
pub use growth::Growth;
use rival::Assembled;
pub use rival::Rival;

/// What is solved for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Formulation {
    /// Pressures, without solids.
    Pressure,
    /// Pressures and velocities of solids, thesis (5.25) in factored form.
    TwoField,
    /// Pressures of the same scene alone, with the inverse of the solids' matrix among the wet nodes.
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

/// What to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// The systems.
    pub formulations: Vec<Formulation>,
    /// Cells along an edge of the block.
    pub grids: Vec<usize>,
    /// Bricks across the beam, which is seven times as long; none for the beam that goes with the grid.
    pub bricks: Vec<Option<usize>>,
    /// Runs per row.
    pub repeats: usize,
    /// How to solve.
    pub solvers: Vec<Solver>,
    /// Solvers on the CPU that take turns with the device.
    pub against: Vec<Rival>,
    /// Bytes of a factor on the CPU; with larger ones nothing is solved.
    pub largest_factor: f64,
    /// Whether the systems are written as Matrix Market files, for other solvers.
    pub matrices: bool,
}

/// A row of solve.csv.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// `base_block`, or `base_scene` with solids.
    pub scene: &'static str,
    /// Cells along an edge.
    pub grid: usize,
    /// Unknowns.
    pub active_cells: u32,
    /// Nodes of the solids.
    pub solid_nodes: u32,
    /// Bricks across the beam; empty for that which the thesis has on a grid of this size, and without one.
    pub bricks: Option<usize>,
    /// `pressure`, `two-field` or `condensed`.
    pub formulation: &'static str,
    /// `multigrid`, `jacobi` or `block_jacobi`.
    pub preconditioner: &'static str,
    /// `f32`, `mixed` or `f64`.
    pub precision: &'static str,
    /// Relative, of the true residual.
    pub tolerance: f64,
    /// `converged`, or how else the solve ended: `converged_to_rounding` where it passed with a residual above the tolerance, but
    /// below what rounding makes of it.
    pub status: &'static str,
    /// PCG iterations summed over rounds.
    pub iterations: u32,
    /// Rounds of refinement.
    pub rounds: u32,
    /// Timed runs.
    pub runs: usize,
    /// Seconds, set-up of the hierarchy included.
    pub seconds_median: f64,
    /// Least.
    pub seconds_min: f64,
    /// Largest.
    pub seconds_max: f64,
    /// True relative residual, f64.
    pub residual_p: f64,
    /// That of the solids' rows; 0 without solids.
    pub residual_v: f64,
    /// Unknowns per second of the median.
    pub cells_per_second: f64,
    /// The same times the iterations.
    pub cell_iterations_per_second: f64,
    /// Bytes that the solve must move.
    pub bytes: f64,
    /// Bytes per second over the copy bandwidth of the same run.
    pub share_of_copy_bandwidth: f64,
    /// Times that the host waits for the device in a solve.
    pub waits: u64,
    /// Submissions in a solve.
    pub submissions: u64,
    /// Dispatches in a solve.
    pub dispatches: u64,
    /// Bytes that the host writes to buffers in a solve.
    pub bytes_up: u64,
    /// Bytes that the host reads back in a solve.
    pub bytes_down: u64,
    /// Seconds of a solve in which nothing is queued on the device, median.
    pub idle_seconds: f64,
    /// Bytes of all device buffers of the solve.
    pub device_bytes: u64,
}

/// The tables and where they were measured.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// Where.
    #[serde(flatten)]
    pub machine: Machine,
    /// A row per grid, beam and solver.
    pub rows: Vec<Row>,
    /// A row for each of them and each solver on the CPU.
    pub against: Vec<Against>,
    /// A row for each solver and what grows.
    pub growth: Vec<Growth>,
}

/// A grid and a beam.
#[derive(Clone, Copy)]
struct Size {
    grid: usize,
    bricks: Option<usize>,
}

/// How a precision is spelled in the tables.
pub(super) fn name(precision: Precision) -> &'static str {
    match precision {
        Precision::F32 => "f32",
        Precision::Mixed => "mixed",
        Precision::F64 => "f64",
    }
}

/// Measures all rows and writes solve.csv, solve.json, solve.svg, solve_growth.csv where a solver has two sizes or more and, with rivals,
/// solve_against.csv into `out`, anew after each; `tell` hears of each row.
///
/// # Errors
/// Before any work [`Error::Limit`] and [`Error::Memory`] where there is no room for a grid, [`Error::Output`] where the folder cannot be
/// written and [`Error::Input`] where another process writes into it; then [`Error::Check`] where a solve does not repeat, and what the device
/// says.
pub fn bench_solve(
    gpu: &Gpu,
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(&Row, &[Against]),
) -> Result<Table, Error> {
    let capacity = Capacity::new(gpu.report());
    for &grid in &options.grids {
        capacity.check(grid, &options.solvers)?;
    }
    let _held = FolderLock::take(out)?;
    remove_earlier(out, &["solve_growth.csv", "solve_against.csv"])?;
    let mut table = Table {
        machine: Machine::new(gpu, options.repeats)?,
        rows: Vec::new(),
        against: Vec::new(),
        growth: Vec::new(),
    };
    let mut measured = |table: &mut Table, row: Row, against: Vec<Against>| {
        tell(&row, &against);
        table.rows.push(row);
        table.against.extend(against);
        table.write(out)
    };
    for &grid in &options.grids {
        let block = BaseBlock::new(grid);
        if options.matrices {
            write_matrices(&block, grid, out)?;
        }
        if options.formulations.contains(&Formulation::Pressure) {
            for solver in &options.solvers {
                let (row, against) = measure(gpu, &block, solver, options, &table.machine)?;
                measured(&mut table, row, against)?;
            }
        }
        let mut coupled = options.formulations.iter();
        if !coupled.any(|formulation| *formulation != Formulation::Pressure) {
            continue;
        }
        for &bricks in &options.bricks {
            let size = Size { grid, bricks };
            let scene = base_scene(size)?;
            let system = scene.coupled_system();
            if options.matrices {
                write_coupled_matrices(&system, size, out)?;
            }
            let formulations = options.formulations.iter();
            for &formulation in formulations.filter(|other| **other != Formulation::Pressure) {
                for solver in &options.solvers {
                    let systems = (&scene, &system);
                    let machine = &table.machine;
                    let (row, against) = measure_coupled(
                        gpu,
                        (formulation, size),
                        systems,
                        solver,
                        options,
                        machine,
                    )?;
                    measured(&mut table, row, against)?;
                }
            }
        }
    }
    Ok(table)
}

impl Row {
    /// Whether the residuals are within the tolerance. Others are no part of ratios and exponents.
    fn converged(&self) -> bool {
        self.status == SolveStatus::Converged.name()
    }
}

impl Table {
    /// Makes again what follows from the rows, and writes what there is.
    fn write(&mut self, out: &Path) -> Result<(), Error> {
        self.growth = growth::growth(&self.rows, &self.against);
        write_csv(&self.rows, &out.join("solve.csv"))?;
        write_csv(&self.growth, &out.join("solve_growth.csv"))?;
        write_csv(&self.against, &out.join("solve_against.csv"))?;
        write_json(self, &out.join("solve.json"))?;
        write_svg(&out.join("solve.svg"), (900, 640), |page| {
            picture::draw(self, page)
        })
    }
}

/// The system of liquid and beam in the thesis's form (5.25).
struct Positive {
    matrix: Csr,
    rhs: Vec<f64>,
    /// Right-hand sides e and -w of (5.17).
    both: [Vec<f64>; 2],
}

impl Positive {
    fn new(system: &CoupledSystem) -> Result<Positive, Error> {
        let blocks = system.blocks();
        let cells = blocks.cells.iter();
        let e: Vec<f64> = cells.map(|&cell| system.pressure.rhs[cell]).collect();
        let components = blocks.components.iter();
        let w: Vec<f64> = components.map(|&at| -system.solid.rhs[at]).collect();
        Ok(Positive {
            matrix: blocks.two_field(SIGMA)?,
            rhs: blocks.two_field_rhs(SIGMA, &e, &w),
            both: [e, w],
        })
    }
}

/// One solve on the device.
struct Solve<Outcome> {
    seconds: f64,
    traffic: Traffic,
    outcome: Outcome,
}

/// Times a solve on a device that has nothing else to do.
fn timed<Outcome>(
    gpu: &Gpu,
    solve: impl FnOnce() -> Result<Outcome, Error>,
) -> Result<Solve<Outcome>, Error> {
    gpu.wait("bench")?;
    let before = gpu.traffic();
    let clock = Instant::now();
    let outcome = solve()?;
    Ok(Solve {
        seconds: clock.elapsed().as_secs_f64(),
        traffic: gpu.traffic().since(before),
        outcome,
    })
}

/// Repeated solves on the device.
struct Repeats<Outcome> {
    seconds: Spread,
    runs: usize,
    /// Traffic of a solve; its idle seconds are the median.
    traffic: Traffic,
    outcome: Outcome,
}

/// Alternates solves on the device with those of the rivals, which begin every other time. `ended`: the part of an outcome that
/// repeats. `what`: the system, for messages.
fn by_turns<Outcome>(
    repeats: usize,
    mut device: impl FnMut() -> Result<Solve<Outcome>, Error>,
    rivals: &mut [Contest],
    ended: fn(&Outcome) -> Ended,
    what: &str,
) -> Result<Repeats<Outcome>, Error> {
    // The first compiles.
    let Solve { outcome, .. } = device()?;
    let mut seconds: Vec<f64> = Vec::new();
    let mut traffic = Vec::new();
    let goes_on = |seconds: &[f64]| {
        let time = seconds.len() < FEWEST || seconds.iter().sum::<f64>() < LONG_ENOUGH;
        seconds.len() < repeats.max(1) && time
    };
    while goes_on(&seconds) {
        // What drifts falls on both.
        let device_first = seconds.len().is_multiple_of(2);
        let mut of_rivals = Vec::new();
        if !device_first {
            of_rivals = solve_all(rivals)?;
        }
        let again = device()?;
        ended(&outcome).ensure_repeated(ended(&again.outcome), what)?;
        let elapsed = again.seconds;
        seconds.push(elapsed);
        traffic.push(again.traffic);
        if device_first {
            of_rivals = solve_all(rivals)?;
        }
        for (rival, taken) in rivals.iter_mut().zip(of_rivals) {
            rival.turns.extend(taken.map(|taken| [elapsed, taken]));
        }
    }
    let idle = traffic.iter().map(|traffic| traffic.idle_seconds);
    Ok(Repeats {
        runs: seconds.len(),
        seconds: Spread::of(seconds),
        traffic: Traffic {
            idle_seconds: Spread::of(idle.collect()).median,
            ..traffic[0]
        },
        outcome,
    })
}

/// Seconds of each, of those that solve.
fn solve_all(rivals: &mut [Contest]) -> Result<Vec<Option<f64>>, Error> {
    rivals.iter_mut().map(Contest::solve).collect()
}

fn contests<'a>(
    options: &Options,
    solver: &Solver,
    system: Assembled<'a>,
) -> Result<Vec<Contest<'a>>, Error> {
    let rivals = options.against.iter();
    rivals
        .map(|&rival| Contest::new(rival, system, solver, options.largest_factor))
        .collect()
}

fn write_matrices(block: &BaseBlock, n: usize, out: &Path) -> Result<(), Error> {
    let system = block.pressure_system();
    let rhs: Vec<f64> = system
        .stencil
        .active_cells()
        .into_iter()
        .map(|cell| system.rhs[cell])
        .collect();
    let comment = "pressure-only base block: negative Laplacian, m^3/s per Pa";
    let matrix = out.join(format!("base_block_{n}.mtx"));
    let text = linalg::matrix_text(&system.to_csr(), linalg::Symmetry::Symmetric, comment);
    write_atomically(&matrix, text.as_bytes())?;
    let rhs = linalg::vector_text(&rhs, "E u*, m^3/s");
    write_atomically(&out.join(format!("base_block_{n}_rhs.mtx")), rhs.as_bytes())
}

/// The system of liquid and beam in the thesis's forms (5.25) and (5.17).
fn write_coupled_matrices(system: &CoupledSystem, size: Size, out: &Path) -> Result<(), Error> {
    let positive = Positive::new(system)?;
    let indefinite = system.blocks().indefinite();
    let both = positive.both.concat();
    let parts = [
        (
            "spd",
            &positive.matrix,
            &positive.rhs,
            "A of the thesis's (5.25): pressures, then velocities",
        ),
        (
            "indefinite",
            &indefinite,
            &both,
            "[B J; J^T -S] of the thesis's (5.17), the same unknowns",
        ),
    ];
    let beam = size
        .bricks
        .map_or(String::new(), |across| format!("_beam_{across}"));
    let name = format!("base_scene_{}{beam}", size.grid);
    for (form, matrix, rhs, comment) in parts {
        let text = linalg::matrix_text(matrix, linalg::Symmetry::Symmetric, comment);
        let file = out.join(format!("{name}_{form}.mtx"));
        write_atomically(&file, text.as_bytes())?;
        let text = linalg::vector_text(rhs, "its right-hand side");
        let file = out.join(format!("{name}_{form}_rhs.mtx"));
        write_atomically(&file, text.as_bytes())?;
    }
    Ok(())
}

/// Cells along an edge of the thesis's grids, of 40, 60 and 80, for each brick across its beams.
const CELLS_PER_BRICK: usize = 20;

/// Bricks across the beam that the thesis has on about so many cells along an edge.
pub(super) fn bricks_across(grid: usize) -> usize {
    match grid {
        ..50 => 2,
        50..70 => 3,
        _ => 4,
    }
}

/// The base scene with a beam, or with that which goes with its grid.
fn base_scene(size: Size) -> Result<BaseScene, Error> {
    let across = size.bricks.unwrap_or(bricks_across(size.grid));
    let beam = BaseBeam {
        bricks: [across, across, 7 * across],
        ..BaseBeam::default()
    };
    BaseScene::new(size.grid, &beam)
}

/// What is solved, for messages.
fn title(formulation: Formulation, Size { grid, bricks }: Size, solver: &Solver) -> String {
    let beam = bricks.map_or(String::new(), |across| {
        format!(" with a beam {across} bricks across")
    });
    format!(
        "{} of grid {grid}{beam}, {} in {}",
        formulation.name(),
        preconditioner_name(solver.preconditioner),
        name(solver.precision)
    )
}

fn measure(
    gpu: &Gpu,
    block: &BaseBlock,
    solver: &Solver,
    options: &Options,
    machine: &Machine,
) -> Result<(Row, Vec<Against>), Error> {
    let grid = &block.grid;
    let padded = grid.padded();
    let faces = |label, fields: &[Vec<f64>; 3]| -> Result<Buffer<f32>, Error> {
        let values: Vec<f32> = Axis::ALL
            .iter()
            .flat_map(|&axis| {
                padded.pad(grid.faces(axis), &fields[axis.index()], |value| {
                    value as f32
                })
            })
            .collect();
        gpu.buffer_with(label, &values)
    };
    let allocated = device_bytes(gpu);
    let open = faces("bench.open", &block.open)?;
    let velocity = faces("bench.velocity", &block.velocity)?;
    let distance = padded.pad(grid.cells, &block.liquid_distance, |value| value as f32);
    let distance = gpu.buffer_with("bench.liquid_distance", &distance)?;
    let buffers = SolverBuffers::new(gpu, grid, solver.precision)?;
    let everywhere = Everywhere::new(gpu, grid)?;
    let within = everywhere.within();
    let system = PressureSystem::new(gpu, &buffers, &open, &distance, within, THETA_FLOOR)?;
    let pressure = PressureSolver::new(gpu, &buffers, &velocity, &open, solver)?;
    let area = grid.dx * grid.dx;
    let system_of_block = block.pressure_system();
    let in_cells = system_of_block.rhs.iter().map(|value| value / area);
    let in_cells: Vec<f64> = in_cells.collect();
    buffers
        .rhs
        .upload(gpu, &padded.pad(grid.cells, &in_cells, |value| value));
    let solve = || -> Result<Solve<Outcome>, Error> {
        timed(gpu, || {
            let mut recorder = Recorder::new(gpu);
            recorder.stage("active_cells", |pass| system.record(pass, &buffers, within));
            let (outcome, _) = pressure.solve(gpu, recorder, &buffers)?;
            Ok(outcome)
        })
    };
    let mut rivals = contests(options, solver, Assembled::Pressure(&system_of_block))?;
    let size = Size {
        grid: grid.cells[0],
        bricks: None,
    };
    let what = title(Formulation::Pressure, size, solver);
    let Repeats {
        seconds,
        runs,
        traffic,
        outcome,
    } = by_turns(options.repeats, solve, &mut rivals, Ended::alone, &what)?;
    let (unknowns, iterations) = (f64::from(outcome.unknowns), f64::from(outcome.iterations));
    let model = SolveBytes {
        unknowns,
        not_uniform: not_uniform(gpu, &buffers)?,
        iterations,
        rounds: f64::from(outcome.refinements),
        widths: widths(&buffers),
        preconditioner: solver.preconditioner,
    };
    let bytes = model.of_set_up() + model.of_pressure();
    let row = Row {
        scene: "base_block",
        grid: size.grid,
        active_cells: outcome.unknowns,
        solid_nodes: 0,
        bricks: size.bricks,
        formulation: Formulation::Pressure.name(),
        preconditioner: preconditioner_name(solver.preconditioner),
        precision: name(solver.precision),
        tolerance: solver.tolerance,
        status: Ended::alone(&outcome).name(solver.tolerance),
        iterations: outcome.iterations,
        rounds: outcome.refinements,
        runs,
        seconds_median: seconds.median,
        seconds_min: seconds.min,
        seconds_max: seconds.max,
        residual_p: outcome.residual,
        residual_v: 0.0,
        cells_per_second: unknowns / seconds.median,
        cell_iterations_per_second: unknowns * iterations / seconds.median,
        bytes,
        share_of_copy_bandwidth: machine.share_of_copy_bandwidth(bytes, seconds.median),
        waits: traffic.waits,
        submissions: traffic.submissions,
        dispatches: traffic.dispatches,
        bytes_up: traffic.bytes_up,
        bytes_down: traffic.bytes_down,
        idle_seconds: traffic.idle_seconds,
        device_bytes: device_bytes(gpu) - allocated,
    };
    let rivals = rivals.into_iter().map(|rival| rival.row(&row)).collect();
    Ok((row, rivals))
}

fn measure_coupled(
    gpu: &Gpu,
    (formulation, size): (Formulation, Size),
    (scene, system): (&BaseScene, &CoupledSystem),
    solver: &Solver,
    options: &Options,
    machine: &Machine,
) -> Result<(Row, Vec<Against>), Error> {
    let solver = &Solver {
        formulation: match formulation {
            Formulation::Condensed => scene::Formulation::Condensed,
            Formulation::Pressure | Formulation::TwoField => scene::Formulation::TwoField,
        },
        ..*solver
    };
    let allocated = device_bytes(gpu);
    let device = DeviceScene::new(gpu, scene, system, solver)?;
    let solve = || -> Result<Solve<CoupledOutcome>, Error> {
        device.reset();
        timed(gpu, || device.solve())
    };
    let assembled = Assembled::Both(system, &scene.solids);
    let mut rivals = contests(options, solver, assembled)?;
    let what = title(formulation, size, solver);
    let Repeats {
        seconds,
        runs,
        traffic,
        outcome,
    } = by_turns(options.repeats, solve, &mut rivals, Ended::together, &what)?;
    let n_cells = system.pressure.n_unknowns() as f64;
    let iterations = f64::from(outcome.iterations);
    let model = SolveBytes {
        unknowns: n_cells,
        not_uniform: not_uniform(gpu, &device.liquid)?,
        iterations,
        rounds: f64::from(outcome.refinements),
        widths: widths(&device.liquid),
        preconditioner: solver.preconditioner,
    };
    let corrections = match outcome.condensed {
        true => {
            let pairs = system.coupling.pairs().iter();
            let wet: BTreeSet<usize> = pairs.map(|pair| pair.node).collect();
            Corrections::Condensed {
                wet_nodes: wet.len(),
            }
        }
        false => Corrections::TwoField {
            degree: device.polynomial.degree as usize,
        },
    };
    let [inner, outer] = model.widths.map(|bytes| bytes as usize);
    let solids = SolidBytes::new(&scene.solids, [outer, inner]);
    let bytes = model.of_set_up() + model.of_both(&solids, corrections);
    let row = Row {
        scene: "base_scene",
        grid: size.grid,
        active_cells: n_cells as u32,
        solid_nodes: scene.solids.rest.len() as u32,
        bricks: size.bricks,
        formulation: formulation.name(),
        preconditioner: preconditioner_name(solver.preconditioner),
        precision: name(solver.precision),
        tolerance: solver.tolerance,
        status: Ended::together(&outcome).name(solver.tolerance),
        iterations: outcome.iterations,
        rounds: outcome.refinements,
        runs,
        seconds_median: seconds.median,
        seconds_min: seconds.min,
        seconds_max: seconds.max,
        residual_p: outcome.residuals[0],
        residual_v: outcome.residuals[1],
        cells_per_second: n_cells / seconds.median,
        cell_iterations_per_second: n_cells * iterations / seconds.median,
        bytes,
        share_of_copy_bandwidth: machine.share_of_copy_bandwidth(bytes, seconds.median),
        waits: traffic.waits,
        submissions: traffic.submissions,
        dispatches: traffic.dispatches,
        bytes_up: traffic.bytes_up,
        bytes_down: traffic.bytes_down,
        idle_seconds: traffic.idle_seconds,
        device_bytes: device_bytes(gpu) - allocated,
    };
    let rivals = rivals.into_iter().map(|rival| rival.row(&row)).collect();
    Ok((row, rivals))
}

/// Bytes of all buffers made so far.
fn device_bytes(gpu: &Gpu) -> u64 {
    gpu.allocated().iter().map(|(_, bytes)| bytes).sum()
}

/// How a preconditioner is spelled in the tables.
pub(super) fn preconditioner_name(preconditioner: Preconditioner) -> &'static str {
    match preconditioner {
        Preconditioner::Multigrid => "multigrid",
        Preconditioner::Jacobi => "jacobi",
        Preconditioner::BlockJacobi => "block_jacobi",
    }
}

/// Bytes of a scalar of the corrections and of the outer loop.
fn widths(buffers: &SolverBuffers) -> [f64; 2] {
    let width = |real: Real| real.bytes() as f64;
    [width(buffers.variant.inner), width(buffers.variant.real)]
}

/// Share of the active quads that are not uniform.
fn not_uniform(gpu: &Gpu, buffers: &SolverBuffers) -> Result<f64, Error> {
    let flags = gpu.download(&buffers.flags)?;
    let flags = flags[..buffers.plan.levels[0].quads].iter();
    let quads = flags.clone().filter(|&&flag| flag != 0).count() as f64;
    let uniform = flags.filter(|&&flag| flag >> 31 == 1).count() as f64;
    Ok(1.0 - uniform / quads.max(1.0))
}

#[cfg(test)]
mod tests {
    use super::Row;

    /// A row of the pressure on a grid of which all cells are active, that takes a nanosecond a cell.
    pub(super) fn row(grid: usize, status: &'static str) -> Row {
        let active_cells = grid.pow(3) as u32;
        let seconds = 1e-9 * f64::from(active_cells);
        Row {
            scene: "base_block",
            grid,
            active_cells,
            solid_nodes: 0,
            bricks: None,
            formulation: "pressure",
            preconditioner: "multigrid",
            precision: "mixed",
            tolerance: 1e-8,
            status,
            iterations: 12,
            rounds: 2,
            runs: 1,
            seconds_median: seconds,
            seconds_min: seconds,
            seconds_max: seconds,
            residual_p: 1e-9,
            residual_v: 0.0,
            cells_per_second: 1e9,
            cell_iterations_per_second: 12e9,
            bytes: 1.0,
            share_of_copy_bandwidth: 1.0,
            waits: 3,
            submissions: 3,
            dispatches: 300,
            bytes_up: 64,
            bytes_down: 640,
            idle_seconds: 0.0,
            device_bytes: 1 << 20,
        }
    }
}
