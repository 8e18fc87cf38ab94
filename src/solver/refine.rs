//! Outer loop: iterative refinement on the true residual r = b - A x, the same for every [`System`].
//!
//! A refinement step solves A dx = r / |r| by conjugate gradients. A residual evaluation accepts or rejects x + |r| dx
//! ([`acceptance`](super::acceptance)) and begins the next step or ends the solve. Both are recorded ahead; kernels write their dispatch sizes.
//! Adapters without f64 evaluate residuals on the host, one exchange per step.

use std::collections::VecDeque;
use std::fmt::Debug;
use std::sync::Mutex;

use crate::Error;
use crate::fields::pressure_system::{N_CLOSED, STATE_WORDS};
use crate::gpu::{
    Arrays, Binding, Bound, Buffer, Gpu, Pass, Readback, Real, RealBuffer, Recorder, StageTimes, Variant, bind, lock,
};
use crate::scene::{Precision, Solver};
use crate::state::SolveStatus;
use crate::step::Stage;
use crate::wgsl;

use super::acceptance::{
    Acceptance, REFERENCE, RESIDUAL, RHS, RefineSettings, SCALE, TERMS, evaluation_slot, n_norms, norm_slot, reference,
    relative,
};
use super::pcg::{Block, Fold, N_SCALARS, Pcg, State, Unknowns};
use super::schur::Elimination;
use super::{Control, Level, plus};

/// Slot of the scalars: `shaders/common/pcg_slots.wgsl`.
const GOAL: usize = 3;
/// Status in [`Control`] where the first direction of a refinement step has no positive energy: `shaders/common/control_state.wgsl`.
const STATUS_BREAKDOWN: u32 = 3;
/// Status in [`Control`] if the last correction was rejected.
const STATUS_STAGNATED: u32 = 4;

/// Result of a solve, of one block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// Status.
    pub status: SolveStatus,
    /// Iterations of conjugate gradients in all refinement steps.
    pub iterations: u32,
    /// Refinement steps.
    pub refinements: u32,
    /// Active cells, or free directions of nodes.
    pub unknowns: u32,
    /// Enclosed components, where the stage `closed_components` looked for them.
    pub closed_components: u32,
    /// |b - A x| / |b|; 0 for b = 0.
    pub residual: f64,
    /// |b - A x| over the norm of the terms that b sums: fluxes, forces.
    pub residual_terms: f64,
    /// Whether `residual` was evaluated in f64.
    pub verified: bool,
}

/// State of the device, as read back.
#[derive(Debug)]
struct Reading {
    control: Control,
    norms: Vec<f64>,
    closed: u32,
    /// Four numbers per node for the form that eliminates them.
    nodes: Vec<f64>,
}

/// Read-backs.
#[derive(Debug)]
struct Readbacks {
    control: Readback<Control>,
    norms: Readback<u32>,
    components: Option<Readback<u32>>,
    /// Unknowns or correction of each block, where residuals are evaluated on the host.
    blocks: Vec<Readback<u32>>,
    /// Dispatch sizes, where the outer loop is the host's.
    args: Option<Readback<u32>>,
}

/// Dispatches recorded ahead. Those that turn out to be needless run empty; where there are too few, the host waits once more.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    /// Iterations in a refinement step.
    pub(super) iterations: usize,
    /// Iterations between two gates of the one-workgroup kernels.
    pub(super) gate: usize,
    /// Refinement steps before the host waits.
    pub(super) steps: usize,
}

/// Cost of a completed solve.
#[derive(Clone, Copy, Debug)]
struct Past {
    aim: Aim,
    iterations: usize,
    steps: usize,
}

/// The latest solves.
#[derive(Debug, Default)]
struct Latest(Mutex<VecDeque<Past>>);

impl Latest {
    /// Number of solves kept of each aim: active sets of a sub-step alternate.
    const N: usize = 8;
    /// Iterations of a refinement step in excess of the mean: the first takes more than the others.
    const SPARE: usize = 2;

    /// Adds a solve, with the refinement steps that were recorded for it where the first recording did not suffice.
    fn push(&self, aim: Aim, solved: &Outcome, recorded: Option<usize>) {
        let steps = recorded.unwrap_or(solved.refinements as usize);
        let mut list = lock(&self.0);
        list.push_front(Past { aim, iterations: solved.iterations as usize, steps: steps.max(1) });
        let mut same = 0;
        list.retain(|past| {
            same += usize::from(past.aim == aim);
            past.aim != aim || same <= Latest::N
        });
    }

