//! Liquid and solids as one system of two blocks, potentials and velocities, refined on the residual of the indefinite system (thesis 5.17):
//!
//! ```text
//!   [B  J; J^T -S] [phi; v] = [E u*; -rhs]         r_p = E u* - B phi - J v,   r_v = P (rhs - S v + J^T phi)
//! ```
//!
//! in the units of the pressure's system. phi is a potential, m/s. Rows of the liquid are divided by dx^2, those of the solids by rho
//! dx^3/dt, the mass rate of a cell. So J is the same in both.
//!
//! Corrections have one of two forms: [`two_field`](super::two_field), both blocks by conjugate gradients on the device, or
//! [`schur`](super::schur), pressures alone.

use std::sync::Mutex;

use crate::Error;
use crate::fields::coupling::{N_LISTS, NODES, PARTIALS, WET};
use crate::fields::{CouplingBuffers, SolidBuffers, SolidSystemBuffers, SolverBuffers};
use crate::gpu::{Arrays, Bound, Buffer, Gpu, Pass, Readback, Real, Recorder, StageTimes, bind, lock};
use crate::scene::{Formulation, Solver};
use crate::wgsl;

use super::chebyshev::Polynomial;
use super::contact_rows::{HeldSolve, NodeReadbacks};
use super::coupled_host::HostCoupled;
use super::pcg::{Block, Pcg, State, Unknowns};
use super::pressure::Pressure;
use super::refine::{Aim, Form, Outcome, OuterLoop, Pace, Shared, System};
use super::schur::{self, Prepared, Schur, check_formulation};
use super::solid_contacts::ContactSearch;
use super::stored_stiffness::StoredStiffness;
use super::two_field::{Monolithic, Operator};

/// Refinement steps in a submission.
const STEPS: usize = 2;

/// Result of a coupled solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoupledOutcome {
    /// Results of the liquid, with active cells, and of the solids, with free directions of nodes. Both have the status and all iterations
    /// of the solve; enclosed components are not counted.
    pub parts: [Outcome; 2],
    /// Whether corrections had the Schur-complement form.
    pub condensed: bool,
}

impl CoupledOutcome {
    /// The same with the iterations of earlier solves.
    pub(crate) fn after(mut self, iterations: u32) -> CoupledOutcome {
        self.parts.iter_mut().for_each(|part| part.iterations += iterations);
        self
    }
}

/// Arrays of both systems and of the coupling.
#[derive(Clone, Copy, Debug)]
pub struct CoupledFields<'a> {
    /// The system of the liquid.
    pub liquid: &'a SolverBuffers,
    /// The system of the solids.
    pub solids: &'a SolidSystemBuffers,
    /// State of the solids.
    pub fields: &'a SolidBuffers,
    /// J.
    pub coupling: &'a CouplingBuffers,
    /// u* on the faces.
    pub velocity: &'a Buffer<f32>,
    /// Open fractions of the faces.
    pub open: &'a Buffer<f32>,
}

impl<'a> CoupledFields<'a> {
    /// Tables for kernels over the wet quads: with names that both systems have, those of the liquid.
    pub(super) fn by_quad(&self) -> [&'a dyn Arrays; 4] {
        [self.coupling, self.liquid, self.solids, self.fields]
    }

    /// Tables for kernels over the nodes: with names that both systems have, those of the solids. `flags`: of the quads.
    pub(super) fn by_node(&self) -> [&'a dyn Arrays; 4] {
        [self.coupling, self.solids, self.liquid, self.fields]
    }
}

/// Solver of the coupled system.
#[derive(Debug)]
pub struct CoupledSolver {
    pub(super) outer: OuterLoop<Coupled>,
    polynomial: Buffer<Polynomial>,
    push: Bound,
    search: ContactSearch,
}

/// Arrays and choices of a solve.
#[derive(Clone, Copy, Debug)]
pub(super) struct Case<'a> {
    at: CoupledFields<'a>,
    degree: usize,
    form: Form<'a>,
    /// Whether the dispatch sizes are in place.
    sized: bool,
    /// Whether the right-hand side is that of the last solve.
    again: bool,
}

