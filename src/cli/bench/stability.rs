//! `cutwater bench stability`

use std::path::PathBuf;

use clap::Args;
use cutwater::Error;
use cutwater::measure::bench_stability::{Options, Told, bench_stability};

use crate::cli::BackendArgs;

#[derive(Debug, Args)]
pub(super) struct Stability {
    /// Sub-steps of each hostile scene
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u64).range(1..))]
    steps: u64,
    /// Parts of names: other cases are left out; each has to be in one
    #[arg(long, value_delimiter = ',', value_name = "PART,..")]
    cases: Vec<String>,
    /// Multiply the cells of the thesis's scene, rounded
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    /// Folder of the results
    #[arg(long, default_value = "out/bench_stability")]
    out: PathBuf,
    #[command(flatten)]
    backend: BackendArgs,
}

impl Stability {
    pub(super) fn run(&self) -> Result<(), Error> {
        let options = Options {
            steps: self.steps,
            cases: self.cases.clone(),
            scale: self.scale,
            backend: self.backend.backend(),
        };
        let verdict = |passed: bool| if passed { "ok  " } else { "FAIL" };
        let table = bench_stability(&options, &self.out, &mut |told| match told {
            Told::Case(row) => say!(
                "{} {:24} sub-steps {:5}, energy {:.3} (to {:.2}; at the end {:.3}, elastic {:.3}), motion {:.3} J (to {:.3}), nodes {:.2} m/s (to {:.2}), liquid {:.2} m/s (to {:.2}), volume {:.3} to {:.3}, lost {:.4}, least det F {:.3}, inverted {}, missed {}, not settled {}, iterations {}, {:.1} s: {}",
                verdict(row.passed),
                row.name,
                row.sub_steps,
                row.energy_ratio,
                row.energy_bound,
                row.energy_end,
                row.elastic_ratio,
                row.motion,
                row.motion_bound,
                row.solid_speed,
                row.solid_speed_bound,
                row.liquid_speed,
                row.liquid_speed_bound,
                row.volume_least,
                row.volume_most,
                row.lost,
                row.min_det,
                row.inverted,
                row.missed,
                row.unsettled,
                row.most_iterations
                    .map_or("none".to_owned(), |most| most.to_string()),
                row.seconds,
                row.status,
            ),
            Told::Limit(row) => say!(
                "{} {:32} m_a/m_s = {:.4}: grows by {:.4} a sub-step, expected {:.4}",
                verdict(row.passed),
                row.name,
                row.ratio,
                row.got,
                row.expected,
            ),
        })?;
        say!("tables and picture: {}", self.out.display());
        table.verdict()
    }
}