    /// Pace that the latest solves with an aim would have needed; that of the first one without any.
    fn pace(&self, aim: Aim, first: Pace) -> Pace {
        let list = lock(&self.0);
        let same = || list.iter().filter(|past| past.aim == aim);
        let mean = same().map(|past| past.iterations.div_ceil(past.steps)).max();
        let steps = same().map(|past| past.steps).max();
        Pace {
            iterations: mean.map_or(first.iterations, |mean| first.iterations.min(mean + Latest::SPARE)),
            steps: steps.map_or(first.steps, |steps| first.steps.min(steps)),
            ..first
        }
    }
}

/// Form of the corrections.
#[derive(Clone, Copy, Debug)]
pub(super) enum Form<'a> {
    /// Conjugate gradients in all blocks.
    Monolithic,
    /// In the first alone; the second is eliminated on the host.
    Schur(Elimination<'a>),
    /// The block to be eliminated has no factor.
    Singular,
}

/// A linear system of one or more blocks, symmetric and positive definite after elimination: what it adds to the outer loop.
pub(super) trait System: Debug {
    /// Buffers, and choices of a solve.
    type Case<'a>: Copy;
    /// The system on the host.
    type Host<'a>: HostSystem;

    /// Whether [`System::record_start`] leaves a guess in the correction, to be kept where it is better than zero.
    const GUESSES: bool = false;

