//! The GPU path of a simulation: buffers, stages and solver of one scene on one device, and what the host keeps of its state.

use crate::Error;
use crate::effects::Effects;
use crate::geometry::{self, CutCells};
use crate::gpu::{AdapterChoice, CompactKernels, Gpu, Readback, Real};
use crate::grid::Grid;
use crate::reference::{self, TimeStep, time_step};
use crate::scene::Scene;
use crate::solver::{Components, PressureSolver, PressureSystem, SolverBuffers, Within};
use crate::stages::{
    Active, AdvectMarkers, AdvectVelocity, Band, Diagnose, Extrapolate, Forces, LiquidBuffers,
    LiquidDistance, LiquidPlan, Probe, Report, RightHandSide, Step, Volume, WriteBack,
};
use crate::state::State;

use super::{Clock, Plan};

/// A scene on the device.
#[derive(Debug)]
pub struct GpuPath {
    pub(super) gpu: Gpu,
    pub(super) scene: Scene,
    pub(super) grid: Grid,
    pub(super) cut: CutCells,
    /// Everything of the state but its fields, which are on the device.
    pub(super) head: State,
    pub(super) n_markers: usize,
    pub(super) max_speed: f64,
    pub(super) liquid: LiquidBuffers,
    pub(super) solver: SolverBuffers,
    pub(super) stages: Stages,
    /// Taken while a step runs.
    pub(super) report: Option<Readback<u32>>,
}

/// The kernels of a step, in its order. Those of an absent effect are absent.
#[derive(Debug)]
pub(super) struct Stages {
    pub(super) advect_markers: Option<AdvectMarkers>,
    pub(super) band: Band,
    pub(super) advect_velocity: AdvectVelocity,
    pub(super) forces: Forces,
    pub(super) liquid_distance: Option<LiquidDistance>,
    /// With a fixed surface, whose volume `liquid_distance` would have measured.
    pub(super) volume: Option<Volume>,
    pub(super) active_cells: PressureSystem,
    pub(super) closed_components: Components,
    pub(super) right_hand_side: RightHandSide,
    pub(super) solve: PressureSolver,
    pub(super) write_back: WriteBack,
    pub(super) extrapolate: Extrapolate,
    pub(super) diagnose: Diagnose,
    /// With its read-back.
    pub(super) probe: Option<(Probe, Readback<u32>)>,
}

/// What decides the sizes of all buffers of a scene on an adapter with or without f64.
pub(super) fn liquid_plan(scene: &Scene, n_markers: usize, f64: bool) -> LiquidPlan {
    LiquidPlan {
        grid: scene.grid(),
        effects: Effects::of(scene),
        n_markers,
        cfl: scene.time.cfl,
        real: if f64 { Real::F64 } else { Real::F32 },
    }
}

impl GpuPath {
    /// Opens the device, clips the obstacles, seeds the liquid, and uploads it.
    ///
    /// # Errors
    /// [`Error::Limit`] where the adapter is too small for the scene, and whatever geometry and device say.
    pub fn open(scene: &Scene, choice: &AdapterChoice) -> Result<GpuPath, Error> {
        let gpu = Gpu::new(choice)?;
        // Before the liquid is seeded, which may take long.
        Plan::new(scene, Some(gpu.report()))?.check(gpu.report())?;
        let grid = scene.grid();
        let cut = geometry::cut_cells(scene, &grid)?;
        let mut state = geometry::initial_state(scene, &grid, &cut)?;
        reference::prepare(scene, &grid, &cut, &mut state);
        GpuPath::new(scene, cut, state, gpu)
    }

    /// Uploads a prepared state.
    pub(super) fn new(
        scene: &Scene,
        cut: CutCells,
        state: State,
        gpu: Gpu,
    ) -> Result<GpuPath, Error> {
        let grid = scene.grid();
        let effects = Effects::of(scene);
        let plan = liquid_plan(scene, state.markers.len(), gpu.has_f64());
        let liquid = LiquidBuffers::new(&gpu, plan)?;
        let solver = SolverBuffers::new(&gpu, &grid, scene.solver.precision)?;
        let stages = Stages::new(&gpu, scene, &effects, &liquid, &solver)?;
        let report = Some(Readback::new(&gpu, "liquid.report", Report::WORDS)?);
        liquid.write_cut_cells(&gpu, &cut);
        let mut path = GpuPath {
            gpu,
            scene: scene.clone(),
            grid,
            cut,
            n_markers: 0,
            max_speed: 0.0,
            head: State::at_rest(&grid),
            liquid,
            solver,
            stages,
            report,
        };
        path.write_state(&state)?;
        Ok(path)
    }

