//! `cutwater bench accuracy`

use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use cutwater::Error;
use cutwater::measure::bench_accuracy::{GridRow, Heard, Options, Row, bench_accuracy};
use cutwater::scene::{Formulation, Scene};

use super::{PrecisionName, PreconditionerName, at_least_once, check_tolerance, tell_machine};
use crate::cli::AdapterArgs;

/// Between two lines about progress.
const PAUSE: Duration = Duration::from_secs(5);

#[derive(Debug, Args)]
pub(super) struct Accuracy {
    /// Scene files (TOML)
    #[arg(required_unless_present = "grids")]
    scenes: Vec<PathBuf>,
    /// Multiply domain.cells, rounded
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    /// Override a key of every scene; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// Frames whose states are solved from
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "N,N,..",
        default_value = "10"
    )]
    frames: Vec<u64>,
    /// Also solve problems that are known exactly with so many cells along 1 m, multiples of 10
    #[arg(long, value_delimiter = ',', value_name = "N,N,..")]
    grids: Vec<usize>,
    /// Precisions to measure
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        value_name = "P,..",
        default_value = "f32,mixed,f64"
    )]
    precision: Vec<PrecisionName>,
    /// Preconditioners to measure
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        value_name = "P,..",
        default_value = "multigrid"
    )]
    preconditioner: Vec<PreconditionerName>,
    /// Relative tolerances of the true residuals
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "X,X,..",
        default_value = "1e-2,1e-4,1e-6,1e-8,1e-10,1e-12"
    )]
    tolerance: Vec<f64>,
    /// PCG iterations in all rounds
    #[arg(long, default_value_t = 5000)]
    max_iterations: u32,
    /// Timed runs per row, at most
    #[arg(long, default_value_t = 5, value_parser = at_least_once())]
    repeats: usize,
    /// Begin no more repeats of a state or a problem once it has been timed for so many seconds
    #[arg(long, default_value_t = 40.0)]
    seconds: f64,
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
        let mut grids = self.grids.clone();
        grids.sort_unstable();
        let options = Options {
            scenes: self.scenes.iter().map(load).collect::<Result<_, _>>()?,
            frames,
            grids,
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
            seconds: self.seconds,
            adapter: self.adapter.choice(),
        };
        let head =
            "precision preconditioner formulation tolerance  iterations  seconds (least, largest)";
        if !options.scenes.is_empty() {
            say!("scene            frame  {head}  error of p, of v");
        }
        let mut last = Instant::now();
        let table = bench_accuracy(&options, &self.out, &mut |heard| match heard {
            Heard::Progress(progress) => {
                if last.elapsed() >= PAUSE {
                    last = Instant::now();
                    warn!(
                        "{}: {} of {} {}, {:.0} s left",
                        progress.on,
                        progress.done,
                        progress.of,
                        progress.work,
                        progress.seconds_left()
                    );
                }
            }
            Heard::First(row) => {
                tell_state(row);
                say!("  the first solve, by itself; the rows follow");
            }
            Heard::State(row) => tell_state(row),
            Heard::Grid(row) => tell_grid(row),
        })?;
        if !table.best.is_empty() {
            say!("the cheapest with both errors below");
        }
        for best in &table.best {
            say!(
                "{:16} {:5}  {:5.0e}: {}, {}, {}, tolerance {:.0e}: {:.4} ({:.4}, {:.4}) s in {} iterations",
                best.scene,
                best.frame,
                best.target,
                best.precision,
                best.preconditioner,
                best.formulation,
                best.tolerance,
                best.seconds_median,
                best.seconds_min,
                best.seconds_max,
                best.iterations,
            );
        }
        if !table.grids_best.is_empty() {
            say!("the cheapest grid, precision and tolerance with errors below");
        }
        for best in &table.grids_best {
            say!(
                "{:13} {:5.0e}: {} cells along 1 m, {}, tolerance {:.0e}: {:.4} ({:.4}, {:.4}) s",
                best.problem,
                best.target,
                best.grid,
                best.precision,
                best.tolerance,
                best.seconds_median,
                best.seconds_min,
                best.seconds_max,
            );
        }
        tell_machine(&table.machine);
        say!("tables and picture: {}", self.out.display());
        Ok(())
    }
}

fn tell_state(row: &Row) {
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
}

fn tell_grid(row: &GridRow) {
    let speed = row
        .error_u
        .map_or(String::new(), |u| format!(", of u {u:.1e}"));
    say!(
        "{:13} {:4}  {:5} {:5.0e}  {:4} iterations  {:.4} s ({:.4}, {:.4})  error of p {:.1e} (of the grid {:.1e}){speed} {}",
        row.problem,
        row.grid,
        row.precision,
        row.tolerance,
        row.iterations,
        row.seconds_median,
        row.seconds_min,
        row.seconds_max,
        row.error_p,
        row.grid_error_p,
        row.status,
    );
}
