//! Preconditioned conjugate gradients for the correction of a refinement step (Hestenes and Stiefel 1952), scalars on the device; one
//! driver for all systems.

use crate::Error;
use crate::fields::pressure_system::FOLD_THREADS;
use crate::gpu::{Arrays, Binding, Bound, Buffer, Gpu, Pass, RealBuffer, Source, Variant, bind};
use crate::wgsl;

use super::refine::{Pace, System};
use super::{Control, Level};

/// Scalars on the device: `shaders/common/pcg_slots.wgsl` names the slots.
pub(super) const N_SCALARS: usize = 8;
/// Dispatch sizes in `gated` after those of the lists: `shaders/common/control.wgsl` names them.
pub(super) const EXTRA_SIZES: usize = 3;
const UPDATE: usize = 0;
const EVALUATE: usize = 1;
const BEGIN: usize = 2;

/// Blocks of unknowns of a system: quads of four scalars, whatever they stand for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block<'a> {
    /// Layout of the quads; its `args` is their list.
    pub(super) level: Level,
    /// Scalar types of the unknowns (`real`) and of the correction (`inner`).
    pub(super) variant: Variant,
    /// Per quad, bits 0-3: lanes with unknowns.
    pub(super) flags: &'a Buffer<u32>,
    pub(super) list: &'a Buffer<u32>,
    /// Dispatch size and length of each list; after them the length of folded partials.
    pub(super) args: &'a Buffer<u32>,
    pub(super) x: &'a RealBuffer,
    /// True residual.
    pub(super) outer: &'a RealBuffer,
    /// Search direction, then correction.
    pub(super) search: &'a RealBuffer,
}

/// The blocks of a system, and the vectors over the first that conjugate gradients work on.
#[derive(Clone, Debug)]
pub(super) struct Unknowns<'a> {
    /// Group of the labels.
    pub(super) group: &'static str,
    pub(super) blocks: Vec<Block<'a>>,
    /// Lists whose dispatch sizes open during a refinement step; the first is that of the first block.
    pub(super) n_lists: usize,
    /// First words of the length of the partials in `args`: for beta, for alpha.
    pub(super) sums: [u32; 2],
    /// Whether sums take two levels: one workgroup alone would be slow on a wide device.
    pub(super) long_sums: bool,
    /// Scalar types of the outer loop (`real`) and of conjugate gradients (`inner`).
    pub(super) variant: Variant,
    /// Preconditioned residual.
    pub(super) z: &'a RealBuffer,
    pub(super) partials: &'a RealBuffer,
    pub(super) outer_partials: &'a RealBuffer,
    /// State of the stage that looked for enclosed components, where there is one.
    pub(super) components: Option<&'a Buffer<u32>>,
}

/// State machine on the device.
#[derive(Debug)]
pub(super) struct State {
    pub(super) control: Buffer<Control>,
    pub(super) scalars: RealBuffer,
    /// Dispatch sizes of the lists during a refinement step, then of the update, the evaluation and the start of a step.
    pub(super) gated: Buffer<u32>,
    /// Dispatch size of the one-workgroup kernels.
    pub(super) gate: Buffer<u32>,
    folded: RealBuffer,
    pub(super) outer_folded: RealBuffer,
    n_lists: usize,
}

impl Arrays for State {
    fn array(&self, name: &str) -> Option<Binding<'_>> {
        Some(match name {
            "control" => (&self.control).into(),
            "scalars" => (&self.scalars).into(),
            "gated" => (&self.gated).into(),
            "gate" => (&self.gate).into(),
            _ => return None,
        })
    }
}

impl State {
    pub(super) fn new(gpu: &Gpu, unknowns: &Unknowns) -> Result<State, Error> {
        let Variant { real, inner, .. } = unknowns.variant;
        let n_lists = unknowns.n_lists;
        let folded = if unknowns.long_sums { 4 * FOLD_THREADS } else { 4 };
        let label = |name: &str| format!("{}.{name}", unknowns.group);
        Ok(State {
            control: gpu.buffer(&label("control"), 1)?,
            scalars: RealBuffer::new(gpu, &label("scalars"), N_SCALARS, inner)?,
            gated: gpu.buffer(&label("gated"), 4 * (n_lists + EXTRA_SIZES))?,
            gate: gpu.buffer(&label("gate"), 8)?,
            folded: RealBuffer::new(gpu, &label("folded"), folded, inner)?,
            outer_folded: RealBuffer::new(gpu, &label("outer_folded"), folded, real)?,
            n_lists,
        })
    }

