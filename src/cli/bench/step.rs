//! `cutwater bench step`

use std::path::PathBuf;

use clap::Args;
use cutwater::Error;
use cutwater::gpu::Gpu;
use cutwater::measure::bench_step::{self, Case};
use cutwater::scene::Scene;

use super::{at_least_once, range, tell_machine};
use crate::cli::AdapterArgs;

#[derive(Debug, Args)]
pub(super) struct Step {
    /// Scene files (TOML)
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// Multiply domain.cells, rounded; several, to see how seconds grow with the cells; max: by the most that the adapter and this machine have
    /// room for
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "S,S,..",
        default_value = "1"
    )]
    scale: Vec<ScaleName>,
    /// Refine the meshes of the solids by so much, each on every grid: bricks of boxes are multiplied, lengths of edges divided; files stay
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "S,S,..",
        default_value = "1"
    )]
    solids_scale: Vec<f64>,
    /// Override a key of every scene; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// Frames of each run
    #[arg(long, default_value_t = 6)]
    frames: u64,
    /// Runs of each scene from its start; no more are begun where they have taken 60 s
    #[arg(long, default_value_t = 3, value_parser = at_least_once())]
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

#[derive(Clone, Copy, Debug)]
enum ScaleName {
    Scale(f64),
    Max,
}

impl std::str::FromStr for ScaleName {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<ScaleName, Self::Err> {
        match text {
            "max" => Ok(ScaleName::Max),
            _ => text
                .parse()
                .map(ScaleName::Scale)
                .map_err(|_| "give numbers, or max"),
        }
    }
}

impl Step {
    /// Every scene at every scale, of the grid and of its solids.
    fn cases(&self) -> Result<Vec<Case>, Error> {
        let mut cases = Vec::new();
        for path in &self.scenes {
            for &scale in &self.scale {
                for &solids_scale in &self.solids_scale {
                    let load = |scale: f64| {
                        let scene = Scene::load(path, &self.overrides, scale)?;
                        Case::new(scene, solids_scale)
                    };
                    let scale = match scale {
                        ScaleName::Scale(scale) => scale,
                        ScaleName::Max => {
                            let adapter = Gpu::find(&self.adapter.choice())?;
                            bench_step::largest_scale(&load, &adapter)?
                        }
                    };
                    cases.push(load(scale)?);
                }
            }
        }
        Ok(cases)
    }

    pub(super) fn run(&self) -> Result<(), Error> {
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
        let options = bench_step::Options {
            scenes: self.cases()?,
            frames: self.frames,
            repeats: self.repeats,
            larger_domain,
            adapter: self.adapter.choice(),
        };
        say!(
            "scene                       cells  unknowns   markers     nodes  sub-steps           ms (least, largest of the runs)  cells/s  of copy bandwidth  waits  dispatches  idle ms"
        );
        let table = bench_step::bench_step(&options, &self.out, &mut |row| {
            say!(
                "{:24} {:8}  {:8.0}  {:8}  {:8}  {:9} {:8}  {:.2} ({:.2}, {:.2})  {:.1e}  {:.0} %  {:.1}  {:.0}  {:.2}",
                row.scene,
                row.cells,
                row.unknowns + row.solid_unknowns,
                row.markers,
                row.nodes,
                row.sub_steps,
                row.kind,
                1e3 * row.seconds_median,
                1e3 * row.seconds_min,
                1e3 * row.seconds_max,
                row.cells_per_second,
                100.0 * row.share_of_copy_bandwidth,
                row.waits,
                row.dispatches,
                1e3 * row.idle_seconds,
            );
        })?;
        for pair in &table.pairs {
            say!(
                "{}, {}: {:.3} times the seconds in the larger domain ({:.3} for the least)",
                pair.scene,
                pair.kind,
                pair.ratio,
                pair.ratio_of_least
            );
        }
        for growth in &table.growth {
            say!(
                "{}, {}: seconds grow with {} to the power of {:.2}{}, at last {:.2} ({} to {})",
                growth.scene,
                growth.kind,
                growth.along,
                growth.exponent,
                range([growth.exponent_low, growth.exponent_high]),
                growth.exponent_last,
                growth.from,
                growth.to,
            );
        }
        tell_machine(&table.machine);
        say!("tables and picture: {}", self.out.display());
        Ok(())
    }
}
