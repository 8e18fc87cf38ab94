//! The simulation: a scene on the GPU or on the f64 CPU path, its sub-steps, and the run loop.

mod control;
mod gpu_contacts;
mod gpu_coupling;
mod gpu_liquid;
mod gpu_obstacles;
mod gpu_path;
mod gpu_solids;
mod health;
mod memory;
mod plan;
mod run;
mod separation;
mod snapshot;
mod squeeze;
mod step;
mod warnings;

pub use gpu_path::GpuPath;
pub use memory::{HostMemory, free_memory};
pub use plan::{Plan, StagePlan};
pub use run::{Options, Progress, Resumed, Summary, run};
pub use snapshot::{
    LevelSnapshot, LiquidSnapshot, Snapshot, SolidSnapshot, StoredPressure, coupled_system, stored_coupling,
};
pub use step::Observer;
pub use warnings::warnings;

use crate::Error;
use crate::effects::Effects;
use crate::elastic::{NodeReadback, Solids};
use crate::geometry::{self, ContactField, CutCells, ObstacleCut, SolidClip, SourceFlow};
use crate::gpu::{AdapterChoice, AdapterReport, Gpu};
use crate::grid::Axis;
use crate::reference::{self, Reference};
use crate::scene::Scene;
use crate::state::{Carried, SolveReport, SolveStatus, State, StepReport};

/// Backend of a simulation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Backend {
    /// An adapter, in the scene's precision.
    Gpu(AdapterChoice),
    /// The CPU, in f64.
    Cpu,
}

impl Backend {
    /// Name: `gpu` or `cpu`.
    pub fn name(&self) -> &'static str {
        match self {
            Backend::Gpu(_) => "gpu",
            Backend::Cpu => "cpu",
        }
    }
}

/// Progress of a simulation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clock {
    /// Simulated time, s.
    pub time: f64,
    /// Completed sub-steps.
    pub step: u64,
    /// Completed frames.
    pub frame: u64,
}

impl Clock {
    fn of(&State { time, step, frame, .. }: &State) -> Clock {
        Clock { time, step, frame }
    }
}

/// A simulation of a scene.
#[derive(Debug)]
pub struct Simulation {
    scene: Scene,
    solids: Solids,
    path: Path,
}

#[derive(Debug)]
enum Path {
    Gpu(Box<GpuPath>),
    Cpu(Box<Reference>),
}

impl Simulation {
    /// Clips the obstacles, seeds the liquid, and opens the backend.
    pub fn new(scene: &Scene, backend: &Backend) -> Result<Simulation, Error> {
        let solids = solids_of(scene)?;
        let path = match backend {
            Backend::Gpu(choice) => Path::Gpu(Box::new(GpuPath::with(scene, &solids, choice)?)),
            Backend::Cpu => Path::Cpu(Box::new(reference_with(scene, &solids)?)),
        };
        Ok(Simulation { scene: scene.clone(), solids, path })
    }

    /// Computes one sub-step of the length that velocities and frame times allow.
    ///
    /// # Errors
    /// [`Error::Stage`] when the solve breaks down or a value is not finite, [`Error::Gpu`] when the device fails.
    pub fn step(&mut self) -> Result<StepReport, Error> {
        let Clock { step, time, .. } = self.clock();
        let report = match &mut self.path {
            Path::Gpu(path) => path.step(path.next_time_step(), None)?,
            Path::Cpu(path) => {
                let time_step = path.next_time_step();
                path.step(time_step)?
            }
        };
        // For probes of reactions.
        let times = [time, self.clock().time];
        let domain = &mut self.scene.domain;
        domain.gravity = domain.mean_gravity(times);
        self.solids.set_load(times);
        let solves =
            [("pressure", report.liquid.map(|liquid| liquid.solve)), ("solid", report.solid.map(|solid| solid.solve))];
        for (name, solve) in solves {
            if let Some(SolveReport {
                status: status @ (SolveStatus::Breakdown | SolveStatus::NonFinite),
                residual,
                ..
            }) = solve
            {
                let status = status.name();
                let problem = format!(
                    "the {name} solve ended with {status} at a relative residual of {residual:.1e}\n  cure: shorter sub-steps (time.fixed_step), solver.precision = \"f64\", or smaller ratios between loads and between stiffnesses"
                );
                return Err(Error::Stage { stage: "solve", step, problem });
            }
        }
        Ok(report)
    }

    /// Reads back the state.
    pub fn state(&self) -> Result<State, Error> {
        match &self.path {
            Path::Gpu(path) => path.state(),
            Path::Cpu(path) => Ok(path.state().clone()),
        }
    }

