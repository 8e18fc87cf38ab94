//! The GPU path of a simulation: one scene on one device, and the host's share of its state.

use glam::DVec3;

use crate::Error;
use crate::effects::Effects;
use crate::elastic::{Cavities, NodeReadback, Solids};
use crate::fields::Step;
use crate::geometry::{self, ContactField, CutCells, ObstacleCut, Running, SolidClip, SourcesAndSinks};
use crate::gpu::{AdapterChoice, Gpu};
use crate::grid::Grid;
use crate::reference::{self, StepLimits, TimeStep};
use crate::scene::Scene;
use crate::state::{Carried, State};
use crate::step::Stage;

use super::gpu_coupling::{ClipTime, GpuCoupling};
use super::gpu_liquid::GpuLiquid;
use super::gpu_obstacles::GpuObstacles;
use super::gpu_solids::GpuSolids;
use super::squeeze::SqueezeReadbacks;
use super::step::Readbacks;
use super::{Clock, HostMemory, Plan};

/// A scene on the device.
#[derive(Debug)]
pub struct GpuPath {
    pub(super) gpu: Gpu,
    pub(super) scene: Scene,
    pub(super) grid: Grid,
    /// Cut cells of the static obstacles.
    cut: CutCells,
    /// The clock of the state, whose fields are on the device.
    pub(super) head: State,
    pub(super) liquid: Option<GpuLiquid>,
    pub(super) solids: Option<GpuSolids>,
    /// With liquid and solids.
    pub(super) coupling: Option<GpuCoupling>,
    /// Moving obstacles in liquid, without solids.
    pub(super) obstacles: Option<GpuObstacles>,
    pub(super) readbacks: Readbacks,
    pub(super) limits: StepLimits,
}

/// Readbacks for the probes: liquid columns in order, and arrays of the nodes that the probes need.
pub(super) type Probed = (Vec<f64>, NodeReadback);

impl GpuPath {
    /// Opens the device, clips the obstacles, seeds the liquid, and uploads the state.
    ///
    /// # Errors
    /// [`Error::Limit`] when the scene exceeds the adapter's limits, and errors of geometry and device.
    pub fn open(scene: &Scene, choice: &AdapterChoice) -> Result<GpuPath, Error> {
        GpuPath::with(scene, &super::solids_of(scene)?, choice)
    }

    /// Opens the device for a scene with its solids.
    pub(super) fn with(scene: &Scene, solids: &Solids, choice: &AdapterChoice) -> Result<GpuPath, Error> {
        let gpu = Gpu::new(choice)?;
        let grid = scene.grid();
        let memory = HostMemory::new(scene, solids, false)?;
        memory.check()?;
        let obstacles = geometry::obstacle_cut(scene, &grid)?;
        let mut clip = super::first_clip(scene, solids, &obstacles);
        // Checks the sources and sinks before the liquid is seeded, which may take long.
        let mut taps = SourcesAndSinks::new(scene, &grid, obstacles.static_cut())?;
        let parts = (&mut clip, &mut taps);
        let plan = Plan::with(scene, solids, Some(&obstacles), parts, Some(gpu.report()))?;
        plan.check(gpu.report())?;
        memory.beside(plan.bytes(), gpu.report()).check()?;
        let mut state = super::first_state(scene, solids, &obstacles, clip.as_ref())?;
        let walls = clip.as_ref().map(|clip| (clip, &solids.triangles[..]));
        let cut = obstacles.static_cut().clone();
        let cut_now = clip.as_ref().map_or(&cut, SolidClip::cut_cells);
        reference::prepare(scene, &grid, cut_now, walls, &mut state)?;
        // A level starts with markers in its band alone; later all liquid may be there.
        let n_markers = match Effects::of(scene).level {
            true => plan.n_markers.max(state.markers.len()),
            false => state.markers.len(),
        };
        let mut path = GpuPath::allocate(gpu, scene, (solids, clip, taps), n_markers)?;
        if let Some(liquid) = &path.liquid {
            liquid.buffers.write_cut_cells(&path.gpu, &cut);
        }
        if let Some(solids) = &mut path.solids {
            solids.write_obstacles(&path.gpu, &obstacles);
        }
        path.limits = StepLimits::new(scene, obstacles.accelerations(), Some(solids));
        path.cut = cut;
        path.write_state(&state)?;
        Ok(path)
    }

