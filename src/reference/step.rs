//! One step of the f64 path, in the lines of the crate's list (thesis, algorithm 4).

use std::time::Instant;

use super::{
    PressureSystem, TimeStep, VolumeSource, active_cells, advect_markers, advect_velocity,
    diagnose, extrapolate, forces, liquid_distance, liquid_volume, max_speed, n_layers,
    open_volumes, prepare, right_hand_side, solve, time_step, volume_rate, write_back,
};
use crate::Error;
use crate::effects::Effects;
use crate::geometry::CutCells;
use crate::grid::{Axis, Grid};
use crate::scene::{Liquid, Scene};
use crate::state::{LiquidReport, SolveStatus, State, StepReport};

/// The simulator on the CPU in f64: a scene's settings and obstacles, and the state that its steps move on.
#[derive(Clone, Debug)]
pub struct Reference {
    scene: Scene,
    liquid: Liquid,
    grid: Grid,
    cut: CutCells,
    effects: Effects,
    /// m^3 per cell
    open_volumes: Vec<f64>,
    state: State,
}

impl Reference {
    /// Starts from a state; one without steps is completed by [`prepare`]. With `surface = "fixed"` its liquid distance is
    /// the exact one, and stays.
    pub fn new(scene: &Scene, cut: CutCells, mut state: State) -> Result<Reference, Error> {
        let grid = scene.grid();
        let file = || scene.file.display().to_string();
        let Some(liquid) = scene.liquid.clone() else {
            return Err(Error::input(
                file(),
                "the scene has no liquid",
                "add a [liquid] section with a region",
            ));
        };
        let cells = [
            state.pressure.len(),
            state.liquid_distance.len(),
            state.active.len(),
            cut.solid_distance.len(),
        ];
        let faces = Axis::ALL.map(|axis| {
            [
                state.velocity[axis.index()].len(),
                cut.open[axis.index()].len(),
            ]
        });
        let fits =
            cells == [grid.n_cells(); 4] && faces == Axis::ALL.map(|axis| [grid.n_faces(axis); 2]);
        if !fits {
            let problem = format!("the state does not have the scene's {:?} cells", grid.cells);
            return Err(Error::input(
                file(),
                problem,
                "resume with the scene and the scale that the state was made with",
            ));
        }
        if state.step == 0 {
            prepare(scene, &grid, &cut, &mut state);
        }
        let open_volumes = open_volumes(&grid, &cut.solid_distance);
        let effects = Effects::of(scene);
        Ok(Reference {
            scene: scene.clone(),
            liquid,
            grid,
            cut,
            effects,
            open_volumes,
            state,
        })
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The state after the last step.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// The obstacles.
    pub fn cut_cells(&self) -> &CutCells {
        &self.cut
    }

    /// The length of the next sub-step.
    pub fn next_time_step(&self) -> TimeStep {
        let Reference {
            scene, grid, state, ..
        } = self;
        let fall = (scene.domain.gravity.length() * grid.dx).sqrt();
        let left = state.time_left(scene.time.frames_per_second);
        time_step(
            &scene.time,
            grid.dx,
            max_speed(&state.velocity),
            fall,
            left,
            state.dt_last,
        )
    }

    /// Does one sub-step. After an error the state is the one before.
    pub fn step(&mut self, time_step: TimeStep) -> Result<StepReport, Error> {
        self.step_observed(time_step, &mut |_, _| {})
    }

    /// Does one sub-step, and tells of the pressure system and its answer (Pa per cell).
    pub fn step_observed(
        &mut self,
        TimeStep { dt, floored }: TimeStep,
        observer: &mut dyn FnMut(&PressureSystem, &[f64]),
    ) -> Result<StepReport, Error> {
        let (scene, grid, cut) = (&self.scene, &self.grid, &self.cut);
        let (open, solid_distance) = (&cut.open, &cut.solid_distance);
        let (density, gravity) = (self.liquid.density, scene.domain.gravity);
        let (velocity, markers) = (&self.state.velocity, &self.state.markers);
        let theta_floor = scene.solver.theta_floor;
        let mut clock = Clock::start();

        let (markers, dropped) = advect_markers(grid, velocity, solid_distance, markers, dt);
        clock.lap("advect_markers");

        let mut velocity = advect_velocity(grid, velocity, dt);
        clock.lap("advect_velocity");

        forces(&mut velocity, gravity, dt);
        clock.lap("forces");

        let phi = match self.effects.markers {
            true => liquid_distance(grid, cut, &markers, self.liquid.marker_radius * grid.dx),
            false => self.state.liquid_distance.clone(),
        };
        clock.lap("liquid_distance");

        let active = active_cells(grid, open, &phi, theta_floor);
        clock.lap("active_cells");

        let source = self.volume_source(&phi, dt);
        let rhs = right_hand_side(grid, open, &velocity, &active, source);
        let system = PressureSystem::new(active, rhs, dt, density);
        clock.lap("right_hand_side");

        let (pressure, solve) = solve(&system, &scene.solver)?;
        self.ensure_finite("solve", solve.status != SolveStatus::NonFinite)?;
        clock.lap("solve");
        observer(&system, &pressure);

        let valid = write_back(&system, &pressure, open, &phi, theta_floor, &mut velocity);
        clock.lap("write_back");

        extrapolate(grid, cut, valid, n_layers(scene.time.cfl), &mut velocity);
        clock.lap("extrapolate");

        let diagnosis = diagnose(cut, &phi, &velocity, &system.stencil, density, gravity);
        self.ensure_finite("diagnose", diagnosis.max_speed.is_finite())?;
        clock.lap("diagnose");

        let report = StepReport {
            dt,
            dt_floored: floored,
            liquid: Some(LiquidReport {
                solve,
                closed_components: system.closed.len(),
                diagnosis,
                markers: markers.len(),
                dropped,
            }),
            solid: None,
            seconds: clock.laps,
        };
        let frames_per_second = scene.time.frames_per_second;
        let state = &mut self.state;
        state.velocity = velocity;
        state.markers = markers;
        state.markers_dropped += dropped;
        state.pressure = pressure;
        state.liquid_distance = phi;
        state.active = system.stencil.active_mask();
        state.advance_clock(dt, frames_per_second);
        Ok(report)
    }

    /// What volume control asks for, given phi (m) and dt (s); nothing where the scene has none.
    fn volume_source(&self, liquid_distance: &[f64], dt: f64) -> Option<VolumeSource<'_>> {
        let volume = liquid_volume(&self.grid, &self.open_volumes, liquid_distance);
        let frame = 1.0 / self.scene.time.frames_per_second;
        let rate = volume_rate(self.state.volume_0, volume, frame, dt);
        let source = VolumeSource {
            rate,
            open_volumes: &self.open_volumes,
        };
        self.effects.volume_control.then_some(source)
    }

    fn ensure_finite(&self, stage: &'static str, finite: bool) -> Result<(), Error> {
        let step = self.state.step;
        let problem = "a number is not finite".to_string();
        if finite {
            Ok(())
        } else {
            Err(Error::Stage {
                stage,
                step,
                problem,
            })
        }
    }
}

/// Wall-clock seconds of the stages.
struct Clock {
    last: Instant,
    laps: Vec<(&'static str, f64)>,
}

impl Clock {
    fn start() -> Clock {
        Clock {
            last: Instant::now(),
            laps: Vec::new(),
        }
    }

    /// Ends a stage.
    fn lap(&mut self, stage: &'static str) {
        let now = Instant::now();
        self.laps.push((stage, (now - self.last).as_secs_f64()));
        self.last = now;
    }
}
