//! Command line: arguments, one function per command, exit codes. See `cutwater --help`.

#[macro_use]
mod say;

mod adapters;
mod bar;
mod bench;
mod compare;
mod converge;
mod export;
mod mesh;
mod plan;
mod plot;
mod preview;
mod report;
mod run;
mod schema;
mod signals;
mod skin;
mod sweep;

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use crate::Error;
use crate::gpu::AdapterChoice;
use crate::scene::{Scene, without};
use crate::sim::Backend;
use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};

/// Output of `--version`: version and sources, as in captions of tables. `-V` prints the version alone.
const BUILD: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("CUTWATER_SOURCES"), ")");

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
    /// Run a scene with every combination of some settings, in a folder each, and summarise the runs
    Sweep(sweep::SweepCommand),
    /// Run a scene at several scales and estimate the order of convergence and the limit of each probe
    Converge(converge::Converge),
    /// List the effects, stages, kernels and buffers of a scene, and check the limits of the adapter
    Plan(plan::PlanCommand),
    /// List the GPU adapters
    Adapters(adapters::Adapters),
    /// Print the JSON schema of scene files, for completion and checks in editors
    Schema(schema::Schema),
    /// Measure solves, sub-steps, and the costs of accuracy and effects
    Bench(bench::Bench),
    /// Check every stage of the GPU path against the f64 path
    Compare(compare::Compare),
    /// Write the system of a sub-step, of the pressure, the solids or both, for other solvers
    Export(export::Export),
    /// Check a mesh of a solid, or fill a closed surface: counts, volume, worst element
    Mesh(mesh::Mesh),
    /// Draw the frames of a run as pictures and an animation
    Preview(preview::Preview),
    /// Write the solids of a run as surfaces that follow their tetrahedra, and its obstacles, for renderers
    Skin(skin::Skin),
    /// Draw the probes and the step table of runs as charts
    Plot(plot::Plot),
    /// Collect the results of benches and runs in one HTML page
    Report(report::Report),
}

/// A scene with its overrides.
#[derive(Debug, Args)]
struct SceneArgs {
    /// Scene file (TOML)
    scene: PathBuf,
    /// Multiply domain.cells, rounded
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    #[command(flatten)]
    overrides: Overrides,
}

impl SceneArgs {
    fn load(&self) -> Result<Scene, Error> {
        Scene::load(&self.scene, &self.overrides.all(), self.scale)
    }
}

/// Changes of a scene.
#[derive(Debug, Args)]
struct Overrides {
    /// Override a key of the scene, such as liquid.region[0].velocity=[1,0,0]; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Remove a key of the scene and what refers to it, such as liquid, solid[0], solid.NAME or obstacle[1]; may be repeated
    #[arg(long = "without", value_name = "KEY")]
    without: Vec<String>,
}

impl Overrides {
    /// The overrides of the library.
    fn all(&self) -> Vec<String> {
        let removals = self.without.iter().map(|key| without(key));
        self.set.iter().cloned().chain(removals).collect()
    }
}

/// Refuses a path that is not the folder of a run; `command` is the command that reads it.
fn ensure_run(path: &Path, command: &str) -> Result<(), Error> {
    let refuse = |problem: &str, cure: String| {
        let what = path.display().to_string();
        Err(Error::input(what, problem, cure))
    };
    let is_scene = path.extension().is_some_and(|kind| kind == "toml");
    if is_scene && path.is_file() {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let cure = format!("run it first: cutwater run {}; then cutwater {command} out/{name}", path.display());
        return refuse("is a scene, not the folder of a run", cure);
    }
    if path.is_file() {
        let cure = match path.parent() {
            Some(run) if run.join("manifest.json").is_file() => {
                format!("give its folder: {}", run.display())
            }
            _ => "give the folder that `cutwater run --out` wrote".to_owned(),
        };
        return refuse("is a file, not the folder of a run", cure);
    }
    if path.is_dir() && !path.join("manifest.json").is_file() {
        let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
        let folders = entries.map(|entry| entry.path());
        let mut runs: Vec<_> = folders.filter(|folder| folder.join("manifest.json").is_file()).collect();
        runs.sort();
        if let Some(run) = runs.first() {
            let cure = format!("give the folder of a run, such as {}", run.display());
            return refuse("contains runs, but is not one itself", cure);
        }
    }
    Ok(())
}

#[derive(Clone, Debug, Args)]
struct BackendArgs {
    /// gpu, or cpu for the f64 path
    #[arg(long, value_enum, default_value = "gpu")]
    backend: BackendName,
    #[command(flatten)]
    adapter: AdapterArgs,
}

#[derive(Clone, Debug, Args)]
struct AdapterArgs {
    /// Adapter by index, kind (discrete, integrated, virtual, software) or part of its name; the best by default
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
}

impl AdapterArgs {
    fn choice(&self) -> AdapterChoice {
        self.adapter.as_deref().map_or(AdapterChoice::Best, |name| {
            name.parse().unwrap_or_else(|never: std::convert::Infallible| match never {})
        })
    }
}

/// Cure for a scene beyond the limits of an adapter.
const SMALLER_SCENE: &str = "fewer cells (--scale) or coarser meshes of the solids";

/// Replaces a cure that names `--backend`, for commands without that option; `smaller` is the cure for too large a problem.
fn without_backend(mut error: Error, smaller: &str) -> Error {
    if let Error::Limit { available, cure, .. } = &mut error
        && cure.ends_with(", or --backend cpu")
    {
        let other = match *available {
            // A limit of zero is a missing feature: f64.
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

/// Parses `-1` after an option as its value, so that the error names the number rather than an unknown option.
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

/// Parses the arguments, runs the command and prints its error, or that of an unprintable line. Returns the exit code; `--help` and
/// unknown arguments end the process.
///
/// `arguments` begin with the name of the program. `program`: the command that starts this command line in another process, for the runs
/// of a sweep; `None` for the executable of this process.
pub fn main(arguments: impl IntoIterator<Item = OsString>, program: Option<&[OsString]>) -> u8 {
    signals::survive_file_size_limit();
    say::record_terminal();
    let arguments = with_negative_numbers(Cli::command()).get_matches_from(arguments);
    let cli = Cli::from_arg_matches(&arguments).unwrap_or_else(|problem| problem.exit());
    let done = match &cli.command {
        Command::Run(command) => command.run(),
        Command::Sweep(command) => command.run(program),
        Command::Converge(command) => command.run(program),
        Command::Plan(command) => command.run(),
        Command::Adapters(command) => command.run(),
        Command::Schema(command) => command.run(),
        Command::Bench(command) => command.run(),
        Command::Compare(command) => command.run(),
        Command::Export(command) => command.run(),
        Command::Mesh(command) => command.run(),
        Command::Preview(command) => command.run(),
        Command::Skin(command) => command.run(),
        Command::Plot(command) => command.run(),
        Command::Report(command) => command.run(),
    };
    match done.and_then(|()| say::ensure_printed()) {
        Ok(()) => 0,
        Err(error) => {
            warn!("error: {error}");
            error.exit_code()
        }
    }
}
