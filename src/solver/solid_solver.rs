//! The solve of the solids, S v = rhs, in the outer loop: conjugate gradients with the products of the elements. The preconditioner
//! is a Chebyshev polynomial in D^-1 S.

use crate::Error;
use crate::fields::solid_system::{BODIES, N_LISTS, NODES};
use crate::fields::{SolidBuffers, SolidSystemBuffers};
use crate::gpu::{Arrays, Bound, Buffer, Gpu, Pass, RealBuffer, Recorder, SPLIT, StageTimes, bind};
use crate::scene::Solver;
use crate::state::ContactReport;
use crate::wgsl;

use super::BLOCK;
use super::chebyshev::{MAX_DEGREE, Polynomial};
use super::contact_rows::{DrySystem, RowsOf};
use super::pcg::{Pcg, State, Unknowns};
use super::refine::{Outcome, OuterLoop, Pace, Shared, System};
use super::solid_host::HostElastic;
use super::solid_system::corrections;

/// Largest solid, in nodes, whose polynomial one workgroup evaluates in one dispatch: a row for each of its threads, so that a step takes
/// about as long as a dispatch of its own and saves its start. With more rows than threads the rest of the device is missed: on llvmpipe
/// (2 threads) a step takes 30, 49, 68, 212 us for 54, 135, 207, 725 nodes, against 36, 48, 56, 142 us with a dispatch each.
const BODY_NODES: usize = 256;
/// Dispatches of an iteration besides those of the preconditioner.
const DISPATCHES: usize = 6;
/// Dispatches recorded ahead of a residual evaluation, and iterations, at most.
const AHEAD: usize = 256;
const CHUNK: usize = 32;
/// Refinement steps in a submission: most solves take one.
const STEPS: usize = 2;

/// Whether each solid is small enough for a workgroup.
fn in_workgroups(largest_body: usize, n_bodies: usize) -> bool {
    largest_body <= BODY_NODES && n_bodies <= SPLIT as usize
}

/// The solve of a step: everything between right-hand side and velocity.
#[derive(Debug)]
pub struct SolidSolver {
    outer: OuterLoop<Elastic>,
    /// Where solids touch each other.
    rows: Option<DrySystem>,
    polynomial: Buffer<Polynomial>,
}

impl SolidSolver {
    /// Compiles and binds.
    pub fn new(
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: &SolidBuffers,
        solver: &Solver,
    ) -> Result<SolidSolver, Error> {
        let polynomial = gpu.uniform("solid_solver.polynomial", &Polynomial::new(0, 1.0))?;
        let case = Case { buffers, fields, degree: 0 };
        let outer = OuterLoop::new(gpu, case, solver, |shared| Elastic::new(gpu, case, shared, &polynomial))?;
        let rows = || DrySystem::new(gpu, buffers, fields);
        Ok(SolidSolver { outer, rows: solver.solid_contact.then(rows).transpose()?, polynomial })
    }

    /// Submits the recording with the solve at its end and waits for the outcome, with a residual in f64: of the host where the device rounds it.
    /// The velocity in `fields` is v* before and v after it. `polynomial`: the preconditioner's, for this step's S.
    /// A solve that does not converge is an [`Outcome`].
    pub fn solve(
        &self,
        gpu: &Gpu,
        recorder: Recorder,
        buffers: &SolidSystemBuffers,
        fields: &SolidBuffers,
        polynomial: &Polynomial,
    ) -> Result<(Outcome, StageTimes), Error> {
        let case = self.case(gpu, buffers, fields, polynomial);
        let (outcomes, times, _) = self.outer.solve(gpu, recorder, case, None, &mut |_| {})?;
        Ok((outcomes[0], times))
    }

    /// The same under the rows of solids that touch each other, which join at most `most` times more (twin: reference/contact_rows.rs).
    pub fn solve_in_rows(
        &self,
        gpu: &Gpu,
        recorder: Recorder,
        (buffers, fields): (&SolidSystemBuffers, &SolidBuffers),
        polynomial: &Polynomial,
        (rows_of, most): (RowsOf, u32),
    ) -> Result<(Outcome, ContactReport, StageTimes), Error> {
        let (mut outcome, mut times) = self.solve(gpu, recorder, buffers, fields, polynomial)?;
        let mut report = ContactReport { solves: 1, ..ContactReport::default() };
        let Some(rows) = &self.rows else {
            return Ok((outcome, report, times));
        };
        let mut progress = None;
        for meeting in 0.. {
            let so_far = (&mut progress, meeting > most);
            if !rows.push(gpu, (buffers, fields), rows_of, so_far, &mut report)? {
                break;
            }
            let (next, mut stages) = self.solve(gpu, Recorder::timed(gpu), buffers, fields, polynomial)?;
            times.append(&mut stages);
            outcome = Outcome { iterations: outcome.iterations + next.iterations, ..next };
        }
        Ok((outcome, report, times))
    }

