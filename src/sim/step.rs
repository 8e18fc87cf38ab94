//! One step on the GPU, in the lines of the crate's list (thesis, algorithm 4); its twin is `reference/step.rs`.

use crate::Error;
use crate::gpu::{Readback, Recorder, StageTimes};
use crate::reference::TimeStep;
use crate::solver::{Components, Outcome};
use crate::stages::{
    AdvectMarkers, AdvectVelocity, Band, Diagnose, Extrapolate, Forces, LiquidDistance, Report,
    RightHandSide, WriteBack,
};
use crate::state::{LiquidReport, SolveReport, StepReport};

use super::gpu_path::{GpuPath, active, within};

/// Hears of every stage once its results are on the device.
pub type Observer<'a> = &'a mut dyn FnMut(&'static str, &GpuPath) -> Result<(), Error>;

/// What the device tells of a sub-step.
struct Told {
    outcome: Outcome,
    report: Report,
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
        observer: Option<Observer>,
    ) -> Result<StepReport, Error> {
        let mut readback = self
            .report
            .take()
            .expect("the read-back comes back after every step");
        let told = self.stages_of(time_step.dt, &mut readback, observer);
        self.report = Some(readback);
        Ok(self.finish(time_step, told?))
    }

    /// Two waits: for the verdict of the solve, and for the report.
    fn stages_of(
        &self,
        dt: f64,
        readback: &mut Readback<u32>,
        observer: Option<Observer>,
    ) -> Result<Told, Error> {
        self.write_step(dt);
        let GpuPath {
            gpu,
            liquid,
            solver,
            stages,
            ..
        } = self;
        let active = active(solver);
        let mut watch = Watch {
            path: self,
            observer,
        };

        let mut to = Recorder::timed(gpu);
        if let Some(advect_markers) = &stages.advect_markers {
            advect_markers.record(&mut to);
            to = watch.after(AdvectMarkers::NAME, to)?;
            stages.band.record(&mut to);
            to = watch.after(Band::NAME, to)?;
        }
        stages.advect_velocity.record(&mut to, liquid);
        to = watch.after(AdvectVelocity::NAME, to)?;
        stages.forces.record(&mut to, liquid);
        to = watch.after(Forces::NAME, to)?;
        if let Some(liquid_distance) = &stages.liquid_distance {
            liquid_distance.record(&mut to, liquid);
            to = watch.after(LiquidDistance::NAME, to)?;
        }
        to.stage("active_cells", |pass| {
            stages.active_cells.record(pass, solver, within(liquid))
        });
        to.stage(Components::NAME, |pass| {
            stages.closed_components.label(pass, solver)
        });
        to = watch.after("active_cells", to)?;
        stages.right_hand_side.record(&mut to, &active);
        to.stage(Components::NAME, |pass| {
            stages.closed_components.remove_means(pass)
        });
        to = watch.after(RightHandSide::NAME, to)?;
        let (outcome, mut seconds) = stages.solve.solve(gpu, to, solver, self.ends_frame(dt))?;
        to = Recorder::timed(gpu);
        to.stage(Components::NAME, |pass| {
            stages.closed_components.centre_potential(pass)
        });
        to = watch.after("solve", to)?;

        stages.write_back.record(&mut to, liquid);
        to = watch.after(WriteBack::NAME, to)?;
        stages.extrapolate.record(&mut to, liquid);
        to = watch.after(Extrapolate::NAME, to)?;
        stages.diagnose.record(&mut to, liquid, &active);
        to.read(&liquid.report, readback);
        let timing = to.submit();
        let report = Report::from_words(&readback.wait(gpu)?);
        seconds.extend(timing.wait()?);
        watch.after(Diagnose::NAME, Recorder::new(gpu))?;
        Ok(Told {
            outcome,
            report,
            seconds,
        })
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
        let Told {
            outcome,
            report,
            seconds,
        } = told;
        let dropped_now = u64::from(report.markers_dropped);
        let dropped = dropped_now - self.head.markers_dropped;
        self.head.markers_dropped = dropped_now;
        self.max_speed = report.diagnosis.max_speed;
        self.head
            .advance_clock(dt, self.scene.time.frames_per_second);
        StepReport {
            dt,
            dt_floored: floored,
            liquid: Some(LiquidReport {
                solve: SolveReport {
                    unknowns: outcome.unknowns as usize,
                    iterations: outcome.iterations,
                    residual: outcome.residual,
                    status: outcome.status,
                },
                closed_components: outcome.closed_components as usize,
                diagnosis: report.diagnosis,
                markers: self.n_markers - dropped_now as usize,
                dropped,
            }),
            solid: None,
            seconds: by_stage(&seconds),
        }
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
