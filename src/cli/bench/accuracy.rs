//! `cutwater bench accuracy`

use std::path::PathBuf;

use clap::Args;
use cutwater::Error;
use cutwater::measure::bench_accuracy::{Options, bench_accuracy};
use cutwater::scene::{Formulation, Scene};

use super::{PrecisionName, PreconditionerName, check_tolerance, tell_machine};
use crate::cli::AdapterArgs;

#[derive(Debug, Args)]
pub(super) struct Accuracy {
    /// Scene files (TOML)
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// Multiply domain.cells, rounded
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    /// Override a key of every scene; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// Frames whose states are solved from
    #[arg(long, value_delimiter = ',', default_values_t = [10])]
    frames: Vec<u64>,
    /// Precisions to measure
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [PrecisionName::F32, PrecisionName::Mixed, PrecisionName::F64])]
    precision: Vec<PrecisionName>,
    /// Preconditioners to measure
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [PreconditionerName::Multigrid, PreconditionerName::Jacobi])]
    preconditioner: Vec<PreconditionerName>,
    /// Relative tolerances of the true residuals
    #[arg(long, value_delimiter = ',', default_values_t = [1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12])]
    tolerance: Vec<f64>,
    /// PCG iterations in all rounds
    #[arg(long, default_value_t = 5000)]
    max_iterations: u32,
    /// Timed runs per row
    #[arg(long, default_value_t = 5)]
    repeats: usize,
    /// Folder of the results
    #[arg(long, default_value = "out/bench_accuracy")]
    out: PathBuf,
    #[command(flatten)]
    adapter: AdapterArgs,
}

impl Accuracy {
    pub(super) fn run(&self) -> Result<(), Error> {
        for &tolerance in &self.tolerance {
            check_tolerance(tolerance)?;
        }
        let load = |path: &PathBuf| Scene::load(path, &self.overrides, self.scale);
        let mut frames = self.frames.clone();
        frames.sort_unstable();
        let options = Options {
            scenes: self.scenes.iter().map(load).collect::<Result<_, _>>()?,
            frames,
            precisions: self.precision.iter().map(|name| name.precision()).collect(),
            preconditioners: self
                .preconditioner
                .iter()
                .map(|name| name.preconditioner())
                .collect(),
            formulations: vec![Formulation::Condensed, Formulation::TwoField],
            tolerances: self.tolerance.clone(),
            max_iterations: self.max_iterations,
            repeats: self.repeats,
            adapter: self.adapter.choice(),
        };
        say!(
            "scene            frame  precision preconditioner formulation tolerance  iterations  seconds (least, largest)  error of p, of v"
        );
        let table = bench_accuracy(&options, &self.out, &mut |row| {
            say!(
                "{:16} {:5}  {:9} {:14} {:11} {:9.0e}  {:10}  {:.4} ({:.4}, {:.4})  {:.1e} {:.1e} {}",
                row.scene,
                row.frame,
                row.precision,
                row.preconditioner,
                row.formulation,
                row.tolerance,
                row.iterations,
                row.seconds_median,
                row.seconds_min,
                row.seconds_max,
                row.error_p,
                row.error_v,
                row.status,
            );
        })?;
        say!("the cheapest with both errors below");
        for best in &table.best {
            say!(
                "{:16} {:5}  {:5.0e}: {}, {}, {}, tolerance {:.0e}: {:.4} s in {} iterations",
                best.scene,
                best.frame,
                best.target,
                best.precision,
                best.preconditioner,
                best.formulation,
                best.tolerance,
                best.seconds_median,
                best.iterations,
            );
        }
        tell_machine(&table.machine);
        say!("tables and picture: {}", self.out.display());
        Ok(())
    }
}
