//! One step on the GPU, in the lines of the crate's list (thesis, algorithm 4); its twin is `reference/step.rs`.

use std::time::Instant;

use crate::Error;
use crate::gpu::{Readback, Recorder, StageTimes};
use crate::reference::{SQUEEZE, TimeStep};
use crate::solver::{Components, Outcome};
use crate::stages::{
    AdvectMarkers, AdvectVelocity, Band, Clip, Diagnose, EXCHANGE, ElementRotations, Extrapolate,
    Forces, LiquidDistance, MoveSolid, Report, RightHandSide, SolidReport, WriteBack,
};
use crate::state::{ContactReport, CouplingReport, SolveReport, SolveStatus, StepReport};

use super::gpu_coupling::{At, CouplingReadbacks};
use super::gpu_liquid::{GpuLiquid, active, within};
use super::gpu_path::GpuPath;
use super::gpu_solids::{GpuSolids, SolidReadbacks};
use super::squeeze::{SqueezeReadbacks, can_squeeze, squeezed};

/// Hears of every stage once its results are on the device.
pub type Observer<'a> = &'a mut dyn FnMut(&'static str, &GpuPath) -> Result<(), Error>;

/// Where the reports of a sub-step arrive. Taken from the path while it runs.
#[derive(Debug)]
pub(super) struct Readbacks {
    pub(super) liquid: Option<Readback<u32>>,
    pub(super) solids: Option<SolidReadbacks>,
    pub(super) coupling: Option<CouplingReadbacks>,
    pub(super) squeeze: Option<SqueezeReadbacks>,
}

/// What the device tells of a sub-step.
#[derive(Default)]
struct Told {
    liquid: Option<(Outcome, Report)>,
    solids: Option<((Outcome, ContactReport), SolidReport)>,
    coupling: Option<CouplingReport>,
    seconds: StageTimes,
}

impl GpuPath {
    /// Does one sub-step, each stage submitted by itself and told of.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails, and what the observer ends with. A solve that does not converge is told in the report.
    pub fn step_observed(&mut self, observer: Observer) -> Result<StepReport, Error> {
        self.step(self.next_time_step(), Some(observer))
    }

    /// Does one sub-step. With an observer each stage is submitted by itself and told of.
    pub(super) fn step(
        &mut self,
        time_step: TimeStep,
        mut observer: Option<Observer>,
    ) -> Result<StepReport, Error> {
        let clock = Instant::now();
        self.write_step(time_step.dt)?;
        let mut readbacks = self
            .readbacks
            .take()
            .expect("the read-backs come back after every step");
        let told = self
            .move_and_clip(time_step.dt, &mut observer)
            .and_then(|told| self.stages_of(time_step.dt, &mut readbacks, observer, told));
        self.readbacks = Some(readbacks);
        let mut report = self.finish(time_step, told?);
        report.seconds_total = clock.elapsed().as_secs_f64();
        Ok(report)
    }

    /// With liquid and solids, the stages up to the host's part of `clip`, which waits for where the nodes are. Other scenes wait for
    /// nothing here.
    fn move_and_clip(&mut self, dt: f64, observer: &mut Option<Observer>) -> Result<Told, Error> {
        let mut told = Told::default();
        let time = self.head.time + dt;
        if let Some((obstacles, liquid)) = self.obstacles.as_mut().zip(self.liquid.as_mut()) {
            let clock = Instant::now();
            obstacles.follow(&self.gpu, liquid, time, dt)?;
            told.seconds
                .push((Clip::NAME, clock.elapsed().as_secs_f64()));
        }
        let both = self.liquid.as_ref().zip(self.solids.as_ref());
        let Some((coupling, (_, solids))) = self.coupling.as_mut().zip(both) else {
            return Ok(told);
        };
        let mut to = Recorder::timed(&self.gpu);
        coupling.record_before(&mut to, solids);
        solids.stages.move_solid.record(&mut to);
        to.read(&solids.buffers.displacement, &mut coupling.moved);
        let timing = to.submit();
        let moved = coupling.moved.wait(&self.gpu)?;
        told.seconds.append(&mut timing.wait()?);
        let displacement = solids.buffers.displacement_of(&moved);
        if let Some(observer) = observer {
            observer(MoveSolid::NAME, self)?;
        }
        let clock = Instant::now();
        let GpuPath {
            gpu,
            scene,
            head,
            liquid,
            solids,
            coupling,
            ..
        } = self;
        let both = liquid.as_mut().zip(solids.as_ref());
        if let Some((coupling, both)) = coupling.as_mut().zip(both) {
            let dt_last = head.dt_last;
            let at = At::Step { time, dt, dt_last };
            coupling.follow(gpu, scene, both, &displacement, at)?;
        }
        told.seconds
            .push((Clip::NAME, clock.elapsed().as_secs_f64()));
        Ok(told)
    }

    /// The other stages, or all of them. Two waits: for the verdict of the solve, and for the reports; with liquid and solids one more, for
    /// whether they touch.
    fn stages_of(
        &self,
        dt: f64,
        readbacks: &mut Readbacks,
        observer: Option<Observer>,
        mut told: Told,
    ) -> Result<Told, Error> {
        let GpuPath {
            gpu,
            liquid,
            solids,
            coupling,
            ..
        } = self;
        let (liquid, solids) = (liquid.as_ref(), solids.as_ref());
        let coupling = coupling.as_ref();
        let mut watch = Watch {
            path: self,
            observer,
        };

        let mut to = Recorder::timed(gpu);
        if let Some(coupling) = coupling {
            coupling.stages.clip.record(&mut to);
            coupling.record_slopes(&mut to);
            to = watch.after(Clip::NAME, to)?;
        } else if let Some(GpuSolids { stages, .. }) = solids {
            stages.move_solid.record(&mut to);
            to = watch.after(MoveSolid::NAME, to)?;
        }
        if let Some(obstacles) = &self.obstacles {
            obstacles.stage.record(&mut to);
            to = watch.after(Clip::NAME, to)?;
        }
        if let Some(GpuLiquid {
            buffers, stages, ..
        }) = liquid
        {
            if let Some(advect_markers) = &stages.advect_markers {
                advect_markers.record(&mut to, buffers);
                to = watch.after(AdvectMarkers::NAME, to)?;
                if stages.record_exchange(&mut to) {
                    to = watch.after(EXCHANGE, to)?;
                }
                stages.band.record(&mut to);
                to = watch.after(Band::NAME, to)?;
            }
            stages.advect_velocity.record(&mut to, buffers);
            to = watch.after(AdvectVelocity::NAME, to)?;
        }
        if let Some(GpuLiquid {
            buffers, stages, ..
        }) = liquid
        {
            stages.forces.record(&mut to, buffers);
            if let Some(sources) = &stages.sources {
                sources.record_hold(&mut to, buffers);
            }
        }
        if let Some(GpuSolids { stages, .. }) = solids {
            stages.forces.record(&mut to);
        }
        to = watch.after(Forces::NAME, to)?;
        if let Some(GpuLiquid {
            buffers,
            solver,
            stages,
            ..
        }) = liquid
        {
            if let Some(liquid_distance) = &stages.liquid_distance {
                liquid_distance.record_with(&mut to, buffers, stages.sinks.as_ref());
                to = watch.after(LiquidDistance::NAME, to)?;
            } else if let Some(volume) = stages.volume.as_ref().filter(|_| self.clip().is_some()) {
                // The surface stays, and solids or obstacles move through it.
                volume.record(&mut to);
            }
            if let Some(coupling) = coupling {
                coupling.record_clear(&mut to);
            }
            to.stage("active_cells", |pass| {
                stages.active_cells.record(pass, solver, within(buffers))
            });
            to.stage(Components::NAME, |pass| {
                let seal = coupling.map(|coupling| &coupling.stages.closed_components);
                stages.closed_components.label(pass, solver, seal)
            });
            to = watch.after("active_cells", to)?;
        }
        if let Some(GpuSolids { stages, .. }) = solids {
            to.stage(ElementRotations::NAME, |pass| {
                stages.rotations.dispatch(pass);
                stages.system.record_matrices(pass);
            });
            to = watch.after(ElementRotations::NAME, to)?;
        }
        if let Some(GpuLiquid { solver, stages, .. }) = liquid {
            stages.right_hand_side.record(&mut to, &active(solver));
            to.stage(Components::NAME, |pass| {
                if let Some(coupling) = coupling {
                    coupling.record_close(pass);
                }
                stages.closed_components.remove_means(pass)
            });
        }
        if let Some(GpuSolids { stages, .. }) = solids {
            to.stage(RightHandSide::NAME, |pass| {
                stages.system.record_right_hand_side(pass);
                if let Some(patch_pressure) =
                    coupling.and_then(|c| c.stages.patch_pressure.as_ref())
                {
                    patch_pressure.record(pass);
                }
                stages.system.record_contacts(pass);
            });
        }
        to = watch.after(RightHandSide::NAME, to)?;
        let mut pressure = None;
        let mut elastic: Option<(Outcome, ContactReport)> = None;
        let (mut together, mut condensed) = (false, false);
        let one_solve = coupling.and_then(|coupling| Some((coupling, coupling.together()?)));
        if let (Some((coupling, solver)), Some(both), Some(of_coupling), Some(of_solids)) = (
            one_solve,
            liquid.zip(solids),
            readbacks.coupling.as_mut(),
            readbacks.solids.as_mut(),
        ) {
            let (touch, mut seconds) = coupling.touch(gpu, both.0, to, of_coupling)?;
            told.seconds.append(&mut seconds);
            together = touch.touching;
            if together {
                let step = both.1.buffers.step_of(self.scene.domain.gravity, dt);
                let (solved, mut seconds) =
                    coupling.solve_in_contact(gpu, solver, both, of_solids, (step, dt), touch)?;
                told.seconds.append(&mut seconds);
                let [of_liquid, of_solids] = solved.parts;
                condensed = solved.condensed;
                (pressure, elastic) = (Some(of_liquid), Some((of_solids, solved.contact)));
            }
            to = Recorder::timed(gpu);
        }
        if let Some(part @ GpuLiquid { solver, stages, .. }) = liquid {
            if !together {
                let (outcome, mut seconds) = stages.solve.solve(gpu, to, solver)?;
                pressure = Some(outcome);
                told.seconds.append(&mut seconds);
                to = Recorder::timed(gpu);
            }
            if let Some(outcome) = &mut pressure
                && outcome.status == SolveStatus::Converged
                && outcome.closed_components > 0
                && can_squeeze(&self.scene)
            {
                let clip = self.clip();
                let obstacles = clip.map_or(&[][..], |clip| clip.obstacles().flux());
                let sources = part.taken_by_sources(clip.map(|clip| &clip.cut_cells().open));
                let taken = obstacles.iter().copied().chain(sources);
                let nodes = solids.zip(clip).filter(|_| together);
                if squeezed(gpu, &mut readbacks.squeeze, part, nodes, taken)? > SQUEEZE {
                    outcome.status = SolveStatus::Incompatible;
                    if let Some((of_solids, _)) = &mut elastic
                        && of_solids.status == SolveStatus::Converged
                    {
                        of_solids.status = SolveStatus::Incompatible;
                    }
                }
            }
            to.stage(Components::NAME, |pass| {
                stages.closed_components.centre_potential(pass)
            });
            if let Some(coupling) = coupling {
                coupling.record_push(&mut to);
            }
        }
        if let Some((solids, SolidReadbacks { answer, .. })) =
            solids.zip(readbacks.solids.as_mut()).filter(|_| !together)
        {
            let (outcome, contact, mut seconds) =
                solids.solve_in_contact(gpu, to, answer, &solids.polynomial(dt))?;
            elastic = Some((outcome, contact));
            told.seconds.append(&mut seconds);
            to = Recorder::timed(gpu);
            if contact.unsettled > 0 {
                // The velocities are those of no system but one that holds all nodes.
                to.clear(&solids.buffers.freedom);
            }
        }
        to = watch.after("solve", to)?;

        if let Some(GpuLiquid {
            buffers, stages, ..
        }) = liquid
        {
            stages.write_back.record(&mut to, buffers);
            if let Some(sources) = &stages.sources {
                sources.record_carry(&mut to);
            }
            to = watch.after(WriteBack::NAME, to)?;
            if let Some(extrapolate) = &stages.extrapolate {
                extrapolate.record(&mut to, buffers);
            }
            to = watch.after(Extrapolate::NAME, to)?;
        }
        if let Some((liquid, readback)) = liquid.zip(readbacks.liquid.as_mut()) {
            let GpuLiquid {
                buffers,
                solver,
                stages,
                ..
            } = liquid;
            if let Some(diagnose) = &stages.diagnose {
                diagnose.record(&mut to, buffers, &active(solver));
            }
            to.read(&buffers.report, readback);
        }
        if let Some((solids, SolidReadbacks { report, .. })) = solids.zip(readbacks.solids.as_mut())
        {
            let GpuSolids {
                buffers, stages, ..
            } = solids;
            stages.diagnose.record(&mut to, buffers);
            to.read(&buffers.report, report);
        }
        if let Some((coupling, readbacks)) = coupling.zip(readbacks.coupling.as_mut()) {
            coupling.record_report(&mut to, readbacks);
        }
        let timing = to.submit();
        if let Some((outcome, readback)) = pressure.zip(readbacks.liquid.as_mut()) {
            told.liquid = Some((outcome, Report::from_words(&readback.wait(gpu)?)));
        }
        if let Some((outcome, SolidReadbacks { report, .. })) =
            elastic.zip(readbacks.solids.as_mut())
        {
            told.solids = Some((outcome, SolidReport::from_words(&report.wait(gpu)?)));
        }
        if let Some((coupling, readbacks)) = coupling.zip(readbacks.coupling.as_mut()) {
            told.coupling = Some(coupling.report(gpu, readbacks, condensed)?);
        }
        told.seconds.extend(timing.wait()?);
        watch.after(Diagnose::NAME, Recorder::new(gpu))?;
        Ok(told)
    }
}

/// Submits after each stage where somebody listens.
struct Watch<'a, 'b> {
    path: &'a GpuPath,
    observer: Option<Observer<'b>>,
}

impl<'a> Watch<'a, '_> {
    fn after(
        &mut self,
        stage: &'static str,
        recorder: Recorder<'a>,
    ) -> Result<Recorder<'a>, Error> {
        let Some(observer) = &mut self.observer else {
            return Ok(recorder);
        };
        recorder.submit();
        observer(stage, self.path)?;
        Ok(Recorder::timed(&self.path.gpu))
    }
}