    /// Records a kernel on a list during a refinement step.
    pub(super) fn in_refinement(&self, pass: &mut Pass, bound: &Bound, list: usize) {
        pass.dispatch_indirect(bound, &self.gated, list);
    }

    /// Records the update of correction and residual, which outlives the refinement step by one kernel.
    pub(super) fn in_update(&self, pass: &mut Pass, bound: &Bound) {
        pass.dispatch_indirect(bound, &self.gated, self.n_lists + UPDATE);
    }

    /// Records a kernel of a residual evaluation.
    pub(super) fn in_evaluation(&self, pass: &mut Pass, bound: &Bound) {
        pass.dispatch_indirect(bound, &self.gated, self.n_lists + EVALUATE);
    }

    /// Records a kernel of the start of a refinement step.
    pub(super) fn in_begin(&self, pass: &mut Pass, bound: &Bound) {
        pass.dispatch_indirect(bound, &self.gated, self.n_lists + BEGIN);
    }

    /// Opens the dispatch sizes of a refinement step from the host, as `refine_accept` does on the device.
    pub(super) fn open(&self, gpu: &Gpu, args: &[u32]) {
        let mut gated = args[..4 * self.n_lists].to_vec();
        for extra in 0..EXTRA_SIZES {
            gated.extend_from_slice(if extra == EVALUATE { &[0; 4] } else { &args[..4] });
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
    /// Binds a one-workgroup kernel that sums `partials`, whose length is in the third word after word `sums` of the arguments.
    pub(super) fn new(
        gpu: &Gpu,
        unknowns: &Unknowns,
        source: &Source,
        variant: Variant,
        ([partials, folded], sums): ([&RealBuffer; 2], u32),
        tables: &[&dyn Arrays],
    ) -> Result<Fold, Error> {
        let block = &unknowns.blocks[0];
        let mut total = block.level;
        total.args = sums;
        let level = gpu.uniform(&format!("{}.level", unknowns.group), &total)?;
        let args = ("args", block.args.into());
        let mut summed = partials;
        let mut first = None;
        if unknowns.long_sums {
            let own = [("level", (&level).into()), args, ("partials", partials.into()), ("folded", folded.into())];
            first = Some(bind(gpu, &wgsl!("fold_partials"), partials.real, own, &[])?);
            summed = folded;
            total.args = 4 * unknowns.n_lists as u32;
        }
        let totals = gpu.uniform(&format!("{}.totals", unknowns.group), &total)?;
        let own = [("totals", (&totals).into()), args, ("partials", summed.into())];
        Ok(Fold { first, last: bind(gpu, source, variant, own, tables)? })
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
    beta: Fold,
    direction: Bound,
    alpha: Fold,
}

impl Pcg {
    /// Compiles and binds; `level` holds that of the unknowns.
    pub(super) fn new(gpu: &Gpu, unknowns: &Unknowns, level: &Buffer<Level>, state: &State) -> Result<Pcg, Error> {
        let block = &unknowns.blocks[0];
        let inner = unknowns.variant.inner;
        let own = [
            ("level", level.into()),
            ("list", block.list.into()),
            ("args", block.args.into()),
            ("z", unknowns.z.into()),
            ("search", block.search.into()),
        ];
        let fold = |source, sums| {
            let sums = ([unknowns.partials, &state.folded], sums);
            Fold::new(gpu, unknowns, &source, inner.into(), sums, &[state])
        };
        Ok(Pcg {
            open: bind(gpu, &wgsl!("pcg_gate"), inner, own, &[state])?,
            beta: fold(wgsl!("pcg_beta"), unknowns.sums[0])?,
            direction: bind(gpu, &wgsl!("pcg_direction"), inner, own, &[state])?,
            alpha: fold(wgsl!("pcg_alpha"), unknowns.sums[1])?,
        })
    }

    /// Records iterations; those after the last of a refinement step do nothing.
    pub(super) fn record<S: System>(
        &self,
        pass: &mut Pass,
        state: &State,
        system: &S,
        case: S::Case<'_>,
        Pace { iterations, gate, .. }: Pace,
    ) {
        for iteration in 0..iterations {
            if iteration % gate == 0 {
                self.record_gate(pass);
            }
            system.record_preconditioner(pass, state, case);
            self.beta.record_gated(pass, &state.gate);
            state.in_refinement(pass, &self.direction, 0);
            system.record_direction(pass, state, case);
            system.record_operator(pass, state, &state.gated, case);
            self.alpha.record_gated(pass, &state.gate);
            system.record_update(pass, state, case);
        }
    }

    /// Opens the one-workgroup kernels during a refinement step.
    pub(super) fn record_gate(&self, pass: &mut Pass) {
        pass.dispatch(&self.open, 1);
    }
}
