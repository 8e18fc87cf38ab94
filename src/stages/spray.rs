//! `spray`: markers that fly as free bodies.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers};
use crate::gpu::{Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

use super::liquid_components::settle_flights;

/// The stage: writes `marker_velocity`, and moves the volume of markers that landed or start to fly to or from the target of the component
/// beside them. Runs after `extrapolate`; its markers include the seeds of the sub-step.
pub fn spray(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Spray.name());
    let kernel = Kernel::new(gpu, &wgsl!("spray"), Real::F32)?;
    let labels = [("labels", (&level.component).into())];
    let spray = kernel.bind(gpu, &labels, &[liquid, level])?;
    let list = [spray.indirect(&level.marker_args, 0), settle_flights(gpu, liquid, level)?];
    Ok(Dispatches::new(Stage::Spray.name(), list))
}
