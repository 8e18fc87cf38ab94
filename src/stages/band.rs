//! `band`: the narrow band, as a list of quads.
//!
//! Tiles of 8 x 8 x 8 cells with liquid are dilated by the reach of extrapolation and advection in a sub-step. All
//! quads of a dilated tile are in the band. The list is row-major, for coalesced access.
//!
//! Tiles with liquid are those with markers. With a level they are the tiles that the liquid may reach in the sub-step,
//! and those with markers of the liquid. Spray needs no band.

use crate::Error;
use crate::gpu::{CompactKernels, Compaction, Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

use crate::fields::{LevelBuffers, LiquidBuffers, TILE};

/// The stage. Runs in every sub-step with markers, and once after the state is written with `surface = "fixed"`.
/// Before the level moves.
pub fn band(gpu: &Gpu, liquid: &LiquidBuffers, level: Option<&LevelBuffers>) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Band.name());
    let bound = |source| Kernel::new(gpu, &source, Real::F32)?.bind(gpu, &[], &[liquid]);
    let n_tiles = liquid.plan.tiles().len();
    let mut list = Vec::new();
    if liquid.plan.effects.level {
        list.push(bound(wgsl!("mark_liquid"))?.indirect(&liquid.band_args, 0));
    }
    match (level, &liquid.markers) {
        (Some(level), _) => {
            let kernel = Kernel::new(gpu, &wgsl!("mark_markers"), Real::F32)?;
            let bound = kernel.bind(gpu, &[], &[liquid, level])?;
            list.push(bound.indirect(&level.marker_args, 0));
        }
        (None, Some(markers)) => list.push(bound(wgsl!("occupy"))?.threads(markers.len())),
        (None, None) => {}
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
