//! Bytes that solves and the stages of solids must move: every array that a kernel needs, once, reads and writes. What neighbouring threads share
//! comes out of a cache; so does what the padding of the rows repeats.

use crate::elastic::{Incidence, Solids};
use crate::scene::Preconditioner;

/// Bytes of a flag, a number of the mesh's topology, or an f32.
const WORD: f64 = 4.0;
/// Bytes of four f32.
const VEC4: f64 = 16.0;

/// Sizes that decide the bytes of the solids' stages.
#[derive(Clone, Copy, Debug)]
pub(super) struct SolidBytes {
    pub(super) nodes: f64,
    pub(super) elements: f64,
    /// Nodes of bodies that move on circles where they turn.
    turning: f64,
    /// 3x3 blocks of the stiffness off its diagonal.
    blocks: f64,
    /// Bytes of a scalar of velocities and residuals.
    real: f64,
    /// Bytes of a scalar of the preconditioner.
    inner: f64,
}

impl SolidBytes {
    /// Of some solids on a device that holds scalars in so many bytes: of velocities, of the preconditioner.
    pub(super) fn new(solids: &Solids, [real, inner]: [usize; 2]) -> SolidBytes {
        let topology = Incidence::new(solids.rest.len(), &solids.elements);
        SolidBytes {
            nodes: solids.rest.len() as f64,
            elements: solids.elements.len() as f64,
            turning: solids
                .rotating_bodies()
                .map(|body| body.nodes.len() as f64)
                .sum(),
            blocks: topology.n_blocks() as f64,
            real: real as f64,
            inner: inner as f64,
        }
    }

    /// A vector per node.
    fn vectors(&self, how_many: f64) -> f64 {
        how_many * 4.0 * self.real * self.nodes
    }

    /// Three vectors per element: rotated gradients, products or forces.
    fn of_elements(&self, how_many: f64) -> f64 {
        how_many * 12.0 * self.real * self.elements
    }

    /// The corners of the nodes, and where they start.
    fn incidence(&self) -> f64 {
        WORD * (self.nodes + 4.0 * self.elements)
    }

    /// A stage other than `solve`; 0 for those that do nothing to solids.
    pub(super) fn of_stage(&self, stage: &str, scripts: bool, obstacles: bool) -> f64 {
        let (n, m) = (self.nodes, self.elements);
        let [scripts, obstacles] = [scripts, obstacles].map(|there| f64::from(u8::from(there)));
        match stage {
            // Rest position, flags, displacement in two parts read and written, velocity. Of what turns rest position, displacement and
            // velocity, both read and written.
            "move_solid" => {
                let still = n * (VEC4 + WORD + 2.0 * VEC4) + self.vectors(1.0);
                let turning = self.turning * (5.0 * VEC4 + 8.0 * self.real);
                still + n * 2.0 * VEC4 + turning
            }
            // Flags, velocity read and written.
            "forces" => n * (WORD + scripts * VEC4) + self.vectors(2.0),
            // Nodes, displacement in two parts, damping; gradients in, rotated and forces out.
            "solid_matrices" => {
                let rotations = m * (VEC4 + 2.0 * WORD) + n * 2.0 * VEC4 + self.of_elements(3.0);
                rotations + self.of_rows()
            }
            // Flags, masses, velocity, load; forces of the elements; sum out. Then who is held, and the diagonals.
            "right_hand_side" => {
                let sum = n * (WORD + VEC4) + self.vectors(3.0) + self.incidence();
                sum + self.of_elements(1.0) + self.of_contacts(obstacles) + self.of_diagonals()
            }
            // Rest position and displacement in two parts, velocity; determinants and energies: a vector each.
            "diagnose" => n * 3.0 * VEC4 + self.vectors(1.0) + m * 2.0 * 4.0 * self.real,
            _ => 0.0,
        }
    }

    /// The rows of the preconditioner, from the rotated elements.
    pub(super) fn of_rows(&self) -> f64 {
        let m = self.elements;
        // Twelve joints per element, where those of each block start, its column; the block out.
        let joints = WORD * (12.0 * m + 2.0 * self.blocks);
        self.of_elements(1.0) + joints + 12.0 * self.inner * self.blocks
    }

