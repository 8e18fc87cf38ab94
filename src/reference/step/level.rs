//! The stages of a level set.

use glam::DVec3;

use super::SubStep;
use crate::geometry::MARKERS_PER_CELL;
use crate::grid::Axis;
use crate::reference::level_cells::in_cells;
use crate::reference::marker_band::cell_of;
use crate::reference::{
    ActiveCells, Before, Components, LevelCells, Levels, Markers, RightHandSide, add_excess,
    advect_level, advect_level_markers, balance, bound_level, component_origins, empty_sinks,
    excess, extend_level, fill_sources, filled, filter_level, liquid_components, marker_band,
    move_spray_volume, occupancy, open_volumes, redistance, seed_markers, shared_volumes, spray,
    thin_liquid, volume_shift,
};
use crate::state::State;

/// Largest relative difference between the target and the volume of a component in a domain with open sides. The flux through
/// them and the transport of the level differ a little, which would add up in the last liquid of a tank.
const LARGEST_DIFFERENCE: f64 = 0.1;

/// Results of the stages of the level, per cell but for the last.
#[derive(Default)]
pub(super) struct LevelResults {
    /// Level after its transport, cells.
    carried: Vec<f64>,
    occupancy: Vec<f64>,
    thin: Vec<bool>,
    /// Level after the last stage that changed it, cells.
    level: Vec<f64>,
    excess: Vec<f64>,
    components: Components,
    /// Volumes that left through open sides, sank, and left as spray, m^3.
    removed: [f64; 3],
    /// Targets of the components before the sub-step, less what left them, m^3.
    volume_before: Vec<f64>,
}

impl State {
    fn take_markers(&mut self) -> Markers {
        Markers {
            position: std::mem::take(&mut self.markers),
            velocity: std::mem::take(&mut self.marker_velocity),
            spray: std::mem::take(&mut self.spray),
        }
    }

    pub(in crate::reference) fn put_markers(&mut self, markers: Markers) {
        self.markers = markers.position;
        self.marker_velocity = markers.velocity;
        self.spray = markers.spray;
    }
}

