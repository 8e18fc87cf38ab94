//! The liquid of a scene on a device: buffers, stages, pressure solver, and the host's share of the state.

use crate::Error;
use crate::effects::Effects;
use crate::fields::pressure_system::BALLISTIC;
use crate::fields::{
    ExchangeBuffers, Exchanged, LevelBuffers, LevelExchange, LiquidBuffers, LiquidPlan, Report, Sinks, SolverBuffers,
    SourceStep, Sources, Step,
};
use crate::geometry::{MARKERS_PER_CELL, Running, SourcesAndSinks};
use crate::gpu::{Dispatches, Gpu, Readback, Real, Recorder};
use crate::grid::Grid;
use crate::reference::{self, Seeded, TimeStep};
use crate::scene::{self, ProbeKind, Scene};
use crate::solver::{Outcome, PressureSolver};
use crate::stages::{self, Components, FreeSurface, PatchPressure, PressureSystem, Probe, Seal, Separation};
use crate::state::{Exchange, LiquidReport, SeparationReport, State};
use crate::step::Stage;

use super::separation::Rounds;
use super::step::solve_report;

/// What the last solve left, per cell.
#[derive(Debug)]
struct Solved {
    pressure: Vec<f64>,
    active: Vec<bool>,
    ballistic: Vec<bool>,
}

/// The liquid on the device.
#[derive(Debug)]
pub(super) struct GpuLiquid {
    pub(super) settings: scene::Liquid,
    /// Used slots of the marker buffer, including deleted markers.
    pub(super) n_markers: usize,
    /// Live markers.
    alive: usize,
    /// Markers removed and added so far.
    passed: Passed,
    /// Markers that a level seeded in the last sub-step.
    seeded: usize,
    /// Dropped markers that the device's count no longer includes.
    dropped_before: u64,
    /// Sources and sinks.
    pub(super) taps: SourcesAndSinks,
    /// Running sources of the sub-step, and the volume that they emit beyond their own cells, m^3.
    running: Running,
    inflow: f64,
    /// Of the state that was written. Until the next solve the device still has the last
    /// ones.
    solved_before: Option<Solved>,
    /// Largest face speed, m/s.
    pub(super) max_speed: f64,
    /// Separated cells of the last sub-step.
    pub(super) n_separated: usize,
    /// Separation in the current sub-step.
    pub(super) separation: Option<SeparationReport>,
    /// Controlled liquid volume, m^3.
    pub(super) volume_0: f64,
    pub(super) buffers: LiquidBuffers,
    /// With a level.
    pub(super) level: Option<LevelBuffers>,
    pub(super) solver: SolverBuffers,
    sources: Option<Sources>,
    /// Volumes that a level exchanges.
    exchange: Option<LevelExchange>,
    pub(super) stages: LiquidStages,
}

/// Arrays and kernels of the liquid that a solve needs.
#[derive(Clone, Copy, Debug)]
pub(super) struct LiquidSolve<'a> {
    pub(super) buffers: &'a LiquidBuffers,
    pub(super) solver: &'a SolverBuffers,
    pub(super) solve: &'a PressureSolver,
}

/// Markers removed and added since the start of the simulation.
#[derive(Clone, Copy, Debug, Default)]
struct Passed {
    /// Dropped inside solids.
    dropped: u64,
    /// Deleted beyond open sides.
    left: u64,
    /// Deleted in sinks.
    sunk: u64,
    /// Emitted by sources.
    emitted: u64,
}

/// Slots of the marker buffer.
#[derive(Clone, Copy, Debug)]
struct Slots {
    capacity: usize,
    /// Used ones, including those of dead markers.
    used: usize,
    /// Those of live markers.
    alive: usize,
}

impl Slots {
    fn dead(&self) -> usize {
        self.used.saturating_sub(self.alive)
    }

    /// Whether kernels process more dead markers than live ones, and many.
    fn most_are_dead(&self) -> bool {
        self.dead() > FEW_DEAD && 2 * self.dead() > self.used
    }

    /// Whether n slots are not free, and dead markers have some.
    fn lack(&self, n: usize) -> bool {
        self.dead() > 0 && self.used + n > self.capacity
    }

