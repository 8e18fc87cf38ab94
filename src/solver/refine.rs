//! The outer loop: rounds of conjugate gradients on the true residual r = b - B x, and the verdict.

use std::sync::{Mutex, PoisonError};

use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Pass, Readback, RealBuffer, Recorder, Variant};
use crate::scene::{Precision, Preconditioner, Solver};
use crate::state::SolveStatus;

use super::Control;
use super::components::{CLOSED, STATE_WORDS};
use super::host_residual::HostSystem;
use super::pcg::{Fold, Pcg, State, first_sweep};
use super::system::SolverBuffers;

/// Slots of the norms: `shaders/common/refine.wgsl` names them.
pub(super) const N_NORMS: usize = 8;
const NORM_R: usize = 0;
const NORM_B: usize = 1;
const NORM_FLUX: usize = 2;
const SCALE: usize = 4;
/// Slot of the scalars: `shaders/common/pcg_slots.wgsl`.
const GOAL: usize = 3;

/// Iterations between two looks at whether the one-workgroup kernels still have work.
const BLOCK: usize = 4;
/// Iterations between two chances to turn from a round to the next: about what multigrid needs for a round.
const CHUNK: [usize; 2] = [8, 64];
/// Chances to turn in a submission: multigrid needs two or three for a solve.
const TURNS: usize = 4;
/// Least reduction of a round in f32: recurrences go on falling where the true residual of a correction stays (4e-5 at 80^3).
const ROUND_FLOOR_F32: f32 = 5e-5;
/// Share of what is left that a round aims for.
const ROUND_MARGIN: f64 = 0.5;

/// What is known after a solve.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    /// How it ended.
    pub status: SolveStatus,
    /// PCG iterations in all rounds.
    pub iterations: u32,
    /// Rounds.
    pub rounds: u32,
    /// Active cells.
    pub unknowns: u32,
    /// Components without a free surface, if [`Components`](super::Components) looked for them.
    pub closed_components: u32,
    /// |b - B x| / |b|; 0 for b = 0.
    pub residual: f64,
    /// |b - B x| over the norm of the fluxes that b sums.
    pub residual_flux: f64,
    /// Whether `residual` was evaluated in f64.
    pub verified: bool,
}

/// What the host reads of the device's state.
#[derive(Debug)]
struct Reading {
    control: Control,
    norms: Vec<f64>,
    closed: u32,
}

/// Where it arrives.
#[derive(Debug)]
struct Readbacks {
    control: Readback<Control>,
    norms: Readback<u32>,
    components: Readback<u32>,
}

/// The doppelganger of `RefineSettings` in `shaders/refine_turn.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(super) struct RefineSettings {
    tolerance: f32,
    rounding: f32,
    round_floor: f32,
    pad_0: f32,
}

/// Relative to the fluxes, what rounding leaves of the residual (design section 5).
pub fn rounding(solver: &Solver) -> f64 {
    match solver.precision {
        Precision::F32 => 1e-7,
        Precision::Mixed | Precision::F64 => 1e-14,
    }
}

