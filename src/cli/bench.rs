//! `cutwater bench`

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use cutwater::Error;
use cutwater::gpu::Gpu;
use cutwater::measure::bench_solids;
use cutwater::measure::bench_solve::{self, Formulation, Options};
use cutwater::measure::bench_sort;
use cutwater::measure::bench_step;
use cutwater::measure::table::Machine;
use cutwater::scene::{Precision, Preconditioner, Scene, Solver};

use super::AdapterArgs;

/// Measure the solves, the whole step, or the sort
#[derive(Debug, Args)]
pub(super) struct Bench {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// The solve against the grid, on the base block and, with a beam, on the base scene: solve.csv, solve.json, solve.svg
    Solve(Solve),
    /// The solve of elastic solids against their size, and against sparse Cholesky: solids.csv, solids.json, solids.svg
    Solids(Solids),
    /// Whole sub-steps of scenes, stage by stage: step.csv, step_stages.csv, step.json, step.svg
    Step(Step),
    /// The sort of keys and values on the device, against the length of the list: sort.csv, sort.json
    Sort(Sort),
}

#[derive(Debug, Args)]
struct Solids {
    /// Nodes of the bodies, about
    #[arg(long, value_delimiter = ',', default_values_t = [1_000, 10_000, 100_000])]
    nodes: Vec<usize>,
    /// Bodies to measure
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [BodyName::Beam])]
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
    #[arg(long, default_value_t = 5)]
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

#[derive(Debug, Args)]
struct Sort {
    /// Entries of the lists
    #[arg(long, value_delimiter = ',', default_values_t = [10_000, 100_000, 1_000_000])]
    entries: Vec<usize>,
    /// Bits of the keys
    #[arg(long, default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=32))]
    bits: u32,
    /// Timed runs per row
    #[arg(long, default_value_t = 5)]
    repeats: usize,
    /// Folder of the results
    #[arg(long, default_value = "out/bench_sort")]
    out: PathBuf,
    #[command(flatten)]
    adapter: AdapterArgs,
}

#[derive(Debug, Args)]
struct Step {
    /// Scene files (TOML)
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// Multiply domain.cells, rounded
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    /// Override a key of every scene; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// Frames of each run
    #[arg(long, default_value_t = 6)]
    frames: u64,
    /// Runs of each scene from its start
    #[arg(long, default_value_t = 3)]
    repeats: usize,
    /// Also run each scene in a domain that many times larger along x, y, z, by turns, and give the ratio of the seconds
    #[arg(long, value_delimiter = ',', num_args = 1, value_name = "X,Y,Z")]
    larger_domain: Vec<usize>,
    /// Folder of the results
    #[arg(long, default_value = "out/bench_step")]
    out: PathBuf,
    #[command(flatten)]
    adapter: AdapterArgs,
}

