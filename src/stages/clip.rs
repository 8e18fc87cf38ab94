//! `clip`: cut cells of deforming solids and moving obstacles. The host clips ([`SolidClip`]); this stage copies the
//! quads that differ to the device, so uncut cells cost nothing.

use crate::Error;
use crate::fields::{ClipBuffers, LiquidBuffers};
use crate::gpu::{Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

/// The stage: copies the clipping of [`ClipBuffers::write`] to the arrays of the liquid.
pub fn clip(gpu: &Gpu, liquid: &LiquidBuffers, clip: &ClipBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Clip.name());
    let mut sources = vec![wgsl!("cut_quads")];
    if liquid.markers.is_some() {
        sources.push(wgsl!("cut_room"));
    }
    if clip.fluxes.is_some() {
        sources.push(wgsl!("obstacle_flux"));
    }
    let over_entries = |source| {
        let bound = Kernel::new(gpu, source, Real::F32)?.bind(gpu, &[], &[clip, liquid])?;
        Ok(bound.threads(clip.size.quads))
    };
    let kernels: Result<Vec<_>, Error> = sources.iter().map(over_entries).collect();
    Ok(Dispatches::new(Stage::Clip.name(), kernels?))
}
