//! The stages of the liquid against their twins.

mod level;
mod pressure;

use glam::DVec3;
use rayon::prelude::*;

use level::Change;
use pressure::unit_system;

use super::table::{Numbers, Pair, Place, Quantity, Table, components, flag, number};
use super::{Both, EPS, corners, largest, rounded_to_f32, unit};
use crate::Error;
use crate::effects::Effects;
use crate::fields::Step;
use crate::geometry::{CutCells, Lattice, Running, SolidClip, SourcesAndSinks};
use crate::gpu::Real;
use crate::grid::{Axis, Grid};
use crate::measure::bounds::{MarkerError, advection_error, open_to_advection};
use crate::reference::{
    self, ActiveCells, Ballistic, CavityMotion, MovingWalls, PressureSystem, RightHandSide as Inflow, Stencil,
    TimeStep, VolumeSource, cavity_source,
};
use crate::scene::{ProbeKind, Scene, ThetaFloor};
use crate::sim::{GpuPath, LiquidSnapshot};
use crate::state::State;
use crate::step::Stage;

/// Largest error of a departure point, in roundings of the extent of the grid.
const NEAR_BALLISTIC: f64 = 256.0;

/// Marker position, m; `None`: deleted.
type Marker = Option<[f64; 3]>;

/// The twins of the liquid, with the inputs of the device.
pub(super) struct LiquidComparison<'a> {
    scene: &'a Scene,
    /// With the dx of the device.
    grid: Grid,
    /// As stored on the device.
    cut: CutCells,
    open_volumes: Vec<f64>,
    taps: SourcesAndSinks,
    /// State of the sources in the sub-step.
    running: Running,
    /// Lattices of the sources, with a level.
    lattices: Vec<Lattice>,
    /// Volume that sources renew, m^3.
    renewed: f64,
    step: Step,
    /// Components of the level before its shift.
    components: reference::Components,
    /// [`TimeStep::courant`] on the device.
    courant: f64,
    pub(super) table: Table,
    /// Input of the stage: the fields of the device.
    pub(super) before: LiquidSnapshot,
    /// Results of earlier twins of the sub-step.
    twin: Twin,
}

/// Results of the twins in a sub-step.
#[derive(Default)]
struct Twin {
    liquid_distance: Vec<f64>,
    /// Error bound of the device's liquid distance per cell, m.
    distance_bounds: Vec<f64>,
    /// Volumes of a level that left, sank and filled sources, with their error bounds on the device, volumes of a cell.
    exchanged: [(f64, f64); 3],
    /// Active cells of the stored liquid distance, in f64.
    active: Option<ActiveCells>,
    /// m/s, and its error bound on the device.
    rhs: Vec<f64>,
    rhs_bound: f64,
    /// The same without the flux of solids, m/s.
    rhs_of_liquid: Vec<f64>,
    /// Cells of enclosed components that the device opened.
    opened: Vec<bool>,
    /// Norm of |E| |u*|, m/s.
    flux: f64,
    /// Pa.
    pressure: Vec<f64>,
    pressure_bound: f64,
    velocity: [Vec<f64>; 3],
    velocity_bound: f64,
}

impl<'a> LiquidComparison<'a> {
    /// `before`: the liquid at the start.
    pub(super) fn new(scene: &'a Scene, path: &GpuPath, before: LiquidSnapshot) -> Self {
        let step = path.step_numbers(TimeStep::NONE).expect("the scene has liquid");
        let grid = Grid { cells: scene.domain.cells, dx: step.dx.into() };
        let cut = path.cut_cells();
        let cut = CutCells {
            open: [0, 1, 2].map(|axis| rounded_to_f32(&cut.open[axis])),
            solid_distance: rounded_to_f32(&cut.solid_distance),
        };
        LiquidComparison {
            scene,
            grid,
            open_volumes: reference::open_volumes(&grid, &cut.solid_distance),
            cut,
            taps: path.taps().map(|(taps, _)| taps.clone()).unwrap_or_default(),
            running: Running::default(),
            lattices: Vec::new(),
            renewed: 0.0,
            step,
            components: reference::Components::default(),
            courant: 0.0,
            table: Table::new(grid),
            twin: Twin {
                liquid_distance: before.liquid_distance.clone(),
                distance_bounds: vec![0.0; grid.n_cells()],
                ..Twin::default()
            },
            before,
        }
    }

    /// Unknowns and E u* (m^3/s) as the device stores them, and as the twins assemble them. For use before `solve` is compared.
    pub(super) fn systems(&self, after: &LiquidSnapshot, both: &Both) -> Option<[(ActiveCells, Inflow); 2]> {
        let area = self.grid.dx * self.grid.dx;
        let assembled = self.twin.active.clone()?;
        let mut stored = self.stored(after);
        stored.seal(both.clip.coupling(), &both.at_rest.prescribed);
        let rhs =
            |values: &[f64]| Inflow { values: values.iter().map(|b| area * b).collect(), scale: area * self.twin.flux };
        Some([(stored, rhs(&self.before.rhs)), (assembled, rhs(&self.twin.rhs))])
    }