/// The solve of a step: everything between a right-hand side and its potential.
#[derive(Debug)]
pub struct PressureSolver {
    solver: Solver,
    state: State,
    pcg: Pcg,
    norms: RealBuffer,
    readbacks: Mutex<Readbacks>,
    measure: Bound,
    start: Fold,
    begin: Bound,
    correct: Bound,
    residual: Bound,
    turn: Fold,
    n_levels: usize,
    variant: Variant,
    host_turns: bool,
}

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
            search,
            outer_partials,
            ..
        } = buffers;
        let state = State::new(gpu, buffers)?;
        let pcg = Pcg::new(gpu, buffers, &state, solver.preconditioner)?;
        let norms = RealBuffer::new(gpu, "solver.norms", N_NORMS, variant.real)?;
        let level = gpu.uniform("solver.level", &plan.level(0))?;
        let level = ("level", (&level).into());
        let (list, args, flags) = (
            ("list", list.into()),
            ("args", args.into()),
            ("flags", flags.into()),
        );
        let matrix = ("matrix", matrix.into());
        let kernel = |source| Kernel::new(gpu, source, *variant);
        let measure = kernel(&crate::wgsl!("refine_measure"))?.bind(
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
        )?;
        let sweep = gpu.uniform("solver.sweep", &first_sweep())?;
        let begin = kernel(&crate::wgsl!("pcg_begin"))?.bind(
            gpu,
            &[
                level,
                ("sweep", (&sweep).into()),
                list,
                args,
                ("norms", (&norms).into()),
                ("outer", outer.into()),
                matrix,
                ("r", r.into()),
                ("search", search.into()),
                ("z", z.into()),
            ],
        )?;
        let correct = kernel(&crate::wgsl!("refine_correct"))?.bind(
            gpu,
            &[
                level,
                list,
                args,
                flags,
                ("norms", (&norms).into()),
                ("search", search.into()),
                ("x", potential.into()),
            ],
        )?;
        let residual = kernel(&crate::wgsl!("refine_residual"))?.bind(
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
        )?;
        let settings = RefineSettings {
            tolerance: solver.tolerance as f32,
            rounding: rounding(solver) as f32,
            round_floor: round_floor(solver),
            pad_0: 0.0,
        };
        let settings = gpu.uniform("solver.refine_settings", &settings)?;
        let sums = [outer_partials, &state.outer_folded];
        let shared = [
            ("norms", (&norms).into()),
            ("control", (&state.control).into()),
            ("gated", (&state.gated).into()),
        ];
        let start = Fold::new(
            gpu,
            buffers,
            &kernel(&crate::wgsl!("refine_start"))?,
            sums,
            &shared,
        )?;
        let mut turn_bindings = shared.to_vec();
        turn_bindings.push(("settings", (&settings).into()));
        turn_bindings.push(("scalars", (&state.scalars).into()));
        let turn = Fold::new(
            gpu,
            buffers,
            &kernel(&crate::wgsl!("refine_turn"))?,
            sums,
            &turn_bindings,
        )?;
        let control = Control {
            max_iterations: solver.max_iterations,
            n_levels: plan.len() as u32,
            ..Control::default()
        };
        gpu.upload(&state.control, &[control]);
        let host_turns = solver.precision == Precision::Mixed && !gpu.has_f64();
        let readbacks = Mutex::new(Readbacks {
            control: Readback::new(gpu, "solver.control", 1)?,
            norms: Readback::new(gpu, "solver.norms", norms.words.len())?,
            components: Readback::new(gpu, "solver.components", STATE_WORDS)?,
        });
        Ok(PressureSolver {
            solver: *solver,
            state,
            pcg,
            readbacks,
            norms,
            measure,
            start,
            begin,
            correct,
            residual,
            turn,
            n_levels: plan.len(),
            variant: *variant,
            host_turns,
        })
    }

    fn chunk(&self) -> usize {
        match self.solver.preconditioner {
            Preconditioner::Multigrid => CHUNK[0],
            Preconditioner::Jacobi => CHUNK[1],
        }
    }

    fn record_start(&self, recorder: &mut Recorder, buffers: &SolverBuffers) {
        recorder.stage("solve", |pass| {
            pass.dispatch_indirect(&self.measure, &buffers.args, 0);
            self.start.record(pass);
        });
    }

    /// From a round to the next, where the round is over: correction, true residual, verdict.
    fn record_turn(&self, pass: &mut Pass) {
        let turn = self.n_levels + 1;
        pass.dispatch_indirect(&self.correct, &self.state.gated, turn);
        pass.dispatch_indirect(&self.residual, &self.state.gated, turn);
        self.turn.record(pass);
    }

    fn record_iterations(&self, pass: &mut Pass) {
        for _ in 0..self.chunk() / BLOCK {
            self.pcg.record(pass, &self.state, BLOCK);
        }
    }

    /// Submits the recording with the solve at its end and waits for the verdict. `verify` asks for a verdict in f64 where
    /// the precision or the adapter would not give one.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails. A solve that does not converge is an [`Outcome`], not an error.
    pub fn solve<'a>(
        &self,
        gpu: &'a Gpu,
        mut recorder: Recorder<'a>,
        buffers: &SolverBuffers,
        verify: bool,
    ) -> Result<(Outcome, crate::gpu::StageTimes), Error> {
        self.record_start(&mut recorder, buffers);
        if self.host_turns {
            let timing = recorder.submit();
            let outcome = self.solve_with_host_turns(gpu, buffers)?;
            return Ok((outcome, timing.wait()?));
        }
        let mut times = Vec::new();
        loop {
            recorder.stage("solve", |pass| {
                for _ in 0..TURNS {
                    self.record_turn(pass);
                    pass.dispatch_indirect(&self.begin, &self.state.gated, self.n_levels + 2);
                    self.record_iterations(pass);
                }
                self.record_turn(pass);
            });
            let (reading, mut stages) = self.submit(gpu, recorder, buffers)?;
            times.append(&mut stages);
            let norms = &reading.norms;
            let mut outcome = self.outcome(&reading);
            if let Some(outcome) = &mut outcome {
                if outcome.status == SolveStatus::Stagnated {
                    // One more turn, so that a correction on trial is taken back.
                    recorder = Recorder::new(gpu);
                    recorder.stage("solve", |pass| self.record_turn(pass));
                    recorder.submit();
                }
                if verify && !outcome.verified {
                    let system = HostSystem::download(gpu, buffers)?;
                    let x = buffers.potential.download(gpu)?;
                    let rhs = buffers.rhs.download(gpu)?;
                    let (_, rr) = system.residual(&x, &rhs);
                    outcome.residual = relative(rr, norms[NORM_B]);
                    outcome.residual_flux = relative(rr, norms[NORM_FLUX]);
                    outcome.verified = true;
                }
                return Ok((*outcome, times));
            }
            recorder = Recorder::timed(gpu);
        }
    }

    /// B x of the system in `buffers`, in the precision of the corrections, as PCG evaluates it. `x` and the answer are in the
    /// device layout; inactive cells of the answer mean nothing. Overwrites what a solve computes with.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn apply(&self, gpu: &Gpu, buffers: &SolverBuffers, x: &[f64]) -> Result<Vec<f64>, Error> {
        buffers.search.upload(gpu, x);
        let mut recorder = Recorder::new(gpu);
        recorder.stage("solve", |pass| self.pcg.record_operator(pass, buffers));
        recorder.submit();
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
        let (mut reading, _) = self.submit(gpu, Recorder::new(gpu), buffers)?;
        let args = gpu.download(&buffers.args)?;
        self.open_round(gpu, &mut reading.control, &mut reading.norms, &args, 1.0);
        buffers.outer.upload(gpu, r);
        let mut recorder = Recorder::new(gpu);
        recorder.stage("solve", |pass| {
            pass.dispatch_indirect(&self.begin, &self.state.gated, self.n_levels + 2);
            self.pcg.record_gate(pass);
            self.pcg.record_preconditioner(pass, &self.state);
        });
        recorder.submit();
        let mut z = buffers.z_next.download(gpu)?;
        z.truncate(r.len());
        Ok(z)
    }

    fn submit(
        &self,
        gpu: &Gpu,
        mut recorder: Recorder,
        buffers: &SolverBuffers,
    ) -> Result<(Reading, crate::gpu::StageTimes), Error> {
        // A panic in another solve leaves nothing half done here: every use begins with new copies.
        let mut readbacks = self
            .readbacks
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let Readbacks {
            control,
            norms,
            components,
        } = &mut *readbacks;
        recorder.read(&self.state.control, control);
        recorder.read(&self.norms.words, norms);
        recorder.read(&buffers.components, components);
        let times = recorder.submit().wait()?;
        let reading = Reading {
            control: control.wait(gpu)?[0],
            norms: self.norms.widen(&norms.wait(gpu)?),
            closed: components.wait(gpu)?[CLOSED],
        };
        Ok((reading, times))
    }

    /// The verdict, or `None` while there is more to do.
    fn outcome(&self, reading: &Reading) -> Option<Outcome> {
        let Reading {
            control,
            norms,
            closed,
        } = reading;
        let status = match control.status {
            _ if !norms[NORM_R].is_finite() || !norms[NORM_B].is_finite() => SolveStatus::NonFinite,
            0 => return None,
            1 => SolveStatus::Converged,
            2 => SolveStatus::IterationLimit,
            3 if control.running == 1 => return None,
            3 => SolveStatus::Breakdown,
            _ => SolveStatus::Stagnated,
        };
        Some(Outcome {
            status,
            iterations: control.iterations,
            rounds: control.rounds,
            unknowns: control.unknowns,
            closed_components: *closed,
            residual: relative(norms[NORM_R], norms[NORM_B]),
            residual_flux: relative(norms[NORM_R], norms[NORM_FLUX]),
            verified: self.variant.real == crate::gpu::Real::F64,
        })
    }

    /// The outer loop for adapters without f64: the rounds run on the device, the unknowns and the residual are held in f64 on
    /// the host, one exchange per round.
    fn solve_with_host_turns(&self, gpu: &Gpu, buffers: &SolverBuffers) -> Result<Outcome, Error> {
        let (reading, _) = self.submit(gpu, Recorder::new(gpu), buffers)?;
        let Reading {
            mut control,
            mut norms,
            closed,
        } = reading;
        let system = HostSystem::download(gpu, buffers)?;
        let args = gpu.download(&buffers.args)?;
        let mut rhs = buffers.rhs.download(gpu)?;
        if closed > 0 {
            // Rounding to f32 gave them means again, of which no solution could get below the tolerance.
            let labels = gpu.download(&buffers.labels)?;
            system.remove_closed_means(&labels, &mut rhs);
        }
        let mut x = vec![0.0; rhs.len()];
        let (mut r, mut rr) = system.residual(&x, &rhs);
        let goal = (self.solver.tolerance.powi(2) * norms[NORM_B])
            .max(rounding(&self.solver).powi(2) * norms[NORM_FLUX]);
        let status = loop {
            if !rr.is_finite() {
                break SolveStatus::NonFinite;
            }
            if rr <= goal {
                break SolveStatus::Converged;
            }
            if control.iterations >= control.max_iterations {
                break SolveStatus::IterationLimit;
            }
            if control.status == 3 {
                break SolveStatus::Breakdown;
            }
            let scale = rr.sqrt();
            let scaled: Vec<f64> = r.iter().map(|value| value / scale).collect();
            buffers.outer.upload(gpu, &scaled);
            self.open_round(gpu, &mut control, &mut norms, &args, goal / rr);
            let mut recorder = Recorder::new(gpu);
            recorder.stage("solve", |pass| {
                pass.dispatch_indirect(&self.begin, &self.state.gated, self.n_levels + 2);
            });
            loop {
                recorder.stage("solve", |pass| self.record_iterations(pass));
                control = self.submit(gpu, recorder, buffers)?.0.control;
                if control.running == 0 {
                    break;
                }
                recorder = Recorder::new(gpu);
            }
            let search = buffers.search.download(gpu)?;
            let correction = &search[rhs.len()..];
            let better: Vec<f64> = x
                .iter()
                .zip(correction)
                .map(|(x, correction)| x + scale * correction)
                .collect();
            let (r_new, rr_new) = system.residual(&better, &rhs);
            if rr_new.is_finite() && rr_new >= rr {
                break SolveStatus::Stagnated;
            }
            (x, r, rr) = (better, r_new, rr_new);
        };
        system.mask(&mut x);
        buffers.potential.upload(gpu, &x);
        Ok(Outcome {
            status,
            iterations: control.iterations,
            rounds: control.rounds,
            unknowns: control.unknowns,
            closed_components: closed,
            residual: relative(rr, norms[NORM_B]),
            residual_flux: relative(rr, norms[NORM_FLUX]),
            verified: true,
        })
    }

    /// What `refine_turn` does on the device to open a round.
    fn open_round(
        &self,
        gpu: &Gpu,
        control: &mut Control,
        norms: &mut [f64],
        args: &[u32],
        left: f64,
    ) {
        control.running = 1;
        control.first = 1;
        control.rounds += 1;
        gpu.upload(&self.state.control, &[*control]);
        norms[SCALE] = 1.0;
        self.norms.upload(gpu, norms);
        let mut scalars = vec![0.0; super::pcg::N_SCALARS];
        scalars[GOAL] =
            (ROUND_MARGIN.powi(2) * left).max(f64::from(round_floor(&self.solver)).powi(2));
        self.state.scalars.upload(gpu, &scalars);
        let mut gated = args[..4 * self.n_levels].to_vec();
        gated.extend_from_slice(&args[..4]);
        gated.extend_from_slice(&[0; 4]);
        gated.extend_from_slice(&args[..4]);
        gpu.upload(&self.state.gated, &gated);
    }
}

fn round_floor(solver: &Solver) -> f32 {
    match solver.precision {
        Precision::F32 | Precision::Mixed => ROUND_FLOOR_F32,
        // The corrections are as precise as the residual: one round does it.
        Precision::F64 => 0.0,
    }
}

/// sqrt(rr / bb), and 0 for nothing of nothing.
fn relative(rr: f64, bb: f64) -> f64 {
    if rr == 0.0 { 0.0 } else { (rr / bb).sqrt() }
}