    /// The blocks on the diagonal, and what holds the nodes.
    fn of_diagonals(&self) -> f64 {
        // Freedom, mass, load; mass term, mean of the diagonal and inverse out.
        let nodes = self.nodes * (2.0 * VEC4 + 2.0 * self.real + 12.0 * self.inner);
        self.of_elements(1.0) + self.incidence() + nodes + self.vectors(1.0)
    }

    /// Which nodes walls and obstacles hold from the start, and the velocities of those.
    fn of_contacts(&self, obstacles: f64) -> f64 {
        // Rest position, flags, displacement in two parts, force; gaps and freedom out.
        let walls = self.nodes * (5.0 * VEC4 + WORD) + self.vectors(1.0);
        // The same, with the distance instead of the flags.
        let touch = walls * (1.0 + obstacles);
        // Gaps, freedom; few velocities.
        touch + self.nodes * 2.0 * VEC4
    }

    /// A product of the polynomial of the preconditioner: one step of its iteration.
    fn of_step(&self) -> f64 {
        let n = self.nodes;
        // Node of the row, its inverse, residual, iterate in and out, increment in and out.
        let row = n * (WORD + (8.0 + 4.0 * 4.0) * self.inner) + self.vectors(1.0);
        row + 12.0 * self.inner * self.blocks
    }

    /// The polynomial of the preconditioner.
    fn of_polynomial(&self, degree: f64) -> f64 {
        // The first step has no product; the last gives the answer and the share of r . z.
        let first = self.nodes * (WORD + 16.0 * self.inner) + self.vectors(1.0);
        first + degree * self.of_step() + self.vectors(2.0)
    }

    /// A product of S with a vector, from the elements, and its sums over the nodes with `others` more vectors.
    fn of_product(&self, others: f64) -> f64 {
        let (n, m) = (self.nodes, self.elements);
        // Nodes, rotated gradients, vector; products written, and read by the gather.
        let products = m * VEC4 + self.of_elements(2.0) + self.vectors(1.0);
        let gather = self.incidence() + self.of_elements(1.0) + n * (VEC4 + self.real);
        products + gather + self.vectors(1.0 + others)
    }

    /// A solve, the rows of its preconditioner given.
    pub(super) fn of_solve(&self, degree: f64, iterations: f64, rounds: f64) -> f64 {
        // Its shares of r . z are summed.
        let polynomial = self.of_polynomial(degree) + self.vectors(1.0);
        // Answer, direction read and written.
        let direction = self.vectors(3.0);
        // Residual; product and partials, which are summed.
        let operator = self.of_product(4.0);
        // Direction, correction and residual read and written, product.
        let update = self.vectors(6.0);
        let iteration = polynomial + direction + operator + update;
        // Who is held in the next solve: right-hand side, velocity, gaps, the mean of the diagonal.
        let update = self.of_product(1.0) + self.nodes * (VEC4 + self.real);
        self.of_outer_loop(rounds) + iterations * iteration + update
    }

    /// The outer loop of a solve: what it starts from, and the turns from round to round.
    pub(super) fn of_outer_loop(&self, rounds: f64) -> f64 {
        // Correction, unknowns read and written; right-hand side, residual and partials, which are summed; then residual in and
        // out, direction and correction out; the mean of the diagonal.
        let turn = self.vectors(7.0) + self.of_product(4.0) + self.nodes * self.real;
        // The guess: freedom, velocity read and written, correction.
        let start = self.nodes * VEC4 + self.vectors(3.0) + turn;
        start + (rounds + 1.0) * turn
    }

    /// Solids' part of an iteration of a two-field solve (symbols as in `solver/two_field.rs`).
    pub(super) fn of_two_field(&self, preconditioner: Preconditioner, degree: f64) -> f64 {
        let polynomial = self.of_polynomial(degree);
        let preconditioner = match preconditioner {
            // Two: y from t; then residual, t, z read and written, partials, which are summed.
            Preconditioner::Multigrid => 2.0 * polynomial + self.vectors(8.0),
            // One, which tells how far a round is: residual, the diagonal's two parts, t, z, partials, which are summed.
            Preconditioner::Jacobi | Preconditioner::BlockJacobi => polynomial + self.vectors(7.0),
        };
        // Freedom, masses.
        let preconditioner = preconditioner + self.nodes * (VEC4 + self.real);
        // J^T p; t in its place, v - t, partials, which are summed; then the product with v - t.
        let operator = self.vectors(1.0) + self.of_product(5.0) + self.of_product(1.0);
        // As in `of_solve`.
        let (direction, update) = (self.vectors(3.0), self.vectors(6.0));
        preconditioner + operator + direction + update
    }
}

