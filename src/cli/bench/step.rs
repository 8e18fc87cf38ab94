//! `cutwater bench step`

use std::path::PathBuf;

use crate::Error;
use crate::gpu::Gpu;
use crate::measure::bench::step::{self, Case};
use crate::scene::Scene;
use clap::Args;

use super::{OrMax, Output, Repeats};
use crate::cli::{AdapterArgs, Overrides};

#[derive(Debug, Args)]
pub(super) struct Step {
    /// Scene files (TOML)
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// Multiply domain.cells, rounded; several, to see how seconds grow with the cells; max: the largest factor with room on the adapter and
    /// this machine
    #[arg(long, value_delimiter = ',', value_name = "S,S,..", default_value = "1")]
    scale: Vec<OrMax<f64>>,
    /// Refine the meshes of the solids by so much, each on every grid: bricks of boxes are multiplied, lengths of edges divided; files stay
    #[arg(long, value_delimiter = ',', value_name = "S,S,..", default_value = "1")]
    solids_scale: Vec<f64>,
    #[command(flatten)]
    overrides: Overrides,
    /// Frames of each run
    #[arg(long, default_value_t = 6)]
    frames: u64,
    #[command(flatten)]
    repeats: Repeats,
    #[command(flatten)]
    output: Output,
    #[command(flatten)]
    adapter: AdapterArgs,
}

impl Step {
    /// Every scene at every scale, of the grid and of its solids.
    fn cases(&self) -> Result<Vec<Case>, Error> {
        let mut cases = Vec::new();
        let overrides = self.overrides.all();
        for path in &self.scenes {
            for &scale in &self.scale {
                for &solids_scale in &self.solids_scale {
                    let load = |scale: f64| Case::new(Scene::load(path, &overrides, scale)?, solids_scale);
                    let scale = match scale {
                        OrMax::Number(scale) => scale,
                        OrMax::Max => step::largest_scale(&load, &Gpu::find(&self.adapter.choice())?)?,
                    };
                    cases.push(load(scale)?);
                }
            }
        }
        Ok(cases)
    }

    pub(super) fn run(&self) -> Result<(), Error> {
        let options = step::Options { scenes: self.cases()?, frames: self.frames, adapter: self.adapter.choice() };
        let (repeats, measure) = (Some(&self.repeats), step::measure);
        self.output.run("step", repeats, &options, measure)
    }
}