    /// Values of the scene's probes, all columns in order.
    pub fn probes(&mut self) -> Result<Vec<f64>, Error> {
        let probes = &self.scene.probes;
        let (liquid, nodes) = match &mut self.path {
            Path::Gpu(path) => path.probed()?,
            Path::Cpu(path) => {
                let (grid, state) = (self.scene.grid(), path.state());
                let open = &path.cut_cells().open;
                let of_liquid = probes.iter().filter(|probe| probe.kind.measures_liquid());
                let values = of_liquid.flat_map(|probe| reference::probe(&grid, open, state, &probe.kind));
                let nodes = NodeReadback {
                    displacement: state.displacement.clone(),
                    velocity: state.node_velocity.clone(),
                    forces: path.node_forces().to_vec(),
                    time: state.time,
                    dt: state.dt_last,
                };
                (values.collect(), nodes)
            }
        };
        let mut liquid = liquid.into_iter();
        let values = probes.iter().enumerate().flat_map(|(number, probe)| {
            let mut values: Vec<f64> = match probe.kind.measures_liquid() {
                true => liquid.by_ref().take(probe.columns().len()).collect(),
                false => self.solids.probe(&self.scene, number, &nodes),
            };
            let slab = self.scene.domain.slab;
            if let Some(factors) = slab.and_then(|slab| slab.probe_factors(&probe.kind)) {
                values.iter_mut().zip(factors).for_each(|(value, factor)| *value *= factor);
            }
            values
        });
        Ok(values.collect())
    }

    /// Displacements of all nodes from rest, m; empty without solids.
    pub fn displacement(&self) -> Result<Vec<[f64; 3]>, Error> {
        match &self.path {
            Path::Gpu(path) => path.displacement(),
            Path::Cpu(path) => Ok(path.state().displacement.clone()),
        }
    }

    /// Time, sub-step and frame.
    pub fn clock(&self) -> Clock {
        match &self.path {
            Path::Gpu(path) => path.clock(),
            Path::Cpu(path) => Clock::of(path.state()),
        }
    }

    /// Liquid volume after a sub-step over the controlled volume; 1 if that is zero. `None` without liquid.
    pub fn volume_ratio(&self, report: &StepReport) -> Option<f64> {
        let liquid = report.liquid?;
        let volume_0 = match &self.path {
            Path::Gpu(path) => path.liquid.as_ref().map_or(0.0, |liquid| liquid.volume_0),
            Path::Cpu(path) => path.state().volume_0,
        };
        Some(if volume_0 > 0.0 { liquid.diagnosis.volume / volume_0 } else { 1.0 })
    }

    /// Flow rates of the sources, in the order of the scene.
    pub fn source_flows(&self) -> Vec<SourceFlow> {
        let taps = match &self.path {
            Path::Gpu(path) => path.taps().map(|(taps, _)| taps),
            Path::Cpu(path) => path.taps(),
        };
        taps.iter().flat_map(|taps| taps.flows()).collect()
    }

    /// The scene, with the changes that were made between sub-steps.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The elastic solids at rest; empty without solids.
    pub fn solids(&self) -> &Solids {
        &self.solids
    }

    /// Cut cells of obstacles, and of solids in liquid.
    pub fn cut_cells(&self) -> &CutCells {
        match &self.path {
            Path::Gpu(path) => path.cut_cells(),
            Path::Cpu(path) => path.cut_cells(),
        }
    }

    /// Replaces the state by another of the same scene.
    pub fn reset(&mut self, state: &State) -> Result<(), Error> {
        match &mut self.path {
            Path::Gpu(path) => path.write_state(state),
            Path::Cpu(path) => path.reset(state.clone()),
        }
    }

    /// Data of the backend beyond [`Simulation::state`], needed to resume.
    pub fn carried(&self) -> Result<Carried, Error> {
        match &self.path {
            Path::Gpu(path) => path.carried(),
            Path::Cpu(_) => Ok(Carried::default()),
        }
    }