    /// Slots that the seeds of a sub-step may need, after so many in the last one.
    fn for_seeds(&self, last: usize) -> usize {
        (4 * last).max(self.capacity / 64)
    }
}

/// The kernels of a sub-step.
#[derive(Debug)]
pub(super) struct LiquidStages {
    /// See [`stages::liquid_stages`].
    own: Vec<Dispatches>,
    /// `extrapolate` and `diagnose`. [`GpuCoupling`](super::gpu_coupling::GpuCoupling) binds them with solids,
    /// [`GpuObstacles`](super::gpu_obstacles::GpuObstacles) with moving obstacles.
    pub(super) beside_bodies: Vec<Dispatches>,
    pub(super) active_cells: PressureSystem,
    pub(super) closed_components: Components,
    pub(super) solve: PressureSolver,
    /// With that effect.
    pub(super) separation: Option<Separation>,
    /// The stage and its readback.
    pub(super) probe: Option<(Probe, Readback<u32>)>,
}

impl LiquidStages {
    /// Records the dispatches of a stage.
    pub(super) fn record(&self, stage: Stage, to: &mut Recorder) {
        let all = self.own.iter().chain(&self.beside_bodies);
        for dispatches in all.filter(|dispatches| dispatches.stage() == stage.name()) {
            dispatches.record(to);
        }
    }
}

/// Largest number of markers of a level over that of its initial liquid full of markers: a splash may have no other liquid
/// than that of the band, where markers crowd.
const CROWDED: f64 = 1.25;
/// Slots for the markers of drops, of whose volume an estimate knows less.
const SLACK: usize = 4096;
/// Number of dead markers below which their slots cost nothing.
const FEW_DEAD: usize = 1 << 16;

/// Buffer sizes of a scene with an initial number of markers, with a level that of its liquid full of markers, on an adapter
/// with or without f64.
fn liquid_plan(scene: &Scene, taps: &SourcesAndSinks, n_markers: usize, f64: bool) -> LiquidPlan {
    let grid = scene.grid();
    let effects = Effects::of(scene);
    let most = match effects.level {
        true => (CROWDED * n_markers as f64) as usize + SLACK,
        false => n_markers,
    };
    LiquidPlan {
        n_markers: most + taps.max_markers(effects.level, scene.time.duration, &grid),
        grid,
        effects,
        cfl: scene.time.cfl,
        real: if f64 { Real::F64 } else { Real::F32 },
    }
}

impl GpuLiquid {
    /// Allocates and compiles. Returns `None` without liquid. Cut cells and state must be written afterwards.
    pub(super) fn new(
        gpu: &Gpu,
        scene: &Scene,
        taps: SourcesAndSinks,
        n_markers: usize,
    ) -> Result<Option<GpuLiquid>, Error> {
        let Some(settings) = scene.liquid.clone() else {
            return Ok(None);
        };
        let plan = liquid_plan(scene, &taps, n_markers, gpu.has_f64());
        let buffers = LiquidBuffers::new(gpu, plan)?;
        let level = LevelBuffers::new(gpu, plan)?;
        let solver = SolverBuffers::new(gpu, &scene.grid(), scene.solver.precision)?;
        let (sources, sinks) = (Sources::new(gpu, &buffers, &taps)?, Sinks::new(gpu, &buffers, &taps)?);
        let exchange = LevelExchange::new(gpu, &buffers, &taps, scene.domain.open)?;
        let taps_on_device =
            ExchangeBuffers { sources: sources.as_ref(), sinks: sinks.as_ref(), level: exchange.as_ref() };
        let stages = LiquidStages::new(gpu, scene, (&buffers, level.as_ref()), &solver, taps_on_device)?;
        Ok(Some(GpuLiquid {
            settings,
            n_markers,
            alive: n_markers,
            passed: Passed::default(),
            seeded: 0,
            dropped_before: 0,
            taps,
            running: Running::default(),
            inflow: 0.0,
            solved_before: None,
            max_speed: 0.0,
            n_separated: 0,
            separation: None,
            volume_0: 0.0,
            buffers,
            level,
            solver,
            sources,
            exchange,
            stages,
        }))
    }

