//! The f64 path: the model of a scene, its boundary, and the state that sub-steps advance.

use std::sync::Arc;

use super::boundary::Boundary;
use super::diagnose::larger;
use super::step::{StepSystem, SubStep};
use super::{BlockPattern, SolidSolver, StepLimits, TimeStep, max_speed, prepare};
use crate::Error;
use crate::effects::Effects;
use crate::elastic::{Cavities, Solids};
use crate::geometry::{ContactField, CutCells, ObstacleCut, SolidClip, SourcesAndSinks};
use crate::grid::{Axis, Grid};
use crate::scene::Scene;
use crate::state::{State, StepReport};

/// The simulator on the CPU in f64.
#[derive(Clone, Debug)]
pub struct Reference {
    model: Model,
    boundary: Boundary,
    /// Obstacles as the nodes meet them, with solids.
    obstacles: Option<ContactField>,
    state: State,
    /// Forces of the liquid on the nodes in the last sub-step, N.
    node_forces: Vec<[f64; 3]>,
}

/// The constant parts of a simulation.
#[derive(Clone, Debug)]
pub(super) struct Model {
    pub(super) scene: Scene,
    pub(super) grid: Grid,
    pub(super) effects: Effects,
    /// Sources and sinks; without any where there is no liquid.
    pub(super) taps: SourcesAndSinks,
    pub(super) solid: Option<SolidModel>,
    pub(super) limits: StepLimits,
}

#[derive(Clone, Debug)]
pub(super) struct SolidModel {
    pub(super) solids: Solids,
    /// See [`Cavities::in_liquid`].
    pub(super) cavities: Cavities,
    pub(super) pattern: Arc<BlockPattern>,
    pub(super) solver: SolidSolver,
}

impl Model {
    pub(super) fn solids(&self) -> Option<&Solids> {
        self.solid.as_ref().map(|part| &part.solids)
    }

    /// Nodes of the surface triangles of all solids.
    pub(super) fn triangles(&self) -> &[[u32; 3]] {
        self.solids().map_or(&[], |solids| &solids.triangles)
    }
}

impl Reference {
    /// Starts from a state. [`prepare`] completes the liquid of a state without steps. With `surface = "fixed"` its liquid distance is
    /// exact and stays. `solids`: those of the scene.
    ///
    /// # Errors
    /// [`Error::Input`] for a scene with neither liquid nor solids, and for a state of another scene.
    pub fn new(scene: &Scene, obstacles: ObstacleCut, solids: Solids, state: State) -> Result<Reference, Error> {
        let grid = scene.grid();
        let effects = Effects::of(scene);
        if !effects.liquid && !effects.solids {
            return Err(Error::input(
                scene.file.display().to_string(),
                "the scene has neither liquid nor solids",
                "add a [liquid] section with a region, or a [[solid]]",
            ));
        }
        let taps = SourcesAndSinks::new(scene, &grid, obstacles.static_cut())?;
        let limits = StepLimits::new(scene, obstacles.accelerations(), Some(&solids));
        let field = effects.solids.then(|| obstacles.contact_field(&grid));
        let boundary = match effects.clips() {
            false => Boundary::Fixed(obstacles.static_cut().clone()),
            true => Boundary::Moving(Box::new(SolidClip::new(&grid, obstacles, &scene.solver))),
        };
        let solid = effects.solids.then(|| SolidModel {
            cavities: Cavities::in_liquid(scene, &solids),
            pattern: Arc::new(BlockPattern::new(&solids)),
            solver: SolidSolver::new(&solids),
            solids,
        });
        let mut reference = Reference {
            model: Model { scene: scene.clone(), grid, effects, taps, solid, limits },
            boundary,
            obstacles: field,
            state: State::default(),
            node_forces: Vec::new(),
        };
        reference.reset(state)?;
        Ok(reference)
    }

    /// Resumes from another state of the scene.
    ///
    /// # Errors
    /// [`Error::Input`] for a state of another scene.
    pub fn reset(&mut self, mut state: State) -> Result<(), Error> {
        let (model, boundary) = (&self.model, &mut self.boundary);
        let Model { scene, grid, .. } = model;
        let refused = |problem: String| {
            let file = scene.file.display().to_string();
            let cure = "resume with the scene and the scale that the state was made with";
            Err(Error::input(file, problem, cure))
        };
        if model.effects.liquid && !fits_grid(grid, boundary.cut_cells(), &state) {
            return refused(format!("the state does not have the scene's {:?} cells", grid.cells));
        }
        if model.effects.level && state.step > 0 && !state.fits_level(grid) {
            return refused("the state does not have the level's markers and components".to_owned());
        }
        let n_nodes = model.solids().map_or(0, |solids| solids.rest.len());
        if [state.displacement.len(), state.node_velocity.len()] != [n_nodes; 2] {
            return refused(format!("the state does not have the {n_nodes} nodes of the scene's solids"));
        }
        boundary.update(model.solids(), &state.displacement, state.time, 0.0);
        if state.step == 0 {
            let moving = boundary.clip().map(|clip| (clip, model.triangles()));
            prepare(scene, grid, boundary.cut_cells(), moving, &mut state)?;
        }
        self.node_forces = vec![[0.0; 3]; n_nodes];
        self.state = state;
        Ok(())
    }

