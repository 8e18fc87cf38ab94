//! `advect_markers`: x1 = x + dt v(x + dt/2 v(x)), v the velocity or, near the surface, that of the surface above, kept off the
//! walls, then out of obstacles and solids.

use crate::Error;
use crate::fields::LiquidBuffers;
use crate::gpu::{Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

/// The stage: `markers` in place by the velocity of the last sub-step. Counts those that leave through open sides and those that it
/// deletes in `report`. Empty without markers.
///
/// # Errors
/// As [`Kernel::new`] and [`Kernel::bind_arrays`].
pub fn advect_markers(gpu: &Gpu, liquid: &LiquidBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::AdvectMarkers.name());
    let n_markers = liquid.n_markers();
    if n_markers == 0 {
        return Ok(Dispatches::new(Stage::AdvectMarkers.name(), []));
    }
    let kernel = |source| Kernel::new(gpu, &source, Real::F32);
    // `common/sample_distance` samples `distances`: first those to the surface, then those to obstacles and solids.
    let to_surface = [("distances", (&liquid.velocity_next).into())];
    let to_solids = [("distances", (&liquid.obstacles.solid_distance).into())];
    let mut list = vec![
        kernel(wgsl!("surface_distance"))?
            .bind_arrays(gpu, &[liquid])?
            .indirect(&liquid.band_args, 0),
        kernel(wgsl!("advect_markers"))?
            .bind_arrays(gpu, &[&to_surface, liquid])?
            .threads(n_markers),
    ];
    if liquid.plan.effects.cuts() {
        let push_out = kernel(wgsl!("push_out"))?.bind_arrays(gpu, &[&to_solids, liquid])?;
        list.push(push_out.threads(n_markers));
    }
    Ok(Dispatches::new(Stage::AdvectMarkers.name(), list))
}