    /// Allocates the readback of the report.
    pub(super) fn readback(gpu: &Gpu, scene: &Scene) -> Result<Option<Readback<u32>>, Error> {
        let words = Report::words(&Effects::of(scene));
        let readback = || Readback::new(gpu, "liquid.report", words);
        scene.liquid.as_ref().map(|_| readback()).transpose()
    }

    /// Writes the liquid's part of a state.
    pub(super) fn write_state(&mut self, gpu: &Gpu, state: &State, step: Step) {
        self.n_markers = state.markers.len();
        self.alive = self.n_markers;
        self.passed = Passed {
            dropped: state.markers_dropped,
            left: state.markers_left,
            sunk: state.markers_sunk,
            emitted: state.markers_emitted,
        };
        self.seeded = 0;
        self.dropped_before = state.markers_dropped;
        self.running = Running::default();
        self.inflow = 0.0;
        self.solved_before = Some(Solved {
            pressure: state.pressure.clone(),
            active: state.active.clone(),
            ballistic: state.ballistic.clone(),
        });
        let grid = &self.buffers.plan.grid;
        self.solver.write_active(gpu, grid, state);
        self.max_speed = reference::max_speed(&state.velocity);
        self.volume_0 = state.volume_0;
        self.buffers.write_state(gpu, state);
        self.buffers.write_separated(gpu, state);
        self.n_separated = state.separated.iter().filter(|on| **on).count();
        if let Some(level) = &self.level {
            level.write_markers(gpu, state);
            level.write_components(gpu, state);
        }
        let step = Step { n_markers: self.n_markers as u32, ..step };
        gpu.upload(&self.buffers.step, &[step]);
        if self.buffers.markers.is_none() {
            // A fixed surface does not move, so band and volume are constant.
            let mut recorder = Recorder::new(gpu);
            self.stages.record(Stage::Band, &mut recorder);
            self.stages.record(Stage::LiquidDistance, &mut recorder);
            recorder.submit();
        }
    }

    /// Reads the liquid's part of the state. `dt_last`: length of the last sub-step, s.
    pub(super) fn read_state(&self, gpu: &Gpu, grid: &Grid, dt_last: f64, state: &mut State) -> Result<(), Error> {
        let alive = self.buffers.read_state(gpu, self.n_markers, state)?;
        if let Some(level) = &self.level {
            level.read_markers(gpu, &alive, state)?;
            level.read_components(gpu, state)?;
        }
        state.markers_dropped = self.passed.dropped;
        state.markers_left = self.passed.left;
        state.markers_sunk = self.passed.sunk;
        state.markers_emitted = self.passed.emitted;
        state.volume_0 = self.volume_0;
        state.separated = self.buffers.read_separated(gpu)?;
        if let Some(solved) = &self.solved_before {
            state.pressure.clone_from(&solved.pressure);
            state.active.clone_from(&solved.active);
            state.ballistic.clone_from(&solved.ballistic);
            return Ok(());
        }
        let padded = grid.padded();
        let flags = gpu.download(&self.solver.flags)?;
        let [active, ballistic] = [0, BALLISTIC].map(|first| {
            let lane = |ix: usize| flags[ix / 4] >> (first + ix % 4) & 1 == 1;
            (0..padded.len()).map(lane).collect::<Vec<bool>>()
        });
        let mut potential = self.solver.potential.download(gpu)?;
        for (potential, _) in potential.iter_mut().zip(&active).filter(|(_, active)| !**active) {
            *potential = 0.0;
        }
        // Pa per m/s of potential: rho dx / dt.
        let pascal = if dt_last > 0.0 { self.settings.density * grid.dx / dt_last } else { 0.0 };
        state.pressure = padded.unpad(grid.cells, &potential, |potential| pascal * potential);
        state.active = padded.unpad(grid.cells, &active, |active| active);
        let moves = self.buffers.plan.effects.markers;
        state.ballistic = padded.unpad(grid.cells, &ballistic, |ballistic| ballistic && moves);
        Ok(())
    }

