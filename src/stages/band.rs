//! `band`: the narrow band, as a list of quads.
//!
//! Tiles of 8 x 8 x 8 cells with liquid are dilated by the reach of extrapolation and advection in a sub-step. All
//! quads of a dilated tile are in the band. The list is row-major, for coalesced access.

use crate::Error;
use crate::gpu::{CompactKernels, Compaction, Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

use crate::fields::{LiquidBuffers, TILE};

/// The stage. Runs in every sub-step with markers, and once after the state is written with `surface = "fixed"`.
pub fn band(gpu: &Gpu, liquid: &LiquidBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Band.name());
    let bound = |source| Kernel::new(gpu, &source, Real::F32)?.bind(gpu, &[], &[liquid]);
    let n_tiles = liquid.plan.tiles().len();
    let mut list = Vec::new();
    if let Some(markers) = &liquid.markers {
        list.push(bound(wgsl!("occupy"))?.threads(markers.len()));
    }
    list.push(bound(wgsl!("dilate_tiles"))?.threads(n_tiles));
    list.push(bound(wgsl!("flag_band"))?.threads(TILE * n_tiles));
    let compaction = Compaction::new(
        gpu,
        &CompactKernels::new(gpu)?,
        &liquid.band_flags,
        &liquid.band_list,
        &liquid.band_args,
        &liquid.band_scratch,
        [0, liquid.band_flags.len()],
        0,
    )?;
    list.extend(compaction.into_dispatches());
    Ok(Dispatches::new(Stage::Band.name(), list))
}
