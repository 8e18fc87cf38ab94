//! `clip`: what deforming solids and moving obstacles leave of the grid in a sub-step. The host clips them ([`SolidClip`]); this stage
//! takes the quads that differ to the device, so the rest of the grid costs nothing.

use crate::Error;
use crate::fields::{ClipBuffers, LiquidBuffers};
use crate::gpu::{Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

/// The stage: the clipping that [`ClipBuffers::write`] wrote to the arrays of the liquid.
///
/// # Errors
/// As [`Kernel::new`] and [`Kernel::bind_arrays`].
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
        let bound = Kernel::new(gpu, source, Real::F32)?.bind_arrays(gpu, &[clip, liquid])?;
        Ok(bound.threads(clip.size.quads))
    };
    let kernels: Result<Vec<_>, Error> = sources.iter().map(over_entries).collect();
    Ok(Dispatches::new(Stage::Clip.name(), kernels?))
}
