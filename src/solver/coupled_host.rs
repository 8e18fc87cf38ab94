//! The outer loop for liquid and solids together on the host, for adapters without f64: the rounds run on the device, unknowns and
//! residuals are held in f64 here, one exchange per round. And the verdict in f64 on solves in f32.
//!
//! Units and signs as in [`two_field`](super::two_field): r_p = E u* - B phi - J v, r_v = P (rhs - S v + J^T phi).

use std::sync::PoisonError;

use glam::DVec3;

use crate::Error;
use crate::gpu::{Gpu, Pass, Readback, Recorder, StageTimes};
use crate::scene::Solver;
use crate::state::SolveStatus;

use super::Control;
use super::chebyshev::Polynomial;
use super::condensed::{Condensed, Form, Ready};
use super::coupling::{LABELS, Pair};
use super::host_residual::HostPressure;
use super::pcg::N_SCALARS;
use super::refine::{
    GOAL, HostResidual, HostSystem, NORM_B, NORM_R, NORM_TERMS, OF_OTHER, SCALE, STATUS_BREAKDOWN,
    goal, host_turns, relative, round_floor,
};
use super::solid_host::HostElastic;
use super::two_field::{
    CoupledFields, CoupledOutcome, NORM_ACTS, NORM_B_V, NORM_BEST_V, NORM_TERMS_V, TwoFieldSolver,
    UNKNOWNS_V,
};

/// What `shaders/coupled_turn.wgsl` has too.
const ROUND_MARGIN: f64 = 0.3;
const SMALLEST: f64 = 1e-37;
const STRICTER: f64 = 0.03;
const STRICTEST: f64 = 1e-5;

/// Where unknowns and corrections arrive.
#[derive(Debug)]
pub(super) struct CoupledReadbacks {
    /// Potentials.
    of_liquid: Readback<u32>,
    /// Velocities.
    of_nodes: Readback<u32>,
    /// Right-hand side of the wet quads before anything flows through solids.
    base: Readback<u32>,
    /// Dispatch sizes, where the outer loop is the host's.
    args: Option<Readback<u32>>,
}

impl CoupledReadbacks {
    pub(super) fn new(
        gpu: &Gpu,
        at: CoupledFields,
        solver: &Solver,
    ) -> Result<CoupledReadbacks, Error> {
        let CoupledFields {
            liquid, coupling, ..
        } = at;
        let args = || Readback::new(gpu, LABELS.args, coupling.args.len());
        let host_turns = host_turns(solver, liquid.variant);
        Ok(CoupledReadbacks {
            of_liquid: Readback::new(
                gpu,
                "coupled_solver.of_liquid",
                liquid.potential.words.len(),
            )?,
            of_nodes: Readback::new(gpu, "coupled_solver.of_nodes", 4 * coupling.n_nodes)?,
            base: Readback::new(gpu, "coupled_solver.base", coupling.base.words.len())?,
            args: host_turns.then(args).transpose()?,
        })
    }
}

/// Both systems as the device stores them, and J.
#[derive(Debug)]
struct HostCoupled<'a> {
    pressure: HostPressure,
    solids: HostElastic,
    pairs: &'a [Pair],
    /// rho dx^3 / dt, kg/s.
    mass: f64,
}

/// Potentials and velocities, m/s; device layout.
#[derive(Clone, Debug)]
struct Iterate {
    p: Vec<f64>,
    v: Vec<f64>,
}

/// What an iterate leaves of both right-hand sides, m/s; squared norms of that, of what each part puts on the other's rows, and of D times the
/// iterate.
#[derive(Debug)]
struct Left {
    r: Iterate,
    rr: [f64; 2],
    acts: [f64; 2],
    dd: [f64; 2],
}

impl Left {
    /// Squared norms that residuals are relative to, given those of the right-hand sides.
    fn acts(&self, bb: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|part: usize| bb[part].max(OF_OTHER.powi(2) * self.acts[part]))
    }
}