    /// The geometry that [`GpuPath::allocate`] was given.
    pub(super) fn into_geometry(self) -> (Option<SolidClip>, SourcesAndSinks) {
        let coupling = self.coupling.map(|coupling| coupling.clip);
        let clip = coupling.or(self.obstacles.map(|obstacles| obstacles.clip));
        let taps = self.liquid.map(|liquid| liquid.taps);
        (clip, taps.unwrap_or_default())
    }

    /// Allocates all arrays and compiles all kernels; on a planning device this is the plan. Obstacles and state must
    /// be written afterwards.
    pub(super) fn allocate(
        gpu: Gpu,
        scene: &Scene,
        (solids, clip, taps): (&Solids, Option<SolidClip>, SourcesAndSinks),
        n_markers: usize,
    ) -> Result<GpuPath, Error> {
        // Stages use handles of their own; all other kernels belong to the solve.
        let gpu = gpu.at(Stage::Solve.name());
        let obstacles = clip.as_ref().map(SolidClip::obstacles);
        let obstacles = obstacles.map_or(Vec::new(), ObstacleCut::accelerations);
        let limits = StepLimits::new(scene, obstacles, Some(solids));
        let mut liquid = GpuLiquid::new(&gpu, scene, taps, n_markers)?;
        let solids = match solids.bodies.is_empty() {
            true => None,
            false => Some(GpuSolids::new(&gpu, scene, solids.clone())?),
        };
        let (mut coupling, mut moving) = (None, None);
        if let Some((liquid, clip)) = liquid.as_mut().zip(clip) {
            match &solids {
                Some(solids) => {
                    coupling = Some(GpuCoupling::new(&gpu, scene, clip, liquid, solids)?);
                }
                None => moving = Some(GpuObstacles::new(&gpu, clip, liquid)?),
            }
        }
        let solid_readbacks = || GpuSolids::readbacks(&gpu);
        let coupling_readbacks = |coupling: &GpuCoupling| coupling.readbacks(&gpu);
        let readbacks = Readbacks {
            solids: solids.as_ref().map(|_| solid_readbacks()).transpose()?,
            coupling: coupling.as_ref().map(coupling_readbacks).transpose()?,
            liquid: GpuLiquid::readback(&gpu, scene)?,
            squeeze: SqueezeReadbacks::at_start(&gpu, scene, solids.as_ref())?,
        };
        Ok(GpuPath {
            gpu,
            scene: scene.clone(),
            grid: scene.grid(),
            cut: CutCells::default(),
            head: State::default(),
            liquid,
            solids,
            coupling,
            obstacles: moving,
            readbacks,
            limits,
        })
    }

    /// Writes a state.
    ///
    /// # Errors
    /// [`Error::Input`] when its markers exceed the capacity.
    pub fn write_state(&mut self, state: &State) -> Result<(), Error> {
        if let Some(room) = self.marker_room().filter(|room| *room < state.markers.len()) {
            return Err(Error::input(
                self.scene.file.display().to_string(),
                format!("the state has {} markers, more than the capacity of {room}", state.markers.len()),
                "resume with the original scene",
            ));
        }
        self.head = State {
            time: state.time,
            step: state.step,
            frame: state.frame,
            dt_last: state.dt_last,
            contact_step: state.contact_step,
            cavity_volume: state.cavity_volume.clone(),
            sources_running: state.sources_running,
            ..State::default()
        };
        if let Some(coupling) = &mut self.coupling {
            let both = self.liquid.as_mut().zip(self.solids.as_ref());
            let both = both.expect("coupling has liquid and solids");
            let time = ClipTime::State { time: state.time };
            let solids = (&*state.displacement, &*state.cavity_volume);
            coupling.update_clip(&self.gpu, &self.scene, both, solids, time)?;
            coupling.write_pressure(&self.gpu, &self.scene, state, self.liquid.as_ref());
        }
        if let Some((obstacles, liquid)) = self.obstacles.as_mut().zip(self.liquid.as_mut()) {
            obstacles.write(&self.gpu, liquid, state.time)?;
        }
        if let Some(liquid) = &mut self.liquid {
            let step = liquid.step_numbers(&self.scene, &self.head, TimeStep::NONE);
            liquid.write_state(&self.gpu, state, step);
        }
        if let Some(solids) = &mut self.solids {
            solids.write_state(&self.gpu, state);
        }
        self.gpu.wait("the initial state")
    }