    /// Begins a sub-step. `moved`: markers have other slots than after the last one.
    pub(super) fn begin(&mut self, path: &GpuPath, time_step: TimeStep, moved: bool) -> Result<(), Error> {
        if let Some(before) = moved.then(|| path.snapshot()).transpose()?.and_then(|device| device.liquid) {
            self.before = before;
        }
        self.table.step = path.clock().step;
        self.courant = f64::from(time_step.courant as f32);
        self.step = path.step_numbers(time_step).expect("the scene has liquid");
        if let Some((_, running)) = path.taps() {
            self.running = running;
            let (grid, dt) = (self.scene.grid(), time_step.dt);
            self.taps.set_velocities(path.clock().time, [path.last_step(), dt]);
            self.lattices = self.taps.lattices(&grid, path.clock().time, dt);
            let inflow: f64 = self.taps.inflows(running, dt).sum();
            if self.effects().open_sides {
                self.renewed = reference::renewed_volume(inflow / dt, time_step.control_time);
            }
        }
        Ok(())
    }

    /// Compares the fields after a stage. `clip`: twin of the clipping.
    pub(super) fn compare(
        &mut self,
        stage: Stage,
        after: &LiquidSnapshot,
        clip: Option<&SolidClip>,
        both: Option<&Both>,
    ) -> Result<(), Error> {
        self.table.stage = stage.name();
        let before = self.before.level.clone();
        let level = before.as_ref().zip(after.level.as_ref()).map(|(before, now)| Change { after, before, now });
        match (stage, level) {
            (Stage::Clip, _) => self.clip(after, clip),
            (Stage::AdvectMarkers, None) => self.advect_markers(after),
            (Stage::AdvectMarkers, Some(change)) => self.advect_level_markers(change),
            (Stage::Exchange, _) => self.exchange(after),
            (Stage::AdvectLevel, Some(change)) => self.advect_level(change),
            (Stage::AdvectVelocity, _) if self.effects().maccormack => self.maccormack(after),
            (Stage::AdvectVelocity, _) => self.advect_velocity(after),
            (Stage::Forces, _) => self.forces(after),
            (Stage::Occupancy, Some(change)) => self.occupancy(change),
            (Stage::BoundLevel, Some(change)) => self.bound_level(change),
            (Stage::Redistance, Some(change)) => self.redistance(change),
            (Stage::FilterLevel, Some(change)) => self.filter_level(change),
            // A fixed surface stays.
            (Stage::LiquidDistance, None) if self.effects().markers => self.liquid_distance(after),
            (Stage::LiquidDistance, Some(change)) => self.level_distance(change),
            (Stage::LiquidComponents, Some(change)) => self.liquid_components(change),
            (Stage::VolumeShift, Some(change)) => self.volume_shift(change),
            (Stage::Excess, Some(change)) => self.excess(change),
            (Stage::MarkerBand, Some(change)) => self.marker_band(change),
            (Stage::Landing, Some(change)) => self.landing(change),
            (Stage::ActiveCells, _) => self.active_cells(after, both),
            (Stage::RightHandSide, _) => self.right_hand_side(after, clip, both),
            (Stage::Solve, _) => self.solve(after, both)?,
            (Stage::WriteBack, _) => self.write_back(after),
            (Stage::Extrapolate, _) => self.extrapolate(after, clip, both),
            (Stage::Spray, Some(change)) => self.spray(change),
            (Stage::Diagnose, _) => {
                self.diagnose(after, clip, both);
                self.probes(after);
            }
            // The band selects where the others work; a wrong band shows in their rows.
            _ => {}
        }
        Ok(())
    }

    /// s
    fn dt(&self) -> f64 {
        self.step.dt.into()
    }

    /// Most cells along an axis: the magnitude of a position in cells.
    fn extent(&self) -> f64 {
        self.grid.cells.into_iter().max().unwrap_or(1) as f64
    }

    fn effects(&self) -> Effects {
        Effects::of(self.scene)
    }

    fn gravity(&self) -> DVec3 {
        glam::Vec3::from(self.step.gravity).as_dvec3()
    }

    fn theta_floor(&self) -> ThetaFloor {
        let ThetaFloor { whole, closing } = self.scene.solver.theta_floor;
        ThetaFloor { whole: f64::from(whole as f32), closing: f64::from(closing as f32) }
    }

    /// Clipping runs on the host, so the device stores its results in f32.
    fn clip(&mut self, after: &LiquidSnapshot, clip: Option<&SolidClip>) {
        let Some((device, clip)) = after.cut.as_ref().zip(clip) else { return };
        let cut = clip.cut_cells();
        let rounded = |gpu: &[f64], twin: &[f64], index: usize| {
            let (&gpu, &twin) = (gpu.get(index)?, twin.get(index)?);
            Some((gpu, twin, EPS * twin.abs()))
        };
        self.table.faces(["open fractions", ""], |a, face| rounded(&device.open[a], &cut.open[a], face));
        self.table.cells(["distance", "m"], |cell| rounded(&device.solid_distance, &cut.solid_distance, cell));
        self.cut = device.clone();
        self.open_volumes = reference::open_volumes(&self.grid, &self.cut.solid_distance);
    }

    /// Relative error of a sum over the cells with liquid. The twin adds in sequence in f64; the report has two f32. Sums in f32 have five
    /// roundings per product and one per quad of a thread's share and level of the tree.
    fn sum_error(&self, real: Real, liquid_distance: &[f64]) -> f64 {
        let terms = self.wet_volume(liquid_distance) / self.grid.cell_volume();
        let shares = if real == Real::F32 { 72.0 * EPS } else { 0.0 };
        shares + (terms + 16.0) * f64::EPSILON + EPS * EPS
    }

