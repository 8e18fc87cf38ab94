//! The pressure solve: the system B phi = b in the outer loop, and what it asks of the kernels.

use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Pass, RealBuffer, Recorder, StageTimes};
use crate::scene::{Preconditioner, Solver};

use super::hierarchy::Hierarchy;
use super::host_residual::HostPressure;
use super::pcg::{Labels, State, Unknowns, labels};
use super::refine::{Outcome, OuterLoop, Pace, System};
use super::system::SolverBuffers;
use super::{OMEGA, Sweep};

pub(super) const LABELS: Labels = labels!("solver");

/// The solve of a step: everything between a right-hand side and its potential.
#[derive(Debug)]
pub struct PressureSolver(OuterLoop<Pressure>);

impl PressureSolver {
    /// Compiles and binds. `velocity` holds u*, `open` the open fractions of the faces.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Gpu::buffer`].
    pub fn new(
        gpu: &Gpu,
        buffers: &SolverBuffers,
        velocity: &Buffer<f32>,
        open: &Buffer<f32>,
        solver: &Solver,
    ) -> Result<PressureSolver, Error> {
        OuterLoop::new(gpu, buffers, solver, |state, norms| {
            Pressure::new(gpu, buffers, state, norms, velocity, open, solver)
        })
        .map(PressureSolver)
    }

