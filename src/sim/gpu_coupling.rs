//! Coupling of liquid and solids on a device: clipping on the host, the coupling matrix J, and the solve for both.

use glam::{DMat3, DVec3};

use crate::Error;
use crate::effects::Effects;
use crate::elastic::Cavities;
use crate::fields;
use crate::fields::{
    ClipBuffers, ClipSize, CouplingBuffers, CouplingSize, LiquidBuffers, Pair, REPORT_WORDS, SolidStep, SolverBuffers,
};
use crate::geometry::SolidClip;
use crate::gpu::{Dispatches, Gpu, Pass, Readback, Recorder, StageTimes};
use crate::grid::Grid;
use crate::linalg::Row;
use crate::reference::{FILLS, MOST_COUPLED, MOST_MEETINGS, cavity_source};
use crate::scene::{CouplingScheme, PatchPressure as Slopes, Scene};
use crate::solver::{
    Aim, CoupledFields, CoupledOutcome, CoupledSolver, Outcome, Polynomial, RowLimits, RowSolves, Weak, WeakBuffers,
};
use crate::stages;
use crate::stages::{FilledCavities, OpenFaces, PatchPressure, Seal};
use crate::state::{ContactReport, CouplingReport, SeparationReport, SolveStatus, State};
use crate::step::Stage;

use super::gpu_contacts::GpuContacts;
use super::gpu_liquid::{GpuLiquid, LiquidSolve};
use super::gpu_solids::{GpuSolids, Search, SolidReadbacks};
use super::separation::Rounds;

/// Capacity for clipping and J.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Capacity {
    clip: ClipSize,
    coupling: CouplingSize,
}

/// Occasion of a clipping.
#[derive(Clone, Copy, Debug)]
pub(super) enum ClipTime {
    /// A new state at a time, s: the arrays of the liquid have just been written.
    State { time: f64 },
    /// A sub-step of length dt that ends at a time, after one of length dt_last (0 before the first); all in s.
    SubStep { time: f64, dt: f64, dt_last: f64 },
}

/// The coupling on the device.
#[derive(Debug)]
pub(super) struct GpuCoupling {
    /// Clipping of the present solids and obstacles.
    pub(super) clip: SolidClip,
    pub(super) cavities: Cavities,
    /// Volumes after the move, m^3; empty before the first sub-step.
    cavity_volumes: Vec<f64>,
    capacity: Capacity,
    on_device: ClipBuffers,
    buffers: CouplingBuffers,
    weak: Option<WeakBuffers>,
    damping_only: bool,
    pub(super) stages: CouplingStages,
    /// Displacements for the next clipping.
    pub(super) moved: Readback<[f32; 4]>,
    /// Forces on the nodes for the probes: J^T p, then the correction for pressure variation within cells. Empty
    /// without force probes.
    probed: Vec<Readback<u32>>,
}

/// Readbacks of a sub-step.
#[derive(Debug)]
pub(super) struct CouplingReadbacks {
    report: Readback<u32>,
    components: Readback<u32>,
    /// `None` without cavities.
    cavities: Option<Readback<u32>>,
}

/// Whether liquid and solids touch, read back before the solve.
#[derive(Clone, Copy, Debug)]
pub(super) struct ContactState {
    /// Whether a patch lies in an active cell.
    pub(super) touching: bool,
    closed_components: u32,
}

/// Result of the coupled solve.
#[derive(Debug)]
pub(super) struct Solved {
    /// Outcome of the liquid rows, then of the solid rows.
    pub(super) parts: [Outcome; 2],
    /// Whether the solve used the Schur-complement form.
    pub(super) condensed: bool,
    pub(super) contact: ContactReport,
    /// Right-hand side of the solids with the forces of contact, N, for the end of the sub-step; `None` where the device has it.
    pub(super) pushed: Option<Vec<f64>>,
}