impl SubStep<'_> {
    fn cells(&self) -> LevelCells<'_> {
        LevelCells {
            grid: &self.model.grid,
            cut: self.boundary.cut_cells(),
        }
    }

    /// Open volumes of the cells, m^3.
    fn open_volumes(&self) -> Vec<f64> {
        open_volumes(&self.model.grid, &self.boundary.cut_cells().solid_distance)
    }

    /// Time of volume control and length of the sub-step, s.
    fn times(&self) -> [f64; 2] {
        [self.time_step.control_time, self.time_step.dt]
    }

    fn spray_volume(&self, markers: u64) -> f64 {
        markers as f64 * self.model.grid.cell_volume() / MARKERS_PER_CELL as f64
    }

    /// Level before the sub-step, cells.
    fn level_before(&self) -> Vec<f64> {
        in_cells(&self.model.grid, &self.before.liquid_distance)
    }

    pub(super) fn advect_level_markers(&mut self) {
        let (model, dt) = (self.model, self.time_step.dt);
        let mut markers = self.after.take_markers();
        let filled = self.before.filled();
        let ballistic = self.ballistic(&filled);
        let (removed, removed_spray) = advect_level_markers(
            &model.grid,
            model.scene.domain.open,
            &self.before.velocity,
            &self.boundary.cut_cells().solid_distance,
            (model.scene.domain.gravity, &ballistic),
            dt,
            &mut markers,
        );
        self.after.put_markers(markers);
        self.results.removed_markers = removed;
        self.results.level.removed[2] = self.spray_volume(removed_spray);
        let effects = &model.effects;
        // Sources and sinks have a stage of their own, which counts these markers too.
        if effects.open_sides && !effects.sources && !effects.sinks {
            self.exchange_level();
        }
    }

    pub(super) fn exchange_level(&mut self) {
        let (model, sources) = (self.model, self.sources);
        let (grid, taps) = (&model.grid, &model.taps);
        let mut markers = self.after.take_markers();
        let in_sink = |x: &[f64; 3]| {
            let cell = cell_of(grid, DVec3::from(*x));
            taps.sink_cells.binary_search(&cell).is_ok()
        };
        let keep: Vec<bool> = markers.position.iter().map(|x| !in_sink(x)).collect();
        let pairs = keep.iter().zip(&markers.spray);
        let sunk_spray = pairs.filter(|(keep, spray)| !**keep && **spray).count();
        let sunk = markers.retain(&keep) as u64;
        let kept = markers.position.len();
        let mut positions = markers.position.clone();
        let distance = &self.boundary.cut_cells().solid_distance;
        let seeded = seed_markers(grid, taps, sources, distance, &mut positions);
        markers.extend(grid, &self.before.velocity, &positions[kept..]);
        self.after.put_markers(markers);
        self.results.level.removed[2] += self.spray_volume(sunk_spray as u64);
        let filled = self.spray_volume(seeded.filled);
        let exchange = &mut self.results.exchange;
        exchange.left = self.results.removed_markers.left;
        exchange.sunk = sunk;
        exchange.emitted = seeded.emitted;
        exchange.volume_emitted = self.time_step.dt * taps.flux(sources.running) + filled;
        self.after.markers_left += exchange.left;
        self.after.markers_sunk += sunk;
        self.after.markers_emitted += seeded.emitted;
        self.after.sources_running = sources.running.into();
        self.open_sources();
    }

    pub(super) fn advect_level(&mut self) {
        let (model, before) = (self.model, self.before);
        let (grid, level) = (&model.grid, self.level_before());
        self.results.level.volume_before = before.component_volume.clone();
        let open = model.scene.domain.open;
        let filled_before = before.filled();
        let ballistic = self.ballistic(&filled_before);
        let dt = self.time_step.dt;
        let mut carried = advect_level(grid, open, &before.velocity, &ballistic, &level, dt);
        fill_sources(grid, &model.taps, self.sources, &mut carried);
        self.results.level.removed[0] = self.outflow(&level);
        let open_volumes = self.open_volumes();
        for &cell in &model.taps.sink_cells {
            let volume = open_volumes[cell] * filled(carried[cell]);
            self.results.level.removed[1] += volume;
            self.remove_volume(before.component.get(cell), volume);
            carried[cell] = 1.0;
        }
        self.results.level.carried = carried;
    }

    /// Takes a volume (m^3) from the target of a component.
    fn remove_volume(&mut self, label: Option<&u32>, volume: f64) {
        let targets = &mut self.results.level.volume_before;
        let target = label.and_then(|&label| targets.get_mut((label as usize).checked_sub(1)?));
        if let Some(target) = target {
            *target -= volume;
        }
    }

    /// Volume that leaves through open sides in the sub-step, m^3. `level` before it, cells.
    fn outflow(&mut self, level: &[f64]) -> f64 {
        let (grid, before) = (self.model.grid, self.before);
        let mut sum = 0.0;
        for axis in Axis::ALL {
            let a = axis.index();
            for face in 0..grid.n_faces(axis) {
                let ijk = grid.face_at(axis, face);
                let side = grid.wall(axis, ijk);
                let Some(side) = side.filter(|&side| self.model.scene.domain.open.has(axis, side))
                else {
                    continue;
                };
                let Some(cell) = grid.face_sides(axis, ijk)[1 - side] else {
                    continue;
                };
                let out = if side == 1 { 1.0 } else { -1.0 } * before.velocity[a][face];
                let area = grid.dx * grid.dx * self.boundary.cut_cells().open[a][face];
                let volume = self.time_step.dt * area * out.max(0.0) * filled(level[cell]);
                sum += volume;
                self.remove_volume(before.component.get(cell), volume);
            }
        }
        sum
    }

    pub(super) fn occupancy(&mut self) {
        let (after, level) = (&self.after, &self.results.level);
        let distance = &self.boundary.cut_cells().solid_distance;
        let grid = &self.model.grid;
        let fraction = occupancy(grid, distance, &level.carried, &after.markers, &after.spray);
        self.results.level.occupancy = fraction;
    }

    pub(super) fn bound_level(&mut self) {
        let level = &self.results.level;
        let thin = thin_liquid(&self.model.grid, &level.carried);
        let bounded = bound_level(self.cells(), &level.occupancy, &thin, &level.carried);
        self.results.level.level = bounded;
        self.results.level.thin = thin;
    }

    pub(super) fn redistance(&mut self) {
        let mut level = std::mem::take(&mut self.results.level.level);
        extend_level(&self.model.grid, self.boundary.cut_cells(), &mut level);
        self.results.level.level = redistance(self.cells(), &level);
    }

    pub(super) fn filter_level(&mut self) {
        let level = &self.results.level;
        self.results.level.level = filter_level(self.cells(), &level.thin, &level.level);
    }

    pub(super) fn level_distance(&mut self) {
        let grid = &self.model.grid;
        let mut level = std::mem::take(&mut self.results.level.level);
        extend_level(grid, self.boundary.cut_cells(), &mut level);
        let mut distance: Vec<f64> = level.iter().map(|phi| phi * grid.dx).collect();
        empty_sinks(&self.model.taps, grid.dx, &mut distance);
        self.after.liquid_distance = distance;
    }

    /// Level after the last stage that changed it, cells.
    fn level_after(&self) -> Vec<f64> {
        in_cells(&self.model.grid, &self.after.liquid_distance)
    }

    pub(super) fn liquid_components(&mut self) {
        let (model, before, dt) = (self.model, self.before, self.time_step.dt);
        let filled_before = before.filled();
        let (grid, level, open_volumes) = (&model.grid, self.level_after(), self.open_volumes());
        let open = &self.boundary.cut_cells().open;
        let components = liquid_components(grid, open, &open_volumes, &level);
        let volume = |cell: usize| match components.label[cell] {
            0 => 0.0,
            _ => open_volumes[cell] * filled(level[cell]),
        };
        let volumes: Vec<f64> = (0..grid.n_cells()).map(volume).collect();
        let old = Before {
            label: &before.component,
            velocity: &before.velocity,
            ballistic: self.ballistic(&filled_before),
        };
        let origins = component_origins(grid, old, |cell| volumes[cell] > 0.0, dt);
        let volume_0 = &self.results.level.volume_before;
        let mut targets = shared_volumes(volume_0, &origins, &components, &volumes);
        self.add_sources(&components.label, &mut targets);
        let [left, sunk, spray] = self.results.level.removed;
        let emitted = self.results.exchange.volume_emitted;
        let whole = before.volume_0 - left - sunk - spray + emitted;
        let flying = self.after.spray.iter().filter(|spray| **spray).count() as u64;
        let flying = self.spray_volume(flying);
        balance(whole - flying, &components.volume, &mut targets);
        self.after.volume_0 = whole;
        if model.effects.open_sides {
            let pairs = targets.iter_mut().zip(&components.volume);
            pairs.for_each(|(target, &volume)| {
                let range = [-LARGEST_DIFFERENCE, LARGEST_DIFFERENCE].map(|d| (1.0 + d) * volume);
                // NaN stays for the check of the solve, where `clamp` would panic.
                *target = target.max(range[0]).min(range[1]);
            });
            self.after.volume_0 = targets.iter().sum::<f64>() + flying;
        }
        self.results.exchange.volume_left = left;
        self.results.exchange.volume_sunk = sunk;
        self.after.component.clone_from(&components.label);
        self.after.component_volume = targets;
        self.results.level.components = components;
    }

    /// Adds the volumes of running sources to the targets (m^3) of the components in their cells.
    fn add_sources(&self, label: &[u32], targets: &mut [f64]) {
        let (taps, running) = (&self.model.taps, self.sources.running);
        let sources = (0..u32::BITS).filter(|source| running >> source & 1 == 1);
        for source in sources {
            let own = taps
                .source_cells
                .iter()
                .filter(|(_, owner)| *owner == source);
            let mut labels = own.map(|&(cell, _)| label[cell]).filter(|&label| label > 0);
            if let Some(label) = labels.next() {
                targets[label as usize - 1] += self.time_step.dt * taps.flux(1 << source);
            }
        }
    }

    pub(super) fn volume_shift(&mut self) {
        let (open_volumes, times) = (self.open_volumes(), self.times());
        let components = &self.results.level.components;
        let after = &mut self.after;
        let (targets, distance) = (&after.component_volume, &mut after.liquid_distance);
        volume_shift(
            &self.model.grid,
            &open_volumes,
            components,
            targets,
            times,
            distance,
        );
    }

    pub(super) fn excess(&mut self) {
        let level = &self.results.level;
        let excess = excess(
            self.cells(),
            &level.components,
            &level.occupancy,
            &self.level_after(),
        );
        self.results.level.excess = excess;
    }

    pub(super) fn marker_band(&mut self) {
        let mut markers = self.after.take_markers();
        let level = &self.results.level;
        let levels = Levels {
            carried: &level.carried,
            level: &self.level_after(),
        };
        marker_band(
            &self.model.grid,
            &self.boundary.cut_cells().solid_distance,
            levels,
            &level.excess,
            [self.sources.seed, self.sources.step],
            &self.before.velocity,
            &mut markers,
        );
        self.after.put_markers(markers);
    }

    /// Adds the source of crowded markers to the right-hand side.
    pub(super) fn add_excess(
        &self,
        open_volumes: &[f64],
        active: &ActiveCells,
        rhs: &mut RightHandSide,
    ) {
        let excess = &self.results.level.excess;
        if self.model.effects.volume_shift {
            let cells = active.stencil.active_cells().into_iter();
            add_excess(excess, open_volumes, cells, self.times(), rhs);
        }
    }

    pub(super) fn spray(&mut self) {
        let grid = &self.model.grid;
        let mut markers = self.after.take_markers();
        let after = &mut self.after;
        let changed = spray(grid, &after.liquid_distance, &after.velocity, &mut markers);
        let label = &self.results.level.components.label;
        move_spray_volume(grid, label, &markers, &changed, &mut after.component_volume);
        after.put_markers(markers);
    }
}
