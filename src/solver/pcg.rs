//! Preconditioned conjugate gradients for the correction of a round (Hestenes and Stiefel 1952), scalars on the device.

use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Pass, RealBuffer};
use crate::scene::Preconditioner;

use super::system::SolverBuffers;
use super::{Control, FOLD_THREADS, Hierarchy, OMEGA, Sweep};

/// Scalars on the device: `shaders/common/pcg_slots.wgsl` names the slots.
pub(super) const N_SCALARS: usize = 8;

/// What the state machine on the device keeps.
#[derive(Debug)]
pub(super) struct State {
    pub(super) control: Buffer<Control>,
    pub(super) scalars: RealBuffer,
    /// Dispatch sizes of the lists while a round runs, then of the update, the turn and the start of a round.
    pub(super) gated: Buffer<u32>,
    /// Dispatch size of the one-workgroup kernels.
    pub(super) gate: Buffer<u32>,
    folded: RealBuffer,
    pub(super) outer_folded: RealBuffer,
}

impl State {
    pub(super) fn new(gpu: &Gpu, buffers: &SolverBuffers) -> Result<State, Error> {
        let (plan, variant) = (&buffers.plan, buffers.variant);
        let folded = if plan.long_sums() {
            4 * FOLD_THREADS
        } else {
            4
        };
        Ok(State {
            control: gpu.buffer("solver.control", 1)?,
            scalars: RealBuffer::new(gpu, "solver.scalars", N_SCALARS, variant.inner)?,
            gated: gpu.buffer("solver.gated", 4 * (plan.len() + 3))?,
            gate: gpu.buffer("solver.gate", 8)?,
            folded: RealBuffer::new(gpu, "solver.folded", folded, variant.inner)?,
            outer_folded: RealBuffer::new(gpu, "solver.outer_folded", folded, variant.real)?,
        })
    }
}

/// A sum over partials: one workgroup, after a first level where there are many.
#[derive(Debug)]
pub(super) struct Fold {
    first: Option<Bound>,
    last: Bound,
}

impl Fold {
    /// Binds a one-workgroup kernel that sums `partials` and goes on from there with the `other` bindings.
    pub(super) fn new(
        gpu: &Gpu,
        buffers: &SolverBuffers,
        kernel: &Kernel,
        [partials, folded]: [&RealBuffer; 2],
        other: &[(&str, crate::gpu::Binding)],
    ) -> Result<Fold, Error> {
        let plan = &buffers.plan;
        let level = gpu.uniform("solver.level", &plan.level(0))?;
        let mut total = plan.level(0);
        let mut summed = partials;
        let mut first = None;
        if plan.long_sums() {
            first = Some(
                Kernel::new(gpu, &crate::wgsl!("fold_partials"), partials.real)?.bind(
                    gpu,
                    &[
                        ("level", (&level).into()),
                        ("args", (&buffers.args).into()),
                        ("partials", partials.into()),
                        ("folded", folded.into()),
                    ],
                )?,
            );
            summed = folded;
            total.args = 4 * plan.len() as u32;
        }
        let totals = gpu.uniform("solver.totals", &total)?;
        let mut bindings = vec![
            ("totals", (&totals).into()),
            ("args", (&buffers.args).into()),
            ("partials", summed.into()),
        ];
        bindings.extend_from_slice(other);
        Ok(Fold {
            first,
            last: kernel.bind(gpu, &bindings)?,
        })
    }

    /// Records the sum outside the gate.
    pub(super) fn record(&self, pass: &mut Pass) {
        if let Some(first) = &self.first {
            pass.dispatch(first, FOLD_THREADS);
        }
        pass.dispatch(&self.last, 1);
    }

    /// Records the sum behind the gate: slot 0 has one workgroup, slot 1 those of the first level.
    fn record_gated(&self, pass: &mut Pass, gate: &Buffer<u32>) {
        if let Some(first) = &self.first {
            pass.dispatch_indirect(first, gate, 1);
        }
        pass.dispatch_indirect(&self.last, gate, 0);
    }
}

/// The dispatches of an iteration.
#[derive(Debug)]
pub(super) struct Pcg {
    open: Bound,
    preconditioner: Precondition,
    beta: Fold,
    direction: Bound,
    apply: Bound,
    alpha: Fold,
    update: Bound,
    n_levels: usize,
}

#[derive(Debug)]
enum Precondition {
    Multigrid(Hierarchy),
    Jacobi(Bound),
}

