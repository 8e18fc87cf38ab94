//! `liquid_distance`: phi = min(2 dx, distance to the nearest marker) - r at cell centres (Zhu and Bridson 2005), -
//! dx deep inside. The stage extends phi into solids as a mean over known neighbours and measures the enclosed
//! volume.
//!
//! The minimum uses integer atomics on scattered values, so it is independent of the order. The work is proportional to
//! the surface: only markers within two cells of an empty cell scatter, and only to cells that are not deep inside.
//!
//! With a level, phi is dx times the level, extended into solids.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers, Sinks};
use crate::gpu::{Binding, Bound, Dispatch, Dispatches, Gpu, Kernel, Real, Source};
use crate::step::Stage;
use crate::wgsl;

/// Depth of the extension into solids, cells. An odd number, so that the last pass writes to `velocity`, with a level to
/// `new_level`.
const PASSES: usize = 3;

/// The stage: writes `liquid_distance`, and but for a level the volume to `report`. Cells of `sinks` are emptied. With a fixed
/// surface it measures the volume only. With a `level` the distance is that of its `new_level`, which the stage also extends
/// into bodies.
pub fn liquid_distance(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    level: Option<&LevelBuffers>,
    sinks: Option<&Sinks>,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::LiquidDistance.name());
    let mut list = match (level, &liquid.markers) {
        (Some(level), _) => of_level(gpu, liquid, level)?,
        (None, Some(markers)) => of_spheres(gpu, liquid, markers.len())?,
        (None, None) => Vec::new(),
    };
    if let Some(sinks) = sinks.filter(|_| liquid.markers.is_some()) {
        list.push(sinks.empty(gpu, liquid)?);
    }
    // Later stages shift a level, and `diagnose` measures its volume.
    if level.is_none() {
        list.extend(volume(gpu, liquid)?);
    }
    Ok(Dispatches::new(Stage::LiquidDistance.name(), list))
}

/// Distance to the spheres around the markers, extended into solids.
fn of_spheres(gpu: &Gpu, liquid: &LiquidBuffers, n_markers: usize) -> Result<Vec<Dispatch>, Error> {
    let bound = |source: Source| Kernel::new(gpu, &source, Real::F32)?.bind(gpu, &[], &[liquid]);
    let over_band = |bound: Bound| bound.indirect(&liquid.band_args, 0);
    let mut list = vec![
        over_band(bound(wgsl!("classify_near"))?),
        over_band(bound(wgsl!("classify_far"))?),
        bound(wgsl!("spread_markers"))?.threads(n_markers),
        over_band(bound(wgsl!("union_of_spheres"))?),
    ];
    if liquid.plan.effects.cuts() {
        list.extend(extension(gpu, liquid)?);
    }
    Ok(list)
}

/// dx times the level, extended into bodies.
fn of_level(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Vec<Dispatch>, Error> {
    let mut list = extend_level(gpu, liquid, level)?;
    let kernel = Kernel::new(gpu, &wgsl!("level_distance"), Real::F32)?;
    let bound = kernel.bind(gpu, &[], &[liquid, level])?;
    list.push(bound.indirect(&liquid.band_args, 0));
    Ok(list)
}

/// Volume and potential energy of the liquid, and the rate of volume control.
fn volume(gpu: &Gpu, liquid: &LiquidBuffers) -> Result<[Dispatch; 2], Error> {
    let real = liquid.plan.real;
    let bound = |source: Source| Kernel::new(gpu, &source, real)?.bind(gpu, &[], &[liquid]);
    Ok([bound(wgsl!("measure_volume"))?.threads(liquid.plan.n_summing()), bound(wgsl!("volume_rate"))?.threads(1)])
}

/// The part that measures the volume of a liquid distance.
///
/// # Errors
/// As [`Kernel::new`] and [`Kernel::bind`].
pub fn measure_volume(gpu: &Gpu, liquid: &LiquidBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::LiquidDistance.name());
    Ok(Dispatches::new(Stage::LiquidDistance.name(), volume(gpu, liquid)?))
}

/// Passes of the extension into solids, alternating between `liquid_distance` and `velocity`, which is free from
/// `advect_velocity` to `write_back`.
fn extension(gpu: &Gpu, liquid: &LiquidBuffers) -> Result<Vec<Dispatch>, Error> {
    // `velocity` is `extended_distance` of the table.
    let ends = [&liquid.liquid_distance, &liquid.velocity];
    let between = |source: Source, from: usize| {
        let ends = [("distance_in", ends[from].into()), ("distance_out", ends[1 - from].into())];
        let bound = Kernel::new(gpu, &source, Real::F32)?.bind(gpu, &ends, &[liquid])?;
        Ok(bound.indirect(&liquid.band_args, 0))
    };
    let passes = (0..PASSES).map(|n| between(wgsl!("extend_into_solids"), n % 2));
    passes.chain([between(wgsl!("finish_extension"), PASSES % 2)]).collect()
}

/// Extends `new_level` into bodies, with `next_level` between the passes. Cells that no pass reaches are unknown
/// (`common/unknown.wgsl`). Nothing without bodies.
pub(super) fn extend_level(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Vec<Dispatch>, Error> {
    if !liquid.plan.effects.cuts() {
        return Ok(Vec::new());
    }
    let over_band = |source: Source, own: &[(&str, Binding)]| {
        let bound = Kernel::new(gpu, &source, Real::F32)?.bind(gpu, own, &[liquid, level])?;
        Ok(bound.indirect(&liquid.band_args, 0))
    };
    let levels = [&level.next_level, &level.new_level];
    let pass = |n: usize| {
        let ends = [("distance_in", levels[n % 2].into()), ("distance_out", levels[1 - n % 2].into())];
        over_band(wgsl!("extend_level"), &ends)
    };
    let forget = [over_band(wgsl!("forget_in_solids"), &[])];
    forget.into_iter().chain((0..PASSES).map(pass)).collect()
}
