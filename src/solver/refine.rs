//! The outer loop: rounds of conjugate gradients on the true residual r = b - A x, and the verdict. The same for every [`System`].

use std::fmt::Debug;
use std::sync::{Mutex, PoisonError};

use crate::Error;
use crate::gpu::{
    Bound, Buffer, Gpu, Kernel, Pass, Readback, Real, RealBuffer, Recorder, StageTimes, Variant,
};
use crate::scene::{Precision, Solver};
use crate::state::SolveStatus;

use super::components::{N_CLOSED, STATE_WORDS};
use super::pcg::{Fold, N_SCALARS, Pcg, State, Unknowns};
use super::{Control, Level};

/// Slots of the norms: `shaders/common/refine.wgsl` names them.
pub(super) const N_NORMS: usize = 8;
pub(super) const NORM_R: usize = 0;
pub(super) const NORM_B: usize = 1;
pub(super) const NORM_TERMS: usize = 2;
pub(super) const SCALE: usize = 4;
/// Slot of the scalars: `shaders/common/pcg_slots.wgsl`.
pub(super) const GOAL: usize = 3;
/// Status in [`Control`] of a round whose first direction has no positive energy: `shaders/common/control_state.wgsl`.
pub(super) const STATUS_BREAKDOWN: u32 = 3;
/// That of a round that made it worse.
pub(super) const STATUS_STAGNATED: u32 = 4;

/// Iterations between two looks at whether the one-workgroup kernels still have work.
pub(super) const BLOCK: usize = 4;
/// Least reduction of a round in f32: recurrences go on falling where the true residual of a correction stays (4e-5 at 80^3).
const ROUND_FLOOR_F32: f32 = 5e-5;
/// Share of its last place that storing an unknown may cost it.
const ROUNDING_OF_X: f64 = 0.5;
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
    /// Active cells, or free components of nodes.
    pub unknowns: u32,
    /// Components without a free surface, if [`Components`](super::Components) looked for them.
    pub closed_components: u32,
    /// |b - A x| / |b|; 0 for b = 0.
    pub residual: f64,
    /// |b - A x| over the norm of the terms that b sums: fluxes, forces.
    pub residual_terms: f64,
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
    components: Option<Readback<u32>>,
    /// The unknowns, where verdicts in f64 are the host's.
    x: Option<Readback<u32>>,
    /// Dispatch sizes and the correction of a round, where the outer loop is the host's.
    args: Option<Readback<u32>>,
    correction: Option<Readback<u32>>,
}

/// The doppelganger of `RefineSettings` in `shaders/common/refine.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct RefineSettings {
    /// Relative tolerance of |r| / |b|.
    pub tolerance: f32,
    /// Of |r| over the norm of the terms that b sums: what rounding leaves.
    pub rounding: f32,
    /// Least reduction of a round.
    pub round_floor: f32,
    /// 1 where the correction holds a guess before the first round, else 0.
    pub guess: f32,
}

impl RefineSettings {
    pub(super) fn new(solver: &Solver, variant: Variant, guesses: bool) -> RefineSettings {
        RefineSettings {
            tolerance: solver.tolerance as f32,
            rounding: rounding(solver) as f32,
            round_floor: round_floor(variant.inner),
            guess: if guesses { 1.0 } else { 0.0 },
        }
    }
}

/// Relative to the terms that the right-hand side sums, what rounding leaves of the residual (design section 5).
pub fn rounding(solver: &Solver) -> f64 {
    match solver.precision {
        Precision::F32 => 1e-7,
        Precision::Mixed | Precision::F64 => 1e-14,
    }
}

/// The share of what liquid puts on solids, or these on it, that counts as a part's right-hand side where it has less of its own:
/// `shaders/coupled_turn.wgsl`.
pub const OF_OTHER: f64 = 0.01;

/// How many dispatches are recorded ahead.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    /// Iterations between two chances to turn from a round to the next.
    pub(super) chunk: usize,
    /// Chances to turn in a submission.
    pub(super) turns: usize,
}

/// A system A x = b that the outer loop solves: what it adds to the state machine.
pub(super) trait System: Debug {
    /// Where it lies, and what is known of it.
    type Buffers<'a>: Copy;
    /// The same on the host.
    type Host: HostSystem;

    /// Whether [`System::record_measure`] leaves a guess in the correction, to be kept if it is better than none.
    const GUESSES: bool;

