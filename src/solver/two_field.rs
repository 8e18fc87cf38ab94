//! Monolithic two-field form of the corrections (thesis 5.25), matrix-free. A correction (dp, dv) solves A [dp; dv] = g,
//!
//! ```text
//!   g = [r_p - J Z1^-1 r_v; Z2 Z1^-1 r_v],   A s = [B s_p + J t; Z2 (s_v - t)],   t = Z1^-1 (J^T s_p - Z2 s_v)
//! ```
//!
//! with Z1 = sigma zeta_M M and Z2 = S - Z1. The factored form has no cancellation. The preconditioner is t = Sh g_v, z_p = H (g_p + J
//! t), z_v = Sh (J^T z_p + Z1 t), with the V-cycle H of the pressure and the polynomial Sh of the solids. Vectors of the liquid have
//! the precision of the corrections. Those of the solids have that of the residuals: they are short, and Z2 is stiff.

use crate::Error;
use crate::fields::Coupling;
use crate::fields::coupling::{BODIES, NODES, WET};
use crate::gpu::{Arrays, Bound, Buffer, Gpu, Pass, Source, bind};
use crate::scene::{Preconditioner, Solver};
use crate::wgsl;

use super::chebyshev::Polynomial;
use super::coupled::CoupledFields;
use super::pcg::State;
use super::pressure::FIRST_SWEEP;
use super::refine::Shared;
use super::solid_solver::Chebyshev;
use super::two_field_jacobi::Jacobi;

/// Dispatches of an iteration besides those of V-cycle and polynomial, about.
const DISPATCHES: usize = 24;
/// Dispatches recorded ahead in a refinement step, and iterations, at most.
const AHEAD: usize = 512;
const CHUNK: usize = 12;

/// Kernels of the form.
#[derive(Debug)]
pub(super) struct Monolithic {
    /// Right-hand side g: t and its products; g_v; g_p.
    begin: [Bound; 4],
    preconditioner: Precondition,
    /// r . z of wet quads and nodes.
    beta: Bound,
    direction: Bound,
    pub(super) operator: Operator,
    update: Bound,
    /// Slots of nodes, solids and wet quads.
    slots: [usize; 3],
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

/// q = A s of either form, but for B s_p.
#[derive(Debug)]
pub(super) struct Operator {
    /// Over the nodes, before B s_p. In this form: products with s_v; t; products with s_v - t; q_v.
    pub(super) nodes: Vec<Bound>,
    /// q_p + J t in the wet quads, after B s_p.
    pub(super) quads: Bound,
    /// s . q of wet quads and nodes.
    pub(super) alpha: Bound,
}

impl Monolithic {
    /// Compiles and binds.
    pub(super) fn new(
        gpu: &Gpu,
        at: CoupledFields,
        shared: &Shared,
        polynomial: &Buffer<Polynomial>,
        solver: &Solver,
    ) -> Result<Monolithic, Error> {
        let CoupledFields { liquid, solids, fields, coupling, .. } = at;
        let variant = liquid.variant;
        let t = [("x", (&coupling.t).into())];
        let tables: &[&dyn Arrays] = &[coupling, solids, shared];
        let bound = |source| bind(gpu, &source, variant, [], tables);
        Ok(Monolithic {
            begin: [
                bind(gpu, &wgsl!("two_field_begin"), variant.real, [], tables)?,
                solids.bind_products(gpu, fields, &coupling.t)?,
                bind(gpu, &wgsl!("two_field_rhs"), variant.real, [], &at.by_node())?,
                bind(gpu, &wgsl!("couple_begin"), variant, t, &at.by_quad())?,
            ],
            preconditioner: match solver.preconditioner {
                Preconditioner::Multigrid => Precondition::Factored(Factored::new(gpu, at, shared, polynomial)?.into()),
                kind => Precondition::Diagonal(Jacobi::new(gpu, at, shared.level, polynomial, kind)?.into()),
            },
            beta: bind_sum(gpu, at, shared, &coupling.coupling, &wgsl!("couple_beta"))?,
            direction: bound(wgsl!("two_field_direction"))?,
            operator: Operator::new(gpu, at, shared)?,
            update: bound(wgsl!("two_field_update"))?,
            slots: [NODES, BODIES, WET].map(|list| coupling.slot(list)),
        })
    }

    /// Iterations recorded ahead in a refinement step.
    pub(super) fn iterations(&self, degree: usize) -> usize {
        let steps = match &self.preconditioner {
            Precondition::Factored(factored) => 2 * factored.polynomials[0].dispatches(degree),
            Precondition::Diagonal(jacobi) => jacobi.polynomial.dispatches(degree),
        };
        (AHEAD / (DISPATCHES + steps)).clamp(2, CHUNK)
    }