    /// From the next solve on, another tolerance of the true residual.
    pub fn set_tolerance(&mut self, gpu: &Gpu, tolerance: f64) {
        self.outer.set_tolerance(gpu, tolerance);
    }

    /// S x as conjugate gradients evaluate it, 0 for prescribed components; x and the answer hold four numbers per node, the fourth 0.
    /// Overwrites what a solve computes with.
    pub fn apply(
        &self,
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: &SolidBuffers,
        x: &[f64],
    ) -> Result<Vec<f64>, Error> {
        let case = Case { buffers, fields, degree: 0 };
        self.outer.apply(gpu, case, &[x])?;
        buffers.q.download(gpu)
    }

    /// p(D^-1 S) D^-1 r, the preconditioner as conjugate gradients evaluate it; r, 0 for prescribed components, and the answer hold four
    /// numbers per node, the fourth 0. Overwrites what a solve computes with.
    pub fn precondition(
        &self,
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: &SolidBuffers,
        polynomial: &Polynomial,
        r: &[f64],
    ) -> Result<Vec<f64>, Error> {
        let case = self.case(gpu, buffers, fields, polynomial);
        buffers.outer.upload(gpu, r);
        self.outer.precondition(gpu, case, |elastic, pass, state| state.in_begin(pass, &elastic.begin))?;
        buffers.z.download(gpu)
    }

    fn case<'a>(
        &self,
        gpu: &Gpu,
        buffers: &'a SolidSystemBuffers,
        fields: &'a SolidBuffers,
        polynomial: &Polynomial,
    ) -> Case<'a> {
        gpu.upload(&self.polynomial, &[*polynomial]);
        Case { buffers, fields, degree: polynomial.degree as usize }
    }
}

/// Buffers, and the degree of the preconditioner.
#[derive(Clone, Copy, Debug)]
struct Case<'a> {
    buffers: &'a SolidSystemBuffers,
    fields: &'a SolidBuffers,
    degree: usize,
}

/// The kernels of the solids' system.
#[derive(Debug)]
struct Elastic {
    guess: Bound,
    /// Products of the elements with the velocity, and with the search direction.
    products: [Bound; 2],
    residual: Bound,
    begin: Bound,
    preconditioner: Chebyshev,
    apply: Bound,
    update: Bound,
}

#[derive(Debug)]
pub(super) enum Chebyshev {
    /// All steps in one dispatch, a workgroup per solid.
    Workgroups(Bound),
    /// A dispatch per step.
    Sweeps(Vec<Bound>),
}

impl Elastic {
    fn new(
        gpu: &Gpu,
        Case { buffers, fields, .. }: Case,
        shared: &Shared,
        polynomial: &Buffer<Polynomial>,
    ) -> Result<Elastic, Error> {
        let variant = buffers.variant;
        let direction = [("x", (&buffers.search).into())];
        let tables: [&dyn Arrays; 3] = [buffers, fields, shared];
        let products = |x| buffers.bind_products(gpu, fields, x);
        Ok(Elastic {
            guess: buffers.bind_guess(gpu, fields)?,
            products: [products(&fields.velocity)?, products(&buffers.search)?],
            residual: buffers.bind_residual(gpu, fields)?,
            begin: bind(gpu, &wgsl!("solid_begin"), variant, [], &tables)?,
            preconditioner: Chebyshev::new(gpu, buffers, polynomial, &buffers.r, &buffers.z)?,
            apply: bind(gpu, &wgsl!("solid_apply"), variant, direction, &tables)?,
            update: bind(gpu, &wgsl!("solid_update"), variant, [], &tables)?,
        })
    }
}