    /// Capacity for markers.
    pub(super) fn room(&self) -> usize {
        self.buffers.plan.n_markers
    }

    /// The potential of the last projection at cell centres, m/s; 0 in inactive cells.
    pub(super) fn potential(&self, gpu: &Gpu, grid: &Grid) -> Result<Vec<f64>, Error> {
        let flags = gpu.download(&self.solver.flags)?;
        let mut potential = self.solver.potential.download(gpu)?;
        for (ix, potential) in potential.iter_mut().enumerate() {
            if flags[ix / 4] >> (ix % 4) & 1 == 0 {
                *potential = 0.0;
            }
        }
        Ok(grid.padded().unpad(grid.cells, &potential, |p| p))
    }

    /// Values of the liquid probes, all columns in order.
    pub(super) fn probes(&mut self, gpu: &Gpu) -> Result<Vec<f64>, Error> {
        let Some((probe, readback)) = &mut self.stages.probe else {
            return Ok(Vec::new());
        };
        let mut recorder = Recorder::new(gpu);
        probe.record(&mut recorder);
        recorder.read(&probe.values, readback);
        recorder.submit();
        Ok(probe.columns(&readback.wait(gpu)?))
    }

    /// Starts a sub-step after the state `head`: sets the running sources and makes room for their markers.
    pub(super) fn begin(&mut self, gpu: &Gpu, head: &State, time_step: TimeStep) -> Result<(), Error> {
        self.make_room(gpu, head.step)?;
        self.running = self.running_after(head);
        let changed = self.taps.set_velocities(head.time, [head.dt_last, time_step.dt]);
        self.inflow = self.inflow(&self.taps, self.running, time_step.dt);
        if let Some(sources) = &self.sources {
            let grid = &self.buffers.plan.grid;
            let lattices = self.taps.lattices(grid, head.time, time_step.dt);
            let step = SourceStep::new(self.running, self.n_markers);
            sources.write_step(gpu, step, &lattices);
            if changed {
                sources.write_velocities(gpu, grid, &self.taps);
            }
        }
        if let Some(level) = &self.level {
            let renewed = self.renewed_volume(time_step);
            let numbers = [self.running.seed, self.running.step];
            level.write_step(gpu, numbers, time_step.courant, renewed);
            if self.sources.is_some() {
                level.write_used(gpu, self.n_slots());
            }
        }
        if let Some(exchange) = &self.exchange {
            let cell_volume = self.buffers.plan.grid.cell_volume();
            exchange.write_step(gpu, &self.taps, self.running, (time_step.dt, cell_volume));
        }
        Ok(())
    }

    /// See [`renewed_volume`], volumes of a cell.
    fn renewed_volume(&self, time_step: TimeStep) -> f64 {
        let plan = &self.buffers.plan;
        match plan.effects.open_sides {
            true => {
                let rate = self.inflow / time_step.dt;
                reference::renewed_volume(rate, time_step.control_time) / plan.grid.cell_volume()
            }
            false => 0.0,
        }
    }

    /// Volume that the sources emit beyond their own cells in a sub-step of dt (s), m^3.
    fn inflow(&self, taps: &SourcesAndSinks, sources: Running, dt: f64) -> f64 {
        match self.level {
            Some(_) => taps.inflows(sources, dt).sum(),
            None => dt * taps.flux(sources.running),
        }
    }

    /// Arrays for the solve of a sub-step of dt (s), and with separation the rounds around it. With solids that touch the liquid `flux` has
    /// their part in the separated cells.
    pub(super) fn rounds<'a>(
        &'a mut self,
        gpu: &'a Gpu,
        dt: f64,
        (seal, flux, patches, tolerance): (Option<&'a Seal>, Option<&'a Dispatches>, Option<&'a PatchPressure>, f64),
    ) -> (LiquidSolve<'a>, Option<Rounds<'a>>) {
        let (buffers, solver) = (&self.buffers, &self.solver);
        let LiquidStages { active_cells, closed_components, solve, separation, .. } = &mut self.stages;
        let rounds = separation.as_mut().map(|stage| Rounds {
            gpu,
            fields: (buffers, solver),
            unmasked: (active_cells, closed_components, seal),
            stage,
            flux,
            patches,
            tolerance,
            pascal: self.settings.density * buffers.plan.grid.dx / dt,
            dt,
            report: SeparationReport { cells: self.n_separated, ..SeparationReport::default() },
            settled: true,
        });
        let of_solve = LiquidSolve { buffers, solver, solve };
        (of_solve, rounds)
    }