    /// Submits the recording with the solve at its end and waits for the verdict, with a residual in f64: of the host where the device rounds it.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails. A solve that does not converge is an [`Outcome`], not an error.
    pub fn solve<'a>(
        &self,
        gpu: &'a Gpu,
        recorder: Recorder,
        buffers: &SolverBuffers,
    ) -> Result<(Outcome, StageTimes), Error> {
        self.0.solve(gpu, recorder, buffers)
    }

    /// From the next solve on, another tolerance of the true residual.
    pub fn set_tolerance(&mut self, gpu: &Gpu, tolerance: f64) {
        self.0.set_tolerance(gpu, tolerance);
    }

    /// B x of the system in `buffers`, in the precision of the corrections, as PCG evaluates it. `x` and the answer are in the
    /// device layout; inactive cells of the answer mean nothing. Overwrites what a solve computes with.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn apply(&self, gpu: &Gpu, buffers: &SolverBuffers, x: &[f64]) -> Result<Vec<f64>, Error> {
        self.0.apply(gpu, buffers, x)?;
        buffers.q.download(gpu)
    }

    /// z = H r, the preconditioner on the system in `buffers`, as PCG evaluates it. `r`, 0 in inactive cells, and the answer are in
    /// the device layout; inactive cells of the answer mean nothing. Overwrites what a solve computes with.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn precondition(
        &self,
        gpu: &Gpu,
        buffers: &SolverBuffers,
        r: &[f64],
    ) -> Result<Vec<f64>, Error> {
        buffers.outer.upload(gpu, r);
        self.0.precondition(gpu, buffers)?;
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
pub(super) const FIRST_SWEEP: Sweep = Sweep {
    omega: OMEGA[0],
    ends_cycle: 0,
    pad_0: 0,
    pad_1: 0,
};

impl Pressure {
    pub(super) fn new(
        gpu: &Gpu,
        buffers: &SolverBuffers,
        state: &State,
        norms: &RealBuffer,
        velocity: &Buffer<f32>,
        open: &Buffer<f32>,
        solver: &Solver,
    ) -> Result<Pressure, Error> {
        let SolverBuffers {
            plan,
            variant,
            flags,
            list,
            args,
            matrix,
            rhs,
            potential,
            outer,
            r,
            z,
            z_next,
            search,
            q,
            partials,
            outer_partials,
            ..
        } = buffers;
        let level = gpu.uniform("solver.level", &plan.level(0))?;
        let level = ("level", (&level).into());
        let (list, args, flags) = (
            ("list", list.into()),
            ("args", args.into()),
            ("flags", flags.into()),
        );
        let matrix = ("matrix", matrix.into());
        let scalars = ("scalars", (&state.scalars).into());
        let sweeps = [(), ()].map(|()| gpu.uniform("solver.sweep", &FIRST_SWEEP));
        let [begin_sweep, update_sweep] = sweeps;
        let outer_kernel = |source| Kernel::new(gpu, source, *variant);
        let kernel = |source| Kernel::new(gpu, source, variant.inner);
        Ok(Pressure {
            measure: outer_kernel(&crate::wgsl!("refine_measure"))?.bind(
                gpu,
                &[
                    level,
                    list,
                    args,
                    flags,
                    ("rhs", rhs.into()),
                    ("velocity", velocity.into()),
                    ("open", open.into()),
                    ("x", potential.into()),
                    ("partials", outer_partials.into()),
                ],
            )?,
            begin: outer_kernel(&crate::wgsl!("pcg_begin"))?.bind(
                gpu,
                &[
                    level,
                    ("sweep", (&begin_sweep?).into()),
                    list,
                    args,
                    ("norms", norms.into()),
                    ("outer", outer.into()),
                    matrix,
                    ("r", r.into()),
                    ("search", search.into()),
                    ("z", z.into()),
                ],
            )?,
            residual: outer_kernel(&crate::wgsl!("refine_residual"))?.bind(
                gpu,
                &[
                    level,
                    list,
                    args,
                    flags,
                    matrix,
                    ("x", potential.into()),
                    ("rhs", rhs.into()),
                    ("outer", outer.into()),
                    ("partials", outer_partials.into()),
                ],
            )?,
            preconditioner: match solver.preconditioner {
                Preconditioner::Multigrid => Precondition::Multigrid(Hierarchy::new(gpu, buffers)?),
                Preconditioner::Jacobi | Preconditioner::BlockJacobi => {
                    Precondition::Jacobi(kernel(&crate::wgsl!("pcg_jacobi"))?.bind(
                        gpu,
                        &[
                            level,
                            list,
                            args,
                            matrix,
                            ("r", r.into()),
                            ("z", z_next.into()),
                            ("partials", partials.into()),
                        ],
                    )?)
                }
            },
            apply: kernel(&crate::wgsl!("pcg_apply"))?.bind(
                gpu,
                &[
                    level,
                    list,
                    args,
                    matrix,
                    ("x", search.into()),
                    ("r", r.into()),
                    ("q_out", q.into()),
                    ("partials", partials.into()),
                ],
            )?,
            update: kernel(&crate::wgsl!("pcg_update"))?.bind(
                gpu,
                &[
                    level,
                    ("sweep", (&update_sweep?).into()),
                    list,
                    args,
                    scalars,
                    matrix,
                    ("search", search.into()),
                    ("q_in", q.into()),
                    ("r", r.into()),
                    ("z", z.into()),
                ],
            )?,
        })
    }
}

impl System for Pressure {
    type Buffers<'a> = &'a SolverBuffers;
    type Host = HostPressure;

    const GUESSES: bool = false;

    fn unknowns<'a>(buffers: Self::Buffers<'a>) -> Unknowns<'a> {
        let SolverBuffers {
            plan,
            variant,
            flags,
            list,
            args,
            potential,
            outer,
            z_next,
            search,
            partials,
            outer_partials,
            components,
            ..
        } = buffers;
        Unknowns {
            labels: &LABELS,
            level: plan.level(0),
            n_lists: plan.len(),
            sums: plan.level(0).args,
            long_sums: plan.long_sums(),
            variant: *variant,
            flags,
            list,
            args,
            x: potential,
            outer,
            z: z_next,
            search,
            partials,
            outer_partials,
            components: Some(components),
        }
    }

    fn pace(&self, _: &SolverBuffers) -> Pace {
        Pace {
            // About what a round needs.
            chunk: match self.preconditioner {
                Precondition::Multigrid(_) => 8,
                Precondition::Jacobi(_) => 64,
            },
            turns: 4,
        }
    }

    fn record_measure(&self, pass: &mut Pass, buffers: &SolverBuffers) {
        pass.dispatch_indirect(&self.measure, &buffers.args, 0);
    }

    fn record_residual(&self, pass: &mut Pass, state: &State) {
        state.in_turn(pass, &self.residual);
    }

    fn record_begin(&self, pass: &mut Pass, state: &State) {
        state.in_begin(pass, &self.begin);
    }

    /// Its first sweep is done.
    fn record_preconditioner(&self, pass: &mut Pass, state: &State, _: &SolverBuffers) {
        match &self.preconditioner {
            Precondition::Multigrid(hierarchy) => hierarchy.record(pass, &state.gated, &state.gate),
            Precondition::Jacobi(bound) => state.in_round(pass, bound, 0),
        }
    }

    fn record_operator(&self, pass: &mut Pass, sizes: &Buffer<u32>) {
        pass.dispatch_indirect(&self.apply, sizes, 0);
    }

    fn record_update(&self, pass: &mut Pass, state: &State) {
        state.in_update(pass, &self.update);
    }

    fn on_host(gpu: &Gpu, buffers: &SolverBuffers, closed: u32) -> Result<HostPressure, Error> {
        HostPressure::download(gpu, buffers, closed, |_| {})
    }
}