/// The kernels of a sub-step, in order.
#[derive(Debug)]
pub(super) struct CouplingStages {
    pub(super) clip: Dispatches,
    pub(super) move_solid: Dispatches,
    pub(super) closed_components: Seal,
    /// `None` without cavities.
    pub(super) filled_cavities: Option<FilledCavities>,
    pub(super) patch_pressure: Option<PatchPressure>,
    scheme: Scheme,
    /// With separation.
    separated_flux: Option<Dispatches>,
    pub(super) diagnose: Dispatches,
}

/// Coupling scheme.
#[derive(Debug)]
enum Scheme {
    /// One solve, with all forces or with damping only.
    Together(Box<CoupledSolver>),
    /// One solve after the other.
    Weak(Weak),
}

impl Capacity {
    /// 1.5 times the size of a clipping, because deforming solids cut other cells later. `differing`: quads that the
    /// last clipping cut.
    pub(super) fn for_clip(grid: &Grid, clip: &SolidClip, differing: usize) -> Capacity {
        let ample = |n: usize| n + n / 2 + 64;
        let size = ClipSize::of(grid, clip, differing);
        let pairs = clip.coupling().pairs();
        let padded = grid.padded();
        let quad = |cell: usize| padded.index(grid.cell_at(cell)) / 4;
        let cells = clip.coupling().cells().map(|(cell, _)| quad(cell));
        let mut quads: Vec<usize> = cells.collect();
        quads.dedup();
        Capacity { clip: size.ample(), coupling: CouplingSize { quads: ample(quads.len()), pairs: ample(pairs.len()) } }
    }

    /// The larger of both, per list.
    fn joined(self, other: Capacity) -> Capacity {
        Capacity {
            clip: self.clip.joined(other.clip),
            coupling: CouplingSize {
                quads: self.coupling.quads.max(other.coupling.quads),
                pairs: self.coupling.pairs.max(other.coupling.pairs),
            },
        }
    }
}

/// Buffers that force probes read: J^T p and, if active, the correction for pressure variation within cells.
fn probed(scene: &Scene) -> Vec<&'static str> {
    let force_probes = scene.probes.iter().any(|probe| probe.kind.measures_force());
    let within = Effects::of(scene).patch_correction;
    let buffers = ["coupling.partials", "patch_pressure.correction"].into_iter();
    let n = usize::from(force_probes) * (1 + usize::from(within));
    buffers.take(n).collect()
}

/// Pressure gradient on patches: the hydrostatic one, Pa/m, and the face apertures when the last pressure is used.
fn slopes<'a>(scene: &Scene, liquid: &'a GpuLiquid) -> (DVec3, Option<OpenFaces<'a>>) {
    let faces = OpenFaces { level: &liquid.buffers.level, open: &liquid.buffers.open };
    let follows = scene.solver.pressure_on_patches == Slopes::Gradient;
    let at_rest = liquid.settings.density * scene.domain.gravity;
    (at_rest, follows.then_some(faces))
}

impl CouplingStages {
    fn new(
        gpu: &Gpu,
        scene: &Scene,
        liquid: &GpuLiquid,
        solids: &GpuSolids,
        (on_device, buffers, cavities): (&ClipBuffers, &CouplingBuffers, &Cavities),
        weak: Option<&WeakBuffers>,
    ) -> Result<CouplingStages, Error> {
        let fields = &solids.buffers;
        let nodes = match weak {
            Some(weak) => (&weak.held, &weak.before),
            None => (&fields.flags, &fields.velocity),
        };
        let scheme = match weak {
            Some(weak) => {
                let both = (&liquid.solver, &solids.system);
                Scheme::Weak(Weak::new(gpu, both, fields, buffers, weak)?)
            }
            None => {
                let at = coupled((&liquid.buffers, &liquid.solver), solids, buffers);
                Scheme::Together(CoupledSolver::new(gpu, at, &scene.solver)?.into())
            }
        };
        let patch_pressure = || {
            let slopes = slopes(scene, liquid);
            PatchPressure::new(gpu, &liquid.solver, &solids.system, fields, buffers, slopes)
        };
        let patch_pressure = Effects::of(scene).patch_correction.then(patch_pressure);
        let patch_pressure = patch_pressure.transpose()?;
        let filled_cavities = || {
            let tables = (&liquid.buffers, &liquid.solver, buffers);
            FilledCavities::new(gpu, tables, cavities.of_node(), cavities.len())
        };
        let filled_cavities = (!cavities.is_empty()).then(filled_cavities).transpose()?;
        let correction = patch_pressure.as_ref().map(|patches| &patches.correction);
        Ok(CouplingStages {
            clip: stages::clip(gpu, &liquid.buffers, on_device)?,
            move_solid: stages::wet_bodies(gpu, fields, &liquid.solver, buffers)?,
            closed_components: Seal::new(gpu, &liquid.solver, nodes, buffers)?,
            scheme,
            filled_cavities,
            separated_flux: stages::separated_flux(gpu, &liquid.buffers, &liquid.solver, buffers, &fields.velocity)?,
            diagnose: stages::diagnose_coupling(gpu, &liquid.solver, buffers, correction)?,
            patch_pressure,
        })
    }
}