    /// Reads back the state.
    pub(super) fn state(&self) -> Result<State, Error> {
        let mut state = self.head.clone();
        if let Some(liquid) = &self.liquid {
            liquid.read_state(&self.gpu, &self.grid, self.head.dt_last, &mut state)?;
        }
        if let Some(solids) = &self.solids {
            solids.buffers.read_state(&self.gpu, &mut state)?;
        }
        Ok(state)
    }

    /// Data of the device and the host beyond [`GpuPath::state`], needed to resume.
    pub(super) fn carried(&self) -> Result<Carried, Error> {
        let mut carried = Carried::default();
        if let Some(liquid) = &self.liquid {
            carried.max_speed[0] = liquid.max_speed;
            if self.follows_pressure() {
                carried.potential = liquid.potential(&self.gpu, &self.grid)?;
            }
        }
        if let Some(solids) = &self.solids {
            solids.carry(&self.gpu, &mut carried)?;
        }
        Ok(carried)
    }

    fn follows_pressure(&self) -> bool {
        let coupling = self.coupling.as_ref();
        coupling.is_some_and(GpuCoupling::follows_pressure)
    }

    /// Writes a state and its carried data; the next sub-steps are bitwise identical to those after the original.
    ///
    /// # Errors
    /// [`Error::Input`] when the state does not fit the scene.
    pub fn resume(&mut self, state: &State, carried: &Carried) -> Result<(), Error> {
        let n_cells = self.grid.n_cells();
        let n_markers = self.liquid.as_ref().map_or(0, |liquid| liquid.room());
        let plan = self.solids.as_ref().map(|solids| &solids.buffers.plan);
        let n_nodes = plan.map_or(0, |plan| plan.n_nodes);
        let n_scripted = plan.map_or(0, |plan| if plan.scripts { plan.n_nodes } else { 0 });
        let follows = if self.follows_pressure() { n_cells } else { 0 };
        let level = Effects::of(&self.scene).level;
        let fits = state.markers.len() <= n_markers
            && (!level || state.fits_level(&self.grid))
            && carried.potential.len() == follows
            && carried.displacement_high.len() == n_nodes
            && carried.displacement_low.len() == n_nodes
            && carried.scripted_displacement.len() == n_scripted
            && carried.scripted_velocity.len() == n_scripted;
        if !fits {
            return Err(super::unfit(&self.scene));
        }
        self.write_state(state)?;
        if let Some(liquid) = &mut self.liquid {
            liquid.max_speed = carried.max_speed[0];
            if follows > 0 {
                let padded = self.grid.padded();
                let potential = padded.pad(self.grid.cells, &carried.potential, |p| p);
                liquid.solver.potential.upload(&self.gpu, &potential);
            }
        }
        if let Some(solids) = &mut self.solids {
            solids.resume(&self.gpu, carried);
        }
        Ok(())
    }