impl<'a> Case<'a> {
    fn new(at: CoupledFields<'a>, degree: usize) -> Case<'a> {
        Case { at, degree, form: Form::Monolithic, sized: false, again: false }
    }
}

/// Form of the corrections of a sub-step.
#[derive(Debug)]
pub(crate) struct CorrectionForm<'a> {
    pub(super) at: CoupledFields<'a>,
    degree: usize,
    pub(super) prepared: Option<(&'a Schur, Prepared<'a>)>,
}

impl CorrectionForm<'_> {
    pub(super) fn condenses(&self) -> bool {
        !matches!(self.prepared, None | Some((_, Prepared::Monolithic)))
    }

    /// `held`: rows of solids that touch each other.
    fn case<'b>(&'b self, again: bool, held: Option<&'b HeldSolve>) -> Case<'b> {
        Case {
            form: match &self.prepared {
                Some((schur, Prepared::Schur(inverse))) => Form::Schur(schur.elimination(self.at, inverse, held)),
                Some((_, Prepared::Singular)) => Form::Singular,
                Some((_, Prepared::Monolithic)) | None => Form::Monolithic,
            },
            sized: self.prepared.is_some(),
            again,
            ..Case::new(self.at, self.degree)
        }
    }
}

/// Kernels of both forms, and those of the residual.
#[derive(Debug)]
pub(super) struct Coupled {
    pressure: Pressure,
    args: Bound,
    guess: Bound,
    keep: Bound,
    /// b - J v in the wet quads.
    residual_quads: Bound,
    /// Products of the elements with v; P (rhs - S v); the same with J^T phi.
    residual_nodes: [Bound; 3],
    residual_sums: Bound,
    /// Weight of the velocities in the norm of conjugate gradients.
    weight: Bound,
    /// J^T of a search direction of the pressure.
    force: Bound,
    monolithic: Monolithic,
    pub(super) schur: Option<Schur>,
    /// For the Schur-complement form and for contact.
    pub(super) stiffness: Option<StoredStiffness>,
    /// Where solids touch each other.
    pub(super) nodes: Option<Mutex<NodeReadbacks>>,
    /// For the right-hand side of the wet quads, where residuals are evaluated on the host.
    base: Option<Mutex<Readback<u32>>>,
}

impl CoupledSolver {
    /// Compiles and binds.
    ///
    /// # Errors
    /// [`Error::Limit`] where the adapter is too small, or the Schur-complement form is required and does not serve.
    pub fn new(gpu: &Gpu, at: CoupledFields, solver: &Solver) -> Result<CoupledSolver, Error> {
        let CoupledFields { liquid, solids, fields, coupling, .. } = at;
        let n_nodes = solids.layout.rows.n_nodes as usize;
        if !gpu.is_planning() {
            check_formulation(n_nodes, solver, liquid.variant)?;
        }
        let polynomial = gpu.uniform("coupled_solver.polynomial", &Polynomial::new(0, 1.0))?;
        let outer =
            OuterLoop::new(gpu, Case::new(at, 0), solver, |shared| Coupled::new(gpu, at, shared, &polynomial, solver))?;
        let own = [("p", (&liquid.potential).into()), ("pushed", (&coupling.difference).into())];
        let real = liquid.variant.real;
        let push = bind(gpu, &wgsl!("couple_push"), real, own, &at.by_node())?;
        Ok(CoupledSolver {
            outer,
            polynomial,
            push,
            search: ContactSearch::new(gpu, solids, fields, &coupling.difference)?,
        })
    }

    /// Submits the recording, which ends with both systems and J in place, with the solve at its end, and waits for the outcome. Potential
    /// and velocity are the result. `polynomial`: of the solids' preconditioner, for this step's S. `again`: the same right-hand side as
    /// in the last solve, with other constraints.
    /// A solve that does not converge is an outcome.
    pub fn solve(
        &self,
        gpu: &Gpu,
        recorder: Recorder,
        at: CoupledFields,
        polynomial: &Polynomial,
        again: bool,
    ) -> Result<(CoupledOutcome, StageTimes), Error> {
        let (form, recorder, mut times) = self.prepare(gpu, recorder, at, polynomial)?;
        let (outcome, mut stages, _) = self.solve_form(gpu, recorder, &form, (again, None), None, &mut |_| {})?;
        times.append(&mut stages);
        Ok((outcome, times))
    }

