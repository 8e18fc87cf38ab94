//! Arguments to one function per command; errors to exit codes.

#[macro_use]
mod say;

mod adapters;
mod bench;
mod compare;
mod export;
mod mesh;
mod plan;
mod plot;
mod preview;
mod report;
mod run;
mod schema;
mod signals;
mod sweep;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use cutwater::Error;
use cutwater::gpu::AdapterChoice;
use cutwater::scene::Scene;
use cutwater::sim::Backend;

/// What `--version` says: version and sources, as captions of tables have them. `-V` says the version alone.
const BUILD: &str = concat!(
    env!("CARGO_PKG_VERSION"),
    " (",
    env!("CUTWATER_SOURCES"),
    ")"
);

/// Two-way coupling between inviscid free-surface liquids and elastic solids, on the GPU, without a window.
#[derive(Debug, Parser)]
#[command(version, long_version = BUILD, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Simulate a scene and write its frames and tables
    Run(run::Run),
    /// Run a scene with every combination of some settings, a folder each, and tell how all of them went
    Sweep(sweep::SweepCommand),
    /// Say what a scene takes: effects, stages, kernels, buffers, and whether the adapter has room
    Plan(plan::PlanCommand),
    /// List the GPU adapters
    Adapters(adapters::Adapters),
    /// Print the JSON schema of scene files, from which editors complete and check
    Schema(schema::Schema),
    /// Measure solves, whole steps, what accuracy and effects cost
    Bench(bench::Bench),
    /// Check every stage of the GPU path against the f64 path
    Compare(compare::Compare),
    /// Write the system of a sub-step, of the pressure, the solids or both, for other solvers
    Export(export::Export),
    /// Check a mesh of a solid, or fill a closed surface: counts, volume, worst element
    Mesh(mesh::Mesh),
    /// Draw the frames of a run as pictures and an animation
    Preview(preview::Preview),
    /// Draw the probes and the step table of runs as charts
    Plot(plot::Plot),
    /// Gather what benches and runs wrote into one HTML page
    Report(report::Report),
}

/// A scene and how it is changed.
#[derive(Debug, Args)]
struct SceneArgs {
    /// Scene file (TOML)
    scene: PathBuf,
    /// Multiply domain.cells, rounded
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    /// Override a key of the scene, such as liquid.region[0].velocity=[1,0,0]; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
}

impl SceneArgs {
    fn load(&self) -> Result<Scene, Error> {
        Scene::load(&self.scene, &self.overrides, self.scale)
    }
}

/// Where to run.
#[derive(Debug, Args)]
struct BackendArgs {
    /// gpu, or cpu for the f64 path
    #[arg(long, value_enum, default_value = "gpu")]
    backend: BackendName,
    #[command(flatten)]
    adapter: AdapterArgs,
}

/// Which adapter.
#[derive(Debug, Args)]
struct AdapterArgs {
    /// Adapter by index, kind (discrete, integrated, virtual, software) or part of its name; the best by default
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
}

impl AdapterArgs {
    fn choice(&self) -> AdapterChoice {
        self.adapter.as_deref().map_or(AdapterChoice::Best, |name| {
            name.parse()
                .unwrap_or_else(|never: std::convert::Infallible| match never {})
        })
    }
}

/// What takes less of an adapter, of commands that simulate a scene.
const SMALLER_SCENE: &str = "fewer cells (--scale) or coarser meshes of the solids";

/// The error of a command that has no `--backend`: a cure that names it gives way to one that the command has; `smaller`: what takes less
/// of the adapter.
fn without_backend(mut error: Error, smaller: &str) -> Error {
    if let Error::Limit {
        available, cure, ..
    } = &mut error
        && cure.ends_with(", or --backend cpu")
    {
        let other = match *available {
            // What is missing altogether is a feature: 64-bit floats.
            0 => "precision mixed, which reaches the same tolerance",
            _ => smaller,
        };
        *cure = format!("use {other}, or another adapter (--adapter)");
    }
    error
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum BackendName {
    Gpu,
    Cpu,
}

impl BackendArgs {
    fn backend(&self) -> Backend {
        match self.backend {
            BackendName::Gpu => Backend::Gpu(self.adapter.choice()),
            BackendName::Cpu => Backend::Cpu,
        }
    }
}

/// Takes `-1` after an option for its value and not for another option, so that what is wrong with the number is told.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    command
        .mut_args(|arg| {
            let with_value = !arg.is_positional() && arg.get_action().takes_values();
            match with_value {
                true => arg.allow_negative_numbers(true),
                false => arg,
            }
        })
        .mut_subcommands(with_negative_numbers)
}

/// Parses the arguments, runs the command, prints its error; where it has none, that of a line that could not be printed.
pub(crate) fn main() -> ExitCode {
    signals::survive_file_size_limit();
    say::note_terminal();
    let arguments = with_negative_numbers(Cli::command()).get_matches();
    let cli = Cli::from_arg_matches(&arguments).unwrap_or_else(|problem| problem.exit());
    let done = match &cli.command {
        Command::Run(command) => command.run(),
        Command::Sweep(command) => command.run(),
        Command::Plan(command) => command.run(),
        Command::Adapters(command) => command.run(),
        Command::Schema(command) => command.run(),
        Command::Bench(command) => command.run(),
        Command::Compare(command) => command.run(),
        Command::Export(command) => command.run(),
        Command::Mesh(command) => command.run(),
        Command::Preview(command) => command.run(),
        Command::Plot(command) => command.run(),
        Command::Report(command) => command.run(),
    };
    match done.and_then(|()| say::ensure_said()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            warn!("error: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}
