//! One step of the f64 path, in the lines of the crate's list (thesis, algorithm 4).

use std::borrow::Cow;
use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;

use super::diagnose::larger;
use super::{
    BlockPattern, Contacts, CoupledSystem, Formulation, Lost, MovingWalls, Passed, PressureSystem,
    SQUEEZE, SolidSolver, SolidSystem, Surface, TimeStep, VolumeSource, active_cells,
    advect_markers, advect_velocity, carry_faces, diagnose, diagnose_solid, divergence,
    empty_sinks, exchanged_volume, extrapolate, forces, hold_faces, liquid_distance, liquid_volume,
    max_speed, move_solid, n_layers, node_forces, open_volumes, patch_pressure, prepare,
    pressure_gradient, right_hand_side, seed_markers, sink_markers, solid_matrices,
    solid_right_hand_side, solve, solve_coupled_in_contact, solve_damping_only, solve_weak,
    surface_distance, time_step, volume_rate, write_back,
};
use crate::Error;
use crate::effects::Effects;
use crate::elastic::Solids;
use crate::geometry::{CutCells, ObstacleCut, Running, SolidClip, Taps};
use crate::grid::{Axis, Grid};
use crate::scene::{CouplingScheme, Liquid, PatchPressure, Scene};
use crate::state::{
    ContactReport, CouplingReport, LiquidReport, SolidReport, SolveReport, SolveStatus, State,
    StepReport,
};

/// The simulator on the CPU in f64: a scene's settings and obstacles, and the state that its steps move on.
#[derive(Clone, Debug)]
pub struct Reference {
    scene: Scene,
    grid: Grid,
    cut: Cut,
    effects: Effects,
    liquid: Option<LiquidPart>,
    solid: Option<SolidPart>,
    state: State,
    /// N, three numbers per node.
    node_forces: Vec<f64>,
}

/// What bodies leave of the grid.
#[derive(Clone, Debug)]
enum Cut {
    /// Obstacles that stand still.
    Still(CutCells),
    /// With solids, or obstacles that move.
    Moving(Box<SolidClip>),
}

impl Cut {
    /// Now.
    fn now(&self) -> &CutCells {
        match self {
            Cut::Still(cut) => cut,
            Cut::Moving(clip) => clip.cut_cells(),
        }
    }

    /// Of the obstacles alone that stand still: what solids touch.
    fn obstacles(&self) -> &CutCells {
        match self {
            Cut::Still(cut) => cut,
            Cut::Moving(clip) => clip.obstacles().still(),
        }
    }

    fn clip(&self) -> Option<&SolidClip> {
        match self {
            Cut::Still(_) => None,
            Cut::Moving(clip) => Some(clip),
        }
    }

    /// Puts obstacles where they are at a time, with the velocities of the dt (both s) that follow.
    fn move_obstacles(&mut self, time: f64, dt: f64) {
        if let Cut::Moving(clip) = self {
            clip.move_obstacles(time, dt);
        }
    }
}

/// What the steps of a liquid share.
#[derive(Clone, Debug)]
struct LiquidPart {
    liquid: Liquid,
    /// m^3 per cell
    open_volumes: Vec<f64>,
    taps: Taps,
}

/// What the steps of solids share.
#[derive(Clone, Debug)]
struct SolidPart {
    solids: Solids,
    pattern: Arc<BlockPattern>,
    solver: SolidSolver,
}

/// The systems of a step.
enum Systems {
    /// Each by itself.
    Apart(Option<Box<PressureSystem>>, Option<Box<SolidSystem>>),
    /// Liquid and solids that touch.
    Coupled(Box<CoupledSystem>),
}

impl Systems {
    fn pressure(&self) -> Option<&PressureSystem> {
        match self {
            Systems::Apart(pressure, _) => pressure.as_deref(),
            Systems::Coupled(system) => Some(&system.pressure),
        }
    }
}

