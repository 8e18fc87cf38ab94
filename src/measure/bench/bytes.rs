//! Least memory traffic of a solve for the pressure: reads and writes of each array that a kernel needs, once. Data that neighbouring threads
//! share, or that the padding of rows repeats, is cached.

use crate::scene::Preconditioner;

/// Sizes that decide the bytes of a solve.
#[derive(Clone, Copy, Debug)]
pub(super) struct SolveBytes {
    /// Active cells.
    pub(super) unknowns: f64,
    /// Share of their quads with stored weights.
    pub(super) not_uniform: f64,
    /// Iterations of conjugate gradients, over all refinement steps.
    pub(super) iterations: f64,
    /// Refinement steps.
    pub(super) refinements: f64,
    /// Bytes of a scalar of the corrections, and of the outer loop.
    pub(super) widths: [f64; 2],
    /// Preconditioner.
    pub(super) preconditioner: Preconditioner,
}

impl SolveBytes {
    /// A solve and its set-up.
    pub(super) fn total(&self) -> f64 {
        // Of the pressure system and its hierarchy: distance and apertures in, the matrix out.
        self.unknowns * (4.0 * 4.0 + 5.0 * self.widths[0] * 8.0 / 7.0) + self.pressure()
    }

    /// A solve for the pressure without its set-up. Per unknown: w bytes for a scalar of the corrections, 8 of the outer loop (4 with `f32`), 5 sections of
    /// the matrix for quads that are not uniform, and a byte of list entries per pass.
    ///
    /// Iteration: apply (s, r, q), update (x and r twice, s, q, z), direction (z, s twice), preconditioner. Preconditioner: a V-cycle with two smoothing
    /// sweeps and one after the prolongation (x, r, x_out each), restriction (x, r), prolongation (x twice) on the finest level, and a seventh of it on
    /// the coarser ones; or the diagonal of all quads (itself, r, z).
    fn pressure(&self) -> f64 {
        let SolveBytes { not_uniform, widths: [inner, outer], .. } = *self;
        let matrix = 5.0 * inner * not_uniform;
        let preconditioner = match self.preconditioner {
            Preconditioner::Multigrid => {
                let sweeps = 3.0 * (3.0 * inner + matrix + 1.0);
                let transfers = (2.0 * inner + matrix + 1.0) + (2.0 * inner + 1.0);
                (sweeps + transfers) * 8.0 / 7.0
            }
            Preconditioner::Jacobi | Preconditioner::BlockJacobi => 3.0 * inner + 1.0,
        };
        let rest = (3.0 * inner + matrix + 1.0) + (7.0 * inner + not_uniform * inner + 1.0) + (3.0 * inner + 1.0);
        let turn = (3.0 * outer + matrix + 1.0) + (2.0 * outer + inner + 1.0) + (outer + 5.0 * inner);
        self.unknowns * (self.iterations * (preconditioner + rest) + (self.refinements + 1.0) * turn)
    }
}
