//! `forces`, for solids: v* += dt g on free components, prescribed components get what is prescribed.

use crate::Error;
use crate::gpu::{Bound, Gpu, Kernel, Recorder};
use crate::wgsl;

use super::{Forces, SolidBuffers};

/// The stage for the nodes of solids: `velocity` in place.
#[derive(Debug)]
pub struct NodeForces {
    n_nodes: usize,
    node_forces: Bound,
}

impl NodeForces {
    /// The stage's name.
    pub const NAME: &'static str = Forces::NAME;

    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(gpu: &Gpu, solids: &SolidBuffers) -> Result<NodeForces, Error> {
        let node_forces = Kernel::new(gpu, &wgsl!("node_forces"), solids.plan.real)?.bind(
            gpu,
            &[
                ("step", (&solids.step).into()),
                ("flags", (&solids.flags).into()),
                ("prescribed", (&solids.prescribed).into()),
                ("velocity", (&solids.velocity).into()),
            ],
        )?;
        Ok(NodeForces {
            n_nodes: solids.plan.n_nodes,
            node_forces,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder) {
        recorder.stage(NodeForces::NAME, |pass| {
            pass.dispatch(&self.node_forces, self.n_nodes);
        });
    }
}