/// Result of a solve in which solids touch each other.
struct SolvedInRows {
    outcome: CoupledOutcome,
    contact: ContactReport,
    /// See [`Solved::pushed`].
    pushed: Option<Vec<f64>>,
}

/// Solves under the rows of solids that touch each other, with separation in rounds. The recording starts the solve. `displacement` of all nodes, m.
fn solve_in_rows(
    (gpu, recorder): (&Gpu, Recorder),
    together: &CoupledSolver,
    (at, polynomial): (CoupledFields, Polynomial),
    (contacts, solids, displacement): (&GpuContacts, &GpuSolids, &[[f64; 3]]),
    rounds: Option<&mut Rounds>,
) -> Result<(SolvedInRows, StageTimes), Error> {
    let dx = solids.buffers.plan.grid.dx;
    let mut last = Vec::new();
    let mut rows = |velocity: &[f64], known: &[Row]| {
        velocity.clone_into(&mut last);
        Ok(contacts.touching(&solids.solids, dx, displacement, |touching| touching.rows(velocity, known)))
    };
    let (form, recorder, mut times) = together.prepare(gpu, recorder, at, &polynomial)?;
    let mut solves = RowSolves::new(together, form);
    let mut contact = ContactReport::default();
    let mut iterations = 0;
    let limits = RowLimits { meetings: MOST_MEETINGS, sets: MOST_COUPLED };
    let mut solve = |recorder, aim: Option<Aim>| {
        let (outcome, report, mut seconds) = solves.solve(gpu, recorder, aim, (&mut rows, limits))?;
        times.append(&mut seconds);
        contact = ContactReport { solves: contact.solves + report.solves, ..report };
        let outcome = outcome.after(iterations);
        iterations = outcome.parts[0].iterations;
        Ok::<_, Error>(outcome)
    };
    let outcome = match rounds {
        None => solve(recorder, None)?,
        Some(rounds) => {
            let (outcome, restoring) = rounds.search(recorder, |recorder, round, _| {
                let aim = Aim { tolerance: round.tolerance, guess: round.number > 1 };
                Ok((solve(recorder, Some(aim))?, false))
            })?;
            restoring.submit();
            outcome
        }
    };
    contacts.touching(&solids.solids, dx, displacement, |touching| touching.shorten(&last, &mut contact));
    Ok((SolvedInRows { outcome, contact, pushed: solves.pushed() }, times))
}

/// Result of a solve. `separation`: status and report of the rounds, for the liquid.
fn settled(
    liquid: &mut GpuLiquid,
    (outcome, closed_components): (CoupledOutcome, u32),
    separation: Option<(SolveStatus, SeparationReport)>,
    contact: ContactReport,
) -> Solved {
    let CoupledOutcome { mut parts, condensed } = outcome;
    parts[0].closed_components = closed_components;
    if let Some((status, report)) = separation {
        parts[0].status = status;
        liquid.n_separated = report.cells;
        liquid.separation = Some(report);
    }
    Solved { parts, condensed, contact, pushed: None }
}

