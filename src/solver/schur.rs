//! Schur-complement form of the corrections, in the pressures alone and in the units of [`coupled`](super::coupled): (B + J S^-1 J^T) dp =
//! r_p - J y with y = S^-1 r_v, then dv = S^-1 (r_v + J^T dp).
//!
//! Conjugate gradients need S^-1 only among the wet components. This is the wet compliance, a dense matrix in f32 from a sparse Cholesky factor
//! on the host. The full S^-1 of y and dv uses the factor in f64, with one exchange of three numbers per node in a refinement step. The
//! rounding of the wet compliance costs iterations and no accuracy.

use std::sync::Mutex;

use crate::Error;
use crate::fields::{Coupling, SolidRows, variant};
use crate::gpu::{Bound, Buffer, Gpu, Pass, Readback, Real, RealBuffer, Recorder, StageTimes, Variant, bind, lock};
use crate::scene::{Formulation, Solver};
use crate::step::Stage;
use crate::wgsl;

use super::chebyshev::Polynomial;
use super::contact_rows::HeldSolve;
use super::coupled::CoupledFields;
use super::pcg::{Pcg, Unknowns};
use super::pressure::FIRST_SWEEP;
use super::refine::{Shared, on_host};
use super::stored_stiffness::{Factor, StoredStiffness};
use super::two_field::{Operator, bind_sum};

/// Wetted components, at most: a W of 81 MB, which the smallest bindings that adapters offer, 128 MiB, have room for.
pub const MOST_WETTED: usize = 4500;
/// Wetted components above which the making of a W of 16 MB costs about as much as what it saves, as long as two-field corrections take a
/// few tens of iterations. Where the polynomial of the solids falls short they take hundreds.
pub const WORTH_WETTED: usize = 2000;
/// Components of all solids, at most: a factor of as many takes some hundredths of a second.
const MOST_COMPONENTS: usize = 30_000;
/// Iterations recorded ahead of an exchange; a refinement step takes about as many.
pub(super) const CHUNK: usize = 12;

/// Size of the wet compliance.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Wetted {
    /// Wetted nodes.
    pub n: u32,
    /// Nothing.
    pub pad_0: u32,
    /// Nothing.
    pub pad_1: u32,
    /// Nothing.
    pub pad_2: u32,
}

/// Kernels and arrays of the form.
#[derive(Debug)]
pub(super) struct Schur {
    /// Form that the scene requires.
    formulation: Formulation,
    /// Whether solids touch each other: the wet compliance is kept to downdate it.
    contact: bool,
    wet: Bound,
    wet_nodes: Buffer<u32>,
    pub(super) begin: Bound,
    /// Over the nodes: wet compliance times J^T s.
    pub(super) operator: Operator,
    force: Bound,
    /// Beta is a sum over the quads of the liquid alone.
    pub(super) pcg: Pcg,
    wetted: Buffer<Wetted>,
    nodes: Buffer<u32>,
    /// Wet compliance times the mass rate of a cell, s/kg kg/s.
    w: Buffer<f32>,
    /// S^-1 r_v over the size of the residual.
    y: RealBuffer,
    /// J without nodes: sums over wet quads alone.
    quads_only: Buffer<Coupling>,
    wet_readback: Mutex<Readback<u32>>,
    node_readback: Mutex<Readback<u32>>,
}

/// Form of the corrections of a solve.
#[derive(Debug)]
pub(super) enum Prepared<'a> {
    Schur(Inverse<'a>),
    /// Too many nodes are wet, or S, which the two-field form does not factorise, has no factor in f64.
    Monolithic,
    /// S has no factor, and the scene requires this form.
    Singular,
}

/// S^-1 of a sub-step.
#[derive(Debug)]
pub(super) struct Inverse<'a> {
    pub(super) factor: Factor<'a>,
    /// rho dx^3 / dt, kg/s.
    pub(super) mass: f64,
    /// Wet nodes.
    pub(super) nodes: Vec<u32>,
    /// The wet compliance in scenes with contact of solids, which downdates it.
    pub(super) wet: Vec<f32>,
}

/// Elimination of the velocities, and their recovery.
#[derive(Clone, Copy, Debug)]
pub(super) struct Elimination<'a> {
    pub(super) inverse: &'a Inverse<'a>,
    /// Rows of contact that are equations in this solve.
    held: Option<&'a HeldSolve<'a>>,
    y: &'a RealBuffer,
    record_force: &'a Bound,
    n_nodes: usize,
    /// J^T dp, four numbers per node.
    pub(super) force: &'a RealBuffer,
    /// For four numbers per node.
    pub(super) readback: &'a Mutex<Readback<u32>>,
}

