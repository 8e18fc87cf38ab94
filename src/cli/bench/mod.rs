//! `cutwater bench`: options of each bench, shared ones once; rows to lines of the terminal.

mod solve;
mod step;

use std::path::PathBuf;

use crate::Error;
use crate::gpu::Gpu;
use crate::measure::bench::{Event, Listener, Results, Settings, accuracy, device, effects, stability};
use crate::scene::{Precision, Preconditioner, Scene};
use clap::builder::{PossibleValuesParser, RangedU64ValueParser, TypedValueParser};
use clap::{Args, Subcommand};

use super::{AdapterArgs, BackendArgs, Overrides, SMALLER_SCENE, without_backend};

/// Measure the solves, the whole step, or the adapter
#[derive(Debug, Args)]
pub(super) struct Bench {
    #[command(subcommand)]
    name: Name,
}

#[derive(Debug, Subcommand)]
enum Name {
    /// The solve against the grid, on the base block and, with a beam, on the base scene: solve.csv, solve_growth.csv, solve_against.csv,
    /// solve.json, solve.svg
    Solve(solve::Solve),
    /// Error against time by precision, preconditioner, form and tolerance, on states of scenes and on known problems: accuracy.csv,
    /// accuracy_best.csv, accuracy_grids.csv, accuracy_grids_best.csv, accuracy_grids_enough.csv, accuracy.json, accuracy.svg,
    /// accuracy_grids.svg
    Accuracy(Accuracy),
    /// Cost of each effect of a scene per sub-step: effects.csv, effects.json, effects.svg
    Effects(Effects),
    /// Whole sub-steps of scenes, stage by stage: step.csv, step_stages.csv, step_growth.csv, step.json, step.svg
    Step(step::Step),
    /// Hostile scenes and the thesis's section 6.3: stability.csv, stability.json, stability.svg
    Stability(Stability),
    /// Rates and latencies of the adapter - bandwidth, arithmetic, launches, waits: device.csv, device.json
    Device(Device),
}

/// Options of all benches.
#[derive(Debug, Args)]
struct Output {
    /// Folder of the results; out/bench_NAME by default
    #[arg(long)]
    out: Option<PathBuf>,
    /// Keep finished rows of an earlier run with the same options on this machine, and measure the others
    #[arg(long)]
    resume: bool,
}

/// Options of benches that repeat.
#[derive(Debug, Args)]
struct Repeats {
    /// Timed runs per row
    #[arg(long, default_value_t = 5, value_parser = at_least_once())]
    repeats: usize,
    /// Do not repeat a row once its runs took so many seconds
    #[arg(long, default_value_t = 20.0)]
    seconds: f64,
}

impl Output {
    /// Runs a bench and prints its rows, derived tables and failures.
    fn run<O>(
        &self,
        name: &str,
        repeats: Option<&Repeats>,
        options: &O,
        measure: impl FnOnce(&O, &Settings, Listener) -> Result<Results, Error>,
    ) -> Result<(), Error> {
        let out = self.out.clone().unwrap_or_else(|| format!("out/bench_{name}").into());
        let settings = Settings {
            out: out.clone(),
            repeats: repeats.map_or(1, |repeats| repeats.repeats),
            seconds: repeats.map_or(0.0, |repeats| repeats.seconds),
            resume: self.resume,
        };
        let mut last = "";
        let results = measure(options, &settings, &mut |event| match event {
            Event::Row(table, row) => {
                if std::mem::replace(&mut last, table.name) != table.name {
                    say!("{}", table.heading());
                }
                say!("{}", table.line(row));
            }
            Event::Progress(text) => warn!("{text}"),
        })?;
        let derived = results.tables.iter().filter(|table| table.key.is_empty());
        for table in derived.filter(|table| !table.rows.is_empty()) {
            say!("{}.csv\n{}", table.name, table.heading());
            table.rows.iter().for_each(|row| say!("{}", table.line(row)));
        }
        if let (Some(adapter), Some(copy)) = (&results.machine.adapter, results.machine.copy_bandwidth) {
            say!("adapter: {adapter}, copy bandwidth {:.1} GB/s", 1e-9 * copy.median);
        }
        say!("results: {}", out.display());
        results.verdict()
    }
}

impl Bench {
    pub(super) fn run(&self) -> Result<(), Error> {
        let (done, smaller) = match &self.name {
            Name::Solve(solve) => (solve.run(), "smaller grids (--grids)"),
            Name::Accuracy(accuracy) => {
                (accuracy.run(), "fewer cells (--scale, --grids) or coarser meshes of the solids")
            }
            Name::Effects(effects) => (effects.run(), SMALLER_SCENE),
            Name::Step(step) => (step.run(), SMALLER_SCENE),
            // The one that has --backend.
            Name::Stability(stability) => return stability.run(),
            Name::Device(device) => (device.run(), "a device with free memory"),
        };
        done.map_err(|error| without_backend(error, smaller))
    }
}

/// Parser of a count of at least 1.
fn at_least_once() -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(1..)
}

