//! `cutwater bench solve`

use crate::Error;
use crate::gpu::Gpu;
use crate::measure::bench::solve::{self, Formulation, GIB, ReferenceSolver};
use crate::measure::bench::{Listener, Settings};
use crate::scene::{Precision, Preconditioner, Solver};
use clap::Args;

use super::{OrMax, Output, PRECONDITIONERS, Repeats, check_tolerance, named};
use crate::cli::AdapterArgs;

#[derive(Debug, Args)]
pub(super) struct Solve {
    /// Cells along an edge of the block; max: the largest multiple of 10 with room on the adapter and this machine
    #[arg(long, value_delimiter = ',', value_name = "N,N,..", default_value = "20,40,60,80")]
    grids: Vec<OrMax<usize>>,
    /// Bricks across the beam, for beams of their own sizes instead of the one that belongs to the grid
    #[arg(long, value_delimiter = ',', value_name = "N,N,..")]
    bricks: Vec<usize>,
    /// Relative tolerances of the true residual
    #[arg(long, value_delimiter = ',', value_name = "T,..", default_value = "1e-8")]
    tolerance: Vec<f64>,
    /// Precisions to measure
    #[arg(long, value_parser = named(Precision::NAMES), value_delimiter = ',', value_name = "P,..", default_value = "mixed")]
    precision: Vec<Precision>,
    /// Systems to solve: pressures on the base block, or pressures and the velocities of a beam on the base scene
    #[arg(long, value_parser = named(Formulation::NAMES), value_delimiter = ',', value_name = "F,..", default_value = "pressure")]
    formulation: Vec<Formulation>,
    /// Preconditioners of the pressure to measure
    #[arg(long, value_parser = named(PRECONDITIONERS), value_delimiter = ',', value_name = "P,..", default_value = "multigrid")]
    preconditioner: Vec<Preconditioner>,
    /// Reference solvers on the CPU to take turns with, in f64: CG with incomplete Cholesky, sparse Cholesky, the f64 path's multigrid
    #[arg(long, value_parser = named(REFERENCES), value_delimiter = ',', value_name = "A,..")]
    against: Vec<ReferenceSolver>,
    /// Larger factors on the CPU are not computed, GiB
    #[arg(long, default_value_t = 1.0, value_name = "GIB")]
    largest_factor: f64,
    /// PCG iterations in all refinement steps
    #[arg(long, default_value_t = 5000)]
    max_iterations: u32,
    #[command(flatten)]
    repeats: Repeats,
    #[command(flatten)]
    output: Output,
    #[command(flatten)]
    adapter: AdapterArgs,
}

const REFERENCES: &[(&str, ReferenceSolver)] = &[
    ("ic0", ReferenceSolver::IncompleteCholesky),
    ("cholesky", ReferenceSolver::Cholesky),
    ("multigrid", ReferenceSolver::Multigrid),
];

impl Solve {
    pub(super) fn run(&self) -> Result<(), Error> {
        let outside = |grid: &&OrMax<usize>| matches!(grid, OrMax::Number(n) if !(2..=solve::LARGEST_GRID).contains(n));
        if let Some(OrMax::Number(n)) = self.grids.iter().find(outside) {
            let problem = "too few or too many cells along an edge";
            return Err(Error::input(format!("--grids {n}"), problem, "give grids of 2 to 1024 cells, or max"));
        }
        if let Some(bricks) = self.bricks.iter().find(|n| !(1..=32).contains(*n)) {
            let problem = "too few or too many bricks across the beam";
            return Err(Error::input(format!("--bricks {bricks}"), problem, "give 1 to 32"));
        }
        if self.largest_factor.is_nan() || self.largest_factor <= 0.0 {
            let what = format!("--largest-factor {}", self.largest_factor);
            return Err(Error::input(what, "not a size", "give a number of GiB above 0"));
        }
        self.tolerance.iter().copied().try_for_each(check_tolerance)?;
        let blocks = self.preconditioner.contains(&Preconditioner::BlockJacobi);
        if blocks && self.formulation.iter().any(|form| *form != Formulation::TwoField) {
            return Err(Error::input(
                "--preconditioner block-jacobi",
                "only the two-field form has blocks of nodes",
                "give --formulation two-field alone, or use --preconditioner jacobi",
            ));
        }
        let gpu = Gpu::new(&self.adapter.choice())?;
        let mut solvers = Vec::new();
        for &precision in &self.precision {
            for &preconditioner in &self.preconditioner {
                solvers.extend(self.tolerance.iter().map(|&tolerance| Solver {
                    tolerance,
                    max_iterations: self.max_iterations,
                    precision,
                    preconditioner,
                    ..Solver::default()
                }));
            }
        }
        let grids = self.grids.iter().map(|grid| match grid {
            OrMax::Number(n) => Ok(*n),
            OrMax::Max => solve::largest_grid(gpu.report(), &solvers),
        });
        let options = solve::Options {
            formulations: self.formulation.clone(),
            grids: grids.collect::<Result<_, _>>()?,
            bricks: match self.bricks.is_empty() {
                true => vec![None],
                false => self.bricks.iter().copied().map(Some).collect(),
            },
            against: self.against.clone(),
            largest_factor: self.largest_factor * GIB,
            solvers,
        };
        let measure = |options: &solve::Options, settings: &Settings, listener: Listener| {
            solve::measure(&gpu, options, settings, listener)
        };
        let repeats = Some(&self.repeats);
        self.output.run("solve", repeats, &options, measure)
    }
}