impl Elimination<'_> {
    /// Writes S^-1 r / size. `unit`: what r is a multiple of.
    pub(super) fn eliminate(&self, gpu: &Gpu, r: &[f64], size: f64, unit: f64) {
        self.y.upload(gpu, &self.velocity(r, size, unit).0);
    }

    /// S^-1 of forces over the mass rate of a cell, in m/s, over a size, and the lambda of held rows.
    fn velocity(&self, forces: &[f64], size: f64, unit: f64) -> (Vec<f64>, Vec<f64>) {
        let Inverse { factor, mass, .. } = self.inverse;
        let newtons: Vec<f64> = forces.iter().map(|force| mass * force).collect();
        let mut velocity = factor.solve(&newtons);
        let lambda = self.held.map_or(Vec::new(), |held| held.constrain(&newtons, unit, &mut velocity));
        velocity.iter_mut().for_each(|v| *v /= size);
        (velocity, lambda)
    }

    /// The correction of the velocities. Held rows get its forces, and the right-hand side with them is returned.
    pub(super) fn correct(&self, gpu: &Gpu, forces: &[f64], size: f64, unit: f64) -> (Vec<f64>, Option<Vec<f64>>) {
        let (velocity, lambda) = self.velocity(forces, size, unit);
        let rhs = self.held.map(|held| held.advance(gpu, &lambda, unit));
        (velocity, rhs)
    }

    /// After a rejected correction: the right-hand side before it.
    pub(super) fn revert(&self, gpu: &Gpu) -> Option<Vec<f64>> {
        self.held.map(|held| held.revert(gpu))
    }

    /// Records J^T of the correction of the pressure.
    pub(super) fn record_force(&self, pass: &mut Pass) {
        pass.dispatch(self.record_force, self.n_nodes);
    }
}

/// Whether corrections of a coupled solve may have the Schur-complement form, on an adapter with or without f64.
pub fn can_condense(rows: &SolidRows, solver: &Solver, f64: bool) -> bool {
    let variant = variant(f64, solver.precision);
    solver.formulation != Formulation::TwoField && room(rows, solver, variant) > 0
}

/// Whether the outer loop is in f64, on the device or on the host, as dv is.
fn refines(solver: &Solver, variant: Variant) -> bool {
    variant.real == Real::F64 || on_host(solver, variant)
}

/// Wetted nodes that there is room for; 0 where the solids are too large or the outer loop is not in f64.
fn room(rows: &SolidRows, solver: &Solver, variant: Variant) -> usize {
    let n = rows.rows.n_nodes as usize;
    match refines(solver, variant) && 3 * n <= MOST_COMPONENTS {
        true => n.min(MOST_WETTED / 3),
        false => 0,
    }
}

/// Refuses the Schur-complement form for solids of this many nodes where the scene requires it and it does not serve.
///
/// # Errors
/// [`Error::Limit`] with what it needs.
pub fn check_formulation(n_nodes: usize, solver: &Solver, variant: Variant) -> Result<(), Error> {
    if solver.formulation != Formulation::Condensed {
        return Ok(());
    }
    let limit = |needed: usize, available: usize, unit| {
        Err(Error::Limit {
            what: "the condensed form of the coupled solve".to_owned(),
            needed: needed as u64,
            available: available as u64,
            unit,
            cure: "use formulation \"auto\" or \"two_field\"".to_owned(),
        })
    };
    match (refines(solver, variant), 3 * n_nodes) {
        (false, _) => limit(1, 0, "outer loop in f64"),
        (true, n) if n > MOST_COMPONENTS => limit(n, MOST_COMPONENTS, "components of the nodes of solids"),
        _ => Ok(()),
    }
}

impl Schur {
    /// Compiles and binds; `None` where the form does not serve.
    pub(super) fn new(gpu: &Gpu, at: CoupledFields, shared: &Shared, solver: &Solver) -> Result<Option<Schur>, Error> {
        let CoupledFields { liquid, solids, coupling, .. } = at;
        let rows = &solids.layout;
        let n = rows.rows.n_nodes as usize;
        let room = room(rows, solver, liquid.variant);
        if room == 0 {
            return Ok(None);
        }
        let real = liquid.variant.real;
        let words = real.bytes() / 4;
        let wet_nodes = gpu.buffer::<u32>("condensed.wet", n)?;
        let wetted = gpu.uniform("condensed.wetted", &Wetted::default())?;
        let nodes = gpu.buffer("condensed.nodes", room)?;
        let w = gpu.buffer("condensed.inverse", 9 * room * room)?;
        let y = RealBuffer::new(gpu, "condensed.y", 4 * n, real)?;
        let quads_only = gpu.uniform("condensed.quads", &Coupling::default())?;
        let sweep = gpu.uniform("coupled_solver.sweep", &FIRST_SWEEP)?;
        let variant = liquid.variant;
        let level = ("level", shared.level.into());
        let wet = [("wet", (&wet_nodes).into())];
        let begin = [level, ("sweep", (&sweep).into()), ("x", (&y).into())];
        let inverse = [
            ("wetted", (&wetted).into()),
            ("nodes", (&nodes).into()),
            ("inverse", (&w).into()),
            ("f", (&coupling.t).into()),
            ("t", (&coupling.difference).into()),
        ];
        let quads = [("x", (&coupling.difference).into())];
        let force = [level, ("search", (&liquid.search).into()), ("force", (&coupling.t).into())];
        let [beta, alpha] = [liquid.plan.level(0).args, shared.unknowns.sums[1]];
        let unknowns = Unknowns { sums: [beta, alpha], ..shared.unknowns.clone() };
        Ok(Some(Schur {
            formulation: solver.formulation,
            contact: solver.solid_contact,
            wet: bind(gpu, &wgsl!("condensed_wet"), real, wet, &at.by_node())?,
            begin: bind(gpu, &wgsl!("condensed_begin"), variant, begin, &at.by_quad())?,
            operator: Operator {
                nodes: vec![bind(gpu, &wgsl!("condensed_apply"), real, inverse, &[])?],
                quads: bind(gpu, &wgsl!("couple_apply"), variant, quads, &at.by_quad())?,
                alpha: bind_sum(gpu, at, shared, &quads_only, &wgsl!("couple_alpha"))?,
            },
            force: bind(gpu, &wgsl!("condensed_force"), variant, force, &at.by_node())?,
            pcg: Pcg::new(gpu, &unknowns, shared.level, shared.state)?,
            wet_readback: Mutex::new(Readback::new(gpu, "condensed.wet", n)?),
            node_readback: Mutex::new(Readback::new(gpu, "condensed.nodes", 4 * words * n)?),
            wet_nodes,
            wetted,
            nodes,
            w,
            y,
            quads_only,
        }))
    }