    /// The running sources of the sub-step after the state `head`.
    pub(super) fn running_after(&self, head: &State) -> Running {
        self.taps.running(head, self.settings.seed)
    }

    /// Prescribed boundary flux of the sources per cell in the sub-step, m^3/s; `open`: see [`SourcesAndSinks::taken`].
    pub(super) fn taken_by_sources(&self, open: Option<&[Vec<f64>; 3]>) -> Vec<(usize, f64)> {
        let grid = &self.buffers.plan.grid;
        self.taps.boundary_flux(grid, open, self.running.running)
    }

    /// Deletes dead markers from the buffer when sources or the seeds of a level need their slots, and with a level when most
    /// are dead. The others keep their order, so the time of deletion does not affect results. Returns whether it did.
    pub(super) fn make_room(&mut self, gpu: &Gpu, step: u64) -> Result<bool, Error> {
        let Some(markers) = &self.buffers.markers else {
            return Ok(false);
        };
        let slots = Slots { capacity: markers.len(), used: self.n_markers, alive: self.alive };
        let of_sources = self.sources.as_ref().map_or(0, Sources::slots);
        if of_sources > 0 && slots.alive + of_sources > slots.capacity {
            return Err(Error::Stage {
                stage: "exchange",
                step,
                problem: format!(
                    "all {} markers are in use: the initial ones, and 1.25 times those that sources emit until the end of the run\n  cure: add an outlet (domain.open or a sink) and restart the run",
                    slots.capacity
                ),
            });
        }
        let wanted = match self.level {
            Some(_) => slots.most_are_dead() || slots.lack(of_sources + slots.for_seeds(self.seeded)),
            None => slots.lack(of_sources),
        };
        if !wanted {
            return Ok(false);
        }
        let alive = self.buffers.compact(gpu, self.n_markers)?;
        if let Some(level) = &self.level {
            level.compact(gpu, &alive)?;
        }
        self.n_markers = alive.into_iter().filter(|alive| *alive).count();
        gpu.upload(&self.buffers.report, &vec![0; self.buffers.report.len()]);
        self.dropped_before = self.passed.dropped;
        Ok(true)
    }

    /// Slots that kernels process in a sub-step: used ones and those reserved for new markers of sources. The seeds of a level
    /// follow them; kernels after `marker_band` find their number in [`LevelBuffers::marker_args`].
    pub(super) fn n_slots(&self) -> usize {
        self.n_markers + self.sources.as_ref().map_or(0, Sources::slots)
    }

    /// Seeds the markers for which the sub-step after the state of number `step` had no slots, where deleted markers have some. The
    /// markers and their order are those of a run with more slots.
    pub(super) fn seed_rest(&mut self, gpu: &Gpu, report: &mut Report, step: u64) -> Result<(), Error> {
        let Some(level) = self.level.as_ref().filter(|_| report.missing > 0) else {
            return Ok(());
        };
        let room = self.room();
        let alive = self.buffers.compact(gpu, room)?;
        level.compact(gpu, &alive)?;
        let kept = alive.into_iter().filter(|alive| *alive).count();
        let used = kept + report.missing as usize;
        if used > room {
            return Err(Error::Stage {
                stage: Stage::MarkerBand.name(),
                step,
                problem: format!(
                    "{used} markers are needed, and there are slots for {room}, {CROWDED} times the initial liquid: {kept} are in use\n  cure: use --backend cpu, or surface = \"markers\""
                ),
            });
        }
        level.write_freed(gpu, [self.running.seed, self.running.step], room - kept);
        let mut recorder = Recorder::new(gpu);
        stages::seed_rest(gpu, &self.buffers, level)?.record(&mut recorder);
        recorder.submit();
        level.write_used(gpu, used);
        let mut recorder = Recorder::new(gpu);
        self.stages.record(Stage::Spray, &mut recorder);
        recorder.submit();
        // `finish` counts the emitted and the seeded markers.
        self.n_markers = kept - (report.emitted + report.seeded) as usize;
        report.seeded += report.missing;
        report.missing = 0;
        Ok(())
    }

