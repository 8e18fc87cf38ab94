//! `liquid_components`: connected components of the liquid and their target volumes.
//!
//! Labels are computed by union-find over the band, as in `closed_components`: the root of a component is its smallest
//! cell, for every order of the threads. Sums over a component are integers of 64 bits at its root, so a run repeats
//! bitwise.

use crate::Error;
use crate::fields::{ExchangeBuffers, LevelBuffers, LiquidBuffers, TILE};
use crate::gpu::{Binding, Dispatch, Dispatches, Gpu, Kernel, Real, Source};
use crate::step::Stage;
use crate::wgsl;

use super::level_exchange::share_exchange;

/// Layers of air with the label of the liquid beside them.
const AIR_LAYERS: u32 = 3;

/// The stage: writes `component`, the volumes in `component_sums` and the targets in `component_volume`. The target of the
/// whole liquid with the spray is `volume_0` of the sub-step, with what `taps` exchange.
pub fn liquid_components(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    level: &LevelBuffers,
    taps: ExchangeBuffers,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::LiquidComponents.name());
    let bound = |source: Source, own: &[(&str, Binding)]| {
        Kernel::new(gpu, &source, Real::F32)?.bind(gpu, own, &[liquid, level])
    };
    let over_band =
        |source: Source, own: &[(&str, Binding)]| Ok::<_, Error>(bound(source, own)?.indirect(&liquid.band_args, 0));
    let labels = ("labels", (&level.component).into());
    let mut list = vec![
        bound(wgsl!("clear_labels"), &[])?.threads(TILE * liquid.plan.tiles().len()),
        over_band(wgsl!("label_liquid"), &[])?,
        over_band(wgsl!("join_labels"), &[labels])?,
        over_band(wgsl!("label_roots"), &[labels])?,
    ];
    for number in 1..=AIR_LAYERS {
        let layer = gpu.uniform("level.layer", &[number, 0, 0, 0])?;
        list.push(over_band(wgsl!("label_air"), &[labels, ("layer", (&layer).into())])?);
    }
    let sums_in = |sums| [("sums", sums)];
    let volumes = sums_in((&level.component_sums).into());
    let overlaps = sums_in((&level.density_now).into());
    let shares = sums_in((&level.density_next).into());
    list.push(over_band(wgsl!("component_volumes"), &volumes)?);
    list.push(over_band(wgsl!("component_overlaps"), &overlaps)?);
    list.push(over_band(wgsl!("component_shares"), &shares)?);
    let [of_sources, of_all, limits] = share_exchange(gpu, liquid, level, taps)?;
    list.extend(of_sources);
    list.push(over_band(wgsl!("sum_components"), &[])?);
    list.extend(of_all);
    list.push(over_band(wgsl!("component_targets"), &[])?);
    list.extend(limits);
    let stage = Dispatches::new(Stage::LiquidComponents.name(), list);
    let stage = stage.clearing(&level.component_totals);
    Ok(match taps.level.and_then(|exchange| exchange.labelled.as_ref()) {
        Some(labelled) => stage.clearing(labelled),
        None => stage,
    })
}

/// The part of `spray` after all markers: adds the flights in `component_flights` to the targets.
pub fn settle_flights(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Dispatch, Error> {
    let gpu = &gpu.at(Stage::Spray.name());
    let kernel = Kernel::new(gpu, &wgsl!("settle_flights"), Real::F32)?;
    let bound = kernel.bind(gpu, &[], &[liquid, level])?;
    Ok(bound.indirect(&liquid.band_args, 0))
}
