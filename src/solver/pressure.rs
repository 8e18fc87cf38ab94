//! The pressure solve: the system B phi = b in the outer loop, and its requirements on the kernels.

use crate::Error;
use crate::fields::SolverBuffers;
use crate::gpu::{Arrays, Bound, Buffer, Gpu, Pass, Recorder, StageTimes, bind};
use crate::scene::{Preconditioner, Solver};
use crate::wgsl;

use super::hierarchy::Hierarchy;
use super::host_residual::HostPressure;
use super::pcg::{Block, Pcg, State, Unknowns};
use super::refine::{Aim, Outcome, OuterLoop, Pace, Shared, System};
use super::{BLOCK, OMEGA, Sweep};

/// The solve of a step: everything between a right-hand side and its potential.
#[derive(Debug)]
pub struct PressureSolver(OuterLoop<Pressure>);

impl PressureSolver {
    /// Compiles and binds. `velocity` holds u*, `open` the open fractions of the faces.
    pub fn new(
        gpu: &Gpu,
        buffers: &SolverBuffers,
        velocity: &Buffer<f32>,
        open: &Buffer<f32>,
        solver: &Solver,
    ) -> Result<PressureSolver, Error> {
        OuterLoop::new(gpu, buffers, solver, |shared| Pressure::new(gpu, buffers, shared, velocity, open, solver))
            .map(PressureSolver)
    }

    /// Submits the recording with the solve at its end and waits for the outcome, with a residual in f64: of the host where the device rounds it.
    /// A solve that does not converge is an [`Outcome`].
    pub fn solve(
        &self,
        gpu: &Gpu,
        recorder: Recorder,
        buffers: &SolverBuffers,
    ) -> Result<(Outcome, StageTimes), Error> {
        let (outcomes, times, _) = self.0.solve(gpu, recorder, buffers, None, &mut |_| {})?;
        Ok((outcomes[0], times))
    }

    /// The same with another aim, with more work at the end of every submission. Returns whether that work has read the solution. A guess is
    /// the correction in the buffers.
    pub(crate) fn solve_then(
        &self,
        gpu: &Gpu,
        recorder: Recorder,
        (buffers, aim): (&SolverBuffers, Aim),
        then: &mut dyn FnMut(&mut Recorder),
    ) -> Result<(Outcome, StageTimes, bool), Error> {
        let (outcomes, times, read) = self.0.solve(gpu, recorder, buffers, Some(aim), then)?;
        Ok((outcomes[0], times, read))
    }

    /// Tolerance of the true residual.
    pub(crate) fn tolerance(&self) -> f64 {
        self.0.tolerance()
    }

    /// From the next solve on, another tolerance of the true residual.
    pub fn set_tolerance(&mut self, gpu: &Gpu, tolerance: f64) {
        self.0.set_tolerance(gpu, tolerance);
    }

    /// B x of the system in `buffers`, in the precision of the corrections, as PCG evaluates it. `x` and the answer are in the
    /// device layout; inactive cells of the answer mean nothing. Overwrites what a solve computes with.
    pub fn apply(&self, gpu: &Gpu, buffers: &SolverBuffers, x: &[f64]) -> Result<Vec<f64>, Error> {
        self.0.apply(gpu, buffers, &[x])?;
        buffers.q.download(gpu)
    }

    /// z = H r, the preconditioner on the system in `buffers`, as PCG evaluates it. `r`, 0 in inactive cells, and the answer are in
    /// the device layout; inactive cells of the answer mean nothing. Overwrites what a solve computes with.
    pub fn precondition(&self, gpu: &Gpu, buffers: &SolverBuffers, r: &[f64]) -> Result<Vec<f64>, Error> {
        buffers.outer.upload(gpu, r);
        self.0.precondition(gpu, buffers, Pressure::begin)?;
        let mut z = buffers.z_next.download(gpu)?;
        z.truncate(r.len());
        Ok(z)
    }
}

/// The kernels of the pressure's system.
#[derive(Debug)]
pub(super) struct Pressure {
    measure: Bound,
    residual: Bound,
    begin: Bound,
    preconditioner: Precondition,
    apply: Bound,
    update: Bound,
}

#[derive(Debug)]
enum Precondition {
    Multigrid(Hierarchy),
    Jacobi(Bound),
}

/// The first sweep of a V-cycle, from zero, which the kernels that write r do on the way.
pub(super) const FIRST_SWEEP: Sweep = Sweep { omega: OMEGA[0], ends_cycle: 0, pad_0: 0, pad_1: 0 };