    /// Bound: [`MarkerError`]. Push-out of obstacles adds the error of the distance and of its normal.
    fn advect_markers(&mut self, after: &LiquidSnapshot) {
        let (grid, dt) = (self.grid, self.dt());
        let (velocity, solid_distance) = (&self.before.velocity, &self.cut.solid_distance);
        let pushed = if self.effects().cuts() { 3.0 * 64.0 * grid.dx } else { 0.0 };
        let distance = reference::surface_distance(&grid, solid_distance, &self.before.liquid_distance);
        let surface = reference::Surface { distance: &distance, radius: f64::from(self.step.marker_radius) * grid.dx };
        let error = MarkerError::new(&grid, velocity, surface, dt);
        let sides = self.scene.domain.open;
        let ballistic = self.ballistic();
        let advect = |start: [f64; 3]| {
            let (walls, markers) = (solid_distance, [start]);
            let advected = reference::advect_markers(&grid, sides, velocity, walls, &surface, &ballistic, &markers, dt);
            advected.0.first().copied()
        };
        let bound = |start: DVec3| error.at(start) + EPS * pushed;
        let markers = [&self.before.markers[..], &after.markers];
        self.add_advected(advected(markers, bound, |_, start| advect(start)));
    }

    /// Adds the rows of [`advected`] markers.
    fn add_advected(&mut self, rows: Vec<Advected>) {
        self.table.add(["markers gone", "flag"], rows.iter().filter_map(|(gone, _)| *gone));
        self.table.add(["positions", "m"], rows.into_iter().flat_map(|(_, positions)| positions));
    }

    /// Deletion and emission depend on the cell of a marker; one within its rounding of a border may be in either cell.
    fn exchange(&mut self, after: &LiquidSnapshot) {
        let (grid, n_before) = (self.grid, self.used_slots());
        let sink = |x: [f64; 3]| reference::sink_markers(&grid, &self.taps, vec![x]).1 == 1;
        let at_border = |x: [f64; 3]| across_borders(&grid, x) != x;
        let slots = self.before.markers.iter().zip(&after.markers).take(n_before).enumerate();
        let old = slots.filter_map(|(slot, (before, gpu))| Some((slot, (*before)?, gpu)));
        let pairs = old.clone().map(|(slot, x, gpu)| {
            let (gone, sinks) = (gpu.is_none(), sink(x));
            (gone == sinks || !at_border(x)).then(|| flag(gone, sinks, Place::Marker(slot, x.into())))
        });
        self.table.add(["markers sunk", "flag"], pairs);
        let mut kept: Vec<[f64; 3]> = old.filter_map(|(.., gpu)| *gpu).collect();
        let (n_kept, borders) = (kept.len(), kept.iter().filter(|&&x| at_border(x)).count());
        let (taps, running, walls) = (&self.taps, self.running, &self.cut.solid_distance);
        // A level fills its sources by volume.
        let filled = if self.effects().level {
            let walls = reference::closed_to_markers(walls, &after.liquid_distance, grid.dx);
            reference::emit_markers(&grid, taps, running, &self.lattices, &walls, &mut kept);
            None
        } else {
            Some(reference::seed_markers(&grid, taps, running, walls, &mut kept).filled)
        };
        let twin = &kept[n_kept..];
        let gpu: Vec<[f64; 3]> = after.markers.iter().skip(n_before).copied().flatten().collect();
        if gpu.len() != twin.len() && gpu.len().abs_diff(twin.len()) <= borders {
            self.table.add(["new positions", "m"], [None::<Pair>]);
            return;
        }
        let quantity = ["markers emitted", ""];
        self.table.whole(quantity, gpu.len() as f64, twin.len() as f64, 0.0);
        if let Some(filled) = filled {
            self.table.whole(quantity, after.report.filled.into(), filled as f64, 0.0);
        }
        self.new_positions(n_before, &gpu, twin);
    }

    /// Slots up to the last one with a marker before the stage.
    fn used_slots(&self) -> usize {
        self.before.markers.iter().rposition(Option::is_some).map_or(0, |last| last + 1)
    }

    /// Compares the positions of new markers, in slots from `first` on. They are off by the roundings of three sums and products in cells, and of
    /// their product with dx.
    fn new_positions(&mut self, first: usize, gpu: &[[f64; 3]], twin: &[[f64; 3]]) {
        let bound = EPS * self.grid.dx * 8.0 * self.extent();
        let positions = gpu.iter().zip(twin).enumerate().flat_map(|(index, (gpu, twin))| {
            components(*gpu, *twin, bound, Place::Marker(first + index, (*twin).into()))
        });
        self.table.add(["new positions", "m"], positions);
    }

    /// Apertures for the advection of velocities, as the device has them.
    fn open_to_advection(&self, after: &LiquidSnapshot) -> [Vec<f64>; 3] {
        open_to_advection(&self.cut.open, |axis, face| after.face_band[axis.index()][face])
    }

    /// Bound: [`advection_error`].
    fn advect_velocity(&mut self, after: &LiquidSnapshot) {
        let (velocity, open, dt) = (&self.before.velocity, &self.open_to_advection(after), self.dt());
        let bound = advection_error(&self.grid, open, (velocity, 0.0), dt);
        let advected = |of: &Ballistic| reference::advect_velocity(&self.grid, open, velocity, of, dt);
        let twin = advected(&self.ballistic());
        let others: Vec<_> = self.near_ballistic().map(|other| advected(&other)).collect();
        let bounds =
            |a: usize, face: usize| bound + largest(others.iter().map(|other| (other[a][face] - twin[a][face]).abs()));
        self.add_band_faces(after, &twin, bounds);
    }

