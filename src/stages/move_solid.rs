//! `move_solid`: x = x* + dt v; nodes beyond a wall are put on it and lose their velocity into it.
//!
//! Bodies that nothing holds, and those on hinges, move on circles where they turn. No prescribed component is stopped by walls; what is
//! inside an obstacle is for the solve.

use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Recorder};
use crate::wgsl;

use super::SolidBuffers;

/// Threads for a body that turns: `FOLD_SIZE` in `shaders/common/tree.wgsl`.
const TURNING_THREADS: usize = 256;

/// The stage: `displacement` and `velocity` in place, by the velocity of the last sub-step.
#[derive(Debug)]
pub struct MoveSolid {
    n_nodes: usize,
    n_turning: usize,
    turn_solids: Option<Bound>,
    move_solid: Bound,
}

impl MoveSolid {
    /// The stage's name.
    pub const NAME: &'static str = "move_solid";

    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(gpu: &Gpu, solids: &SolidBuffers) -> Result<MoveSolid, Error> {
        let kernel = |source| Kernel::new(gpu, &source, solids.plan.real);
        let step = ("step", (&solids.step).into());
        let rest = ("rest", (&solids.rest).into());
        let flags = ("flags", (&solids.flags).into());
        let displacement = ("displacement", (&solids.displacement).into());
        let velocity = ("velocity", (&solids.velocity).into());
        let turn_solids = |bodies: &Buffer<[u32; 4]>| {
            let bodies = ("bodies", bodies.into());
            kernel(wgsl!("turn_solids"))?
                .bind(gpu, &[step, bodies, rest, flags, displacement, velocity])
        };
        Ok(MoveSolid {
            n_nodes: solids.plan.n_nodes,
            n_turning: solids.plan.n_turning,
            turn_solids: solids.turning.as_ref().map(turn_solids).transpose()?,
            move_solid: kernel(wgsl!("move_solid"))?
                .bind(gpu, &[step, rest, flags, displacement, velocity])?,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder) {
        recorder.stage(MoveSolid::NAME, |pass| {
            if let Some(turn_solids) = &self.turn_solids {
                // A workgroup each.
                pass.dispatch(turn_solids, TURNING_THREADS * self.n_turning);
            }
            pass.dispatch(&self.move_solid, self.n_nodes);
        });
    }
}
