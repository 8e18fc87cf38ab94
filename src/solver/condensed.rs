//! The correction of a coupled solve in its condensed form, pressures alone: (B + J S^-1 J^T) dp = r_p - J y, y = S^-1 r_v, then
//! dv = S^-1 (r_v + J^T dp) in the units of [`two_field`](super::two_field), whose outer loop it shares.
//!
//! Conjugate gradients need S^-1 only among the components that the liquid wets: a dense W in f32, made from a sparse Cholesky factor on
//! the host (design section 5). The full S^-1 of y and dv uses the factor in f64: one exchange of three numbers per node a round. W only
//! corrects, so its rounding costs iterations and no accuracy.

use std::sync::{Mutex, PoisonError};

use crate::Error;
use crate::gpu::{
    Bound, Buffer, Gpu, Kernel, Pass, Readback, Real, RealBuffer, Recorder, StageTimes, Variant,
};
use crate::scene::{Formulation, Solver};
use crate::state::SolveStatus;

use super::chebyshev::Polynomial;
use super::coupling::{Coupling, NODES, WET};
use super::pcg::{Pcg, State, Unknowns};
use super::refine::{SCALE, STATUS_STAGNATED, System, host_turns};
use super::solid_system::SolidRows;
use super::stored_stiffness::{Factor, Stored, StoredStiffness};
use super::two_field::{CoupledFields, CoupledOutcome, TwoFieldSolver};
use super::{Control, Level, Sweep, variant};

/// Wetted components, at most: a W of 81 MB, which the smallest bindings that adapters offer, 128 MiB, have room for.
pub const MOST_WETTED: usize = 4500;
/// Wetted components above which the making of a W of 16 MB costs about as much as what it saves, as long as two-field corrections take a
/// few tens of iterations. Where the polynomial of the solids falls short they take hundreds.
pub const WORTH_WETTED: usize = 2000;
/// Components of all solids, at most: a factor of as many takes some hundredths of a second.
const MOST_COMPONENTS: usize = 30_000;
/// Iterations that are recorded ahead of an exchange; a round takes about as many.
const CHUNK: usize = 12;

/// The doppelganger of `Wetted` in `shaders/common/wetted.wgsl`.
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

/// What the condensed form adds to [`TwoFieldSolver`].
#[derive(Debug)]
pub(super) struct Condensed {
    /// What the scene asks for.
    formulation: Formulation,
    stiffness: StoredStiffness,
    wet: Bound,
    wet_nodes: Buffer<u32>,
    begin: Bound,
    inverse: Bound,
    quads: Bound,
    alpha: Bound,
    of_correction: Bound,
    /// Sums over the quads of the liquid alone.
    pcg: Pcg,
    wetted: Buffer<Wetted>,
    nodes: Buffer<u32>,
    /// W times the mass rate of a cell, s/kg kg/s.
    w: Buffer<f32>,
    /// S^-1 r_v over the size of the residual.
    y: RealBuffer,
    /// J with no nodes, so that sums are over wet quads alone.
    of_quads: Buffer<Coupling>,
    readbacks: Mutex<Readbacks>,
}

/// Where what the host computes with arrives.
#[derive(Debug)]
struct Readbacks {
    wet: Readback<u32>,
    freedom: Readback<[f32; 4]>,
    rotated: Readback<u32>,
    masses: Readback<u32>,
    of_nodes: Readback<u32>,
}

/// What the corrections of a solve are made of.
#[derive(Debug)]
pub(super) enum Form<'a> {
    /// Pressures alone.
    Condensed(Ready<'a>),
    /// Pressures and velocities: too many nodes are wet, or S, which this form does not factorise, has no factor in f64.
    TwoField,
    /// Nothing: S has no factor, and the scene asks for the condensed form.
    WithoutFactor,
}

