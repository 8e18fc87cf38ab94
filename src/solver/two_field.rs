//! The coupled solve in its two-field form (thesis 5.25), matrix-free, refined on the residual of the indefinite system.
//!
//! ```text
//!   [B  J; J^T -S] [phi; v] = [E u*; -rhs]         r_p = E u* - B phi - J v,   r_v = P (rhs - S v + J^T phi)
//! ```
//!
//! in the units of the pressure's system: phi is a potential, m/s, rows of the liquid are divided by dx^2 and those of the solids by
//! rho dx^3/dt, the mass rate of a cell, so that J is the same in both. A correction (dp, dv) solves A [dp; dv] = g,
//!
//! ```text
//!   g = [r_p - J Z1^-1 r_v; Z2 Z1^-1 r_v],   A s = [B s_p + J t; Z2 (s_v - t)],   t = Z1^-1 (J^T s_p - Z2 s_v)
//! ```
//!
//! with Z1 = sigma zeta_M M and Z2 = S - Z1: the factored form, which never adds what it later subtracts (design section 5). It is
//! preconditioned by t = Sh g_v, z_p = H (g_p + J t), z_v = Sh (J^T z_p + Z1 t), H the V-cycle of the pressure and Sh the polynomial of
//! the solids. Vectors of the liquid are as precise as the corrections, those of the solids as the residuals: they are few, and Z2 is
//! stiff.

use std::sync::{Mutex, PoisonError};

use crate::Error;
use crate::gpu::{
    Bound, Buffer, Gpu, Kernel, Pass, Readback, Real, RealBuffer, Recorder, StageTimes, Variant,
};
use crate::scene::{Formulation, Preconditioner, Solver};
use crate::state::SolveStatus;

use super::chebyshev::Polynomial;
use super::condensed::{Condensed, check_formulation};
use super::coupled_host::CoupledReadbacks;
use super::coupling::{BODIES, CouplingBuffers, LABELS, N_LISTS, NODES, PARTIALS, WET};
use super::pcg::{Fold, Pcg, State, Unknowns};
use super::pressure::{FIRST_SWEEP, Pressure};
use super::refine::{
    NORM_B, NORM_R, NORM_TERMS, Outcome, RefineSettings, SCALE, STATUS_STAGNATED, System,
    host_turns, relative, verdict,
};
use super::solid_contacts::ContactSearch;
use super::solid_solver::Chebyshev;
use super::solid_system::{SolidFields, SolidSystemBuffers};
use super::two_field_jacobi::Jacobi;
use super::{Control, SolverBuffers};

/// Slots of the norms: `shaders/common/refine.wgsl` names them, also those that other systems lack.
pub(super) const N_NORMS: usize = 15;
pub(super) const NORM_B_V: usize = 6;
pub(super) const NORM_TERMS_V: usize = 7;
pub(super) const UNKNOWNS_V: usize = 9;
pub(super) const NORM_BEST_V: usize = 10;
/// Of both parts: what residuals are relative to.
pub(super) const NORM_ACTS: [usize; 2] = [13, 14];
/// Dispatches of an iteration besides those of V-cycle and polynomial, about.
const DISPATCHES: usize = 24;
/// Dispatches that are recorded ahead of a chance to turn, and iterations, at most.
const AHEAD: usize = 512;
const CHUNK: usize = 12;
const TURNS: usize = 2;

/// What is known after a coupled solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoupledOutcome {
    /// How it ended.
    pub status: SolveStatus,
    /// PCG iterations in all rounds.
    pub iterations: u32,
    /// Rounds.
    pub rounds: u32,
    /// Active cells, and free directions of nodes.
    pub unknowns: [u32; 2],
    /// |r| over |b| of the rows of the liquid and of those of the solids; 0 for b = 0.
    pub residuals: [f64; 2],
    /// |r| over the norm of the terms that b sums, likewise.
    pub residual_terms: [f64; 2],
    /// Whether these were evaluated in f64.
    pub verified: bool,
    /// Whether corrections were made in the condensed form.
    pub condensed: bool,
}

