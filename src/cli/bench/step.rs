//! `cutwater bench step`

use std::path::PathBuf;

use clap::Args;
use cutwater::Error;
use cutwater::measure::bench_step;
use cutwater::scene::Scene;

use super::{at_least_once, tell_machine};
use crate::cli::AdapterArgs;

#[derive(Debug, Args)]
pub(super) struct Step {
    /// Scene files (TOML)
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// Multiply domain.cells, rounded; several, to see how seconds grow with the cells
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "S,S,..",
        default_value = "1"
    )]
    scale: Vec<f64>,
    /// Override a key of every scene; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// Frames of each run
    #[arg(long, default_value_t = 6)]
    frames: u64,
    /// Runs of each scene from its start
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

impl Step {
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
        let scenes = self.scenes.iter().flat_map(|path| {
            let scales = self.scale.iter();
            scales.map(|&scale| Scene::load(path, &self.overrides, scale))
        });
        let options = bench_step::Options {
            scenes: scenes.collect::<Result<_, _>>()?,
            frames: self.frames,
            repeats: self.repeats,
            larger_domain,
            adapter: self.adapter.choice(),
        };
        say!(
            "scene                       cells  unknowns   markers     nodes  sub-steps  ms (least, largest)  cells/s  of copy bandwidth"
        );
        let table = bench_step::bench_step(&options, &self.out, &mut |row| {
            say!(
                "{:24} {:8}  {:8}  {:8}  {:8}  {:9}  {:.2} ({:.2}, {:.2})  {:.1e}  {:.0} %",
                row.scene,
                row.cells,
                row.unknowns + row.solid_unknowns,
                row.markers,
                row.nodes,
                row.sub_steps,
                1e3 * row.seconds_median,
                1e3 * row.seconds_min,
                1e3 * row.seconds_max,
                row.cells_per_second,
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
        for growth in &table.growth {
            say!(
                "{}: seconds grow with the cells to the power of {:.2} ({} to {})",
                growth.scene,
                growth.exponent,
                growth.from,
                growth.to,
            );
        }
        tell_machine(&table.machine);
        say!("tables and picture: {}", self.out.display());
        Ok(())
    }
}