    /// Stores the numbers of the report that the next sub-step needs.
    pub(super) fn finish(&mut self, outcome: &Outcome, report: Report) -> LiquidReport {
        let dropped_so_far = self.dropped_before + u64::from(report.markers_dropped);
        let dropped = dropped_so_far - self.passed.dropped;
        let [left, sunk, emitted] = [report.left, report.sunk, report.emitted].map(u64::from);
        let kept = self.alive - (dropped + left + sunk) as usize;
        self.seeded = report.seeded as usize;
        self.alive = kept - report.deleted as usize + emitted as usize + self.seeded;
        self.n_markers += emitted as usize + self.seeded;
        self.passed = Passed {
            dropped: dropped_so_far,
            left: self.passed.left + left,
            sunk: self.passed.sunk + sunk,
            emitted: self.passed.emitted + emitted,
        };
        let effects = &self.buffers.plan.effects;
        let exchange = match (effects.exchange(), effects.level) {
            (true, true) => Some(self.exchange_level(&report)),
            (true, false) => Some(self.exchange_markers(&report, kept)),
            (false, _) => {
                let lost = f64::from(report.spray_lost) / MARKERS_PER_CELL as f64;
                self.volume_0 -= lost * self.buffers.plan.grid.cell_volume();
                None
            }
        };
        self.solved_before = None;
        self.max_speed = report.diagnosis.max_speed;
        LiquidReport {
            solve: solve_report(outcome),
            closed_components: outcome.closed_components as usize,
            diagnosis: report.diagnosis,
            markers: self.alive,
            dropped,
            exchange,
            separation: self.separation.take(),
        }
    }

    /// Exchange of markers in the sub-step, of which so many were kept. It changes the controlled volume.
    fn exchange_markers(&mut self, report: &Report, kept: usize) -> Exchange {
        let seeded = Seeded { emitted: report.emitted.into(), filled: report.filled.into() };
        let passed = reference::Passed { left: report.left.into(), sunk: report.sunk.into(), seeded, kept };
        let grid = &self.buffers.plan.grid;
        let ([_, volume_0], exchange) = reference::exchanged_volume(grid, self.volume_0, self.inflow, passed);
        self.volume_0 = volume_0;
        exchange
    }

    /// The same with a level.
    fn exchange_level(&mut self, report: &Report) -> Exchange {
        let one = self.buffers.plan.grid.cell_volume();
        let spray = |markers: u32| f64::from(markers) / MARKERS_PER_CELL as f64;
        let Exchanged { left_spray, sunk_spray, left, sunk, filled, limited, liquid } = report.exchanged;
        let exchange = Exchange {
            left: report.left.into(),
            sunk: report.sunk.into(),
            emitted: report.emitted.into(),
            volume_left: one * (left + spray(left_spray)),
            volume_sunk: one * (sunk + spray(sunk_spray)),
            volume_emitted: self.inflow + one * filled,
        };
        let dropped = one * spray(report.spray_lost - left_spray - sunk_spray);
        let gone = exchange.volume_left + exchange.volume_sunk + dropped;
        self.volume_0 += exchange.volume_emitted - gone + one * limited;
        // Without liquid there is no target to limit.
        if self.buffers.plan.effects.open_sides && liquid == 0.0 {
            self.volume_0 = one * spray(report.flying);
        }
        exchange
    }