impl Pressure {
    pub(super) fn new(
        gpu: &Gpu,
        buffers: &SolverBuffers,
        shared: &Shared,
        velocity: &Buffer<f32>,
        open: &Buffer<f32>,
        solver: &Solver,
    ) -> Result<Pressure, Error> {
        let variant = buffers.variant;
        let level = gpu.uniform("solver.level", &buffers.plan.level(0))?;
        let [begin_sweep, update_sweep] =
            [gpu.uniform("solver.sweep", &FIRST_SWEEP)?, gpu.uniform("solver.sweep", &FIRST_SWEEP)?];
        let level = [("level", (&level).into())];
        let tables: &[&dyn Arrays] = &[&level, buffers, shared];
        let x = ("x", (&buffers.potential).into());
        let outer_partials = ("partials", (&buffers.outer_partials).into());
        let direction = ("x", (&buffers.search).into());
        let outer = [("velocity", velocity.into()), ("open", open.into()), x, outer_partials];
        let begin_sweep = [("sweep", (&begin_sweep).into())];
        let update_sweep = [("sweep", (&update_sweep).into())];
        let inner = variant.inner;
        Ok(Pressure {
            measure: bind(gpu, &wgsl!("refine_measure"), variant, outer, tables)?,
            begin: bind(gpu, &wgsl!("pcg_begin"), variant, begin_sweep, tables)?,
            residual: bind(gpu, &wgsl!("refine_residual"), variant, outer, tables)?,
            preconditioner: match solver.preconditioner {
                Preconditioner::Multigrid => Precondition::Multigrid(Hierarchy::new(gpu, buffers)?),
                Preconditioner::Jacobi | Preconditioner::BlockJacobi => {
                    let z = [("z", (&buffers.z_next).into())];
                    Precondition::Jacobi(bind(gpu, &wgsl!("pcg_jacobi"), inner, z, tables)?)
                }
            },
            apply: bind(gpu, &wgsl!("pcg_apply"), inner, [direction], tables)?,
            update: bind(gpu, &wgsl!("pcg_update"), inner, update_sweep, tables)?,
        })
    }

    /// Records the scaled residual, and the first sweep of a V-cycle on it.
    pub(super) fn begin(&self, pass: &mut Pass, state: &State) {
        state.in_begin(pass, &self.begin);
    }
}

impl SolverBuffers {
    /// Potentials as a block of unknowns.
    pub(super) fn block(&self) -> Block<'_> {
        Block {
            level: self.plan.level(0),
            variant: self.variant,
            flags: &self.flags,
            list: &self.list,
            args: &self.args,
            x: &self.potential,
            outer: &self.outer,
            search: &self.search,
        }
    }
}

impl System for Pressure {
    type Case<'a> = &'a SolverBuffers;
    type Host<'a> = HostPressure;

    fn unknowns<'a>(buffers: Self::Case<'a>) -> Unknowns<'a> {
        let plan = &buffers.plan;
        Unknowns {
            group: "solver",
            blocks: vec![buffers.block()],
            n_lists: plan.len(),
            sums: [plan.level(0).args; 2],
            long_sums: plan.long_sums(),
            variant: buffers.variant,
            z: &buffers.z_next,
            partials: &buffers.partials,
            outer_partials: &buffers.outer_partials,
            components: Some(&buffers.components),
        }
    }

    fn pace(&self, _: &SolverBuffers) -> Pace {
        // About what a refinement step needs.
        let iterations = match self.preconditioner {
            Precondition::Multigrid(_) => 8,
            Precondition::Jacobi(_) => 64,
        };
        Pace { iterations, gate: BLOCK, steps: 4 }
    }

    fn record_start(&self, pass: &mut Pass, buffers: &SolverBuffers) {
        pass.dispatch_indirect(&self.measure, &buffers.args, 0);
    }

    fn record_residual(&self, pass: &mut Pass, state: &State) {
        state.in_evaluation(pass, &self.residual);
    }

    fn record_begin(&self, pass: &mut Pass, state: &State, _: &Pcg, _: &SolverBuffers) {
        self.begin(pass, state);
    }

    /// The first sweep is done.
    fn record_preconditioner(&self, pass: &mut Pass, state: &State, _: &SolverBuffers) {
        match &self.preconditioner {
            Precondition::Multigrid(hierarchy) => hierarchy.record(pass, &state.gated, &state.gate),
            Precondition::Jacobi(bound) => state.in_refinement(pass, bound, 0),
        }
    }

    fn record_operator(&self, pass: &mut Pass, _: &State, sizes: &Buffer<u32>, _: &SolverBuffers) {
        pass.dispatch_indirect(&self.apply, sizes, 0);
    }

    fn record_update(&self, pass: &mut Pass, state: &State, _: &SolverBuffers) {
        state.in_update(pass, &self.update);
    }

    fn on_host<'a>(&self, gpu: &Gpu, buffers: Self::Case<'a>, closed: u32) -> Result<Self::Host<'a>, Error> {
        HostPressure::download(gpu, buffers, closed, |_| {})
    }
}