    /// Copies gravity and the keyframes of obstacles and scripts from a scene that is the same otherwise.
    pub(super) fn follow(&mut self, scene: &Scene) {
        let coupling = self.coupling.as_mut().map(|coupling| &mut coupling.clip);
        let obstacles = self.obstacles.as_mut().map(|obstacles| &mut obstacles.clip);
        if let Some(clip) = coupling.or(obstacles) {
            clip.follow(scene);
        }
        if let Some(solids) = &mut self.solids {
            solids.follow(scene);
        }
        // Of `set_tolerance`.
        let solver = self.scene.solver;
        self.scene = scene.clone();
        self.scene.solver = solver;
        let pushing = self.solids.as_ref().and_then(GpuSolids::moving);
        let obstacles = match (pushing, self.clip()) {
            (Some(field), _) => field.accelerations(),
            (None, Some(clip)) => clip.obstacles().accelerations(),
            (None, None) => Vec::new(),
        };
        self.limits = StepLimits::new(scene, obstacles, self.solids());
    }

    /// Reads back the input of the probes after a sub-step.
    pub(super) fn probed(&mut self) -> Result<Probed, Error> {
        let values = match &mut self.liquid {
            Some(liquid) => liquid.probes(&self.gpu)?,
            None => Vec::new(),
        };
        let [displacement, velocity] = match &mut self.solids {
            Some(solids) => solids.probed(&self.gpu)?,
            None => Default::default(),
        };
        let forces = match &mut self.coupling {
            Some(coupling) => coupling.probed(&self.gpu)?,
            None => Vec::new(),
        };
        let nodes = NodeReadback { displacement, velocity, forces, time: self.head.time, dt: self.head.dt_last };
        Ok((values, nodes))
    }

    /// Displacements of all nodes, m; empty without solids.
    pub(super) fn displacement(&self) -> Result<Vec<[f64; 3]>, Error> {
        let of = |solids: &GpuSolids| solids.displacement(&self.gpu);
        Ok(self.solids.as_ref().map(of).transpose()?.unwrap_or_default())
    }

    /// The length of the next sub-step.
    pub fn next_time_step(&self) -> TimeStep {
        let time = &self.scene.time;
        let left = self.head.time_left(time.frames_per_second);
        let liquid = self.liquid.iter().map(|liquid| liquid.max_speed);
        let solids = self.solids.iter().map(|solids| solids.max_speed);
        let obstacles = self.clip().map(SolidClip::obstacles);
        let obstacles = obstacles.map(|cut| cut.max_speed(self.head.time, left));
        let pushing = self.solids.iter();
        let pushing = pushing.map(|solids| solids.obstacle_speed(self.head.time, left));
        let sources = self.liquid.iter();
        let sources = sources.map(|liquid| liquid.taps.speed(self.head.time, [self.head.dt_last, left], time.cfl));
        // Later keyframes of scripts are included in the velocities of their nodes.
        let scripts = self.solids.iter().filter(|_| self.head.step == 0);
        let scripts = scripts.map(|of| of.solids.max_script_speed(self.head.time, left));
        let max_speed = liquid.chain(solids).chain(obstacles);
        let max_speed = max_speed.chain(sources).chain(scripts).chain(pushing);
        let max_speed = max_speed.fold(0.0, f64::max);
        let times = [self.head.time, left];
        self.limits.time_step(max_speed, times, self.head.last_limits())
    }