impl HostCoupled<'_> {
    /// Reads both systems back.
    fn download<'a>(
        gpu: &Gpu,
        at: CoupledFields<'a>,
        base: &mut Readback<u32>,
    ) -> Result<HostCoupled<'a>, Error> {
        let coupling = at.coupling;
        let mut recorder = Recorder::new(gpu);
        recorder.read(&coupling.base.words, base);
        recorder.submit();
        let base = coupling.base.widen(&base.wait(gpu)?);
        let pairs = coupling.pairs.as_slice();
        // Turns on the device take J v off where solids are wet.
        let restore = |rhs: &mut [f64]| {
            let wet = pairs.chunk_by(|a, b| a.cell / 4 == b.cell / 4);
            for (wet, base) in wet.zip(base.chunks_exact(4)) {
                let first = wet[0].cell / 4 * 4;
                rhs[first..first + 4].copy_from_slice(base);
            }
        };
        Ok(HostCoupled {
            pressure: HostPressure::download(gpu, at.liquid, u32::MAX, restore)?,
            solids: HostElastic::download(gpu, at.solids, at.fields)?,
            pairs,
            mass: f64::from(coupling.now.mass),
        })
    }

    /// Nothing but what is held.
    fn start(&self) -> Iterate {
        Iterate {
            p: self.pressure.start(),
            v: self.solids.held(),
        }
    }

    /// J^T p in N, four numbers per node.
    fn force(&self, p: &[f64]) -> Vec<f64> {
        let mut force = vec![0.0; 4 * self.solids.n_nodes()];
        for pair in self
            .pairs
            .iter()
            .filter(|pair| self.pressure.active[pair.cell])
        {
            let of_node = &mut force[4 * pair.node..];
            for (force, value) in of_node.iter_mut().zip(pair.value) {
                *force += self.mass * p[pair.cell] * f64::from(value);
            }
        }
        force
    }

    /// E u* - J v.
    fn closed_by(&self, v: &[f64]) -> Vec<f64> {
        let mut rhs = self.pressure.rhs.clone();
        for pair in self.pairs {
            // Closed components have it already: see couple_close.
            if self.pressure.active[pair.cell] && !self.pressure.closed[pair.cell] {
                let value = DVec3::from(pair.value.map(f64::from));
                rhs[pair.cell] -= value.dot(DVec3::from_slice(&v[4 * pair.node..]));
            }
        }
        rhs
    }

    fn left(&self, at: &Iterate) -> Left {
        let rhs = self.closed_by(&at.v);
        let of_liquid = self.pressure.residual_of(&rhs, &at.p);
        let force = self.force(&at.p);
        let mut of_solids = self.solids.residual_with(Some(&force), &at.v);
        of_solids.r.iter_mut().for_each(|r| *r /= self.mass);
        let squared = self.mass * self.mass;
        let both = |of: fn(&HostResidual) -> f64| [of(&of_liquid), of(&of_solids) / squared];
        Left {
            rr: both(|of| of.rr),
            acts: both(|of| of.acts),
            dd: both(|of| of.dd),
            r: Iterate {
                p: of_liquid.r,
                v: of_solids.r,
            },
        }
    }

    /// Squared norm of the terms that the right-hand side of the solids sums.
    fn terms(&self) -> f64 {
        self.solids.terms() / (self.mass * self.mass)
    }
}

/// A round: the residual that it corrects, over its size, and how the device is to begin it.
struct Round<'a> {
    r: &'a Iterate,
    control: Control,
    norms: Vec<f64>,
    /// The part of the squared norm at which it ends.
    goal: f64,
    args: &'a [u32],
}

