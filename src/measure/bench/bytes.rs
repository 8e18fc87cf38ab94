//! Least memory traffic of solves: reads and writes of each array that a kernel needs, once. Data that neighbouring threads
//! share, or that the padding of rows repeats, is cached.

use crate::elastic::{Incidence, Solids};
use crate::scene::Preconditioner;

/// Bytes of a flag, an index of the mesh, or an f32.
const WORD: f64 = 4.0;
/// Bytes of four f32.
const VEC4: f64 = 16.0;

/// Sizes that decide the bytes of the solids' part of a solve.
#[derive(Clone, Copy, Debug)]
pub(super) struct SolidBytes {
    nodes: f64,
    elements: f64,
    /// 3x3 blocks of the stiffness off its diagonal.
    blocks: f64,
    /// Bytes of a scalar of the preconditioner, and of velocities and residuals.
    inner: f64,
    real: f64,
    /// Degree of the polynomial of the preconditioner.
    degree: f64,
    /// Nodes of the wet compliance, a dense matrix, where pressures are corrected alone.
    wet_nodes: Option<usize>,
}

impl SolidBytes {
    pub(super) fn new(solids: &Solids, [inner, real]: [f64; 2], degree: u32, wet_nodes: Option<usize>) -> SolidBytes {
        let (nodes, elements) = (solids.rest.len(), &solids.elements);
        let blocks = Incidence::new(nodes, elements).n_blocks() as f64;
        let (nodes, elements) = (nodes as f64, elements.len() as f64);
        SolidBytes { nodes, elements, blocks, real, inner, degree: degree.into(), wet_nodes }
    }

    /// A vector per node.
    fn vectors(&self, how_many: f64) -> f64 {
        how_many * 4.0 * self.real * self.nodes
    }

    /// Three vectors per element: rotated gradients, products or forces.
    fn element_vectors(&self, how_many: f64) -> f64 {
        how_many * 12.0 * self.real * self.elements
    }

    /// The polynomial of the preconditioner.
    fn polynomial(&self) -> f64 {
        // The first step has no product; the last writes z and its share of r . z.
        let first = self.nodes * (WORD + 16.0 * self.inner) + self.vectors(1.0);
        // Node of the row, its inverse, residual, iterate in and out, increment in and out.
        let row = self.nodes * (WORD + (8.0 + 4.0 * 4.0) * self.inner) + self.vectors(1.0);
        let step = row + 12.0 * self.inner * self.blocks;
        first + self.degree * step + self.vectors(2.0)
    }

    /// Product of S with a vector, from the elements, gathered at the nodes with `others` more vectors.
    fn product(&self, others: f64) -> f64 {
        let (n, m) = (self.nodes, self.elements);
        // Nodes, rotated gradients, vector; products written, and read by the gather.
        let products = m * VEC4 + self.element_vectors(2.0) + self.vectors(1.0);
        // Corners of the nodes and their offsets.
        let incidence = WORD * (n + 4.0 * m);
        let gather = incidence + self.element_vectors(1.0) + n * (VEC4 + self.real);
        products + gather + self.vectors(1.0 + others)
    }

    /// The outer loop of a solve: start, and residual evaluations between refinement steps.
    fn outer_loop(&self, refinements: f64) -> f64 {
        // Correction, unknowns read and written; right-hand side, residual and partials, which are summed; then residual in and
        // out, direction and correction out; the mean of the diagonal.
        let turn = self.vectors(7.0) + self.product(4.0) + self.nodes * self.real;
        // Initial guess: constraint projector, velocity read and written, correction.
        let start = self.nodes * VEC4 + self.vectors(3.0) + turn;
        start + (refinements + 1.0) * turn
    }

    /// Solids' part of an iteration of a two-field solve (symbols as in `solver/two_field.rs`).
    fn two_field(&self, preconditioner: Preconditioner) -> f64 {
        let polynomial = self.polynomial();
        let preconditioner = match preconditioner {
            // Two: y from t; then residual, t, z read and written, partials, which are summed.
            Preconditioner::Multigrid => 2.0 * polynomial + self.vectors(8.0),
            // One: residual, the diagonal's two parts, t, z, partials, which are summed.
            Preconditioner::Jacobi | Preconditioner::BlockJacobi => polynomial + self.vectors(7.0),
        };
        // Constraint projector, masses.
        let preconditioner = preconditioner + self.nodes * (VEC4 + self.real);
        // J^T p; t in its place, v - t, partials, which are summed; then the product with v - t.
        let operator = self.vectors(1.0) + self.product(5.0) + self.product(1.0);
        // Direction read and written, z; direction, correction and residual read and written, product.
        let (direction, update) = (self.vectors(3.0), self.vectors(6.0));
        preconditioner + operator + direction + update
    }
}

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
    /// Preconditioner of the pressure, with solids of the coupled system.
    pub(super) preconditioner: Preconditioner,
}

impl SolveBytes {
    /// A solve and its set-up. The outer loop of a coupled solve is that of the solids alone; its other parts are small, as are the pairs of cells and
    /// nodes.
    pub(super) fn total(&self, coupled: Option<SolidBytes>) -> f64 {
        let [inner, _] = self.widths;
        // Of the pressure system and its hierarchy: distance and apertures in, the matrix out.
        let set_up = self.unknowns * (4.0 * 4.0 + 5.0 * inner * 8.0 / 7.0);
        let Some(solids) = coupled else { return set_up + self.pressure() };
        let iteration = match solids.wet_nodes {
            None => solids.two_field(self.preconditioner),
            // The wet compliance in f32, three components per node; vectors of the nodes are small beside it.
            Some(wet_nodes) => 4.0 * (3.0 * wet_nodes as f64).powi(2),
        };
        set_up + (self.pressure() + solids.outer_loop(self.refinements) + self.iterations * iteration)
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
