//! Preconditioned conjugate gradients for the correction of a round (Hestenes and Stiefel 1952), scalars on the device. What is the same
//! for every system: a quad is four scalars, whatever they stand for.

use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Pass, RealBuffer, Variant};

use super::refine::System;
use super::{Control, FOLD_THREADS, Level};

/// Scalars on the device: `shaders/common/pcg_slots.wgsl` names the slots.
pub(super) const N_SCALARS: usize = 8;
/// Dispatch sizes in `gated` after those of the lists: `shaders/common/control.wgsl` names them.
pub(super) const EXTRA_SIZES: usize = 3;
const UPDATE: usize = 0;
const TURN: usize = 1;
const BEGIN: usize = 2;

/// Labels of what the state machine allocates.
#[derive(Debug)]
pub(super) struct Labels {
    pub(super) control: &'static str,
    pub(super) scalars: &'static str,
    pub(super) gated: &'static str,
    pub(super) gate: &'static str,
    pub(super) folded: &'static str,
    pub(super) outer_folded: &'static str,
    pub(super) norms: &'static str,
    pub(super) level: &'static str,
    pub(super) totals: &'static str,
    pub(super) refine_settings: &'static str,
    pub(super) x: &'static str,
    pub(super) args: &'static str,
    pub(super) correction: &'static str,
}

/// The labels of a group of buffers.
macro_rules! labels {
    ($group:literal) => {
        $crate::solver::pcg::Labels {
            control: concat!($group, ".control"),
            scalars: concat!($group, ".scalars"),
            gated: concat!($group, ".gated"),
            gate: concat!($group, ".gate"),
            folded: concat!($group, ".folded"),
            outer_folded: concat!($group, ".outer_folded"),
            norms: concat!($group, ".norms"),
            level: concat!($group, ".level"),
            totals: concat!($group, ".totals"),
            refine_settings: concat!($group, ".refine_settings"),
            x: concat!($group, ".x"),
            args: concat!($group, ".args"),
            correction: concat!($group, ".correction"),
        }
    };
}
pub(super) use labels;

/// The quads of a system, and the vectors over them that the state machine works on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unknowns<'a> {
    pub(super) labels: &'static Labels,
    /// Where the quads lie; its `args` is the first list.
    pub(super) level: Level,
    /// Lists whose dispatch sizes open while a round runs; the first is that of the quads.
    pub(super) n_lists: usize,
    /// First word of the length of the partials of a round in `args`.
    pub(super) sums: u32,
    /// Whether sums take two levels: one workgroup alone would be slow on a wide device.
    pub(super) long_sums: bool,
    /// Scalar types of the outer loop (`real`) and of the rounds (`inner`).
    pub(super) variant: Variant,
    /// Per quad, bits 0-3: which lanes are unknowns.
    pub(super) flags: &'a Buffer<u32>,
    pub(super) list: &'a Buffer<u32>,
    /// Dispatch size and length of each list; after them the length of folded partials.
    pub(super) args: &'a Buffer<u32>,
    /// The unknowns.
    pub(super) x: &'a RealBuffer,
    /// The true residual.
    pub(super) outer: &'a RealBuffer,
    /// Preconditioned residual, as the search direction takes it.
    pub(super) z: &'a RealBuffer,
    /// Search direction, then correction.
    pub(super) search: &'a RealBuffer,
    pub(super) partials: &'a RealBuffer,
    pub(super) outer_partials: &'a RealBuffer,
    /// State of the stage that looked for closed components, where there is one.
    pub(super) components: Option<&'a Buffer<u32>>,
}

/// Entries of `folded`.
pub(super) fn folded_len(long_sums: bool) -> usize {
    if long_sums { 4 * FOLD_THREADS } else { 4 }
}

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
    n_lists: usize,
}

impl State {
    pub(super) fn new(gpu: &Gpu, unknowns: &Unknowns) -> Result<State, Error> {
        let Unknowns {
            labels,
            n_lists,
            variant,
            ..
        } = *unknowns;
        let folded = folded_len(unknowns.long_sums);
        Ok(State {
            control: gpu.buffer(labels.control, 1)?,
            scalars: RealBuffer::new(gpu, labels.scalars, N_SCALARS, variant.inner)?,
            gated: gpu.buffer(labels.gated, 4 * (n_lists + EXTRA_SIZES))?,
            gate: gpu.buffer(labels.gate, 8)?,
            folded: RealBuffer::new(gpu, labels.folded, folded, variant.inner)?,
            outer_folded: RealBuffer::new(gpu, labels.outer_folded, folded, variant.real)?,
            n_lists,
        })
    }

    /// Records a kernel on a list while a round runs.
    pub(super) fn in_round(&self, pass: &mut Pass, bound: &Bound, list: usize) {
        pass.dispatch_indirect(bound, &self.gated, list);
    }

    /// Records the update of correction and residual, which outlives the round by one kernel.
    pub(super) fn in_update(&self, pass: &mut Pass, bound: &Bound) {
        pass.dispatch_indirect(bound, &self.gated, self.n_lists + UPDATE);
    }