    /// Replaces the state.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn write_state(&mut self, state: &State) -> Result<(), Error> {
        self.n_markers = state.markers.len();
        self.max_speed = reference::max_speed(&state.velocity);
        self.liquid.write_state(&self.gpu, state);
        self.head = State {
            velocity: Default::default(),
            markers: Vec::new(),
            pressure: Vec::new(),
            liquid_distance: Vec::new(),
            active: Vec::new(),
            displacement: Vec::new(),
            node_velocity: Vec::new(),
            ..*state
        };
        self.write_step(0.0);
        if self.stages.advect_markers.is_none() {
            // The liquid stays where it is, and so do the band and the volume.
            let mut recorder = crate::gpu::Recorder::new(&self.gpu);
            self.stages.band.record(&mut recorder);
            if let Some(volume) = &self.stages.volume {
                volume.record(&mut recorder);
            }
            recorder.submit();
        }
        self.gpu.wait("the initial state")
    }

    /// A host copy of the present moment.
    pub(super) fn state(&self) -> Result<State, Error> {
        let mut state = self.head.clone();
        self.liquid
            .read_state(&self.gpu, self.n_markers, &mut state)?;
        let padded = self.grid.padded();
        let flags = self.gpu.download(&self.solver.flags)?;
        let lane = |ix: usize| flags[ix / 4] >> (ix % 4) & 1 == 1;
        let active: Vec<bool> = (0..padded.len()).map(lane).collect();
        let mut potential = self.solver.potential.download(&self.gpu)?;
        for (potential, _) in potential
            .iter_mut()
            .zip(&active)
            .filter(|(_, active)| !**active)
        {
            *potential = 0.0;
        }
        let pascal = self.pressure_scale();
        state.pressure = padded.unpad(self.grid.cells, &potential, |potential| pascal * potential);
        state.active = padded.unpad(self.grid.cells, &active, |active| active);
        Ok(state)
    }

    /// The values of the scene's probes, all columns in order.
    pub(super) fn probes(&mut self) -> Result<Vec<f64>, Error> {
        let Some((probe, readback)) = &mut self.stages.probe else {
            return Ok(Vec::new());
        };
        let mut recorder = crate::gpu::Recorder::new(&self.gpu);
        probe.record(&mut recorder, &active(&self.solver));
        recorder.read(&probe.values, readback);
        recorder.submit();
        Ok(probe.columns(&readback.wait(&self.gpu)?))
    }

    /// Pa per m/s of potential: rho dx / dt.
    fn pressure_scale(&self) -> f64 {
        let density = self
            .scene
            .liquid
            .as_ref()
            .map_or(0.0, |liquid| liquid.density);
        if self.head.dt_last > 0.0 {
            density * self.grid.dx / self.head.dt_last
        } else {
            0.0
        }
    }

    /// The length of the next sub-step.
    pub fn next_time_step(&self) -> TimeStep {
        let Scene { time, domain, .. } = &self.scene;
        let fall = (domain.gravity.length() * self.grid.dx).sqrt();
        let left = self.head.time_left(time.frames_per_second);
        time_step(
            time,
            self.grid.dx,
            self.max_speed,
            fall,
            left,
            self.head.dt_last,
        )
    }

    /// Tells the kernels the length of the sub-step.
    pub(super) fn write_step(&self, dt: f64) {
        self.gpu.upload(&self.liquid.step, &[self.step_numbers(dt)]);
    }

    /// What the kernels know of a sub-step of dt (s).
    pub fn step_numbers(&self, dt: f64) -> Step {
        let Scene {
            time,
            domain,
            liquid,
            solver,
            ..
        } = &self.scene;
        Step {
            gravity: domain.gravity.as_vec3().to_array(),
            dt: dt as f32,
            size: self.grid.size().as_vec3().to_array(),
            dx: self.grid.dx as f32,
            inv_dx: (1.0 / self.grid.dx) as f32,
            frame: (1.0 / time.frames_per_second) as f32,
            volume_0: if self.liquid.plan.effects.volume_control {
                self.head.volume_0 as f32
            } else {
                0.0
            },
            density: liquid.as_ref().map_or(0.0, |liquid| liquid.density) as f32,
            marker_radius: liquid.as_ref().map_or(0.0, |liquid| liquid.marker_radius) as f32,
            theta_floor: solver.theta_floor as f32,
            n_markers: self.n_markers as u32,
            spare: 0,
        }
    }

    /// Whether a sub-step of this length ends a frame.
    pub(super) fn ends_frame(&self, dt: f64) -> bool {
        let mut after = self.head.clone();
        after.advance_clock(dt, self.scene.time.frames_per_second);
        after.frame > self.head.frame
    }

    /// The obstacles' cut cells.
    pub fn cut_cells(&self) -> &CutCells {
        &self.cut
    }

    /// How far the simulation is.
    pub fn clock(&self) -> Clock {
        Clock::of(&self.head)
    }

    /// Cells of the band of the last sub-step.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn band_cells(&self) -> Result<usize, Error> {
        let args = self.gpu.download(&self.liquid.band_args)?;
        Ok(4 * args[3] as usize)
    }

    /// Share of the active quads that are not tagged uniform: those whose matrix the solve must load.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn share_not_uniform(&self) -> Result<f64, Error> {
        let flags = self.gpu.download(&self.solver.flags)?;
        let active = flags[..self.grid.padded().quads]
            .iter()
            .filter(|&&flag| flag != 0);
        let (mut n_active, mut n_uniform) = (0u32, 0u32);
        for flag in active {
            n_active += 1;
            n_uniform += flag >> 31;
        }
        Ok(1.0 - f64::from(n_uniform) / f64::from(n_active.max(1)))
    }

    /// Bytes of a scalar of the solve's unknowns, and of its corrections.
    pub fn scalar_bytes(&self) -> [usize; 2] {
        let variant = self.solver.variant;
        [variant.real, variant.inner].map(Real::bytes)
    }

    /// The device.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }
}

