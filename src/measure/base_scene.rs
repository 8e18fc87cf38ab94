//! The base scene on a device: both systems and J between them, for benches and tests of coupled solvers.

use crate::Error;
use crate::elastic::{Body, Bounds};
use crate::fields::{
    CouplingBuffers, CouplingSize, Pair, SolidBuffers, SolidPlan, SolidRows, SolidSystemBuffers, SolverBuffers, variant,
};
use crate::gpu::{Buffer, Dispatches, Gpu, Recorder};
use crate::grid::{Axis, Grid};
use crate::reference::CoupledSystem;
use crate::reference::base_block::{BaseBlock, DENSITY, THETA_FLOOR};
use crate::reference::base_scene::BaseScene;
use crate::scene::Solver;
use crate::solver::{CoupledFields, CoupledOutcome, CoupledSolver, Polynomial, SolidSystem};
use crate::stages::{Everywhere, PressureSystem, element_rotations};
use crate::state::State;
use crate::step::Stage;

/// The base scene and its two-field solver.
#[derive(Debug)]
pub struct DeviceScene<'a> {
    gpu: &'a Gpu,
    /// The cells.
    pub grid: Grid,
    /// s
    dt: f64,
    /// The liquid's system.
    pub liquid: SolverBuffers,
    everywhere: Everywhere,
    pressure: PressureSystem,
    /// E u* over dx^2, device layout, m/s.
    rhs: Vec<f64>,
    open: Buffer<f32>,
    velocity: Buffer<f32>,
    /// Read by the kernel of the active cells.
    _distance: Buffer<f32>,
    fields: SolidBuffers,
    solids: SolidSystemBuffers,
    rotations: Dispatches,
    system: SolidSystem,
    coupling: CouplingBuffers,
    /// The preconditioner of the solids, for the scene's step.
    pub polynomial: Polynomial,
    state: State,
    /// The solver.
    pub solver: CoupledSolver,
}

/// Face apertures, face velocities and liquid distance of the base block on a device.
///
/// # Errors
/// [`Error::Limit`] if the adapter is too small.
pub(super) fn block_fields(gpu: &Gpu, block: &BaseBlock, open: &[Vec<f64>; 3]) -> Result<[Buffer<f32>; 3], Error> {
    let (grid, padded) = (block.grid, block.grid.padded());
    let faces = |label, fields: &[Vec<f64>; 3]| {
        let values = Axis::ALL.map(|axis| padded.pad(grid.faces(axis), &fields[axis.index()], |value| value as f32));
        gpu.buffer_with(label, &values.concat())
    };
    let distance = padded.pad(grid.cells, &block.liquid_distance, |value| value as f32);
    Ok([
        faces("bench.open", open)?,
        faces("bench.velocity", &block.velocity)?,
        gpu.buffer_with("bench.liquid_distance", &distance)?,
    ])
}