impl Pcg {
    pub(super) fn new(
        gpu: &Gpu,
        buffers: &SolverBuffers,
        state: &State,
        preconditioner: Preconditioner,
    ) -> Result<Pcg, Error> {
        let SolverBuffers {
            plan,
            variant,
            list,
            args,
            matrix,
            r,
            z,
            z_next,
            search,
            q,
            partials,
            ..
        } = buffers;
        let inner = variant.inner;
        let level = gpu.uniform("solver.level", &plan.level(0))?;
        let level = ("level", (&level).into());
        let (list, args) = (("list", list.into()), ("args", args.into()));
        let kernel = |source| Kernel::new(gpu, source, inner);
        let scalars = ("scalars", (&state.scalars).into());
        let fold = |kernel: &Kernel| {
            let other = [
                scalars,
                ("control", (&state.control).into()),
                ("gated", (&state.gated).into()),
            ];
            Fold::new(gpu, buffers, kernel, [partials, &state.folded], &other)
        };
        let preconditioner = match preconditioner {
            Preconditioner::Multigrid => Precondition::Multigrid(Hierarchy::new(gpu, buffers)?),
            Preconditioner::Jacobi => {
                Precondition::Jacobi(kernel(&crate::wgsl!("pcg_jacobi"))?.bind(
                    gpu,
                    &[
                        level,
                        list,
                        args,
                        ("matrix", matrix.into()),
                        ("r", r.into()),
                        ("z", z_next.into()),
                        ("partials", partials.into()),
                    ],
                )?)
            }
        };
        let open = kernel(&crate::wgsl!("pcg_gate"))?.bind(
            gpu,
            &[
                ("control", (&state.control).into()),
                ("gate", (&state.gate).into()),
            ],
        )?;
        let direction = kernel(&crate::wgsl!("pcg_direction"))?.bind(
            gpu,
            &[
                level,
                list,
                args,
                scalars,
                ("z", z_next.into()),
                ("search", search.into()),
            ],
        )?;
        let apply = kernel(&crate::wgsl!("pcg_apply"))?.bind(
            gpu,
            &[
                level,
                list,
                args,
                ("matrix", matrix.into()),
                ("x", search.into()),
                ("r", r.into()),
                ("q_out", q.into()),
                ("partials", partials.into()),
            ],
        )?;
        let sweep = gpu.uniform("solver.sweep", &first_sweep())?;
        let update = kernel(&crate::wgsl!("pcg_update"))?.bind(
            gpu,
            &[
                level,
                ("sweep", (&sweep).into()),
                list,
                args,
                scalars,
                ("matrix", matrix.into()),
                ("search", search.into()),
                ("q_in", q.into()),
                ("r", r.into()),
                ("z", z.into()),
            ],
        )?;
        let beta = fold(&kernel(&crate::wgsl!("pcg_beta"))?)?;
        let alpha = fold(&kernel(&crate::wgsl!("pcg_alpha"))?)?;
        Ok(Pcg {
            open,
            preconditioner,
            beta,
            direction,
            apply,
            alpha,
            update,
            n_levels: plan.len(),
        })
    }

    /// Records iterations; those after the end of the round do nothing.
    pub(super) fn record(&self, pass: &mut Pass, state: &State, iterations: usize) {
        let State { gated, gate, .. } = state;
        self.record_gate(pass);
        for _ in 0..iterations {
            self.record_preconditioner(pass, state);
            self.beta.record_gated(pass, gate);
            pass.dispatch_indirect(&self.direction, gated, 0);
            pass.dispatch_indirect(&self.apply, gated, 0);
            self.alpha.record_gated(pass, gate);
            pass.dispatch_indirect(&self.update, gated, self.n_levels);
        }
    }
}

/// The parts of an iteration that stand alone.
impl Pcg {
    /// Opens the one-workgroup kernels if a round is running.
    pub(super) fn record_gate(&self, pass: &mut Pass) {
        pass.dispatch(&self.open, 1);
    }

    /// z = H r, its first sweep done.
    pub(super) fn record_preconditioner(&self, pass: &mut Pass, State { gated, gate, .. }: &State) {
        match &self.preconditioner {
            Precondition::Multigrid(hierarchy) => hierarchy.record(pass, gated, gate),
            Precondition::Jacobi(bound) => pass.dispatch_indirect(bound, gated, 0),
        }
    }

    /// q = B s on the active quads of `buffers`.
    pub(super) fn record_operator(&self, pass: &mut Pass, buffers: &SolverBuffers) {
        pass.dispatch_indirect(&self.apply, &buffers.args, 0);
    }
}

/// The first sweep of a V-cycle, from zero, which the kernels that write r do on the way.
pub(super) fn first_sweep() -> Sweep {
    Sweep {
        omega: OMEGA[0],
        ends_cycle: 0,
        pad_0: 0,
        pad_1: 0,
    }
}
