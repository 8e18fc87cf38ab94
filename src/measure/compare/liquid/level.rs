//! The stages of a level against their twins.
//!
//! Many of their results are discontinuous: interface cells, clipped corrections, cells of thin liquid. Each twin also runs from
//! inputs that are moved by their rounding, in several patterns of signs. Where these results differ, a number above its bound but
//! within twice the spread is excused.

use glam::DVec3;

use super::{LiquidComparison, Numbers, Pair, Place, Quantity, across_borders, components, corners, flag, largest};
use crate::grid::Axis;
use crate::measure::bounds::{EPS, level_error, maccormack_error, marker_error};
use crate::reference::{self, LevelCells, Levels, Markers, REACH, UNKNOWN};
use crate::sim::{LevelSnapshot, LiquidSnapshot};

/// Patterns of signs for inputs that are moved by their rounding.
const PATTERNS: u32 = 12;
/// Roundings of a number of a level in a pass over its neighbours.
const PASS: f64 = 24.0;
/// Passes of the distance in `redistance`, and what comes after them.
const PASSES: f64 = 12.0;

/// The liquid after a stage, and its level before and after.
#[derive(Clone, Copy)]
pub(super) struct Change<'a> {
    pub(super) after: &'a LiquidSnapshot,
    pub(super) before: &'a LevelSnapshot,
    pub(super) now: &'a LevelSnapshot,
}

/// Values moved by an amount, up or down.
fn moved(values: &[f64], by: f64, pattern: u32) -> Vec<f64> {
    let signed = |(index, value): (usize, &f64)| {
        let bits = (index as u32 ^ pattern.wrapping_mul(0x9e37_79b9)).wrapping_mul(0x85eb_ca6b);
        value + if bits >> 16 & 1 == 1 { by } else { -by }
    };
    values.iter().enumerate().map(signed).collect()
}

/// Face velocities moved by amounts (m/s) along the axes, all up and all down: departure points move to every side.
fn moved_along(velocity: &[Vec<f64>; 3], by: f64) -> impl Iterator<Item = [Vec<f64>; 3]> {
    corners().map(move |corner| [0, 1, 2].map(|a| velocity[a].iter().map(|v| v + by * corner[a]).collect()))
}

/// A number on both paths and its bound; `None` above the bound but within twice the spread of other twins.
fn judged(gpu: f64, twin: f64, bound: f64, others: impl Iterator<Item = f64>) -> Option<Numbers> {
    let off = (gpu - twin).abs();
    let excused = off > bound && off <= bound + 2.0 * largest(others.map(|other| (other - twin).abs()));
    (!excused).then_some((gpu, twin, bound))
}