impl<'a> DeviceScene<'a> {
    /// Uploads a scene, and J and E u* of its system.
    ///
    /// # Errors
    /// [`Error::Limit`] if the adapter is too small, or lacks f64 and the precision needs it.
    pub fn new(
        gpu: &'a Gpu,
        scene: &BaseScene,
        system: &CoupledSystem,
        solver: &Solver,
    ) -> Result<DeviceScene<'a>, Error> {
        let grid = scene.block.grid;
        let padded = grid.padded();
        let clip = scene.clip();
        let [open, velocity, distance] = block_fields(gpu, &scene.block, &clip.cut_cells().open)?;
        let liquid = SolverBuffers::new(gpu, &grid, solver.precision)?;
        let everywhere = Everywhere::new(gpu, &grid)?;
        let within = everywhere.within();
        let pressure = PressureSystem::new(gpu, &liquid, &open, &distance, within, THETA_FLOOR)?;
        let real = variant(gpu.has_f64(), solver.precision).real;
        let plan = SolidPlan::new(grid, &scene.solids, real);
        let fields = SolidBuffers::new(gpu, plan, &scene.solids)?;
        let solids = SolidSystemBuffers::new(gpu, &SolidRows::new(&scene.solids)?, solver)?;
        // v* of the scene includes gravity.
        gpu.upload(&fields.step, &[fields.step_of(glam::DVec3::ZERO, scene.dt)]);
        let area = grid.dx * grid.dx;
        let pairs = Pair::all(&system.coupling, &grid);
        let size = CouplingSize { quads: pairs.len(), pairs: pairs.len() };
        let mut coupling = CouplingBuffers::new(gpu, &liquid, &solids, size)?;
        coupling.write(gpu, &pairs, DENSITY * grid.dx.powi(3) / scene.dt)?;
        let zeta = |body: &Body| [body.zeta_mass(scene.dt), body.zeta_stiffness(scene.dt)];
        let bound = CoupledFields {
            liquid: &liquid,
            solids: &solids,
            fields: &fields,
            coupling: &coupling,
            velocity: &velocity,
            open: &open,
        };
        let two_field = CoupledSolver::new(gpu, bound, solver)?;
        let rhs: Vec<f64> = system.pressure.rhs.iter().map(|b| b / area).collect();
        Ok(DeviceScene {
            solver: two_field,
            rotations: element_rotations(gpu, &fields)?,
            system: SolidSystem::new(gpu, &solids, &fields, None)?,
            rhs: padded.pad(grid.cells, &rhs, |b| b),
            polynomial: Polynomial::for_solids(&Bounds::new(&scene.solids), &scene.solids, zeta),
            state: State {
                displacement: scene.displacement.clone(),
                node_velocity: scene.node_velocity.clone(),
                ..State::at_rest(&grid)
            },
            dt: scene.dt,
            _distance: distance,
            gpu,
            grid,
            liquid,
            everywhere,
            pressure,
            open,
            velocity,
            fields,
            solids,
            coupling,
        })
    }

    /// Arrays of the solver.
    pub fn fields(&self) -> CoupledFields<'_> {
        let DeviceScene { liquid, solids, fields, coupling, velocity, open, .. } = self;
        CoupledFields { liquid, solids, fields, coupling, velocity, open }
    }

    /// Writes u* and v*, which a solve replaces.
    pub fn reset(&self) {
        self.fields.write_state(self.gpu, &self.state);
        self.liquid.rhs.upload(self.gpu, &self.rhs);
    }

    /// Records the set-up of both systems.
    pub fn record_systems(&self) -> Recorder {
        let mut recorder = Recorder::new(self.gpu);
        let within = self.everywhere.within();
        recorder.stage(Stage::ActiveCells.name(), |pass| self.pressure.record(pass, &self.liquid, within));
        recorder.stage(Stage::SolidMatrices.name(), |pass| {
            self.rotations.record_in(pass);
            self.system.record_matrices(pass);
            self.system.record_right_hand_side(pass);
            self.system.record_contacts(pass);
        });
        recorder
    }

    /// Sets both systems up and solves them.
    pub fn solve(&self) -> Result<CoupledOutcome, Error> {
        let (recorder, fields) = (self.record_systems(), self.fields());
        let (outcome, _) = self.solver.solve(self.gpu, recorder, fields, &self.polynomial, false)?;
        Ok(outcome)
    }

    /// Pressures per cell, Pa, undefined in inactive cells, and velocities of the nodes, m/s.
    pub fn answer(&self) -> Result<(Vec<f64>, Vec<[f64; 3]>), Error> {
        let grid = &self.grid;
        let potential = self.liquid.potential.download(self.gpu)?;
        let to_pressure = DENSITY * grid.dx / self.dt;
        let pressure = grid.padded().unpad(grid.cells, &potential, |phi| to_pressure * phi);
        let mut state = self.state.clone();
        self.fields.read_state(self.gpu, &mut state)?;
        Ok((pressure, state.node_velocity))
    }
}
