//! `advect_markers`: x1 = x + dt v(x + dt/2 v(x)), v the velocity or, near the surface, that of the surface above, kept off the
//! walls, then out of obstacles and solids.

use crate::Error;
use crate::gpu::{Bound, Gpu, Kernel, Real, Recorder};
use crate::wgsl;

use super::{LiquidBuffers, over_band};

/// The stage. Moves the markers by the velocity of the last sub-step; counts those that leave through open sides and those that it
/// drops in the report.
#[derive(Debug)]
pub struct AdvectMarkers {
    n_markers: usize,
    surface_distance: Bound,
    advect_markers: Bound,
    push_out: Option<Bound>,
}

impl AdvectMarkers {
    /// The stage's name.
    pub const NAME: &'static str = "advect_markers";

    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    ///
    /// # Panics
    /// When the buffers have no markers.
    pub fn new(gpu: &Gpu, buffers: &LiquidBuffers) -> Result<AdvectMarkers, Error> {
        let markers = buffers.markers.as_ref().expect("the scene has markers");
        let level = ("level", (&buffers.level).into());
        let step = ("step", (&buffers.step).into());
        let positions = ("markers", (&markers.positions).into());
        let velocity = ("velocity", (&buffers.velocity).into());
        // Free until advection writes it.
        let surface = &buffers.velocity_next;
        let [_, args, list] = over_band(buffers);
        let report = ("report", (&buffers.report).into());
        let push_out = || {
            let distance = ("distances", (&buffers.obstacles.solid_distance).into());
            Kernel::new(gpu, &wgsl!("push_out"), Real::F32)?
                .bind(gpu, &[level, step, distance, positions, report])
        };
        Ok(AdvectMarkers {
            n_markers: markers.positions.len(),
            surface_distance: Kernel::new(gpu, &wgsl!("surface_distance"), Real::F32)?.bind(
                gpu,
                &[
                    level,
                    step,
                    args,
                    list,
                    ("occupied", (&markers.occupied).into()),
                    ("liquid_distance", (&buffers.liquid_distance).into()),
                    ("surface", surface.into()),
                ],
            )?,
            advect_markers: Kernel::new(gpu, &wgsl!("advect_markers"), Real::F32)?.bind(
                gpu,
                &[
                    level,
                    step,
                    velocity,
                    ("distances", surface.into()),
                    positions,
                    report,
                ],
            )?,
            push_out: buffers.plan.effects.cuts().then(push_out).transpose()?,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder, buffers: &LiquidBuffers) {
        recorder.stage(AdvectMarkers::NAME, |pass| {
            pass.dispatch_indirect(&self.surface_distance, &buffers.band_args, 0);
            pass.dispatch(&self.advect_markers, self.n_markers);
            if let Some(push_out) = &self.push_out {
                pass.dispatch(push_out, self.n_markers);
            }
        });
    }
}
