//! `bench solve`: the solve against the grid, of the pressure on the pressure-only base block, and of liquid and solids on the base scene.
//!
//! A run is timed from the recording of the set-up of hierarchy and, with solids, of their elements to the verdict on the host. The first run of each row, which
//! compiles, is not counted. Bytes follow the model of `bytes_per_solve`: every array that a pass needs, once.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::time::Instant;

use plotters::prelude::*;
use serde::Serialize;

use crate::Error;
use crate::gpu::{Buffer, Gpu, Real, Recorder};
use crate::grid::{Axis, Padded};
use crate::linalg;
use crate::output::write_atomically;
use crate::reference::SIGMA;
use crate::reference::base_block::{BaseBlock, THETA_FLOOR};
use crate::reference::base_scene::{BaseBeam, BaseScene};
use crate::scene::{self, Precision, Preconditioner, Solver};
use crate::solver::{
    CoupledOutcome, Everywhere, Outcome, PressureSolver, PressureSystem, SolverBuffers,
};

use super::base_scene::DeviceScene;
use super::solid_bytes::SolidBytes;
use super::statistics::Spread;
use super::table::{Machine, write_csv, write_json, write_svg};

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
    /// Runs per row.
    pub repeats: usize,
    /// How to solve.
    pub solvers: Vec<Solver>,
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
    /// Nodes of the solids: of the beam that the thesis has on a grid of this size.
    pub solid_nodes: u32,
    /// `pressure` or `two-field`.
    pub formulation: &'static str,
    /// `multigrid` or `jacobi`.
    pub preconditioner: &'static str,
    /// `f32`, `mixed` or `f64`.
    pub precision: &'static str,
    /// Relative, of the true residual.
    pub tolerance: f64,
    /// `converged`, or how else the solve ended.
    pub status: &'static str,
    /// PCG iterations summed over rounds.
    pub iterations: u32,
    /// Rounds of refinement.
    pub rounds: u32,
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
    /// Unknowns times iterations per second.
    pub cell_iterations_per_second: f64,
    /// Bytes that the solve must move.
    pub bytes: f64,
    /// Bytes per second over the copy bandwidth of the same run.
    pub share_of_copy_bandwidth: f64,
}

/// A row per grid and solver.
pub type Table = super::table::Table<Row>;

/// Bytes per unknown that the iterations of a solve must move, each pass touching each of its arrays once: w bytes a scalar of
/// the corrections, 8 of the outer loop (4 with `f32`), 5 sections of the matrix for the share of quads that are not uniform.
///
/// An iteration on the finest level: apply (s, r, q), update (x and r twice, s, q, z), two smoothing sweeps and the one after
/// the prolongation (x, r, x_out each), restriction (x, r), prolongation (x twice), direction (z, s twice); list entries, a byte per
/// cell and pass. The coarser levels add a seventh of what the V-cycle moves.
pub(super) fn bytes_per_iterations(
    not_uniform: f64,
    iterations: f64,
    rounds: f64,
    [inner, outer]: [f64; 2],
) -> f64 {
    let matrix = 5.0 * inner * not_uniform;
    let cycle =
        3.0 * (3.0 * inner + matrix + 1.0) + (2.0 * inner + matrix + 1.0) + (2.0 * inner + 1.0);
    let rest = (3.0 * inner + matrix + 1.0)
        + (7.0 * inner + not_uniform * inner + 1.0)
        + (3.0 * inner + 1.0);
    let iteration = cycle * 8.0 / 7.0 + rest;
    let turn = (3.0 * outer + matrix + 1.0) + (2.0 * outer + inner + 1.0) + (outer + 5.0 * inner);
    iterations * iteration + (rounds + 1.0) * turn
}

