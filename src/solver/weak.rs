//! Weak coupling: the pressure against the velocities that nodes had before the sub-step, then the solids under that pressure. Each
//! system is solved by itself; what joins them stands here.

use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Pass, RealBuffer, Recorder};
use crate::step::Stage;

use super::coupling::CouplingBuffers;
use super::solid_system::{SolidFields, SolidSystemBuffers};
use super::system::SolverBuffers;

/// What weak coupling keeps.
#[derive(Debug)]
pub struct WeakBuffers {
    /// Velocities before the sub-step, m/s.
    pub before: RealBuffer,
    /// Node flags without a free component: solids give way too late to fix the level of a pressure.
    pub held: Buffer<u32>,
}

impl WeakBuffers {
    /// Allocates.
    ///
    /// # Errors
    /// [`Error::Limit`] where the adapter is too small.
    pub fn new(gpu: &Gpu, solids: &SolidSystemBuffers) -> Result<WeakBuffers, Error> {
        let n = solids.sizes.n_nodes as usize;
        Ok(WeakBuffers {
            before: RealBuffer::new(gpu, "weak.before", 4 * n, solids.variant.real)?,
            held: gpu.buffer("weak.held", n.next_multiple_of(4))?,
        })
    }

    /// Records, before anything moves, what the pressure will be solved against.
    pub fn record(&self, to: &mut Recorder, fields: SolidFields) {
        to.copy(&fields.velocity.words, &self.before.words);
    }
}

/// The kernels.
#[derive(Debug)]
pub struct Weak {
    /// b, then b - J v outside closed components.
    against: [Bound; 2],
    push: Bound,
    n_quads: usize,
    n_nodes: usize,
}

impl Weak {
    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(
        gpu: &Gpu,
        (liquid, solids): (&SolverBuffers, &SolidSystemBuffers),
        fields: SolidFields,
        coupling: &CouplingBuffers,
        buffers: &WeakBuffers,
    ) -> Result<Weak, Error> {
        let joint = ("coupling", (&coupling.coupling).into());
        let words = ("words", (&coupling.words).into());
        let flags = ("flags", (&liquid.flags).into());
        let base = ("base", (&coupling.base).into());
        let rhs = ("rhs", (&liquid.rhs).into());
        let kernel =
            |stage: Stage, source| Kernel::new(&gpu.at(stage.name()), source, liquid.variant.real);
        Ok(Weak {
            against: [
                kernel(Stage::ClosedComponents, &crate::wgsl!("couple_keep"))?
                    .bind(gpu, &[joint, words, rhs, base])?,
                kernel(Stage::ClosedComponents, &crate::wgsl!("couple_residual"))?.bind(
                    gpu,
                    &[
                        joint,
                        words,
                        ("pairs", (&coupling.quad_pairs).into()),
                        flags,
                        ("x", (&buffers.before).into()),
                        base,
                        rhs,
                    ],
                )?,
            ],
            push: kernel(Stage::Solve, &crate::wgsl!("weak_push"))?.bind(
                gpu,
                &[
                    joint,
                    words,
                    ("pairs", (&coupling.node_pairs).into()),
                    flags,
                    ("p", (&liquid.potential).into()),
                    ("node_flags", fields.flags.into()),
                    ("rhs", (&solids.rhs).into()),
                ],
            )?,
            n_quads: coupling.size.quads,
            n_nodes: coupling.n_nodes,
        })
    }

    /// Records what solids take up outside closed components, once the right-hand side of the pressure stands.
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