/// A system of a step and its answer.
#[derive(Clone, Copy, Debug)]
pub enum StepSystem<'a> {
    /// The pressure per cell, Pa.
    Pressure(&'a PressureSystem, &'a [f64]),
    /// The velocities of the nodes, m/s.
    Solid(&'a SolidSystem, &'a [[f64; 3]]),
    /// Both, where liquid and solids touch.
    Coupled(&'a CoupledSystem, &'a [f64], &'a [[f64; 3]]),
}

impl Reference {
    /// Starts from a state; the liquid of one without steps is completed by [`prepare`]. With `surface = "fixed"` its liquid
    /// distance is the exact one, and stays. `solids`: those of the scene.
    ///
    /// # Errors
    /// [`Error::Input`] where the scene has neither liquid nor solids, and where the state is not one of the scene.
    pub fn new(
        scene: &Scene,
        obstacles: ObstacleCut,
        solids: Solids,
        state: State,
    ) -> Result<Reference, Error> {
        let grid = scene.grid();
        let effects = Effects::of(scene);
        if !effects.liquid && !effects.solids {
            return Err(Error::input(
                scene.file.display().to_string(),
                "the scene has neither liquid nor solids",
                "add a [liquid] section with a region, or a [[solid]]",
            ));
        }
        let part = |liquid| {
            Ok::<_, Error>(LiquidPart {
                liquid,
                open_volumes: open_volumes(&grid, &obstacles.cut.solid_distance),
                taps: Taps::new(scene, &grid, obstacles.still())?,
            })
        };
        let liquid = scene.liquid.clone().map(part).transpose()?;
        let cut = match effects.clips() {
            false => Cut::Still(obstacles.still().clone()),
            true => Cut::Moving(Box::new(SolidClip::new(&grid, obstacles, &scene.solver))),
        };
        let solid = effects.solids.then(|| SolidPart {
            pattern: Arc::new(BlockPattern::new(&solids)),
            solver: SolidSolver::new(&solids),
            solids,
        });
        let mut reference = Reference {
            scene: scene.clone(),
            grid,
            cut,
            effects,
            liquid,
            solid,
            state: State::default(),
            node_forces: Vec::new(),
        };
        reference.reset(state)?;
        Ok(reference)
    }

    /// Goes on from another state of the scene.
    ///
    /// # Errors
    /// [`Error::Input`] where it is none.
    pub fn reset(&mut self, mut state: State) -> Result<(), Error> {
        let refused = |problem: String| {
            let file = self.scene.file.display().to_string();
            let cure = "resume with the scene and the scale that the state was made with";
            Err(Error::input(file, problem, cure))
        };
        let grid = &self.grid;
        if self.effects.liquid && !fits_grid(grid, self.cut.now(), &state) {
            return refused(format!(
                "the state does not have the scene's {:?} cells",
                grid.cells
            ));
        }
        let n_nodes = self.solid.as_ref().map_or(0, |part| part.solids.rest.len());
        if [state.displacement.len(), state.node_velocity.len()] != [n_nodes; 2] {
            return refused(format!(
                "the state does not have the {n_nodes} nodes of the scene's solids"
            ));
        }
        self.cut.move_obstacles(state.time, 0.0);
        clip(&mut self.cut, self.solid.as_ref(), &state);
        self.node_forces = vec![0.0; 3 * n_nodes];
        if state.step == 0 {
            let triangles = self
                .solid
                .as_ref()
                .map_or(&[][..], |part| &part.solids.triangles);
            let moving = self.cut.clip().map(|clip| (clip, triangles));
            prepare(&self.scene, grid, self.cut.now(), moving, &mut state);
        }
        self.state = state;
        Ok(())
    }

