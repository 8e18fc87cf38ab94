//! `move_solid`, before the motion: bodies that touch nothing. They move by dt v + dt^2 g / 2, which is exact in free fall.

use super::move_solid::BODY_THREADS;
use crate::Error;
use crate::fields::{CouplingBuffers, SolidBuffers, SolverBuffers};
use crate::gpu::{Dispatches, Gpu, Kernel, Source, Variant};
use crate::solver::ObstacleField;
use crate::step::Stage;
use crate::wgsl;

/// Marks the bodies in `ballistic` that touch neither walls nor obstacles at the end of the motion.
pub fn ballistic_bodies(
    gpu: &Gpu,
    solids: &SolidBuffers,
    obstacles: Option<ObstacleField>,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::MoveSolid.name());
    let kernel = |source: &Source| Kernel::new(gpu, source, Variant::from(solids.plan.real));
    let threads = BODY_THREADS * solids.plan.n_free;
    let mut list = Vec::new();
    if threads > 0 {
        let release = kernel(&wgsl!("release_bodies"))?.bind(gpu, &[], &[solids])?;
        list.push(release.threads(threads));
        if let Some(obstacles) = obstacles {
            let own = [("level", obstacles.level.into()), ("distances", obstacles.solid_distance.into())];
            let hold = kernel(&wgsl!("hold_at_obstacles"))?.bind(gpu, &own, &[solids])?;
            list.push(hold.threads(threads));
        }
    }
    Ok(Dispatches::new(Stage::MoveSolid.name(), list))
}

/// Unmarks those that liquid touched in the last sub-step.
pub fn wet_bodies(
    gpu: &Gpu,
    solids: &SolidBuffers,
    solver: &SolverBuffers,
    coupling: &CouplingBuffers,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::MoveSolid.name());
    let threads = BODY_THREADS * solids.plan.n_free;
    let mut list = Vec::new();
    if threads > 0 {
        let kernel = Kernel::new(gpu, &wgsl!("hold_in_liquid"), Variant::from(solids.plan.real))?;
        let own = [("flags", (&solver.flags).into())];
        list.push(kernel.bind(gpu, &own, &[coupling, solids])?.threads(threads));
    }
    Ok(Dispatches::new(Stage::MoveSolid.name(), list))
}