    /// Liquid that touched nothing in the last solve, as the device has it.
    fn ballistic(&self) -> Ballistic<'_> {
        let LiquidSnapshot { filled, ballistic, .. } = &self.before;
        let ballistic = if self.step.n_markers == 0 { &[][..] } else { ballistic };
        Ballistic::new(filled, ballistic, self.gravity(), self.dt())
    }

    /// The same for positions that are off by their error; none where nothing is ballistic. Where one decides otherwise, either is right.
    fn near_ballistic(&self) -> impl Iterator<Item = Ballistic<'_>> {
        let (ballistic, near) = (self.ballistic(), NEAR_BALLISTIC * self.extent() * EPS);
        corners().filter(move |_| !ballistic.is_none()).map(move |corner| ballistic.off_by(near * corner))
    }

    /// One product and one sum; on faces of sources one rounding.
    fn forces(&mut self, after: &LiquidSnapshot) {
        let mut twin = self.before.velocity_next.clone();
        let (gravity, dt) = (self.gravity(), self.dt());
        let before = reference::max_speed(&twin);
        reference::forces(&mut twin, gravity, dt);
        reference::hold_faces(&self.taps, &self.cut.open, self.running.running, &mut twin);
        let bound = EPS * (2.0 * dt * gravity.abs().max_element() + before.max(reference::max_speed(&twin)));
        self.add_band_faces(after, &twin, |_, _| bound);
    }

    /// Compares u* on the faces of the band.
    fn add_band_faces(&mut self, after: &LiquidSnapshot, twin: &[Vec<f64>; 3], bound: impl Fn(usize, usize) -> f64) {
        self.table.faces(["u*", "m/s"], |a, face| {
            after.face_band[a][face].then_some((after.velocity_next[a][face], twin[a][face], bound(a, face)))
        });
    }

    /// A position in cells is off by 3 roundings of its size per axis; root, product and difference add a few. A pass into solids uses coefficients
    /// whose magnitudes sum to less than 3, since a slope is made of differences. It triples the error, and its sums over up to 30 pairs and
    /// 6 neighbours add 110 roundings.
    fn liquid_distance(&mut self, after: &LiquidSnapshot) {
        let grid = self.grid;
        let dx = grid.dx;
        let outside = EPS * dx * (3.0 * 3.0 * self.extent() + 14.0);
        let pass = |error: f64| 3.0 * error + 110.0 * EPS * dx;
        let in_solid = pass(pass(pass(outside)));
        let centres = self.cut.solid_distance.iter();
        let bounds: Vec<f64> = centres.map(|&distance| if distance < 0.0 { in_solid } else { outside }).collect();
        let radius = f64::from(self.step.marker_radius) * dx;
        let markers: Vec<[f64; 3]> = after.markers.iter().copied().flatten().collect();
        // Outside the band the device stores air without a distance, which extends into no body.
        let distance = |phi: f64, cell: usize| if after.band[cell] || phi < 0.0 { phi } else { dx };
        let twin_of = |markers: &[[f64; 3]]| {
            let mut phi = reference::union_of_spheres(&grid, &self.cut.solid_distance, markers, radius);
            reference::extend_spheres(&grid, &self.cut, |cell| after.band[cell], &mut phi);
            reference::empty_sinks(&self.taps, dx, &mut phi);
            phi
        };
        let twin = twin_of(&markers);
        let gpu = &after.liquid_distance;
        let differs = |cell: usize| after.band[cell] && (gpu[cell] - twin[cell]).abs() > bounds[cell];
        // Markers within a rounding of a border, moved to the next cell.
        let other = (0..grid.n_cells()).any(differs).then(|| {
            let moved: Vec<[f64; 3]> = markers.iter().map(|x| across_borders(&grid, *x)).collect();
            twin_of(&moved)
        });
        let agrees = |cell: usize, other: &[f64]| (gpu[cell] - other[cell]).abs() <= 4.0 * bounds[cell];
        self.table.cells(["phi", "m"], |cell| {
            let excused = differs(cell) && other.as_ref().is_some_and(|other| agrees(cell, other));
            Some((!excused).then(|| (distance(gpu[cell], cell), distance(twin[cell], cell), bounds[cell])))
        });
        self.volume_rate(after);
        self.twin.liquid_distance = twin;
        self.twin.distance_bounds = bounds;
    }

    /// Volume of the cells with liquid or at the brink of it, m^3: the scale of the roundings of sums.
    fn wet_volume(&self, liquid_distance: &[f64]) -> f64 {
        let wet = |phi: &&f64| **phi <= 0.5 * self.grid.dx;
        liquid_distance.iter().filter(wet).count() as f64 * self.grid.cell_volume()
    }

    /// The rate is off by the relative error of the volume over the time of the correction.
    fn volume_rate(&mut self, after: &LiquidSnapshot) {
        let phi = &after.liquid_distance;
        let volume = reference::liquid_volume(&self.grid, &self.open_volumes, phi);
        let volume_bound = self.sum_error(after.real, phi) * self.wet_volume(phi);
        let kept = after.markers.iter().flatten().count() - after.report.emitted as usize;
        let gone = after.report.left + after.report.sunk;
        let volume_0 = reference::volume_without(self.step.volume_0.into(), gone.into(), kept);
        let (control_time, dt) = (f64::from(self.step.control_time), self.dt());
        let twin = reference::volume_rate(volume_0, volume, control_time, dt);
        let mut bound = 0.0;
        if volume_0 > 0.0 && volume > 0.0 {
            let quotient = if after.real == Real::F32 { 6.0 * EPS } else { 0.0 };
            let relative = quotient + volume_bound / volume;
            // The slope of the rate, without its limits.
            bound = 2.0 / control_time * (volume_0 / volume) * relative + 8.0 * EPS * twin.abs();
        }
        self.table.whole(["volume rate", "1/s"], after.report.volume_rate, twin, bound);
    }

    /// The set of unknowns and the weights copy signs and apertures, so they are exact. Free-surface terms: theta has the rounding of a difference
    /// and a quotient, its reciprocal of a quotient, a sum of six of five more.
    fn active_cells(&mut self, after: &LiquidSnapshot, both: Option<&Both>) {
        let grid = self.grid;
        let phi = &after.liquid_distance;
        let open = self.taps.pressure_apertures(&self.cut.open, self.running.running);
        let mut twin = reference::active_cells(&grid, &open, phi, self.theta_floor());
        if let Some(both) = both {
            twin.seal(both.clip.coupling(), &both.at_rest.prescribed);
        }
        let (stencil, table) = (&twin.stencil, &mut self.table);
        table.cell_flags("ballistic", &after.ballistic, &reference::ballistic_cells(&open, stencil));
        table.cell_flags("active", &after.active, &stencil.active_mask());
        table.faces(["weights", ""], |a, face| Some((after.weight[a][face], stencil.weight[a][face], 0.0)));
        table.cells(["free-surface terms", ""], |cell| {
            let (gpu, twin) = (after.dirichlet[cell], stencil.dirichlet[cell]);
            Some((gpu, twin, DIRICHLET_ROUNDINGS * EPS * twin))
        });
        table.cells(["1 / diagonal", ""], |cell| {
            let diagonal = stencil.diagonal[cell];
            let twin = if diagonal > 0.0 { 1.0 / diagonal } else { 0.0 };
            // A sum of eleven and a quotient more.
            let bound = (DIRICHLET_ROUNDINGS + 16.0) * EPS * twin;
            Some((after.inverse_diagonal[cell], twin, bound))
        });
        self.twin.active = Some(twin);
    }

    /// Six products and their sum in the scalar type: up to 12 roundings of six speeds. Volume control adds a product of three, prescribed nodes in
    /// enclosed components products with areas in f32, and obstacles a flux in f32.
    fn right_hand_side(&mut self, after: &LiquidSnapshot, clip: Option<&SolidClip>, both: Option<&Both>) {
        let grid = self.grid;
        let active = self.twin.active.take().expect("active_cells comes before right_hand_side");
        let velocity = &self.before.velocity_next;
        let open = self.taps.flux_apertures(&self.cut.open, self.running.running);
        let source = VolumeSource { rate: self.before.report.volume_rate, open_volumes: &self.open_volumes };
        let mut twin = reference::right_hand_side(&grid, &open, velocity, &active, Some(source));
        let of_excess = self.add_excess(&active.stencil.active_mask(), &mut twin);
        let area = grid.dx * grid.dx;
        let speed = active_speed(&grid, &active.stencil, velocity);
        let of_cavities = both.map_or(0.0, |both| self.fill_cavities(both, &active, &mut twin));
        let terms = 12.0 * 6.0 * unit(after.real) * speed + of_excess + of_cavities;
        let rate = after.report.volume_rate.abs();
        let mut bound = terms + EPS * 6.0 * rate * grid.dx;
        let mut gpu = after.rhs.clone();
        reference::remove_means(&active.closed, &mut gpu);
        let mut closed = vec![false; grid.n_cells()];
        active.closed.iter().flatten().for_each(|&cell| closed[cell] = true);
        self.table.cell_flags("closed components", &after.closed, &closed);
        let mut rhs: Vec<f64> = twin.values.iter().map(|b| b / area).collect();
        if let Some(clip) = clip {
            for &(cell, flux) in clip.obstacles().flux() {
                if active.stencil.active(cell) {
                    rhs[cell] -= flux / area;
                    bound = bound.max(terms + 4.0 * EPS * (flux.abs() / area + rate * grid.dx));
                }
            }
            reference::remove_means(&active.closed, &mut rhs);
        }
        self.twin.rhs_of_liquid.clone_from(&rhs);
        if let Some(both) = both {
            let [flux, gross, _] = both.flux(grid.dx, &closed);
            rhs.iter_mut().zip(flux).for_each(|(b, flux)| *b -= flux);
            reference::remove_means(&active.closed, &mut rhs);
            bound += 4.0 * EPS * largest(gross);
        }
        self.table.cells(["E u* / dx^2", "m/s"], |cell| {
            let numbers = (gpu[cell], rhs[cell], bound);
            active.stencil.active(cell).then_some(numbers)
        });
        self.twin.rhs = rhs;
        self.twin.rhs_bound = bound;
        self.twin.flux = twin.scale / area;
        self.twin.active = Some(active);
    }

    /// Adds the sources of the liquid that fills cavities (m^3/s). Returns the error of a source over a sum in f32 and two products, m/s.
    fn fill_cavities(&self, both: &Both, active: &ActiveCells, rhs: &mut reference::RightHandSide) -> f64 {
        let ((cavities, targets), dt) = (both.cavities, self.dt());
        let volumes = cavities.volumes(both.at_rest, &both.solids.displacement);
        let motion = CavityMotion { volumes: &volumes, targets, dt };
        reference::fill_cavities(cavities, both.clip.coupling(), active, motion, &self.open_volumes, rhs);
        let rate = |(&volume, &target): (&f64, &f64)| cavity_source(target, volume, dt).abs() / volume;
        16.0 * EPS * self.grid.dx * largest(volumes.iter().zip(targets).map(rate))
    }

    /// Flags of valid faces are exact. theta has 6 roundings, the quotient by it and the difference 5 and 1; u less that is rounded in the scalar
    /// type and again to f32.
    fn write_back(&mut self, after: &LiquidSnapshot) {
        let grid = self.grid;
        let active = self.before.active_cells(&grid);
        // In units of dt/(rho dx) the potential is the pressure.
        let system = PressureSystem { scale: grid.dx * grid.dx, ..unit_system(active, Vec::new(), 0.0) };
        let open = self.taps.pressure_apertures(&self.cut.open, self.running.running);
        let (u_star, potential, phi) =
            (&self.before.velocity_next, &self.before.potential, &self.before.liquid_distance);
        let mut twin = u_star.clone();
        let mut valid = reference::write_back(&system, potential, &open, phi, self.theta_floor(), &mut twin);
        reference::carry_faces(&self.taps, &self.cut.open, self.running.running, &mut twin, &mut valid);
        self.table.faces(["valid faces", "flag"], |a, face| {
            Some((number(after.valid[a][face]), number(valid[a][face]), 0.0))
        });
        self.table.faces(["u", "m/s"], |a, face| {
            let twin = if valid[a][face] { twin[a][face] } else { 0.0 };
            let change = (twin - u_star[a][face]).abs();
            let bound = EPS * (13.0 * change + 2.0 * twin.abs());
            Some((after.velocity[a][face], twin, bound))
        });
    }

    /// A layer takes the mean of up to six faces: 5 roundings of the sum, a quotient. Along obstacles the direction has the roundings of distances up
    /// to 3 dx over the length of the gradient. The velocity of solids is a mean over three nodes and two places.
    fn extrapolate(&mut self, after: &LiquidSnapshot, clip: Option<&SolidClip>, both: Option<&Both>) {
        let grid = self.grid;
        let layers = reference::n_layers(self.scene.time.cfl);
        let (triangles, nodes): (&[_], &[_]) =
            both.map_or((&[], &[]), |both| (&both.at_rest.triangles, &both.solids.velocity));
        let walls = clip.map(|clip| MovingWalls { clip, triangles, velocity: nodes });
        let obstacles = clip.map_or(&[][..], |clip| clip.obstacles().wall_velocities());
        let obstacles = obstacles.iter().map(|(_, v)| v.abs().max_element());
        let wall_speed = largest(nodes.as_flattened().iter().map(|v| v.abs()).chain(obstacles));
        let speed = 3.0 * wall_speed + reference::max_speed(&self.before.velocity);
        let mut twin = self.before.velocity.clone();
        let valid = self.before.valid.clone();
        let largest = if self.effects().maccormack { self.step.largest_slope.into() } else { 0.0 };
        let extent = (layers, largest);
        let held = self.effects().separation.then(|| {
            let pairs = self.before.active.iter().zip(&self.before.separated);
            pairs.map(|(active, separated)| *active && !*separated).collect::<Vec<_>>()
        });
        reference::extrapolate_one_sided(&grid, &self.cut, (walls, held.as_deref()), valid, extent, &mut twin);
        // Blended neighbour velocities: two sums of up to 26, products and a quotient.
        let blended = if self.effects().cuts() { 64.0 } else { 0.0 };
        let means = EPS * speed * (blended + 10.0 * layers as f64);
        let cut = self.effects().cuts().then_some(&self.cut);
        self.table.faces(["u", "m/s"], |a, face| {
            // Outside the band the device has no velocities, not even those of bodies.
            let twin = if after.face_band[a][face] { twin[a][face] } else { 0.0 };
            let gpu = after.velocity[a][face];
            let slip = match cut.filter(|cut| cut.open[a][face] == 0.0) {
                Some(cut) => slip_roundings(&grid, &cut.solid_distance, Axis::ALL[a], face),
                None => Some(0.0),
            };
            // With free slip or without it, no face is faster than a vector of three such components.
            let possible = gpu.abs() <= 3.0_f64.sqrt() * speed + means;
            let excused = slip.is_none() && possible && (gpu - twin).abs() > means;
            Some((!excused).then(|| (gpu, twin, means + EPS * speed * slip.unwrap_or(0.0))))
        });
        self.twin.velocity = twin;
        let worst = self.table.row(["u", "m/s"]).worst;
        self.twin.velocity_bound = worst.map_or(means, |worst| means.max(worst.bound));
    }

    /// Sums: [`LiquidComparison::sum_error`]. The largest speed copies a number. Divergence: twelve products summed, rounded to f32 and multiplied by
    /// 1/dx; the flux of solids is a sum of products with areas in f32.
    fn diagnose(&mut self, after: &LiquidSnapshot, clip: Option<&SolidClip>, both: Option<&Both>) {
        let grid = self.grid;
        let filled = self.effects().level.then(|| reference::filled_distance(&grid, &after.liquid_distance));
        let phi = filled.as_ref().unwrap_or(&after.liquid_distance);
        let (density, gravity) = (f64::from(self.step.density), self.gravity());
        let stencil = after.active_cells(&grid).stencil;
        let (mut boundary_flux, mut area_error) = (vec![0.0; grid.n_cells()], 0.0);
        if let Some(both) = both {
            let [flux, gross, _] = both.flux(grid.dx, &after.active);
            boundary_flux = flux.into_iter().map(|flux| grid.dx * grid.dx * flux).collect();
            area_error = 4.0 * EPS * largest(gross) / grid.dx;
            self.diagnose_coupling(after, both);
        }
        for &(cell, flux) in clip.map_or(&[][..], |clip| clip.obstacles().flux()) {
            boundary_flux[cell] += flux;
            area_error = area_error.max(4.0 * EPS * flux.abs() / grid.cell_volume());
        }
        let (cut, velocity) = (&self.cut, &after.velocity);
        let open = self.taps.flux_apertures(&cut.open, self.running.running);
        // Separated cells open.
        let masked = after.separated.contains(&true).then(|| stencil.masked(&after.separated));
        let solved = masked.as_ref().unwrap_or(&stencil);
        let left = reference::divergence(&open, velocity, solved, Some(&boundary_flux));
        let mut twin = reference::diagnose(&grid, cut, phi, velocity, left, density, gravity);
        let spray = after.spray();
        reference::add_spray(&grid, (density, gravity), spray.iter().copied(), &mut twin);
        let gpu = after.report.diagnosis;
        let spray_volume = spray.len() as f64 * grid.cell_volume() / 8.0;
        // A filled part is a mean of eight samples of up to five cells, each of 27 values, doubled.
        let parts = if self.effects().level { 160.0 * EPS } else { 0.0 };
        let off = self.sum_error(after.real, phi) + parts;
        let volume = off * (self.wet_volume(phi) + spray_volume);
        let spray_speed = largest(spray.iter().flat_map(|(_, v)| v.map(f64::abs)));
        let (mass, speed) = (density * volume, twin.max_speed.max(spray_speed));
        let height = gravity.abs().dot(grid.size());
        let flux = active_speed(&grid, &stencil, velocity) / grid.dx;
        let divergence = 72.0 * unit(after.real) * flux + 4.0 * EPS * twin.divergence.abs() + area_error;
        // Sums over the spray are of whole quanta, 2^-12 cells.
        let spray_mass = density * spray_volume;
        let quantum = grid.dx * (-13.0_f64).exp2() * spray_mass;
        let (way, height_quantum) = (quantum / self.dt(), quantum * gravity.length());
        let energy = 1.5 * mass * speed * speed + 0.5 * way * (grid.dx / self.dt());
        let ([px, py, pz], [qx, qy, qz], momentum) = (gpu.momentum, twin.momentum, mass * speed + way);
        // The largest speed is that of the faces, without spray.
        self.table.wholes([
            ("volume", "m^3", gpu.volume, twin.volume, volume),
            ("momentum x", "kg m/s", px, qx, momentum),
            ("momentum y", "kg m/s", py, qy, momentum),
            ("momentum z", "kg m/s", pz, qz, momentum),
            ("kinetic energy", "J", gpu.kinetic_energy, twin.kinetic_energy, energy),
            ("potential energy", "J", gpu.potential_energy, twin.potential_energy, mass * height + height_quantum),
            ("largest speed", "m/s", gpu.max_speed, twin.max_speed, 0.0),
            ("divergence", "1/s", gpu.divergence, twin.divergence, divergence),
        ]);
    }

    /// Whether liquid and solids touch, and the sum of J^T p with areas in f32: a rounding per node of a sum and level of the tree in f32.
    fn diagnose_coupling(&mut self, after: &LiquidSnapshot, both: &Both) {
        let Some(report) = both.report else { return };
        let [force, gross] = both.force(self.pascal());
        let [force, gross] = [force, gross].map(|nodes| nodes.into_iter().sum::<DVec3>());
        let bound = (4.0 * EPS + 64.0 * unit(after.real)) * gross.length();
        self.table.add(["J^T p", "N"], components(report.force, force.into(), bound, Place::Whole));
        self.table.add(["touching", "flag"], [flag(report.touching, both.touch(), Place::Whole)]);
    }

    /// Probes of the device's fields, and of those of the twins. Velocity and pressure are means, so their error is that of the fields. Heights and
    /// fronts decrease where phi increases: their bounds are those of phi shifted by its error.
    fn probes(&mut self, after: &LiquidSnapshot) {
        let grid = self.grid;
        let gpu = State {
            velocity: after.velocity.clone(),
            pressure: after.potential.iter().map(|phi| self.pascal() * phi).collect(),
            liquid_distance: after.liquid_distance.clone(),
            active: after.active.clone(),
            ..State::at_rest(&grid)
        };
        let twin = State { velocity: self.twin.velocity.clone(), pressure: self.twin.pressure.clone(), ..gpu.clone() };
        let shifted = |shift: f64| {
            let twin = self.twin.liquid_distance.iter();
            let phi: Vec<f64> = twin.zip(&self.twin.distance_bounds).map(|(phi, bound)| phi + shift * bound).collect();
            let active = reference::active_cells(&grid, &self.cut.open, &phi, self.theta_floor());
            State { active: active.stencil.active_mask(), liquid_distance: phi, ..gpu.clone() }
        };
        let surfaces = [0.0, 1.0, -1.0].map(shifted);
        self.table.stage = "probes";
        let mut column = 0;
        for probe in &self.scene.probes {
            let read = |state: &State| reference::probe(&grid, &self.cut.open, state, &probe.kind);
            // `rounding`: relative error of a sum, besides `bound`.
            let (quantity, twin, bound, rounding) = match &probe.kind {
                ProbeKind::Pressure { .. } => (["pressure", "Pa"], read(&twin), self.twin.pressure_bound, 1e-12),
                ProbeKind::Velocity { .. } => (["velocity", "m/s"], read(&twin), self.twin.velocity_bound, 0.0),
                ProbeKind::Height { .. } | ProbeKind::Front { .. } => {
                    let [twin, low, high] = [0, 1, 2].map(|s| read(&surfaces[s])[0]);
                    let reach = (low - twin).abs().max((high - twin).abs());
                    (["surface", "m"], vec![twin], reach + 1e-12 * grid.size().max_element(), 0.0)
                }
                ProbeKind::Flux { axis, min, max } => {
                    let sides = *max - *min;
                    let area = sides[(axis + 1) % 3] * sides[(axis + 2) % 3];
                    (["flux", "m^3/s"], read(&twin), area * self.twin.velocity_bound, 1e-12)
                }
                // Both paths evaluate those of the solids by the same function of the nodes, which have their own rows.
                _ => continue,
            };
            for (gpu, twin) in read(&gpu).into_iter().zip(twin) {
                let bound = bound + rounding * gpu.abs();
                self.table.add(quantity, [(gpu, twin, bound, Place::Column(column))]);
                column += 1;
            }
        }
    }
}

