//! Weak coupling: the pressure is solved with the old velocities of the nodes, then the solids under that pressure. Two separate
//! solves; this file has the terms that couple them.

use crate::Error;
use crate::fields::{CouplingBuffers, SolidBuffers, SolidSystemBuffers, SolverBuffers};
use crate::gpu::{Bound, Buffer, Gpu, Pass, RealBuffer, Recorder, bind};
use crate::step::Stage;
use crate::wgsl;

/// Arrays of weak coupling.
#[derive(Debug)]
pub struct WeakBuffers {
    /// Velocities before the sub-step, m/s.
    pub before: RealBuffer,
    /// Node flags without a free component: solids give way too late to fix the level of a pressure.
    pub held: Buffer<u32>,
}

impl WeakBuffers {
    /// Allocates.
    pub fn new(gpu: &Gpu, solids: &SolidSystemBuffers) -> Result<WeakBuffers, Error> {
        let n = solids.sizes.n_nodes as usize;
        Ok(WeakBuffers {
            before: RealBuffer::new(gpu, "weak.before", 4 * n, solids.variant.real)?,
            held: gpu.buffer("weak.held", n.next_multiple_of(4))?,
        })
    }

    /// Records, before anything moves, what the pressure will be solved against.
    pub fn record(&self, to: &mut Recorder, fields: &SolidBuffers) {
        to.copy(&fields.velocity.words, &self.before.words);
    }
}

/// The kernels.
#[derive(Debug)]
pub struct Weak {
    /// b, then b - J v outside enclosed components.
    against: [Bound; 2],
    push: Bound,
    n_quads: usize,
    n_nodes: usize,
}

impl Weak {
    /// Compiles and binds.
    pub fn new(
        gpu: &Gpu,
        (liquid, solids): (&SolverBuffers, &SolidSystemBuffers),
        fields: &SolidBuffers,
        coupling: &CouplingBuffers,
        buffers: &WeakBuffers,
    ) -> Result<Weak, Error> {
        let real = liquid.variant.real;
        let before = [("x", (&buffers.before).into())];
        let pushed = [("p", (&liquid.potential).into()), ("node_flags", (&fields.flags).into())];
        let at_components = gpu.at(Stage::ClosedComponents.name());
        let against = |source, own| bind(&at_components, &source, real, own, &[coupling, liquid]);
        let at_solve = gpu.at(Stage::Solve.name());
        Ok(Weak {
            against: [against(wgsl!("couple_keep"), before)?, against(wgsl!("couple_residual"), before)?],
            push: bind(&at_solve, &wgsl!("weak_push"), real, pushed, &[coupling, solids, liquid])?,
            n_quads: coupling.size.quads,
            n_nodes: coupling.n_nodes,
        })
    }

    /// Records the flux of the nodes outside enclosed components, once the right-hand side of the pressure is in place.
    pub fn record_against(&self, pass: &mut Pass) {
        for bound in &self.against {
            pass.dispatch(bound, self.n_quads);
        }
    }

    /// Records what the pressure found does to the right-hand side of the solids.
    pub fn record_push(&self, pass: &mut Pass) {
        pass.dispatch(&self.push, self.n_nodes);
    }
}