/// What is uploaded for a solve, and the factor.
#[derive(Debug)]
pub(super) struct Ready<'a> {
    factor: Factor<'a>,
    /// rho dx^3 / dt, kg/s.
    mass: f64,
}

/// Whether corrections of a coupled solve may have the condensed form, on an adapter with or without f64.
pub fn can_condense(rows: &SolidRows, solver: &Solver, f64: bool) -> bool {
    let variant = variant(f64, solver.precision);
    solver.formulation != Formulation::TwoField && room(rows, solver, variant) > 0
}

/// Whether the outer loop is in f64, on the device or on the host, as dv is.
fn refines(solver: &Solver, variant: Variant) -> bool {
    variant.real == Real::F64 || host_turns(solver, variant)
}

/// Wetted nodes that there is room for; 0 where the solids are too large or the outer loop is not in f64.
fn room(rows: &SolidRows, solver: &Solver, variant: Variant) -> usize {
    let n = rows.rows.n_nodes as usize;
    match refines(solver, variant) && 3 * n <= MOST_COMPONENTS {
        true => n.min(MOST_WETTED / 3),
        false => 0,
    }
}

/// Refuses the condensed form for solids of so many nodes where it is asked for and does not serve.
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
        (true, n) if n > MOST_COMPONENTS => {
            limit(n, MOST_COMPONENTS, "components of the nodes of solids")
        }
        _ => Ok(()),
    }
}

impl Condensed {
    /// Compiles and binds; `None` where it does not serve.
    pub(super) fn new(
        gpu: &Gpu,
        at: CoupledFields,
        unknowns: &Unknowns,
        state: &State,
        (level, sweep): (&Buffer<Level>, &Buffer<Sweep>),
        solver: &Solver,
    ) -> Result<Option<Condensed>, Error> {
        let CoupledFields {
            liquid,
            solids,
            coupling,
            ..
        } = at;
        let rows = &solids.layout;
        let (n, m) = (rows.rows.n_nodes as usize, rows.rows.n_elements as usize);
        let room = room(rows, solver, liquid.variant);
        if room == 0 {
            return Ok(None);
        }
        let real = liquid.variant.real;
        let words = real.bytes() / 4;
        let kernel = |source| Kernel::new(gpu, source, liquid.variant);
        let wide = |source| Kernel::new(gpu, source, real);
        let wet_nodes = gpu.buffer::<u32>("condensed.wet", n)?;
        let wetted = gpu.uniform("condensed.wetted", &Wetted::default())?;
        let nodes = gpu.buffer("condensed.nodes", room)?;
        let w = gpu.buffer("condensed.inverse", 9 * room * room)?;
        let y = RealBuffer::new(gpu, "condensed.y", 4 * n, real)?;
        let of_quads = gpu.uniform("condensed.quads", &Coupling::default())?;
        let joint = ("coupling", (&coupling.coupling).into());
        let list = ("words", (&coupling.words).into());
        let by_quad = ("pairs", (&coupling.quad_pairs).into());
        let by_node = ("pairs", (&coupling.node_pairs).into());
        let flags = ("flags", (&liquid.flags).into());
        let partials = ("partials", (&coupling.partials).into());
        let level_binding = ("level", level.into());
        Ok(Some(Condensed {
            formulation: solver.formulation,
            stiffness: StoredStiffness::new(n, &rows.elements),
            wet: wide(&crate::wgsl!("condensed_wet"))?.bind(
                gpu,
                &[joint, list, by_node, flags, ("wet", (&wet_nodes).into())],
            )?,
            begin: kernel(&crate::wgsl!("condensed_begin"))?.bind(
                gpu,
                &[
                    joint,
                    level_binding,
                    ("sweep", sweep.into()),
                    list,
                    by_quad,
                    flags,
                    ("x", (&y).into()),
                    ("matrix", (&liquid.matrix).into()),
                    ("r", (&liquid.r).into()),
                    ("z", (&liquid.z).into()),
                    partials,
                ],
            )?,
            inverse: wide(&crate::wgsl!("condensed_apply"))?.bind(
                gpu,
                &[
                    ("wetted", (&wetted).into()),
                    ("nodes", (&nodes).into()),
                    ("inverse", (&w).into()),
                    ("f", (&coupling.t).into()),
                    ("t", (&coupling.difference).into()),
                ],
            )?,
            quads: kernel(&crate::wgsl!("couple_apply"))?.bind(
                gpu,
                &[
                    joint,
                    list,
                    by_quad,
                    flags,
                    ("x", (&coupling.difference).into()),
                    ("search", (&liquid.search).into()),
                    ("r", (&liquid.r).into()),
                    ("q", (&liquid.q).into()),
                    partials,
                ],
            )?,
            alpha: kernel(&crate::wgsl!("couple_alpha"))?.bind(
                gpu,
                &[
                    ("coupling", (&of_quads).into()),
                    ("args", (&coupling.args).into()),
                    partials,
                    ("scalars", (&state.scalars).into()),
                    ("all_partials", (&liquid.partials).into()),
                ],
            )?,
            of_correction: kernel(&crate::wgsl!("condensed_force"))?.bind(
                gpu,
                &[
                    joint,
                    level_binding,
                    list,
                    by_node,
                    flags,
                    ("search", (&liquid.search).into()),
                    ("force", (&coupling.t).into()),
                ],
            )?,
            pcg: {
                let sums = unknowns.level.args;
                Pcg::new(gpu, &Unknowns { sums, ..*unknowns }, level, state)?
            },
            readbacks: Mutex::new(Readbacks {
                wet: Readback::new(gpu, "condensed.wet", n)?,
                freedom: Readback::new(gpu, "condensed.freedom", n)?,
                rotated: Readback::new(gpu, "condensed.rotated", 12 * words * m)?,
                masses: Readback::new(gpu, "condensed.masses", words * n)?,
                of_nodes: Readback::new(gpu, "condensed.nodes", 4 * words * n)?,
            }),
            wet_nodes,
            wetted,
            nodes,
            w,
            y,
            of_quads,
        }))
    }