impl LiquidComparison<'_> {
    fn level_cells(&self) -> LevelCells<'_> {
        LevelCells { grid: &self.grid, cut: &self.cut }
    }

    /// phi / dx: a product with 1 / dx, which is rounded.
    fn in_cells(&self, distance: &[f64]) -> Vec<f64> {
        distance.iter().map(|phi| phi / self.grid.dx).collect()
    }

    /// A field with air outside the band, where the device has none.
    fn with_air(&self, of: &LiquidSnapshot, field: &[f64]) -> Vec<f64> {
        field.iter().zip(&of.band).map(|(&phi, &band)| if band { phi } else { REACH }).collect()
    }

    /// Compares the cells of the band. `twins`: from the inputs, and from inputs moved by their rounding.
    fn band_cells(&mut self, quantity: Quantity, after: &LiquidSnapshot, gpu: &[f64], twins: &[Vec<f64>], bound: f64) {
        let [twin, others @ ..] = twins else { return };
        self.table.cells(quantity, |cell| {
            after.band[cell].then(|| judged(gpu[cell], twin[cell], bound, others.iter().map(|other| other[cell])))
        });
    }

    /// Cells from and to which a sub-step stays in the band. The device takes what MacCormack's first pass leaves outside it for air.
    fn settled(&self, after: &LiquidSnapshot) -> Vec<bool> {
        let (grid, dt) = (self.grid, self.dt());
        let fall = 0.5 * dt * dt * self.gravity().length();
        let way = 3.0_f64.sqrt() * dt * reference::max_speed(&self.before.velocity) + fall;
        let reach = (way / grid.dx).ceil() as usize + 1;
        let mut settled = after.band.clone();
        for axis in Axis::ALL.map(Axis::index) {
            let near = |cell: usize| {
                let mut ijk = grid.cell_at(cell);
                let last = (ijk[axis] + reach + 1).min(grid.cells[axis]);
                (ijk[axis].saturating_sub(reach)..last).all(|at| {
                    ijk[axis] = at;
                    settled[grid.cell(ijk)]
                })
            };
            settled = (0..settled.len()).map(near).collect();
        }
        settled
    }

    /// Results of a twin from its input and from inputs moved by so much.
    fn twins(&self, input: &[f64], by: f64, twin: impl Fn(&[f64]) -> Vec<f64>) -> Vec<Vec<f64>> {
        let others = (0..PATTERNS).map(|pattern| twin(&moved(input, by, pattern)));
        std::iter::once(twin(input)).chain(others).collect()
    }

    /// Bound: [`level_error`].
    pub(super) fn advect_level(&mut self, Change { after, now, .. }: Change) {
        let (grid, dt) = (self.grid, self.dt());
        let velocity = &self.before.velocity;
        let level = self.in_cells(&self.before.liquid_distance);
        let ballistic = self.ballistic();
        let sides = self.scene.domain.open;
        let carried = reference::carry_level(&grid, sides, velocity, &ballistic, &level, dt);
        let [_, bound] = level_error(&grid, velocity, &level, &carried, dt);
        let advected =
            |velocity: &_, of: &_, level: &[f64]| reference::advect_level(&grid, sides, velocity, of, level, dt);
        let mut twins = self.twins(&level, bound, |level| advected(velocity, &ballistic, level));
        twins.extend(self.near_ballistic().map(|other| advected(velocity, &other, &level)));
        // A departure point on a plane of cell centres may have the taps of either side.
        let by = 16.0 * EPS * reference::max_speed(velocity);
        twins.extend(moved_along(velocity, by).map(|velocity| advected(&velocity, &ballistic, &level)));
        self.exchange_level(after, &level, (&mut twins, bound));
        let band = self.settled(after);
        let settled = LiquidSnapshot { band, ..after.clone() };
        self.band_cells(["phi", "cells"], &settled, &now.carried, &twins, bound);
        if !now.separation_bounds.is_empty() {
            self.separated_level(after, now, &level);
        }
    }

    /// The normal of a body is off by the rounding of two distances over their difference, at least half a cell. A path back of air that ends at
    /// a body may enter it or not; where it enters it is off by the roundings of two distances, times the slope of the path.
    fn separated_level(&mut self, after: &LiquidSnapshot, now: &LevelSnapshot, level: &[f64]) {
        let velocity = &self.before.velocity;
        let finite = |bounds: &[f64]| -> Vec<f64> { bounds.iter().map(|bound| bound.max(-REACH)).collect() };
        let motion = self.dt() * reference::max_speed(velocity) / self.grid.dx;
        let bound = EPS * (PASS * REACH + 16.0 * self.extent() * motion);
        let separated = |velocity: &_, level: &[f64]| {
            let bodies = (self.dt(), self.effects().leaves_still_bodies());
            finite(&reference::separation_bounds(self.level_cells(), velocity, &self.before.separated, level, bodies))
        };
        let mut twins = self.twins(level, EPS * REACH, |level| separated(velocity, level));
        let by = 16.0 * EPS * reference::max_speed(velocity);
        twins.extend(moved_along(velocity, by).map(|velocity| separated(&velocity, level)));
        self.band_cells(["bound", "cells"], after, &finite(&now.separation_bounds), &twins, bound);
    }

    /// Sources and sinks in the twins of the advected level, of an error `bound` (cells). Volumes: of a cell the error of the level
    /// and a unit of the sums; through a face that of a quotient and five products.
    fn exchange_level(&mut self, after: &LiquidSnapshot, level: &[f64], (twins, bound): (&mut [Vec<f64>], f64)) {
        let (grid, dt, taps) = (self.grid, self.dt(), &self.taps);
        let one = grid.cell_volume();
        let left_there = (self.running.step > 0).then_some(level);
        let sums = twins.iter_mut().map(|twin| {
            *twin = self.with_air(after, twin);
            let filled = reference::fill_sources(&grid, taps, self.running, &self.open_volumes, twin);
            let sunk = reference::sunk_volumes(taps, &self.open_volumes, left_there, twin);
            reference::empty_level_sinks(taps, twin);
            let sunk = sunk.iter().map(|(_, volume)| volume).sum::<f64>();
            [sunk / one, filled.iter().sum::<f64>() / one]
        });
        let sums: Vec<[f64; 2]> = sums.collect();
        let unit = (-24.0_f64).exp2();
        let with_bound = |which: usize, cells: usize| {
            let others = sums.iter().map(|sum| (sum[which] - sums[0][which]).abs());
            let in_cells = cells as f64 * (2.0 * bound + 16.0 * EPS + unit);
            (sums[0][which], in_cells + 2.0 * largest(others))
        };
        let [sunk, filled] = [with_bound(0, taps.sink_cells.len()), with_bound(1, taps.source_cells.len())];
        let velocity = &self.before.velocity;
        let left = reference::outflow(&grid, self.scene.domain.open, &self.cut.open, velocity, level, dt);
        let way = dt * reference::max_speed(velocity) / grid.dx;
        let left_bound = left.len() as f64 * (16.0 * EPS * way + unit);
        let left = left.iter().map(|(_, volume)| volume / one).sum();
        self.twin.exchanged = [(left, left_bound), sunk, filled];
    }

    /// Bound: [`maccormack_error`]. Whether the corrected velocity is within the range of its taps may hang on a rounding.
    pub(super) fn maccormack(&mut self, after: &LiquidSnapshot) {
        let (grid, dt, open) = (self.grid, self.dt(), &self.open_to_advection(after));
        let mut velocity = self.before.velocity.clone();
        let mut given = 0.0;
        if !self.taps.faces.is_empty() {
            let fall = 0.5 * dt * self.gravity();
            // A velocity of a source is rounded, and so are product and difference.
            given = 3.0 * EPS * (reference::max_speed(&velocity) + fall.abs().max_element());
            reference::rewind_sources(&self.taps, &self.cut.open, self.running.running, fall, &mut velocity);
        }
        let (velocity, ballistic) = (&velocity, self.ballistic());
        let carried = reference::advect_velocity(&grid, open, velocity, &ballistic, dt);
        let bound = maccormack_error(&grid, open, (velocity, given), &carried, dt);
        let times = [dt, self.courant];
        let advect = |velocity: &_, near: &_| reference::advect_velocity_maccormack(&grid, open, velocity, near, times);
        let twin = advect(velocity, &ballistic);
        let moved = |pattern| velocity.each_ref().map(|values| moved(values, bound, pattern));
        let mut others: Vec<[Vec<f64>; 3]> = (0..PATTERNS).map(|pattern| advect(&moved(pattern), &ballistic)).collect();
        others.extend(self.near_ballistic().map(|near| advect(velocity, &near)));
        let settled = self.settled(after);
        self.table.faces(["u*", "m/s"], |a, face| {
            let axis = Axis::ALL[a];
            // A face on a side of the domain may lie in a tile beyond the band.
            let mut sides = grid.face_sides(axis, grid.face_at(axis, face)).into_iter().flatten();
            let inside = after.face_band[a][face] && sides.all(|cell| settled[cell]);
            let others = others.iter().map(|other| other[a][face]);
            inside.then(|| judged(after.velocity_next[a][face], twin[a][face], bound, others))
        });
    }

    /// Markers of a level: liquid by the midpoint rule, spray on its parabola. Push-out of obstacles adds the error of the distance and of its normal.
    pub(super) fn advect_level_markers(&mut self, Change { after, before, .. }: Change) {
        let (grid, dt, gravity) = (self.grid, self.dt(), self.gravity());
        let (velocity, ballistic) = (&self.before.velocity, self.ballistic());
        let pushed = if self.effects().cuts() { 3.0 * 64.0 * grid.dx } else { 0.0 };
        let advect = |slot: usize, start: [f64; 3]| {
            let mut one = Markers {
                position: vec![start],
                velocity: vec![before.marker_velocity[slot]],
                spray: vec![before.spray[slot]],
            };
            let (sides, falls) = (self.scene.domain.open, (gravity, &ballistic));
            reference::advect_level_markers(&grid, sides, velocity, &self.cut.solid_distance, falls, dt, &mut one);
            one.position.first().copied()
        };
        let fall = gravity.length() * dt;
        let fastest = largest(before.marker_velocity.iter().flatten().map(|v| v.abs())) + fall;
        let bound =
            marker_error(&grid, velocity, dt) + EPS * (8.0 * dt * fastest + 4.0 * self.extent() * grid.dx + pushed);
        let markers = [&self.before.markers[..], &after.markers];
        self.add_advected(super::advected(markers, |_| bound, advect));
    }

    /// A weight is a product of three differences from 1, each off by the roundings of a position in cells, rounded to 2^-20.
    pub(super) fn occupancy(&mut self, Change { after, before, now }: Change) {
        let grid = self.grid;
        let markers = self.markers_of_level(before);
        let (solid, at, spray) = (&self.cut.solid_distance, &markers.position, &markers.spray);
        let fraction = |carried: &[f64]| reference::occupancy(&grid, solid, carried, at, spray);
        let twins = self.twins(&self.with_air(after, &now.carried), EPS * REACH, fraction);
        let weight = 3.0 * 4.0 * EPS * self.extent() + (-20.0_f64).exp2();
        let bound = self.most_markers(&markers) * weight + 64.0 * EPS;
        self.band_cells(["F", ""], after, &now.occupancy, &twins, bound);
    }

    /// Largest number of markers around a cell over that in its open surroundings, of which a fifth counts.
    fn most_markers(&self, markers: &Markers) -> f64 {
        let mut counts = vec![0.0; self.grid.n_cells()];
        for x in &markers.position {
            counts[reference::cell_of(&self.grid, *x)] += 1.0;
        }
        27.0 * largest(counts) / 8.0 / 0.2
    }

    /// The markers before a stage.
    fn markers_of_level(&self, level: &LevelSnapshot) -> Markers {
        let slots = self.before.markers.iter().enumerate();
        let alive = || slots.clone().filter_map(|(slot, x)| Some((slot, (*x)?)));
        Markers {
            position: alive().map(|(_, x)| x).collect(),
            velocity: alive().map(|(slot, _)| level.marker_velocity[slot]).collect(),
            spray: alive().map(|(slot, _)| level.spray[slot]).collect(),
        }
    }

    /// A root of 1 - |q| near 0 spreads its rounding; the smoothed occupancy is a mean of 27.
    pub(super) fn bound_level(&mut self, Change { after, before, now }: Change) {
        let carried = self.with_air(after, &before.carried);
        let occupancy = &before.occupancy;
        let thin = reference::thin_liquid(&self.grid, &carried);
        let bounded = |occupancy: &[f64]| {
            let mut level = reference::bound_level(self.level_cells(), occupancy, &thin, &carried);
            reference::raise_separated(&before.separation_bounds, &mut level);
            level
        };
        let twins = self.twins(occupancy, 4.0 * EPS, |moved| {
            let known = occupancy.iter().zip(moved).map(|(&f, &moved)| if f == UNKNOWN { f } else { moved });
            bounded(&known.collect::<Vec<_>>())
        });
        self.band_cells(["phi", "cells"], after, &now.level, &twins, PASS * EPS * REACH);
    }

    /// Each pass adds the roundings of a root of sums of squares. Ties of two paths are covered by twins whose whole level
    /// moves outwards or inwards.
    pub(super) fn redistance(&mut self, Change { after, before, now }: Change) {
        let level = self.with_air(after, &before.level);
        let bound = PASSES * PASS * EPS * REACH;
        let redistanced = |level: &[f64]| {
            let mut level = level.to_vec();
            reference::extend_level(&self.grid, &self.cut, &mut level);
            reference::redistance(self.level_cells(), &before.separation_bounds, &level)
        };
        let mut twins = self.twins(&level, bound, redistanced);
        let away = |by: f64| level.iter().map(|phi| phi + by * phi.signum()).collect::<Vec<_>>();
        twins.extend([bound, -bound].map(|by| redistanced(&away(by))));
        self.band_cells(["phi", "cells"], after, &now.level, &twins, bound);
    }

    pub(super) fn filter_level(&mut self, Change { after, before, now }: Change) {
        let level = self.with_air(after, &before.level);
        let thin = reference::thin_liquid(&self.grid, &self.with_air(after, &before.carried));
        let bound = PASS * EPS * REACH;
        let twins = self.twins(&level, bound, |level| {
            reference::filter_level(self.level_cells(), &thin, self.courant.min(1.0), level)
        });
        self.band_cells(["phi", "cells"], after, &now.level, &twins, bound);
    }

    pub(super) fn level_distance(&mut self, Change { after, before, .. }: Change) {
        let dx = self.grid.dx;
        let level = self.with_air(after, &before.level);
        let bound = PASSES * PASS * EPS * REACH;
        let twins = self.twins(&level, EPS * REACH, |level| {
            let mut level = level.to_vec();
            reference::extend_level(&self.grid, &self.cut, &mut level);
            reference::empty_level_sinks(&self.taps, &mut level);
            level.iter().map(|phi| phi * dx).collect()
        });
        self.band_cells(["phi", "m"], after, &after.liquid_distance, &twins, bound * dx);
        self.twin.liquid_distance.clone_from(&twins[0]);
        self.twin.distance_bounds = vec![bound * dx; self.grid.n_cells()];
    }

    /// Components of a liquid distance, m.
    fn components_of(&self, distance: &[f64]) -> reference::Components {
        reference::liquid_components(&self.grid, &self.cut.open, &self.open_volumes, &self.in_cells(distance))
    }

    /// Labels depend on signs alone, which are equal. Where a cell comes from may hang on a rounding, which moves a cell between targets.
    pub(super) fn liquid_components(&mut self, Change { after, now, .. }: Change) {
        let twin = self.components_of(&after.liquid_distance);
        self.table.cells(["component", ""], |cell| Some((now.component[cell].into(), twin.label[cell].into(), 0.0)));
        let whole: f64 = now.component_volume.iter().sum();
        let slots = now.spray.iter().zip(&after.markers);
        let flying = slots.filter(|(spray, x)| **spray && x.is_some()).count() + now.lost_spray as usize;
        let one = self.grid.cell_volume();
        let mut total = f64::from(self.step.volume_0) - flying as f64 * one / 8.0;
        if self.effects().exchange() {
            let of_step = after.report.exchanged;
            let volumes =
                [("volume left", of_step.left), ("volume sunk", of_step.sunk), ("volume filled", of_step.filled)];
            for ((name, gpu), (twin, bound)) in volumes.into_iter().zip(self.twin.exchanged) {
                self.table.whole([name, "m^3"], one * gpu, one * twin, one * bound);
            }
            total += one * (of_step.filled - of_step.left - of_step.sunk + of_step.limited);
        }
        let bound = 1e-5 * total.abs();
        // Where a target is capped at a multiple of its volume, less than the total is distributed.
        let mut targets = now.component_volume.iter().zip(&twin.volume);
        let capped = !self.effects().open_sides
            && targets.any(|(target, volume)| *target >= 0.999 * reference::LARGEST_TARGET * volume);
        let twin_whole = match (twin.volume.is_empty(), capped) {
            (true, _) => 0.0,
            (_, true) => total.min(whole),
            _ => total,
        };
        self.table.whole(["target volume", "m^3"], whole, twin_whole, bound);
    }

    /// The shift is a quotient of sums, whose relative error is that of the volume over what the liquid lacks.
    pub(super) fn volume_shift(&mut self, Change { after, now, .. }: Change) {
        self.components = self.components_of(&self.before.liquid_distance);
        let (grid, components) = (self.grid, &self.components);
        let times = [f64::from(self.step.control_time), self.dt()];
        let limits = (times, reference::largest_shift(self.courant));
        let shifted = |targets: &[f64]| {
            let mut distance = self.before.liquid_distance.clone();
            reference::volume_shift(
                &grid,
                &self.open_volumes,
                &self.cut.solid_distance,
                components,
                targets,
                limits,
                &mut distance,
            );
            distance
        };
        let targets = &now.component_volume;
        if targets.len() != components.volume.len() {
            return;
        }
        let twins = [0.0, 1e-5, -1e-5]
            .map(|relative| shifted(&targets.iter().map(|target| target * (1.0 + relative)).collect::<Vec<_>>()));
        // The shift is bounded.
        let offs = |other| std::iter::zip(other, &twins[0]).map(|(other, twin): (&f64, &f64)| (other - twin).abs());
        let spread = largest(twins[1..].iter().flat_map(offs));
        let bound = 4.0 * EPS * REACH * grid.dx + spread;
        self.band_cells(["phi", "m"], after, &after.liquid_distance, &twins, bound);
        self.twin.liquid_distance.clone_from(&twins[0]);
    }

    /// Two times 27 weights and a quotient by at least 0.05.
    pub(super) fn excess(&mut self, Change { after, before, now }: Change) {
        let level = self.in_cells(&after.liquid_distance);
        let mut components = self.components.clone();
        components.label.clone_from(&now.component);
        let (n, targets) = (components.enclosed.len(), &now.component_volume);
        if targets.len() != n || components.label.iter().any(|&label| label as usize > n) {
            return;
        }
        let most = largest(before.occupancy.iter().map(|f| f.abs())).max(1.0);
        // Volumes, in f32 with sums of fixed point, over the dead band of the volume control.
        let bound = (64.0 * EPS / 0.05 + 1e-5 / 0.005) * most;
        let twins = self.twins(&level, 2.0 * EPS * REACH, |level| {
            reference::excess(self.level_cells(), (&components, targets), self.renewed, &before.occupancy, level)
        });
        self.band_cells(["e", ""], after, &now.excess, &twins, bound);
    }

    /// Deleted and seeded markers. A sample of the level near the depth of the band may be on either side of it.
    pub(super) fn marker_band(&mut self, Change { after, before, now }: Change) {
        let grid = self.grid;
        let mut markers = self.markers_of_level(before);
        let n_before = markers.position.len();
        let level = self.in_cells(&after.liquid_distance);
        let levels = Levels { carried: &self.with_air(after, &now.carried), level: &level };
        let numbers = [self.running.seed, self.running.step];
        let (solid, velocity, crowd) = (&self.cut.solid_distance, &self.before.velocity, &now.excess);
        let [deleted, seeded] = reference::marker_band(&grid, solid, levels, crowd, numbers, velocity, &mut markers);
        let slots = self.before.markers.iter().zip(&after.markers);
        let gone = slots.filter(|(x, now)| x.is_some() && now.is_none()).count();
        let new = (after.markers.iter().flatten().count() + gone).saturating_sub(n_before);
        // As many markers as lie within a rounding of the depth may differ: of some thousand, one.
        let near = |n: usize| 1.0 + 1e-3 * n as f64;
        self.table.wholes([
            ("markers deleted", "", gone as f64, deleted as f64, near(deleted)),
            ("markers seeded", "", new as f64, seeded as f64, near(seeded)),
        ]);
        let first = self.used_slots();
        let fresh: Vec<[f64; 3]> = after.markers.iter().skip(first).copied().flatten().collect();
        if fresh.len() == seeded {
            self.new_positions(first, &fresh, &markers.position[n_before - deleted..]);
        }
    }

    /// A weight has three roundings of a position in cells and is divided by a sum of at least 1/256; both paths round it to 2^-16. What
    /// faces hang on a rounding of a plane of cell centres is excused.
    pub(super) fn landing(&mut self, Change { after, before, .. }: Change) {
        let (grid, dt) = (self.grid, self.dt());
        let phi = &after.liquid_distance;
        let level = self.in_cells(phi);
        let volume = |cell: usize| {
            self.open_volumes[cell] / grid.cell_volume() * reference::interpolant_part(&grid, &level, cell)
        };
        let volumes: Vec<f64> = (0..grid.n_cells()).map(volume).collect();
        let mut markers = self.markers_of_level(before);
        let landed = reference::land(&grid, phi, &mut markers);
        let mut faces = self.before.velocity_next.clone();
        let open = &self.cut.open;
        let (liquid, flying) = ((&phi[..], &volumes[..]), (&markers, &landed[..]));
        reference::take_landing(&grid, open, liquid, flying, dt, &mut faces);
        let speeds = landed.iter().flat_map(|&marker| markers.velocity[marker]).map(f64::abs);
        let fastest = largest(speeds).max(reference::max_speed(&faces));
        let weight = EPS * 24.0 * self.extent() * 256.0 + 2.0 * (-16.0_f64).exp2();
        let near = Axis::ALL.map(|axis| {
            let mut near = vec![0.0; grid.n_faces(axis)];
            let around = landed.iter().map(|&marker| grid.faces_around(axis, markers.position[marker].into()));
            around.flat_map(|around| around.weights()).for_each(|(face, _)| near[face] += 1.0);
            near
        });
        self.table.faces(["u*", "m/s"], |a, face| {
            let near = near[a][face];
            let mass = reference::face_mass(&grid, &volumes, Axis::ALL[a], face).max(1e-3);
            let off = near / 8.0 * weight * (fastest + grid.dx / dt) / mass;
            let bound = off.min(2.0 * fastest) + 400.0 * EPS * fastest * near.min(1.0);
            let (gpu, twin) = (after.velocity_next[a][face], faces[a][face]);
            let excused = near > 0.0 && (gpu - twin).abs() > bound;
            after.face_band[a][face].then(|| (!excused).then_some((gpu, twin, bound)))
        });
    }

    /// A marker within its rounding of a plane of cell centres may have other cells around it. Velocities: a trilinear sample.
    pub(super) fn spray(&mut self, Change { after, before, now }: Change) {
        let grid = self.grid;
        let mut twin = self.markers_of_level(before);
        let (phi, velocity) = (&after.liquid_distance, &after.velocity);
        reference::spray(&grid, phi, velocity, &mut twin);
        let alive: Vec<usize> = (0..after.markers.len()).filter(|&slot| after.markers[slot].is_some()).collect();
        if alive.len() != twin.position.len() {
            return;
        }
        let half = DVec3::splat(0.5 * grid.dx);
        let (mut flags, mut velocities): (Vec<Option<Pair>>, _) = (Vec::new(), Vec::new());
        let speed = reference::max_speed(velocity);
        let bound = EPS * (10.0 * speed + 2.0 * 12.0 * self.extent() * speed);
        for (index, &slot) in alive.iter().enumerate() {
            let x = DVec3::from(twin.position[index]);
            let place = Place::Marker(slot, x);
            let (gpu, spray) = (now.spray[slot], twin.spray[index]);
            let excused = gpu != spray && across_borders(&grid, (x + half).into()) != (x + half).to_array();
            flags.push((!excused).then(|| flag(gpu, spray, place)));
            if !excused {
                velocities.extend(components(now.marker_velocity[slot], twin.velocity[index], bound, place));
            }
        }
        self.table.add(["spray", "flag"], flags);
        self.table.add(["marker velocity", "m/s"], velocities);
    }

    /// Adds the source of crowded markers to E u* (m^3/s).
    pub(super) fn add_excess(&self, active: &[bool], rhs: &mut reference::RightHandSide) -> f64 {
        let level = self.before.level.as_ref().filter(|_| self.effects().volume_shift);
        let Some(level) = level else { return 0.0 };
        let times = [f64::from(self.step.control_time), self.dt()];
        let cells = (0..active.len()).filter(|&cell| active[cell]);
        reference::add_excess(&level.excess, &self.open_volumes, cells, times, rhs);
        // A quotient by at least 1.5 sub-steps and two products.
        8.0 * EPS * self.grid.dx / (1.5 * times[1])
    }
}
