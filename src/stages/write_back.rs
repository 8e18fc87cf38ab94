//! `write_back`: u = u* - dt/(rho dx) (p_+ - p_-) on every open face with an active side (thesis 4.36).

use crate::Error;
use crate::fields::{LiquidBuffers, SolverBuffers};
use crate::gpu::{Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

/// The stage: computes `velocity` from `velocity_next` and the potential p dt / (rho dx), m/s, and flags the faces in
/// `valid`. Other faces become 0.
pub fn write_back(gpu: &Gpu, liquid: &LiquidBuffers, solver: &SolverBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::WriteBack.name());
    let still_air = Kernel::new(gpu, &wgsl!("still_air"), Real::F32)?.bind(gpu, &[], &[liquid])?;
    let kernel = Kernel::new(gpu, &wgsl!("write_back"), solver.variant.real)?;
    let write_back = kernel.bind(gpu, &[], &[liquid, solver])?;
    Ok(Dispatches::new(
        Stage::WriteBack.name(),
        [still_air.threads(liquid.plan.tiles().len()), write_back.indirect(&liquid.band_args, 0)],
    ))
}