    pub(super) fn elimination<'a>(
        &'a self,
        at: CoupledFields<'a>,
        inverse: &'a Inverse<'a>,
        held: Option<&'a HeldSolve<'a>>,
    ) -> Elimination<'a> {
        Elimination {
            inverse,
            held,
            y: &self.y,
            record_force: &self.force,
            n_nodes: at.coupling.n_nodes,
            force: &at.coupling.t,
            readback: &self.node_readback,
        }
    }

    /// Wet nodes, at most.
    pub(super) fn room(&self) -> usize {
        self.nodes.len()
    }

    /// Wet nodes, at most, for a solve without contact: all that there is room for, or fewer where the two-field form, with this polynomial, is
    /// quick.
    pub(super) fn worth_wetted(&self, polynomial: &Polynomial) -> usize {
        let room = self.room();
        match self.formulation {
            Formulation::Condensed => room,
            Formulation::Auto | Formulation::TwoField if polynomial.falls_short() => room,
            Formulation::Auto | Formulation::TwoField => room.min(WORTH_WETTED / 3),
        }
    }

    /// Submits the recording, which ends with both systems and J in place, and computes the wet compliance where the form is this one. `most`: wet
    /// nodes of this form.
    pub(super) fn prepare<'a>(
        &'a self,
        gpu: &Gpu,
        mut recorder: Recorder,
        at: CoupledFields,
        (stiffness, most): (&'a StoredStiffness, usize),
        record_args: impl FnOnce(&mut Pass),
    ) -> Result<(Prepared<'a>, StageTimes), Error> {
        let coupling = at.coupling;
        recorder.stage(Stage::Solve.name(), |pass| {
            record_args(pass);
            pass.dispatch(&self.wet, coupling.n_nodes);
        });
        let mut wet = lock(&self.wet_readback);
        recorder.read(&self.wet_nodes, &mut wet);
        let mut readbacks = lock(&stiffness.readbacks);
        readbacks.record(&mut recorder, at.solids, at.fields);
        let timing = recorder.submit();
        let wet = wet.wait(gpu)?;
        let stored = readbacks.wait(gpu, at.solids, at.fields)?;
        let times = timing.wait()?;
        let nodes = (0..wet.len() as u32).filter(|&node| wet[node as usize] != 0);
        let nodes: Vec<u32> = nodes.collect();
        if nodes.len() > most {
            return Ok((Prepared::Monolithic, times));
        }
        let mass = f64::from(coupling.written.sizes.mass);
        let Some(factor) = stiffness.factorise(&stored)? else {
            let form = match self.formulation {
                Formulation::Condensed => Prepared::Singular,
                Formulation::Auto | Formulation::TwoField => Prepared::Monolithic,
            };
            return Ok((form, times));
        };
        let mut wet = factor.inverse_among(&nodes, mass);
        gpu.upload(&self.w, &wet);
        if !self.contact {
            wet = Vec::new();
        }
        gpu.upload(&self.nodes, &nodes);
        let wetted = Wetted { n: nodes.len() as u32, ..Wetted::default() };
        gpu.upload(&self.wetted, &[wetted]);
        let quads_only = Coupling { n_nodes: 0, ..coupling.written.sizes };
        gpu.upload(&self.quads_only, &[quads_only]);
        let inverse = Inverse { factor, mass, nodes, wet };
        Ok((Prepared::Schur(inverse), times))
    }

    /// Writes the wet compliance with rows as equations.
    pub(super) fn hold(&self, gpu: &Gpu, inverse: &Inverse, held: &HeldSolve) {
        gpu.upload(&self.w, &held.compliance(inverse));
    }
}
