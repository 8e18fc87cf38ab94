//! The diagonal of the two-field system as its preconditioner, for comparison: of the rows of the liquid
//! diag(B) + diag(J Z1^-1 J^T), of those of the solids diag(Z2 + Z2 Z1^-1 Z2), or the 3x3 blocks of the nodes.

use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Pass, RealBuffer};
use crate::scene::Preconditioner;

use super::Level;
use super::chebyshev::Polynomial;
use super::solid_solver::Chebyshev;
use super::two_field::CoupledFields;

/// Its kernels.
#[derive(Debug)]
pub(super) struct Jacobi {
    n_nodes: usize,
    set_up: Bound,
    quads: Bound,
    nodes: Bound,
    /// t = Sh g_v, which tells how far a round is: a residual of a product of matrices does not.
    pub(super) polynomial: Chebyshev,
}

const DIAGONAL: &str = "coupled_solver.diagonal";
const KIND: &str = "coupled_solver.diagonal_kind";

impl Jacobi {
    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Gpu::buffer`].
    pub(super) fn new(
        gpu: &Gpu,
        at: CoupledFields,
        level: &Buffer<Level>,
        polynomial: &Buffer<Polynomial>,
        kind: Preconditioner,
    ) -> Result<Jacobi, Error> {
        let CoupledFields {
            liquid,
            solids,
            fields,
            coupling,
            ..
        } = at;
        let n_nodes = coupling.n_nodes;
        let diagonal = RealBuffer::new(gpu, DIAGONAL, 8 * n_nodes, liquid.variant.real)?;
        let blocks = u32::from(kind == Preconditioner::BlockJacobi);
        let kind = gpu.uniform(KIND, &[blocks, 0, 0, 0])?;
        let kernel = |source| Kernel::new(gpu, source, liquid.variant);
        let joint = ("coupling", (&coupling.coupling).into());
        let freedom = ("freedom", fields.freedom.into());
        let masses = ("masses", (&solids.masses).into());
        let partials = ("partials", (&coupling.partials).into());
        Ok(Jacobi {
            n_nodes,
            set_up: kernel(&crate::wgsl!("two_field_diagonal"))?.bind(
                gpu,
                &[
                    joint,
                    ("rows", (&solids.rows).into()),
                    ("kind", (&kind).into()),
                    ("list", (&solids.list).into()),
                    ("blocks", (&solids.blocks).into()),
                    freedom,
                    masses,
                    ("rotated", fields.rotated.into()),
                    ("incidence", (&solids.incidence).into()),
                    ("diagonal", (&diagonal).into()),
                ],
            )?,
            quads: kernel(&crate::wgsl!("couple_jacobi"))?.bind(
                gpu,
                &[
                    joint,
                    ("level", level.into()),
                    ("words", (&coupling.words).into()),
                    ("pairs", (&coupling.quad_pairs).into()),
                    freedom,
                    masses,
                    ("matrix", (&liquid.matrix).into()),
                    ("r", (&liquid.r).into()),
                    ("z", (&liquid.z_next).into()),
                    partials,
                ],
            )?,
            nodes: Kernel::new(gpu, &crate::wgsl!("two_field_jacobi"), liquid.variant.real)?.bind(
                gpu,
                &[
                    joint,
                    ("r", (&solids.r).into()),
                    ("diagonal", (&diagonal).into()),
                    freedom,
                    masses,
                    ("t", (&coupling.t).into()),
                    ("z", (&solids.z).into()),
                    partials,
                ],
            )?,
            polynomial: Chebyshev::new(gpu, solids, polynomial, &solids.r, &coupling.t)?,
        })
    }

    /// Records the set-up, once the matrices and what is held are known.
    pub(super) fn record_set_up(&self, pass: &mut Pass) {
        pass.dispatch(&self.set_up, self.n_nodes);
    }

    /// Records z_p of the wet quads, after that of B alone, and z_v. `sizes`, and the slots of nodes, solids and wet quads in it.
    pub(super) fn record(
        &self,
        pass: &mut Pass,
        sizes: &Buffer<u32>,
        [nodes, bodies, wet]: [usize; 3],
        degree: usize,
    ) {
        self.polynomial.record(pass, sizes, [nodes, bodies], degree);
        pass.dispatch_indirect(&self.quads, sizes, wet);
        pass.dispatch_indirect(&self.nodes, sizes, nodes);
    }
}
