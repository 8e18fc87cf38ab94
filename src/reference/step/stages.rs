//! The stages of a sub-step but for the solve, each named as in the schedule.

use std::borrow::Cow;

use super::SubStep;
use crate::Error;
use crate::elastic::Solids;
use crate::reference::{
    ActiveCells, Ballistic, CavityMotion, Contacts, MovingWalls, Passed, PatchForces, PressureSystem, RightHandSide,
    SolidSystem, Surface, TimeStep, VolumeSource, active_cells, advect_markers, advect_velocity,
    advect_velocity_maccormack, ballistic_bodies, ballistic_cells, carry_faces, diagnose_liquid, diagnose_solid,
    divergence, empty_sinks, exchanged_volume, extrapolate_one_sided, fill_cavities, forces, hold_faces,
    hold_near_others, liquid_distance, liquid_volume, move_solid, n_layers, node_forces, open_volumes, patch_pressure,
    pressure_gradient, rewind_sources, right_hand_side, seed_markers, sink_markers, solid_matrices,
    solid_right_hand_side, surface_distance, volume_rate, wet_nodes, write_back,
};
use crate::scene::{CouplingScheme, PatchPressure};
use crate::state::{LiquidReport, SolidReport};
use crate::step::Stage;

impl SubStep<'_> {
    pub(super) fn move_solid(&mut self) {
        let Some(solids) = self.solids() else { return };
        let dt = self.time_step.dt;
        if let (true, Some(obstacles)) = (self.model.effects.pushing_obstacles, &mut self.obstacles) {
            obstacles.move_to(self.before.time + dt, dt);
        }
        let ballistic = self.ballistic_bodies(solids);
        let after = &mut self.after;
        let (displacement, velocity) = (&mut after.displacement, &mut after.node_velocity);
        if self.before.step == 0 {
            solids.start_scripts(displacement, velocity, dt);
        }
        if self.model.scene.solver.coupling == CouplingScheme::Weak {
            self.results.velocity_before.clone_from(velocity);
        }
        let falls = (self.model.scene.domain.gravity, &*ballistic);
        move_solid(solids, &self.model.grid, dt, falls, displacement, velocity);
    }

    fn ballistic_bodies(&self, solids: &Solids) -> Vec<bool> {
        let (n, before) = (solids.rest.len(), self.before);
        let wet = match (self.boundary.clip(), self.model.effects.liquid) {
            (Some(clip), true) => wet_nodes(clip.coupling(), &before.filled(), n),
            _ => vec![false; n],
        };
        let distance = match (self.model.effects.obstacles, &self.obstacles) {
            (true, Some(obstacles)) => &*obstacles.distance,
            _ => &[],
        };
        let falling = (self.model.scene.domain.gravity, self.time_step.dt);
        let (u, v) = (&before.displacement, &before.node_velocity);
        let mut ballistic = ballistic_bodies(solids, &self.model.grid, distance, &wet, falling, u, v);
        if self.model.effects.solid_contact {
            hold_near_others(solids, self.model.grid.dx, self.time_step.dt, u, v, &mut ballistic);
        }
        ballistic
    }

    pub(super) fn clip(&mut self) {
        let (dt, displacement) = (self.time_step.dt, &self.after.displacement);
        let time = self.before.time + dt;
        self.boundary.update(self.solids(), displacement, time, dt);
        if let Some(clip) = self.boundary.clip() {
            self.results.coupling.overlap_cells = clip.overlap().cells;
            self.results.coupling.overlap_depth = clip.overlap().depth;
        }
    }

    pub(super) fn advect_markers(&mut self) {
        let Some(liquid) = self.liquid() else { return };
        if self.model.effects.level {
            return self.advect_level_markers();
        }
        let (grid, before) = (&self.model.grid, self.before);
        let solid_distance = &self.boundary.cut_cells().solid_distance;
        // Without markers the surface has no use.
        let distance = match before.markers.is_empty() {
            true => Vec::new(),
            false => surface_distance(grid, solid_distance, &before.liquid_distance),
        };
        let surface = Surface { distance: &distance, radius: liquid.marker_radius * grid.dx };
        (self.after.markers, self.results.removed_markers) = advect_markers(
            grid,
            self.model.scene.domain.open,
            &before.velocity,
            solid_distance,
            &surface,
            &self.ballistic(&before.filled()),
            &before.markers,
            self.time_step.dt,
        );
        let effects = &self.model.effects;
        // Sources and sinks have a stage of their own, which counts these markers too.
        if effects.open_sides && !effects.sources && !effects.sinks {
            self.exchange();
        }
    }

    pub(super) fn exchange(&mut self) {
        if self.model.effects.level {
            return self.exchange_level();
        }
        let (grid, taps, sources) = (&self.model.grid, &self.model.taps, self.sources);
        let (cut, after) = (self.boundary.cut_cells(), &mut self.after);
        let (mut markers, sunk) = sink_markers(grid, taps, std::mem::take(&mut after.markers));
        let passed = Passed {
            left: self.results.removed_markers.left,
            sunk,
            kept: markers.len(),
            seeded: seed_markers(grid, taps, sources, &cut.solid_distance, &mut markers),
        };
        let inflow = self.time_step.dt * taps.flux(sources.running);
        let (volumes, exchange) = exchanged_volume(grid, after.volume_0, inflow, passed);
        (after.volume_0, self.results.volume_0_next) = (volumes[0], Some(volumes[1]));
        after.markers = markers;
        after.markers_left += exchange.left;
        after.markers_sunk += exchange.sunk;
        after.markers_emitted += exchange.emitted;
        after.sources_running = sources.running.into();
        self.results.exchange = exchange;
        self.open_sources();
    }

    /// Apertures of the faces of running sources.
    pub(super) fn open_sources(&mut self) {
        let (taps, sources) = (&self.model.taps, self.sources);
        let cut = self.boundary.cut_cells();
        self.results.source_apertures = self.model.effects.sources.then(|| {
            let (open, running) = (&cut.open, sources.running);
            [taps.pressure_apertures(open, running), taps.flux_apertures(open, running)]
        });
    }

    pub(super) fn advect_velocity(&mut self) {
        let open = &self.boundary.cut_cells().open;
        let (filled, grid) = (self.before.filled(), &self.model.grid);
        let mut velocity = Cow::Borrowed(&self.before.velocity);
        if self.model.effects.maccormack && self.model.effects.sources {
            let fall = 0.5 * self.time_step.dt * self.model.scene.domain.gravity;
            rewind_sources(&self.model.taps, open, self.sources.running, fall, velocity.to_mut());
        }
        let ballistic = self.ballistic(&filled);
        let TimeStep { dt, courant, .. } = self.time_step;
        self.after.velocity = if self.model.effects.maccormack {
            advect_velocity_maccormack(grid, open, &velocity, &ballistic, [dt, courant])
        } else {
            advect_velocity(grid, open, &velocity, &ballistic, dt)
        };
    }

    /// Liquid that touched nothing in the last solve.
    pub(super) fn ballistic<'f>(&'f self, filled: &'f [bool]) -> Ballistic<'f> {
        let gravity = self.model.scene.domain.gravity;
        Ballistic::new(filled, &self.before.ballistic, gravity, self.time_step.dt)
    }

    pub(super) fn forces(&mut self) {
        let (dt, gravity) = (self.time_step.dt, self.model.scene.domain.gravity);
        let after = &mut self.after;
        if self.model.effects.liquid {
            let (taps, open) = (&self.model.taps, &self.boundary.cut_cells().open);
            forces(&mut after.velocity, gravity, dt);
            hold_faces(taps, open, self.sources.running, &mut after.velocity);
        }
        if let Some(solids) = self.model.solids() {
            let time = self.before.time + dt;
            let prescribed = solids.prescribed_velocity(&after.displacement, time, dt);
            node_forces(solids, &prescribed, gravity, dt, &mut after.node_velocity);
        }
    }

    pub(super) fn liquid_distance(&mut self) {
        let Some(liquid) = self.liquid() else { return };
        if self.model.effects.level {
            return self.level_distance();
        }
        if self.model.effects.markers {
            let (grid, cut) = (&self.model.grid, self.boundary.cut_cells());
            let radius = liquid.marker_radius * grid.dx;
            let mut distance = liquid_distance(grid, cut, &self.after.markers, radius);
            empty_sinks(&self.model.taps, grid.dx, &mut distance);
            self.after.liquid_distance = distance;
        }
    }

    pub(super) fn active_cells(&mut self) {
        let (grid, floor) = (&self.model.grid, self.model.scene.solver.theta_floor);
        let phi = &self.after.liquid_distance;
        let mut active = active_cells(grid, self.apertures()[0], phi, floor);
        if let Some((clip, solids)) = self.boundary.clip().zip(self.solids()) {
            active.seal(clip.coupling(), &solids.prescribed);
        }
        self.after.active = active.stencil.active_mask();
        if self.model.effects.markers {
            self.after.ballistic = ballistic_cells(self.apertures()[0], &active.stencil);
        }
        self.results.active = Some(active);
    }

    pub(super) fn solid_matrices(&mut self) {
        let displacement = &self.after.displacement;
        let solid = self.model.solid.as_ref();
        self.results.matrices = solid.map(|part| solid_matrices(&part.solids, &part.pattern, displacement));
    }

    pub(super) fn right_hand_side(&mut self) {
        self.results.pressure = self.pressure_system();
        self.results.solid = self.solid_system();
    }

    fn pressure_system(&mut self) -> Option<PressureSystem> {
        let (liquid, active) = (self.liquid()?, self.results.active.take()?);
        let dt = self.time_step.dt;
        let (grid, taps, after) = (&self.model.grid, &self.model.taps, &self.after);
        let cut = self.boundary.cut_cells();
        let open_volumes = &open_volumes(grid, &cut.solid_distance);
        let source = self.model.effects.volume_control.then(|| {
            let volume = liquid_volume(grid, open_volumes, &after.liquid_distance);
            let control_time = self.time_step.control_time;
            let rate = volume_rate(after.volume_0, volume, control_time, dt);
            VolumeSource { rate, open_volumes }
        });
        let mut rhs = right_hand_side(grid, self.apertures()[1], &after.velocity, &active, source);
        self.add_excess(open_volumes, &active, &mut rhs);
        let cavity_volume = self.fill_cavities(open_volumes, &active, &mut rhs);
        let system = PressureSystem::new(active, rhs, dt, liquid.density);
        let obstacles = self.boundary.moving_obstacles();
        let obstacles = obstacles.map_or(&[][..], |obstacles| obstacles.flux());
        let system = match obstacles {
            [] => system,
            flux => system.beside_obstacles(flux),
        };
        let sources = taps.boundary_flux(grid, Some(&cut.open), self.sources.running);
        let system = system.with_taken(obstacles.iter().copied().chain(sources));
        self.after.cavity_volume = cavity_volume;
        Some(system)
    }

    /// Adds the sources of the liquid that fills cavities to the right-hand side. Returns the targets of the cavities, m^3.
    fn fill_cavities(&self, open_volumes: &[f64], active: &ActiveCells, rhs: &mut RightHandSide) -> Vec<f64> {
        let Some((solid, clip)) = self.model.solid.as_ref().zip(self.boundary.clip()) else {
            return Vec::new();
        };
        let volumes = solid.cavities.volumes(&solid.solids, &self.after.displacement);
        let motion = CavityMotion { volumes: &volumes, targets: &self.before.cavity_volume, dt: self.time_step.dt };
        fill_cavities(&solid.cavities, clip.coupling(), active, motion, open_volumes, rhs)
    }

    fn solid_system(&mut self) -> Option<(SolidSystem, Contacts)> {
        let (solids, matrices) = (self.solids()?, self.results.matrices.as_ref()?);
        let obstacles = self.obstacles.as_deref()?;
        let dt = self.time_step.dt;
        self.results.patch_forces = self.patch_forces(solids);
        let (displacement, velocity) = (&self.after.displacement, &mut self.after.node_velocity);
        let mut rhs = solid_right_hand_side(solids, matrices, velocity, dt);
        rhs.add(solids, &self.results.patch_forces.sum_over(|_| true));
        let contacts = Contacts::new(solids, obstacles, displacement, &rhs.values, dt);
        let contacts = match self.model.effects.solid_contact {
            true => contacts.none_active(),
            false => contacts,
        };
        let freedom = contacts.hold(velocity);
        let stiffness = matrices.stiffness.clone();
        let system = SolidSystem::new(solids, stiffness, &rhs, velocity, freedom, dt);
        Some((system, contacts))
    }

    /// Forces on all nodes by the variation of the pressure within cells; none without that effect.
    fn patch_forces(&self, solids: &Solids) -> PatchForces {
        let (scene, before) = (&self.model.scene, self.before);
        let (clip, system) = (self.boundary.clip(), self.results.pressure.as_ref());
        let bodies = clip.zip(system).zip(self.liquid());
        let bodies = bodies.filter(|_| self.model.effects.patch_correction);
        let Some(((clip, system), liquid)) = bodies else {
            return PatchForces::default();
        };
        let at_rest = liquid.density * scene.domain.gravity;
        let (grid, open) = (&self.model.grid, &clip.cut_cells().open);
        let gradient = |cell| match scene.solver.pressure_on_patches {
            PatchPressure::Cell | PatchPressure::Hydrostatic => at_rest,
            PatchPressure::Gradient => {
                let (active, pressure) = (&before.active, &before.pressure);
                pressure_gradient(grid, open, active, pressure, at_rest, cell)
            }
        };
        let (patches, triangles) = (clip.patches(), &solids.triangles);
        let n_nodes = solids.rest.len();
        patch_pressure(&system.stencil, patches, triangles, n_nodes, gradient)
    }

    pub(super) fn write_back(&mut self) {
        let Some(system) = &self.results.pressure else {
            return;
        };
        let mut velocity = std::mem::take(&mut self.after.velocity);
        let [pressure_aperture, flux_aperture] = self.apertures();
        let mut valid = write_back(
            system,
            &self.after.pressure,
            pressure_aperture,
            &self.after.liquid_distance,
            self.model.scene.solver.theta_floor,
            &mut velocity,
        );
        let (open, running) = (&self.boundary.cut_cells().open, self.sources.running);
        carry_faces(&self.model.taps, open, running, &mut velocity, &mut valid);
        let flux = self.boundary.clip().map(|clip| {
            let mut flux = vec![0.0; self.model.grid.n_cells()];
            clip.coupling().add_product(self.after.node_velocity.as_flattened(), &mut flux);
            for &(cell, taken) in clip.obstacles().flux() {
                flux[cell] += taken;
            }
            flux
        });
        // Separated cells open.
        let separation = self.results.separation.as_ref();
        let masked = separation.map(|separation| system.stencil.masked(separation.cells()));
        let (stencil, flux) = (masked.as_ref().unwrap_or(&system.stencil), flux.as_deref());
        self.results.divergence = divergence(flux_aperture, &velocity, stencil, flux);
        (self.after.velocity, self.results.valid) = (velocity, valid);
    }

    pub(super) fn extrapolate(&mut self) {
        let model = self.model;
        let walls = self.boundary.clip().map(|clip| MovingWalls {
            clip,
            triangles: model.triangles(),
            velocity: &self.after.node_velocity,
        });
        let valid = std::mem::take(&mut self.results.valid);
        let layers = n_layers(model.scene.time.cfl);
        let (cut, velocity) = (self.boundary.cut_cells(), &mut self.after.velocity);
        let largest = match model.effects.maccormack {
            true => self.time_step.largest_slope(model.grid.dx),
            false => 0.0,
        };
        let held = self.results.separation.as_ref().map(|separation| {
            let pairs = self.after.active.iter().zip(separation.cells());
            pairs.map(|(active, separated)| *active && !*separated).collect::<Vec<_>>()
        });
        let (walls, extent) = ((walls, held.as_deref()), (layers, largest));
        extrapolate_one_sided(&model.grid, cut, walls, valid, extent, velocity);
    }

    pub(super) fn diagnose(&mut self) -> Result<(), Error> {
        let (liquid, solid) = (self.liquid_report(), self.solid_report());
        let liquid_speed = liquid.map(|report| report.diagnosis.max_speed);
        let solid_speed = solid.map(|report| report.diagnosis.max_speed);
        (self.results.liquid_report, self.results.solid_report) = (liquid, solid);
        let mut speeds = liquid_speed.into_iter().chain(solid_speed);
        self.ensure_finite(Stage::Diagnose, speeds.all(f64::is_finite))
    }

    fn liquid_report(&self) -> Option<LiquidReport> {
        let (results, after) = (&self.results, &self.after);
        Some(LiquidReport {
            solve: results.solves[0]?,
            closed_components: results.pressure.as_ref()?.closed.len(),
            diagnosis: diagnose_liquid(&self.model.scene, self.boundary.cut_cells(), after, results.divergence)?,
            markers: after.markers.len(),
            dropped: results.removed_markers.dropped,
            exchange: (self.model.effects.exchange()).then_some(results.exchange),
            separation: (results.separation.as_ref()).map(|separation| separation.report(self.time_step.dt)),
        })
    }

    fn solid_report(&self) -> Option<SolidReport> {
        let (solids, results) = (self.solids()?, &self.results);
        let deformations = &results.matrices.as_ref()?.deformations;
        let (u, v) = (&self.after.displacement, &self.after.node_velocity);
        Some(SolidReport {
            solve: results.solves[1]?,
            contact: results.contact,
            diagnosis: diagnose_solid(solids, deformations, u, v, self.model.scene.domain.gravity),
        })
    }

    /// Apertures of the faces for the pressure and for fluxes.
    fn apertures(&self) -> [&[Vec<f64>; 3]; 2] {
        let open = &self.boundary.cut_cells().open;
        let apertures = self.results.source_apertures.as_ref();
        apertures.map_or([open; 2], |apertures| apertures.each_ref())
    }
}