impl GpuPath {
    /// Moves the clock on and puts the row of steps.csv together.
    fn finish(&mut self, TimeStep { dt, floored }: TimeStep, told: Told) -> StepReport {
        if let Some(liquid) = &self.liquid {
            self.head.sources_running = liquid.running_after(&self.head).running.into();
        }
        self.head
            .advance_clock(dt, self.scene.time.frames_per_second);
        let liquid = self.liquid.as_mut().zip(told.liquid);
        let solids = self.solids.as_mut().zip(told.solids);
        StepReport {
            dt,
            dt_floored: floored,
            liquid: liquid.map(|(liquid, (outcome, report))| liquid.finish(&outcome, report)),
            solid: solids.map(|(solids, ((outcome, contact), report))| {
                solids.finish(&outcome, contact, report)
            }),
            coupling: told.coupling,
            seconds: by_stage(&told.seconds),
            seconds_total: 0.0,
        }
    }
}

/// What a solve did.
pub(super) fn solve_report(outcome: &Outcome) -> SolveReport {
    SolveReport {
        unknowns: outcome.unknowns as usize,
        iterations: outcome.iterations,
        residual: outcome.residual,
        status: outcome.status,
    }
}

/// Sums the times of a stage that took several passes, in the order of first appearance.
fn by_stage(times: &StageTimes) -> StageTimes {
    let mut sums: StageTimes = Vec::new();
    for &(stage, seconds) in times {
        match sums.iter_mut().find(|(name, _)| *name == stage) {
            Some((_, sum)) => *sum += seconds,
            None => sums.push((stage, seconds)),
        }
    }
    sums
}