    /// Wetted nodes that are worth a W: all that there is room for, or fewer where the two-field form, with this polynomial, is quick.
    fn most_wetted(&self, polynomial: &Polynomial) -> usize {
        let room = self.nodes.len();
        match self.formulation {
            Formulation::Condensed => room,
            Formulation::Auto | Formulation::TwoField if polynomial.falls_short() => room,
            Formulation::Auto | Formulation::TwoField => room.min(WORTH_WETTED / 3),
        }
    }

    /// Submits the recording, which ends with both systems and J in place, and makes W where the form is the condensed one.
    pub(super) fn ready<'a>(
        &'a self,
        gpu: &Gpu,
        mut recorder: Recorder,
        at: CoupledFields,
        polynomial: &Polynomial,
        record_args: impl FnOnce(&mut Pass),
    ) -> Result<(Form<'a>, StageTimes), Error> {
        let (solids, coupling) = (at.solids, at.coupling);
        recorder.stage("solve", |pass| {
            record_args(pass);
            pass.dispatch(&self.wet, coupling.n_nodes);
        });
        // A panic in another solve leaves nothing half done here: every use begins with new copies.
        let mut readbacks = self
            .readbacks
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let Readbacks {
            wet,
            freedom,
            rotated,
            masses,
            ..
        } = &mut *readbacks;
        recorder.read(&self.wet_nodes, wet);
        recorder.read(at.fields.freedom, freedom);
        recorder.read(&at.fields.rotated.words, rotated);
        recorder.read_part(&solids.masses.words, 0, masses);
        let timing = recorder.submit();
        let wet = wet.wait(gpu)?;
        let stored = Stored {
            freedom: freedom.wait(gpu)?,
            rotated: at.fields.rotated.widen(&rotated.wait(gpu)?),
            masses: solids.masses.widen(&masses.wait(gpu)?),
        };
        let times = timing.wait()?;
        let nodes = (0..wet.len() as u32).filter(|&node| wet[node as usize] != 0);
        let nodes: Vec<u32> = nodes.collect();
        if nodes.len() > self.most_wetted(polynomial) {
            return Ok((Form::TwoField, times));
        }
        let mass = f64::from(coupling.now.mass);
        let Some(factor) = self.stiffness.factorise(&stored)? else {
            let form = match self.formulation {
                Formulation::Condensed => Form::WithoutFactor,
                Formulation::Auto | Formulation::TwoField => Form::TwoField,
            };
            return Ok((form, times));
        };
        gpu.upload(&self.w, &factor.inverse_among(&nodes, mass));
        gpu.upload(&self.nodes, &nodes);
        let wetted = Wetted {
            n: nodes.len() as u32,
            ..Wetted::default()
        };
        gpu.upload(&self.wetted, &[wetted]);
        let of_quads = Coupling {
            n_nodes: 0,
            ..coupling.now
        };
        gpu.upload(&self.of_quads, &[of_quads]);
        Ok((Form::Condensed(Ready { factor, mass }), times))
    }
}

