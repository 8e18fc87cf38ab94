//! One step of the f64 path, in the lines of the crate's list (thesis, algorithm 4).

use std::sync::Arc;
use std::time::Instant;

use super::diagnose::larger;
use super::{
    BlockPattern, Contacts, PressureSystem, SolidSolver, SolidSystem, TimeStep, VolumeSource,
    active_cells, advect_markers, advect_velocity, diagnose, diagnose_solid, extrapolate, forces,
    liquid_distance, liquid_volume, max_speed, move_solid, n_layers, node_forces, open_volumes,
    prepare, right_hand_side, solid_matrices, solid_right_hand_side, solve, time_step, volume_rate,
    write_back,
};
use crate::Error;
use crate::effects::Effects;
use crate::elastic::Solids;
use crate::geometry::CutCells;
use crate::grid::{Axis, Grid};
use crate::scene::{Liquid, Scene};
use crate::state::{LiquidReport, SolidReport, SolveReport, SolveStatus, State, StepReport};

/// The simulator on the CPU in f64: a scene's settings and obstacles, and the state that its steps move on.
#[derive(Clone, Debug)]
pub struct Reference {
    scene: Scene,
    grid: Grid,
    cut: CutCells,
    effects: Effects,
    liquid: Option<LiquidPart>,
    solid: Option<SolidPart>,
    state: State,
}

/// What the steps of a liquid share.
#[derive(Clone, Debug)]
struct LiquidPart {
    liquid: Liquid,
    /// m^3 per cell
    open_volumes: Vec<f64>,
}

/// What the steps of solids share.
#[derive(Clone, Debug)]
struct SolidPart {
    solids: Solids,
    pattern: Arc<BlockPattern>,
    solver: SolidSolver,
}

/// A system of a step and its answer.
#[derive(Clone, Copy, Debug)]
pub enum StepSystem<'a> {
    /// The pressure per cell, Pa.
    Pressure(&'a PressureSystem, &'a [f64]),
    /// The velocities of the nodes, m/s.
    Solid(&'a SolidSystem, &'a [[f64; 3]]),
}

