//! What the solver allocates besides its fields.

use crate::gpu::{BufferPlan, Range, Real, RealBuffer, Variant};
use crate::grid::Grid;
use crate::scene::{Formulation, Preconditioner, Solver};

use super::chebyshev::Polynomial;
use super::components::STATE_WORDS;
use super::condensed::Condensed;
use super::coupling::{self, CouplingSize};
use super::hierarchy::Tail;
use super::pcg::{EXTRA_SIZES, Labels, N_SCALARS, folded_len};
use super::pressure::LABELS;
use super::refine::{N_NORMS, RefineSettings, host_turns};
use super::solid_solver::sweeps;
use super::solid_system::SolidRows;
use super::system::ActiveSettings;
use super::two_field;
use super::two_field_jacobi::Jacobi;
use super::{Control, Level, LevelPlan, Sweep};

/// Sums that end in a one-workgroup kernel: start and turn of a round, alpha, beta.
const FOLDS: usize = 4;

/// Scalars, dispatch sizes and uniforms of [`PressureSystem`](super::PressureSystem), [`Components`](super::Components) and
/// [`PressureSolver`](super::PressureSolver). Uniforms that are made several times are lines with that many elements in all.
pub fn small_buffers(grid: &Grid, solver: &Solver, variant: Variant) -> Vec<BufferPlan> {
    let plan = LevelPlan::new(grid);
    let n_levels = plan.len();
    let multigrid = solver.preconditioner == Preconditioner::Multigrid;
    let n_scalars = plan.levels[0].len();
    let mut plans = outer_loop(
        &LABELS,
        [n_levels, n_scalars],
        plan.long_sums(),
        solver,
        variant,
    );
    plans.extend(pressure(&plan, multigrid));
    plans.extend([
        BufferPlan::of::<Level>(LABELS.level, n_levels + 1),
        BufferPlan::of::<ActiveSettings>("solver.active_settings", 1),
        BufferPlan::of::<Range>("compact.range", n_levels),
        BufferPlan::of::<u32>("solver.closed_sizes", 8),
        BufferPlan::of::<u32>("solver.components (read-back)", STATE_WORDS),
        BufferPlan::of::<[u32; 4]>("solver.closed_settings", 2),
    ]);
    plans
}

/// The uniforms of [`Pressure`](super::pressure::Pressure), with or without multigrid.
fn pressure(plan: &LevelPlan, multigrid: bool) -> Vec<BufferPlan> {
    let in_cycle = |n: usize| if multigrid { n } else { 0 };
    let mut plans = vec![
        BufferPlan::of::<Level>(LABELS.level, 1 + in_cycle(plan.tail + 1)),
        BufferPlan::of::<Sweep>("solver.sweep", 2 + in_cycle(3)),
    ];
    if multigrid {
        plans.push(BufferPlan::of::<Tail>("solver.tail", 1));
    }
    plans
}

/// What [`TwoFieldSolver`](super::TwoFieldSolver) allocates.
pub(super) fn two_field(
    grid: &Grid,
    rows: &SolidRows,
    size: &CouplingSize,
    solver: &Solver,
    variant: Variant,
) -> Vec<BufferPlan> {
    let plan = LevelPlan::new(grid);
    let labels = &coupling::LABELS;
    let n_lists = plan.len() + coupling::N_LISTS;
    let mut plans = state_machine(
        labels,
        n_lists,
        two_field::N_NORMS,
        plan.long_sums(),
        variant,
    );
    plans.extend(pressure(
        &plan,
        solver.preconditioner == Preconditioner::Multigrid,
    ));
    plans.extend([
        BufferPlan::of::<Polynomial>("coupled_solver.polynomial", 1),
        BufferPlan::of::<Sweep>("coupled_solver.sweep", 1),
    ]);
    let factored = solver.preconditioner == Preconditioner::Multigrid;
    for _ in 0..1 + usize::from(factored) {
        plans.extend(sweeps(rows));
    }
    if !factored {
        plans.extend(Jacobi::buffers(rows, variant));
    }
    if solver.formulation != Formulation::TwoField {
        plans.extend(Condensed::buffers(rows, solver, variant));
    }
    if variant.real == Real::F32 {
        let n_nodes = rows.rows.n_nodes as usize;
        plans.extend([
            BufferPlan::of::<u32>("coupled_solver.of_liquid (read-back)", grid.padded().len()),
            BufferPlan::of::<u32>("coupled_solver.of_nodes (read-back)", 4 * n_nodes),
            BufferPlan::of::<u32>("coupled_solver.base (read-back)", 4 * size.quads),
        ]);
    }
    if host_turns(solver, variant) {
        plans.push(BufferPlan::of::<u32>(labels.args_back, 4 * (n_lists + 1)));
    }
    plans
}

/// What the outer loop allocates for any system with so many lists and scalars.
pub(super) fn outer_loop(
    labels: &Labels,
    [n_lists, n_scalars]: [usize; 2],
    long_sums: bool,
    solver: &Solver,
    variant: Variant,
) -> Vec<BufferPlan> {
    let real = variant.real;
    let mut plans = state_machine(labels, n_lists, N_NORMS, long_sums, variant);
    if real == Real::F32 {
        plans.push(BufferPlan::of::<u32>(labels.x_back, n_scalars));
    }
    if host_turns(solver, variant) {
        plans.extend([
            BufferPlan::of::<u32>(labels.args_back, 4 * (n_lists + 1)),
            BufferPlan::of::<u32>(labels.correction_back, n_scalars),
        ]);
    }
    plans
}

/// What the state machine on the device and its folds allocate.
fn state_machine(
    labels: &Labels,
    n_lists: usize,
    n_norms: usize,
    long_sums: bool,
    Variant { real, inner, .. }: Variant,
) -> Vec<BufferPlan> {
    let folded = folded_len(long_sums);
    vec![
        BufferPlan::of::<Control>(labels.control, 1),
        RealBuffer::plan(labels.scalars, N_SCALARS, inner),
        BufferPlan::of::<u32>(labels.gated, 4 * (n_lists + EXTRA_SIZES)),
        BufferPlan::of::<u32>(labels.gate, 8),
        RealBuffer::plan(labels.folded, folded, inner),
        RealBuffer::plan(labels.outer_folded, folded, real),
        RealBuffer::plan(labels.norms, n_norms, real),
        BufferPlan::of::<Level>(labels.level, FOLDS + 1),
        BufferPlan::of::<Level>(labels.totals, FOLDS),
        BufferPlan::of::<RefineSettings>(labels.refine_settings, 1),
        BufferPlan::of::<Control>(labels.control_back, 1),
        RealBuffer::plan(labels.norms_back, n_norms, real),
    ]
}