    /// Solves in a form that was prepared, with more work at the end of every submission. Returns whether that work has read the solution.
    /// `again`: the right-hand side of the last solve. `held`: see [`CorrectionForm::case`]. `aim`: of a round of separation, in which the
    /// active cells may be fewer than those that the form was prepared for; its guess is of velocities, and of the correction of potentials
    /// in the buffers.
    pub(crate) fn solve_form(
        &self,
        gpu: &Gpu,
        recorder: Recorder,
        form: &CorrectionForm,
        (again, held): (bool, Option<&HeldSolve>),
        aim: Option<Aim>,
        then: &mut dyn FnMut(&mut Recorder),
    ) -> Result<(CoupledOutcome, StageTimes, bool), Error> {
        let case = form.case(again, held);
        let case = Case { sized: case.sized && aim.is_none(), ..case };
        let (outcomes, times, read) = self.outer.solve(gpu, recorder, case, aim, then)?;
        let outcome = CoupledOutcome { parts: [outcomes[0], outcomes[1]], condensed: form.condenses() };
        Ok((outcome, times, read))
    }

    /// Decides on the form of the corrections of this sub-step, as [`CoupledSolver::solve`] does. Returns the recording to go on with.
    pub(crate) fn prepare<'a>(
        &'a self,
        gpu: &Gpu,
        recorder: Recorder,
        at: CoupledFields<'a>,
        polynomial: &Polynomial,
    ) -> Result<(CorrectionForm<'a>, Recorder, StageTimes), Error> {
        let system = &self.outer.system;
        let mut form = CorrectionForm { at, degree: polynomial.degree as usize, prepared: None };
        let (mut recorder, mut times) = (recorder, StageTimes::new());
        if let Some(schur) = &system.schur {
            let most = schur.worth_wetted(polynomial);
            let (prepared, stages) = system.prepare(gpu, recorder, at, (schur, most))?;
            times = stages;
            recorder = Recorder::timed(gpu);
            form.prepared = Some((schur, prepared));
        }
        if !form.condenses() {
            gpu.upload(&self.polynomial, &[*polynomial]);
        }
        Ok((form, recorder, times))
    }

    /// Tolerance of both residuals.
    pub(crate) fn tolerance(&self) -> f64 {
        self.outer.tolerance()
    }

    /// From the next solve on, another tolerance of both residuals.
    pub fn set_tolerance(&mut self, gpu: &Gpu, tolerance: f64) {
        self.outer.set_tolerance(gpu, tolerance);
    }

    /// Records, after a solve, the forces on the nodes, liquid included.
    pub fn record_push(&self, pass: &mut Pass, n_nodes: usize) {
        pass.dispatch(&self.push, n_nodes);
    }

    /// The search for the active set of contacts.
    pub fn search(&self) -> &ContactSearch {
        &self.search
    }

    /// A x as conjugate gradients evaluate it; x and A x: quads of level 0 in the device layout, then four numbers per node. Inactive
    /// cells of A x are undefined. Overwrites work arrays of the solve.
    pub fn apply(&self, gpu: &Gpu, at: CoupledFields, x: &[f64]) -> Result<Vec<f64>, Error> {
        let (p, v) = x.split_at(4 * at.liquid.plan.levels[0].quads);
        self.outer.apply(gpu, Case::new(at, 0), &[p, v])?;
        let mut q = at.liquid.q.download(gpu)?;
        q.extend(at.solids.q.download(gpu)?);
        Ok(q)
    }

    /// The preconditioner of a residual g, as conjugate gradients evaluate it; vectors as those of [`CoupledSolver::apply`], g 0 in
    /// inactive cells and constrained directions. Overwrites work arrays of the solve.
    pub fn precondition(
        &self,
        gpu: &Gpu,
        at: CoupledFields,
        polynomial: &Polynomial,
        g: &[f64],
    ) -> Result<Vec<f64>, Error> {
        gpu.upload(&self.polynomial, &[*polynomial]);
        let n = 4 * at.liquid.plan.levels[0].quads;
        let (p, v) = g.split_at(n);
        at.liquid.outer.upload(gpu, p);
        at.solids.r.upload(gpu, v);
        let case = Case::new(at, polynomial.degree as usize);
        self.outer.precondition(gpu, case, |coupled, pass, state| coupled.pressure.begin(pass, state))?;
        let mut z = at.liquid.z_next.download(gpu)?;
        z.truncate(n);
        z.extend(at.solids.z.download(gpu)?);
        Ok(z)
    }
}

