//! `redistance`: restores the level to a distance.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers};
use crate::gpu::{Binding, Dispatches, Gpu, Kernel, Real, Source};
use crate::step::Stage;
use crate::wgsl;

use super::liquid_distance::extend_level;

/// Jacobi passes of the distance. An odd number, so that the last pass writes to `eikonal_next`.
const PASSES: usize = 9;

/// The stage: `new_level` in place, in bodies the extended level. Uses `next_level`, `eikonal_now` and `eikonal_next`.
pub fn redistance(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Redistance.name());
    let over_band = |source: Source, own: &[(&str, Binding)]| {
        let bound = Kernel::new(gpu, &source, Real::F32)?.bind(gpu, own, &[liquid, level])?;
        Ok::<_, Error>(bound.indirect(&liquid.band_args, 0))
    };
    let mut list = extend_level(gpu, liquid, level)?;
    list.push(over_band(wgsl!("start_redistance"), &[])?);
    let separates = liquid.plan.effects.separation;
    if separates {
        list.push(over_band(wgsl!("start_separated"), &[])?);
    }
    let distances = [&level.eikonal_now, &level.eikonal_next];
    for n in 0..PASSES {
        let ends = [("distance_in", distances[n % 2].into()), ("distance_out", distances[1 - n % 2].into())];
        list.push(over_band(wgsl!("eikonal_pass"), &ends)?);
    }
    let mixed = ("mixed", distances[1 - PASSES % 2].into());
    let last = [("distances", distances[PASSES % 2].into()), mixed];
    list.push(over_band(wgsl!("mix_level"), &last)?);
    list.push(over_band(wgsl!("relax_level"), &[mixed])?);
    if separates {
        list.push(over_band(wgsl!("keep_separated"), &[mixed])?);
    }
    Ok(Dispatches::new(Stage::Redistance.name(), list))
}
