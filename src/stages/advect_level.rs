//! `advect_level`: transport of the level by MacCormack's method, semi-Lagrangian along the midpoint rule in both passes.
//! In ballistic liquid the departure point is g dt^2 / 2 further up.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers, SolverBuffers};
use crate::gpu::{Binding, Dispatches, Gpu, Kernel, Real, Source};
use crate::step::Stage;
use crate::wgsl;

/// The stage: `liquid_distance` to `carried_level` on the band, and the components that cells come from to `component_origin`. With
/// separation, `separation_bounds` too.
pub fn advect_level(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    solver: &SolverBuffers,
    level: &LevelBuffers,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::AdvectLevel.name());
    let distances = ("distances", (&liquid.liquid_distance).into());
    // `carried_level` contains the departure points until the last kernel replaces them.
    let departures = ("departures", (&level.carried_level).into());
    let over_band = |source: Source, own: &[(&str, Binding)]| {
        let kernel = Kernel::new(gpu, &source, Real::F32)?;
        let bound = kernel.bind(gpu, own, &[liquid, solver, level])?;
        Ok::<_, Error>(bound.indirect(&liquid.band_args, 0))
    };
    let mut list = vec![
        over_band(wgsl!("advect_level"), &[distances, departures])?,
        over_band(wgsl!("component_origins"), &[("labels", (&level.component).into()), departures])?,
        over_band(wgsl!("correct_level"), &[distances])?,
    ];
    let effects = liquid.plan.effects;
    if effects.separation {
        list.push(over_band(wgsl!("separated_level"), &[distances])?);
        if effects.leaves_still_bodies() {
            list.push(over_band(wgsl!("air_at_bodies"), &[distances])?);
        }
    }
    Ok(Dispatches::new(Stage::AdvectLevel.name(), list))
}