/// Fields of the coupled solve.
fn coupled<'a>(
    (liquid, solver): (&'a LiquidBuffers, &'a SolverBuffers),
    solids: &'a GpuSolids,
    coupling: &'a CouplingBuffers,
) -> CoupledFields<'a> {
    CoupledFields {
        liquid: solver,
        solids: &solids.system,
        fields: &solids.buffers,
        coupling,
        velocity: &liquid.velocity_next,
        open: liquid.solve_open(),
    }
}

impl GpuCoupling {
    /// Allocates and compiles, including the liquid stages that depend on the clipping. The state must be written
    /// afterwards.
    pub(super) fn new(
        gpu: &Gpu,
        scene: &Scene,
        clip: SolidClip,
        liquid: &mut GpuLiquid,
        solids: &GpuSolids,
    ) -> Result<GpuCoupling, Error> {
        let grid = scene.grid();
        let capacity = Capacity::for_clip(&grid, &clip, 0);
        let on_device = ClipBuffers::new(gpu, &grid, capacity.clip)?;
        let (liquid_system, solid_system) = (&liquid.solver, &solids.system);
        let buffers = CouplingBuffers::new(gpu, liquid_system, solid_system, capacity.coupling)?;
        let weak = scene.solver.coupling == CouplingScheme::Weak;
        let weak = weak.then(|| WeakBuffers::new(gpu, solid_system));
        let weak = weak.transpose()?;
        let cavities = Cavities::in_liquid(scene, &solids.solids);
        let with = (&on_device, &buffers, &cavities);
        let stages = CouplingStages::new(gpu, scene, liquid, solids, with, weak.as_ref())?;
        // Four numbers per node.
        let words = buffers.partials.real.bytes() * solids.buffers.plan.n_nodes;
        let probed = probed(scene).into_iter();
        let probed = probed.map(|label| Readback::new(gpu, label, words));
        let coupling = GpuCoupling {
            probed: probed.collect::<Result<_, _>>()?,
            moved: Readback::new(gpu, "coupling.displacement", 2 * solids.buffers.plan.n_nodes)?,
            clip,
            cavities,
            cavity_volumes: Vec::new(),
            capacity,
            on_device,
            buffers,
            weak,
            damping_only: scene.solver.coupling == CouplingScheme::DampingOnly,
            stages,
        };
        coupling.bind_liquid(gpu, liquid, solids)?;
        Ok(coupling)
    }

    /// Allocates the readbacks of a sub-step.
    pub(super) fn readbacks(&self, gpu: &Gpu) -> Result<CouplingReadbacks, Error> {
        let cavities = self.stages.filled_cavities.as_ref();
        let cavities = cavities.map(|cavities| Readback::new(gpu, "coupling.cavities", cavities.words().len()));
        Ok(CouplingReadbacks {
            cavities: cavities.transpose()?,
            report: Readback::new(gpu, "coupling.report", REPORT_WORDS)?,
            components: Readback::new(gpu, "coupling.components", 1)?,
        })
    }

    /// Binds the liquid stages that depend on the clipping.
    fn bind_liquid(&self, gpu: &Gpu, liquid: &mut GpuLiquid, solids: &GpuSolids) -> Result<(), Error> {
        let GpuLiquid { buffers, solver, stages: liquid_stages, .. } = liquid;
        let velocity = &solids.buffers.velocity;
        let walls = Some((&self.on_device, Some(velocity)));
        let fluxes = Some((&self.on_device, &self.buffers, velocity));
        liquid_stages.beside_bodies = vec![
            stages::extrapolate(gpu, buffers, walls)?,
            stages::diagnose(gpu, (buffers, liquid.level.as_ref()), solver, fluxes)?,
        ];
        Ok(())
    }

