//! The diagonal of the two-field system as its preconditioner, for comparison. For the liquid it is diag(B) + diag(J
//! Z1^-1 J^T), for the solids diag(Z2 + Z2 Z1^-1 Z2) or the 3x3 blocks of the nodes.

use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Pass, RealBuffer, bind};
use crate::scene::Preconditioner;
use crate::wgsl;

use super::Level;
use super::chebyshev::Polynomial;
use super::coupled::CoupledFields;
use super::solid_solver::Chebyshev;

/// Kernels.
#[derive(Debug)]
pub(super) struct Jacobi {
    n_nodes: usize,
    set_up: Bound,
    quads: Bound,
    nodes: Bound,
    /// t = Sh g_v, which measures convergence: the residual of a product of matrices does not.
    pub(super) polynomial: Chebyshev,
}

impl Jacobi {
    /// Compiles and binds.
    pub(super) fn new(
        gpu: &Gpu,
        at: CoupledFields,
        level: &Buffer<Level>,
        polynomial: &Buffer<Polynomial>,
        kind: Preconditioner,
    ) -> Result<Jacobi, Error> {
        let CoupledFields { liquid, solids, coupling, .. } = at;
        let n_nodes = coupling.n_nodes;
        let diagonal = RealBuffer::new(gpu, "coupled_solver.diagonal", 8 * n_nodes, liquid.variant.real)?;
        let blocks = u32::from(kind == Preconditioner::BlockJacobi);
        let kind = gpu.uniform("coupled_solver.diagonal_kind", &[blocks, 0, 0, 0])?;
        let variant = liquid.variant;
        let own = [("kind", (&kind).into()), ("diagonal", (&diagonal).into())];
        let quads = [("level", level.into()), ("z", (&liquid.z_next).into())];
        Ok(Jacobi {
            n_nodes,
            set_up: bind(gpu, &wgsl!("two_field_diagonal"), variant, own, &at.by_node())?,
            quads: bind(gpu, &wgsl!("couple_jacobi"), variant, quads, &at.by_quad())?,
            nodes: bind(gpu, &wgsl!("two_field_jacobi"), variant.real, own, &at.by_node())?,
            polynomial: Chebyshev::new(gpu, solids, polynomial, &solids.r, &coupling.t)?,
        })
    }

    /// Records the set-up, once matrices and constraints are in place.
    pub(super) fn record_set_up(&self, pass: &mut Pass) {
        pass.dispatch(&self.set_up, self.n_nodes);
    }

    /// Records z_p of the wet quads, after that of B alone, and z_v. `sizes`, and the slots of nodes, solids and wet quads in it.
    pub(super) fn record(&self, pass: &mut Pass, sizes: &Buffer<u32>, [nodes, bodies, wet]: [usize; 3], degree: usize) {
        self.polynomial.record(pass, sizes, [nodes, bodies], degree);
        pass.dispatch_indirect(&self.quads, sizes, wet);
        pass.dispatch_indirect(&self.nodes, sizes, nodes);
    }
}