impl Chebyshev {
    /// Binds z = p(D^-1 S) D^-1 r.
    pub(super) fn new(
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        polynomial: &Buffer<Polynomial>,
        r: &RealBuffer,
        z: &RealBuffer,
    ) -> Result<Chebyshev, Error> {
        let variant = buffers.variant;
        let own = [("polynomial", polynomial.into()), ("r", r.into()), ("z", z.into())];
        if in_workgroups(buffers.layout.largest_body(), buffers.sizes.n_bodies as usize) {
            let bound = bind(gpu, &wgsl!("chebyshev_polynomial"), variant, own, &[buffers])?;
            return Ok(Chebyshev::Workgroups(bound));
        }
        let sweeps = (0..=MAX_DEGREE as u32).map(|k| {
            let sweep = gpu.uniform("solid_solver.sweep", &[k, 0, 0, 0])?;
            let step = [("sweep", (&sweep).into())];
            bind(gpu, &wgsl!("chebyshev_sweep"), variant, own, &[&step, buffers])
        });
        Ok(Chebyshev::Sweeps(sweeps.collect::<Result<_, _>>()?))
    }

    /// Records it; `sizes` has the dispatch sizes of nodes and of solids in these slots.
    pub(super) fn record(&self, pass: &mut Pass, sizes: &Buffer<u32>, [nodes, bodies]: [usize; 2], degree: usize) {
        match self {
            Chebyshev::Workgroups(bound) => pass.dispatch_indirect(bound, sizes, bodies),
            Chebyshev::Sweeps(sweeps) => {
                for sweep in &sweeps[..=degree] {
                    pass.dispatch_indirect(sweep, sizes, nodes);
                }
            }
        }
    }

    /// Dispatches that it takes.
    pub(super) fn dispatches(&self, degree: usize) -> usize {
        match self {
            Chebyshev::Workgroups(_) => 1,
            Chebyshev::Sweeps(_) => degree + 1,
        }
    }
}

impl System for Elastic {
    type Case<'a> = Case<'a>;
    type Host<'a> = HostElastic;

    const GUESSES: bool = true;

    fn unknowns<'a>(case: Self::Case<'a>) -> Unknowns<'a> {
        let Case { buffers, fields, .. } = case;
        Unknowns {
            group: "solid_solver",
            blocks: vec![buffers.block(fields)],
            n_lists: N_LISTS,
            sums: [buffers.level().args; 2],
            long_sums: buffers.layout.long_sums(),
            variant: corrections(buffers.variant),
            z: &buffers.z,
            partials: &buffers.partials,
            // Never in use at the same time.
            outer_partials: &buffers.partials,
            components: None,
        }
    }

    fn pace(&self, case: Case<'_>) -> Pace {
        let dispatches = DISPATCHES + self.preconditioner.dispatches(case.degree);
        let iterations = (AHEAD / dispatches).next_multiple_of(BLOCK).min(CHUNK);
        Pace { iterations, gate: BLOCK, steps: STEPS }
    }

    fn record_start(&self, pass: &mut Pass, case: Case<'_>) {
        for bound in [&self.guess, &self.products[0], &self.residual] {
            pass.dispatch_indirect(bound, &case.buffers.args, NODES);
        }
    }

    fn record_residual(&self, pass: &mut Pass, state: &State) {
        state.in_evaluation(pass, &self.products[0]);
        state.in_evaluation(pass, &self.residual);
    }

    fn record_begin(&self, pass: &mut Pass, state: &State, _: &Pcg, _: Case<'_>) {
        state.in_begin(pass, &self.begin);
    }

    fn record_preconditioner(&self, pass: &mut Pass, state: &State, case: Case<'_>) {
        self.preconditioner.record(pass, &state.gated, [NODES, BODIES], case.degree);
    }

    fn record_operator(&self, pass: &mut Pass, _: &State, sizes: &Buffer<u32>, _: Case<'_>) {
        pass.dispatch_indirect(&self.products[1], sizes, NODES);
        pass.dispatch_indirect(&self.apply, sizes, NODES);
    }

    fn record_update(&self, pass: &mut Pass, state: &State, _: Case<'_>) {
        state.in_update(pass, &self.update);
    }

    fn on_host<'a>(&self, gpu: &Gpu, case: Self::Case<'a>, _: u32) -> Result<Self::Host<'a>, Error> {
        HostElastic::download(gpu, case.buffers, case.fields)
    }
}
