//! `write_back`: u = u* - dt/(rho dx) (p_+ - p_-) on every open face with an active side (thesis 4.36).

use crate::Error;
use crate::gpu::{Bound, Gpu, Kernel, Real, RealBuffer, Recorder};
use crate::wgsl;

use super::{Active, LiquidBuffers, over_band};

/// The stage: `velocity_next` and the potential to `velocity`, and the faces that are `valid` now. Other faces become 0.
#[derive(Debug)]
pub struct WriteBack {
    n_tiles: usize,
    still_air: Bound,
    write_back: Bound,
}

impl WriteBack {
    /// The stage's name.
    pub const NAME: &'static str = "write_back";

    /// Compiles and binds. `potential`: p dt / (rho dx), m/s, as many as padded cells; only active lanes are read.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(
        gpu: &Gpu,
        buffers: &LiquidBuffers,
        active: &Active,
        potential: &RealBuffer,
    ) -> Result<WriteBack, Error> {
        let [level, args, list] = over_band(buffers);
        let write_back = Kernel::new(gpu, &wgsl!("write_back"), potential.real)?.bind(
            gpu,
            &[
                level,
                args,
                list,
                ("step", (&buffers.step).into()),
                ("flags", active.flags.into()),
                ("velocity_next", (&buffers.velocity_next).into()),
                ("liquid_distance", (&buffers.liquid_distance).into()),
                ("potential", potential.into()),
                ("velocity", (&buffers.velocity).into()),
                ("valid", (&buffers.valid).into()),
            ],
        )?;
        let still_air = Kernel::new(gpu, &wgsl!("still_air"), Real::F32)?.bind(
            gpu,
            &[
                level,
                ("tiles", (&buffers.tiles).into()),
                ("dilated", (&buffers.dilated).into()),
                ("velocity", (&buffers.velocity).into()),
            ],
        )?;
        Ok(WriteBack {
            n_tiles: buffers.plan.tiles().len(),
            still_air,
            write_back,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder, buffers: &LiquidBuffers) {
        recorder.stage(WriteBack::NAME, |pass| {
            pass.dispatch(&self.still_air, self.n_tiles);
            pass.dispatch_indirect(&self.write_back, &buffers.band_args, 0);
        });
    }
}