    /// Resumes from a state of the same scene and backend. Results are bitwise identical on the same device.
    ///
    /// # Errors
    /// [`Error::Input`] when the state does not fit the scene; [`Error::Gpu`] when the device fails.
    pub fn resume(&mut self, state: &State, carried: &Carried) -> Result<(), Error> {
        let (grid, frames) = (self.scene.grid(), self.scene.time.frames_per_second);
        let n_cells = if self.scene.liquid.is_some() { grid.n_cells() } else { 0 };
        let cells = [state.pressure.len(), state.liquid_distance.len(), state.active.len(), state.ballistic.len()];
        let faces = Axis::ALL.map(|axis| state.velocity[axis.index()].len());
        let n_faces = Axis::ALL.map(|axis| grid.n_faces(axis));
        let liquid = n_cells == 0 || (cells == [n_cells; 4] && faces == n_faces);
        let n_nodes = self.solids.rest.len();
        let solids = [state.displacement.len(), state.node_velocity.len()] == [n_nodes; 2];
        let left = state.time_left(frames) * frames;
        let clock = 0.0 < left && left <= 1.0 + 1e-9 && state.dt_last >= 0.0;
        if !(liquid && solids && clock) {
            return Err(unfit(&self.scene));
        }
        match &mut self.path {
            Path::Gpu(path) => path.resume(state, carried),
            Path::Cpu(path) => path.reset(state.clone()),
        }
    }

    /// The GPU path.
    pub fn gpu_path(&self) -> Option<&GpuPath> {
        match &self.path {
            Path::Gpu(path) => Some(path),
            Path::Cpu(_) => None,
        }
    }

    /// The device, on the GPU path.
    pub fn gpu(&self) -> Option<&Gpu> {
        self.gpu_path().map(GpuPath::gpu)
    }

    /// The adapter, on the GPU path.
    pub fn adapter(&self) -> Option<&AdapterReport> {
        self.gpu().map(Gpu::report)
    }
}

/// Error for a state that does not fit the scene.
fn unfit(scene: &Scene) -> Error {
    Error::input(
        scene.file.display().to_string(),
        "the checkpoint does not fit this scene: the lengths of its arrays differ, or its time is outside its frame",
        "resume with the original scene and backend, or restart with --overwrite",
    )
}

/// The solids of a scene at rest; empty without solids.
///
/// # Errors
/// [`Error::Input`] when a mesh is unusable, or a pin or load matches no node.
pub fn solids_of(scene: &Scene) -> Result<Solids, Error> {
    Solids::new(scene, &geometry::solid_meshes(scene)?)
}

/// The f64 path of a scene, before its first step.
pub fn reference_path(scene: &Scene) -> Result<Reference, Error> {
    reference_with(scene, &solids_of(scene)?)
}

fn reference_with(scene: &Scene, solids: &Solids) -> Result<Reference, Error> {
    HostMemory::new(scene, solids, true)?.check()?;
    let obstacles = geometry::obstacle_cut(scene, &scene.grid())?;
    let clip = first_clip(scene, solids, &obstacles);
    let state = first_state(scene, solids, &obstacles, clip.as_ref())?;
    Reference::new(scene, obstacles, solids.clone(), state)
}

/// Initial clipping of solids in liquid and of moving obstacles; `None` when nothing that cuts the grid can move.
fn first_clip(scene: &Scene, solids: &Solids, obstacles: &ObstacleCut) -> Option<SolidClip> {
    Effects::of(scene).clips().then(|| {
        let mut clip = SolidClip::new(&scene.grid(), obstacles.clone(), &scene.solver);
        clip.clip(&solids.moved(&solids.initial_state(scene).0));
        clip
    })
}

/// The initial state for [`reference::prepare`]. Liquid is seeded outside the solids.
fn first_state(
    scene: &Scene,
    solids: &Solids,
    obstacles: &ObstacleCut,
    clip: Option<&SolidClip>,
) -> Result<State, Error> {
    let cut = clip.map_or(&obstacles.cut, SolidClip::cut_cells);
    let (displacement, velocity) = solids.initial_state(scene);
    solids.ensure_clearance(scene, &obstacles.cut.solid_distance, &displacement)?;
    let grid = scene.grid();
    let mut state = geometry::initial_state(scene, &grid, cut)?;
    if Effects::of(scene).separation {
        state.separated = vec![false; grid.n_cells()];
    }
    (state.displacement, state.node_velocity) = (displacement, velocity);
    if !solids.rest.is_empty() {
        state.contact_step = first_contact_step(scene, solids, &obstacles.contact_field(&grid), &state);
    }
    Ok(state)
}

/// [`State::contact_step`] of a state whose velocities no solve has limited.
fn first_contact_step(scene: &Scene, solids: &Solids, obstacles: &ContactField, state: &State) -> f64 {
    let frame = 1.0 / scene.time.frames_per_second;
    let longest = match scene.time.fixed_step {
        Some(fixed) => frame / (frame / fixed).round().max(1.0),
        None => scene.time.max_step.unwrap_or(frame).min(frame),
    };
    let with = (obstacles, Effects::of(scene).solid_contact);
    reference::first_contact_step(solids, with, &state.displacement, &state.node_velocity, longest)
}
