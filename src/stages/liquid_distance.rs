//! `liquid_distance`: phi = min(2 dx, distance to the nearest marker) - r at cell centres (Zhu and Bridson 2005), -
//! dx deep inside. The stage extends phi into solids as a mean over known neighbours and measures the enclosed
//! volume.
//!
//! The minimum uses integer atomics on scattered values, so it is independent of the order. Only markers within two
//! cells of an empty cell scatter, and only to cells that are not deep inside: the work is proportional to the
//! surface.

use crate::Error;
use crate::fields::{LiquidBuffers, Sinks};
use crate::gpu::{Bound, Dispatch, Dispatches, Gpu, Kernel, Real, Source};
use crate::step::Stage;
use crate::wgsl;

/// Depth of the extension into solids, cells. An odd number, so that the last pass writes to `velocity`.
const PASSES: usize = 3;

/// The stage: writes `liquid_distance`, and the volume to `report`. Cells of `sinks` are emptied. With a fixed
/// surface it measures the volume only.
pub fn liquid_distance(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    sinks: Option<&Sinks>,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::LiquidDistance.name());
    let mut list = Vec::new();
    if let Some(markers) = &liquid.markers {
        let bound =
            |source: Source| Kernel::new(gpu, &source, Real::F32)?.bind(gpu, &[], &[liquid]);
        let over_band = |bound: Bound| bound.indirect(&liquid.band_args, 0);
        list.push(over_band(bound(wgsl!("classify_near"))?));
        list.push(over_band(bound(wgsl!("classify_far"))?));
        list.push(bound(wgsl!("spread_markers"))?.threads(markers.len()));
        list.push(over_band(bound(wgsl!("union_of_spheres"))?));
        if liquid.plan.effects.cuts() {
            list.extend(extension(gpu, liquid)?);
        }
        if let Some(sinks) = sinks {
            list.push(sinks.empty(gpu, liquid)?);
        }
    }
    list.extend(volume(gpu, liquid)?);
    Ok(Dispatches::new(Stage::LiquidDistance.name(), list))
}

/// Volume and potential energy of the liquid, and the rate of volume control.
fn volume(gpu: &Gpu, liquid: &LiquidBuffers) -> Result<[Dispatch; 2], Error> {
    let real = liquid.plan.real;
    let bound = |source: Source| Kernel::new(gpu, &source, real)?.bind(gpu, &[], &[liquid]);
    Ok([
        bound(wgsl!("measure_volume"))?.threads(liquid.plan.n_summing()),
        bound(wgsl!("volume_rate"))?.threads(1),
    ])
}

/// The part that measures the volume of a liquid distance.
///
/// # Errors
/// As [`Kernel::new`] and [`Kernel::bind`].
pub fn measure_volume(gpu: &Gpu, liquid: &LiquidBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::LiquidDistance.name());
    Ok(Dispatches::new(
        Stage::LiquidDistance.name(),
        volume(gpu, liquid)?,
    ))
}

/// Passes of the extension into solids, alternating between `liquid_distance` and `velocity`, which is free from
/// `advect_velocity` to `write_back`.
fn extension(gpu: &Gpu, liquid: &LiquidBuffers) -> Result<Vec<Dispatch>, Error> {
    // `velocity` is `extended_distance` of the table.
    let ends = [&liquid.liquid_distance, &liquid.velocity];
    let between = |source: Source, from: usize| {
        let ends = [
            ("distance_in", ends[from].into()),
            ("distance_out", ends[1 - from].into()),
        ];
        let bound = Kernel::new(gpu, &source, Real::F32)?.bind(gpu, &ends, &[liquid])?;
        Ok(bound.indirect(&liquid.band_args, 0))
    };
    let passes = (0..PASSES).map(|n| between(wgsl!("extend_into_solids"), n % 2));
    passes
        .chain([between(wgsl!("finish_extension"), PASSES % 2)])
        .collect()
}