    fn unknowns<'a>(case: Self::Case<'a>) -> Unknowns<'a>;

    fn form<'a>(_: Self::Case<'a>) -> Form<'a> {
        Form::Monolithic
    }

    /// Pace of the first solve, and the most of later ones.
    fn pace(&self, case: Self::Case<'_>) -> Pace;

    /// Driver of conjugate gradients for the form, given that of the monolithic one.
    fn pcg<'a>(&'a self, monolithic: &'a Pcg, _: Self::Case<'_>) -> &'a Pcg {
        monolithic
    }

    /// Before everything: dispatch sizes and set-up of the preconditioner.
    fn record_set_up(&self, _: &mut Pass, _: Self::Case<'_>) {}

    /// Unknowns at the start; partials of |b|^2, of the squared norm of its terms and of the number of unknowns, of the first block.
    fn record_start(&self, pass: &mut Pass, case: Self::Case<'_>);

    /// True residual, partials of its evaluation for the first block, norms of the other blocks.
    fn record_residual(&self, pass: &mut Pass, state: &State);

    /// Scaled residual as conjugate gradients start from it; correction of zero.
    fn record_begin(&self, pass: &mut Pass, state: &State, pcg: &Pcg, case: Self::Case<'_>);

    /// z = H r, with the partials of r . z.
    fn record_preconditioner(&self, pass: &mut Pass, state: &State, case: Self::Case<'_>);

    /// Search directions of the blocks but the first.
    fn record_direction(&self, _: &mut Pass, _: &State, _: Self::Case<'_>) {}

    /// q = A s on the lists whose dispatch sizes stand in `sizes`, with the partials that give alpha.
    fn record_operator(&self, pass: &mut Pass, state: &State, sizes: &Buffer<u32>, case: Self::Case<'_>);

    /// x = x + alpha s, r = r - alpha q.
    fn record_update(&self, pass: &mut Pass, state: &State, case: Self::Case<'_>);

    /// Reads the system back. `closed`: enclosed components whose right-hand side still has a mean.
    fn on_host<'a>(&self, gpu: &Gpu, case: Self::Case<'a>, closed: u32) -> Result<Self::Host<'a>, Error>;
}

/// A system in f64 on the host. Vectors by block, in the device layout.
pub(super) trait HostSystem {
    fn start(&self) -> Vec<Vec<f64>>;

    /// r = b - A x, 0 where there is no unknown.
    fn residuals(&self, x: &[Vec<f64>]) -> Vec<HostResidual>;

    /// Completes norms and number of unknowns, given the residuals of the start.
    fn complete(&self, _start: &[HostResidual], _norms: &mut [f64], _control: &mut Control) {}

    /// Coupling terms of the second block, of a correction of the first.
    fn coupling(&self, _first: &[f64]) -> Vec<f64> {
        Vec::new()
    }

    /// Replaces the right-hand side of the second block.
    fn set_forces(&mut self, _: Vec<f64>) {}

    /// Before the unknowns are uploaded: what else evaluations on the device leave behind.
    fn finish(&self, _: &Gpu, _x: &mut [Vec<f64>]) {}
}

/// Residual of a block on the host.
#[derive(Debug)]
pub(super) struct HostResidual {
    pub(super) r: Vec<f64>,
    /// |r|^2
    pub(super) rr: f64,
    /// Squared norm of the coupling terms; for pressures it includes b.
    pub(super) coupling: f64,
    /// |D x|^2, D the diagonal of A.
    pub(super) dd: f64,
}

/// Accuracy and start of a solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Aim {
    /// Bound of |r| relative to the right-hand side.
    pub(crate) tolerance: f64,
    /// Whether the solve starts from the correction as it stands, unless zero is better.
    pub(crate) guess: bool,
}

/// The solve of a system.
#[derive(Debug)]
pub(super) struct OuterLoop<S> {
    solver: Solver,
    pub(super) system: S,
    state: State,
    pcg: Pcg,
    norms: RealBuffer,
    settings: Buffer<RefineSettings>,
    n_blocks: usize,
    readbacks: Mutex<Readbacks>,
    start: Fold,
    /// x = x + scale dx of each block.
    correct: Vec<Bound>,
    accept: Fold,
    /// Scalar types: `real` of the residuals on the device.
    variant: Variant,
    on_host: bool,
    latest: Latest,
}

/// State machine and norms, before the system is bound to them.
#[derive(Debug)]
pub(super) struct Shared<'a> {
    pub(super) state: &'a State,
    pub(super) norms: &'a RealBuffer,
    /// Layout of the first block.
    pub(super) level: &'a Buffer<Level>,
    pub(super) unknowns: &'a Unknowns<'a>,
}

impl Arrays for Shared<'_> {
    fn array(&self, name: &str) -> Option<Binding<'_>> {
        match name {
            "norms" => Some(self.norms.into()),
            _ => self.state.array(name),
        }
    }
}

impl<S: System> OuterLoop<S> {
    /// Compiles and binds; `system` binds what the system adds.
    pub(super) fn new(
        gpu: &Gpu,
        case: S::Case<'_>,
        solver: &Solver,
        system: impl FnOnce(&Shared) -> Result<S, Error>,
    ) -> Result<OuterLoop<S>, Error> {
        let unknowns = S::unknowns(case);
        let Unknowns { group, blocks, variant, .. } = &unknowns;
        let (variant, n_blocks) = (*variant, blocks.len());
        let label = |name: &str| format!("{group}.{name}");
        let state = State::new(gpu, &unknowns)?;
        let norms = RealBuffer::new(gpu, &label("norms"), n_norms(n_blocks), variant.real)?;
        let levels =
            blocks.iter().map(|block| gpu.uniform(&label("level"), &block.level)).collect::<Result<Vec<_>, _>>()?;
        let correct = blocks.iter().zip(&levels).map(|(block, level)| {
            let own = [
                ("level", level.into()),
                ("list", block.list.into()),
                ("args", block.args.into()),
                ("flags", block.flags.into()),
                ("norms", (&norms).into()),
                ("search", block.search.into()),
                ("x", block.x.into()),
            ];
            bind(gpu, &wgsl!("refine_correct"), block.variant, own, &[])
        });
        let correct = correct.collect::<Result<_, _>>()?;
        let settings = RefineSettings::new(solver, variant, S::GUESSES, n_blocks);
        let settings = gpu.uniform(&label("refine_settings"), &settings)?;
        let shared = Shared { state: &state, norms: &norms, level: &levels[0], unknowns: &unknowns };
        let own = [("settings", (&settings).into())];
        let sum = |source| {
            let sums = [unknowns.outer_partials, &state.outer_folded];
            let sums = (sums, blocks[0].level.args);
            Fold::new(gpu, &unknowns, &source, variant, sums, &[&own, &shared])
        };
        let system = system(&shared)?;
        let start = sum(wgsl!("refine_start"))?;
        let accept = sum(wgsl!("refine_accept"))?;
        let control =
            Control { max_iterations: solver.max_iterations, n_lists: unknowns.n_lists as u32, ..Control::default() };
        gpu.upload(&state.control, &[control]);
        let on_host = on_host(solver, variant);
        let components = unknowns.components.map(|components| Readback::new(gpu, components.label(), STATE_WORDS));
        let of_blocks = blocks.iter().filter(|_| variant.real == Real::F32);
        let of_blocks = of_blocks.map(|block| Readback::new(gpu, block.x.words.label(), block.x.words.len()));
        let args = || Readback::new(gpu, &label("args"), blocks[0].args.len());
        let readbacks = Mutex::new(Readbacks {
            control: Readback::new(gpu, &label("control"), 1)?,
            norms: Readback::new(gpu, &label("norms"), norms.words.len())?,
            components: components.transpose()?,
            blocks: of_blocks.collect::<Result<_, _>>()?,
            args: on_host.then(args).transpose()?,
        });
        Ok(OuterLoop {
            solver: *solver,
            pcg: Pcg::new(gpu, &unknowns, &levels[0], &state)?,
            system,
            state,
            norms,
            settings,
            n_blocks,
            readbacks,
            start,
            correct,
            accept,
            variant,
            on_host,
            latest: Latest::default(),
        })
    }

    pub(super) fn tolerance(&self) -> f64 {
        self.solver.tolerance
    }

    pub(super) fn set_tolerance(&mut self, gpu: &Gpu, tolerance: f64) {
        self.solver.tolerance = tolerance;
        gpu.upload(&self.settings, &[self.settings(self.aim())]);
    }

    /// As set for all solves.
    fn aim(&self) -> Aim {
        Aim { tolerance: self.solver.tolerance, guess: S::GUESSES }
    }

    /// Settings of the solver to a tolerance.
    fn solver_to(&self, tolerance: f64) -> Solver {
        Solver { tolerance, ..self.solver }
    }

    fn settings(&self, aim: Aim) -> RefineSettings {
        let solver = self.solver_to(aim.tolerance);
        RefineSettings::new(&solver, self.variant, aim.guess, self.n_blocks)
    }

    /// Correction, true residuals and acceptance, where a refinement step is over.
    fn record_evaluation(&self, pass: &mut Pass) {
        for bound in &self.correct {
            self.state.in_evaluation(pass, bound);
        }
        self.system.record_residual(pass, &self.state);
        self.accept.record(pass);
    }

    fn record_begin(&self, pass: &mut Pass, case: S::Case<'_>) {
        let pcg = self.system.pcg(&self.pcg, case);
        self.system.record_begin(pass, &self.state, pcg, case);
    }

    fn record_iterations(&self, pass: &mut Pass, aim: Aim, case: S::Case<'_>) {
        let pcg = self.system.pcg(&self.pcg, case);
        pcg.record(pass, &self.state, &self.system, case, self.pace(aim, case));
    }

    fn pace(&self, aim: Aim, case: S::Case<'_>) -> Pace {
        self.latest.pace(aim, self.system.pace(case))
    }

    /// Submits the recording with the solve at its end and waits for the outcome of each block, with residuals in f64: of the host where
    /// the device rounds them. `aim`: of this solve, where it differs from that of all. `then` adds work at the end of every submission.
    /// Returns whether that work has read the solution.
    pub(super) fn solve(
        &self,
        gpu: &Gpu,
        recorder: Recorder,
        case: S::Case<'_>,
        aim: Option<Aim>,
        then: &mut dyn FnMut(&mut Recorder),
    ) -> Result<(Vec<Outcome>, StageTimes, bool), Error> {
        let mut times = StageTimes::new();
        let outcomes = match aim {
            None => self.refine(gpu, recorder, case, self.aim(), then, &mut times)?,
            Some(Aim { tolerance, guess }) => {
                // The host, where it refines, has no use for a guess.
                let aim = Aim { tolerance, guess: guess && !self.on_host };
                gpu.upload(&self.settings, &[self.settings(aim)]);
                let outcomes = self.refine(gpu, recorder, case, aim, then, &mut times)?;
                gpu.upload(&self.settings, &[self.settings(self.aim())]);
                outcomes
            }
        };
        let read = outcomes[0].status == SolveStatus::Converged && !self.on_host;
        Ok((outcomes, times, read))
    }

    fn refine(
        &self,
        gpu: &Gpu,
        mut recorder: Recorder,
        case: S::Case<'_>,
        aim: Aim,
        then: &mut dyn FnMut(&mut Recorder),
        times: &mut StageTimes,
    ) -> Result<Vec<Outcome>, Error> {
        self.clear(gpu, case);
        let form = S::form(case);
        let monolithic = matches!(form, Form::Monolithic);
        recorder.stage(Stage::Solve.name(), |pass| {
            self.system.record_start(pass, case);
            self.start.record(pass);
            // A guess of several blocks is evaluated after zero.
            let early = usize::from(S::GUESSES || !monolithic) + usize::from(aim.guess && self.n_blocks > 1);
            if !self.on_host {
                (0..early).for_each(|_| self.record_evaluation(pass));
            }
        });
        if self.on_host {
            let outcomes = self.solve_on_host(gpu, recorder, case, aim, times)?;
            self.latest.push(aim, &outcomes[0], None);
            return Ok(outcomes);
        }
        let steps = self.pace(aim, case).steps;
        let mut recordings = 0;
        loop {
            recordings += 1;
            if monolithic {
                for _ in 0..steps {
                    recorder.stage(Stage::Solve.name(), |pass| {
                        self.record_evaluation(pass);
                        self.record_begin(pass, case);
                        self.record_iterations(pass, aim, case);
                    });
                }
                recorder.stage(Stage::Solve.name(), |pass| self.record_evaluation(pass));
            }
            let residual = match form {
                Form::Schur(elimination) => Some((S::unknowns(case).blocks[1].outer, elimination.readback)),
                Form::Monolithic | Form::Singular => None,
            };
            then(&mut recorder);
            let reading = self.submit(gpu, recorder, case, residual, times)?;
            if let Some(status) = status(&reading, self.n_blocks) {
                if reading.control.status == STATUS_STAGNATED {
                    if let Form::Schur(elimination) = form {
                        elimination.revert(gpu);
                    }
                    // One more evaluation, which subtracts the rejected correction.
                    recorder = Recorder::new(gpu);
                    recorder.stage(Stage::Solve.name(), |pass| self.record_evaluation(pass));
                    recorder.submit();
                }
                let outcomes = self.verified(gpu, case, status, reading)?;
                self.latest.push(aim, &outcomes[0], (monolithic && recordings > 1).then_some(recordings * steps));
                return Ok(outcomes);
            }
            recorder = match form {
                Form::Monolithic => Recorder::timed(gpu),
                Form::Schur(elimination) => self.refine_schur(gpu, (case, aim), elimination, reading, times)?,
                Form::Singular => return self.verified(gpu, case, SolveStatus::Breakdown, reading),
            };
        }
    }

    /// A refinement step in the first block, with the second eliminated before and recovered after, and the next evaluation recorded.
    fn refine_schur(
        &self,
        gpu: &Gpu,
        (case, aim): (S::Case<'_>, Aim),
        elimination: Elimination,
        reading: Reading,
        times: &mut StageTimes,
    ) -> Result<Recorder, Error> {
        // Else a rejected correction is to be subtracted first.
        if reading.control.running == 1 {
            let size = reading.norms[SCALE];
            elimination.eliminate(gpu, &reading.nodes, size, 1.0);
            let force = self.iterate(gpu, (case, aim), Some(elimination), times)?.nodes;
            let forces = plus(&reading.nodes, size, &force);
            let mut search = vec![0.0; forces.len()];
            search.extend(elimination.correct(gpu, &forces, size, 1.0).0);
            S::unknowns(case).blocks[1].search.upload(gpu, &search);
        } else {
            elimination.revert(gpu);
        }
        let mut recorder = Recorder::timed(gpu);
        recorder.stage(Stage::Solve.name(), |pass| self.record_evaluation(pass));
        Ok(recorder)
    }

    /// Before a solve in the Schur-complement form: nothing is left of a monolithic one.
    fn clear(&self, gpu: &Gpu, case: S::Case<'_>) {
        if !self.on_host && !matches!(S::form(case), Form::Monolithic) {
            self.state.scalars.upload(gpu, &[0.0; N_SCALARS]);
            for block in &S::unknowns(case).blocks[1..] {
                let n = 4 * block.search.words.len() / block.search.real.bytes();
                block.search.upload(gpu, &vec![0.0; n]);
            }
        }
    }

    /// q = A x in the precision of the corrections, as conjugate gradients evaluate it; x by block. Overwrites work arrays of the solve.
    pub(super) fn apply(&self, gpu: &Gpu, case: S::Case<'_>, x: &[&[f64]]) -> Result<(), Error> {
        let blocks = S::unknowns(case).blocks;
        for (block, x) in blocks.iter().zip(x) {
            block.search.upload(gpu, x);
        }
        let mut recorder = Recorder::new(gpu);
        recorder.stage(Stage::Solve.name(), |pass| {
            self.system.record_set_up(pass, case);
            let sizes = blocks[0].args;
            self.system.record_operator(pass, &self.state, sizes, case);
        });
        recorder.submit();
        gpu.check(Stage::Solve.name())
    }

    /// z = H r as conjugate gradients evaluate it, with r written by `begin`. Overwrites work arrays of the solve.
    pub(super) fn precondition(
        &self,
        gpu: &Gpu,
        case: S::Case<'_>,
        begin: impl FnOnce(&S, &mut Pass, &State),
    ) -> Result<(), Error> {
        let mut recorder = Recorder::new(gpu);
        recorder.stage(Stage::Solve.name(), |pass| self.system.record_set_up(pass, case));
        let mut reading = self.submit(gpu, recorder, case, None, &mut StageTimes::new())?;
        let args = gpu.download(S::unknowns(case).blocks[0].args)?;
        self.open(gpu, &mut reading, &args, 1.0);
        let mut recorder = Recorder::new(gpu);
        recorder.stage(Stage::Solve.name(), |pass| {
            begin(&self.system, pass, &self.state);
            self.pcg.record_gate(pass);
            self.system.record_preconditioner(pass, &self.state, case);
        });
        recorder.submit();
        gpu.check(Stage::Solve.name())
    }

    /// Submits and reads the state back, with four numbers per node of a form that eliminates them.
    fn submit(
        &self,
        gpu: &Gpu,
        mut recorder: Recorder,
        case: S::Case<'_>,
        nodes: Option<(&RealBuffer, &Mutex<Readback<u32>>)>,
        times: &mut StageTimes,
    ) -> Result<Reading, Error> {
        let mut readbacks = lock(&self.readbacks);
        let Readbacks { control, norms, components, .. } = &mut *readbacks;
        recorder.read(&self.state.control, control);
        recorder.read(&self.norms.words, norms);
        if let (Some(words), Some(back)) = (S::unknowns(case).components, components.as_mut()) {
            recorder.read(words, back);
        }
        let mut nodes = nodes.map(|(nodes, readback)| (nodes, lock(readback)));
        if let Some((nodes, readback)) = &mut nodes {
            recorder.read(&nodes.words, readback);
        }
        times.append(&mut recorder.submit().wait()?);
        Ok(Reading {
            control: control.wait(gpu)?[0],
            norms: self.norms.widen(&norms.wait(gpu)?),
            closed: match components {
                Some(components) => components.wait(gpu)?[N_CLOSED],
                None => 0,
            },
            nodes: match &mut nodes {
                Some((nodes, readback)) => nodes.widen(&readback.wait(gpu)?),
                None => Vec::new(),
            },
        })
    }

    /// Reads unknowns back, or corrections: of the first blocks as many as there are buffers.
    fn read_blocks<'b>(&self, gpu: &Gpu, blocks: &[Block<'b>], correction: bool) -> Result<Vec<Vec<f64>>, Error> {
        let mut readbacks = lock(&self.readbacks);
        let mut recorder = Recorder::new(gpu);
        let from = |block: &Block<'b>| if correction { block.search } else { block.x };
        for (block, back) in blocks.iter().zip(&mut readbacks.blocks) {
            let words = &from(block).words;
            // The correction is the second half of the search direction.
            let first = if correction { words.len() / 2 } else { 0 };
            recorder.read_part(words, first, back);
        }
        recorder.submit();
        let blocks = blocks.iter().zip(&mut readbacks.blocks);
        blocks.map(|(block, back)| Ok(from(block).widen(&back.wait(gpu)?))).collect()
    }

    /// Outcomes by block, with residuals evaluated on the host where the device rounded them.
    fn verified(
        &self,
        gpu: &Gpu,
        case: S::Case<'_>,
        status: SolveStatus,
        mut reading: Reading,
    ) -> Result<Vec<Outcome>, Error> {
        if self.variant.real == Real::F32 {
            let x = self.read_blocks(gpu, &S::unknowns(case).blocks, false)?;
            let residuals = self.system.on_host(gpu, case, 0)?.residuals(&x);
            set_norms(&mut reading.norms, &residuals);
        }
        Ok(self.outcomes(status, &reading))
    }

    fn outcomes(&self, status: SolveStatus, reading: &Reading) -> Vec<Outcome> {
        let Reading { control, norms, .. } = reading;
        let of_others = (1..self.n_blocks).map(|block| norms[evaluation_slot(block, self.n_blocks) + 2] as u32);
        let mut unknowns: Vec<u32> = std::iter::once(0).chain(of_others).collect();
        unknowns[0] = control.unknowns - unknowns.iter().sum::<u32>();
        let outcome = |(block, unknowns)| {
            let norm = |norm| norms[norm_slot(block, norm)];
            Outcome {
                status,
                iterations: control.iterations,
                refinements: control.refinements,
                unknowns,
                closed_components: reading.closed,
                residual: relative(norm(RESIDUAL), norm(REFERENCE)),
                residual_terms: relative(norm(RESIDUAL), norm(TERMS)),
                verified: true,
            }
        };
        unknowns.into_iter().enumerate().map(outcome).collect()
    }

    /// The outer loop on the host: corrections on the device, unknowns and residuals in f64 here.
    fn solve_on_host(
        &self,
        gpu: &Gpu,
        recorder: Recorder,
        case: S::Case<'_>,
        aim: Aim,
        times: &mut StageTimes,
    ) -> Result<Vec<Outcome>, Error> {
        let mut reading = self.submit(gpu, recorder, case, None, times)?;
        let form = S::form(case);
        if let Form::Singular = form {
            reading.control.status = STATUS_BREAKDOWN;
        }
        let args = lock(&self.readbacks)
            .args
            .as_mut()
            .expect("made with every solver whose outer loop is the host's")
            .fetch(gpu, S::unknowns(case).blocks[0].args)?;
        let mut system = self.system.on_host(gpu, case, reading.closed)?;
        let mut x = system.start();
        let mut residuals = system.residuals(&x);
        let Reading { norms, control, .. } = &mut reading;
        system.complete(&residuals, norms, control);
        let mut acceptance = Acceptance::new(&self.solver_to(aim.tolerance), &self.settings(aim));
        let mut worst = acceptance.worst(&residuals, &reading.norms);
        let status = loop {
            if !worst.is_finite() {
                break SolveStatus::NonFinite;
            }
            if worst <= 1.0 {
                break SolveStatus::Converged;
            }
            if reading.control.iterations >= reading.control.max_iterations {
                break SolveStatus::IterationLimit;
            }
            if reading.control.status == STATUS_BREAKDOWN {
                break SolveStatus::Breakdown;
            }
            let size = residuals.iter().map(|block| block.rr).sum::<f64>().sqrt();
            let scaled = residuals.iter();
            let scaled = scaled.map(|block| block.r.iter().map(|r| r / size).collect());
            let scaled: Vec<Vec<f64>> = scaled.collect();
            for (block, residual) in residuals.iter().enumerate() {
                reading.norms[norm_slot(block, RESIDUAL)] = residual.rr / (size * size);
            }
            let goal = acceptance.inner_tolerance(worst);
            let blocks = S::unknowns(case).blocks;
            match form {
                Form::Schur(elimination) => {
                    elimination.eliminate(gpu, &scaled[1], 1.0, 1.0 / size);
                    blocks[0].outer.upload(gpu, &scaled[0]);
                }
                Form::Monolithic | Form::Singular => {
                    for (block, scaled) in blocks.iter().zip(&scaled) {
                        block.outer.upload(gpu, scaled);
                    }
                }
            }
            reading.control.refinements += 1;
            self.open(gpu, &mut reading, &args, goal);
            reading.control = self.iterate(gpu, (case, aim), None, times)?.control;
            let correction = self.correction(gpu, case, &mut system, (&scaled, 1.0 / size))?;
            let better = x.iter().zip(&correction).map(|(x, dx)| plus(x, size, dx));
            let better: Vec<Vec<f64>> = better.collect();
            let after = system.residuals(&better);
            let worst_after = acceptance.worst(&after, &reading.norms);
            let Control { status, refinements, .. } = reading.control;
            let broke_down = status == STATUS_BREAKDOWN;
            if worst_after >= worst && !(broke_down && refinements == 1) {
                if let Form::Schur(elimination) = form
                    && let Some(rhs) = elimination.revert(gpu)
                {
                    system.set_forces(rhs);
                }
                if acceptance.retry() && !broke_down {
                    continue;
                }
                break match reading.control.iterations >= reading.control.max_iterations {
                    true => SolveStatus::IterationLimit,
                    false => SolveStatus::Stagnated,
                };
            }
            (x, residuals, worst) = (better, after, worst_after);
        };
        set_norms(&mut reading.norms, &residuals);
        system.finish(gpu, &mut x);
        for (block, x) in S::unknowns(case).blocks.iter().zip(&x) {
            block.x.upload(gpu, x);
        }
        Ok(self.outcomes(status, &reading))
    }

    /// Begins a refinement step from the host, as `refine_accept` does on the device; the residual is scaled already.
    fn open(&self, gpu: &Gpu, reading: &mut Reading, args: &[u32], goal: f64) {
        reading.control.running = 1;
        reading.control.first = 1;
        gpu.upload(&self.state.control, &[reading.control]);
        reading.norms[SCALE] = 1.0;
        self.norms.upload(gpu, &reading.norms);
        let mut scalars = vec![0.0; N_SCALARS];
        scalars[GOAL] = goal;
        self.state.scalars.upload(gpu, &scalars);
        self.state.open(gpu, args);
    }

    /// Submits iterations until the refinement step is over; reads back the force of an elimination.
    fn iterate(
        &self,
        gpu: &Gpu,
        (case, aim): (S::Case<'_>, Aim),
        elimination: Option<Elimination>,
        times: &mut StageTimes,
    ) -> Result<Reading, Error> {
        let mut recorder = Recorder::timed(gpu);
        recorder.stage(Stage::Solve.name(), |pass| self.record_begin(pass, case));
        loop {
            recorder.stage(Stage::Solve.name(), |pass| {
                self.record_iterations(pass, aim, case);
                elimination.iter().for_each(|elimination| elimination.record_force(pass));
            });
            let force = elimination.map(|elimination| (elimination.force, elimination.readback));
            let reading = self.submit(gpu, recorder, case, force, times)?;
            if reading.control.running == 0 {
                return Ok(reading);
            }
            recorder = Recorder::timed(gpu);
        }
    }

    /// Reads the correction of a refinement step back; an eliminated block follows from the first and its scaled residual.
    fn correction(
        &self,
        gpu: &Gpu,
        case: S::Case<'_>,
        system: &mut S::Host<'_>,
        (scaled, unit): (&[Vec<f64>], f64),
    ) -> Result<Vec<Vec<f64>>, Error> {
        let blocks = S::unknowns(case).blocks;
        let Form::Schur(elimination) = S::form(case) else {
            return self.read_blocks(gpu, &blocks, true);
        };
        let mut correction = self.read_blocks(gpu, &blocks[..1], true)?;
        let forces = plus(&system.coupling(&correction[0]), 1.0, &scaled[1]);
        let (velocity, rhs) = elimination.correct(gpu, &forces, 1.0, unit);
        if let Some(rhs) = rhs {
            system.set_forces(rhs);
        }
        correction.push(velocity);
        Ok(correction)
    }
}

/// Whether the outer loop runs on the host: `mixed` where the device has no f64 to refine in.
pub(super) fn on_host(solver: &Solver, variant: Variant) -> bool {
    solver.precision == Precision::Mixed && variant.real == Real::F32
}

/// Writes the norms of an evaluation on the host.
fn set_norms(norms: &mut [f64], residuals: &[HostResidual]) {
    for (block, residual) in residuals.iter().enumerate() {
        norms[norm_slot(block, REFERENCE)] = reference(block, residual, norms);
        norms[norm_slot(block, RESIDUAL)] = residual.rr;
    }
}

/// Status of a solve that is over.
fn status(reading: &Reading, n_blocks: usize) -> Option<SolveStatus> {
    let Reading { control, norms, .. } = reading;
    let finite = |norm| (0..n_blocks).all(|block| norms[norm_slot(block, norm)].is_finite());
    Some(match control.status {
        _ if !finite(RESIDUAL) || !finite(RHS) => SolveStatus::NonFinite,
        0 => return None,
        1 => SolveStatus::Converged,
        2 => SolveStatus::IterationLimit,
        STATUS_BREAKDOWN if control.running == 1 => return None,
        STATUS_BREAKDOWN => SolveStatus::Breakdown,
        // The last correction was rejected, but the limit is what ended the solve.
        _ if control.iterations >= control.max_iterations => SolveStatus::IterationLimit,
        _ => SolveStatus::Stagnated,
    })
}
