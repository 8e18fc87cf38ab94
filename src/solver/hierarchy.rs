//! The preconditioner: one symmetric V-cycle of aggregation multigrid, z_next = H r.

use crate::Error;
use crate::fields::pressure_system::TAIL_LEVELS;
use crate::fields::{LevelPlan, SolverBuffers};
use crate::gpu::{Bound, Buffer, Gpu, Pass, Source, bind};
use crate::wgsl;

use super::{Level, OMEGA, Sweep, TAIL_STEPS};

/// Double sweeps on the last level; with a few cells left this solves it well below what the cycle needs.
const SOLVE_SWEEPS: u32 = 4;

/// The levels that one workgroup handles, and the steps of their V-cycle.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Tail {
    /// The levels, finest first.
    pub levels: [Level; TAIL_LEVELS],
    /// Steps, in order.
    pub steps: [TailStep; TAIL_STEPS],
    /// Number of steps.
    pub n_steps: u32,
    /// Nothing.
    pub pad_0: u32,
    /// Nothing.
    pub pad_1: u32,
    /// Nothing.
    pub pad_2: u32,
}

/// A step of the V-cycle.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
pub struct TailStep {
    /// `SWEEP`, `RESTRICT` or `PROLONG`.
    pub op: u32,
    /// To which level.
    pub level: u32,
    /// Relaxation weight.
    pub omega: f32,
    /// Nothing.
    pub pad_0: u32,
}

const SWEEP: u32 = 0;
const RESTRICT: u32 = 1;
const PROLONG: u32 = 2;

/// The part of the V-cycle below `plan.tail`, its first sweep excepted.
fn tail_steps(n_levels: usize) -> Vec<TailStep> {
    let last = n_levels - 1;
    let step = |op: u32, level: usize, omega: f32| TailStep { op, level: level as u32, omega, pad_0: 0 };
    let mut steps = Vec::new();
    for level in 0..last {
        steps.push(step(SWEEP, level, OMEGA[1]));
        steps.push(step(RESTRICT, level + 1, OMEGA[0]));
    }
    // From zero any sequence of sweeps is symmetric, so the last level needs no mirrored half.
    steps.push(step(SWEEP, last, OMEGA[1]));
    for _ in 1..SOLVE_SWEEPS {
        steps.push(step(SWEEP, last, OMEGA[0]));
        steps.push(step(SWEEP, last, OMEGA[1]));
    }
    for level in (0..last).rev() {
        steps.push(step(PROLONG, level, 0.0));
        steps.push(step(SWEEP, level, OMEGA[1]));
        steps.push(step(SWEEP, level, OMEGA[0]));
    }
    steps
}

impl LevelPlan {
    /// The uniform of a level.
    pub(crate) fn level(&self, level: usize) -> Level {
        Level {
            shape: self.levels[level].layout_at(self.first[level], self.total),
            coefficient: (1u32 << level) as f32,
            args: 4 * level as u32,
            ..bytemuck::Zeroable::zeroed()
        }
    }
}

/// The dispatches of a V-cycle. The first sweep of the finest level, from zero, is left to whoever writes r, into `z`.
#[derive(Debug)]
pub struct Hierarchy {
    /// Per level above the tail: second sweep, restriction to the next level.
    down: Vec<[Bound; 2]>,
    tail: Bound,
    /// Per level above the tail: prolongation from the next level, two sweeps.
    up: Vec<[Bound; 3]>,
}

impl Hierarchy {
    /// Compiles and binds.
    pub fn new(gpu: &Gpu, buffers: &SolverBuffers) -> Result<Hierarchy, Error> {
        let SolverBuffers { plan, variant, z, z_next, .. } = buffers;
        let inner = variant.inner;
        let levels = (0..=plan.tail)
            .map(|level| gpu.uniform("solver.level", &plan.level(level)))
            .collect::<Result<Vec<_>, _>>()?;
        let sweep = |omega: f32, ends_cycle: bool| {
            gpu.uniform("solver.sweep", &Sweep { omega, ends_cycle: ends_cycle.into(), pad_0: 0, pad_1: 0 })
        };
        let sweeps = [sweep(OMEGA[0], false)?, sweep(OMEGA[1], false)?, sweep(OMEGA[0], true)?];
        let bound = |source: Source, level: usize, sweep: &Buffer<Sweep>, to_next: bool| {
            let (x, x_out) = if to_next { (z, z_next) } else { (z_next, z) };
            let own = [
                ("level", (&levels[level]).into()),
                ("coarse", (&levels[level + 1]).into()),
                ("sweep", sweep.into()),
                ("x", x.into()),
                ("x_out", x_out.into()),
            ];
            bind(gpu, &source, inner, own, &[buffers])
        };
        let mut down = Vec::new();
        let mut up = Vec::new();
        for level in 0..plan.tail {
            let smooth = |sweep, to_next| bound(wgsl!("vcycle_smooth"), level, sweep, to_next);
            let restrict = bound(wgsl!("vcycle_restrict"), level, &sweeps[0], false)?;
            let prolong = bound(wgsl!("vcycle_prolong"), level, &sweeps[0], false)?;
            down.push([smooth(&sweeps[1], true)?, restrict]);
            let last = if level == 0 { &sweeps[2] } else { &sweeps[0] };
            up.push([prolong, smooth(&sweeps[1], false)?, smooth(last, true)?]);
        }
        let mut tail: Tail = bytemuck::Zeroable::zeroed();
        for level in plan.tail..plan.len() {
            tail.levels[level - plan.tail] = plan.level(level);
        }
        let steps = tail_steps(plan.len() - plan.tail);
        tail.steps[..steps.len()].copy_from_slice(&steps);
        tail.n_steps = steps.len() as u32;
        let tail = gpu.uniform("solver.tail", &tail)?;
        let own = [("tail", (&tail).into()), ("x_in", z.into()), ("x", z_next.into())];
        let tail = bind(gpu, &wgsl!("vcycle_tail"), inner, own, &[buffers])?;
        Ok(Hierarchy { down, tail, up })
    }

    /// Records a V-cycle on the lists whose dispatch sizes stand in `sizes` (a level per slot); `gate` holds the size of the tail.
    pub fn record(&self, pass: &mut Pass, sizes: &Buffer<u32>, gate: &Buffer<u32>) {
        for (level, [smooth, restrict]) in self.down.iter().enumerate() {
            pass.dispatch_indirect(smooth, sizes, level);
            pass.dispatch_indirect(restrict, sizes, level + 1);
        }
        pass.dispatch_indirect(&self.tail, gate, 0);
        for (level, bounds) in self.up.iter().enumerate().rev() {
            for bound in bounds {
                pass.dispatch_indirect(bound, sizes, level);
            }
        }
    }
}
