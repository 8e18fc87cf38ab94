//! The pressure solver on the GPU: matrix-free conjugate gradients on the cut-cell, ghost-fluid Laplacian, preconditioned by one
//! symmetric V-cycle of aggregation multigrid, inside an outer loop that refines on the true residual.
//!
//! The unknown is the potential phi = p dt / (rho dx), m/s: B p = E u* of the thesis divided by dx^2 becomes
//!
//! ```text
//!   sum over faces of w_f (phi_c - phi_nb) + dirichlet_c phi_c = b_c = - sum over faces of s_f open_f u*_f       (m/s)
//! ```
//!
//! with w_f the open fraction between two active cells and dirichlet_c the sum of open_f / theta_f over faces towards air.
//! The matrix is stored in f32 and *is* the system of the step; widening it to f64 is exact.
//!
//! **Storage.** Dense padded arrays of quads, all levels one after another, and a compact list of active quads per level. A list
//! entry is tagged when its quad is uniform, which spares the weights' loads for nine quads in ten.
//!
//! **Multigrid** (design section 5; Ng et al. 2009, Shao et al. 2022, Wang et al. 2026): 2x2x2 aggregates, coarse weights half the sum
//! of the fine ones, two sweeps of scheduled-relaxation Jacobi before and, mirrored, after; levels of at most [`TAIL_QUADS`]
//! quads run in one workgroup.
//!
//! **Rounds.** A round is a PCG solve for a correction, in f32 unless the precision is `f64`; between rounds ("turn") the residual
//! is evaluated in the precision of the unknowns. All of it is recorded ahead; kernels on the device open and close the
//! dispatch sizes of what follows, so nothing waits for the host. |r|^2 after an update is computed from the sums that give
//! alpha, so that a finished round does not start another V-cycle. State machine and outer loop are the same for every system of
//! quads, whatever their four scalars stand for.
//!
//! **Liquid and solids together** ([`CoupledSolver`]): one outer loop on the residual of the indefinite system (thesis 5.17), two
//! forms of the corrections: pressures and velocities, all on the device; or pressures alone, with S^-1 among the wet nodes as a dense
//! matrix that the host makes from a sparse Cholesky factor.
//!
//! Letters: x correction, r residual, z preconditioned residual, s search direction, q = B s.

mod acceptance;
mod chebyshev;
mod components;
mod coupled;
mod coupled_host;
mod coupling;
mod hierarchy;
mod host_residual;
mod patch_pressure;
mod pcg;
mod pressure;
mod refine;
mod schur;
mod solid_contacts;
mod solid_host;
mod solid_solver;
mod solid_system;
mod stored_stiffness;
mod system;
mod two_field;
mod two_field_jacobi;
mod weak;

pub use acceptance::{COUPLING_SHARE, RefineSettings, rounding};
pub use chebyshev::Polynomial;
pub use components::{Components, Seal};
pub use coupled::{CoupledFields, CoupledOutcome, CoupledSolver};
pub use coupling::{Coupling, CouplingBuffers, CouplingSize, Pair, REPORT_WORDS};
pub use hierarchy::{Hierarchy, Tail, TailStep};
pub use patch_pressure::{OpenFaces, PatchPressure, PressureSlope};
pub use pressure::PressureSolver;
pub use refine::Outcome;
pub use schur::{MOST_WETTED, WORTH_WETTED, Wetted, can_condense, check_formulation};
pub use solid_contacts::{ContactSearch, ObstacleField};
pub use solid_solver::SolidSolver;
pub use solid_system::{Rows, SolidRows, SolidSystem, SolidSystemBuffers};
pub use system::{
    ActiveSettings, Everywhere, FreeSurface, LevelPlan, PressureSystem, SolverBuffers, Within,
    variant,
};
pub use weak::{Weak, WeakBuffers};

use crate::Error;
use crate::gpu::{Arrays, Binding, Bound, Gpu, Kernel, Source, Variant};
use crate::grid::Layout;

/// Binds a kernel: the variables in `own` to these arrays, every other to the array of its name in the first table that has one.
fn bind<const N: usize>(
    gpu: &Gpu,
    source: &Source,
    variant: impl Into<Variant>,
    own: [(&str, Binding); N],
    tables: &[&dyn Arrays],
) -> Result<Bound, Error> {
    let own: &dyn Arrays = &own;
    Kernel::new(gpu, source, variant)?.bind_arrays(gpu, &[&[own], tables].concat())
}

/// Largest number of quads, spare ones counted, of the levels that one workgroup handles; `vcycle_tail.wgsl` has it too.
pub const TAIL_QUADS: usize = 256;
/// Most levels in the tail.
pub const TAIL_LEVELS: usize = 8;
/// Room for the steps of the tail: 5 per level and the sweeps that solve the last.
pub const TAIL_STEPS: usize = 48;
/// Iterations between two gates of the one-workgroup kernels.
const BLOCK: usize = 4;
/// Threads of the first level of a long sum; `fold_partials.wgsl` has it too.
pub const FOLD_THREADS: usize = 4096;

/// Weights of the two sweeps of scheduled-relaxation Jacobi (Yang and Mittal 2014), which damp the upper half of the spectrum of
/// the 7-point operator; the mirrored order after the coarse correction keeps the V-cycle symmetric.
pub const OMEGA: [f32; 2] = [1.7319, 0.5695];

/// The doppelganger of `Level` in `shaders/common/level.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Level {
    /// Where the level lies.
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

/// The doppelganger of `Sweep` in `shaders/common/sweep.wgsl`.
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

/// The doppelganger of `Control` in `shaders/common/control_state.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Control {
    /// 1 while a round goes on.
    pub running: u32,
    /// A `STATUS_*` of the shader.
    pub status: u32,
    /// PCG iterations in all rounds.
    pub iterations: u32,
    /// Where to stop.
    pub max_iterations: u32,
    /// 1 until the round has made its first step.
    pub first: u32,
    /// Rounds begun.
    pub rounds: u32,
    /// Active cells, or free components of nodes.
    pub unknowns: u32,
    /// Lists whose dispatch sizes open while a round runs.
    pub n_lists: u32,
}
