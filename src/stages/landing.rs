//! `landing`: spray with liquid around it becomes a part of that liquid, with its momentum (equations in the twin,
//! `reference/landing.rs`). Without spray the stage has no work.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers};
use crate::gpu::{Binding, Dispatches, Gpu, Kernel, Real, Source};
use crate::step::Stage;
use crate::wgsl;

/// The stage: writes `velocity_next`, `marker_velocity` of what lands and `component_flights`. Runs between `marker_band` and the
/// solve.
pub fn landing(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Landing.name());
    let bound = |source: Source, own: &[(&str, Binding)]| {
        Kernel::new(gpu, &source, Real::F32)?.bind(gpu, own, &[liquid, level])
    };
    let labels = [("labels", (&level.component).into())];
    let list = [
        bound(wgsl!("land_markers"), &labels)?.indirect(&level.landing_args, 0),
        bound(wgsl!("clear_landing"), &[])?.indirect(&level.landing_args, 1),
        bound(wgsl!("spread_landing"), &[])?.indirect(&level.landing_args, 0),
        bound(wgsl!("take_landing"), &[])?.indirect(&level.landing_args, 1),
    ];
    Ok(Dispatches::new(Stage::Landing.name(), list))
}