    /// Copies gravity and the keyframes of obstacles and scripts from a scene that is the same otherwise.
    pub fn follow(&mut self, scene: &Scene) {
        let Reference { model, boundary, obstacles, .. } = self;
        boundary.follow(scene);
        if let Some(field) = obstacles {
            field.follow(scene);
        }
        if let Some(solid) = &mut model.solid {
            solid.solids.follow(scene);
        }
        let accelerations = match (obstacles, boundary.moving_obstacles()) {
            (Some(field), _) => field.accelerations(),
            (None, Some(cut)) => cut.accelerations(),
            (None, None) => Vec::new(),
        };
        model.limits = StepLimits::new(scene, accelerations, model.solids());
        model.scene = scene.clone();
    }

    /// Sources and sinks; `None` without liquid.
    pub fn taps(&self) -> Option<&SourcesAndSinks> {
        self.model.effects.liquid.then_some(&self.model.taps)
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.model.scene
    }

    /// The state after the last step.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Forces of the liquid on the nodes in the last sub-step, N: J^T p, and those of the pressure's variation within cells.
    pub fn node_forces(&self) -> &[[f64; 3]] {
        &self.node_forces
    }

    /// Replaces [`State::contact_step`], s.
    pub(crate) fn limit_step(&mut self, longest: f64) {
        self.state.contact_step = longest;
    }

    /// The obstacles as the nodes of solids meet them.
    pub(crate) fn contact_field(&self) -> ContactField {
        let none = || ContactField::at_rest(&self.model.grid, Vec::new());
        self.obstacles.clone().unwrap_or_else(none)
    }

    /// Cut cells of obstacles and immersed solids.
    pub fn cut_cells(&self) -> &CutCells {
        self.boundary.cut_cells()
    }

    /// Immersed solids and obstacles in motion, clipped against the grid; `None` without any.
    pub fn clip(&self) -> Option<&SolidClip> {
        self.boundary.clip()
    }

    /// The length of the next sub-step.
    pub fn next_time_step(&self) -> TimeStep {
        let Reference { model, state, .. } = self;
        let Model { scene, taps, .. } = model;
        let left = state.time_left(scene.time.frames_per_second);
        let nodes = state.node_velocity.as_flattened().iter();
        let solid_speed = nodes.fold(0.0, |max, v| larger(max, v.abs()));
        let obstacles = self.boundary.moving_obstacles();
        let obstacle_speed = obstacles.map_or(0.0, |cut| cut.max_speed(state.time, left));
        let pushing = self.obstacles.as_ref();
        let pushing_speed = pushing.map_or(0.0, |field| field.max_speed(state.time, left));
        let obstacle_speed = obstacle_speed.max(pushing_speed);
        let speed = larger(max_speed(&state.velocity), solid_speed.max(obstacle_speed));
        let speed = larger(speed, taps.speed(state.time, [state.dt_last, left], scene.time.cfl));
        // After the first sub-step the velocities of scripted nodes include the scripts.
        let scripts = match (model.solids(), state.step) {
            (Some(solids), 0) => solids.max_script_speed(state.time, left),
            _ => 0.0,
        };
        let speed = larger(speed, scripts);
        model.limits.time_step(speed, [state.time, left], state.last_limits())
    }

    /// Runs one sub-step. After an error the state is the one before.
    pub fn step(&mut self, time_step: TimeStep) -> Result<StepReport, Error> {
        self.step_observed(time_step, &mut |_| {})
    }

    /// Runs one sub-step and calls the observer with the systems solved and their solutions.
    pub fn step_observed(
        &mut self,
        time_step: TimeStep,
        observer: &mut dyn FnMut(StepSystem),
    ) -> Result<StepReport, Error> {
        let Reference { model, boundary, obstacles, state, node_forces } = self;
        let times = [state.time, state.time + time_step.dt];
        let domain = &mut model.scene.domain;
        domain.gravity = domain.mean_gravity(times);
        model.taps.set_velocities(state.time, [state.dt_last, time_step.dt]);
        if let Some(solid) = &mut model.solid {
            solid.solids.set_load(times);
        }
        let boundaries = (&mut *boundary, obstacles.as_mut());
        match SubStep::new(model, boundaries, state, time_step, observer).complete() {
            Ok((after, forces, report)) => {
                (*state, *node_forces) = (after, forces);
                Ok(report)
            }
            Err(error) => {
                boundary.update(model.solids(), &state.displacement, state.time, 0.0);
                Err(error)
            }
        }
    }
}

/// Whether a state and cut cells have the cells and faces of a grid.
fn fits_grid(grid: &Grid, cut: &CutCells, state: &State) -> bool {
    let [pressure, distance] = [&state.pressure, &state.liquid_distance].map(Vec::len);
    let cells = [pressure, distance, state.active.len(), state.ballistic.len(), cut.solid_distance.len()];
    let faces = |axis: Axis| {
        let lists = [&state.velocity, &cut.open].map(|faces| faces[axis.index()].len());
        lists == [grid.n_faces(axis); 2]
    };
    let separated = [0, grid.n_cells()].contains(&state.separated.len());
    cells == [grid.n_cells(); 5] && separated && Axis::ALL.into_iter().all(faces)
}
