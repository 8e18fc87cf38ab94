//! `write_back`: u = u* - dt/(rho dx) (p_+ - p_-) on every open face with an active side (thesis 4.36).

use super::active_cells::{ActiveSettings, FreeSurface};
use crate::Error;
use crate::fields::{LiquidBuffers, SolverBuffers};
use crate::gpu::{Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

/// The stage: computes `velocity` from `velocity_next` and the potential p dt / (rho dx), m/s, and flags the faces in
/// `valid`. Other faces become 0. `free_surface`: as for [`PressureSystem::new`](super::PressureSystem::new).
pub fn write_back(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    solver: &SolverBuffers,
    free_surface: impl Into<FreeSurface>,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::WriteBack.name());
    let still_air = Kernel::new(gpu, &wgsl!("still_air"), Real::F32)?.bind(gpu, &[], &[liquid])?;
    let kernel = Kernel::new(gpu, &wgsl!("write_back"), solver.variant.real)?;
    let settings = gpu.uniform("liquid.free_surface", &ActiveSettings::from(free_surface.into()))?;
    let own = [("settings", (&settings).into()), ("open", liquid.solve_open().into())];
    let write_back = kernel.bind(gpu, &own, &[liquid, solver])?;
    Ok(Dispatches::new(
        Stage::WriteBack.name(),
        [still_air.threads(liquid.plan.tiles().len()), write_back.indirect(&liquid.band_args, 0)],
    ))
}