impl Coupled {
    /// The Schur-complement form, in a solve with it.
    fn schur(&self, case: Case) -> Option<&Schur> {
        self.schur.as_ref().filter(|_| matches!(case.form, Form::Schur(_)))
    }

    /// Prepares the Schur-complement form for `most` wet nodes, after the recording.
    pub(super) fn prepare<'a>(
        &'a self,
        gpu: &Gpu,
        recorder: Recorder,
        at: CoupledFields,
        (schur, most): (&'a Schur, usize),
    ) -> Result<(Prepared<'a>, StageTimes), Error> {
        let stiffness = self.stiffness.as_ref().expect("made with the form");
        schur.prepare(gpu, recorder, at, (stiffness, most), |pass| pass.dispatch(&self.args, 1))
    }

    fn new(
        gpu: &Gpu,
        at: CoupledFields,
        shared: &Shared,
        polynomial: &Buffer<Polynomial>,
        solver: &Solver,
    ) -> Result<Coupled, Error> {
        let CoupledFields { liquid, solids, fields, coupling, .. } = at;
        let variant = liquid.variant;
        let real = variant.real;
        let sized = [("from_args", (&liquid.args).into())];
        let v = [("x", (&fields.velocity).into())];
        let p = [("p", (&liquid.potential).into()), ("sums", (&solids.partials).into())];
        let direction = [("p", (&liquid.search).into())];
        let schur = match solver.formulation {
            Formulation::TwoField => None,
            Formulation::Auto | Formulation::Condensed => Schur::new(gpu, at, shared, solver)?,
        };
        Ok(Coupled {
            pressure: Pressure::new(gpu, liquid, shared, at.velocity, at.open, solver)?,
            args: bind(gpu, &wgsl!("coupled_args"), variant, sized, &[coupling])?,
            guess: solids.bind_guess(gpu, fields)?,
            keep: bind(gpu, &wgsl!("couple_keep"), real, [], &at.by_quad())?,
            residual_quads: bind(gpu, &wgsl!("couple_residual"), real, v, &at.by_quad())?,
            residual_nodes: [
                solids.bind_products(gpu, fields, &fields.velocity)?,
                solids.bind_residual(gpu, fields)?,
                bind(gpu, &wgsl!("coupled_residual"), real, p, &at.by_node())?,
            ],
            residual_sums: bind(gpu, &wgsl!("coupled_sums"), real, [], &[coupling, shared])?,
            weight: bind(gpu, &wgsl!("two_field_weight"), variant, [], &[coupling, shared])?,
            force: bind(gpu, &wgsl!("couple_force"), variant, direction, &at.by_node())?,
            monolithic: Monolithic::new(gpu, at, shared, polynomial, solver)?,
            stiffness: (schur.is_some() || solver.solid_contact)
                .then(|| StoredStiffness::new(gpu, solids, fields))
                .transpose()?,
            schur,
            nodes: (solver.solid_contact).then(|| NodeReadbacks::new(gpu, solids, fields)).transpose()?.map(Mutex::new),
            base: (real == Real::F32)
                .then(|| Readback::new(gpu, "coupled_solver.base", coupling.base.words.len()))
                .transpose()?
                .map(Mutex::new),
        })
    }
}

impl System for Coupled {
    type Case<'a> = Case<'a>;
    type Host<'a> = HostCoupled<'a>;

