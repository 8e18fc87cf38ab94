//! `right_hand_side`: b = - sum over faces of s_f open_f u*_f, m/s (thesis 4.38 over dx^2), plus what volume control adds in
//! components with a free surface, less what obstacles take up that move.

use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Kernel, RealBuffer, Recorder};
use crate::wgsl;

use super::{Active, LiquidBuffers};

/// The stage: `velocity_next` to the solver's right-hand side, over the active quads; the means over components without a
/// free surface are still in it.
#[derive(Debug)]
pub struct RightHandSide {
    right_hand_side: Bound,
    take_up: Option<Bound>,
}

impl RightHandSide {
    /// The stage's name.
    pub const NAME: &'static str = "right_hand_side";

    /// Compiles and binds. `rhs`: m/s, as many as padded cells.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(
        gpu: &Gpu,
        buffers: &LiquidBuffers,
        active: &Active,
        rhs: &RealBuffer,
    ) -> Result<RightHandSide, Error> {
        let right_hand_side = Kernel::new(gpu, &wgsl!("right_hand_side"), rhs.real)?.bind(
            gpu,
            &[
                ("level", (&buffers.level).into()),
                ("step", (&buffers.step).into()),
                ("args", active.args.into()),
                ("list", active.list.into()),
                ("flags", active.flags.into()),
                ("velocity", (&buffers.velocity_next).into()),
                ("open", buffers.flux_open().into()),
                ("solid_distance", (&buffers.obstacles.solid_distance).into()),
                ("report", (&buffers.report).into()),
                ("rhs", rhs.into()),
            ],
        )?;
        let take_up = |flux: &Buffer<f32>| {
            Kernel::new(gpu, &wgsl!("take_up"), rhs.real)?.bind(
                gpu,
                &[
                    ("args", active.args.into()),
                    ("list", active.list.into()),
                    ("flags", active.flags.into()),
                    ("obstacle_flux", flux.into()),
                    ("rhs", rhs.into()),
                ],
            )
        };
        Ok(RightHandSide {
            right_hand_side,
            take_up: buffers.obstacle_flux.as_ref().map(take_up).transpose()?,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder, active: &Active) {
        recorder.stage(RightHandSide::NAME, |pass| {
            pass.dispatch_indirect(&self.right_hand_side, active.args, 0);
            if let Some(take_up) = &self.take_up {
                pass.dispatch_indirect(take_up, active.args, 0);
            }
        });
    }
}