    /// Forces of the liquid on the nodes in the last sub-step, N. Empty without force probes.
    pub(super) fn probed(&mut self, gpu: &Gpu) -> Result<Vec<[f64; 3]>, Error> {
        let cell_forces = &self.buffers.partials;
        let within = self.stages.patch_pressure.as_ref();
        let buffers = [cell_forces].into_iter().chain(within.map(|p| &p.correction));
        let mut to = Recorder::new(gpu);
        for (buffer, readback) in buffers.zip(&mut self.probed) {
            to.read_part(&buffer.words, 0, readback);
        }
        to.submit();
        let mut sums = Vec::new();
        for readback in &mut self.probed {
            let forces = cell_forces.widen(&readback.wait(gpu)?);
            let (nodes, _) = forces.as_chunks::<4>();
            sums.resize(nodes.len(), [0.0; 3]);
            for (sum, force) in sums.iter_mut().zip(nodes) {
                *sum = std::array::from_fn(|axis| sum[axis] + force[axis]);
            }
        }
        Ok(sums)
    }

    /// Clips the present solids and writes the clipping and J, before all work submitted later. `displacement` of all
    /// nodes in m, `cavity_volume` of the state.
    ///
    /// # Errors
    /// [`Error::Limit`] when a larger capacity exceeds the adapter's limits.
    pub(super) fn update_clip(
        &mut self,
        gpu: &Gpu,
        scene: &Scene,
        (liquid, solids): (&mut GpuLiquid, &GpuSolids),
        (displacement, cavity_volume): (&[[f64; 3]], &[f64]),
        at: ClipTime,
    ) -> Result<(), Error> {
        let grid = scene.grid();
        let (time, span) = match at {
            ClipTime::State { time } => (time, 0.0),
            ClipTime::SubStep { time, dt, .. } => (time, dt),
        };
        self.clip.move_obstacles(time, span);
        self.clip.clip(&solids.solids.moved(displacement));
        let (pairs, cut) = (self.pairs(&grid), self.on_device.cut(&self.clip));
        if !(self.on_device.fits(&cut) && self.buffers.fits(&pairs)) {
            let capacity = Capacity::for_clip(&grid, &self.clip, self.on_device.n_differing());
            self.capacity = self.capacity.joined(capacity);
            let (liquid_system, solid_system) = (&liquid.solver, &solids.system);
            self.on_device = self.on_device.resized(gpu, self.capacity.clip)?;
            self.buffers = CouplingBuffers::new(gpu, liquid_system, solid_system, self.capacity.coupling)?;
            let with = (&self.on_device, &self.buffers, &self.cavities);
            let weak = self.weak.as_ref();
            self.stages = CouplingStages::new(gpu, scene, liquid, solids, with, weak)?;
            self.bind_liquid(gpu, liquid, solids)?;
        }
        let triangles = &solids.solids.triangles;
        let density = liquid.settings.density;
        // Before a sub-step only the pairs are used, not the mass rate of a cell.
        let dt = if span > 0.0 { span } else { 1.0 };
        self.buffers.write(gpu, &pairs, density * grid.dx.powi(3) / dt)?;
        let ClipTime::SubStep { dt_last, .. } = at else {
            liquid.buffers.write_cut_cells(gpu, self.clip.cut_cells());
            self.on_device.write(gpu, (&self.clip, cut), triangles, true);
            return Ok(());
        };
        self.on_device.write(gpu, (&self.clip, cut), triangles, false);
        if let Some(cavities) = &self.stages.filled_cavities {
            self.cavity_volumes = self.cavities.volumes(&solids.solids, displacement);
            let targets = cavity_volume.iter().copied().chain(std::iter::repeat(0.0));
            let pairs = self.cavity_volumes.iter().zip(targets);
            let pairs =
                pairs.map(|(&volume, target)| (FILLS.map(|part| part * volume), cavity_source(target, volume, span)));
            cavities.write(gpu, pairs, grid.cell_volume());
        }
        self.write_patches(gpu, scene, (liquid, solids), &pairs, dt_last);
        Ok(())
    }