impl TwoFieldSolver {
    /// As [`TwoFieldSolver::solve`], with the outer loop on the host.
    pub(super) fn solve_with_host_turns<'a>(
        &self,
        gpu: &'a Gpu,
        mut recorder: Recorder,
        at: CoupledFields,
        polynomial: &Polynomial,
        again: bool,
    ) -> Result<(CoupledOutcome, StageTimes), Error> {
        let mut times = Vec::new();
        let (mut condensed, mut without_factor) = (None, false);
        if let Some(kernels) = &self.condensed {
            let (form, mut stages) =
                kernels.ready(gpu, recorder, at, polynomial, |pass| self.record_args(pass))?;
            times.append(&mut stages);
            match form {
                Form::Condensed(ready) => condensed = Some((kernels, ready)),
                Form::TwoField => {}
                Form::WithoutFactor => without_factor = true,
            }
            recorder = Recorder::timed(gpu);
        } else {
            recorder.stage("solve", |pass| self.record_args(pass));
        }
        gpu.upload(&self.polynomial, &[*polynomial]);
        recorder.stage("solve", |pass| self.record_start(pass, at, again));
        let (mut control, mut norms, mut stages) = self.submit(gpu, recorder)?;
        times.append(&mut stages);
        if without_factor {
            control.status = STATUS_BREAKDOWN;
        }
        let (system, args) = self.with_readbacks(|readbacks| {
            let args = readbacks.args.as_mut();
            let args = args.expect("made with every solver whose outer loop is the host's");
            let mut recorder = Recorder::new(gpu);
            recorder.read(&at.coupling.args, args);
            recorder.submit();
            let args = args.wait(gpu)?;
            Ok((HostCoupled::download(gpu, at, &mut readbacks.base)?, args))
        })?;
        control.unknowns += system.solids.n_free();
        norms[UNKNOWNS_V] = f64::from(system.solids.n_free());
        let mut x = system.start();
        let mut left = system.left(&x);
        let bb = left.rr;
        let terms = [norms[NORM_TERMS], system.terms()];
        let worst = |left: &Left| {
            let acts = left.acts(bb);
            let part = |part: usize| {
                let goal = goal(&self.solver, [acts[part], terms[part]], left.dd[part]);
                left.rr[part] / goal.max(SMALLEST)
            };
            // Not a number where one of them is none.
            let [p, v] = [part(0), part(1)];
            if p > v || p.is_nan() { p } else { v }
        };
        let floor = f64::from(round_floor(self.variant.inner));
        let mut strictness = 1.0;
        let status = loop {
            let now = worst(&left);
            if !now.is_finite() {
                break SolveStatus::NonFinite;
            }
            if now <= 1.0 {
                break SolveStatus::Converged;
            }
            if control.iterations >= control.max_iterations {
                break SolveStatus::IterationLimit;
            }
            if control.status == STATUS_BREAKDOWN {
                break SolveStatus::Breakdown;
            }
            let size = (left.rr[0] + left.rr[1]).sqrt();
            let over = |r: &[f64]| r.iter().map(|r| r / size).collect();
            let r = Iterate {
                p: over(&left.r.p),
                v: over(&left.r.v),
            };
            control.rounds += 1;
            norms[NORM_R] = left.rr[0] / (size * size);
            norms[NORM_BEST_V] = left.rr[1] / (size * size);
            let round = Round {
                r: &r,
                control,
                norms: norms.clone(),
                goal: strictness * strictness * (ROUND_MARGIN.powi(2) / now).max(floor * floor),
                args: &args,
            };
            let correction;
            (correction, control) = match &condensed {
                Some((kernels, ready)) => {
                    self.condensed_round(gpu, at, &system, (kernels, ready), round, &mut times)?
                }
                None => self.two_field_round(gpu, at, polynomial, round, &mut times)?,
            };
            let plus = |x: &[f64], by: &[f64]| -> Vec<f64> {
                x.iter().zip(by).map(|(x, by)| x + size * by).collect()
            };
            let better = Iterate {
                p: plus(&x.p, &correction.p),
                v: plus(&x.v, &correction.v),
            };
            let of_better = system.left(&better);
            if worst(&of_better) < now {
                (x, left) = (better, of_better);
                continue;
            }
            // Where the polynomial is poor for a stiff solid the round may have ended too early for the residual that counts.
            strictness *= STRICTER;
            if strictness < STRICTEST {
                break SolveStatus::Stagnated;
            }
        };
        system.pressure.mask(&mut x.p);
        // As turns on the device leave it.
        at.liquid.rhs.upload(gpu, &system.closed_by(&x.v));
        at.liquid.potential.upload(gpu, &x.p);
        at.fields.velocity.upload(gpu, &x.v);
        norms[NORM_B] = bb[0];
        norms[NORM_B_V] = bb[1];
        norms[NORM_TERMS_V] = terms[1];
        norms[NORM_R] = left.rr[0];
        norms[NORM_BEST_V] = left.rr[1];
        for (slot, acts) in NORM_ACTS.into_iter().zip(left.acts(bb)) {
            norms[slot] = acts;
        }
        let mut outcome = self.outcome_of(status, &control, &norms);
        outcome.condensed = condensed.is_some() || without_factor;
        outcome.verified = true;
        Ok((outcome, times))
    }

    /// Evaluates the residuals of a solve in f64.
    pub(super) fn verify(
        &self,
        gpu: &Gpu,
        at: CoupledFields,
        norms: &[f64],
        outcome: &mut CoupledOutcome,
    ) -> Result<(), Error> {
        let left = self.with_readbacks(|readbacks| {
            let mut recorder = Recorder::new(gpu);
            recorder.read(&at.liquid.potential.words, &mut readbacks.of_liquid);
            recorder.read(&at.fields.velocity.words, &mut readbacks.of_nodes);
            recorder.submit();
            let x = Iterate {
                p: at.liquid.potential.widen(&readbacks.of_liquid.wait(gpu)?),
                v: at.fields.velocity.widen(&readbacks.of_nodes.wait(gpu)?),
            };
            Ok(HostCoupled::download(gpu, at, &mut readbacks.base)?.left(&x))
        })?;
        let [rr_p, rr_v] = left.rr;
        let acts = left.acts([norms[NORM_B], norms[NORM_B_V]]);
        outcome.residuals = [relative(rr_p, acts[0]), relative(rr_v, acts[1])];
        outcome.residual_terms = [
            relative(rr_p, norms[NORM_TERMS]),
            relative(rr_v, norms[NORM_TERMS_V]),
        ];
        outcome.verified = true;
        Ok(())
    }

    /// A correction by two-field conjugate gradients.
    fn two_field_round(
        &self,
        gpu: &Gpu,
        at: CoupledFields,
        polynomial: &Polynomial,
        round: Round,
        times: &mut StageTimes,
    ) -> Result<(Iterate, Control), Error> {
        at.solids.outer.upload(gpu, &round.r.v);
        self.open_round(gpu, at, round);
        let degree = polynomial.degree as usize;
        let mut recorder = Recorder::timed(gpu);
        recorder.stage("solve", |pass| self.record_begin(pass));
        let control = self.iterate(gpu, recorder, times, |pass| {
            self.record_iterations(pass, at, degree)
        })?;
        let (n, n_nodes) = (at.liquid.potential.words.len(), 4 * at.coupling.n_nodes);
        let correction = self.with_readbacks(|readbacks| {
            let mut recorder = Recorder::new(gpu);
            recorder.read_part(&at.liquid.search.words, n, &mut readbacks.of_liquid);
            recorder.read_part(&at.solids.search.words, n_nodes, &mut readbacks.of_nodes);
            recorder.submit();
            Ok(Iterate {
                p: at.liquid.search.widen(&readbacks.of_liquid.wait(gpu)?),
                v: at.solids.search.widen(&readbacks.of_nodes.wait(gpu)?),
            })
        })?;
        Ok((correction, control))
    }

    /// A correction by conjugate gradients in the pressures alone.
    fn condensed_round(
        &self,
        gpu: &Gpu,
        at: CoupledFields,
        system: &HostCoupled,
        (condensed, ready): (&Condensed, &Ready),
        round: Round,
        times: &mut StageTimes,
    ) -> Result<(Iterate, Control), Error> {
        let r = round.r;
        condensed.write_start(gpu, &ready.velocity(&r.v, 1.0));
        self.open_round(gpu, at, round);
        let mut recorder = Recorder::timed(gpu);
        recorder.stage("solve", |pass| self.record_condensed_begin(pass, condensed));
        let control = self.iterate(gpu, recorder, times, |pass| {
            self.record_condensed(pass, condensed, at)
        })?;
        let n = at.liquid.potential.words.len();
        let p = self.with_readbacks(|readbacks| {
            let mut recorder = Recorder::new(gpu);
            recorder.read_part(&at.liquid.search.words, n, &mut readbacks.of_liquid);
            recorder.submit();
            Ok(at.liquid.search.widen(&readbacks.of_liquid.wait(gpu)?))
        })?;
        let force = system.force(&p);
        let forces = force.iter().zip(&r.v);
        let forces: Vec<f64> = forces.map(|(f, r)| f / system.mass + r).collect();
        let v = ready.velocity(&forces, 1.0);
        Ok((Iterate { p, v }, control))
    }

    /// What `coupled_turn` does on the device to open a round.
    fn open_round(&self, gpu: &Gpu, at: CoupledFields, mut round: Round) {
        at.liquid.outer.upload(gpu, &round.r.p);
        round.control.running = 1;
        round.control.first = 1;
        gpu.upload(&self.state.control, &[round.control]);
        round.norms[SCALE] = 1.0;
        self.norms.upload(gpu, &round.norms);
        let mut scalars = vec![0.0; N_SCALARS];
        scalars[GOAL] = round.goal;
        self.state.scalars.upload(gpu, &scalars);
        self.state.open(gpu, round.args);
    }

    /// Submits iterations until the round is over.
    fn iterate<'a>(
        &self,
        gpu: &'a Gpu,
        mut recorder: Recorder,
        times: &mut StageTimes,
        record: impl Fn(&mut Pass),
    ) -> Result<Control, Error> {
        loop {
            recorder.stage("solve", &record);
            let (control, _, mut stages) = self.submit(gpu, recorder)?;
            times.append(&mut stages);
            if control.running == 0 {
                return Ok(control);
            }
            recorder = Recorder::timed(gpu);
        }
    }

    fn with_readbacks<T>(
        &self,
        read: impl FnOnce(&mut CoupledReadbacks) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let readbacks = self.to_host.as_ref();
        let readbacks = readbacks.expect("made with every solver whose residual the device rounds");
        // A panic in another solve leaves nothing half done here: every use begins with new copies.
        let mut readbacks = readbacks.lock().unwrap_or_else(PoisonError::into_inner);
        read(&mut readbacks)
    }
}
