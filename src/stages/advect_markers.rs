//! `advect_markers`: x1 = x + dt u(x + dt/2 u(x)), kept off the walls, then out of obstacles and solids.

use crate::Error;
use crate::gpu::{Bound, Gpu, Kernel, Real, Recorder};
use crate::wgsl;

use super::LiquidBuffers;

/// The stage. Moves the markers by the velocity of the last sub-step; counts those that leave through open sides and those that it
/// drops in the report.
#[derive(Debug)]
pub struct AdvectMarkers {
    n_markers: usize,
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
        let report = ("report", (&buffers.report).into());
        let push_out = || {
            let distance = ("solid_distance", (&buffers.obstacles.solid_distance).into());
            Kernel::new(gpu, &wgsl!("push_out"), Real::F32)?
                .bind(gpu, &[level, step, distance, positions, report])
        };
        Ok(AdvectMarkers {
            n_markers: markers.positions.len(),
            advect_markers: Kernel::new(gpu, &wgsl!("advect_markers"), Real::F32)?
                .bind(gpu, &[level, step, velocity, positions, report])?,
            push_out: buffers.plan.effects.cuts().then(push_out).transpose()?,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder) {
        recorder.stage(AdvectMarkers::NAME, |pass| {
            pass.dispatch(&self.advect_markers, self.n_markers);
            if let Some(push_out) = &self.push_out {
                pass.dispatch(push_out, self.n_markers);
            }
        });
    }
}