    /// Writes the integrals over the patches, before all work submitted later: also again before a solve that is repeated, since those of cells that separated
    /// are 0. `pairs`: those of the present clipping; `dt_last`: length of the last sub-step, s; 0 before the first.
    pub(super) fn write_patches(
        &mut self,
        gpu: &Gpu,
        scene: &Scene,
        (liquid, solids): (&GpuLiquid, &GpuSolids),
        pairs: &[Pair],
        dt_last: f64,
    ) {
        if self.stages.patch_pressure.is_none() {
            return;
        }
        let (grid, density) = (scene.grid(), liquid.settings.density);
        let moments = self.moments(&grid, &solids.solids.triangles);
        let scale = if dt_last > 0.0 { density / dt_last } else { 0.0 };
        let at_rest = slopes(scene, liquid).0;
        if let Some(patch_pressure) = &mut self.stages.patch_pressure {
            patch_pressure.write(gpu, pairs, &moments, (at_rest, scale));
        }
    }

    /// Whether patches use the last pressure.
    pub(super) fn follows_pressure(&self) -> bool {
        let patches = self.stages.patch_pressure.as_ref();
        patches.is_some_and(|patches| patches.follows_pressure())
    }

    /// Writes the pressure of a state, if patches use the last pressure.
    pub(super) fn write_pressure(&self, gpu: &Gpu, scene: &Scene, state: &State, liquid: Option<&GpuLiquid>) {
        let Some(liquid) = liquid.filter(|_| self.follows_pressure()) else {
            return;
        };
        let grid = scene.grid();
        let padded = grid.padded();
        let to_potential = state.dt_last / (liquid.settings.density * grid.dx);
        let potential = padded.pad(grid.cells, &state.pressure, |p| to_potential * p);
        liquid.solver.potential.upload(gpu, &potential);
    }

    /// J in device units.
    pub(super) fn pairs(&self, grid: &Grid) -> Vec<Pair> {
        Pair::all(self.clip.coupling(), grid)
    }

    /// Integrals of n N_i (x - x_cell)^T over the patches of each pair, m^3.
    fn moments(&self, grid: &Grid, triangles: &[[u32; 3]]) -> Vec<DMat3> {
        let patches = self.clip.patches();
        let coupling = self.clip.coupling();
        coupling.sums(DMat3::ZERO, patches, triangles, |patch, corner| {
            let offset = patch.centroid - grid.cell_centre(grid.cell_at(patch.cell));
            let weighted = patch.barycentric[corner] * patch.area * offset + patch.moments[corner];
            let column = |axis: usize| weighted[axis] * patch.normal;
            DMat3::from_cols(column(0), column(1), column(2))
        })
    }

    /// Records the copy of the velocities before the sub-step, for weak coupling.
    pub(super) fn record_before(&self, to: &mut Recorder, solids: &GpuSolids) {
        if let Some(weak) = &self.weak {
            weak.record(to, &solids.buffers);
        }
    }

    /// Records the flux of prescribed nodes into enclosed components, or of all nodes in weak coupling.
    pub(super) fn record_close(&self, pass: &mut Pass) {
        if let Scheme::Weak(weak) = &self.stages.scheme {
            weak.record_against(pass);
        }
        self.stages.closed_components.record_close(pass);
    }

    /// Records, in weak coupling, the pressure forces on the right-hand side of the solids.
    pub(super) fn record_push(&self, to: &mut Recorder) {
        if let Scheme::Weak(weak) = &self.stages.scheme {
            to.stage(Stage::Solve.name(), |pass| weak.record_push(pass));
        }
    }

    /// Records the gradients of the last pressure, if patches use it.
    pub(super) fn record_slopes(&self, to: &mut Recorder) {
        let patches = self.stages.patch_pressure.as_ref();
        if let Some(patches) = patches.filter(|patches| patches.follows_pressure()) {
            to.stage(Stage::Clip.name(), |pass| patches.record_slopes(pass));
        }
    }