/// Error of the direction along an obstacle at a closed face, in roundings of the speed; `None` where rounding decides whether the face slips.
fn slip_roundings(grid: &Grid, solid_distance: &[f64], axis: Axis, face: usize) -> Option<f64> {
    let ijk = grid.face_at(axis, face);
    if grid.face_sides(axis, ijk).contains(&None) {
        return Some(0.0);
    }
    let x = grid.face_centre(axis, ijk);
    let at = |x: DVec3| grid.sample_cells(solid_distance, x);
    // The mean of two distances, and half a cell.
    if (at(x) - 0.5 * grid.dx).abs() <= EPS * 4.0 * 3.0 * grid.dx {
        return None;
    }
    let gradient = DVec3::from(DVec3::AXES.map(|axis| {
        let half = axis * (0.5 * grid.dx);
        (at(x + half) - at(x - half)) / grid.dx
    }));
    let length = gradient.length();
    // Below 1e-6 there is no direction; near it rounding decides.
    (length >= 1e-5).then(|| 4.0 * 3.0 / length)
}

/// Flag and positions of a marker after its advection; `None` is excused.
type Advected = (Option<Pair>, Vec<Option<Pair>>);

/// Markers in slots before and after their advection. `bound`: error of the end of a marker by its start, m; `advect`: twin of the marker in a slot.
fn advected(
    [before, after]: [&[Marker]; 2],
    bound: impl Fn(DVec3) -> f64 + Sync,
    advect: impl Fn(usize, [f64; 3]) -> Marker + Sync,
) -> Vec<Advected> {
    let rows = before.par_iter().zip(after).enumerate().map(|(slot, (start, gpu))| {
        let place = Place::Marker(slot, start.unwrap_or_default().into());
        let bound = start.map_or(0.0, |start| bound(start.into()));
        let twin = start.and_then(|start| advect(slot, start));
        let agree = match gpu.zip(twin) {
            Some((gpu, twin)) => (0..3).all(|a| (gpu[a] - twin[a]).abs() <= bound),
            None => gpu.is_none() == twin.is_none(),
        };
        let decides = |start| depends_on_start(start, gpu, bound, |start| advect(slot, start));
        if !agree && start.is_some_and(decides) {
            return (None, vec![None; 3]);
        }
        let positions = gpu.zip(twin).map(|(gpu, twin)| components(gpu, twin, bound, place).map(Some).to_vec());
        (Some(flag(gpu.is_none(), twin.is_none(), place)), positions.unwrap_or_default())
    });
    rows.collect()
}

