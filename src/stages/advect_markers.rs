//! `advect_markers`: x1 = x + dt v(x + dt/2 v(x)). Near the surface v is the velocity of the surface above. Markers
//! are then pushed out of walls, obstacles and solids. In liquid that touches nothing they also fall by g dt^2 / 2.

use crate::Error;
use crate::fields::{LiquidBuffers, SolverBuffers};
use crate::gpu::{Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

/// The stage: moves `markers` by the velocity of the last sub-step. Counts markers that cross open sides, and deleted
/// ones, in `report`. Empty without markers.
pub fn advect_markers(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    solver: &SolverBuffers,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::AdvectMarkers.name());
    let n_markers = liquid.n_markers();
    if liquid.markers.is_none() {
        return Ok(Dispatches::new(Stage::AdvectMarkers.name(), []));
    }
    let kernel = |source| Kernel::new(gpu, &source, Real::F32);
    // `common/sample_distance` samples `distances`: the surface first, then obstacles and solids.
    let to_surface = [("distances", (&liquid.velocity_next).into())];
    let to_solids = [("distances", (&liquid.obstacles.solid_distance).into())];
    let mut list = vec![
        kernel(wgsl!("surface_distance"))?
            .bind(gpu, &[], &[liquid])?
            .indirect(&liquid.band_args, 0),
        kernel(wgsl!("advect_markers"))?
            .bind(gpu, &to_surface, &[liquid, solver])?
            .threads(n_markers),
    ];
    if liquid.plan.effects.cuts() {
        let push_out = kernel(wgsl!("push_out"))?.bind(gpu, &to_solids, &[liquid])?;
        list.push(push_out.threads(n_markers));
    }
    Ok(Dispatches::new(Stage::AdvectMarkers.name(), list))
}