impl CoupledOutcome {
    /// The part of the liquid, which has so many closed components, and that of the solids. Both have all iterations.
    pub fn parts(&self, closed_components: u32) -> [Outcome; 2] {
        [(0, closed_components), (1, 0)].map(|(part, closed_components)| Outcome {
            status: self.status,
            iterations: self.iterations,
            rounds: self.rounds,
            unknowns: self.unknowns[part],
            closed_components,
            residual: self.residuals[part],
            residual_terms: self.residual_terms[part],
            verified: self.verified,
        })
    }
}

/// What the solve reads and writes.
#[derive(Clone, Copy, Debug)]
pub struct CoupledFields<'a> {
    /// The system of the liquid.
    pub liquid: &'a SolverBuffers,
    /// The system of the solids.
    pub solids: &'a SolidSystemBuffers,
    /// What the solids are.
    pub fields: SolidFields<'a>,
    /// J.
    pub coupling: &'a CouplingBuffers,
    /// u* on the faces.
    pub velocity: &'a Buffer<f32>,
    /// Open fractions of the faces.
    pub open: &'a Buffer<f32>,
}

/// The kernels of the two-field solve.
#[derive(Debug)]
pub struct TwoFieldSolver {
    pub(super) solver: Solver,
    pub(super) state: State,
    pub(super) pcg: Pcg,
    pub(super) pressure: Pressure,
    pub(super) norms: RealBuffer,
    settings: Buffer<RefineSettings>,
    args: Bound,
    start: Fold,
    turn: Fold,
    correct: [Bound; 2],
    guess: Bound,
    keep: Bound,
    residual: Residual,
    pub(super) begin: Begin,
    preconditioner: Precondition,
    pub(super) operator: Operator,
    beta: Bound,
    alpha: Bound,
    direction: Bound,
    update: Bound,
    push: Bound,
    search: ContactSearch,
    /// The other form of the correction, where it serves.
    pub(super) condensed: Option<Condensed>,
    pub(super) polynomial: Buffer<Polynomial>,
    readbacks: Mutex<(Readback<Control>, Readback<u32>)>,
    /// What the host judges with where the device rounds the residuals.
    pub(super) to_host: Option<Mutex<CoupledReadbacks>>,
    /// Slots of nodes, solids and wet quads.
    slots: [usize; 3],
    pub(super) variant: Variant,
}

#[derive(Debug)]
struct Residual {
    /// b - J v in the wet quads; products of the elements with v, what they leave of the right-hand side, with J^T phi; sums.
    quads: Bound,
    products: Bound,
    solid: Bound,
    nodes: Bound,
    sums: Bound,
}

#[derive(Debug)]
pub(super) struct Begin {
    nodes: Bound,
    products: Bound,
    rhs: Bound,
    quads: Bound,
    pub(super) weight: Bound,
}

#[derive(Debug)]
enum Precondition {
    Factored(Box<Factored>),
    Diagonal(Box<Jacobi>),
}

#[derive(Debug)]
struct Factored {
    /// t = Sh g_v, then z_v = Sh y.
    polynomials: [Chebyshev; 2],
    right: Bound,
    restore: Bound,
    nodes: Bound,
    z: Bound,
}

#[derive(Debug)]
pub(super) struct Operator {
    products: [Bound; 2],
    pub(super) force: Bound,
    half: Bound,
    apply: Bound,
    quads: Bound,
}