    /// Sources and sinks; `None` without liquid.
    pub fn taps(&self) -> Option<&Taps> {
        self.liquid.as_ref().map(|part| &part.taps)
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The state after the last step.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Forces of the liquid on the nodes in the last sub-step, N: J^T p and what pressure does that varies within cells.
    pub fn node_forces(&self) -> &[[f64; 3]] {
        self.node_forces.as_chunks().0
    }

    /// What obstacles, and solids in liquid, leave of the grid.
    pub fn cut_cells(&self) -> &CutCells {
        self.cut.now()
    }

    /// Solids in liquid and obstacles that move, as they cut the grid.
    pub fn clip(&self) -> Option<&SolidClip> {
        self.cut.clip()
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
        let obstacles = self.cut.clip().map(SolidClip::obstacles);
        let obstacle_speed = obstacles.map_or(0.0, |cut| cut.max_speed(state.time, left));
        let speed = larger(max_speed(&state.velocity), solid_speed.max(obstacle_speed));
        let taps = self.liquid.as_ref().map(|part| &part.taps);
        let sources = taps.map_or(0.0, |taps| taps.speed(state.time, scene.time.cfl));
        let speed = larger(speed, sources);
        // Later keyframes of scripts are in the velocities of their nodes.
        let scripts = match (&self.solid, state.step) {
            (Some(part), 0) => part.solids.max_script_speed(state.time, left),
            _ => 0.0,
        };
        let speed = larger(speed, scripts);
        time_step(&scene.time, grid.dx, speed, fall, left, state.dt_last)
    }

    /// Does one sub-step. After an error the state is the one before.
    pub fn step(&mut self, time_step: TimeStep) -> Result<StepReport, Error> {
        self.step_observed(time_step, &mut |_| {})
    }

    /// Does one sub-step, and tells of the systems solved and their answers.
    pub fn step_observed(
        &mut self,
        time_step: TimeStep,
        observer: &mut dyn FnMut(StepSystem),
    ) -> Result<StepReport, Error> {
        let nothing = Cut::Still(CutCells {
            open: Default::default(),
            solid_distance: Vec::new(),
        });
        let mut cut = std::mem::replace(&mut self.cut, nothing);
        let stepped = self.stages(time_step, &mut cut, observer);
        if stepped.is_err() {
            cut.move_obstacles(self.state.time, 0.0);
            clip(&mut cut, self.solid.as_ref(), &self.state);
        }
        self.cut = cut;
        let (state, report, node_forces) = stepped?;
        (self.state, self.node_forces) = (state, node_forces);
        Ok(report)
    }

    /// The stages of a sub-step: the state after it, `cut` with it, and the forces of the liquid on the nodes, N.
    fn stages(
        &self,
        TimeStep { dt, floored }: TimeStep,
        cut: &mut Cut,
        observer: &mut dyn FnMut(StepSystem),
    ) -> Result<(State, StepReport, Vec<f64>), Error> {
        let (scene, grid) = (&self.scene, &self.grid);
        let (settings, gravity) = (&scene.solver, scene.domain.gravity);
        let (liquid, solid) = (self.liquid.as_ref(), self.solid.as_ref());
        let before = &self.state;
        let mut state = before.clone();
        let mut clock = Clock::start();

        let mut moved_with = Vec::new();
        if let Some(SolidPart { solids, .. }) = solid {
            let State {
                displacement,
                node_velocity,
                ..
            } = &mut state;
            if before.step == 0 {
                solids.start_scripts(displacement, node_velocity, dt);
            }
            if settings.coupling == CouplingScheme::Weak {
                moved_with.clone_from(node_velocity);
            }
            move_solid(solids, grid, dt, displacement, node_velocity);
            clock.lap("move_solid");
        }

        if self.effects.clips() {
            cut.move_obstacles(before.time + dt, dt);
            clip(cut, solid, &state);
            clock.lap("clip");
        }
        let (clip, obstacles, cut) = (cut.clip(), cut.obstacles(), cut.now());
        let (open, solid_distance) = (&cut.open, &cut.solid_distance);

        let mut lost = Lost::default();
        let mut exchange = None;
        let mut running = Running::default();
        if let Some(LiquidPart { liquid, taps, .. }) = liquid {
            // Without markers nobody asks where the surface is.
            let distance = if before.markers.is_empty() {
                Vec::new()
            } else {
                surface_distance(grid, solid_distance, &before.liquid_distance)
            };
            let surface = Surface {
                distance: &distance,
                radius: liquid.marker_radius * grid.dx,
            };
            (state.markers, lost) = advect_markers(
                grid,
                scene.domain.open,
                &before.velocity,
                solid_distance,
                &surface,
                &before.markers,
                dt,
            );
            clock.lap("advect_markers");

            if self.effects.exchange() {
                running = taps.running(before, liquid.seed);
                let (markers, sunk) = sink_markers(grid, taps, std::mem::take(&mut state.markers));
                state.markers = markers;
                let passed = Passed {
                    left: lost.left,
                    sunk,
                    kept: state.markers.len(),
                    seeded: seed_markers(grid, taps, running, solid_distance, &mut state.markers),
                };
                let inflow = dt * taps.flux(running.running);
                let (volumes, of_step) = exchanged_volume(grid, before.volume_0, inflow, passed);
                state.volume_0 = volumes[0];
                state.markers_left += of_step.left;
                state.markers_sunk += of_step.sunk;
                state.markers_emitted += of_step.emitted;
                state.sources_running = running.running.into();
                exchange = Some((of_step, volumes[1]));
                if self.effects.sources || self.effects.sinks {
                    clock.lap("exchange");
                }
            }

            state.velocity = advect_velocity(grid, open, &before.velocity, dt);
            clock.lap("advect_velocity");
        }

        if let Some(LiquidPart { taps, .. }) = liquid {
            forces(&mut state.velocity, gravity, dt);
            hold_faces(taps, open, running.running, &mut state.velocity);
        }
        if let Some(SolidPart { solids, .. }) = solid {
            let prescribed = solids.prescribed_velocity(&state.displacement, before.time + dt, dt);
            node_forces(solids, &prescribed, gravity, dt, &mut state.node_velocity);
        }
        clock.lap("forces");

        // Faces that sources hold are closed for the pressure.
        let held_open = liquid
            .filter(|_| self.effects.sources)
            .map(|part| part.taps.held_open(open, running.running));
        let open_to_pressure = held_open.as_ref().unwrap_or(open);
        let flux_open = liquid
            .filter(|_| self.effects.sources)
            .map(|part| part.taps.flux_open(open, running.running));
        let open_to_flux = flux_open.as_ref().unwrap_or(open);
        let active = liquid.map(|LiquidPart { liquid, taps, .. }| {
            if self.effects.markers {
                let radius = liquid.marker_radius * grid.dx;
                state.liquid_distance = liquid_distance(grid, cut, &state.markers, radius);
                empty_sinks(taps, grid.dx, &mut state.liquid_distance);
            }
            clock.lap("liquid_distance");

            let mut active = active_cells(
                grid,
                open_to_pressure,
                &state.liquid_distance,
                settings.theta_floor,
            );
            if let Some((clip, part)) = clip.zip(solid) {
                active.seal(clip.coupling(), &part.solids.prescribed);
            }
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

        let mut coupling = CouplingReport::default();
        let mut node_forces = vec![0.0; 3 * before.displacement.len()];
        let pressure = liquid.zip(active).map(|(part, active)| {
            let open_volumes = match clip {
                None => Cow::Borrowed(&part.open_volumes),
                Some(_) => Cow::Owned(open_volumes(grid, solid_distance)),
            };
            let source = self.volume_source(&open_volumes, &state, dt);
            let rhs = right_hand_side(grid, open_to_flux, &state.velocity, &active, source);
            let system = PressureSystem::new(active, rhs, dt, part.liquid.density);
            let obstacles = clip.map_or(&[][..], |clip| clip.obstacles().flux());
            let sources = part.taps.taken(grid, Some(open), running.running);
            let system = match obstacles {
                [] => system,
                flux => system.beside_obstacles(flux),
            };
            system.with_taken(obstacles.iter().copied().chain(sources))
        });
        let motion = solid.zip(matrices.as_ref()).map(|(part, matrices)| {
            let SolidPart { solids, .. } = part;
            let mut rhs = solid_right_hand_side(solids, matrices, &state.node_velocity, dt);
            if let Some((clip, pressure)) = clip.zip(pressure.as_ref()) {
                let forces = self.patch_correction(clip, pressure, solids);
                coupling.correction = forces.iter().copied().sum::<DVec3>().to_array();
                for (sum, force) in node_forces.as_chunks_mut::<3>().0.iter_mut().zip(&forces) {
                    *sum = force.to_array();
                }
                rhs.add(solids, &forces);
            }
            let State {
                displacement,
                node_velocity,
                ..
            } = &mut state;
            let of_obstacles = &obstacles.solid_distance;
            let contacts = Contacts::new(solids, grid, of_obstacles, displacement, &rhs.values, dt);
            let freedom = contacts.hold(node_velocity);
            let stiffness = matrices.stiffness.clone();
            let system = SolidSystem::new(solids, stiffness, &rhs, node_velocity, freedom, dt);
            (system, contacts)
        });
        clock.lap("right_hand_side");

        let (systems, [pressure_solve, solid_solve], contact) =
            self.solve(clip, pressure, motion, &moved_with, &mut state)?;
        let finite = |solve: &SolveReport| solve.status != SolveStatus::NonFinite;
        let mut solves = pressure_solve.iter().chain(&solid_solve);
        self.ensure_finite("solve", solves.all(finite))?;
        clock.lap("solve");
        match &systems {
            Systems::Apart(pressure, motion) => {
                if let Some(system) = pressure {
                    observer(StepSystem::Pressure(system, &state.pressure));
                }
                if let Some(system) = motion {
                    observer(StepSystem::Solid(system, &state.node_velocity));
                }
            }
            Systems::Coupled(system) => {
                let (pressure, velocity) = (&state.pressure, &state.node_velocity);
                observer(StepSystem::Coupled(system, pressure, velocity));
            }
        }
        if let Some((clip, system)) = clip.zip(systems.pressure()) {
            let mut force = vec![0.0; state.node_velocity.as_flattened().len()];
            clip.coupling().add_transposed(&state.pressure, &mut force);
            let nodes = force.chunks_exact(3).map(DVec3::from_slice);
            coupling.force = nodes.sum::<DVec3>().to_array();
            let sums = node_forces.iter_mut().zip(&force);
            sums.for_each(|(sum, force)| *sum += force);
            coupling.touching = touches(clip, system);
            coupling.condensed = matches!(
                &systems,
                Systems::Coupled(both) if Formulation::of(both) == Formulation::Condensed
            );
        }

        let mut left = 0.0;
        if let Some(system) = systems.pressure() {
            let (phi, floor) = (&state.liquid_distance, settings.theta_floor);
            let mut valid = write_back(
                system,
                &state.pressure,
                open_to_pressure,
                phi,
                floor,
                &mut state.velocity,
            );
            if let Some(LiquidPart { taps, .. }) = liquid {
                carry_faces(taps, open, running.running, &mut state.velocity, &mut valid);
            }

            let flux = clip.map(|clip| {
                let mut flux = vec![0.0; grid.n_cells()];
                clip.coupling()
                    .add_product(state.node_velocity.as_flattened(), &mut flux);
                for &(cell, taken) in clip.obstacles().flux() {
                    flux[cell] += taken;
                }
                flux
            });
            let (velocity, stencil) = (&state.velocity, &system.stencil);
            left = divergence(open_to_flux, velocity, stencil, flux.as_deref());
            clock.lap("write_back");

            let walls = clip.map(|clip| MovingWalls {
                clip,
                triangles: solid.map_or(&[], |part| &part.solids.triangles),
                velocity: &state.node_velocity,
            });
            let layers = n_layers(scene.time.cfl);
            extrapolate(grid, cut, walls, valid, layers, &mut state.velocity);
            clock.lap("extrapolate");
        }

        let liquid_report = liquid.zip(systems.pressure()).zip(pressure_solve);
        let liquid_report = liquid_report.map(|((part, system), solve)| {
            let (phi, velocity) = (&state.liquid_distance, &state.velocity);
            let density = part.liquid.density;
            let diagnosis = diagnose(grid, cut, phi, velocity, left, density, gravity);
            state.active = system.stencil.active_mask();
            LiquidReport {
                solve,
                closed_components: system.closed.len(),
                diagnosis,
                markers: state.markers.len(),
                dropped: lost.dropped,
                exchange: exchange.map(|(exchange, _)| exchange),
            }
        });
        let solid_report = solid.zip(matrices).zip(solid_solve);
        let solid_report = solid_report.map(|((part, matrices), solve)| {
            let (u, v) = (&state.displacement, &state.node_velocity);
            let diagnosis = diagnose_solid(&part.solids, &matrices.deformations, u, v, gravity);
            SolidReport {
                solve,
                contact,
                diagnosis,
            }
        });
        let liquid_speed = liquid_report.map(|liquid| liquid.diagnosis.max_speed);
        let solid_speed = solid_report.map(|solid| solid.diagnosis.max_speed);
        let mut speeds = liquid_speed.into_iter().chain(solid_speed);
        self.ensure_finite("diagnose", speeds.all(f64::is_finite))?;
        clock.lap("diagnose");

        if let Some((_, volume_0)) = exchange {
            state.volume_0 = volume_0;
        }
        state.markers_dropped += lost.dropped;
        state.advance_clock(dt, scene.time.frames_per_second);
        let of_both = clip.filter(|_| self.effects.coupling);
        let coupling = of_both.map(|clip| CouplingReport {
            overlap_cells: clip.overlap().cells,
            overlap_depth: clip.overlap().depth,
            ..coupling
        });
        let report = StepReport {
            dt,
            dt_floored: floored,
            liquid: liquid_report,
            solid: solid_report,
            coupling,
            seconds_total: clock.start.elapsed().as_secs_f64(),
            seconds: clock.laps,
        };
        Ok((state, report, node_forces))
    }

    /// Solves for the pressure and the velocities of the nodes, which go into the state; `moved_with`: velocities before the sub-step, m/s, for
    /// weak coupling. The systems as they were solved at last, and the reports of both and of contact.
    fn solve(
        &self,
        clip: Option<&SolidClip>,
        pressure: Option<PressureSystem>,
        motion: Option<(SolidSystem, Contacts)>,
        moved_with: &[[f64; 3]],
        state: &mut State,
    ) -> Result<(Systems, [Option<SolveReport>; 2], ContactReport), Error> {
        let (settings, part) = (&self.scene.solver, self.solid.as_ref());
        let touched = clip
            .zip(pressure.as_ref())
            .filter(|(clip, pressure)| touches(clip, pressure))
            .map(|(clip, _)| clip);
        match (touched, pressure, motion, part) {
            (Some(clip), Some(mut pressure), Some((mut solid, mut contacts)), Some(part)) => {
                let SolidPart { solids, solver, .. } = part;
                let coupling = clip.coupling();
                let strong = match settings.coupling {
                    CouplingScheme::Strong => solve_coupled_in_contact,
                    CouplingScheme::DampingOnly => solve_damping_only,
                    CouplingScheme::Weak => {
                        let mut contact = ContactReport::default();
                        let solution = solve_weak(
                            &mut pressure,
                            &mut solid,
                            coupling,
                            moved_with,
                            settings,
                            |solid| {
                                let (velocity, report, found) = solver.solve_in_contact(
                                    solids,
                                    solid,
                                    &mut contacts,
                                    settings,
                                )?;
                                contact = found;
                                Ok((velocity, report))
                            },
                        )?;
                        (state.pressure, state.node_velocity) =
                            (solution.pressure, solution.velocity);
                        let [of_pressure, of_solid] = solution.reports;
                        let of_pressure =
                            or_incompatible(of_pressure, pressure.squeezed(&pressure.closed, None));
                        let systems = Systems::Apart(Some(pressure.into()), Some(solid.into()));
                        return Ok((systems, [of_pressure, of_solid].map(Some), contact));
                    }
                };
                let (system, solution, contact) = strong(
                    &pressure,
                    &mut solid,
                    coupling,
                    &mut contacts,
                    solver,
                    solids,
                    settings,
                )?;
                (state.pressure, state.node_velocity) = (solution.pressure, solution.velocity);
                let reports = solution.reports;
                let reports = reports.map(|report| Some(or_incompatible(report, system.squeezed)));
                Ok((Systems::Coupled(Box::new(system)), reports, contact))
            }
            (_, pressure, motion, part) => {
                let mut reports = [None; 2];
                let mut contact = ContactReport::default();
                if let Some(system) = &pressure {
                    let (pressure, report) = solve(system, settings)?;
                    state.pressure = pressure;
                    reports[0] = Some(or_incompatible(
                        report,
                        system.squeezed(&system.closed, None),
                    ));
                }
                let mut solved = None;
                if let Some(((mut system, mut contacts), part)) = motion.zip(part) {
                    let SolidPart { solids, solver, .. } = part;
                    let (velocity, report, found) =
                        solver.solve_in_contact(solids, &mut system, &mut contacts, settings)?;
                    state.node_velocity = velocity;
                    (reports[1], contact) = (Some(report), found);
                    solved = Some(Box::new(system));
                }
                let systems = Systems::Apart(pressure.map(Box::new), solved);
                Ok((systems, reports, contact))
            }
        }
    }

    /// Forces of the pressure's variation within cells on all nodes, N; none where the scene has no such effect.
    fn patch_correction(
        &self,
        clip: &SolidClip,
        pressure: &PressureSystem,
        solids: &Solids,
    ) -> Vec<DVec3> {
        let Some(LiquidPart { liquid, .. }) = self
            .liquid
            .as_ref()
            .filter(|_| self.effects.patch_correction)
        else {
            return Vec::new();
        };
        let at_rest = liquid.density * self.scene.domain.gravity;
        let (before, open) = (&self.state, &clip.cut_cells().open);
        let forces = |gradient: &dyn Fn(usize) -> DVec3| {
            let (stencil, triangles) = (&pressure.stencil, &solids.triangles);
            patch_pressure(
                stencil,
                clip.patches(),
                triangles,
                solids.rest.len(),
                gradient,
            )
        };
        match self.scene.solver.pressure_on_patches {
            PatchPressure::Cell => Vec::new(),
            PatchPressure::Hydrostatic => forces(&|_| at_rest),
            PatchPressure::Gradient => forces(&|cell| {
                let (grid, active) = (&self.grid, &before.active);
                pressure_gradient(grid, open, active, &before.pressure, at_rest, cell)
            }),
        }
    }

    /// What volume control asks for, given phi (m), the volume to hold (m^3) and dt (s); nothing where the scene has none.
    fn volume_source<'a>(
        &self,
        open_volumes: &'a [f64],
        state: &State,
        dt: f64,
    ) -> Option<VolumeSource<'a>> {
        let volume = liquid_volume(&self.grid, open_volumes, &state.liquid_distance);
        let frame = 1.0 / self.scene.time.frames_per_second;
        let rate = volume_rate(state.volume_0, volume, frame, dt);
        let source = VolumeSource { rate, open_volumes };
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

/// `clip`: what solids in liquid leave of the grid where a state puts them.
fn clip(cut: &mut Cut, solid: Option<&SolidPart>, state: &State) {
    if let (Cut::Moving(clip), Some(SolidPart { solids, .. })) = (cut, solid) {
        clip.clip(&solids.moved(&state.displacement));
    }
}

/// Whether a patch lies in a cell that is an unknown.
fn touches(clip: &SolidClip, pressure: &PressureSystem) -> bool {
    let mut cells = clip.coupling().cells();
    cells.any(|(cell, _)| pressure.stencil.active(cell))
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

/// The report, or that a prescribed motion or a source asks too much: `squeezed` is its share.
fn or_incompatible(report: SolveReport, squeezed: f64) -> SolveReport {
    let status = match report.status {
        SolveStatus::Converged if squeezed > SQUEEZE => SolveStatus::Incompatible,
        status => status,
    };
    SolveReport { status, ..report }
}
