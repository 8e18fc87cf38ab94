//! The pressure solver on the GPU: matrix-free conjugate gradients on the cut-cell, ghost-fluid Laplacian. The preconditioner is one symmetric
//! V-cycle of aggregation multigrid. An outer loop refines on the true residual.
//!
//! The unknown is the potential phi = p dt / (rho dx), m/s: B p = E u* of the thesis divided by dx^2 becomes
//!
//! ```text
//!   sum over faces of w_f (phi_c - phi_nb) + dirichlet_c phi_c = b_c = - sum over faces of s_f open_f u*_f       (m/s)
//! ```
//!
//! with w_f the face aperture between two active cells and dirichlet_c the sum of open_f / theta_f over faces towards air. The matrix is
//! stored in f32 and *is* the system of the sub-step; its conversion to f64 is exact.
//!
//! **Storage.** Dense padded arrays of quads, all levels one after another, and a compact list of active quads per level. A list entry is
//! tagged if its quad is uniform: nine in ten quads then load no weights.
//!
//! **Multigrid** (Ng et al. 2009, Shao et al. 2022, Wang et al. 2026). Aggregates have 2x2x2 cells, coarse weights are half the sum of the
//! fine ones. Two sweeps of scheduled-relaxation Jacobi precede the correction, and the same in reversed order follow it. Levels of at most
//! `TAIL_QUADS` quads run in one workgroup.
//!
//! **Outer loop** (`refine.rs`). A refinement step solves for a correction by conjugate gradients, in f32 unless the precision is `f64`. A
//! residual evaluation in the precision of the unknowns follows. Both are recorded ahead. Kernels write the dispatch sizes of later kernels,
//! so nothing waits for the host. |r|^2 after an update follows from the sums of alpha, so that a finished step does not start another
//! V-cycle. Outer loop, acceptance rule and conjugate gradients are the same for every system.
//!
//! **Systems.** The unknown is a list of blocks: pressures of cells, velocities of nodes, or both ([`CoupledSolver`]). The residual of both is
//! that of the indefinite system (thesis 5.17). Their corrections have two forms: the monolithic two-field form, and the Schur-complement form
//! in the pressures alone. The latter has the wet compliance as a dense matrix from a sparse Cholesky factor on the host.
//!
//! Symbols: x correction, r residual, z preconditioned residual, s search direction, q = A s.

mod acceptance;
mod chebyshev;
mod contact_rows;
mod coupled;
mod coupled_host;
mod coupled_rows;
mod hierarchy;
mod host_residual;
mod pcg;
mod pressure;
mod refine;
mod schur;
mod solid_contacts;
mod solid_host;
mod solid_solver;
mod solid_system;
mod stored_stiffness;
mod two_field;
mod two_field_jacobi;
mod weak;

pub use acceptance::{COUPLING_SHARE, RefineSettings, rounding};
pub use chebyshev::Polynomial;
pub use contact_rows::{RowsOf, check_contact};
pub use coupled::{CoupledFields, CoupledOutcome, CoupledSolver};
pub(crate) use coupled_rows::{RowLimits, RowSolves};
pub use hierarchy::{Hierarchy, Tail, TailStep};
pub use pressure::PressureSolver;
pub(crate) use refine::Aim;
pub use refine::Outcome;
pub use schur::{MOST_WETTED, WORTH_WETTED, Wetted, can_condense, check_formulation};
pub use solid_contacts::{ContactSearch, ObstacleField};
pub use solid_solver::SolidSolver;
pub use solid_system::SolidSystem;
pub use weak::{Weak, WeakBuffers};

use crate::grid::Layout;

/// x + factor y.
fn plus(x: &[f64], factor: f64, y: &[f64]) -> Vec<f64> {
    x.iter().zip(y).map(|(x, y)| x + factor * y).collect()
}

/// Room for the steps of the tail: 5 per level and the sweeps that solve the last.
pub const TAIL_STEPS: usize = 48;
/// Iterations between two gates of the one-workgroup kernels.
const BLOCK: usize = 4;

/// Weights of the two sweeps of scheduled-relaxation Jacobi (Yang and Mittal 2014), which damp the upper half of the spectrum of
/// the 7-point operator; the mirrored order after the coarse correction keeps the V-cycle symmetric.
pub const OMEGA: [f32; 2] = [1.7319, 0.5695];

/// A level of the hierarchy.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Level {
    /// Layout.
    pub shape: Layout,
    /// Weight of every inner face of a uniform quad: 2^level.
    pub coefficient: f32,
    /// First word of the level's arguments in `args`.
    pub args: u32,
    /// Nothing.
    pub pad_0: u32,
    /// Nothing.
    pub pad_1: u32,
}

/// A sweep of the smoother.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Sweep {
    /// Relaxation weight.
    pub omega: f32,
    /// 1 when the sweep ends a V-cycle.
    pub ends_cycle: u32,
    /// Nothing.
    pub pad_0: u32,
    /// Nothing.
    pub pad_1: u32,
}

/// State machine of a solve.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Control {
    /// 1 during a refinement step.
    pub running: u32,
    /// A `STATUS_*` of the shader.
    pub status: u32,
    /// Iterations of conjugate gradients in all refinement steps.
    pub iterations: u32,
    /// Limit of the iterations.
    pub max_iterations: u32,
    /// 1 until the first iteration of the refinement step is over.
    pub first: u32,
    /// Refinement steps begun.
    pub refinements: u32,
    /// Active cells, or free components of nodes.
    pub unknowns: u32,
    /// Lists whose dispatch sizes open during a refinement step.
    pub n_lists: u32,
}
