//! The solve of the solids, S v = rhs: conjugate gradients on the elements' own products, preconditioned by a Chebyshev polynomial in
//! D^-1 S, in the outer loop.

use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Pass, RealBuffer, Recorder, SPLIT, StageTimes};
use crate::scene::Solver;

use super::chebyshev::{MAX_DEGREE, Polynomial};
use super::pcg::{State, Unknowns};
use super::refine::{Outcome, OuterLoop, Pace, System};
use super::solid_host::HostElastic;
use super::solid_system::{
    BODIES, LABELS, N_LISTS, NODES, SolidFields, SolidRows, SolidSystemBuffers, rounds,
};

/// Largest solid, in nodes, whose polynomial one workgroup evaluates in one dispatch: a row for each of its threads, so that a step takes
/// about as long as a dispatch of its own and saves its start. With more rows than threads the rest of the device is missed: on llvmpipe
/// (2 threads) a step takes 30, 49, 68, 212 us for 54, 135, 207, 725 nodes, against 36, 48, 56, 142 us with a dispatch each.
const BODY_NODES: usize = 256;
/// Dispatches of an iteration besides those of the preconditioner.
const DISPATCHES: usize = 6;
/// Dispatches that are recorded ahead of a chance to turn, and the iterations they may make, at most.
const AHEAD: usize = 256;
const CHUNK: usize = 32;
/// Chances to turn in a submission: most solves take one round.
const TURNS: usize = 2;

/// Whether each solid is small enough for a workgroup.
fn in_workgroups(largest_body: usize, n_bodies: usize) -> bool {
    largest_body <= BODY_NODES && n_bodies <= SPLIT as usize
}

/// The kernels of [`SolidSolver::solve`].
pub fn solid_kernels(rows: &SolidRows) -> Vec<&'static str> {
    let mut kernels = vec![
        "solid_guess",
        "solid_products",
        "solid_residual",
        "refine_start",
        "refine_correct",
        "refine_turn",
        "solid_begin",
        "pcg_gate",
        "pcg_beta",
        "pcg_direction",
        "solid_apply",
        "pcg_alpha",
        "solid_update",
    ];
    if rows.long_sums() {
        kernels.push("fold_partials");
    }
    let one_by_one = !in_workgroups(rows.largest_body(), rows.rows.n_bodies as usize);
    kernels.push(match one_by_one {
        true => "chebyshev_sweep",
        false => "chebyshev_polynomial",
    });
    kernels
}

/// The solve of a step: everything between right-hand side and velocity.
#[derive(Debug)]
pub struct SolidSolver {
    outer: OuterLoop<Elastic>,
    polynomial: Buffer<Polynomial>,
}

