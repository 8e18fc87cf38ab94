//! `right_hand_side`: b = - sum over faces of s_f open_f u*_f, m/s (thesis 4.38 over dx^2). Volume control adds a
//! source in components with a free surface, a level the excess of its markers; the flux of moving obstacles is
//! subtracted.

use super::excess::add_excess;
use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers, SolverBuffers};
use crate::gpu::{Dispatches, Gpu, Kernel};
use crate::step::Stage;
use crate::wgsl;

/// The stage: `velocity_next` to the solver's `rhs`, m/s, over the active quads. The mean over each enclosed liquid
/// component is not yet subtracted.
pub fn right_hand_side(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    level: Option<&LevelBuffers>,
    solver: &SolverBuffers,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::RightHandSide.name());
    // The flux of u* through the apertures of the solve.
    let predicted = [("velocity", (&liquid.velocity_next).into()), ("open", liquid.solve_open().into())];
    let over_active = |source, own: &[_]| {
        let kernel = Kernel::new(gpu, &source, solver.variant.real)?;
        let bound = kernel.bind(gpu, own, &[liquid, solver])?;
        Ok::<_, Error>(bound.indirect(&solver.args, 0))
    };
    let mut kernels = vec![over_active(wgsl!("right_hand_side"), &predicted)?];
    if let Some(level) = level.filter(|_| liquid.plan.effects.volume_shift) {
        kernels.push(add_excess(gpu, liquid, level, solver)?);
    }
    if liquid.obstacle_flux.is_some() {
        kernels.push(over_active(wgsl!("take_up"), &[])?);
    }
    Ok(Dispatches::new(Stage::RightHandSide.name(), kernels))
}