impl Condensed {
    /// Writes y of a round.
    pub(super) fn write_start(&self, gpu: &Gpu, y: &[f64]) {
        self.y.upload(gpu, y);
    }
}

impl Ready<'_> {
    /// S^-1 of forces over the mass rate of a cell, in m/s, over a size.
    pub(super) fn velocity(&self, forces: &[f64], size: f64) -> Vec<f64> {
        let newtons: Vec<f64> = forces.iter().map(|force| self.mass * force).collect();
        let mut velocity = self.factor.solve(&newtons);
        velocity.iter_mut().for_each(|v| *v /= size);
        velocity
    }
}

/// What the host hears between submissions.
struct Told {
    control: Control,
    norms: Vec<f64>,
    /// Four numbers per node.
    of_nodes: Vec<f64>,
}

impl TwoFieldSolver {
    /// As [`TwoFieldSolver::solve`], in the condensed form; no outcome, and nothing changed, where the form is the other one. Where there is
    /// no factor for it a breakdown: what is free stays at zero.
    pub(super) fn solve_condensed<'a>(
        &self,
        condensed: &Condensed,
        gpu: &'a Gpu,
        recorder: Recorder,
        at: CoupledFields,
        polynomial: &Polynomial,
        again: bool,
    ) -> Result<(Option<CoupledOutcome>, StageTimes), Error> {
        let (form, mut times) =
            condensed.ready(gpu, recorder, at, polynomial, |pass| self.record_args(pass))?;
        let ready = match form {
            Form::Condensed(ready) => Some(ready),
            Form::TwoField => return Ok((None, times)),
            Form::WithoutFactor => None,
        };
        let n = 4 * at.coupling.n_nodes;
        let nothing = vec![0.0; n];
        // Nothing is left of a two-field round.
        let scalars = self.state.scalars.words.len() * 4 / self.state.scalars.real.bytes();
        self.state.scalars.upload(gpu, &vec![0.0; scalars]);
        at.solids.search.upload(gpu, &vec![0.0; 2 * n]);
        let outer = &at.solids.outer;
        let mut to = Recorder::timed(gpu);
        to.stage("solve", |pass| {
            self.record_start(pass, at, again);
            self.record_turn(pass);
        });
        let mut told = self.hear(gpu, to, condensed, outer, &mut times)?;
        let mut rounds = 0;
        loop {
            if let Some(mut outcome) = self.outcome(&told.control, &told.norms) {
                if told.control.status == STATUS_STAGNATED {
                    // One more turn, so that a correction on trial is taken back.
                    let mut to = Recorder::timed(gpu);
                    to.stage("solve", |pass| self.record_turn(pass));
                    self.hear(gpu, to, condensed, outer, &mut times)?;
                }
                outcome.condensed = true;
                return Ok((Some(outcome), times));
            }
            let Some(ready) = &ready else {
                let status = SolveStatus::Breakdown;
                let mut outcome = self.outcome_of(status, &told.control, &told.norms);
                outcome.condensed = true;
                return Ok((Some(outcome), times));
            };
            if told.control.rounds > rounds {
                // After a round that is kept dv has left nothing of r_v but rounding; after one that is taken back all of it is there.
                let size = told.norms[SCALE];
                let y = ready.velocity(&told.of_nodes, size);
                rounds = told.control.rounds;
                condensed.write_start(gpu, &y);
                let residual = told.of_nodes;
                let mut to = Recorder::timed(gpu);
                to.stage("solve", |pass| self.record_condensed_begin(pass, condensed));
                loop {
                    to.stage("solve", |pass| {
                        self.record_condensed(pass, condensed, at);
                        pass.dispatch(&condensed.of_correction, at.coupling.n_nodes);
                    });
                    told = self.hear(gpu, to, condensed, &at.coupling.t, &mut times)?;
                    if told.control.running == 0 {
                        break;
                    }
                    to = Recorder::timed(gpu);
                }
                let forces = residual.iter().zip(&told.of_nodes);
                let forces: Vec<f64> = forces.map(|(r, force)| r + size * force).collect();
                let mut search = nothing.clone();
                search.extend(ready.velocity(&forces, size));
                at.solids.search.upload(gpu, &search);
            }
            let mut to = Recorder::timed(gpu);
            to.stage("solve", |pass| self.record_turn(pass));
            told = self.hear(gpu, to, condensed, outer, &mut times)?;
        }
    }

    /// Submits, and reads four numbers per node with the state.
    fn hear(
        &self,
        gpu: &Gpu,
        mut to: Recorder,
        condensed: &Condensed,
        of_nodes: &RealBuffer,
        times: &mut StageTimes,
    ) -> Result<Told, Error> {
        let mut readbacks = condensed
            .readbacks
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        to.read(&of_nodes.words, &mut readbacks.of_nodes);
        let (control, norms, mut stages) = self.submit(gpu, to)?;
        times.append(&mut stages);
        Ok(Told {
            control,
            norms,
            of_nodes: of_nodes.widen(&readbacks.of_nodes.wait(gpu)?),
        })
    }

    /// The right-hand side of a correction.
    pub(super) fn record_condensed_begin(&self, pass: &mut Pass, condensed: &Condensed) {
        self.pressure.record_begin(pass, &self.state);
        self.state.in_begin(pass, &condensed.begin);
        self.pcg.record_gate(pass);
        pass.dispatch_indirect(&self.begin.weight, &self.state.gate, 0);
    }

    pub(super) fn record_condensed(
        &self,
        pass: &mut Pass,
        condensed: &Condensed,
        at: CoupledFields,
    ) {
        let [nodes, wet] = [NODES, WET].map(|list| at.coupling.slot(list));
        let (state, gated) = (&self.state, &self.state.gated);
        self.pcg.record_gate(pass);
        for _ in 0..CHUNK {
            self.pressure.record_preconditioner(pass, state, at.liquid);
            condensed.pcg.beta.record_gated(pass, &state.gate);
            state.in_round(pass, &condensed.pcg.direction, 0);
            for bound in [&self.operator.force, &condensed.inverse] {
                pass.dispatch_indirect(bound, gated, nodes);
            }
            self.pressure.record_operator(pass, gated);
            pass.dispatch_indirect(&condensed.quads, gated, wet);
            pass.dispatch_indirect(&condensed.alpha, &state.gate, 0);
            self.pcg.alpha.record_gated(pass, &state.gate);
            self.pressure.record_update(pass, state);
        }
    }
}
