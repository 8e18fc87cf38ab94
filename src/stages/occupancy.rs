//! `occupancy`: fraction of the surroundings of each cell that markers fill.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers};
use crate::gpu::{Bound, Dispatches, Gpu, Kernel, Real, Source};
use crate::step::Stage;
use crate::wgsl;

/// The stage: writes `occupancy` from the markers and `carried_level`. Uses `marker_weights`.
pub fn occupancy(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Occupancy.name());
    let bound = |source: Source| Kernel::new(gpu, &source, Real::F32)?.bind(gpu, &[], &[liquid, level]);
    let over_band = |bound: Bound| bound.indirect(&liquid.band_args, 0);
    let list = [
        bound(wgsl!("weigh_markers"))?.indirect(&level.marker_args, 0),
        over_band(bound(wgsl!("occupancy_of_cells"))?),
    ];
    Ok(Dispatches::new(Stage::Occupancy.name(), list))
}