/// Form of the corrections of a solve for liquid and solids.
#[derive(Clone, Copy, Debug)]
pub(super) enum Corrections {
    /// Pressures and velocities.
    TwoField {
        /// Of the solids' polynomial.
        degree: usize,
    },
    /// Pressures alone.
    Condensed {
        /// Nodes among which there is a dense inverse.
        wet_nodes: usize,
    },
}

/// Sizes that decide the bytes of a solve.
#[derive(Clone, Copy, Debug)]
pub(super) struct SolveBytes {
    /// Active cells.
    pub(super) unknowns: f64,
    /// Share of their quads whose weights are loaded.
    pub(super) not_uniform: f64,
    /// Of conjugate gradients, in all rounds.
    pub(super) iterations: f64,
    /// Rounds.
    pub(super) rounds: f64,
    /// Bytes of a scalar of the corrections, and of the outer loop.
    pub(super) widths: [f64; 2],
    /// Of the pressure, and with solids of both.
    pub(super) preconditioner: Preconditioner,
}

impl SolveBytes {
    /// The set-up of the system of the pressure and of its hierarchy: distance and open fractions in, the matrix out.
    pub(super) fn of_set_up(&self) -> f64 {
        let [inner, _] = self.widths;
        self.unknowns * (4.0 * 4.0 + 5.0 * inner * 8.0 / 7.0)
    }

    /// A solve for the pressure, its system given. Per unknown: w bytes a scalar of the corrections, 8 of the outer loop (4 with `f32`), 5
    /// sections of the matrix for the share of quads that are not uniform; list entries, a byte per cell and pass.
    ///
    /// An iteration: apply (s, r, q), update (x and r twice, s, q, z), direction (z, s twice), preconditioner. That is a V-cycle: on the finest
    /// level two smoothing sweeps and the one after the prolongation (x, r, x_out each), restriction (x, r), prolongation (x twice), and
    /// a seventh of it on the coarser ones; or the diagonal of all quads (itself, r, z).
    pub(super) fn of_pressure(&self) -> f64 {
        let SolveBytes {
            not_uniform,
            widths: [inner, outer],
            ..
        } = *self;
        let matrix = 5.0 * inner * not_uniform;
        let preconditioner = match self.preconditioner {
            Preconditioner::Multigrid => {
                let sweeps = 3.0 * (3.0 * inner + matrix + 1.0);
                let transfers = (2.0 * inner + matrix + 1.0) + (2.0 * inner + 1.0);
                (sweeps + transfers) * 8.0 / 7.0
            }
            Preconditioner::Jacobi | Preconditioner::BlockJacobi => 3.0 * inner + 1.0,
        };
        let rest = (3.0 * inner + matrix + 1.0)
            + (7.0 * inner + not_uniform * inner + 1.0)
            + (3.0 * inner + 1.0);
        let turn =
            (3.0 * outer + matrix + 1.0) + (2.0 * outer + inner + 1.0) + (outer + 5.0 * inner);
        self.unknowns * (self.iterations * (preconditioner + rest) + (self.rounds + 1.0) * turn)
    }

    /// A solve for the pressure and the velocities of solids, both systems given. The outer loop counts as that of the solids by
    /// themselves; what it has beside is little, as are the pairs of cells and nodes.
    pub(super) fn of_both(&self, solids: &SolidBytes, corrections: Corrections) -> f64 {
        let iteration = match corrections {
            Corrections::TwoField { degree } => {
                solids.of_two_field(self.preconditioner, degree as f64)
            }
            // The inverse in f32, three components a node; vectors of the nodes are little beside it.
            Corrections::Condensed { wet_nodes } => 4.0 * (3.0 * wet_nodes as f64).powi(2),
        };
        self.of_pressure() + solids.of_outer_loop(self.rounds) + self.iterations * iteration
    }
}