impl TwoFieldSolver {
    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Gpu::buffer`]; [`Error::Limit`] where the condensed form is asked for and does not serve.
    pub fn new(gpu: &Gpu, at: CoupledFields, solver: &Solver) -> Result<TwoFieldSolver, Error> {
        let CoupledFields {
            liquid,
            solids,
            fields,
            coupling,
            ..
        } = at;
        let variant = liquid.variant;
        if !gpu.is_planning() {
            check_formulation(solids.layout.rows.n_nodes as usize, solver, variant)?;
        }
        let unknowns = unknowns(at);
        let state = State::new(gpu, &unknowns)?;
        let norms = RealBuffer::new(gpu, LABELS.norms, N_NORMS, variant.real)?;
        let pressure = Pressure::new(gpu, liquid, &state, &norms, at.velocity, at.open, solver)?;
        let polynomial = gpu.uniform("coupled_solver.polynomial", &Polynomial::new(0, 1.0))?;
        let level = gpu.uniform(LABELS.level, &unknowns.level)?;
        let sweep = gpu.uniform("coupled_solver.sweep", &FIRST_SWEEP)?;
        let settings = RefineSettings::new(solver, variant, false);
        let settings = gpu.uniform(LABELS.refine_settings, &settings)?;

        let kernel = |source| Kernel::new(gpu, source, variant);
        let wide = |source| Kernel::new(gpu, source, variant.real);
        let joint = ("coupling", (&coupling.coupling).into());
        let words = ("words", (&coupling.words).into());
        let by_quad = ("pairs", (&coupling.quad_pairs).into());
        let by_node = ("pairs", (&coupling.node_pairs).into());
        let flags = ("flags", (&liquid.flags).into());
        let freedom = ("freedom", fields.freedom.into());
        let rows = ("rows", (&solids.rows).into());
        let incidence = ("incidence", (&solids.incidence).into());
        let products = ("products", (&solids.products).into());
        let masses = ("masses", (&solids.masses).into());
        let partials = ("partials", (&coupling.partials).into());
        let norm_slots = ("norms", (&norms).into());
        let scalars = ("scalars", (&state.scalars).into());
        let t = ("t", (&coupling.t).into());
        let base = ("base", (&coupling.base).into());
        let difference = ("difference", (&coupling.difference).into());
        let product_of = |x| solids.bind_products(gpu, fields, x);
        let sum_joint = |source| {
            kernel(source)?.bind(
                gpu,
                &[
                    joint,
                    ("args", (&coupling.args).into()),
                    partials,
                    scalars,
                    ("all_partials", (&liquid.partials).into()),
                ],
            )
        };
        let shared = [
            norm_slots,
            ("control", (&state.control).into()),
            ("gated", (&state.gated).into()),
            ("settings", (&settings).into()),
        ];
        let sum = |kernel: Kernel, other: &[_]| {
            let sums = [&liquid.outer_partials, &state.outer_folded];
            Fold::new(gpu, &unknowns, &kernel, (sums, unknowns.level.args), other)
        };
        let mut turn = shared.to_vec();
        turn.push(scalars);
        let control = Control {
            max_iterations: solver.max_iterations,
            n_lists: unknowns.n_lists as u32,
            ..Control::default()
        };
        gpu.upload(&state.control, &[control]);
        let slots = [NODES, BODIES, WET].map(|list| coupling.slot(list));
        Ok(TwoFieldSolver {
            solver: *solver,
            args: kernel(&crate::wgsl!("coupled_args"))?.bind(
                gpu,
                &[
                    joint,
                    ("from_args", (&liquid.args).into()),
                    ("sizes", (&coupling.sizes).into()),
                    ("args", (&coupling.args).into()),
                ],
            )?,
            start: sum(kernel(&crate::wgsl!("refine_start"))?, &shared)?,
            turn: sum(kernel(&crate::wgsl!("coupled_turn"))?, &turn)?,
            correct: [
                kernel(&crate::wgsl!("refine_correct"))?.bind(
                    gpu,
                    &[
                        ("level", (&level).into()),
                        ("list", (&liquid.list).into()),
                        ("args", (&coupling.args).into()),
                        flags,
                        norm_slots,
                        ("search", (&liquid.search).into()),
                        ("x", (&liquid.potential).into()),
                    ],
                )?,
                wide(&crate::wgsl!("two_field_correct"))?.bind(
                    gpu,
                    &[
                        joint,
                        norm_slots,
                        ("search", (&solids.search).into()),
                        ("x", fields.velocity.into()),
                    ],
                )?,
            ],
            guess: solids.bind_guess(gpu, fields)?,
            keep: wide(&crate::wgsl!("couple_keep"))?
                .bind(gpu, &[joint, words, ("rhs", (&liquid.rhs).into()), base])?,
            residual: Residual {
                products: product_of(fields.velocity)?,
                solid: solids.bind_residual(gpu, fields)?,
                nodes: wide(&crate::wgsl!("coupled_residual"))?.bind(
                    gpu,
                    &[
                        joint,
                        words,
                        by_node,
                        flags,
                        freedom,
                        ("sums", (&solids.partials).into()),
                        ("p", (&liquid.potential).into()),
                        ("outer", (&solids.outer).into()),
                        partials,
                    ],
                )?,
                quads: wide(&crate::wgsl!("couple_residual"))?.bind(
                    gpu,
                    &[
                        joint,
                        words,
                        by_quad,
                        flags,
                        ("x", fields.velocity.into()),
                        base,
                        ("rhs", (&liquid.rhs).into()),
                    ],
                )?,
                sums: wide(&crate::wgsl!("coupled_sums"))?
                    .bind(gpu, &[joint, partials, norm_slots])?,
            },
            begin: Begin {
                nodes: wide(&crate::wgsl!("two_field_begin"))?.bind(
                    gpu,
                    &[
                        joint,
                        norm_slots,
                        masses,
                        ("outer", (&solids.outer).into()),
                        t,
                        ("search", (&solids.search).into()),
                    ],
                )?,
                products: product_of(&coupling.t)?,
                rhs: wide(&crate::wgsl!("two_field_rhs"))?.bind(
                    gpu,
                    &[
                        joint,
                        rows,
                        freedom,
                        incidence,
                        products,
                        masses,
                        t,
                        ("r", (&solids.r).into()),
                    ],
                )?,
                quads: kernel(&crate::wgsl!("couple_begin"))?.bind(
                    gpu,
                    &[
                        joint,
                        words,
                        by_quad,
                        flags,
                        ("x", (&coupling.t).into()),
                        ("r", (&liquid.r).into()),
                        partials,
                    ],
                )?,
                weight: kernel(&crate::wgsl!("two_field_weight"))?.bind(
                    gpu,
                    &[
                        joint,
                        partials,
                        norm_slots,
                        ("control", (&state.control).into()),
                        scalars,
                    ],
                )?,
            },
            preconditioner: match solver.preconditioner {
                Preconditioner::Multigrid => Precondition::Factored(Box::new(Factored {
                    polynomials: [
                        Chebyshev::new(gpu, solids, &polynomial, &solids.r, &coupling.t)?,
                        Chebyshev::new(gpu, solids, &polynomial, &coupling.difference, &solids.z)?,
                    ],
                    right: kernel(&crate::wgsl!("couple_right"))?.bind(
                        gpu,
                        &[
                            joint,
                            ("level", (&level).into()),
                            ("sweep", (&sweep).into()),
                            words,
                            by_quad,
                            flags,
                            ("x", (&coupling.t).into()),
                            ("matrix", (&liquid.matrix).into()),
                            ("r", (&liquid.r).into()),
                            ("z", (&liquid.z).into()),
                            ("kept", (&coupling.kept).into()),
                        ],
                    )?,
                    restore: kernel(&crate::wgsl!("couple_restore"))?.bind(
                        gpu,
                        &[
                            joint,
                            words,
                            ("kept", (&coupling.kept).into()),
                            ("z", (&liquid.z_next).into()),
                            ("r", (&liquid.r).into()),
                            partials,
                        ],
                    )?,
                    nodes: kernel(&crate::wgsl!("couple_nodes"))?.bind(
                        gpu,
                        &[
                            joint,
                            words,
                            by_node,
                            flags,
                            freedom,
                            ("p", (&liquid.z_next).into()),
                            masses,
                            t,
                            ("y", (&coupling.difference).into()),
                        ],
                    )?,
                    z: wide(&crate::wgsl!("two_field_z"))?.bind(
                        gpu,
                        &[
                            joint,
                            ("r", (&solids.r).into()),
                            masses,
                            t,
                            ("z", (&solids.z).into()),
                            partials,
                        ],
                    )?,
                })),
                kind => Precondition::Diagonal(Box::new(Jacobi::new(
                    gpu,
                    at,
                    &level,
                    &polynomial,
                    kind,
                )?)),
            },
            operator: Operator {
                products: [
                    product_of(&solids.search)?,
                    product_of(&coupling.difference)?,
                ],
                force: kernel(&crate::wgsl!("couple_force"))?.bind(
                    gpu,
                    &[
                        joint,
                        words,
                        by_node,
                        flags,
                        ("p", (&liquid.search).into()),
                        t,
                    ],
                )?,
                half: wide(&crate::wgsl!("two_field_half"))?.bind(
                    gpu,
                    &[
                        joint,
                        rows,
                        freedom,
                        incidence,
                        products,
                        masses,
                        ("search", (&solids.search).into()),
                        t,
                        difference,
                        partials,
                    ],
                )?,
                apply: wide(&crate::wgsl!("two_field_apply"))?.bind(
                    gpu,
                    &[
                        joint,
                        rows,
                        freedom,
                        incidence,
                        products,
                        masses,
                        difference,
                        ("q_out", (&solids.q).into()),
                    ],
                )?,
                quads: kernel(&crate::wgsl!("couple_apply"))?.bind(
                    gpu,
                    &[
                        joint,
                        words,
                        by_quad,
                        flags,
                        ("x", (&coupling.t).into()),
                        ("search", (&liquid.search).into()),
                        ("r", (&liquid.r).into()),
                        ("q", (&liquid.q).into()),
                        partials,
                    ],
                )?,
            },
            beta: sum_joint(&crate::wgsl!("couple_beta"))?,
            alpha: sum_joint(&crate::wgsl!("couple_alpha"))?,
            direction: kernel(&crate::wgsl!("two_field_direction"))?.bind(
                gpu,
                &[
                    joint,
                    scalars,
                    ("z", (&solids.z).into()),
                    ("search", (&solids.search).into()),
                ],
            )?,
            update: kernel(&crate::wgsl!("two_field_update"))?.bind(
                gpu,
                &[
                    joint,
                    scalars,
                    ("search", (&solids.search).into()),
                    ("q_in", (&solids.q).into()),
                    ("r", (&solids.r).into()),
                ],
            )?,
            push: wide(&crate::wgsl!("couple_push"))?.bind(
                gpu,
                &[
                    joint,
                    words,
                    by_node,
                    flags,
                    ("p", (&liquid.potential).into()),
                    ("rhs", (&solids.rhs).into()),
                    ("pushed", (&coupling.difference).into()),
                ],
            )?,
            search: ContactSearch::new(gpu, solids, fields, &coupling.difference)?,
            condensed: match solver.formulation {
                Formulation::TwoField => None,
                Formulation::Auto | Formulation::Condensed => {
                    Condensed::new(gpu, at, &unknowns, &state, (&level, &sweep), solver)?
                }
            },
            readbacks: Mutex::new((
                Readback::new(gpu, LABELS.control, 1)?,
                Readback::new(gpu, LABELS.norms, norms.words.len())?,
            )),
            to_host: (variant.real == Real::F32)
                .then(|| CoupledReadbacks::new(gpu, at, solver).map(Mutex::new))
                .transpose()?,
            pcg: Pcg::new(gpu, &unknowns, &level, &state)?,
            slots,
            variant,
            pressure,
            polynomial,
            state,
            norms,
            settings,
        })
    }

    /// Submits the recording, which ends with both systems and J in place, with the solve at its end, and waits for the verdict. Potential
    /// and velocity are the answer. `polynomial`: of the solids' preconditioner, for this step's S. `again`: the same right-hand side as
    /// in the last solve, whatever is held now.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails. A solve that does not converge is an outcome, not an error.
    pub fn solve<'a>(
        &self,
        gpu: &'a Gpu,
        mut recorder: Recorder,
        at: CoupledFields,
        polynomial: &Polynomial,
        again: bool,
    ) -> Result<(CoupledOutcome, StageTimes), Error> {
        if host_turns(&self.solver, self.variant) {
            return self.solve_with_host_turns(gpu, recorder, at, polynomial, again);
        }
        let mut times = Vec::new();
        if let Some(condensed) = &self.condensed {
            let (outcome, mut stages) =
                self.solve_condensed(condensed, gpu, recorder, at, polynomial, again)?;
            times.append(&mut stages);
            if let Some(outcome) = outcome {
                return Ok((outcome, times));
            }
            recorder = Recorder::timed(gpu);
        }
        gpu.upload(&self.polynomial, &[*polynomial]);
        let degree = polynomial.degree as usize;
        recorder.stage("solve", |pass| {
            self.record_args(pass);
            self.record_start(pass, at, again);
        });
        loop {
            recorder.stage("solve", |pass| {
                for _ in 0..TURNS {
                    self.record_turn(pass);
                    self.record_begin(pass);
                    self.record_iterations(pass, at, degree);
                }
                self.record_turn(pass);
            });
            let (control, norms, mut stages) = self.submit(gpu, recorder)?;
            times.append(&mut stages);
            if let Some(mut outcome) = self.outcome(&control, &norms) {
                if control.status == STATUS_STAGNATED {
                    // One more turn, so that a correction on trial is taken back.
                    recorder = Recorder::new(gpu);
                    recorder.stage("solve", |pass| self.record_turn(pass));
                    recorder.submit();
                }
                if !outcome.verified {
                    self.verify(gpu, at, &norms, &mut outcome)?;
                }
                return Ok((outcome, times));
            }
            recorder = Recorder::timed(gpu);
        }
    }

    /// From the next solve on, another tolerance of both residuals.
    pub fn set_tolerance(&mut self, gpu: &Gpu, tolerance: f64) {
        self.solver.tolerance = tolerance;
        let settings = RefineSettings::new(&self.solver, self.variant, false);
        gpu.upload(&self.settings, &[settings]);
    }

    /// Records, after a solve, what pushes the nodes: all that the search for what is held asks of the liquid.
    pub fn record_push(&self, pass: &mut Pass, n_nodes: usize) {
        pass.dispatch(&self.push, n_nodes);
    }

    /// The search for what walls and obstacles hold.
    pub fn search(&self) -> &ContactSearch {
        &self.search
    }

    /// A x as conjugate gradients evaluate it; x and the answer: quads of level 0 in the device layout, then four numbers per node. What
    /// the answer has in inactive cells means nothing. Overwrites what a solve computes with.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn apply(&self, gpu: &Gpu, at: CoupledFields, x: &[f64]) -> Result<Vec<f64>, Error> {
        let (of_p, of_v) = x.split_at(4 * at.liquid.plan.levels[0].quads);
        at.liquid.search.upload(gpu, of_p);
        at.solids.search.upload(gpu, of_v);
        let mut recorder = Recorder::new(gpu);
        recorder.stage("solve", |pass| {
            self.record_args(pass);
            self.record_operator(pass, &at.coupling.args);
        });
        recorder.submit();
        gpu.check("solve")?;
        let mut q = at.liquid.q.download(gpu)?;
        q.extend(at.solids.q.download(gpu)?);
        Ok(q)
    }

    /// The preconditioner of a residual g, as conjugate gradients evaluate it; vectors as those of [`TwoFieldSolver::apply`], g 0 in
    /// inactive cells and in what is held. Overwrites what a solve computes with.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn precondition(
        &self,
        gpu: &Gpu,
        at: CoupledFields,
        polynomial: &Polynomial,
        g: &[f64],
    ) -> Result<Vec<f64>, Error> {
        gpu.upload(&self.polynomial, &[*polynomial]);
        let n = 4 * at.liquid.plan.levels[0].quads;
        let (of_p, of_v) = g.split_at(n);
        at.liquid.outer.upload(gpu, of_p);
        at.solids.r.upload(gpu, of_v);
        let mut norms = vec![0.0; N_NORMS];
        norms[SCALE] = 1.0;
        self.norms.upload(gpu, &norms);
        let mut recorder = Recorder::new(gpu);
        recorder.stage("solve", |pass| {
            self.record_args(pass);
            self.record_set_up(pass);
        });
        recorder.submit();
        let args = gpu.download(&at.coupling.args)?;
        let control = Control {
            running: 1,
            first: 1,
            max_iterations: self.solver.max_iterations,
            n_lists: (at.liquid.plan.len() + N_LISTS) as u32,
            ..Control::default()
        };
        gpu.upload(&self.state.control, &[control]);
        self.state.open(gpu, &args);
        let mut recorder = Recorder::new(gpu);
        recorder.stage("solve", |pass| {
            self.pressure.record_begin(pass, &self.state);
            self.pcg.record_gate(pass);
            self.record_preconditioner(pass, at, polynomial.degree as usize);
        });
        recorder.submit();
        gpu.check("solve")?;
        let mut z = at.liquid.z_next.download(gpu)?;
        z.truncate(n);
        z.extend(at.solids.z.download(gpu)?);
        Ok(z)
    }

    /// The sizes of all lists, once the active cells are known.
    pub(super) fn record_args(&self, pass: &mut Pass) {
        pass.dispatch(&self.args, 1);
    }

    /// The set-up of the preconditioner, where it has any.
    fn record_set_up(&self, pass: &mut Pass) {
        if let Precondition::Diagonal(jacobi) = &self.preconditioner {
            jacobi.record_set_up(pass);
        }
    }

    /// Where the solve starts from, and the size of the right-hand sides.
    pub(super) fn record_start(&self, pass: &mut Pass, at: CoupledFields, again: bool) {
        self.pressure.record_measure(pass, at.liquid);
        self.record_set_up(pass);
        pass.dispatch_indirect(&self.guess, &at.coupling.args, self.slots[NODES]);
        if !again {
            pass.dispatch_indirect(&self.keep, &at.coupling.args, self.slots[WET]);
        }
        self.start.record(pass);
    }

    /// Correction, true residuals, verdict, where a round is over.
    pub(super) fn record_turn(&self, pass: &mut Pass) {
        let Residual {
            products,
            solid,
            nodes,
            quads,
            sums,
        } = &self.residual;
        for bound in &self.correct {
            self.state.in_turn(pass, bound);
        }
        self.state.in_turn(pass, quads);
        self.pressure.record_residual(pass, &self.state);
        for bound in [products, solid, nodes] {
            self.state.in_turn(pass, bound);
        }
        pass.dispatch(sums, 1);
        self.turn.record(pass);
    }

    /// The right-hand side of a correction.
    pub(super) fn record_begin(&self, pass: &mut Pass) {
        let Begin {
            nodes,
            products,
            rhs,
            quads,
            weight,
        } = &self.begin;
        self.pressure.record_begin(pass, &self.state);
        for bound in [nodes, products, rhs, quads] {
            self.state.in_begin(pass, bound);
        }
        self.pcg.record_gate(pass);
        pass.dispatch_indirect(weight, &self.state.gate, 0);
    }

    pub(super) fn record_iterations(&self, pass: &mut Pass, at: CoupledFields, degree: usize) {
        let steps = match &self.preconditioner {
            Precondition::Factored(factored) => 2 * factored.polynomials[0].dispatches(degree),
            Precondition::Diagonal(jacobi) => jacobi.polynomial.dispatches(degree),
        };
        let count = (AHEAD / (DISPATCHES + steps)).clamp(2, CHUNK);
        let nodes = self.slots[NODES];
        let (state, gated) = (&self.state, &self.state.gated);
        self.pcg.record_gate(pass);
        for _ in 0..count {
            self.record_preconditioner(pass, at, degree);
            pass.dispatch_indirect(&self.beta, &state.gate, 0);
            self.pcg.beta.record_gated(pass, &state.gate);
            state.in_round(pass, &self.pcg.direction, 0);
            pass.dispatch_indirect(&self.direction, gated, nodes);
            self.record_operator(pass, gated);
            pass.dispatch_indirect(&self.alpha, &state.gate, 0);
            self.pcg.alpha.record_gated(pass, &state.gate);
            self.pressure.record_update(pass, state);
            state.in_update(pass, &self.update);
        }
    }

    /// Symmetric and positive, since polynomial and V-cycle are, and diagonals.
    fn record_preconditioner(&self, pass: &mut Pass, at: CoupledFields, degree: usize) {
        let [nodes, bodies, wet] = self.slots;
        let gated = &self.state.gated;
        let Factored {
            polynomials,
            right,
            restore,
            nodes: of_nodes,
            z,
        } = match &self.preconditioner {
            Precondition::Factored(factored) => &**factored,
            Precondition::Diagonal(jacobi) => {
                self.pressure
                    .record_preconditioner(pass, &self.state, at.liquid);
                jacobi.record(pass, gated, self.slots, degree);
                return;
            }
        };
        polynomials[0].record(pass, gated, [nodes, bodies], degree);
        pass.dispatch_indirect(right, gated, wet);
        self.pressure
            .record_preconditioner(pass, &self.state, at.liquid);
        pass.dispatch_indirect(restore, gated, wet);
        pass.dispatch_indirect(of_nodes, gated, nodes);
        polynomials[1].record(pass, gated, [nodes, bodies], degree);
        pass.dispatch_indirect(z, gated, nodes);
    }

    /// q = A s, in the factored form.
    fn record_operator(&self, pass: &mut Pass, sizes: &Buffer<u32>) {
        let [nodes, _, wet] = self.slots;
        let Operator {
            products,
            force,
            half,
            apply,
            quads,
        } = &self.operator;
        for bound in [force, &products[0], half, &products[1], apply] {
            pass.dispatch_indirect(bound, sizes, nodes);
        }
        self.pressure.record_operator(pass, sizes);
        pass.dispatch_indirect(quads, sizes, wet);
    }

    pub(super) fn submit(
        &self,
        gpu: &Gpu,
        mut recorder: Recorder,
    ) -> Result<(Control, Vec<f64>, StageTimes), Error> {
        // A panic in another solve leaves nothing half done here: every use begins with new copies.
        let mut readbacks = self
            .readbacks
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let (control, norms) = &mut *readbacks;
        recorder.read(&self.state.control, control);
        recorder.read(&self.norms.words, norms);
        let times = recorder.submit().wait()?;
        let norms = self.norms.widen(&norms.wait(gpu)?);
        Ok((control.wait(gpu)?[0], norms, times))
    }

    /// The verdict, or `None` while there is more to do.
    pub(super) fn outcome(&self, control: &Control, norms: &[f64]) -> Option<CoupledOutcome> {
        let finite = [NORM_R, NORM_B, NORM_BEST_V, NORM_B_V];
        let finite = finite.iter().all(|&slot| norms[slot].is_finite());
        let status = verdict(control, finite)?;
        Some(self.outcome_of(status, control, norms))
    }

    pub(super) fn outcome_of(
        &self,
        status: SolveStatus,
        control: &Control,
        norms: &[f64],
    ) -> CoupledOutcome {
        CoupledOutcome {
            status,
            iterations: control.iterations,
            rounds: control.rounds,
            unknowns: {
                let of_solids = norms[UNKNOWNS_V] as u32;
                [control.unknowns - of_solids, of_solids]
            },
            residuals: [
                relative(norms[NORM_R], norms[NORM_ACTS[0]]),
                relative(norms[NORM_BEST_V], norms[NORM_ACTS[1]]),
            ],
            residual_terms: [
                relative(norms[NORM_R], norms[NORM_TERMS]),
                relative(norms[NORM_BEST_V], norms[NORM_TERMS_V]),
            ],
            verified: self.variant.real == Real::F64,
            condensed: false,
        }
    }
}

/// What the state machine knows of the coupled system: the quads of the liquid; the solids join as one more partial.
fn unknowns(at: CoupledFields<'_>) -> Unknowns<'_> {
    let CoupledFields {
        liquid, coupling, ..
    } = at;
    Unknowns {
        labels: &LABELS,
        level: liquid.plan.level(0),
        n_lists: liquid.plan.len() + N_LISTS,
        sums: 4 * coupling.slot(PARTIALS) as u32,
        long_sums: liquid.plan.long_sums(),
        variant: liquid.variant,
        flags: &liquid.flags,
        list: &liquid.list,
        args: &coupling.args,
        x: &liquid.potential,
        outer: &liquid.outer,
        z: &liquid.z_next,
        search: &liquid.search,
        partials: &liquid.partials,
        outer_partials: &liquid.outer_partials,
        components: None,
    }
}
