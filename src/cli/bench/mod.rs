//! `cutwater bench`

mod accuracy;
mod device;
mod effects;
mod solids;
mod solve;
mod stability;
mod step;
mod thesis;

use clap::builder::RangedU64ValueParser;
use clap::{Args, Subcommand, ValueEnum};
use cutwater::Error;
use cutwater::measure::table::Machine;
use cutwater::scene::{Precision, Preconditioner};

use super::{SMALLER_SCENE, without_backend};
use accuracy::Accuracy;
use device::Device;
use effects::Effects;
use solids::Solids;
use solve::Solve;
use stability::Stability;
use step::Step;
use thesis::Thesis;

/// Measure the solves, the whole step, or the adapter; or the thesis's tables
#[derive(Debug, Args)]
pub(super) struct Bench {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// The solve against the grid, on the base block and, with a beam, on the base scene: solve.csv, solve_growth.csv, solve_against.csv,
    /// solve.json, solve.svg
    Solve(Solve),
    /// The solve of elastic solids against their size, and against sparse Cholesky: solids.csv, solids.json, solids.svg
    Solids(Solids),
    /// What accuracy costs in time: errors against seconds, by precision, preconditioner, form and tolerance, on states of scenes:
    /// accuracy.csv, accuracy_best.csv, accuracy_grids.csv, accuracy_grids_best.csv, accuracy_grids_enough.csv, accuracy.json, accuracy.svg,
    /// accuracy_grids.svg
    Accuracy(Accuracy),
    /// What each effect of a scene adds to a sub-step, in time, bytes and dispatches, and each output to a frame: effects.csv, outputs.csv,
    /// effects.json, outputs.json, effects.svg
    Effects(Effects),
    /// Whole sub-steps of scenes, stage by stage: step.csv, step_stages.csv, step_growth.csv, step.json, step.svg
    Step(Step),
    /// What stays stable: hostile scenes, the thesis's section 6.3, the limit of weak coupling: stability.csv, stability_limit.csv,
    /// stability.json, stability.svg
    Stability(Stability),
    /// Rates and latencies of the adapter - bandwidth, arithmetic, launches, waits: device.csv, device.json
    Device(Device),
    /// Tables 6.1 to 6.6 of the thesis beside what they are here: thesis_scenes.csv, thesis_systems.csv, thesis_means.csv, thesis_growth.csv, thesis.csv,
    /// thesis_orders.csv, thesis.json, thesis.svg
    Thesis(Thesis),
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum PrecisionName {
    F32,
    Mixed,
    F64,
}

impl PrecisionName {
    fn precision(self) -> Precision {
        match self {
            PrecisionName::F32 => Precision::F32,
            PrecisionName::Mixed => Precision::Mixed,
            PrecisionName::F64 => Precision::F64,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum PreconditionerName {
    Multigrid,
    Jacobi,
    BlockJacobi,
}

impl PreconditionerName {
    fn preconditioner(self) -> Preconditioner {
        match self {
            PreconditionerName::Multigrid => Preconditioner::Multigrid,
            PreconditionerName::Jacobi => Preconditioner::Jacobi,
            PreconditionerName::BlockJacobi => Preconditioner::BlockJacobi,
        }
    }
}

impl Bench {
    pub(super) fn run(&self) -> Result<(), Error> {
        let (done, smaller) = match &self.what {
            What::Solve(solve) => (solve.run(), "smaller grids (--grids)"),
            What::Accuracy(accuracy) => (
                accuracy.run(),
                "fewer cells (--scale, --grids) or coarser meshes of the solids",
            ),
            What::Effects(effects) => (effects.run(), SMALLER_SCENE),
            What::Solids(solids) => (solids.run(), "fewer nodes (--nodes)"),
            What::Step(step) => (step.run(), SMALLER_SCENE),
            // The one that has --backend.
            What::Stability(stability) => return stability.run(),
            What::Device(device) => (device.run(), "a device with free memory"),
            What::Thesis(thesis) => (thesis.run(), "smaller grids (--grids) and scenes (--scale)"),
        };
        done.map_err(|error| without_backend(error, smaller))
    }
}

/// Reads how often something is done.
fn at_least_once() -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(1..)
}

fn tell_machine(machine: &Machine) {
    say!(
        "adapter: {}, copy bandwidth {:.1} GB/s",
        machine.adapter,
        machine.copy_bandwidth.median * 1e-9
    );
}

/// Ends of a range, to stand behind what it is of; nothing where there is none.
fn range([low, high]: [Option<f64>; 2]) -> String {
    low.zip(high).map_or(String::new(), |(low, high)| {
        format!(" ({low:.2} to {high:.2})")
    })
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