    /// The state machine knows the quads of the liquid; the solids join as one more partial.
    fn unknowns<'a>(case: Self::Case<'a>) -> Unknowns<'a> {
        let CoupledFields { liquid, solids, fields, coupling, .. } = case.at;
        let pressure = Block { args: &coupling.args, ..liquid.block() };
        Unknowns {
            group: "coupled_solver",
            blocks: vec![pressure, solids.block(fields)],
            n_lists: liquid.plan.len() + N_LISTS,
            sums: [4 * coupling.slot(PARTIALS) as u32; 2],
            long_sums: liquid.plan.long_sums(),
            variant: liquid.variant,
            z: &liquid.z_next,
            partials: &liquid.partials,
            outer_partials: &liquid.outer_partials,
            components: None,
        }
    }

    fn form<'a>(case: Self::Case<'a>) -> Form<'a> {
        case.form
    }

    fn pace(&self, case: Case<'_>) -> Pace {
        let iterations = match case.form {
            Form::Monolithic => self.monolithic.iterations(case.degree),
            Form::Schur(_) | Form::Singular => schur::CHUNK,
        };
        Pace { iterations, gate: iterations, steps: STEPS }
    }

    fn pcg<'a>(&'a self, monolithic: &'a Pcg, case: Case<'_>) -> &'a Pcg {
        self.schur(case).map_or(monolithic, |schur| &schur.pcg)
    }

    fn record_set_up(&self, pass: &mut Pass, case: Case<'_>) {
        if !case.sized {
            pass.dispatch(&self.args, 1);
        }
        self.monolithic.record_set_up(pass);
    }

    fn record_start(&self, pass: &mut Pass, case: Case<'_>) {
        let coupling = case.at.coupling;
        self.record_set_up(pass, case);
        self.pressure.record_start(pass, case.at.liquid);
        pass.dispatch_indirect(&self.guess, &coupling.args, coupling.slot(NODES));
        if !case.again {
            pass.dispatch_indirect(&self.keep, &coupling.args, coupling.slot(WET));
        }
    }

    fn record_residual(&self, pass: &mut Pass, state: &State) {
        state.in_evaluation(pass, &self.residual_quads);
        self.pressure.record_residual(pass, state);
        for bound in &self.residual_nodes {
            state.in_evaluation(pass, bound);
        }
        pass.dispatch(&self.residual_sums, 1);
    }

    fn record_begin(&self, pass: &mut Pass, state: &State, pcg: &Pcg, case: Case<'_>) {
        self.pressure.begin(pass, state);
        match self.schur(case) {
            Some(schur) => state.in_begin(pass, &schur.begin),
            None => self.monolithic.record_begin(pass, state),
        }
        pcg.record_gate(pass);
        pass.dispatch_indirect(&self.weight, &state.gate, 0);
    }

    fn record_preconditioner(&self, pass: &mut Pass, state: &State, case: Case<'_>) {
        let Case { at, degree, .. } = case;
        let pressure = |pass: &mut Pass| self.pressure.record_preconditioner(pass, state, at.liquid);
        match case.form {
            Form::Schur(_) => pressure(pass),
            Form::Monolithic | Form::Singular => self.monolithic.record_preconditioner(pass, state, degree, pressure),
        }
    }

    fn record_direction(&self, pass: &mut Pass, state: &State, case: Case<'_>) {
        if let Form::Monolithic = case.form {
            self.monolithic.record_direction(pass, state);
        }
    }

    fn record_operator(&self, pass: &mut Pass, state: &State, sizes: &Buffer<u32>, case: Case<'_>) {
        let CoupledFields { liquid, coupling, .. } = case.at;
        let [nodes, wet] = [NODES, WET].map(|list| coupling.slot(list));
        pass.dispatch_indirect(&self.force, sizes, nodes);
        let operator: &Operator = self.schur(case).map_or(&self.monolithic.operator, |schur| &schur.operator);
        for bound in &operator.nodes {
            pass.dispatch_indirect(bound, sizes, nodes);
        }
        self.pressure.record_operator(pass, state, sizes, liquid);
        pass.dispatch_indirect(&operator.quads, sizes, wet);
        pass.dispatch_indirect(&operator.alpha, &state.gate, 0);
    }

    fn record_update(&self, pass: &mut Pass, state: &State, case: Case<'_>) {
        self.pressure.record_update(pass, state, case.at.liquid);
        if let Form::Monolithic = case.form {
            self.monolithic.record_update(pass, state);
        }
    }

    fn on_host<'a>(&self, gpu: &Gpu, case: Self::Case<'a>, _: u32) -> Result<HostCoupled<'a>, Error> {
        let base = self.base.as_ref();
        let base = base.expect("made with every solver whose residual the device rounds");
        HostCoupled::download(gpu, case.at, &mut lock(base))
    }
}
