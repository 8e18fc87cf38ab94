//! The stages of the liquid against their twins.

mod pressure;

use glam::DVec3;
use rayon::prelude::*;

use super::table::{Place, Table, number};
use super::{Both, EPS, unit};
use crate::Error;
use crate::effects::Effects;
use crate::fields::Step;
use crate::geometry::{CutCells, Running, SolidClip, SourcesAndSinks};
use crate::gpu::Real;
use crate::grid::{Axis, Grid};
use crate::measure::bounds::{MarkerError, advection_error, open_to_advection};
use crate::reference::{
    self, ActiveCells, MovingWalls, PressureSystem, RightHandSide as Inflow, Stencil, TimeStep,
    VolumeSource,
};
use crate::scene::{ProbeKind, Scene};
use crate::sim::{GpuPath, LiquidSnapshot};
use crate::state::State;
use crate::step::Stage;

/// The twins of a scene, fed with what the device holds.
pub(super) struct LiquidJudge<'a> {
    scene: &'a Scene,
    /// With the dx of the device.
    grid: Grid,
    /// As the device has them.
    cut: CutCells,
    open_volumes: Vec<f64>,
    taps: SourcesAndSinks,
    /// What the sources do in the sub-step.
    running: Running,
    step: Step,
    pub(super) table: Table,
    /// What the stage had.
    before: LiquidSnapshot,
    /// What twins of earlier stages of the sub-step made, for later ones.
    twin: Twin,
}

/// Answers of the twins in a sub-step.
#[derive(Default)]
struct Twin {
    liquid_distance: Vec<f64>,
    /// How far off the device's may be, per cell, m.
    distance_bounds: Vec<f64>,
    /// Of the stored liquid distance, all in f64.
    active: Option<ActiveCells>,
    /// m/s, and how far off the device's may be.
    rhs: Vec<f64>,
    rhs_bound: f64,
    /// Norm of |E| |u*|, m/s.
    flux: f64,
    /// Pa.
    pressure: Vec<f64>,
    pressure_bound: f64,
    velocity: [Vec<f64>; 3],
    velocity_bound: f64,
}