/// Whether the rounding of its start decides the end of a marker: the gradient of the distance jumps, or its sign changes. Compares with starts
/// shifted by the bound (m) along each diagonal.
fn depends_on_start(start: [f64; 3], gpu: &Marker, bound: f64, advect: impl Fn([f64; 3]) -> Marker) -> bool {
    let shifted: Vec<Marker> = corners().map(|corner| advect((DVec3::from(start) + bound * corner).into())).collect();
    let Some(x) = gpu else { return shifted.iter().any(Option::is_none) };
    (0..3).all(|a| {
        let ends = || shifted.iter().flatten().map(|end| end[a]);
        let low = ends().fold(f64::INFINITY, f64::min);
        let high = ends().fold(f64::NEG_INFINITY, f64::max);
        (low - bound..=high + bound).contains(&x[a])
    })
}

/// Roundings of a free-surface term.
const DIRICHLET_ROUNDINGS: f64 = 17.0;

/// Largest speed of a face of an active cell, m/s.
fn active_speed(grid: &Grid, stencil: &Stencil, velocity: &[Vec<f64>; 3]) -> f64 {
    largest(Axis::ALL.into_iter().flat_map(|axis| {
        let sides = move |face| grid.face_sides(axis, grid.face_at(axis, face)).into_iter().flatten();
        let faces = velocity[axis.index()].iter().enumerate();
        faces.filter(move |(face, _)| sides(*face).any(|cell| stencil.active(cell))).map(|(_, v)| v.abs())
    }))
}

/// Position of a marker (m) beyond every cell border that is within its rounding in cells.
fn across_borders(grid: &Grid, x: [f64; 3]) -> [f64; 3] {
    let dx = grid.dx;
    x.map(|x| {
        let cells = x / dx;
        let border = cells.round();
        let rounding = 3.0 * EPS * cells.max(1.0);
        match border > 0.0 && (cells - border).abs() <= rounding {
            true => (border - rounding * (cells - border + 1e-30).signum()) * dx,
            false => x,
        }
    })
}
