//! `forces`: u* += dt g on the faces.

use crate::Error;
use crate::gpu::{Bound, Gpu, Kernel, Real, Recorder};
use crate::wgsl;

use super::{LiquidBuffers, over_band};

/// The stage: `velocity_next` in place on the band.
#[derive(Debug)]
pub struct Forces {
    forces: Bound,
}

impl Forces {
    /// The stage's name.
    pub const NAME: &'static str = "forces";

    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(gpu: &Gpu, buffers: &LiquidBuffers) -> Result<Forces, Error> {
        let [level, args, list] = over_band(buffers);
        let forces = Kernel::new(gpu, &wgsl!("forces"), Real::F32)?.bind(
            gpu,
            &[
                level,
                args,
                list,
                ("step", (&buffers.step).into()),
                ("velocity_next", (&buffers.velocity_next).into()),
            ],
        )?;
        Ok(Forces { forces })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder, buffers: &LiquidBuffers) {
        recorder.stage(Forces::NAME, |pass| {
            pass.dispatch_indirect(&self.forces, &buffers.band_args, 0);
        });
    }
}