impl<'a> LiquidJudge<'a> {
    /// `None` for a scene without liquid.
    pub(super) fn new(scene: &'a Scene, path: &GpuPath) -> Result<Option<LiquidJudge<'a>>, Error> {
        let (Some(step), Some(before)) =
            (path.step_numbers(TimeStep::NONE), path.snapshot()?.liquid)
        else {
            return Ok(None);
        };
        let grid = Grid {
            cells: scene.domain.cells,
            dx: step.dx.into(),
        };
        let single = |values: &Vec<f64>| {
            let values = values.iter().map(|&value| f64::from(value as f32));
            values.collect::<Vec<f64>>()
        };
        let cut = path.cut_cells();
        let cut = CutCells {
            open: [0, 1, 2].map(|axis| single(&cut.open[axis])),
            solid_distance: single(&cut.solid_distance),
        };
        Ok(Some(LiquidJudge {
            scene,
            grid,
            open_volumes: reference::open_volumes(&grid, &cut.solid_distance),
            cut,
            taps: path
                .taps()
                .map_or_else(SourcesAndSinks::default, |(taps, _)| taps.clone()),
            running: Running::default(),
            step,
            table: Table::default(),
            twin: Twin {
                liquid_distance: before.liquid_distance.clone(),
                distance_bounds: vec![0.0; grid.n_cells()],
                ..Twin::default()
            },
            before,
        }))
    }

    /// Before `solve` is judged: the unknowns and E u* (m^3/s) as the device stores them, and as the twins assemble them.
    pub(super) fn systems(
        &self,
        after: &LiquidSnapshot,
        both: &Both,
    ) -> Option<[(ActiveCells, Inflow); 2]> {
        let area = self.grid.dx * self.grid.dx;
        let assembled = self.twin.active.clone()?;
        let mut stored = after.active_cells(&self.grid);
        stored.seal(both.clip.coupling(), &both.at_rest.prescribed);
        let rhs = |values: &[f64]| Inflow {
            values: values.iter().map(|b| area * b).collect(),
            scale: area * self.twin.flux,
        };
        let [of_device, of_twin] = [rhs(&self.before.rhs), rhs(&self.twin.rhs)];
        Some([(stored, of_device), (assembled, of_twin)])
    }

    /// Hears of the next sub-step.
    pub(super) fn begin(&mut self, path: &GpuPath, time_step: TimeStep) {
        self.table.step = path.clock().step;
        if let Some(step) = path.step_numbers(time_step) {
            self.step = step;
        }
        if let Some((_, running)) = path.taps() {
            self.running = running;
        }
    }

    /// Judges what a stage left; `held` is what the device really holds, `clip` as the twin clips what moves.
    pub(super) fn judge(
        &mut self,
        stage: Stage,
        after: &LiquidSnapshot,
        held: Option<LiquidSnapshot>,
        clip: Option<&SolidClip>,
        both: Option<&Both>,
    ) -> Result<(), Error> {
        self.judge_stage(stage, after, clip, both)?;
        self.before = held.unwrap_or_else(|| after.clone());
        Ok(())
    }

    /// Open fractions for the pressure: without the faces that sources hold.
    fn open_to_pressure(&self) -> [Vec<f64>; 3] {
        self.taps
            .pressure_apertures(&self.cut.open, self.running.running)
    }

    /// Open fractions of the fluxes: with the apertures of sources on the faces that they hold.
    fn open_to_flux(&self) -> [Vec<f64>; 3] {
        self.taps
            .flux_apertures(&self.cut.open, self.running.running)
    }

    fn judge_stage(
        &mut self,
        stage: Stage,
        after: &LiquidSnapshot,
        clip: Option<&SolidClip>,
        both: Option<&Both>,
    ) -> Result<(), Error> {
        match stage {
            Stage::Clip => {
                if let Some(clip) = clip {
                    self.clip(after, clip);
                }
            }
            Stage::AdvectMarkers => self.advect_markers(after),
            Stage::Exchange => self.exchange(after),
            Stage::AdvectVelocity => self.advect_velocity(after),
            Stage::Forces => self.forces(after),
            // A fixed surface stays.
            Stage::LiquidDistance if Effects::of(self.scene).markers => {
                self.liquid_distance(after);
            }
            Stage::ActiveCells => self.active_cells(after, both),
            Stage::RightHandSide => self.right_hand_side(after, clip, both),
            Stage::Solve => self.solve(after, both)?,
            Stage::WriteBack => self.write_back(after),
            Stage::Extrapolate => self.extrapolate(after, clip, both),
            Stage::Diagnose => {
                self.diagnose(after, clip, both);
                self.probes(after);
            }
            // The band decides where the others work; what it leaves out shows in theirs.
            _ => {}
        }
        Ok(())
    }

    /// s
    fn dt(&self) -> f64 {
        self.step.dt.into()
    }

    /// Most cells along an axis: the size of a position in cells.
    fn extent(&self) -> f64 {
        self.grid.cells.into_iter().max().unwrap_or(1) as f64
    }

    fn gravity(&self) -> DVec3 {
        glam::Vec3::from(self.step.gravity).as_dvec3()
    }

    fn theta_floor(&self) -> f64 {
        self.step.theta_floor.into()
    }

    /// Whether obstacles or solids cut the grid.
    fn cuts(&self) -> bool {
        Effects::of(self.scene).cuts()
    }

    /// The device's copies of what the host clipped.
    fn clip(&mut self, after: &LiquidSnapshot, clip: &SolidClip) {
        let (grid, cut) = (self.grid, clip.cut_cells());
        let Some(device) = &after.cut else { return };
        let rounded = |gpu: &[f64], twin: &[f64], index: usize| {
            let (&gpu, &twin) = (gpu.get(index)?, twin.get(index)?);
            Some((gpu, twin, EPS * twin.abs()))
        };
        let row = [Stage::Clip.name(), "open fractions", ""];
        self.table.faces(&grid, row, |a, face| {
            rounded(&device.open[a], &cut.open[a], face)
        });
        let row = [Stage::Clip.name(), "distance", "m"];
        self.table.cells(&grid, row, |cell| {
            rounded(&device.solid_distance, &cut.solid_distance, cell)
        });
        self.cut = device.clone();
        self.open_volumes = reference::open_volumes(&grid, &self.cut.solid_distance);
    }

    /// Relative error of a sum over the cells that hold liquid. The twin adds them one after another in f64; the report holds two
    /// f32. Where the device sums in f32: five products and quotients of a term, and a sum per quad of a share and level of the tree.
    fn sum_error(&self, real: Real, liquid_distance: &[f64]) -> f64 {
        let terms = self.wet_volume(liquid_distance) / self.grid.cell_volume();
        let shares = if real == Real::F32 { 72.0 * EPS } else { 0.0 };
        shares + (terms + 16.0) * f64::EPSILON + EPS * EPS
    }

    /// As [`MarkerError`] says. Push-out moves by the distance's error and turns by the normal's.
    fn advect_markers(&mut self, after: &LiquidSnapshot) {
        let (grid, dt) = (self.grid, self.dt());
        let (velocity, solid_distance) = (&self.before.velocity, &self.cut.solid_distance);
        let pushed = if self.cuts() {
            3.0 * 64.0 * grid.dx
        } else {
            0.0
        };
        let phi = &self.before.liquid_distance;
        let distance = reference::surface_distance(&grid, solid_distance, phi);
        let surface = reference::Surface {
            distance: &distance,
            radius: f64::from(self.step.marker_radius) * grid.dx,
        };
        let error = MarkerError::new(&grid, velocity, surface, dt);
        let bound = |start: [f64; 3]| error.at(start.into()) + EPS * pushed;
        let sides = self.scene.domain.open;
        let twin = |start: [f64; 3]| {
            let markers = [start];
            reference::advect_markers(
                &grid,
                sides,
                velocity,
                solid_distance,
                &surface,
                &markers,
                dt,
            )
            .0
            .pop()
        };
        let close = |gpu: &Option<[f64; 3]>, twin: &Option<[f64; 3]>, bound: f64| match (gpu, twin)
        {
            (Some(gpu), Some(twin)) => (0..3).all(|a| (gpu[a] - twin[a]).abs() <= bound),
            (gpu, twin) => gpu.is_none() == twin.is_none(),
        };
        // Where the gradient of the distance jumps, or its sign decides, a start that is off by a rounding ends elsewhere.
        let excused = |start: [f64; 3], gpu: &Option<[f64; 3]>, bound: f64| {
            let shifted: Vec<_> = (0..8)
                .map(|corner| {
                    twin(std::array::from_fn(|a| {
                        start[a] + if corner >> a & 1 == 1 { bound } else { -bound }
                    }))
                })
                .collect();
            match gpu {
                None => shifted.iter().any(Option::is_none),
                Some(x) => (0..3).all(|a| {
                    let ends = || shifted.iter().flatten().map(|end| end[a]);
                    let low = ends().fold(f64::INFINITY, f64::min);
                    let high = ends().fold(f64::NEG_INFINITY, f64::max);
                    (low - bound..=high + bound).contains(&x[a])
                }),
            }
        };
        let pairs: Vec<_> = self
            .before
            .markers
            .par_iter()
            .zip(&after.markers)
            .map(|(start, gpu)| {
                let end = start.and_then(twin);
                let bound = start.map_or(0.0, bound);
                let excused = !close(gpu, &end, bound)
                    && start.is_some_and(|start| excused(start, gpu, bound));
                (bound, *gpu, end, excused)
            })
            .collect();
        let place = |index: usize| {
            Place::Marker(index, self.before.markers[index].unwrap_or_default().into())
        };
        let judged = || pairs.iter().enumerate().filter(|(_, pair)| !pair.3);
        self.table.add_flags(
            [Stage::AdvectMarkers.name(), "markers gone"],
            judged()
                .map(|(index, (_, gpu, twin, _))| (gpu.is_none(), twin.is_none(), place(index))),
        );
        self.table.add(
            [Stage::AdvectMarkers.name(), "positions", "m"],
            judged().flat_map(|(index, &(bound, gpu, twin, _))| {
                let both = gpu.zip(twin).into_iter();
                both.flat_map(move |(gpu, twin)| {
                    (0..3).map(move |a| (gpu[a], twin[a], bound, index))
                })
                .map(|(gpu, twin, bound, index)| (gpu, twin, bound, place(index)))
            }),
        );
        let n_excused = pairs.iter().filter(|pair| pair.3).count();
        self.table
            .row(Stage::AdvectMarkers.name(), "positions", "m")
            .excused += 3 * n_excused as u64;
    }

    /// Which markers sink and how many cells of sources lack depends on the cell that a marker is in: those within their rounding of a border
    /// may be in either. New places are off by the roundings of three sums and products in cells, and of their product with dx.
    fn exchange(&mut self, after: &LiquidSnapshot) {
        let grid = self.grid;
        let n_before = self.before.markers.iter().rposition(Option::is_some);
        let n_before = n_before.map_or(0, |last| last + 1);
        let taps = self.taps.clone();
        let sink = |x: [f64; 3]| reference::sink_markers(&grid, &taps, vec![x]).1 == 1;
        let at_border = |x: [f64; 3]| across_borders(&grid, x) != x;
        let mut kept = Vec::new();
        let mut excused = 0;
        let mut pairs = Vec::new();
        let old = self.before.markers.iter().zip(&after.markers);
        for (index, (before, gpu)) in old.take(n_before).enumerate() {
            let Some(x) = *before else { continue };
            let (gone, sinks) = (gpu.is_none(), sink(x));
            if gone != sinks && at_border(x) {
                excused += 1;
            } else {
                pairs.push((gone, sinks, Place::Marker(index, x.into())));
            }
            kept.extend(*gpu);
        }
        self.table
            .add_flags([Stage::Exchange.name(), "markers sunk"], pairs);
        self.table
            .row(Stage::Exchange.name(), "markers sunk", "flag")
            .excused += excused;
        let mut excused = 0;
        let borders = kept.iter().filter(|&&x| at_border(x)).count();
        let n_kept = kept.len();
        let seeded = reference::seed_markers(
            &grid,
            &taps,
            self.running,
            &self.cut.solid_distance,
            &mut kept,
        );
        let twin = &kept[n_kept..];
        let new = &after.markers[n_before.min(after.markers.len())..];
        let gpu: Vec<[f64; 3]> = new.iter().copied().flatten().collect();
        if gpu.len() != twin.len() && gpu.len().abs_diff(twin.len()) <= borders {
            excused += 1;
        } else {
            let counts = [gpu.len(), twin.len()].map(|n| n as f64);
            let filled = [after.report.filled.into(), seeded.filled as f64];
            let numbers = [counts, filled].map(|[gpu, twin]| (gpu, twin, 0.0, Place::Whole));
            self.table
                .add([Stage::Exchange.name(), "markers emitted", ""], numbers);
            let bound = EPS * grid.dx * 8.0 * self.extent();
            let places = gpu.iter().zip(twin).enumerate();
            self.table.add(
                [Stage::Exchange.name(), "new positions", "m"],
                places.flat_map(|(index, (gpu, twin))| {
                    let place = move || Place::Marker(n_before + index, (*twin).into());
                    (0..3).map(move |a| (gpu[a], twin[a], bound, place()))
                }),
            );
        }
        self.table
            .row(Stage::Exchange.name(), "new positions", "m")
            .excused += excused;
    }

    /// As [`advection_error`] says.
    fn advect_velocity(&mut self, after: &LiquidSnapshot) {
        let (velocity, dt) = (&self.before.velocity, self.dt());
        let in_band = |axis: Axis, face: usize| after.face_band[axis.index()][face];
        let open = &open_to_advection(&self.cut.open, in_band);
        let bound = advection_error(&self.grid, open, velocity, dt);
        let twin = reference::advect_velocity(&self.grid, open, velocity, dt);
        self.add_band_faces([Stage::AdvectVelocity.name(), "u*"], after, &twin, bound);
    }

    /// One product and one sum.
    fn forces(&mut self, after: &LiquidSnapshot) {
        let mut twin = self.before.velocity_next.clone();
        let (gravity, dt) = (self.gravity(), self.dt());
        let bound = EPS * (2.0 * dt * gravity.abs().max_element() + reference::max_speed(&twin));
        reference::forces(&mut twin, gravity, dt);
        reference::hold_faces(&self.taps, &self.cut.open, self.running.running, &mut twin);
        self.add_band_faces([Stage::Forces.name(), "u*"], after, &twin, bound);
    }

    /// u* on the faces of the band against the twin's.
    fn add_band_faces(
        &mut self,
        [stage, quantity]: [&'static str; 2],
        after: &LiquidSnapshot,
        twin: &[Vec<f64>; 3],
        bound: f64,
    ) {
        let row = [stage, quantity, "m/s"];
        self.table.faces(&self.grid, row, |a, face| {
            let numbers = (after.velocity_next[a][face], twin[a][face], bound);
            after.face_band[a][face].then_some(numbers)
        });
    }

    /// A position in cells is off by its size times 3 roundings per axis; root, product and difference add a few. A pass into solids
    /// takes values with coefficients whose magnitudes add up to less than 3, a slope being made of differences: it triples what they
    /// are off by, and its sums over up to 30 pairs and 6 neighbours add 110 roundings.
    fn liquid_distance(&mut self, after: &LiquidSnapshot) {
        let grid = self.grid;
        let dx = grid.dx;
        let outside = EPS * dx * (3.0 * 3.0 * self.extent() + 14.0);
        let pass = |off: f64| 3.0 * off + 110.0 * EPS * dx;
        let in_solid = pass(pass(pass(outside)));
        let centres = self.cut.solid_distance.iter();
        let bounds: Vec<f64> = centres
            .map(|&distance| if distance < 0.0 { in_solid } else { outside })
            .collect();
        let radius = f64::from(self.step.marker_radius) * dx;
        let markers: Vec<[f64; 3]> = after.markers.iter().copied().flatten().collect();
        let mut twin = reference::liquid_distance(&grid, &self.cut, &markers, radius);
        reference::empty_sinks(&self.taps, dx, &mut twin);
        let gpu = &after.liquid_distance;
        let differs = |cell: usize, twin: &[f64]| (gpu[cell] - twin[cell]).abs() > bounds[cell];
        let in_band = |cell: &usize| after.band[*cell];
        let mut excused = vec![false; grid.n_cells()];
        if (0..grid.n_cells())
            .filter(in_band)
            .any(|cell| differs(cell, &twin))
        {
            // Markers so close to the border of a cell that a rounding puts them into the next, put there.
            let moved: Vec<[f64; 3]> = markers.iter().map(|x| across_borders(&grid, *x)).collect();
            let other = reference::liquid_distance(&grid, &self.cut, &moved, radius);
            for cell in (0..grid.n_cells()).filter(in_band) {
                excused[cell] =
                    differs(cell, &twin) && (gpu[cell] - other[cell]).abs() <= 4.0 * bounds[cell];
            }
        }
        let distance = |distance: &[f64], cell: usize| {
            // Outside the band the device says air, without saying how far.
            if after.band[cell] || distance[cell] < 0.0 {
                distance[cell]
            } else {
                dx
            }
        };
        let row = [Stage::LiquidDistance.name(), "phi", "m"];
        self.table.cells(&grid, row, |cell| {
            let numbers = (distance(gpu, cell), distance(&twin, cell), bounds[cell]);
            (!excused[cell]).then_some(numbers)
        });
        self.table
            .row(Stage::LiquidDistance.name(), "phi", "m")
            .excused += excused.iter().filter(|&&excused| excused).count() as u64;
        self.volume_rate(after);
        self.twin.liquid_distance = twin;
        self.twin.distance_bounds = bounds;
    }

    /// Cells that hold liquid or are on the brink of it, times their volume: what the roundings of sums are measured against, m^3.
    fn wet_volume(&self, liquid_distance: &[f64]) -> f64 {
        let wet = |phi: &&f64| **phi <= 0.5 * self.grid.dx;
        liquid_distance.iter().filter(wet).count() as f64 * self.grid.cell_volume()
    }

    /// The rate is off by the volume's error, relative to it, over the time of the correction.
    fn volume_rate(&mut self, after: &LiquidSnapshot) {
        let phi = &after.liquid_distance;
        let volume = reference::liquid_volume(&self.grid, &self.open_volumes, phi);
        let volume_bound = self.sum_error(after.real, phi) * self.wet_volume(phi);
        // What is there without the new ones.
        let alive = after.markers.iter().flatten().count();
        let kept = alive - after.report.emitted as usize;
        let gone = after.report.left + after.report.sunk;
        let volume_0 = f64::from(self.step.volume_0);
        let volume_0 = reference::volume_without(volume_0, gone.into(), kept);
        let (control_time, dt) = (f64::from(self.step.control_time), self.dt());
        let (twin, bound) = if volume_0 > 0.0 && volume > 0.0 {
            let rate = |volume| reference::volume_rate(volume_0, volume, control_time, dt);
            let twin = rate(volume);
            let ratio = volume_0 / volume;
            // The slope of the rate, without its limits.
            let per_ratio = 2.0 / control_time;
            let quotient = if after.real == Real::F32 {
                6.0 * EPS
            } else {
                0.0
            };
            let relative = quotient + volume_bound / volume;
            (twin, per_ratio * ratio * relative + 8.0 * EPS * twin.abs())
        } else {
            (0.0, 0.0)
        };
        let row = [Stage::LiquidDistance.name(), "volume rate", "1/s"];
        self.table.whole(row, after.report.volume_rate, twin, bound);
    }

    /// The set of unknowns and the weights copy signs and open fractions, so they are exact. Free-surface terms: theta is off by
    /// one difference and one quotient, its reciprocal by a quotient, a sum of six by five more.
    fn active_cells(&mut self, after: &LiquidSnapshot, both: Option<&Both>) {
        let grid = self.grid;
        let phi = &after.liquid_distance;
        let open = self.open_to_pressure();
        let mut twin = reference::active_cells(&grid, &open, phi, self.theta_floor());
        if let Some(both) = both {
            twin.seal(both.clip.coupling(), &both.at_rest.prescribed);
        }
        let stencil = &twin.stencil;
        let stage = "active_cells";
        let table = &mut self.table;
        table.cells(&grid, [stage, "active", "flag"], |cell| {
            let (gpu, twin) = (after.active[cell], stencil.active(cell));
            Some((number(gpu), number(twin), 0.0))
        });
        table.faces(&grid, [stage, "weights", ""], |a, face| {
            Some((after.weight[a][face], stencil.weight[a][face], 0.0))
        });
        table.cells(&grid, [stage, "free-surface terms", ""], |cell| {
            let twin = stencil.dirichlet[cell];
            Some((
                after.dirichlet[cell],
                twin,
                DIRICHLET_ROUNDINGS * EPS * twin,
            ))
        });
        table.cells(&grid, [stage, "1 / diagonal", ""], |cell| {
            let diagonal = stencil.diagonal[cell];
            let twin = if diagonal > 0.0 { 1.0 / diagonal } else { 0.0 };
            // A sum of eleven and a quotient more.
            let bound = (DIRICHLET_ROUNDINGS + 16.0) * EPS * twin;
            Some((after.inverse_diagonal[cell], twin, bound))
        });
        self.twin.active = Some(twin);
    }

    /// What volume control adds at the rate of the device.
    fn source(&self) -> VolumeSource<'_> {
        VolumeSource {
            rate: self.before.report.volume_rate,
            open_volumes: &self.open_volumes,
        }
    }

    /// Six products and their sum in the scalar type, up to 12 roundings of six speeds; volume control adds a product of three, prescribed
    /// nodes in closed components products with areas that are f32, and obstacles a number that is one.
    fn right_hand_side(
        &mut self,
        after: &LiquidSnapshot,
        clip: Option<&SolidClip>,
        both: Option<&Both>,
    ) {
        let grid = self.grid;
        let active = self
            .twin
            .active
            .take()
            .expect("active_cells comes before right_hand_side");
        let velocity = &self.before.velocity_next;
        let (open, source) = (self.open_to_flux(), Some(self.source()));
        let twin = reference::right_hand_side(&grid, &open, velocity, &active, source);
        let area = grid.dx * grid.dx;
        let speed = active_speed(&grid, &active.stencil, velocity);
        let terms = 12.0 * 6.0 * unit(after.real) * speed;
        let rate = after.report.volume_rate.abs();
        let mut bound = terms + EPS * 6.0 * rate * grid.dx;
        let mut gpu = after.rhs.clone();
        reference::remove_means(&active.closed, &mut gpu);
        let mut closed = vec![false; grid.n_cells()];
        active
            .closed
            .iter()
            .flatten()
            .for_each(|&cell| closed[cell] = true);
        let row = [Stage::RightHandSide.name(), "closed components", "flag"];
        self.table.cells(&grid, row, |cell| {
            Some((number(after.closed[cell]), number(closed[cell]), 0.0))
        });
        self.twin.rhs = twin.values.iter().map(|b| b / area).collect();
        if let Some(clip) = clip {
            for &(cell, flux) in clip.obstacles().flux() {
                if active.stencil.active(cell) {
                    self.twin.rhs[cell] -= flux / area;
                    bound = bound.max(terms + 4.0 * EPS * (flux.abs() / area + rate * grid.dx));
                }
            }
            reference::remove_means(&active.closed, &mut self.twin.rhs);
        }
        if let Some(both) = both {
            let [flux, gross] = both.flux(grid.dx, &closed);
            let pairs = self.twin.rhs.iter_mut().zip(flux);
            pairs.for_each(|(rhs, flux)| *rhs -= flux);
            reference::remove_means(&active.closed, &mut self.twin.rhs);
            bound += 4.0 * EPS * gross.into_iter().fold(0.0, f64::max);
        }
        let rhs = &self.twin.rhs;
        let row = [Stage::RightHandSide.name(), "E u* / dx^2", "m/s"];
        self.table.cells(&grid, row, |cell| {
            let numbers = (gpu[cell], rhs[cell], bound);
            active.stencil.active(cell).then_some(numbers)
        });
        self.twin.rhs_bound = bound;
        self.twin.flux = twin.scale / area;
        self.twin.active = Some(active);
    }

    /// Faces are valid or not, exactly. theta is off by 6 roundings, the quotient by it and the difference by 5 and 1, and u - that
    /// is rounded in the scalar type and again to f32.
    fn write_back(&mut self, after: &LiquidSnapshot) {
        let grid = self.grid;
        let active = self.before.active_cells(&grid);
        let rhs = reference::RightHandSide {
            values: Vec::new(),
            scale: 0.0,
        };
        // A unit of dt/(rho dx), so that the twin takes the potential for the pressure.
        let system = PressureSystem {
            scale: grid.dx * grid.dx,
            ..PressureSystem::new(active, rhs, 1.0, 1.0)
        };
        let u_star = &self.before.velocity_next;
        let mut twin = u_star.clone();
        let mut valid = reference::write_back(
            &system,
            &self.before.potential,
            &self.open_to_pressure(),
            &self.before.liquid_distance,
            self.theta_floor(),
            &mut twin,
        );
        let running = self.running.running;
        reference::carry_faces(&self.taps, &self.cut.open, running, &mut twin, &mut valid);
        let row = [Stage::WriteBack.name(), "valid faces", "flag"];
        self.table.faces(&grid, row, |a, face| {
            Some((number(after.valid[a][face]), number(valid[a][face]), 0.0))
        });
        let row = [Stage::WriteBack.name(), "u", "m/s"];
        self.table.faces(&grid, row, |a, face| {
            let twin = if valid[a][face] { twin[a][face] } else { 0.0 };
            let change = (twin - u_star[a][face]).abs();
            let bound = EPS * (13.0 * change + 2.0 * twin.abs());
            Some((after.velocity[a][face], twin, bound))
        });
    }

    /// A mean of up to six per layer: 5 roundings of the sum, a quotient. Along obstacles the direction is off by the roundings
    /// of distances up to 3 dx over the length of the gradient; solids move by a mean over three nodes and two places.
    fn extrapolate(
        &mut self,
        after: &LiquidSnapshot,
        clip: Option<&SolidClip>,
        both: Option<&Both>,
    ) {
        let grid = self.grid;
        let layers = reference::n_layers(self.scene.time.cfl);
        let walls = clip.map(|clip| MovingWalls {
            clip,
            triangles: both.map_or(&[], |both| &both.at_rest.triangles),
            velocity: both.map_or(&[], |both| &both.solids.velocity),
        });
        let of_nodes = walls.map_or(&[][..], |walls| walls.velocity.as_flattened());
        let of_nodes = of_nodes.iter().fold(0.0, |m, v| f64::max(m, v.abs()));
        let of_obstacles = clip
            .map_or(&[][..], |clip| clip.obstacles().wall_velocities())
            .iter();
        let of_walls = of_obstacles.fold(of_nodes, |m, (_, v)| m.max(v.abs().max_element()));
        let speed = 3.0 * of_walls + reference::max_speed(&self.before.velocity);
        let mut twin = self.before.velocity.clone();
        let valid = self.before.valid.clone();
        reference::extrapolate(&grid, &self.cut, walls, valid, layers, &mut twin);
        // What slivers show: two sums of up to 26, products and a quotient.
        let blended = if self.cuts() { 64.0 } else { 0.0 };
        let means = EPS * speed * (blended + 10.0 * layers as f64);
        for axis in Axis::ALL {
            let a = axis.index();
            let mut excused = 0;
            let mut pairs = Vec::new();
            for face in 0..grid.n_faces(axis) {
                let (gpu, twin) = (after.velocity[a][face], twin[a][face]);
                let slip = if self.cuts() && self.cut.open[a][face] == 0.0 {
                    self.slip_roundings(axis, face)
                } else {
                    Slip::Steady(0.0)
                };
                let bound = match slip {
                    Slip::Steady(roundings) => means + EPS * speed * roundings,
                    Slip::Unsteady => f64::INFINITY,
                };
                // Along the obstacle or not, it is no longer than a vector of three such components.
                let possible = gpu.abs() <= 3.0_f64.sqrt() * speed + means;
                if bound.is_infinite() && possible && (gpu - twin).abs() > means {
                    excused += 1;
                } else {
                    let bound = if bound.is_finite() { bound } else { means };
                    pairs.push((gpu, twin, bound, Place::face(&grid, axis, face)));
                }
            }
            self.table
                .add([Stage::Extrapolate.name(), "u", "m/s"], pairs);
            self.table
                .row(Stage::Extrapolate.name(), "u", "m/s")
                .excused += excused;
        }
        self.twin.velocity = twin;
        self.twin.velocity_bound = self
            .table
            .row(Stage::Extrapolate.name(), "u", "m/s")
            .worst
            .map_or(means, |worst| means.max(worst.bound));
    }

    /// How far off the direction along an obstacle may be at a closed face, in roundings of the speed.
    fn slip_roundings(&self, axis: Axis, face: usize) -> Slip {
        let (grid, distance) = (&self.grid, &self.cut.solid_distance);
        let ijk = grid.face_at(axis, face);
        if grid.face_sides(axis, ijk).contains(&None) {
            return Slip::Steady(0.0);
        }
        let x = grid.face_centre(axis, ijk);
        let at = |x: DVec3| grid.sample_cells(distance, x);
        // The mean of two distances, and half a cell.
        if (at(x) - 0.5 * grid.dx).abs() <= EPS * 4.0 * 3.0 * grid.dx {
            return Slip::Unsteady;
        }
        let gradient = DVec3::from([0, 1, 2].map(|b| {
            let half = DVec3::AXES[b] * (0.5 * grid.dx);
            (at(x + half) - at(x - half)) / grid.dx
        }));
        let length = gradient.length();
        if length < 1e-5 {
            // Below 1e-6 there is no direction; near it rounding decides.
            return Slip::Unsteady;
        }
        Slip::Steady(4.0 * 3.0 / length)
    }

    /// Sums as [`LiquidJudge::sum_error`] says. The largest speed copies a number. Divergence: twelve products summed, rounded to f32 and
    /// multiplied by 1/dx; solids take up sums of products with areas that are f32.
    fn diagnose(&mut self, after: &LiquidSnapshot, clip: Option<&SolidClip>, both: Option<&Both>) {
        let grid = self.grid;
        let phi = &after.liquid_distance;
        let density = f64::from(self.step.density);
        let gravity = self.gravity();
        let stencil = after.active_cells(&grid).stencil;
        let (mut taken, mut of_areas) = (None, 0.0);
        if let Some(both) = both {
            let [flux, gross] = both.flux(grid.dx, &after.active);
            let area = grid.dx * grid.dx;
            taken = Some(
                flux.into_iter()
                    .map(|flux| area * flux)
                    .collect::<Vec<f64>>(),
            );
            of_areas = 4.0 * EPS * gross.into_iter().fold(0.0, f64::max) / grid.dx;
            self.diagnose_coupling(after, both);
        }
        for &(cell, flux) in clip.map_or(&[][..], |clip| clip.obstacles().flux()) {
            taken.get_or_insert_with(|| vec![0.0; grid.n_cells()])[cell] += flux;
            of_areas = of_areas.max(4.0 * EPS * flux.abs() / grid.cell_volume());
        }
        let twin = {
            let (cut, velocity) = (&self.cut, &after.velocity);
            let open = self.open_to_flux();
            let left = reference::divergence(&open, velocity, &stencil, taken.as_deref());
            reference::diagnose(&grid, cut, phi, velocity, left, density, gravity)
        };
        let gpu = after.report.diagnosis;
        let rounding = self.sum_error(after.real, phi);
        let volume = rounding * self.wet_volume(phi);
        let mass = density * volume;
        let speed = twin.max_speed;
        let momentum = mass * speed;
        let energy = 1.5 * mass * speed * speed;
        let height = gravity.abs().dot(grid.size());
        let flux = active_speed(&grid, &stencil, &after.velocity) / grid.dx;
        let divergence =
            72.0 * unit(after.real) * flux + 4.0 * EPS * twin.divergence.abs() + of_areas;
        let mut row = |quantity, unit, gpu, twin, bound| {
            let row = [Stage::Diagnose.name(), quantity, unit];
            self.table.whole(row, gpu, twin, bound);
        };
        row("volume", "m^3", gpu.volume, twin.volume, volume);
        for (a, quantity) in ["momentum x", "momentum y", "momentum z"]
            .into_iter()
            .enumerate()
        {
            row(
                quantity,
                "kg m/s",
                gpu.momentum[a],
                twin.momentum[a],
                momentum,
            );
        }
        let [of_gpu, of_twin] = [gpu, twin].map(|d| (d.kinetic_energy, d.potential_energy));
        row("kinetic energy", "J", of_gpu.0, of_twin.0, energy);
        row("potential energy", "J", of_gpu.1, of_twin.1, mass * height);
        row("largest speed", "m/s", gpu.max_speed, twin.max_speed, 0.0);
        row(
            "divergence",
            "1/s",
            gpu.divergence,
            twin.divergence,
            divergence,
        );
    }

    /// Whether both touch, and the sum of J^T p with areas that are f32, a rounding per node of a sum and level of the tree in f32.
    fn diagnose_coupling(&mut self, after: &LiquidSnapshot, both: &Both) {
        let Some(told) = both.told else { return };
        let [force, gross] = both.force(self.pascal());
        let sums = |values: &[f64]| {
            let nodes = values.as_chunks::<3>().0.iter();
            nodes.map(|force| DVec3::from(*force)).sum::<DVec3>()
        };
        let (twin, gross) = (sums(&force), sums(&gross));
        let bound = (4.0 * EPS + 64.0 * unit(after.real)) * gross.length();
        self.table.add(
            [Stage::Diagnose.name(), "J^T p", "N"],
            (0..3).map(|axis| (told.force[axis], twin[axis], bound, Place::Whole)),
        );
        self.table.add_flags(
            [Stage::Diagnose.name(), "touching"],
            [(told.touching, both.touch(), Place::Whole)],
        );
    }

    /// What the probes read of the device's fields, and of those that the twins made. Velocity and pressure are means, so they are off
    /// by what they are made from. Heights and fronts fall where phi rises: they are where phi, off by its bound, puts them.
    fn probes(&mut self, after: &LiquidSnapshot) {
        let grid = self.grid;
        let on_device = |liquid_distance: Vec<f64>, active: Vec<bool>| State {
            velocity: after.velocity.clone(),
            pressure: self.in_pascal(&after.potential),
            liquid_distance,
            active,
            ..State::at_rest(&grid)
        };
        let gpu = on_device(after.liquid_distance.clone(), after.active.clone());
        let twin = State {
            velocity: self.twin.velocity.clone(),
            pressure: self.twin.pressure.clone(),
            ..gpu.clone()
        };
        let surface = |shift: f64| {
            let twin = self.twin.liquid_distance.iter();
            let phi: Vec<f64> = twin
                .zip(&self.twin.distance_bounds)
                .map(|(phi, bound)| phi + shift * bound)
                .collect();
            let open = &self.cut.open;
            let active = reference::active_cells(&grid, open, &phi, self.theta_floor());
            on_device(phi, active.stencil.active_mask())
        };
        let surfaces = [0.0, 1.0, -1.0].map(surface);
        let mut pairs = Vec::new();
        for probe in &self.scene.probes {
            let read = |state: &State| reference::probe(&grid, state, &probe.kind);
            match probe.kind {
                ProbeKind::Pressure { .. } => {
                    let rounding = 1e-12 * read(&gpu)[0].abs();
                    let bound = self.twin.pressure_bound + rounding;
                    pairs.push(("pressure", "Pa", read(&gpu)[0], read(&twin)[0], bound));
                }
                ProbeKind::Velocity { .. } => {
                    for (gpu, twin) in read(&gpu).into_iter().zip(read(&twin)) {
                        pairs.push(("velocity", "m/s", gpu, twin, self.twin.velocity_bound));
                    }
                }
                ProbeKind::Height { .. } | ProbeKind::Front { .. } => {
                    let [twin, low, high] = [0, 1, 2].map(|s| read(&surfaces[s])[0]);
                    let reach = (low - twin).abs().max((high - twin).abs());
                    let bound = reach + 1e-12 * grid.size().max_element();
                    pairs.push(("surface", "m", read(&gpu)[0], twin, bound));
                }
                // Both paths read them by the same function of the nodes, which have their own rows.
                ProbeKind::Node { .. } | ProbeKind::Solid { .. } | ProbeKind::Force { .. } => {}
            }
        }
        for (column, (quantity, unit, gpu, twin, bound)) in pairs.into_iter().enumerate() {
            self.table.add(
                ["probes", quantity, unit],
                [(gpu, twin, bound, Place::Column(column))],
            );
        }
    }
}

/// Whether the slip of a face hangs on a rounding.
enum Slip {
    /// Its direction is off by so many roundings of the speed.
    Steady(f64),
    /// It may slip or not.
    Unsteady,
}

/// Roundings of a free-surface term.
const DIRICHLET_ROUNDINGS: f64 = 17.0;

/// Largest speed of a face of an active cell, m/s.
fn active_speed(grid: &Grid, stencil: &Stencil, velocity: &[Vec<f64>; 3]) -> f64 {
    let speeds = stencil.active_cells().into_iter().flat_map(|cell| {
        Axis::ALL.into_iter().flat_map(move |axis| {
            let a = axis.index();
            [0, 1].map(|side| {
                let mut face = grid.cell_at(cell);
                face[a] += side;
                velocity[a][grid.face(axis, face)].abs()
            })
        })
    });
    speeds.fold(0.0, f64::max)
}

/// The marker (m), moved to the other side of every cell border that is within its rounding in cells.
fn across_borders(grid: &Grid, x: [f64; 3]) -> [f64; 3] {
    let dx = grid.dx;
    x.map(|x| {
        let cells = x / dx;
        let border = cells.round();
        let rounding = 3.0 * EPS * cells.max(1.0);
        if border > 0.0 && (cells - border).abs() <= rounding {
            (border - rounding * (cells - border + 1e-30).signum()) * dx
        } else {
            x
        }
    })
}
