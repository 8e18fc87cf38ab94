//! One step of the f64 path, in the lines of the crate's list (thesis, algorithm 4).

use std::time::Instant;

use super::{
    PressureSystem, Projection, TimeStep, VolumeSource, active_cells, advect_markers,
    advect_velocity, diagnose, extrapolate, forces, liquid_distance, liquid_volume, max_speed,
    n_layers, open_volume, right_hand_side, solve, time_step, volume_rate, write_back,
};
use crate::Error;
use crate::effects::Effects;
use crate::geometry::CutCells;
use crate::grid::{Axis, Grid};
use crate::scene::{Liquid, Scene};
use crate::state::{SolveStatus, State, StepReport};

/// The simulator on the CPU in f64: a scene's settings and obstacles, and the state that its steps move on.
#[derive(Clone, Debug)]
pub struct Reference {
    scene: Scene,
    liquid: Liquid,
    grid: Grid,
    cut: CutCells,
    effects: Effects,
    /// m^3 per cell
    open_volume: Vec<f64>,
    state: State,
}

impl Reference {
    /// Starts from a state; with `surface = "fixed"` its liquid distance is the exact one, and stays.
    pub fn new(scene: &Scene, cut: CutCells, state: State) -> Result<Reference, Error> {
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
        let open_volume = open_volume(&grid, &cut.solid_distance);
        let effects = Effects::of(scene);
        Ok(Reference {
            scene: scene.clone(),
            liquid,
            grid,
            cut,
            effects,
            open_volume,
            state,
        })
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
    pub fn step(&mut self, TimeStep { dt, floored }: TimeStep) -> Result<StepReport, Error> {
        let Reference {
            scene,
            liquid,
            grid,
            cut,
            effects,
            open_volume,
            state,
        } = self;
        let frames_per_second = scene.time.frames_per_second;
        let (gravity, theta_floor) = (scene.domain.gravity, scene.solver.theta_floor);
        let mut clock = Clock::default();

        let (markers, dropped) = clock.time("advect_markers", || {
            advect_markers(
                grid,
                &state.velocity,
                &cut.solid_distance,
                &state.markers,
                dt,
            )
        });
        let mut velocity = clock.time("advect_velocity", || {
            advect_velocity(grid, &state.velocity, dt)
        });
        clock.time("forces", || forces(&mut velocity, gravity, dt));
        let phi = clock.time("liquid_distance", || match effects.markers {
            true => liquid_distance(grid, cut, &markers, liquid.marker_radius * grid.dx),
            false => state.liquid_distance.clone(),
        });
        let active = clock.time("active_cells", || {
            active_cells(grid, &cut.open, &phi, theta_floor)
        });
        let closed_components = active.closed.len();
        let system = clock.time("right_hand_side", || {
            let source = effects.volume_control.then(|| {
                let volume = liquid_volume(grid, open_volume, &phi);
                VolumeSource {
                    rate: volume_rate(state.volume_0, volume, 1.0 / frames_per_second),
                    open_volume,
                }
            });
            let rhs = right_hand_side(grid, &cut.open, &velocity, &active, source);
            PressureSystem::new(active, rhs, dt, liquid.density)
        });
        let (pressure, solve) = clock.time("solve", || solve(&system, &scene.solver))?;
        if solve.status == SolveStatus::NonFinite {
            return Err(failed(
                "solve",
                state.step,
                "the right-hand side or the pressure is not finite",
            ));
        }
        let valid = clock.time("write_back", || {
            let (open, liquid_distance, pressure) = (&cut.open, &phi[..], &pressure[..]);
            write_back(
                grid,
                Projection {
                    system: &system,
                    pressure,
                    open,
                    liquid_distance,
                    theta_floor,
                },
                &mut velocity,
            )
        });
        clock.time("extrapolate", || {
            extrapolate(grid, cut, valid, n_layers(scene.time.cfl), &mut velocity)
        });
        let diagnosis = clock.time("diagnose", || {
            diagnose(
                grid,
                cut,
                &phi,
                &velocity,
                &system.stencil,
                liquid.density,
                gravity,
            )
        });
        if !diagnosis.max_speed.is_finite() {
            return Err(failed("diagnose", state.step, "a velocity is not finite"));
        }

        let n_markers = markers.len();
        state.advance_clock(dt, frames_per_second);
        state.markers_dropped += dropped;
        state.active = system
            .stencil
            .diagonal
            .iter()
            .map(|&diagonal| diagonal > 0.0)
            .collect();
        (
            state.velocity,
            state.markers,
            state.pressure,
            state.liquid_distance,
        ) = (velocity, markers, pressure, phi);
        let seconds = clock.laps;
        Ok(StepReport {
            dt,
            dt_floored: floored,
            solve,
            closed_components,
            diagnosis,
            markers: n_markers,
            dropped,
            seconds,
        })
    }
}

fn failed(stage: &'static str, step: u64, problem: &str) -> Error {
    Error::Stage {
        stage,
        step,
        problem: problem.to_string(),
    }
}

/// Wall-clock seconds of the stages.
#[derive(Default)]
struct Clock {
    laps: Vec<(&'static str, f64)>,
}

impl Clock {
    fn time<T>(&mut self, stage: &'static str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        self.laps.push((stage, start.elapsed().as_secs_f64()));
        result
    }
}