#[derive(Debug, Args)]
struct Solve {
    /// Cells along an edge of the block
    #[arg(long, value_delimiter = ',', default_values_t = [20, 40, 60, 80])]
    grids: Vec<usize>,
    /// Timed runs per row
    #[arg(long, default_value_t = 5)]
    repeats: usize,
    /// Relative tolerance of the true residual
    #[arg(long, default_value_t = 1e-8)]
    tolerance: f64,
    /// Precisions to measure
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [PrecisionName::Mixed])]
    precision: Vec<PrecisionName>,
    /// Systems to solve: pressures on the base block, or pressures and the velocities of a beam on the base scene
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [FormulationName::Pressure])]
    formulation: Vec<FormulationName>,
    /// Preconditioners of the pressure to measure
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [PreconditionerName::Multigrid])]
    preconditioner: Vec<PreconditionerName>,
    /// PCG iterations in all rounds
    #[arg(long, default_value_t = 5000)]
    max_iterations: u32,
    /// Also write the systems as base_block_N.mtx and base_block_N_rhs.mtx
    #[arg(long)]
    matrices: bool,
    /// Folder of the results
    #[arg(long, default_value = "out/bench_solve")]
    out: PathBuf,
    #[command(flatten)]
    adapter: AdapterArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FormulationName {
    Pressure,
    TwoField,
    Condensed,
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
enum BodyName {
    Beam,
    Block,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum PreconditionerName {
    Multigrid,
    Jacobi,
}

/// Cells along an edge of the base block: 2^30 in all at most, as of a scene.
const GRIDS: std::ops::RangeInclusive<usize> = 2..=1024;
/// Nodes of the bodies: a solid of more does not fit into the memory of most hosts.
const NODES: std::ops::RangeInclusive<usize> = 8..=1 << 22;

impl Bench {
    pub(super) fn run(&self) -> Result<(), Error> {
        match &self.what {
            What::Solve(solve) => solve.run(),
            What::Solids(solids) => solids.run(),
            What::Step(step) => step.run(),
            What::Sort(sort) => sort.run(),
        }
    }
}

fn tell_machine(machine: &Machine) {
    say!(
        "adapter: {}, copy bandwidth {:.1} GB/s",
        machine.adapter,
        machine.copy_bandwidth.median * 1e-9
    );
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

impl Solids {
    fn run(&self) -> Result<(), Error> {
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

impl Sort {
    fn run(&self) -> Result<(), Error> {
        let gpu = Gpu::new(&self.adapter.choice())?;
        let options = bench_sort::Options {
            entries: self.entries.clone(),
            bits: self.bits,
            repeats: self.repeats,
        };
        say!("  entries  bits  ms (least, largest)  of copy bandwidth");
        let table = bench_sort::bench_sort(&gpu, &options, &self.out, &mut |row| {
            say!(
                "{:9}  {:4}  {:.2} ({:.2}, {:.2})  {:.0} %",
                row.entries,
                row.bits,
                1e3 * row.seconds_median,
                1e3 * row.seconds_min,
                1e3 * row.seconds_max,
                100.0 * row.share_of_copy_bandwidth,
            );
        })?;
        tell_machine(&table.machine);
        say!("tables: {}", self.out.display());
        Ok(())
    }
}

impl Step {
    fn run(&self) -> Result<(), Error> {
        let larger_domain = match self.larger_domain[..] {
            [] => None,
            [x, y, z] if x.min(y).min(z) > 0 => Some([x, y, z]),
            _ => {
                return Err(Error::input(
                    format!("--larger-domain {:?}", self.larger_domain),
                    "not three factors",
                    "give whole factors of at least 1 along x, y, z, such as 2,2,2",
                ));
            }
        };
        let load = |path: &PathBuf| Scene::load(path, &self.overrides, self.scale);
        let options = bench_step::Options {
            scenes: self.scenes.iter().map(load).collect::<Result<_, _>>()?,
            frames: self.frames,
            repeats: self.repeats,
            larger_domain,
            adapter: self.adapter.choice(),
        };
        say!(
            "scene                       cells  unknowns   markers     nodes  sub-steps  ms (least, largest)  of copy bandwidth"
        );
        let table = bench_step::bench_step(&options, &self.out, &mut |row| {
            say!(
                "{:24} {:8}  {:8}  {:8}  {:8}  {:9}  {:.2} ({:.2}, {:.2})  {:.0} %",
                row.scene,
                row.cells,
                row.unknowns + row.solid_unknowns,
                row.markers,
                row.nodes,
                row.sub_steps,
                1e3 * row.seconds_median,
                1e3 * row.seconds_min,
                1e3 * row.seconds_max,
                100.0 * row.share_of_copy_bandwidth,
            );
        })?;
        for pair in &table.pairs {
            say!(
                "{}: {:.3} times the seconds in the larger domain ({:.3} for the least)",
                pair.scene,
                pair.ratio,
                pair.ratio_of_least
            );
        }
        tell_machine(&table.machine);
        say!("tables and picture: {}", self.out.display());
        Ok(())
    }
}

impl Solve {
    fn run(&self) -> Result<(), Error> {
        if let Some(&grid) = self.grids.iter().find(|n| !GRIDS.contains(n)) {
            return Err(Error::input(
                format!("--grids {grid}"),
                "too few or too many cells along an edge",
                "give grids of 2 to 1024 cells",
            ));
        }
        check_tolerance(self.tolerance)?;
        let gpu = Gpu::new(&self.adapter.choice())?;
        let mut solvers = Vec::new();
        for precision in &self.precision {
            for preconditioner in &self.preconditioner {
                solvers.push(Solver {
                    tolerance: self.tolerance,
                    max_iterations: self.max_iterations,
                    precision: precision.precision(),
                    preconditioner: match preconditioner {
                        PreconditionerName::Multigrid => Preconditioner::Multigrid,
                        PreconditionerName::Jacobi => Preconditioner::Jacobi,
                    },
                    ..Solver::default()
                });
            }
        }
        let formulations = self.formulation.iter().map(|name| match name {
            FormulationName::Pressure => Formulation::Pressure,
            FormulationName::TwoField => Formulation::TwoField,
            FormulationName::Condensed => Formulation::Condensed,
        });
        let options = Options {
            formulations: formulations.collect(),
            grids: self.grids.clone(),
            repeats: self.repeats,
            solvers,
            matrices: self.matrices,
        };
        say!(
            "grid  cells     nodes  formulation  preconditioner precision  iterations  seconds (least, largest)  residuals"
        );
        let table = bench_solve::bench_solve(&gpu, &options, &self.out, &mut |row| {
            say!(
                "{:4}  {:8}  {:5}  {:11}  {:14} {:9}  {:10}  {:.4} ({:.4}, {:.4})  {:.1e} {:.1e} {}",
                row.grid,
                row.active_cells,
                row.solid_nodes,
                row.formulation,
                row.preconditioner,
                row.precision,
                row.iterations,
                row.seconds_median,
                row.seconds_min,
                row.seconds_max,
                row.residual_p,
                row.residual_v,
                row.status,
            );
        })?;
        tell_machine(&table.machine);
        say!("table and picture: {}", self.out.display());
        Ok(())
    }
}