impl Stages {
    fn new(
        gpu: &Gpu,
        scene: &Scene,
        effects: &Effects,
        liquid: &LiquidBuffers,
        solver: &SolverBuffers,
    ) -> Result<Stages, Error> {
        let active = active(solver);
        let compact = CompactKernels::new(gpu)?;
        let theta_floor = scene.solver.theta_floor;
        let active_cells = PressureSystem::new(
            gpu,
            solver,
            &liquid.open,
            &liquid.liquid_distance,
            within(liquid),
            theta_floor,
        )?;
        let solve = PressureSolver::new(
            gpu,
            solver,
            &liquid.velocity_next,
            &liquid.open,
            &scene.solver,
        )?;
        let probe = || {
            let kinds = scene.probes.iter().map(|probe| &probe.kind);
            let probe = Probe::new(gpu, liquid, &active, &solver.potential, kinds)?;
            let readback = Readback::new(gpu, "probe.values", probe.values.len())?;
            Ok::<_, Error>((probe, readback))
        };
        Ok(Stages {
            advect_markers: effects
                .markers
                .then(|| AdvectMarkers::new(gpu, liquid))
                .transpose()?,
            band: Band::new(gpu, &compact, liquid)?,
            advect_velocity: AdvectVelocity::new(gpu, liquid)?,
            forces: Forces::new(gpu, liquid)?,
            liquid_distance: effects
                .markers
                .then(|| LiquidDistance::new(gpu, liquid))
                .transpose()?,
            volume: (!effects.markers)
                .then(|| Volume::new(gpu, liquid))
                .transpose()?,
            active_cells,
            closed_components: Components::new(gpu, solver)?,
            right_hand_side: RightHandSide::new(gpu, liquid, &active, &solver.rhs)?,
            solve,
            write_back: WriteBack::new(gpu, liquid, &active, &solver.potential)?,
            extrapolate: Extrapolate::new(gpu, liquid)?,
            diagnose: Diagnose::new(gpu, liquid, &active)?,
            probe: effects.probes.then(probe).transpose()?,
        })
    }
}

/// Where the solver looks for liquid.
pub(super) fn within(liquid: &LiquidBuffers) -> Within<'_> {
    Within {
        list: &liquid.band_list,
        args: &liquid.band_args,
    }
}

/// The solver's lists as the stages read them.
pub(super) fn active(solver: &SolverBuffers) -> Active<'_> {
    Active {
        flags: &solver.flags,
        list: &solver.list,
        args: &solver.args,
    }
}