    /// Submits the recording, which ends with both systems assembled, and reads back the contact of liquid and
    /// solids. Not for weak coupling. Cavities that liquid fills for the first time get the target `cavity_volume`.
    pub(super) fn touch(
        &self,
        gpu: &Gpu,
        liquid: &GpuLiquid,
        mut to: Recorder,
        readbacks: &mut CouplingReadbacks,
        cavity_volume: &mut Vec<f64>,
    ) -> Result<(ContactState, StageTimes), Error> {
        to.read(&self.buffers.report, &mut readbacks.report);
        to.read(&liquid.solver.components, &mut readbacks.components);
        // The words are read back until each cavity has a target.
        cavity_volume.resize(self.cavities.len(), 0.0);
        let cavities = self.stages.filled_cavities.as_ref().filter(|_| cavity_volume.contains(&0.0));
        let cavities = cavities.zip(readbacks.cavities.as_mut());
        let cavities = cavities.map(|(cavities, readback)| {
            to.read(cavities.words(), readback);
            readback
        });
        let timing = to.submit();
        if let Some(readback) = cavities {
            let words = readback.wait(gpu)?;
            let targets = cavity_volume.iter_mut().zip(&self.cavity_volumes).zip(FilledCavities::filled(&words));
            let first = targets.filter(|((target, _), filled)| *filled && **target == 0.0);
            first.for_each(|((target, volume), _)| *target = *volume);
        }
        let report = fields::CouplingReport::from_words(&readbacks.report.wait(gpu)?);
        let closed_components = readbacks.components.wait(gpu)?[0];
        let touch = ContactState { touching: report.touching, closed_components };
        Ok((touch, timing.wait()?))
    }

    /// Solves for liquid and solids in a sub-step of dt (s) until the active set of contacts is unchanged, and in each
    /// the set of separated cells.
    /// Damping-only coupling first solves for the solids without damping, then for both without elasticity. `displacement` of all
    /// nodes, m.
    pub(super) fn solve_in_contact(
        &self,
        gpu: &Gpu,
        together: &CoupledSolver,
        (liquid, solids): (&mut GpuLiquid, &GpuSolids),
        SolidReadbacks { answer, .. }: &mut SolidReadbacks,
        (step, dt): (SolidStep, f64),
        (touch, displacement): (ContactState, &[[f64; 3]]),
    ) -> Result<(Solved, StageTimes), Error> {
        let CouplingStages { closed_components, separated_flux, patch_pressure, .. } = &self.stages;
        let with = (Some(closed_components), separated_flux.as_ref(), patch_pressure.as_ref(), together.tolerance());
        let (LiquidSolve { buffers, solver, .. }, mut rounds) = liquid.rounds(gpu, dt, with);
        let at = coupled((buffers, solver), solids, &self.buffers);
        let mut recorder = Recorder::timed(gpu);
        if let Some(rounds) = &rounds {
            rounds.record_start(&mut recorder);
        }
        if let Some(contacts) = &solids.contacts {
            let touching = (contacts, solids, displacement);
            let (SolvedInRows { outcome, contact, pushed }, times) =
                solve_in_rows((gpu, recorder), together, (at, solids.polynomial(dt)), touching, rounds.as_mut())?;
            let separation = rounds.map(|rounds| (rounds.status(outcome.parts[0].status), rounds.report));
            let solved = settled(liquid, (outcome, touch.closed_components), separation, contact);
            return Ok((Solved { pushed, ..solved }, times));
        }
        let mut before = None;
        let mut times = StageTimes::new();
        if self.damping_only {
            let undamped = SolidStep { damped: 0.0, ..step };
            solids.record_other_system(gpu, &mut recorder, undamped, false);
            let polynomial = solids.polynomial_for(|_| [1.0 / dt, dt]);
            let (outcome, contact, mut seconds) = solids.solve_in_contact(gpu, recorder, answer, &polynomial)?;
            times.append(&mut seconds);
            before = Some((outcome.status, contact));
            recorder = Recorder::timed(gpu);
            let inelastic = SolidStep { elastic: 0.0, ..step };
            solids.record_other_system(gpu, &mut recorder, inelastic, true);
        }
        let polynomial = match self.damping_only {
            true => solids.polynomial_for(|body| [1.0 / dt + body.mass_damping, body.stiffness_damping]),
            false => solids.polynomial(dt),
        };
        let mut iterations = 0;
        let solve = |recorder, solves| {
            let again = solves > 0;
            let (outcome, times) = match &mut rounds {
                None => together.solve(gpu, recorder, at, &polynomial, again)?,
                Some(rounds) => {
                    let (form, recorder, mut times) = together.prepare(gpu, recorder, at, &polynomial)?;
                    let mut before = 0;
                    let (outcome, restoring) = rounds.search(recorder, |recorder, round, update| {
                        let guess = round.number > 1;
                        let aim = Aim { tolerance: round.tolerance, guess };
                        let with = (again || guess, None);
                        let (outcome, mut seconds, updated) =
                            together.solve_form(gpu, recorder, &form, with, Some(aim), update)?;
                        times.append(&mut seconds);
                        let outcome = outcome.after(before);
                        before = outcome.parts[0].iterations;
                        Ok((outcome, updated))
                    })?;
                    restoring.submit();
                    (outcome, times)
                }
            };
            let outcome = outcome.after(iterations);
            iterations = outcome.parts[0].iterations;
            Ok((outcome, outcome.parts[0].status, times))
        };
        let n_nodes = solids.buffers.plan.n_nodes;
        let search = Search {
            search: together.search(),
            push: |pass: &mut Pass| together.record_push(pass, n_nodes),
            together: true,
        };
        let (mut outcome, mut contact, mut seconds) =
            solids.iterate_active_set(gpu, recorder, answer, solve, search)?;
        times.append(&mut seconds);
        if let Some((status, before)) = before {
            contact.solves += before.solves;
            contact.unsettled += before.unsettled;
            if status != SolveStatus::Converged {
                outcome.parts[1].status = status;
            }
        }
        let separation = rounds.map(|rounds| (rounds.status(outcome.parts[0].status), rounds.report));
        Ok((settled(liquid, (outcome, touch.closed_components), separation, contact), times))
    }

