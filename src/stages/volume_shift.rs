//! `volume_shift`: moves the level of each component towards its target volume.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers};
use crate::gpu::{Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

/// The stage, after `liquid_components`: writes `liquid_distance`. Empty without volume control.
pub fn volume_shift(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::VolumeShift.name());
    let mut list = Vec::new();
    if liquid.plan.effects.volume_shift {
        let over_band = |source, own: &[_]| {
            let bound = Kernel::new(gpu, &source, Real::F32)?.bind(gpu, own, &[liquid, level])?;
            Ok::<_, Error>(bound.indirect(&liquid.band_args, 0))
        };
        // Zero since `liquid_components`.
        let areas = [("sums", (&level.density_next).into())];
        list.push(over_band(wgsl!("component_areas"), &areas)?);
        list.push(over_band(wgsl!("volume_shift"), &[])?);
    }
    Ok(Dispatches::new(Stage::VolumeShift.name(), list))
}