    /// Records a kernel of the turn from one round to the next.
    pub(super) fn in_turn(&self, pass: &mut Pass, bound: &Bound) {
        pass.dispatch_indirect(bound, &self.gated, self.n_lists + TURN);
    }

    /// Records a kernel of the start of a round.
    pub(super) fn in_begin(&self, pass: &mut Pass, bound: &Bound) {
        pass.dispatch_indirect(bound, &self.gated, self.n_lists + BEGIN);
    }

    /// Opens the sizes of a round from the host, as `refine_turn` does on the device.
    pub(super) fn open(&self, gpu: &Gpu, args: &[u32]) {
        let mut gated = args[..4 * self.n_lists].to_vec();
        for extra in 0..EXTRA_SIZES {
            gated.extend_from_slice(if extra == TURN { &[0; 4] } else { &args[..4] });
        }
        gpu.upload(&self.gated, &gated);
    }
}

/// A sum over partials: one workgroup, after a first level where there are many.
#[derive(Debug)]
pub(super) struct Fold {
    first: Option<Bound>,
    last: Bound,
}

impl Fold {
    /// Binds a one-workgroup kernel that sums `partials`, whose length stands after word `sums` of the arguments, and goes on from there
    /// with the `other` bindings.
    pub(super) fn new(
        gpu: &Gpu,
        unknowns: &Unknowns,
        kernel: &Kernel,
        ([partials, folded], sums): ([&RealBuffer; 2], u32),
        other: &[(&str, crate::gpu::Binding)],
    ) -> Result<Fold, Error> {
        let mut total = unknowns.level;
        total.args = sums;
        let level = gpu.uniform(unknowns.labels.level, &total)?;
        let args = ("args", unknowns.args.into());
        let mut summed = partials;
        let mut first = None;
        if unknowns.long_sums {
            first = Some(
                Kernel::new(gpu, &crate::wgsl!("fold_partials"), partials.real)?.bind(
                    gpu,
                    &[
                        ("level", (&level).into()),
                        args,
                        ("partials", partials.into()),
                        ("folded", folded.into()),
                    ],
                )?,
            );
            summed = folded;
            total.args = 4 * unknowns.n_lists as u32;
        }
        let totals = gpu.uniform(unknowns.labels.totals, &total)?;
        let mut bindings = vec![
            ("totals", (&totals).into()),
            args,
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
    pub(super) fn record_gated(&self, pass: &mut Pass, gate: &Buffer<u32>) {
        if let Some(first) = &self.first {
            pass.dispatch_indirect(first, gate, 1);
        }
        pass.dispatch_indirect(&self.last, gate, 0);
    }
}

/// The dispatches of an iteration that do not depend on the system.
#[derive(Debug)]
pub(super) struct Pcg {
    open: Bound,
    pub(super) beta: Fold,
    pub(super) direction: Bound,
    pub(super) alpha: Fold,
}

impl Pcg {
    /// Compiles and binds; `level` holds that of the unknowns.
    pub(super) fn new(
        gpu: &Gpu,
        unknowns: &Unknowns,
        level: &Buffer<Level>,
        state: &State,
    ) -> Result<Pcg, Error> {
        let kernel = |source| Kernel::new(gpu, source, unknowns.variant.inner);
        let scalars = ("scalars", (&state.scalars).into());
        let control = ("control", (&state.control).into());
        let args = ("args", unknowns.args.into());
        let gated = ("gated", (&state.gated).into());
        let fold = |kernel: &Kernel| {
            let other = [scalars, control, gated];
            let sums = ([unknowns.partials, &state.folded], unknowns.sums);
            Fold::new(gpu, unknowns, kernel, sums, &other)
        };
        let open = kernel(&crate::wgsl!("pcg_gate"))?
            .bind(gpu, &[control, args, gated, ("gate", (&state.gate).into())])?;
        let direction = kernel(&crate::wgsl!("pcg_direction"))?.bind(
            gpu,
            &[
                ("level", level.into()),
                ("list", unknowns.list.into()),
                args,
                scalars,
                ("z", unknowns.z.into()),
                ("search", unknowns.search.into()),
            ],
        )?;
        Ok(Pcg {
            open,
            beta: fold(&kernel(&crate::wgsl!("pcg_beta"))?)?,
            direction,
            alpha: fold(&kernel(&crate::wgsl!("pcg_alpha"))?)?,
        })
    }

    /// Records iterations; those after the end of the round do nothing.
    pub(super) fn record<S: System>(
        &self,
        pass: &mut Pass,
        state: &State,
        system: &S,
        buffers: S::Buffers<'_>,
        iterations: usize,
    ) {
        self.record_gate(pass);
        for _ in 0..iterations {
            system.record_preconditioner(pass, state, buffers);
            self.beta.record_gated(pass, &state.gate);
            state.in_round(pass, &self.direction, 0);
            system.record_operator(pass, &state.gated);
            self.alpha.record_gated(pass, &state.gate);
            system.record_update(pass, state);
        }
    }

    /// Opens the one-workgroup kernels if a round is running.
    pub(super) fn record_gate(&self, pass: &mut Pass) {
        pass.dispatch(&self.open, 1);
    }
}
