//! `advect_markers`: x1 = x + dt v(x + dt/2 v(x)). Near the surface v is the velocity of the surface above. Markers are
//! then pushed out of walls, obstacles and solids. In ballistic liquid they also fall by g dt^2 / 2. With a level v is
//! the velocity at the markers themselves, and spray flies as free bodies.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers, SolverBuffers};
use crate::gpu::{Bound, Dispatch, Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

/// The stage: moves `markers` by the velocity of the last sub-step. Counts markers that cross open sides, and deleted
/// ones, in `report`. Empty without markers. With a level it also moves spray, and counts it and what of it is lost in
/// `marker_counts`.
pub fn advect_markers(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    solver: &SolverBuffers,
    level: Option<&LevelBuffers>,
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
    let over_markers = |bound: Bound| -> Dispatch {
        match level {
            Some(level) => bound.indirect(&level.marker_args, 0),
            None => bound.threads(n_markers),
        }
    };
    let mut list = match level {
        Some(level) => {
            let kernel = kernel(wgsl!("advect_level_markers"))?;
            let bound = kernel.bind(gpu, &to_solids, &[liquid, level, solver])?;
            vec![over_markers(bound)]
        }
        None => vec![
            kernel(wgsl!("surface_distance"))?.bind(gpu, &[], &[liquid])?.indirect(&liquid.band_args, 0),
            over_markers(kernel(wgsl!("advect_markers"))?.bind(gpu, &to_surface, &[liquid, solver])?),
        ],
    };
    if liquid.plan.effects.cuts() {
        let push_out = kernel(wgsl!("push_out"))?.bind(gpu, &to_solids, &[liquid])?;
        list.push(over_markers(push_out));
    }
    let Some(level) = level else {
        return Ok(Dispatches::new(Stage::AdvectMarkers.name(), list));
    };
    let count_spray = kernel(wgsl!("count_spray"))?.bind(gpu, &[], &[liquid, level])?;
    list.push(over_markers(count_spray));
    Ok(Dispatches::new(Stage::AdvectMarkers.name(), list).clearing(&level.marker_counts))
}
