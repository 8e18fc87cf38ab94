//! `advect_velocity`: u*(x) = u(x - dt u(x - dt/2 u(x))) per face, semi-Lagrangian along the midpoint rule (Stam 1999).
//! Small-aperture faces contribute in proportion to their aperture. Liquid that touches nothing comes from g dt^2 / 2 further up.

use crate::Error;
use crate::fields::{LiquidBuffers, SolverBuffers};
use crate::gpu::{Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

/// The stage: `velocity` to `velocity_next` on the band. Afterwards `velocity` contains blended velocities on
/// small-aperture faces.
pub fn advect_velocity(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    solver: &SolverBuffers,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::AdvectVelocity.name());
    let kernels = match liquid.plan.effects.cuts() {
        false => &[wgsl!("advect_velocity")][..],
        true => &[
            wgsl!("advect_slivers"),
            wgsl!("show_slivers"),
            wgsl!("advect_beside_slivers"),
        ],
    };
    let over_band = |source| {
        let bound = Kernel::new(gpu, source, Real::F32)?.bind(gpu, &[], &[liquid, solver])?;
        Ok(bound.indirect(&liquid.band_args, 0))
    };
    let kernels: Result<Vec<_>, Error> = kernels.iter().map(over_band).collect();
    Ok(Dispatches::new(Stage::AdvectVelocity.name(), kernels?))
}
