//! `cutwater bench solve`

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use cutwater::Error;
use cutwater::gpu::Gpu;
use cutwater::measure::bench_solve::{self, Formulation, Options, Rival};
use cutwater::scene::Solver;

use super::{
    PrecisionName, PreconditionerName, at_least_once, check_tolerance, range, tell_machine,
};
use crate::cli::AdapterArgs;

#[derive(Debug, Args)]
pub(super) struct Solve {
    /// Cells along an edge of the block; max: the largest multiple of 10 that the adapter and this machine have room for
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "N,N,..",
        default_value = "20,40,60,80"
    )]
    grids: Vec<GridName>,
    /// Bricks across the beam, for beams of their own sizes instead of that which goes with the grid
    #[arg(long, value_delimiter = ',', value_name = "N,N,..")]
    bricks: Vec<usize>,
    /// Timed runs per row; from the fourth on no more are begun where they have taken 20 s
    #[arg(long, default_value_t = 5, value_parser = at_least_once())]
    repeats: usize,
    /// Relative tolerances of the true residual
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "T,..",
        default_value = "1e-8"
    )]
    tolerance: Vec<f64>,
    /// Precisions to measure
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        value_name = "P,..",
        default_value = "mixed"
    )]
    precision: Vec<PrecisionName>,
    /// Systems to solve: pressures on the base block, or pressures and the velocities of a beam on the base scene
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        value_name = "F,..",
        default_value = "pressure"
    )]
    formulation: Vec<FormulationName>,
    /// Preconditioners of the pressure to measure
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        value_name = "P,..",
        default_value = "multigrid"
    )]
    preconditioner: Vec<PreconditionerName>,
    /// Solvers on the CPU to take turns with, in double precision
    #[arg(long, value_enum, value_delimiter = ',', value_name = "A,..")]
    against: Vec<RivalName>,
    /// Larger factors on the CPU are not computed, GiB
    #[arg(long, default_value_t = 1.0, value_name = "GIB")]
    largest_factor: f64,
    /// PCG iterations in all rounds
    #[arg(long, default_value_t = 5000)]
    max_iterations: u32,
    /// Also write the systems as Matrix Market files, base_*.mtx
    #[arg(long)]
    matrices: bool,
    /// Folder of the results
    #[arg(long, default_value = "out/bench_solve")]
    out: PathBuf,
    #[command(flatten)]
    adapter: AdapterArgs,
}

#[derive(Clone, Copy, Debug)]
enum GridName {
    Cells(usize),
    Max,
}