    pub(super) fn record_set_up(&self, pass: &mut Pass) {
        if let Precondition::Diagonal(jacobi) = &self.preconditioner {
            jacobi.record_set_up(pass);
        }
    }

    pub(super) fn record_begin(&self, pass: &mut Pass, state: &State) {
        for bound in &self.begin {
            state.in_begin(pass, bound);
        }
    }

    /// Symmetric and positive definite, since polynomial and V-cycle are, and diagonals. `pressure` records the preconditioner of the liquid.
    pub(super) fn record_preconditioner(
        &self,
        pass: &mut Pass,
        state: &State,
        degree: usize,
        pressure: impl FnOnce(&mut Pass),
    ) {
        let [nodes, bodies, wet] = self.slots;
        let gated = &state.gated;
        match &self.preconditioner {
            Precondition::Factored(factored) => {
                let [first, second] = &factored.polynomials;
                first.record(pass, gated, [nodes, bodies], degree);
                pass.dispatch_indirect(&factored.right, gated, wet);
                pressure(pass);
                pass.dispatch_indirect(&factored.restore, gated, wet);
                pass.dispatch_indirect(&factored.nodes, gated, nodes);
                second.record(pass, gated, [nodes, bodies], degree);
                pass.dispatch_indirect(&factored.z, gated, nodes);
            }
            Precondition::Diagonal(jacobi) => {
                pressure(pass);
                jacobi.record(pass, gated, self.slots, degree);
            }
        }
        pass.dispatch_indirect(&self.beta, &state.gate, 0);
    }

    pub(super) fn record_direction(&self, pass: &mut Pass, state: &State) {
        pass.dispatch_indirect(&self.direction, &state.gated, self.slots[0]);
    }

    pub(super) fn record_update(&self, pass: &mut Pass, state: &State) {
        state.in_update(pass, &self.update);
    }
}

impl Factored {
    fn new(gpu: &Gpu, at: CoupledFields, shared: &Shared, polynomial: &Buffer<Polynomial>) -> Result<Factored, Error> {
        let CoupledFields { liquid, solids, coupling, .. } = at;
        let sweep = gpu.uniform("coupled_solver.sweep", &FIRST_SWEEP)?;
        let variant = liquid.variant;
        let right = [("level", shared.level.into()), ("sweep", (&sweep).into()), ("x", (&coupling.t).into())];
        let restored = [("z", (&liquid.z_next).into())];
        let nodes = [("p", (&liquid.z_next).into()), ("y", (&coupling.difference).into())];
        Ok(Factored {
            polynomials: [
                Chebyshev::new(gpu, solids, polynomial, &solids.r, &coupling.t)?,
                Chebyshev::new(gpu, solids, polynomial, &coupling.difference, &solids.z)?,
            ],
            right: bind(gpu, &wgsl!("couple_right"), variant, right, &at.by_quad())?,
            restore: bind(gpu, &wgsl!("couple_restore"), variant, restored, &at.by_quad())?,
            nodes: bind(gpu, &wgsl!("couple_nodes"), variant, nodes, &at.by_node())?,
            z: bind(gpu, &wgsl!("two_field_z"), variant.real, [], &at.by_node())?,
        })
    }
}

impl Operator {
    fn new(gpu: &Gpu, at: CoupledFields, shared: &Shared) -> Result<Operator, Error> {
        let CoupledFields { liquid, solids, fields, coupling, .. } = at;
        let wide = |source| bind(gpu, &source, liquid.variant.real, [], &at.by_node());
        let x = [("x", (&coupling.t).into())];
        Ok(Operator {
            nodes: vec![
                solids.bind_products(gpu, fields, &solids.search)?,
                wide(wgsl!("two_field_half"))?,
                solids.bind_products(gpu, fields, &coupling.difference)?,
                wide(wgsl!("two_field_apply"))?,
            ],
            quads: bind(gpu, &wgsl!("couple_apply"), liquid.variant, x, &at.by_quad())?,
            alpha: bind_sum(gpu, at, shared, &coupling.coupling, &wgsl!("couple_alpha"))?,
        })
    }
}

/// Binds a sum over wet quads and nodes, whose numbers are in `sizes`, that joins the partials of the active quads.
pub(super) fn bind_sum(
    gpu: &Gpu,
    at: CoupledFields,
    shared: &Shared,
    sizes: &Buffer<Coupling>,
    source: &Source,
) -> Result<Bound, Error> {
    let own = [("coupling", sizes.into()), ("all_partials", (&at.liquid.partials).into())];
    bind(gpu, source, at.coupling.variant, own, &[at.coupling, shared])
}