    pub(super) fn set_tolerance(&mut self, gpu: &Gpu, tolerance: f64) {
        if let Scheme::Together(solver) = &mut self.stages.scheme {
            solver.set_tolerance(gpu, tolerance);
        }
    }

    /// The coupled solver; `None` in weak coupling.
    pub(super) fn together(&self) -> Option<&CoupledSolver> {
        match &self.stages.scheme {
            Scheme::Together(solver) => Some(solver),
            Scheme::Weak(_) => None,
        }
    }

    /// Records the readbacks at the end of a sub-step.
    pub(super) fn record_report(&self, to: &mut Recorder, readbacks: &mut CouplingReadbacks) {
        self.stages.diagnose.record(to);
        to.read(&self.buffers.report, &mut readbacks.report);
    }

    /// Waits for all submitted work and reads the report.
    pub(super) fn read_report(&self, gpu: &Gpu) -> Result<fields::CouplingReport, Error> {
        let words = gpu.download(&self.buffers.report)?;
        Ok(fields::CouplingReport::from_words(&words))
    }

    /// Clears the report.
    pub(super) fn record_clear(&self, to: &mut Recorder) {
        to.clear(&self.buffers.report);
    }

    /// Decodes the report of a sub-step.
    pub(super) fn report(
        &self,
        gpu: &Gpu,
        readbacks: &mut CouplingReadbacks,
        condensed: bool,
    ) -> Result<CouplingReport, Error> {
        let report = fields::CouplingReport::from_words(&readbacks.report.wait(gpu)?);
        let overlap = self.clip.overlap();
        Ok(CouplingReport {
            touching: report.touching,
            condensed,
            force: report.force,
            correction: report.correction,
            overlap_cells: overlap.cells,
            overlap_depth: overlap.depth,
        })
    }
}