/// Parser of a name.
fn named<T: Copy + Send + Sync + 'static>(names: &'static [(&'static str, T)]) -> impl TypedValueParser<Value = T> {
    let parser = PossibleValuesParser::new(names.iter().map(|(name, _)| *name));
    parser.map(move |text| {
        let known = names.iter().find(|(name, _)| *name == text);
        known.expect("the parser knows the names").1
    })
}

const PRECONDITIONERS: &[(&str, Preconditioner)] = &[
    ("multigrid", Preconditioner::Multigrid),
    ("jacobi", Preconditioner::Jacobi),
    ("block-jacobi", Preconditioner::BlockJacobi),
];

/// A number, or the largest with room.
#[derive(Clone, Copy, Debug)]
enum OrMax<T> {
    Number(T),
    Max,
}

impl<T: std::str::FromStr> std::str::FromStr for OrMax<T> {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<OrMax<T>, Self::Err> {
        match text {
            "max" => Ok(OrMax::Max),
            _ => text.parse().map(OrMax::Number).map_err(|_| "give numbers, or max"),
        }
    }
}

fn check_tolerance(tolerance: f64) -> Result<(), Error> {
    if tolerance > 0.0 && tolerance < 1.0 {
        return Ok(());
    }
    Err(Error::input(
        format!("--tolerance {tolerance}"),
        "no residual can meet it",
        "give a number above 0 and below 1, such as 1e-8",
    ))
}

fn load(files: &[PathBuf], overrides: &[String], scale: f64) -> Result<Vec<Scene>, Error> {
    files.iter().map(|file| Scene::load(file, overrides, scale)).collect()
}

#[derive(Debug, Args)]
struct Device {
    #[command(flatten)]
    repeats: Repeats,
    #[command(flatten)]
    output: Output,
    #[command(flatten)]
    adapter: AdapterArgs,
}

impl Device {
    fn run(&self) -> Result<(), Error> {
        let gpu = Gpu::new(&self.adapter.choice())?;
        let repeats = Some(&self.repeats);
        self.output.run("device", repeats, &gpu, device::measure)
    }
}

#[derive(Debug, Args)]
struct Effects {
    /// Scene files (TOML)
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// Multiply domain.cells, rounded
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    #[command(flatten)]
    overrides: Overrides,
    /// Frames of each scene; a pair of sub-steps with and without each effect after each of them
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u64).range(1..))]
    frames: u64,
    #[command(flatten)]
    output: Output,
    #[command(flatten)]
    adapter: AdapterArgs,
}

impl Effects {
    fn run(&self) -> Result<(), Error> {
        let options = effects::Options {
            scenes: load(&self.scenes, &self.overrides.all(), self.scale)?,
            frames: self.frames,
            adapter: self.adapter.choice(),
        };
        self.output.run("effects", None, &options, effects::measure)
    }
}

#[derive(Debug, Args)]
struct Stability {
    /// Sub-steps of each hostile scene
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u64).range(1..))]
    steps: u64,
    /// Parts of names: other cases are left out; each has to be in one
    #[arg(long, value_delimiter = ',', value_name = "PART,..")]
    cases: Vec<String>,
    /// Multiply the cells of the thesis's scene, rounded
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    #[command(flatten)]
    output: Output,
    #[command(flatten)]
    backend: BackendArgs,
}

impl Stability {
    fn run(&self) -> Result<(), Error> {
        let options = stability::Options {
            steps: self.steps,
            cases: self.cases.clone(),
            scale: self.scale,
            backend: self.backend.backend(),
        };
        let measure = stability::measure;
        self.output.run("stability", None, &options, measure)
    }
}

#[derive(Debug, Args)]
struct Accuracy {
    /// Scene files (TOML)
    #[arg(required_unless_present = "grids")]
    scenes: Vec<PathBuf>,
    /// Multiply domain.cells, rounded
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    #[command(flatten)]
    overrides: Overrides,
    /// Frames whose states are solved from
    #[arg(long, value_delimiter = ',', value_name = "N,N,..", default_value = "10")]
    frames: Vec<u64>,
    /// Also solve known problems with so many cells along 1 m, multiples of 10
    #[arg(long, value_delimiter = ',', value_name = "N,N,..")]
    grids: Vec<usize>,
    /// Precisions to measure
    #[arg(long, value_parser = named(Precision::NAMES), value_delimiter = ',', value_name = "P,..", default_value = "f32,mixed,f64")]
    precision: Vec<Precision>,
    /// Preconditioners to measure
    #[arg(long, value_parser = named(PRECONDITIONERS), value_delimiter = ',', value_name = "P,..", default_value = "multigrid")]
    preconditioner: Vec<Preconditioner>,
    /// Relative tolerances of the true residuals
    #[arg(long, value_delimiter = ',', value_name = "X,X,..", default_value = "1e-2,1e-4,1e-6,1e-8,1e-10,1e-12")]
    tolerance: Vec<f64>,
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

impl Accuracy {
    fn run(&self) -> Result<(), Error> {
        self.tolerance.iter().copied().try_for_each(check_tolerance)?;
        let options = accuracy::Options {
            scenes: load(&self.scenes, &self.overrides.all(), self.scale)?,
            frames: self.frames.clone(),
            grids: self.grids.clone(),
            precisions: self.precision.clone(),
            preconditioners: self.preconditioner.clone(),
            tolerances: self.tolerance.clone(),
            max_iterations: self.max_iterations,
            adapter: self.adapter.choice(),
        };
        let (repeats, measure) = (Some(&self.repeats), accuracy::measure);
        self.output.run("accuracy", repeats, &options, measure)
    }
}