/// Bytes that a solve must move, the set-up of the hierarchy included: distance and open fractions in, the matrix out.
fn bytes_per_solve(
    unknowns: f64,
    not_uniform: f64,
    iterations: f64,
    rounds: f64,
    widths: [f64; 2],
) -> f64 {
    let set_up = 4.0 * 4.0 + 5.0 * widths[0] * 8.0 / 7.0;
    unknowns * (bytes_per_iterations(not_uniform, iterations, rounds, widths) + set_up)
}

/// How a precision is spelled in the tables.
pub(super) fn name(precision: Precision) -> &'static str {
    match precision {
        Precision::F32 => "f32",
        Precision::Mixed => "mixed",
        Precision::F64 => "f64",
    }
}

/// Measures all rows and writes solve.csv, solve.json and solve.svg into `out`; `tell` hears of each row.
///
/// # Errors
/// [`Error::Output`], and what the device says.
pub fn bench_solve(
    gpu: &Gpu,
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(&Row),
) -> Result<Table, Error> {
    for &n in &options.grids {
        // Before anything is made: a block too large for the device may be too large for the host.
        let bytes = 3 * 16 * Padded::new([n; 3]).quads as u64;
        gpu.report().check_buffer("bench.open", bytes)?;
    }
    fs::create_dir_all(out).map_err(|problem| Error::output(out, problem))?;
    let mut table = Table {
        machine: Machine::new(gpu, options.repeats)?,
        rows: Vec::new(),
    };
    for &n in &options.grids {
        let block = BaseBlock::new(n);
        if options.matrices {
            let mut formulations = options.formulations.iter();
            write_matrices(&block, n, out)?;
            if formulations.any(|formulation| *formulation != Formulation::Pressure) {
                write_coupled_matrices(n, out)?;
            }
        }
        for &formulation in &options.formulations {
            for solver in &options.solvers {
                let (repeats, machine) = (options.repeats, &table.machine);
                let row = match formulation {
                    Formulation::Pressure => measure(gpu, &block, solver, repeats, machine)?,
                    Formulation::TwoField | Formulation::Condensed => {
                        measure_coupled(gpu, (formulation, n), solver, repeats, machine)?
                    }
                };
                tell(&row);
                table.rows.push(row);
            }
        }
    }
    write_csv(&table.rows, &out.join("solve.csv"))?;
    write_json(&table, &out.join("solve.json"))?;
    write_svg(&out.join("solve.svg"), (800, 600), |page| {
        draw(&table, page)
    })?;
    Ok(table)
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
fn write_coupled_matrices(n: usize, out: &Path) -> Result<(), Error> {
    let system = base_scene(n)?.coupled_system();
    let blocks = system.blocks();
    let cells = blocks.cells.iter();
    let e: Vec<f64> = cells.map(|&cell| system.pressure.rhs[cell]).collect();
    let components = blocks.components.iter();
    let w: Vec<f64> = components.map(|&at| -system.solid.rhs[at]).collect();
    let both: Vec<f64> = e.iter().chain(&w).copied().collect();
    let parts = [
        (
            "spd",
            blocks.two_field(SIGMA)?,
            blocks.two_field_rhs(SIGMA, &e, &w),
            "A of the thesis's (5.25): pressures, then velocities",
        ),
        (
            "indefinite",
            blocks.indefinite(),
            both,
            "[B J; J^T -S] of the thesis's (5.17), the same unknowns",
        ),
    ];
    for (name, matrix, rhs, comment) in parts {
        let text = linalg::matrix_text(&matrix, linalg::Symmetry::Symmetric, comment);
        let file = out.join(format!("base_scene_{n}_{name}.mtx"));
        write_atomically(&file, text.as_bytes())?;
        let text = linalg::vector_text(&rhs, "its right-hand side");
        let file = out.join(format!("base_scene_{n}_{name}_rhs.mtx"));
        write_atomically(&file, text.as_bytes())?;
    }
    Ok(())
}

/// The base scene with the beam that goes with a grid.
fn base_scene(n: usize) -> Result<BaseScene, Error> {
    let beam = BaseBeam {
        bricks: bricks(n),
        ..BaseBeam::default()
    };
    BaseScene::new(n, &beam)
}

fn measure(
    gpu: &Gpu,
    block: &BaseBlock,
    solver: &Solver,
    repeats: usize,
    machine: &Machine,
) -> Result<Row, Error> {
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
    buffers.rhs.upload(
        gpu,
        &padded.pad(grid.cells, &block.pressure_system().rhs, |value| {
            value / area
        }),
    );
    let solve = |verify: bool| -> Result<(f64, Outcome), Error> {
        gpu.wait("bench")?;
        let clock = Instant::now();
        let mut recorder = Recorder::new(gpu);
        recorder.stage("active_cells", |pass| system.record(pass, &buffers, within));
        let (outcome, _) = pressure.solve(gpu, recorder, &buffers, verify)?;
        Ok((clock.elapsed().as_secs_f64(), outcome))
    };
    let (_, outcome) = solve(true)?;
    let mut seconds = Vec::new();
    for _ in 0..repeats.max(1) {
        let (elapsed, again) = solve(false)?;
        assert_eq!(
            again.iterations, outcome.iterations,
            "the same solve on the same device repeats"
        );
        seconds.push(elapsed);
    }
    let seconds = Spread::of(seconds);
    let not_uniform = not_uniform(gpu, &buffers)?;
    let widths = widths(&buffers);
    let (unknowns, iterations) = (f64::from(outcome.unknowns), f64::from(outcome.iterations));
    let bytes = bytes_per_solve(
        unknowns,
        not_uniform,
        iterations,
        f64::from(outcome.rounds),
        widths,
    );
    Ok(Row {
        scene: "base_block",
        grid: grid.cells[0],
        active_cells: outcome.unknowns,
        solid_nodes: 0,
        formulation: Formulation::Pressure.name(),
        preconditioner: preconditioner_name(solver.preconditioner),
        precision: name(solver.precision),
        tolerance: solver.tolerance,
        status: outcome.status.name(),
        iterations: outcome.iterations,
        rounds: outcome.rounds,
        seconds_median: seconds.median,
        seconds_min: seconds.min,
        seconds_max: seconds.max,
        residual_p: outcome.residual,
        residual_v: 0.0,
        cell_iterations_per_second: unknowns * iterations / seconds.median,
        bytes,
        share_of_copy_bandwidth: machine.share_of_copy_bandwidth(bytes, seconds.median),
    })
}

/// The beam that the thesis has on about so many cells along an edge.
fn bricks(n: usize) -> [usize; 3] {
    match n {
        ..50 => [2, 2, 14],
        50..70 => [3, 3, 21],
        _ => [4, 4, 28],
    }
}

fn measure_coupled(
    gpu: &Gpu,
    (formulation, n): (Formulation, usize),
    solver: &Solver,
    repeats: usize,
    machine: &Machine,
) -> Result<Row, Error> {
    let solver = &Solver {
        formulation: match formulation {
            Formulation::Condensed => scene::Formulation::Condensed,
            Formulation::Pressure | Formulation::TwoField => scene::Formulation::TwoField,
        },
        ..*solver
    };
    let scene = base_scene(n)?;
    let system = scene.coupled_system();
    let device = DeviceScene::new(gpu, &scene, &system, solver)?;
    let solve = || -> Result<(f64, CoupledOutcome), Error> {
        device.reset();
        gpu.wait("bench")?;
        let clock = Instant::now();
        let outcome = device.solve()?;
        Ok((clock.elapsed().as_secs_f64(), outcome))
    };
    let (_, outcome) = solve()?;
    let mut seconds = Vec::new();
    for _ in 0..repeats.max(1) {
        let (elapsed, again) = solve()?;
        assert_eq!(again, outcome, "the same solve on the same device repeats");
        seconds.push(elapsed);
    }
    let seconds = Spread::of(seconds);
    let n_cells = system.pressure.n_unknowns() as f64;
    let iterations = f64::from(outcome.iterations);
    let widths = widths(&device.liquid);
    let [inner, outer] = widths.map(|bytes| bytes as usize);
    let not_uniform = not_uniform(gpu, &device.liquid)?;
    let rounds = f64::from(outcome.rounds);
    // Two polynomials an iteration, or W in f32; what else there is of the solids is little beside that.
    let of_solids = if outcome.condensed {
        let pairs = system.coupling.pairs().iter();
        let wet: BTreeSet<usize> = pairs.map(|pair| pair.node).collect();
        4.0 * (3.0 * wet.len() as f64).powi(2)
    } else {
        let solids = SolidBytes::new(&scene.solids, [outer, inner]);
        2.0 * f64::from(device.polynomial.degree) * solids.of_step()
    };
    let bytes =
        bytes_per_solve(n_cells, not_uniform, iterations, rounds, widths) + iterations * of_solids;
    Ok(Row {
        scene: "base_scene",
        grid: n,
        active_cells: n_cells as u32,
        solid_nodes: scene.solids.rest.len() as u32,
        formulation: formulation.name(),
        preconditioner: preconditioner_name(solver.preconditioner),
        precision: name(solver.precision),
        tolerance: solver.tolerance,
        status: outcome.status.name(),
        iterations: outcome.iterations,
        rounds: outcome.rounds,
        seconds_median: seconds.median,
        seconds_min: seconds.min,
        seconds_max: seconds.max,
        residual_p: outcome.residuals[0],
        residual_v: outcome.residuals[1],
        cell_iterations_per_second: n_cells * iterations / seconds.median,
        bytes,
        share_of_copy_bandwidth: machine.share_of_copy_bandwidth(bytes, seconds.median),
    })
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

/// Seconds against unknowns, log-log, a line per solver, bars from least to largest.
fn draw(table: &Table, page: SVGBackend) -> Result<(), Box<dyn std::error::Error>> {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let unknowns = |row: &Row| f64::from(row.active_cells.max(1));
    let bounds = |values: Vec<f64>| {
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(0.0, f64::max);
        (low / 1.5)..(high * 1.5)
    };
    let x = bounds(table.rows.iter().map(unknowns).collect());
    let y = bounds(
        table
            .rows
            .iter()
            .flat_map(|row| [row.seconds_min, row.seconds_max])
            .collect(),
    );
    let mut chart = ChartBuilder::on(&root)
        .caption(
            format!("Solve, {}", table.machine.adapter),
            ("sans-serif", 20),
        )
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(70)
        .build_cartesian_2d(x.log_scale(), y.log_scale())?;
    chart
        .configure_mesh()
        .x_desc("unknowns")
        .y_desc("seconds")
        .draw()?;
    let key = |row: &Row| {
        format!(
            "{} {} {} {:.0e}",
            row.formulation, row.preconditioner, row.precision, row.tolerance
        )
    };
    let mut keys: Vec<String> = table.rows.iter().map(key).collect();
    keys.sort();
    keys.dedup();
    for (index, series) in keys.into_iter().enumerate() {
        let colour = Palette99::pick(index).to_rgba();
        let rows: Vec<&Row> = table.rows.iter().filter(|row| key(row) == series).collect();
        let points = rows.iter().map(|row| (unknowns(row), row.seconds_median));
        chart
            .draw_series(LineSeries::new(points, colour.stroke_width(2)).point_size(3))?
            .label(series)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour));
        for row in rows {
            let spread = [
                (unknowns(row), row.seconds_min),
                (unknowns(row), row.seconds_max),
            ];
            chart.draw_series([PathElement::new(spread, colour)])?;
        }
    }
    chart
        .configure_series_labels()
        .border_style(BLACK)
        .background_style(WHITE)
        .draw()?;
    root.present()?;
    Ok(())
}