    /// Parameters of the sub-step after the state `head`.
    pub(super) fn step_numbers(&self, scene: &Scene, head: &State, time_step: TimeStep) -> Step {
        let TimeStep { dt, control_time, .. } = time_step;
        let taps = self.taps.with_velocities(head.time, [head.dt_last, dt]);
        let inflow = self.inflow(&taps, self.running_after(head), dt);
        let domain = &scene.domain;
        let (grid, effects) = (scene.grid(), &self.buffers.plan.effects);
        Step {
            gravity: domain.mean_gravity([head.time, head.time + dt]).as_vec3().to_array(),
            dt: dt as f32,
            size: grid.size().as_vec3().to_array(),
            dx: grid.dx as f32,
            inv_dx: (1.0 / grid.dx) as f32,
            control_time: control_time.min(f64::from(f32::MAX)) as f32,
            volume_0: if effects.volume_control || effects.level { (self.volume_0 + inflow) as f32 } else { 0.0 },
            density: self.settings.density as f32,
            marker_radius: self.settings.marker_radius as f32,
            n_markers: self.n_slots() as u32,
            open_sides: domain.open.bits(),
            largest_slope: time_step.largest_slope(grid.dx) as f32,
        }
    }
}

impl LiquidStages {
    fn new(
        gpu: &Gpu,
        scene: &Scene,
        (liquid, level): (&LiquidBuffers, Option<&LevelBuffers>),
        solver: &SolverBuffers,
        taps: ExchangeBuffers,
    ) -> Result<LiquidStages, Error> {
        let effects = &liquid.plan.effects;
        let free_surface = FreeSurface { theta_floor: scene.solver.theta_floor, open_sides: effects.open_sides };
        let active_cells = PressureSystem::new(
            gpu,
            solver,
            liquid.solve_open(),
            &liquid.liquid_distance,
            liquid.within(),
            free_surface,
        )?;
        let solve = PressureSolver::new(gpu, solver, &liquid.velocity_next, liquid.solve_open(), &scene.solver)?;
        let probe = || {
            let probe = Probe::new(gpu, liquid, solver, probes(scene))?;
            let readback = Readback::new(gpu, "probe.values", probe.values.len())?;
            Ok::<_, Error>((probe, readback))
        };
        let mode = scene.liquid.as_ref().map(|liquid| liquid.separation);
        let mode = mode.unwrap_or(scene::Separation::None);
        Ok(LiquidStages {
            separation: Separation::new(gpu, liquid, solver, mode, free_surface)?,
            own: stages::liquid_stages(gpu, liquid, solver, level, (free_surface, taps))?,
            beside_bodies: match effects.clips() {
                true => Vec::new(),
                false => {
                    vec![stages::extrapolate(gpu, liquid, None)?, stages::diagnose(gpu, (liquid, level), solver, None)?]
                }
            },
            active_cells,
            closed_components: Components::new(gpu, solver, mode != scene::Separation::None)?,
            solve,
            probe: has_probes(scene).then(probe).transpose()?,
        })
    }
}

/// The probes of the liquid.
pub(super) fn probes(scene: &Scene) -> impl Iterator<Item = &ProbeKind> + Clone {
    let kinds = scene.probes.iter().map(|probe| &probe.kind);
    kinds.filter(|kind| kind.measures_liquid())
}

/// Whether the scene has probes of the liquid.
pub(super) fn has_probes(scene: &Scene) -> bool {
    probes(scene).next().is_some()
}

#[cfg(test)]
mod tests {
    use super::{FEW_DEAD, Slots};

    #[test]
    fn slots_of_dead_markers_are_freed_when_they_are_needed_or_many() {
        let slots = |used, alive| Slots { capacity: 400_000, used, alive };
        // Free slots suffice, exactly and not.
        assert!(!slots(300_000, 200_000).lack(100_000));
        assert!(slots(300_000, 200_000).lack(100_001));
        // Without dead markers nothing is gained.
        assert!(!slots(300_000, 300_000).lack(100_001));
        // More than half of them dead, and many.
        assert!(slots(2 * FEW_DEAD + 3, FEW_DEAD + 1).most_are_dead());
        assert!(!slots(2 * FEW_DEAD + 2, FEW_DEAD + 1).most_are_dead());
        assert!(!slots(FEW_DEAD, 0).most_are_dead());
        // A share of the capacity, or four times the last ones.
        assert_eq!(slots(0, 0).for_seeds(0), 6250);
        assert_eq!(slots(0, 0).for_seeds(5000), 20_000);
    }
}