impl SolidSolver {
    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Gpu::buffer`].
    pub fn new(
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: SolidFields,
        solver: &Solver,
    ) -> Result<SolidSolver, Error> {
        let polynomial = gpu.uniform("solid_solver.polynomial", &Polynomial::new(0, 1.0))?;
        let case = Case {
            buffers,
            fields,
            degree: 0,
        };
        let outer = OuterLoop::new(gpu, case, solver, |state, norms| {
            Elastic::new(gpu, case, state, norms, &polynomial)
        })?;
        Ok(SolidSolver { outer, polynomial })
    }

    /// Submits the recording with the solve at its end and waits for the verdict, with a residual in f64: of the host where the device rounds it.
    /// The velocity in `fields` is v* before and v after it. `polynomial`: the preconditioner's, for this step's S.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails. A solve that does not converge is an [`Outcome`], not an error.
    pub fn solve<'a>(
        &self,
        gpu: &'a Gpu,
        recorder: Recorder,
        buffers: &SolidSystemBuffers,
        fields: SolidFields,
        polynomial: &Polynomial,
    ) -> Result<(Outcome, StageTimes), Error> {
        let case = self.case(gpu, buffers, fields, polynomial);
        self.outer.solve(gpu, recorder, case)
    }

    /// From the next solve on, another tolerance of the true residual.
    pub fn set_tolerance(&mut self, gpu: &Gpu, tolerance: f64) {
        self.outer.set_tolerance(gpu, tolerance);
    }

    /// S x as conjugate gradients evaluate it, 0 for prescribed components; x and the answer hold four numbers per node, the fourth 0.
    /// Overwrites what a solve computes with.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn apply(
        &self,
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: SolidFields,
        x: &[f64],
    ) -> Result<Vec<f64>, Error> {
        let case = Case {
            buffers,
            fields,
            degree: 0,
        };
        self.outer.apply(gpu, case, x)?;
        buffers.q.download(gpu)
    }

    /// p(D^-1 S) D^-1 r, the preconditioner as conjugate gradients evaluate it; r, 0 for prescribed components, and the answer hold four
    /// numbers per node, the fourth 0. Overwrites what a solve computes with.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn precondition(
        &self,
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: SolidFields,
        polynomial: &Polynomial,
        r: &[f64],
    ) -> Result<Vec<f64>, Error> {
        let case = self.case(gpu, buffers, fields, polynomial);
        buffers.outer.upload(gpu, r);
        self.outer.precondition(gpu, case)?;
        buffers.z.download(gpu)
    }

    fn case<'a>(
        &self,
        gpu: &Gpu,
        buffers: &'a SolidSystemBuffers,
        fields: SolidFields<'a>,
        polynomial: &Polynomial,
    ) -> Case<'a> {
        gpu.upload(&self.polynomial, &[*polynomial]);
        Case {
            buffers,
            fields,
            degree: polynomial.degree as usize,
        }
    }
}

/// Where the system lies, and the degree of its preconditioner.
#[derive(Clone, Copy, Debug)]
struct Case<'a> {
    buffers: &'a SolidSystemBuffers,
    fields: SolidFields<'a>,
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
        Case {
            buffers, fields, ..
        }: Case,
        state: &State,
        norms: &RealBuffer,
        polynomial: &Buffer<Polynomial>,
    ) -> Result<Elastic, Error> {
        let kernel = |source| Kernel::new(gpu, source, buffers.variant);
        let rows = ("rows", (&buffers.rows).into());
        let freedom = ("freedom", fields.freedom.into());
        let incidence = ("incidence", (&buffers.incidence).into());
        let products = ("products", (&buffers.products).into());
        let masses = ("masses", (&buffers.masses).into());
        let outer = ("outer", (&buffers.outer).into());
        let r = ("r", (&buffers.r).into());
        let search = ("search", (&buffers.search).into());
        let partials = ("partials", (&buffers.partials).into());
        let product_of = |x| buffers.bind_products(gpu, fields, x);
        Ok(Elastic {
            guess: buffers.bind_guess(gpu, fields)?,
            products: [product_of(fields.velocity)?, product_of(&buffers.search)?],
            residual: buffers.bind_residual(gpu, fields)?,
            begin: kernel(&crate::wgsl!("solid_begin"))?
                .bind(gpu, &[rows, ("norms", norms.into()), outer, r, search])?,
            preconditioner: Chebyshev::new(gpu, buffers, polynomial, &buffers.r, &buffers.z)?,
            apply: kernel(&crate::wgsl!("solid_apply"))?.bind(
                gpu,
                &[
                    rows,
                    freedom,
                    incidence,
                    products,
                    masses,
                    ("x", (&buffers.search).into()),
                    r,
                    ("q_out", (&buffers.q).into()),
                    partials,
                ],
            )?,
            update: kernel(&crate::wgsl!("solid_update"))?.bind(
                gpu,
                &[
                    rows,
                    ("scalars", (&state.scalars).into()),
                    search,
                    ("q_in", (&buffers.q).into()),
                    r,
                ],
            )?,
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
        let kernel = |source| Kernel::new(gpu, source, buffers.variant);
        let bindings = [
            ("rows", (&buffers.rows).into()),
            ("polynomial", polynomial.into()),
            ("list", (&buffers.list).into()),
            ("blocks", (&buffers.blocks).into()),
            ("inverse", (&buffers.inverse).into()),
            ("r", r.into()),
            ("pair", (&buffers.pair).into()),
            ("increment", (&buffers.increment).into()),
            ("z", z.into()),
            ("partials", (&buffers.partials).into()),
        ];
        if in_workgroups(buffers.largest_body, buffers.sizes.n_bodies as usize) {
            let bound = kernel(&crate::wgsl!("chebyshev_polynomial"))?.bind(gpu, &bindings)?;
            return Ok(Chebyshev::Workgroups(bound));
        }
        let kernel = kernel(&crate::wgsl!("chebyshev_sweep"))?;
        let sweeps = (0..=MAX_DEGREE as u32).map(|k| {
            let sweep = gpu.uniform("solid_solver.sweep", &[k, 0, 0, 0])?;
            let mut bindings = bindings.to_vec();
            bindings.push(("sweep", (&sweep).into()));
            kernel.bind(gpu, &bindings)
        });
        Ok(Chebyshev::Sweeps(sweeps.collect::<Result<_, _>>()?))
    }

    /// Records it; `sizes` has the dispatch sizes of nodes and of solids in these slots.
    pub(super) fn record(
        &self,
        pass: &mut Pass,
        sizes: &Buffer<u32>,
        [nodes, bodies]: [usize; 2],
        degree: usize,
    ) {
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
    type Buffers<'a> = Case<'a>;
    type Host = HostElastic;

    const GUESSES: bool = true;

    fn unknowns<'a>(case: Self::Buffers<'a>) -> Unknowns<'a> {
        let Case {
            buffers, fields, ..
        } = case;
        Unknowns {
            labels: &LABELS,
            level: buffers.level(),
            n_lists: N_LISTS,
            sums: buffers.level().args,
            long_sums: buffers.long_sums,
            variant: rounds(buffers.variant),
            flags: fields.flags,
            list: &buffers.list,
            args: &buffers.args,
            x: fields.velocity,
            outer: &buffers.outer,
            z: &buffers.z,
            search: &buffers.search,
            partials: &buffers.partials,
            // Rounds and turns take turns with it.
            outer_partials: &buffers.partials,
            components: None,
        }
    }

    fn pace(&self, case: Case<'_>) -> Pace {
        let steps = self.preconditioner.dispatches(case.degree);
        Pace {
            chunk: (AHEAD / (DISPATCHES + steps))
                .next_multiple_of(super::refine::BLOCK)
                .min(CHUNK),
            turns: TURNS,
        }
    }

    fn record_measure(&self, pass: &mut Pass, case: Case<'_>) {
        for bound in [&self.guess, &self.products[0], &self.residual] {
            pass.dispatch_indirect(bound, &case.buffers.args, NODES);
        }
    }

    fn record_residual(&self, pass: &mut Pass, state: &State) {
        state.in_turn(pass, &self.products[0]);
        state.in_turn(pass, &self.residual);
    }

    fn record_begin(&self, pass: &mut Pass, state: &State) {
        state.in_begin(pass, &self.begin);
    }

    fn record_preconditioner(&self, pass: &mut Pass, state: &State, case: Case<'_>) {
        self.preconditioner
            .record(pass, &state.gated, [NODES, BODIES], case.degree);
    }

    fn record_operator(&self, pass: &mut Pass, sizes: &Buffer<u32>) {
        pass.dispatch_indirect(&self.products[1], sizes, NODES);
        pass.dispatch_indirect(&self.apply, sizes, NODES);
    }

    fn record_update(&self, pass: &mut Pass, state: &State) {
        state.in_update(pass, &self.update);
    }

    fn on_host(gpu: &Gpu, case: Case<'_>, _: u32) -> Result<HostElastic, Error> {
        HostElastic::download(gpu, case.buffers, case.fields)
    }
}
