//! `advect_velocity`: u*(x) = u(x - dt u(x - dt/2 u(x))) per face, semi-Lagrangian along the midpoint rule (Stam 1999), with
//! a level corrected by MacCormack's method. Small-aperture faces contribute in proportion to their aperture. In ballistic
//! liquid the departure point is g dt^2 / 2 further up.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers, SolverBuffers, Sources};
use crate::gpu::{Binding, Dispatches, Gpu, Kernel, Real, Source};
use crate::step::Stage;
use crate::wgsl;

/// The stage: `velocity` to `velocity_next` on the band. Afterwards `velocity` contains blended velocities on
/// small-aperture faces and, with a level, those of `sources` less half a sub-step of gravity.
pub fn advect_velocity(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    solver: &SolverBuffers,
    level: Option<&LevelBuffers>,
    sources: Option<&Sources>,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::AdvectVelocity.name());
    let effects = liquid.plan.effects;
    let over_band = |source: Source, own: &[(&str, Binding)]| {
        let kernel = Kernel::new(gpu, &source, Real::F32)?;
        let bound = kernel.bind(gpu, own, &[liquid, solver, &level])?;
        Ok::<_, Error>(bound.indirect(&liquid.band_args, 0))
    };
    let mut list = Vec::new();
    match level.filter(|_| effects.maccormack) {
        Some(level) => {
            if let Some(sources) = sources {
                let kernel = Kernel::new(gpu, &wgsl!("rewind_sources"), Real::F32)?;
                list.push(kernel.bind(gpu, &[], &[sources, liquid])?.threads(sources.n_faces));
            }
            if let Some(slivers) = &level.sliver_velocity {
                let to_slivers = [("velocity_next", slivers.into())];
                list.push(over_band(wgsl!("advect_slivers"), &to_slivers)?);
                list.push(over_band(wgsl!("show_slivers"), &[])?);
            }
            // `velocity_next` contains the departure points until the next kernel replaces them.
            let departures = [("departures", (&liquid.velocity_next).into())];
            list.push(over_band(wgsl!("carry_velocity"), &departures)?);
            list.push(over_band(wgsl!("correct_velocity"), &[])?);
            if level.sliver_velocity.is_some() {
                list.push(over_band(wgsl!("mix_slivers"), &[])?);
            }
        }
        None if effects.cuts() => {
            list.push(over_band(wgsl!("advect_slivers"), &[])?);
            list.push(over_band(wgsl!("show_slivers"), &[])?);
            list.push(over_band(wgsl!("advect_beside_slivers"), &[])?);
        }
        None => list.push(over_band(wgsl!("advect_velocity"), &[])?),
    }
    Ok(Dispatches::new(Stage::AdvectVelocity.name(), list))
}
