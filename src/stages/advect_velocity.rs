//! `advect_velocity`: u*(x) = u(x - dt u(x - dt/2 u(x))) per face, semi-Lagrangian along the midpoint rule (Stam 1999).

use crate::Error;
use crate::gpu::{Bound, Gpu, Kernel, Pass, Real, Recorder};
use crate::wgsl;

use super::{LiquidBuffers, over_band};

/// The stage: `velocity` to `velocity_next` on the band.
#[derive(Debug)]
pub struct AdvectVelocity {
    advect_velocity: Bound,
}

impl AdvectVelocity {
    /// The stage's name.
    pub const NAME: &'static str = "advect_velocity";

    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(gpu: &Gpu, buffers: &LiquidBuffers) -> Result<AdvectVelocity, Error> {
        let [level, args, list] = over_band(buffers);
        let advect_velocity = Kernel::new(gpu, &wgsl!("advect_velocity"), Real::F32)?.bind(
            gpu,
            &[
                level,
                args,
                list,
                ("step", (&buffers.step).into()),
                ("velocity", (&buffers.velocity).into()),
                ("quads", (&buffers.velocity).into()),
                ("velocity_next", (&buffers.velocity_next).into()),
            ],
        )?;
        Ok(AdvectVelocity { advect_velocity })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder, buffers: &LiquidBuffers) {
        recorder.stage(AdvectVelocity::NAME, |pass: &mut Pass| {
            pass.dispatch_indirect(&self.advect_velocity, &buffers.band_args, 0);
        });
    }
}
