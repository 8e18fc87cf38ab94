//! `cutwater bench solids`

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use cutwater::Error;
use cutwater::measure::bench_solids;
use cutwater::scene::Solver;

use super::{PrecisionName, at_least_once, check_tolerance, tell_machine};
use crate::cli::AdapterArgs;

#[derive(Debug, Args)]
pub(super) struct Solids {
    /// Nodes of the bodies, about
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "N,N,..",
        default_value = "1000,10000,100000"
    )]
    nodes: Vec<usize>,
    /// Bodies to measure
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        value_name = "B,..",
        default_value = "beam"
    )]
    body: Vec<BodyName>,
    /// Young's modulus, Pa
    #[arg(long, default_value_t = 2e5)]
    young: f64,
    /// Density, kg/m^3
    #[arg(long, default_value_t = 1000.0)]
    density: f64,
    /// Length of the sub-steps, s
    #[arg(long, default_value_t = 1.0 / 120.0)]
    step: f64,
    /// Timed solves per row
    #[arg(long, default_value_t = 5, value_parser = at_least_once())]
    repeats: usize,
    /// Relative tolerance of the true residual
    #[arg(long, default_value_t = 1e-8)]
    tolerance: f64,
    /// PCG iterations in all rounds
    #[arg(long, default_value_t = 5000)]
    max_iterations: u32,
    /// Precision to measure
    #[arg(long, value_enum, default_value_t = PrecisionName::Mixed)]
    precision: PrecisionName,
    /// Factors of more GiB are not computed
    #[arg(long, value_name = "GIB", default_value_t = 4.0)]
    largest_factor: f64,
    /// Folder of the results
    #[arg(long, default_value = "out/bench_solids")]
    out: PathBuf,
    #[command(flatten)]
    adapter: AdapterArgs,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum BodyName {
    Beam,
    Block,
}

/// Nodes of the bodies: a solid of more does not fit into the memory of most hosts.
const NODES: std::ops::RangeInclusive<usize> = 8..=1 << 22;

impl Solids {
    pub(super) fn run(&self) -> Result<(), Error> {
        if let Some(&nodes) = self.nodes.iter().find(|n| !NODES.contains(n)) {
            return Err(Error::input(
                format!("--nodes {nodes}"),
                "too few or too many nodes for a body",
                "give 8 to 4194304 nodes",
            ));
        }
        for (key, number, example) in [
            ("young", self.young, "1e6"),
            ("density", self.density, "1000"),
            ("step", self.step, "0.01"),
            ("largest-factor", self.largest_factor, "4"),
        ] {
            if !(number > 0.0 && number.is_finite()) {
                return Err(Error::input(
                    format!("--{key} {number}"),
                    "not a number above 0",
                    format!("give one, such as {example}"),
                ));
            }
        }
        check_tolerance(self.tolerance)?;
        let options = bench_solids::Options {
            bodies: self
                .body
                .iter()
                .map(|body| match body {
                    BodyName::Beam => bench_solids::Body::Beam,
                    BodyName::Block => bench_solids::Body::Block,
                })
                .collect(),
            nodes: self.nodes.clone(),
            young: self.young,
            density: self.density,
            step: self.step,
            repeats: self.repeats,
            largest_factor: self.largest_factor * (1u64 << 30) as f64,
            solver: Solver {
                tolerance: self.tolerance,
                max_iterations: self.max_iterations,
                precision: self.precision.precision(),
                ..Solver::default()
            },
            adapter: self.adapter.choice(),
        };
        say!(
            "body    nodes  unknowns  iterations x degree  seconds (least, largest)  residual  of copy bandwidth  Cholesky: order, factor, solve  ratio"
        );
        let table = bench_solids::bench_solids(&options, &self.out, &mut |row| {
            let factor = match (row.factor_seconds, row.substitution_seconds, row.ratio) {
                (Some(factor), Some(solve), Some(ratio)) => {
                    format!("{factor:.3}, {solve:.3}  {ratio:.2}")
                }
                _ => format!(
                    "left out, {:.1} GiB",
                    row.factor_bytes / (1u64 << 30) as f64
                ),
            };
            say!(
                "{:5} {:7}  {:8}  {:10} x {:6}  {:.4} ({:.4}, {:.4})  {:.1e} {}  {:.0} %  {:.3}, {factor}",
                row.body,
                row.nodes,
                row.unknowns,
                row.iterations,
                row.degree,
                row.seconds_median,
                row.seconds_min,
                row.seconds_max,
                row.residual,
                row.status,
                100.0 * row.share_of_copy_bandwidth,
                row.ordering_seconds,
            );
        })?;
        tell_machine(&table.machine);
        say!("table and picture: {}", self.out.display());
        Ok(())
    }
}
