//! `marker_band`: markers fill a band of three cells below the surface. Markers below it are deleted; sites that enter it get
//! a marker (see the twin, `reference/marker_band.rs`).
//!
//! Seeds are appended to the used slots in the order of the cells: counts, a scan in one workgroup, and the write.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers};
use crate::gpu::{Dispatch, Dispatches, Gpu, Kernel, Real, Source};
use crate::step::Stage;
use crate::wgsl;

/// The rest of the seeds of the sub-step, in slots that were freed after it ([`LevelBuffers::write_freed`]).
pub fn seed_rest(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::MarkerBand.name());
    let list = [seed_band(gpu, liquid, level)?];
    Ok(Dispatches::new(Stage::MarkerBand.name(), list))
}

fn seed_band(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Dispatch, Error> {
    let chunks = [("chunks", (&liquid.band_scratch).into())];
    let kernel = Kernel::new(gpu, &wgsl!("seed_band"), Real::F32)?;
    let bound = kernel.bind(gpu, &chunks, &[liquid, level])?;
    Ok(bound.indirect(&liquid.band_args, 0))
}

/// The stage: writes `markers`, `marker_velocity` of seeds, the number of used slots in `marker_args`, and the numbers of
/// markers of the sub-step in `report`.
pub fn marker_band(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::MarkerBand.name());
    let kernel = |source: Source| Kernel::new(gpu, &source, Real::F32);
    // The scratch memory of the compaction in `band` is free.
    let chunks = [("chunks", (&liquid.band_scratch).into())];
    let scanned = |source: Source| kernel(source)?.bind(gpu, &chunks, &[liquid, level]);
    let delete_markers = kernel(wgsl!("delete_markers"))?.bind(gpu, &[], &[liquid, level])?;
    let list = [
        delete_markers.indirect(&level.marker_args, 0),
        scanned(wgsl!("count_seeds"))?.indirect(&liquid.band_args, 0),
        scanned(wgsl!("plan_band_seeds"))?.threads(1),
        seed_band(gpu, liquid, level)?,
    ];
    Ok(Dispatches::new(Stage::MarkerBand.name(), list))
}
