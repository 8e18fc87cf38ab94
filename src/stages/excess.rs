//! `excess`: density of the markers less that of liquid.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers, SolverBuffers};
use crate::gpu::{Binding, Dispatch, Dispatches, Gpu, Kernel, Real, Source};
use crate::grid::Axis;
use crate::step::Stage;
use crate::wgsl;

/// The stage, after `liquid_components`: writes `excess`. Empty without volume control.
pub fn excess(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Excess.name());
    let mut list = Vec::new();
    if liquid.plan.effects.volume_shift {
        let over_band = |source: Source, own: &[(&str, Binding)]| {
            let bound = Kernel::new(gpu, &source, Real::F32)?.bind(gpu, own, &[liquid, level])?;
            Ok::<_, Error>(bound.indirect(&liquid.band_args, 0))
        };
        list.push(over_band(wgsl!("excess_density"), &[])?);
        // Twice along each axis; an even number of passes ends where it began.
        let ends = [&level.density_now, &level.density_next];
        for (pass, axis) in Axis::ALL.iter().chain(&Axis::ALL).enumerate() {
            let axis = gpu.uniform("level.axis", &[axis.index() as u32, 0, 0, 0])?;
            let own = [
                ("axis", (&axis).into()),
                ("density_in", ends[pass % 2].into()),
                ("density_out", ends[1 - pass % 2].into()),
            ];
            list.push(over_band(wgsl!("smooth_density"), &own)?);
        }
        list.push(over_band(wgsl!("limit_excess"), &[])?);
    }
    Ok(Dispatches::new(Stage::Excess.name(), list))
}

/// The part of `right_hand_side` that adds the source of the excess to the solver's `rhs`.
pub(super) fn add_excess(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    level: &LevelBuffers,
    solver: &SolverBuffers,
) -> Result<Dispatch, Error> {
    let kernel = Kernel::new(gpu, &wgsl!("add_excess"), solver.variant.real)?;
    let bound = kernel.bind(gpu, &[], &[level, liquid, solver])?;
    Ok(bound.indirect(&solver.args, 0))
}