impl std::str::FromStr for GridName {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<GridName, Self::Err> {
        match text {
            "max" => Ok(GridName::Max),
            _ => text
                .parse()
                .map(GridName::Cells)
                .map_err(|_| "give numbers of cells, or max"),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FormulationName {
    Pressure,
    TwoField,
    Condensed,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum RivalName {
    /// Conjugate gradients with an incomplete Cholesky factor
    Ic0,
    /// A sparse Cholesky factor
    Cholesky,
    /// The f64 path's conjugate gradients with multigrid, of liquid and solids in the condensed form
    Multigrid,
}

/// Bricks across the beam.
const BRICKS: std::ops::RangeInclusive<usize> = 1..=32;

/// Cells along an edge of the base block.
const GRIDS: std::ops::RangeInclusive<usize> = 2..=bench_solve::LARGEST_GRID;

impl Solve {
    pub(super) fn run(&self) -> Result<(), Error> {
        let outside = |grid: &&GridName| matches!(grid, GridName::Cells(n) if !GRIDS.contains(n));
        if let Some(GridName::Cells(n)) = self.grids.iter().find(outside) {
            return Err(Error::input(
                format!("--grids {n}"),
                "too few or too many cells along an edge",
                "give grids of 2 to 1024 cells, or max",
            ));
        }
        if let Some(&bricks) = self.bricks.iter().find(|n| !BRICKS.contains(n)) {
            return Err(Error::input(
                format!("--bricks {bricks}"),
                "too few or too many bricks across the beam",
                "give 1 to 32",
            ));
        }
        if self.largest_factor.is_nan() || self.largest_factor <= 0.0 {
            return Err(Error::input(
                format!("--largest-factor {}", self.largest_factor),
                "not a size",
                "give a number of GiB above 0",
            ));
        }
        self.tolerance
            .iter()
            .copied()
            .try_for_each(check_tolerance)?;
        let blocks = |name: &PreconditionerName| matches!(name, PreconditionerName::BlockJacobi);
        let of_nodes = |name: &FormulationName| matches!(name, FormulationName::TwoField);
        if self.preconditioner.iter().any(blocks) && !self.formulation.iter().all(of_nodes) {
            return Err(Error::input(
                "--preconditioner block-jacobi",
                "only the two-field form has blocks of nodes",
                "give --formulation two-field alone, or use --preconditioner jacobi",
            ));
        }
        let gpu = Gpu::new(&self.adapter.choice())?;
        let mut solvers = Vec::new();
        for precision in &self.precision {
            for preconditioner in &self.preconditioner {
                solvers.extend(self.tolerance.iter().map(|&tolerance| Solver {
                    tolerance,
                    max_iterations: self.max_iterations,
                    precision: precision.precision(),
                    preconditioner: preconditioner.preconditioner(),
                    ..Solver::default()
                }));
            }
        }
        let grids = self.grids.iter().map(|grid| match grid {
            GridName::Cells(n) => Ok(*n),
            GridName::Max => bench_solve::largest_grid(gpu.report(), &solvers),
        });
        let grids = grids.collect::<Result<_, _>>()?;
        let formulations = self.formulation.iter().map(|name| match name {
            FormulationName::Pressure => Formulation::Pressure,
            FormulationName::TwoField => Formulation::TwoField,
            FormulationName::Condensed => Formulation::Condensed,
        });
        let against = self.against.iter().map(|name| match name {
            RivalName::Ic0 => Rival::IncompleteCholesky,
            RivalName::Cholesky => Rival::Cholesky,
            RivalName::Multigrid => Rival::Multigrid,
        });
        let options = Options {
            formulations: formulations.collect(),
            grids,
            bricks: match self.bricks.is_empty() {
                true => vec![None],
                false => self.bricks.iter().copied().map(Some).collect(),
            },
            against: against.collect(),
            largest_factor: self.largest_factor * bench_solve::GIB,
            repeats: self.repeats,
            solvers,
            matrices: self.matrices,
        };
        say!(
            "grid  cells     nodes  formulation  preconditioner precision  tolerance  iterations  seconds (least, largest)  residuals  waits  dispatches  idle ms"
        );
        let table = bench_solve::bench_solve(&gpu, &options, &self.out, &mut |row, against| {
            say!(
                "{:4}  {:8}  {:5}  {:11}  {:14} {:9}  {:9.0e}  {:10}  {:.4} ({:.4}, {:.4})  {:.1e} {:.1e} {}  {:5}  {:10}  {:.2}",
                row.grid,
                row.active_cells,
                row.solid_nodes,
                row.formulation,
                row.preconditioner,
                row.precision,
                row.tolerance,
                row.iterations,
                row.seconds_median,
                row.seconds_min,
                row.seconds_max,
                row.residual_p,
                row.residual_v,
                row.status,
                row.waits,
                row.dispatches,
                1e3 * row.idle_seconds,
            );
            for rival in against {
                match (rival.seconds_median, rival.ratio_median) {
                    (Some(seconds), Some(ratio)) => say!(
                        "      {:12} on the CPU: {seconds:.4} s, {ratio:.2} times as long ({:.2}, {:.2}), residuals {:.1e} {:.1e}",
                        rival.rival,
                        rival.ratio_min.unwrap_or(ratio),
                        rival.ratio_max.unwrap_or(ratio),
                        rival.residual_p.unwrap_or(0.0),
                        rival.residual_v.unwrap_or(0.0)
                    ),
                    _ => say!("      {:12} on the CPU: {}", rival.rival, rival.note),
                }
            }
        })?;
        for growth in &table.growth {
            say!(
                "{} {} {}: seconds grow with {} to the power of {:.2}{}, at last {:.2} ({} to {})",
                growth.formulation,
                growth.solver,
                growth.precision,
                growth.along,
                growth.exponent,
                range([growth.exponent_low, growth.exponent_high]),
                growth.exponent_last,
                growth.from,
                growth.to,
            );
        }
        tell_machine(&table.machine);
        say!("table and picture: {}", self.out.display());
        Ok(())
    }
}
