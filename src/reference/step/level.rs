//! The stages of a level set.

use super::SubStep;
use crate::geometry::MARKERS_PER_CELL;
use crate::reference::level_cells::in_cells;
use crate::reference::marker_band::cell_of;
use crate::reference::{
    ActiveCells, Before, CellVolume, Components, LevelCells, Levels, Markers, RightHandSide, add_excess, add_sources,
    advect_level, advect_level_markers, balance, bound_level, cap_targets, closed_to_markers, component_origins,
    emit_markers, empty_level_sinks, excess, extend_level, fill_sources, filter_level, hold_source_origins,
    interpolant_part, land, largest_shift, limit_targets, liquid_components, marker_band, move_spray_volume, occupancy,
    open_volumes, outflow, raise_separated, redistance, remove_volumes, renewed_volume, separation_bounds,
    shared_volumes, spray, sunk_volumes, take_landing, thin_liquid, volume_shift,
};
use crate::state::State;

/// Results of the stages of the level, per cell but for the last.
#[derive(Default)]
pub(super) struct LevelResults {
    /// Level after its transport, cells.
    carried: Vec<f64>,
    /// Bounds of the level at walls and bodies, cells.
    separation_bounds: Vec<f64>,
    occupancy: Vec<f64>,
    thin: Vec<bool>,
    /// Level after the last stage that changed it, cells.
    level: Vec<f64>,
    excess: Vec<f64>,
    components: Components,
    /// See [`renewed_volume`], m^3.
    renewed: f64,
    /// Volumes that left through open sides and sank, with spray, and of spray lost in bodies, m^3.
    removed: [f64; 3],
    /// Volumes of starting sources, per source cell, m^3.
    first_fill: Vec<f64>,
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
        LevelCells { grid: &self.model.grid, cut: self.boundary.cut_cells() }
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
        let [left, dropped] = [removed_spray.left, removed_spray.dropped];
        self.results.level.removed = [left, 0, dropped].map(|n| self.spray_volume(n));
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
        let in_sink = |x: &[f64; 3]| taps.sink_cells.binary_search(&cell_of(grid, *x)).is_ok();
        let keep: Vec<bool> = markers.position.iter().map(|x| !in_sink(x)).collect();
        let pairs = keep.iter().zip(&markers.spray);
        let sunk_spray = pairs.filter(|(keep, spray)| !**keep && **spray).count();
        let sunk = markers.retain(&keep) as u64;
        let kept = markers.position.len();
        let mut positions = markers.position.clone();
        let distance = &self.boundary.cut_cells().solid_distance;
        let distance = closed_to_markers(distance, &self.before.liquid_distance, grid.dx);
        let lattices = taps.lattices(grid, self.before.time, self.time_step.dt);
        let emitted = emit_markers(grid, taps, sources, &lattices, &distance, &mut positions);
        markers.extend(grid, &self.before.velocity, &positions[kept..]);
        self.after.put_markers(markers);
        self.results.level.removed[1] = self.spray_volume(sunk_spray as u64);
        let exchange = &mut self.results.exchange;
        exchange.left = self.results.removed_markers.left;
        exchange.sunk = sunk;
        exchange.emitted = emitted;
        self.after.markers_left += exchange.left;
        self.after.markers_sunk += sunk;
        self.after.markers_emitted += emitted;
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
        let open_volumes = self.open_volumes();
        let bodies = (dt, model.effects.leaves_still_bodies());
        let bounds = separation_bounds(self.cells(), &before.velocity, &before.separated, &level, bodies);
        let results = &mut self.results.level;
        results.separation_bounds = bounds;
        results.first_fill = fill_sources(grid, &model.taps, self.sources, &open_volumes, &mut carried);
        let apertures = &self.boundary.cut_cells().open;
        let left = outflow(grid, open, apertures, &before.velocity, &level, dt);
        // Initial liquid in a sink sinks in the first sub-step.
        let left_there = (before.step > 0).then_some(&level[..]);
        let sunk = sunk_volumes(&model.taps, &open_volumes, left_there, &carried);
        empty_level_sinks(&model.taps, &mut carried);
        results.carried = carried;
        for (volumes, removed) in [left, sunk].iter().zip(&mut results.removed) {
            *removed += volumes.iter().map(|&(_, volume): &CellVolume| volume).sum::<f64>();
            remove_volumes(&before.component, volumes, &mut results.volume_before);
        }
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
        let mut bounded = bound_level(self.cells(), &level.occupancy, &thin, &level.carried);
        raise_separated(&level.separation_bounds, &mut bounded);
        self.results.level.level = bounded;
        self.results.level.thin = thin;
    }

    pub(super) fn redistance(&mut self) {
        let mut level = std::mem::take(&mut self.results.level.level);
        extend_level(&self.model.grid, self.boundary.cut_cells(), &mut level);
        self.results.level.level = redistance(self.cells(), &self.results.level.separation_bounds, &level);
    }

    pub(super) fn filter_level(&mut self) {
        let level = &self.results.level;
        self.results.level.level = filter_level(self.cells(), &level.thin, self.time_step.motion(), &level.level);
    }

    pub(super) fn level_distance(&mut self) {
        let grid = &self.model.grid;
        let mut level = std::mem::take(&mut self.results.level.level);
        extend_level(grid, self.boundary.cut_cells(), &mut level);
        empty_level_sinks(&self.model.taps, &mut level);
        self.after.liquid_distance = level.iter().map(|phi| phi * grid.dx).collect();
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
            _ => open_volumes[cell] * interpolant_part(grid, &level, cell),
        };
        let volumes: Vec<f64> = (0..grid.n_cells()).map(volume).collect();
        let old =
            Before { label: &before.component, velocity: &before.velocity, ballistic: self.ballistic(&filled_before) };
        let mut origins = component_origins(grid, old, |cell| volumes[cell] > 0.0, dt);
        hold_source_origins(grid, &model.taps, self.sources, &before.component, &mut origins);
        let volume_0 = &self.results.level.volume_before;
        let mut targets = shared_volumes(volume_0, &origins, &components, &volumes);
        let taps = &model.taps;
        let inflows: Vec<f64> = taps.inflows(self.sources, dt).collect();
        let first_fill = &self.results.level.first_fill;
        add_sources(taps, first_fill, &inflows, &components.label, &mut targets);
        let rate = inflows.iter().sum::<f64>() / dt;
        self.results.level.renewed = match model.effects.open_sides {
            true => renewed_volume(rate, self.time_step.control_time),
            false => 0.0,
        };
        let [left, sunk, spray] = self.results.level.removed;
        let emitted = first_fill.iter().sum::<f64>() + inflows.iter().sum::<f64>();
        let whole = before.volume_0 - left - sunk - spray + emitted;
        let flying = self.after.spray.iter().filter(|spray| **spray).count() as u64;
        let flying = self.spray_volume(flying);
        balance(whole - flying, &components.volume, &mut targets);
        self.after.volume_0 = whole;
        match model.effects.open_sides {
            true => {
                limit_targets(&components.volume, self.results.level.renewed, &mut targets);
                self.after.volume_0 = targets.iter().sum::<f64>() + flying;
            }
            false => cap_targets(&components.volume, &mut targets),
        }
        self.results.exchange.volume_left = left;
        self.results.exchange.volume_sunk = sunk;
        self.results.exchange.volume_emitted = emitted;
        self.after.component.clone_from(&components.label);
        self.after.component_volume = targets;
        self.results.level.components = components;
    }

    pub(super) fn volume_shift(&mut self) {
        let (open_volumes, walls) = (self.open_volumes(), &self.boundary.cut_cells().solid_distance);
        let limits = (self.times(), largest_shift(self.time_step.courant));
        let components = &self.results.level.components;
        let after = &mut self.after;
        let (targets, distance) = (&after.component_volume, &mut after.liquid_distance);
        volume_shift(&self.model.grid, &open_volumes, walls, components, targets, limits, distance);
    }

    pub(super) fn excess(&mut self) {
        let level = &self.results.level;
        let components = (&level.components, &self.after.component_volume[..]);
        let excess = excess(self.cells(), components, level.renewed, &level.occupancy, &self.level_after());
        self.results.level.excess = excess;
    }

    pub(super) fn marker_band(&mut self) {
        let mut markers = self.after.take_markers();
        let level = &self.results.level;
        let levels = Levels { carried: &level.carried, level: &self.level_after() };
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

    pub(super) fn landing(&mut self) {
        let grid = &self.model.grid;
        let mut markers = self.after.take_markers();
        let landed = land(grid, &self.after.liquid_distance, &mut markers);
        if !landed.is_empty() {
            let level = self.level_after();
            let open_volumes = self.open_volumes();
            let volume = |cell| open_volumes[cell] / grid.cell_volume() * interpolant_part(grid, &level, cell);
            let volumes: Vec<f64> = (0..grid.n_cells()).map(volume).collect();
            let open = &self.boundary.cut_cells().open;
            let (dt, after) = (self.time_step.dt, &mut self.after);
            let liquid = (&*after.liquid_distance, &*volumes);
            take_landing(grid, open, liquid, (&markers, &landed), dt, &mut after.velocity);
            let label = &self.results.level.components.label;
            move_spray_volume(grid, label, &markers, &landed, &mut after.component_volume);
        }
        self.after.put_markers(markers);
    }

    /// Adds the source of crowded markers to the right-hand side.
    pub(super) fn add_excess(&self, open_volumes: &[f64], active: &ActiveCells, rhs: &mut RightHandSide) {
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