impl Reference {
    /// Starts from a state; the liquid of one without steps is completed by [`prepare`]. With `surface = "fixed"` its liquid
    /// distance is the exact one, and stays. `solids`: those of the scene.
    ///
    /// # Errors
    /// [`Error::Input`] where the scene has neither liquid nor solids, or both, and where the state is not one of the scene.
    pub fn new(
        scene: &Scene,
        cut: CutCells,
        solids: Solids,
        mut state: State,
    ) -> Result<Reference, Error> {
        let grid = scene.grid();
        let effects = Effects::of(scene);
        let refused = |problem: String, cure: &str| {
            Err(Error::input(
                scene.file.display().to_string(),
                problem,
                cure,
            ))
        };
        match (effects.liquid, effects.solids) {
            (false, false) => {
                let problem = "the scene has neither liquid nor solids".to_owned();
                return refused(
                    problem,
                    "add a [liquid] section with a region, or a [[solid]]",
                );
            }
            (true, true) => {
                let problem = "the coupling of liquid and elastic solids is not simulated yet";
                return refused(problem.to_owned(), "remove [liquid], or the solids");
            }
            _ => {}
        }
        let cure = "resume with the scene and the scale that the state was made with";
        if effects.liquid && !fits_grid(&grid, &cut, &state) {
            let problem = format!("the state does not have the scene's {:?} cells", grid.cells);
            return refused(problem, cure);
        }
        let n_nodes = solids.rest.len();
        if [state.displacement.len(), state.node_velocity.len()] != [n_nodes; 2] {
            let problem =
                format!("the state does not have the {n_nodes} nodes of the scene's solids");
            return refused(problem, cure);
        }
        if state.step == 0 {
            prepare(scene, &grid, &cut, &mut state);
        }
        let liquid = scene.liquid.clone().map(|liquid| LiquidPart {
            liquid,
            open_volumes: open_volumes(&grid, &cut.solid_distance),
        });
        let solid = effects.solids.then(|| SolidPart {
            pattern: Arc::new(BlockPattern::new(&solids)),
            solver: SolidSolver::new(&solids),
            solids,
        });
        Ok(Reference {
            scene: scene.clone(),
            grid,
            cut,
            effects,
            liquid,
            solid,
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
        let nodes = state.node_velocity.as_flattened().iter();
        let solid_speed = nodes.fold(0.0, |max, v| larger(max, v.abs()));
        let speed = larger(max_speed(&state.velocity), solid_speed);
        time_step(&scene.time, grid.dx, speed, fall, left, state.dt_last)
    }

    /// Does one sub-step. After an error the state is the one before.
    pub fn step(&mut self, time_step: TimeStep) -> Result<StepReport, Error> {
        self.step_observed(time_step, &mut |_| {})
    }

    /// Does one sub-step, and tells of the systems solved and their answers.
    pub fn step_observed(
        &mut self,
        TimeStep { dt, floored }: TimeStep,
        observer: &mut dyn FnMut(StepSystem),
    ) -> Result<StepReport, Error> {
        let (scene, grid, cut) = (&self.scene, &self.grid, &self.cut);
        let (open, solid_distance) = (&cut.open, &cut.solid_distance);
        let (settings, gravity) = (&scene.solver, scene.domain.gravity);
        let (liquid, solid) = (self.liquid.as_ref(), self.solid.as_ref());
        let before = &self.state;
        let mut state = before.clone();
        let mut clock = Clock::start();

        if let Some(SolidPart { solids, .. }) = solid {
            let State {
                displacement,
                node_velocity,
                ..
            } = &mut state;
            move_solid(
                solids,
                grid,
                solid_distance,
                dt,
                displacement,
                node_velocity,
            );
            clock.lap("move_solid");
        }

        let mut dropped = 0;
        if liquid.is_some() {
            (state.markers, dropped) =
                advect_markers(grid, &before.velocity, solid_distance, &before.markers, dt);
            clock.lap("advect_markers");

            state.velocity = advect_velocity(grid, &before.velocity, dt);
            clock.lap("advect_velocity");
        }

        if liquid.is_some() {
            forces(&mut state.velocity, gravity, dt);
        }
        if let Some(SolidPart { solids, .. }) = solid {
            let prescribed = solids.prescribed_velocity(&state.displacement, before.time + dt, dt);
            node_forces(solids, &prescribed, gravity, dt, &mut state.node_velocity);
        }
        clock.lap("forces");

        let active = liquid.map(|LiquidPart { liquid, .. }| {
            if self.effects.markers {
                let radius = liquid.marker_radius * grid.dx;
                state.liquid_distance = liquid_distance(grid, cut, &state.markers, radius);
            }
            clock.lap("liquid_distance");

            let active = active_cells(grid, open, &state.liquid_distance, settings.theta_floor);
            clock.lap("active_cells");
            active
        });

        let matrices = solid.map(
            |SolidPart {
                 solids, pattern, ..
             }| {
                let matrices = solid_matrices(solids, pattern, &state.displacement);
                clock.lap("solid_matrices");
                matrices
            },
        );

        let pressure = liquid.zip(active).map(|(part, active)| {
            let source = self.volume_source(part, &state.liquid_distance, dt);
            let rhs = right_hand_side(grid, open, &state.velocity, &active, source);
            PressureSystem::new(active, rhs, dt, part.liquid.density)
        });
        let mut motion = solid.zip(matrices.as_ref()).map(|(part, matrices)| {
            let SolidPart { solids, .. } = part;
            let rhs = solid_right_hand_side(solids, matrices, &state.node_velocity, dt);
            let State {
                displacement,
                node_velocity,
                ..
            } = &mut state;
            let contacts =
                Contacts::new(solids, grid, solid_distance, displacement, &rhs.values, dt);
            let freedom = contacts.hold(node_velocity);
            let stiffness = matrices.stiffness.clone();
            let system = SolidSystem::new(solids, stiffness, &rhs, node_velocity, freedom, dt);
            (system, contacts)
        });
        clock.lap("right_hand_side");

        let pressure_solve = match &pressure {
            None => None,
            Some(system) => {
                let (pressure, report) = solve(system, settings)?;
                state.pressure = pressure;
                Some(report)
            }
        };
        let solid_solve = match solid.zip(motion.as_mut()) {
            None => None,
            Some((SolidPart { solids, solver, .. }, (system, contacts))) => {
                let (velocity, report) =
                    solver.solve_in_contact(solids, system, contacts, settings)?;
                state.node_velocity = velocity;
                Some(report)
            }
        };
        let finite = |solve: &SolveReport| solve.status != SolveStatus::NonFinite;
        let mut solves = pressure_solve.iter().chain(&solid_solve);
        self.ensure_finite("solve", solves.all(finite))?;
        clock.lap("solve");
        if let Some(system) = &pressure {
            observer(StepSystem::Pressure(system, &state.pressure));
        }
        if let Some((system, _)) = &motion {
            observer(StepSystem::Solid(system, &state.node_velocity));
        }

        if let Some(system) = &pressure {
            let (phi, floor) = (&state.liquid_distance, settings.theta_floor);
            let valid = write_back(
                system,
                &state.pressure,
                open,
                phi,
                floor,
                &mut state.velocity,
            );
            clock.lap("write_back");

            extrapolate(
                grid,
                cut,
                valid,
                n_layers(scene.time.cfl),
                &mut state.velocity,
            );
            clock.lap("extrapolate");
        }

        let liquid_report = liquid.zip(pressure).zip(pressure_solve);
        let liquid_report = liquid_report.map(|((part, system), solve)| {
            let (phi, velocity) = (&state.liquid_distance, &state.velocity);
            let density = part.liquid.density;
            let diagnosis = diagnose(cut, phi, velocity, &system.stencil, density, gravity);
            state.active = system.stencil.active_mask();
            LiquidReport {
                solve,
                closed_components: system.closed.len(),
                diagnosis,
                markers: state.markers.len(),
                dropped,
            }
        });
        let solid_report = solid.zip(matrices).zip(solid_solve);
        let solid_report = solid_report.map(|((part, matrices), solve)| {
            let (u, v) = (&state.displacement, &state.node_velocity);
            let diagnosis = diagnose_solid(&part.solids, &matrices.deformations, u, v, gravity);
            SolidReport { solve, diagnosis }
        });
        let liquid_speed = liquid_report.map(|liquid| liquid.diagnosis.max_speed);
        let solid_speed = solid_report.map(|solid| solid.diagnosis.max_speed);
        let mut speeds = liquid_speed.into_iter().chain(solid_speed);
        self.ensure_finite("diagnose", speeds.all(f64::is_finite))?;
        clock.lap("diagnose");

        state.markers_dropped += dropped;
        state.advance_clock(dt, scene.time.frames_per_second);
        self.state = state;
        Ok(StepReport {
            dt,
            dt_floored: floored,
            liquid: liquid_report,
            solid: solid_report,
            seconds_total: clock.start.elapsed().as_secs_f64(),
            seconds: clock.laps,
        })
    }

    /// What volume control asks for, given phi (m) and dt (s); nothing where the scene has none.
    fn volume_source<'a>(
        &self,
        part: &'a LiquidPart,
        liquid_distance: &[f64],
        dt: f64,
    ) -> Option<VolumeSource<'a>> {
        let volume = liquid_volume(&self.grid, &part.open_volumes, liquid_distance);
        let frame = 1.0 / self.scene.time.frames_per_second;
        let rate = volume_rate(self.state.volume_0, volume, frame, dt);
        let source = VolumeSource {
            rate,
            open_volumes: &part.open_volumes,
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

/// Whether a state and cut cells have the cells and faces of a grid.
fn fits_grid(grid: &Grid, cut: &CutCells, state: &State) -> bool {
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
    cells == [grid.n_cells(); 4] && faces == Axis::ALL.map(|axis| [grid.n_faces(axis); 2])
}

/// Wall-clock seconds of the stages.
struct Clock {
    start: Instant,
    last: Instant,
    laps: Vec<(&'static str, f64)>,
}

impl Clock {
    fn start() -> Clock {
        let now = Instant::now();
        Clock {
            start: now,
            last: now,
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