    /// The quads of the unknowns and the vectors over them.
    fn unknowns<'a>(buffers: Self::Buffers<'a>) -> Unknowns<'a>;

    /// How much is recorded ahead.
    fn pace(&self, buffers: Self::Buffers<'_>) -> Pace;

    /// Records, before the first round: the unknowns take their start; partials of |b|^2, of the squared norm of the terms that b sums,
    /// and of the number of unknowns.
    fn record_measure(&self, pass: &mut Pass, buffers: Self::Buffers<'_>);

    /// Records the true residual, in a turn, with the partials of its squared norm.
    fn record_residual(&self, pass: &mut Pass, state: &State);

    /// Records the start of a round: the scaled residual, a correction of zero.
    fn record_begin(&self, pass: &mut Pass, state: &State);

    /// Records z = H r, with the partials of r . z.
    fn record_preconditioner(&self, pass: &mut Pass, state: &State, buffers: Self::Buffers<'_>);

    /// Records q = A s on the lists whose dispatch sizes stand in `sizes`, with the partials that give alpha.
    fn record_operator(&self, pass: &mut Pass, sizes: &Buffer<u32>);

    /// Records x = x + alpha s, r = r - alpha q.
    fn record_update(&self, pass: &mut Pass, state: &State);

    /// Reads the system back. `closed`: components whose right-hand side still has a mean.
    fn on_host(gpu: &Gpu, buffers: Self::Buffers<'_>, closed: u32) -> Result<Self::Host, Error>;
}

/// A system in f64 on the host, for adapters without f64 and for verdicts on f32 solves. Vectors are in the device layout.
pub(super) trait HostSystem {
    /// What the unknowns start from.
    fn start(&self) -> Vec<f64>;

    /// r = b - A x, 0 where there is no unknown.
    fn residual(&self, x: &[f64]) -> HostResidual;

    /// Puts what is no unknown right.
    fn mask(&self, _x: &mut [f64]) {}
}

/// A residual on the host.
#[derive(Debug)]
pub(super) struct HostResidual {
    pub(super) r: Vec<f64>,
    /// |r|^2
    pub(super) rr: f64,
    /// Squared norm of what the other part of a coupled system puts on the rows; of pressures with b, where that is known together only.
    pub(super) acts: f64,
    /// |D x|^2, D the diagonal of A.
    pub(super) dd: f64,
}

/// |r|^2 that is enough, as on the device: `shaders/refine_turn.wgsl`.
pub(super) fn goal(solver: &Solver, [bb, terms]: [f64; 2], dd: f64) -> f64 {
    let of_x = ROUNDING_OF_X * f64::EPSILON;
    let of_terms = (rounding(solver).powi(2) * terms).max(of_x.powi(2) * dd);
    (solver.tolerance.powi(2) * bb).max(of_terms)
}

/// The solve of a system.
#[derive(Debug)]
pub(super) struct OuterLoop<S> {
    solver: Solver,
    system: S,
    state: State,
    pcg: Pcg,
    norms: RealBuffer,
    settings: Buffer<RefineSettings>,
    readbacks: Mutex<Readbacks>,
    start: Fold,
    correct: Bound,
    turn: Fold,
    /// Scalar types: `real` of the residuals on the device.
    variant: Variant,
    host_turns: bool,
}

impl<S: System> OuterLoop<S> {
    /// Compiles and binds; `system` makes what the system adds, given the state and the norms.
    pub(super) fn new(
        gpu: &Gpu,
        buffers: S::Buffers<'_>,
        solver: &Solver,
        system: impl FnOnce(&State, &RealBuffer) -> Result<S, Error>,
    ) -> Result<OuterLoop<S>, Error> {
        let unknowns = S::unknowns(buffers);
        let Unknowns {
            labels, variant, ..
        } = unknowns;
        let state = State::new(gpu, &unknowns)?;
        let norms = RealBuffer::new(gpu, labels.norms, N_NORMS, variant.real)?;
        let system = system(&state, &norms)?;
        let level: Buffer<Level> = gpu.uniform(labels.level, &unknowns.level)?;
        let kernel = |source| Kernel::new(gpu, source, variant);
        let correct = kernel(&crate::wgsl!("refine_correct"))?.bind(
            gpu,
            &[
                ("level", (&level).into()),
                ("list", unknowns.list.into()),
                ("args", unknowns.args.into()),
                ("flags", unknowns.flags.into()),
                ("norms", (&norms).into()),
                ("search", unknowns.search.into()),
                ("x", unknowns.x.into()),
            ],
        )?;
        let settings = RefineSettings::new(solver, variant, S::GUESSES);
        let settings = gpu.uniform(labels.refine_settings, &settings)?;
        let shared = [
            ("norms", (&norms).into()),
            ("control", (&state.control).into()),
            ("gated", (&state.gated).into()),
            ("settings", (&settings).into()),
        ];
        let sum = |kernel: Kernel, other: &[_]| {
            let sums = [unknowns.outer_partials, &state.outer_folded];
            Fold::new(gpu, &unknowns, &kernel, (sums, unknowns.level.args), other)
        };
        let start = sum(kernel(&crate::wgsl!("refine_start"))?, &shared)?;
        let mut turn = shared.to_vec();
        turn.push(("scalars", (&state.scalars).into()));
        let turn = sum(kernel(&crate::wgsl!("refine_turn"))?, &turn)?;
        let control = Control {
            max_iterations: solver.max_iterations,
            n_lists: unknowns.n_lists as u32,
            ..Control::default()
        };
        gpu.upload(&state.control, &[control]);
        let host_turns = host_turns(solver, variant);
        let components = unknowns
            .components
            .map(|components| Readback::new(gpu, components.label(), STATE_WORDS));
        let kept =
            |needed: bool, label, len| needed.then(|| Readback::new(gpu, label, len)).transpose();
        let n_words = unknowns.x.words.len();
        let readbacks = Mutex::new(Readbacks {
            control: Readback::new(gpu, labels.control, 1)?,
            norms: Readback::new(gpu, labels.norms, norms.words.len())?,
            components: components.transpose()?,
            x: kept(variant.real == Real::F32, labels.x, n_words)?,
            args: kept(host_turns, labels.args, unknowns.args.len())?,
            correction: kept(host_turns, labels.correction, n_words)?,
        });
        Ok(OuterLoop {
            solver: *solver,
            pcg: Pcg::new(gpu, &unknowns, &level, &state)?,
            system,
            state,
            norms,
            settings,
            readbacks,
            start,
            correct,
            turn,
            variant,
            host_turns,
        })
    }

    pub(super) fn set_tolerance(&mut self, gpu: &Gpu, tolerance: f64) {
        self.solver.tolerance = tolerance;
        let settings = RefineSettings::new(&self.solver, self.variant, S::GUESSES);
        gpu.upload(&self.settings, &[settings]);
    }

    /// From a round to the next, where the round is over: correction, true residual, verdict.
    fn record_turn(&self, pass: &mut Pass) {
        self.state.in_turn(pass, &self.correct);
        self.system.record_residual(pass, &self.state);
        self.turn.record(pass);
    }

    fn record_iterations(&self, pass: &mut Pass, buffers: S::Buffers<'_>) {
        for _ in 0..self.system.pace(buffers).chunk / BLOCK {
            self.pcg
                .record(pass, &self.state, &self.system, buffers, BLOCK);
        }
    }

    /// Submits the recording with the solve at its end and waits for the verdict, with a residual in f64: of the host where the device rounds it.
    pub(super) fn solve<'a>(
        &self,
        gpu: &'a Gpu,
        mut recorder: Recorder,
        buffers: S::Buffers<'_>,
    ) -> Result<(Outcome, StageTimes), Error> {
        recorder.stage("solve", |pass| {
            self.system.record_measure(pass, buffers);
            self.start.record(pass);
            if S::GUESSES && !self.host_turns {
                self.record_turn(pass);
            }
        });
        if self.host_turns {
            let mut times = recorder.submit().wait()?;
            let outcome = self.solve_with_host_turns(gpu, buffers, &mut times)?;
            return Ok((outcome, times));
        }
        let mut times = Vec::new();
        loop {
            recorder.stage("solve", |pass| {
                for _ in 0..self.system.pace(buffers).turns {
                    self.record_turn(pass);
                    self.system.record_begin(pass, &self.state);
                    self.record_iterations(pass, buffers);
                }
                self.record_turn(pass);
            });
            let (reading, mut stages) = self.submit(gpu, recorder, buffers)?;
            times.append(&mut stages);
            let norms = &reading.norms;
            let mut outcome = self.outcome(&reading);
            if let Some(outcome) = &mut outcome {
                if reading.control.status == STATUS_STAGNATED {
                    // One more turn, so that a correction on trial is taken back.
                    recorder = Recorder::new(gpu);
                    recorder.stage("solve", |pass| self.record_turn(pass));
                    recorder.submit();
                }
                if !outcome.verified {
                    let x = S::unknowns(buffers).x;
                    let words = self.to_host(gpu, &x.words, 0, |kept| &mut kept.x)?;
                    let HostResidual { rr, .. } =
                        S::on_host(gpu, buffers, 0)?.residual(&x.widen(&words));
                    outcome.residual = relative(rr, norms[NORM_B]);
                    outcome.residual_terms = relative(rr, norms[NORM_TERMS]);
                    outcome.verified = true;
                }
                return Ok((*outcome, times));
            }
            recorder = Recorder::timed(gpu);
        }
    }

    /// q = A x in the precision of the corrections, as PCG evaluates it. Overwrites what a solve computes with.
    pub(super) fn apply(&self, gpu: &Gpu, buffers: S::Buffers<'_>, x: &[f64]) -> Result<(), Error> {
        let Unknowns { search, args, .. } = S::unknowns(buffers);
        search.upload(gpu, x);
        let mut recorder = Recorder::new(gpu);
        recorder.stage("solve", |pass| self.system.record_operator(pass, args));
        recorder.submit();
        gpu.check("solve")
    }

    /// z = H r as PCG evaluates it, for r where the residual of the outer loop stands. Overwrites what a solve computes with.
    pub(super) fn precondition(&self, gpu: &Gpu, buffers: S::Buffers<'_>) -> Result<(), Error> {
        let (mut reading, _) = self.submit(gpu, Recorder::new(gpu), buffers)?;
        let args = gpu.download(S::unknowns(buffers).args)?;
        self.open_round(gpu, &mut reading.control, &mut reading.norms, &args, 1.0);
        let mut recorder = Recorder::new(gpu);
        recorder.stage("solve", |pass| {
            self.system.record_begin(pass, &self.state);
            self.pcg.record_gate(pass);
            self.system
                .record_preconditioner(pass, &self.state, buffers);
        });
        recorder.submit();
        gpu.check("solve")
    }

    fn submit(
        &self,
        gpu: &Gpu,
        mut recorder: Recorder,
        buffers: S::Buffers<'_>,
    ) -> Result<(Reading, StageTimes), Error> {
        // A panic in another solve leaves nothing half done here: every use begins with new copies.
        let mut readbacks = self
            .readbacks
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let Readbacks {
            control,
            norms,
            components,
            ..
        } = &mut *readbacks;
        recorder.read(&self.state.control, control);
        recorder.read(&self.norms.words, norms);
        if let (Some(words), Some(back)) = (S::unknowns(buffers).components, components.as_mut()) {
            recorder.read(words, back);
        }
        let times = recorder.submit().wait()?;
        let reading = Reading {
            control: control.wait(gpu)?[0],
            norms: self.norms.widen(&norms.wait(gpu)?),
            closed: match components {
                Some(components) => components.wait(gpu)?[N_CLOSED],
                None => 0,
            },
        };
        Ok((reading, times))
    }

    /// Reads a part of a buffer, from word `first` on, into one of the kept read-backs.
    fn to_host(
        &self,
        gpu: &Gpu,
        from: &Buffer<u32>,
        first: usize,
        kept: impl FnOnce(&mut Readbacks) -> &mut Option<Readback<u32>>,
    ) -> Result<Vec<u32>, Error> {
        let mut readbacks = self
            .readbacks
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let readback = kept(&mut readbacks).as_mut();
        let readback = readback.expect("made with the solver where the host has a part in it");
        let mut recorder = Recorder::new(gpu);
        recorder.read_part(from, first, readback);
        recorder.submit();
        readback.wait(gpu)
    }

    /// The verdict, or `None` while there is more to do.
    fn outcome(&self, reading: &Reading) -> Option<Outcome> {
        let Reading {
            control,
            norms,
            closed,
        } = reading;
        let finite = norms[NORM_R].is_finite() && norms[NORM_B].is_finite();
        let status = verdict(control, finite)?;
        Some(Outcome {
            status,
            iterations: control.iterations,
            rounds: control.rounds,
            unknowns: control.unknowns,
            closed_components: *closed,
            residual: relative(norms[NORM_R], norms[NORM_B]),
            residual_terms: relative(norms[NORM_R], norms[NORM_TERMS]),
            verified: self.variant.real == Real::F64,
        })
    }

    /// The outer loop for adapters without f64: the rounds run on the device, the unknowns and the residual are held in f64 on
    /// the host, one exchange per round.
    fn solve_with_host_turns(
        &self,
        gpu: &Gpu,
        buffers: S::Buffers<'_>,
        times: &mut StageTimes,
    ) -> Result<Outcome, Error> {
        let (reading, _) = self.submit(gpu, Recorder::new(gpu), buffers)?;
        let Reading {
            mut control,
            mut norms,
            closed,
        } = reading;
        let system = S::on_host(gpu, buffers, closed)?;
        let unknowns = S::unknowns(buffers);
        let args = self.to_host(gpu, unknowns.args, 0, |kept| &mut kept.args)?;
        let mut x = system.start();
        let HostResidual {
            mut r,
            mut rr,
            mut dd,
            ..
        } = system.residual(&x);
        let status = loop {
            let goal = goal(&self.solver, [norms[NORM_B], norms[NORM_TERMS]], dd);
            if !rr.is_finite() {
                break SolveStatus::NonFinite;
            }
            if rr <= goal {
                break SolveStatus::Converged;
            }
            if control.iterations >= control.max_iterations {
                break SolveStatus::IterationLimit;
            }
            if control.status == STATUS_BREAKDOWN {
                break SolveStatus::Breakdown;
            }
            let scale = rr.sqrt();
            let scaled: Vec<f64> = r.iter().map(|value| value / scale).collect();
            unknowns.outer.upload(gpu, &scaled);
            self.open_round(gpu, &mut control, &mut norms, &args, goal / rr);
            let mut recorder = Recorder::timed(gpu);
            recorder.stage("solve", |pass| self.system.record_begin(pass, &self.state));
            loop {
                recorder.stage("solve", |pass| self.record_iterations(pass, buffers));
                let (reading, mut stages) = self.submit(gpu, recorder, buffers)?;
                times.append(&mut stages);
                control = reading.control;
                if control.running == 0 {
                    break;
                }
                recorder = Recorder::timed(gpu);
            }
            let search = &unknowns.search;
            let words = self.to_host(gpu, &search.words, x.len(), |kept| &mut kept.correction)?;
            let correction = search.widen(&words);
            let better: Vec<f64> = x
                .iter()
                .zip(&correction)
                .map(|(x, correction)| x + scale * correction)
                .collect();
            let residual = system.residual(&better);
            // As in `refine_turn`: of the first round alone a breakdown is told.
            let broke_down = control.status == STATUS_BREAKDOWN && control.rounds == 1;
            let worse = residual.rr.is_finite() && residual.rr >= rr;
            if worse && !broke_down {
                break match control.iterations >= control.max_iterations {
                    true => SolveStatus::IterationLimit,
                    false => SolveStatus::Stagnated,
                };
            }
            (x, r, rr, dd) = (better, residual.r, residual.rr, residual.dd);
        };
        system.mask(&mut x);
        unknowns.x.upload(gpu, &x);
        Ok(Outcome {
            status,
            iterations: control.iterations,
            rounds: control.rounds,
            unknowns: control.unknowns,
            closed_components: closed,
            residual: relative(rr, norms[NORM_B]),
            residual_terms: relative(rr, norms[NORM_TERMS]),
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
        let mut scalars = vec![0.0; N_SCALARS];
        let floor = f64::from(round_floor(self.variant.inner));
        scalars[GOAL] = (ROUND_MARGIN.powi(2) * left).max(floor.powi(2));
        self.state.scalars.upload(gpu, &scalars);
        self.state.open(gpu, args);
    }
}

/// Whether the outer loop runs on the host: `mixed` where the device has no f64 to refine in.
pub(super) fn host_turns(solver: &Solver, variant: Variant) -> bool {
    solver.precision == Precision::Mixed && variant.real == Real::F32
}

/// Rounds in f32 end early; those as precise as the residual take one to do it all.
pub(super) fn round_floor(inner: Real) -> f32 {
    match inner {
        Real::F32 => ROUND_FLOOR_F32,
        Real::F64 => 0.0,
    }
}

/// How a solve ended, or `None` while there is more to do.
pub(super) fn verdict(control: &Control, finite: bool) -> Option<SolveStatus> {
    Some(match control.status {
        _ if !finite => SolveStatus::NonFinite,
        0 => return None,
        1 => SolveStatus::Converged,
        2 => SolveStatus::IterationLimit,
        STATUS_BREAKDOWN if control.running == 1 => return None,
        STATUS_BREAKDOWN => SolveStatus::Breakdown,
        // The last correction made it worse and is taken back, but the limit is what ended the solve.
        _ if control.iterations >= control.max_iterations => SolveStatus::IterationLimit,
        _ => SolveStatus::Stagnated,
    })
}

/// sqrt(rr / bb), and 0 where b is nothing: its squares may be below what f32 can tell from 0, and then the unknowns that are 0 solve it.
pub(super) fn relative(rr: f64, bb: f64) -> f64 {
    if bb == 0.0 { 0.0 } else { (rr / bb).sqrt() }
}