    /// Writes the parameters of a sub-step.
    pub(super) fn write_step(&mut self, time_step: TimeStep) -> Result<(), Error> {
        self.scene.domain.gravity = self.gravity(time_step);
        if let Some(liquid) = &mut self.liquid {
            liquid.begin(&self.gpu, &self.head, time_step)?;
            let step = liquid.step_numbers(&self.scene, &self.head, time_step);
            self.gpu.upload(&liquid.buffers.step, &[step]);
        }
        if let Some(solids) = &mut self.solids {
            solids.write_step(&self.gpu, &self.scene, &self.head, time_step.dt)?;
        }
        Ok(())
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Mean gravity of the next sub-step, m/s^2.
    pub fn gravity(&self, time_step: TimeStep) -> DVec3 {
        let time = self.head.time;
        self.scene.domain.mean_gravity([time, time + time_step.dt])
    }

    /// Parameters of the liquid for a sub-step; `None` without liquid.
    pub fn step_numbers(&self, time_step: TimeStep) -> Option<Step> {
        let liquid = self.liquid.as_ref()?;
        Some(liquid.step_numbers(&self.scene, &self.head, time_step))
    }

    /// The solids at rest; `None` without solids.
    pub fn solids(&self) -> Option<&Solids> {
        self.solids.as_ref().map(|solids| &solids.solids)
    }

    /// The cavities in liquid, and their targets before the solve, m^3.
    pub fn cavities(&self) -> Option<(&Cavities, &[f64])> {
        self.coupling.as_ref().map(|coupling| (&coupling.cavities, &*self.head.cavity_volume))
    }

    /// Sources and sinks, and the running sources of the next sub-step.
    pub fn taps(&self) -> Option<(&SourcesAndSinks, Running)> {
        let liquid = self.liquid.as_ref()?;
        Some((&liquid.taps, liquid.running_after(&self.head)))
    }

    /// Capacity for markers; `None` without markers.
    pub fn marker_room(&self) -> Option<usize> {
        let markers = self.liquid.as_ref()?.buffers.markers.as_ref()?;
        Some(markers.len())
    }

    /// Cut cells of obstacles, and of solids in liquid.
    pub fn cut_cells(&self) -> &CutCells {
        self.clip().map_or(&self.cut, SolidClip::cut_cells)
    }

    /// Replaces [`State::contact_step`], s.
    pub(super) fn limit_step(&mut self, longest: f64) {
        self.head.contact_step = longest;
    }

    /// The obstacles as the nodes of solids meet them.
    pub fn contact_field(&self) -> ContactField {
        let moving = self.solids.as_ref().and_then(GpuSolids::moving);
        let at_rest = || ContactField::at_rest(&self.scene.grid(), self.cut.solid_distance.clone());
        moving.cloned().unwrap_or_else(at_rest)
    }

    /// Clipping of solids in liquid and of moving obstacles.
    pub fn clip(&self) -> Option<&SolidClip> {
        let obstacles = self.obstacles.as_ref().map(|obstacles| &obstacles.clip);
        let coupling = self.coupling.as_ref().map(|coupling| &coupling.clip);
        coupling.or(obstacles)
    }

    /// Deletes dead markers where the next sub-step would, which moves the others to other slots. Returns whether it did.
    ///
    /// # Errors
    /// [`Error::Stage`] where sources have no markers left.
    pub fn make_room(&mut self) -> Result<bool, Error> {
        let step = self.clock().step;
        self.liquid.as_mut().map_or(Ok(false), |liquid| liquid.make_room(&self.gpu, step))
    }

    /// Time, sub-step and frame.
    pub fn clock(&self) -> Clock {
        Clock::of(&self.head)
    }

    /// Length of the last sub-step, s; 0 before the first.
    pub fn last_step(&self) -> f64 {
        self.head.dt_last
    }

    /// Number of cells in the narrow band of the last sub-step.
    pub fn band_cells(&self) -> Result<usize, Error> {
        let Some(liquid) = &self.liquid else {
            return Ok(0);
        };
        let args = self.gpu.download(&liquid.buffers.band_args)?;
        Ok(4 * args[3] as usize)
    }

    /// The grid.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Sets the tolerance of the true residuals from the next solve on.
    pub fn set_tolerance(&mut self, tolerance: f64) {
        self.scene.solver.tolerance = tolerance;
        if let Some(liquid) = &mut self.liquid {
            liquid.stages.solve.set_tolerance(&self.gpu, tolerance);
        }
        if let Some(solids) = &mut self.solids {
            solids.stages.solve.set_tolerance(&self.gpu, tolerance);
        }
        if let Some(coupling) = &mut self.coupling {
            coupling.set_tolerance(&self.gpu, tolerance);
        }
    }

    /// The device.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }
}
