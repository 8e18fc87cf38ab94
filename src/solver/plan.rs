//! What the solver allocates besides its fields.

use crate::gpu::{BufferPlan, Range, RealBuffer, Variant};
use crate::grid::Grid;
use crate::scene::{Preconditioner, Solver};

use super::components::STATE_WORDS;
use super::hierarchy::Tail;
use super::pcg::N_SCALARS;
use super::refine::{N_NORMS, RefineSettings};
use super::system::ActiveSettings;
use super::{Control, FOLD_THREADS, Level, LevelPlan, Sweep};

/// Sums that end in a one-workgroup kernel: start and turn of a round, alpha, beta.
const FOLDS: usize = 4;

/// Scalars, dispatch sizes and uniforms of [`PressureSystem`](super::PressureSystem), [`Components`](super::Components) and
/// [`PressureSolver`](super::PressureSolver). Uniforms that are made several times are one line with that many elements.
pub fn small_buffers(grid: &Grid, solver: &Solver, variant: Variant) -> Vec<BufferPlan> {
    let plan = LevelPlan::new(grid);
    let n_levels = plan.len();
    let Variant { real, inner } = variant;
    let folded = if plan.long_sums() {
        4 * FOLD_THREADS
    } else {
        4
    };
    let multigrid = solver.preconditioner == Preconditioner::Multigrid;
    let in_cycle = |n: usize| if multigrid { n } else { 0 };
    let mut plans = vec![
        BufferPlan::of::<Control>("solver.control", 1),
        RealBuffer::plan("solver.scalars", N_SCALARS, inner),
        BufferPlan::of::<u32>("solver.gated", 4 * (n_levels + 3)),
        BufferPlan::of::<u32>("solver.gate", 8),
        RealBuffer::plan("solver.folded", folded, inner),
        RealBuffer::plan("solver.outer_folded", folded, real),
        RealBuffer::plan("solver.norms", N_NORMS, real),
        BufferPlan::of::<Level>(
            "solver.level",
            n_levels + FOLDS + 3 + in_cycle(plan.tail + 1),
        ),
        BufferPlan::of::<Level>("solver.totals", FOLDS),
        BufferPlan::of::<Sweep>("solver.sweep", 2 + in_cycle(3)),
        BufferPlan::of::<ActiveSettings>("solver.active_settings", 1),
        BufferPlan::of::<RefineSettings>("solver.refine_settings", 1),
        BufferPlan::of::<Range>("compact.range", n_levels),
        BufferPlan::of::<u32>("solver.closed_sizes", 8),
        BufferPlan::of::<Control>("solver.control (read-back)", 1),
        RealBuffer::plan("solver.norms (read-back)", N_NORMS, real),
        BufferPlan::of::<u32>("solver.components (read-back)", STATE_WORDS),
        BufferPlan::of::<[u32; 4]>("solver.closed_settings", 2),
    ];
    if multigrid {
        plans.push(BufferPlan::of::<Tail>("solver.tail", 1));
    }
    plans
}
