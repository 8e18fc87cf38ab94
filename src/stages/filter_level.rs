//! `filter_level`: damps ripples along the surface.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers};
use crate::gpu::{Dispatches, Gpu, Kernel, Real, Source};
use crate::step::Stage;
use crate::wgsl;

/// The stage: `new_level` in place. Uses `next_level`, near the surface only.
pub fn filter_level(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::FilterLevel.name());
    let over_band = |source: Source| {
        let bound = Kernel::new(gpu, &source, Real::F32)?.bind(gpu, &[], &[liquid, level])?;
        Ok::<_, Error>(bound.indirect(&liquid.band_args, 0))
    };
    let list = [over_band(wgsl!("filter_level"))?, over_band(wgsl!("keep_filtered"))?];
    Ok(Dispatches::new(Stage::FilterLevel.name(), list))
}
