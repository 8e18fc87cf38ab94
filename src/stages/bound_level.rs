//! `bound_level`: bounds of the level by the markers.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers};
use crate::gpu::{Binding, Dispatches, Gpu, Kernel, Real, Source};
use crate::step::Stage;
use crate::wgsl;

/// The stage: writes `new_level` from `carried_level` and `occupancy`, and `thin`, which `filter_level` reads.
pub fn bound_level(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::BoundLevel.name());
    let over_band = |source: Source, own: &[(&str, Binding)]| {
        let bound = Kernel::new(gpu, &source, Real::F32)?.bind(gpu, own, &[liquid, level])?;
        Ok::<_, Error>(bound.indirect(&liquid.band_args, 0))
    };
    // The marks of thick liquid, which spread along one axis per kernel.
    let marks = [&level.thin, &level.thin_next];
    let spread = [("thick_in", marks[0].into()), ("thick_out", marks[1].into())];
    let mut list = vec![
        over_band(wgsl!("mark_thick"), &[("thick", marks[0].into())])?,
        over_band(wgsl!("spread_thick"), &spread)?,
        over_band(wgsl!("mark_thin"), &[("thick_in", marks[1].into())])?,
        over_band(wgsl!("bound_thin"), &[])?,
        over_band(wgsl!("bound_level"), &[])?,
    ];
    if liquid.plan.effects.separation {
        list.push(over_band(wgsl!("raise_separated"), &[])?);
    }
    Ok(Dispatches::new(Stage::BoundLevel.name(), list))
}
