//! `right_hand_side`: b = - sum over faces of s_f open_f u*_f, m/s (thesis 4.38 over dx^2). Volume control adds a
//! source in components with a free surface; the flux of moving obstacles is subtracted.

use crate::Error;
use crate::fields::LiquidBuffers;
use crate::gpu::{Dispatches, Gpu, Kernel};
use crate::solver::SolverBuffers;
use crate::step::Stage;
use crate::wgsl;

/// The stage: `velocity_next` to the solver's `rhs`, m/s, over the active quads. The mean over each enclosed liquid
/// component is not yet subtracted.
pub fn right_hand_side(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    solver: &SolverBuffers,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::RightHandSide.name());
    let mut sources = vec![wgsl!("right_hand_side")];
    if liquid.obstacle_flux.is_some() {
        sources.push(wgsl!("take_up"));
    }
    // The flux of u* through the apertures of the solve.
    let predicted = [
        ("velocity", (&liquid.velocity_next).into()),
        ("open", liquid.solve_open().into()),
    ];
    let over_active = |source| {
        let kernel = Kernel::new(gpu, source, solver.variant.real)?;
        let bound = kernel.bind_arrays(gpu, &[&predicted, liquid, solver])?;
        Ok(bound.indirect(&solver.args, 0))
    };
    let kernels: Result<Vec<_>, Error> = sources.iter().map(over_active).collect();
    Ok(Dispatches::new(Stage::RightHandSide.name(), kernels?))
}
