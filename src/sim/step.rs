//! A sub-step on the GPU: its [`Backend`] for the schedule of [`crate::step`]. The twin is `reference/step.rs`.

use std::time::Instant;

use crate::Error;
use crate::effects::Effects;
use crate::fields::{Report, SolidReport};
use crate::gpu::{Gpu, Readback, Recorder, StageTimes};
use crate::reference::{SQUEEZE, TimeStep};
use crate::solver::{Aim, Outcome};
use crate::state::{ContactReport, CouplingReport, SolveReport, SolveStatus, StepReport};
use crate::step::{self, Backend, Stage};

use super::gpu_coupling::{ClipTime, CouplingReadbacks};
use super::gpu_liquid::{GpuLiquid, LiquidSolve};
use super::gpu_path::GpuPath;
use super::gpu_solids::SolidReadbacks;
use super::squeeze::{Squeeze, SqueezeReadbacks, can_open, can_squeeze, squeezed};

/// Stage callback: called after each stage, once its results are on the device.
pub type Observer<'a> = &'a mut dyn FnMut(Stage, &GpuPath) -> Result<(), Error>;

/// Readbacks of the reports of a sub-step.
#[derive(Debug)]
pub(super) struct Readbacks {
    pub(super) liquid: Option<Readback<u32>>,
    pub(super) solids: Option<SolidReadbacks>,
    pub(super) coupling: Option<CouplingReadbacks>,
    pub(super) squeeze: Option<SqueezeReadbacks>,
}

/// Results of a sub-step on the host.
#[derive(Default)]
struct StepReadback {
    pressure: Option<Outcome>,
    velocity: Option<(Outcome, ContactReport)>,
    /// Whether one solve was for liquid and solids together, and whether it used the Schur-complement form.
    together: bool,
    condensed: bool,
    /// See [`Solved::pushed`](super::gpu_coupling::Solved).
    pushed: Option<Vec<f64>>,
    liquid: Option<Report>,
    solids: Option<SolidReport>,
    coupling: Option<CouplingReport>,
    seconds: StageTimes,
}

impl StepReadback {
    /// Adds iterations, solves and seconds of a solve that was repeated.
    fn add_solve(&mut self, before: StepReadback) {
        if let Some((now, before)) = self.pressure.as_mut().zip(before.pressure) {
            now.iterations += before.iterations;
        }
        if let Some(((now, contact), (before, contact_before))) = self.velocity.as_mut().zip(before.velocity) {
            now.iterations += before.iterations;
            contact.solves += contact_before.solves;
        }
        self.seconds.splice(0..0, before.seconds);
    }
}

/// A sub-step in progress. It waits for the outcome of the solve and for the reports. Coupling adds waits for the
/// node positions and for contact of liquid and solids.
struct SubStep<'p, 'o> {
    path: &'p mut GpuPath,
    dt: f64,
    /// Recorded commands, not yet submitted.
    recorder: Option<Recorder>,
    /// Displacements after `move_solid`, m, with liquid and solids.
    moved: Vec<[f64; 3]>,
    readback: StepReadback,
    observer: Option<Observer<'o>>,
}

impl GpuPath {
    /// Computes one sub-step with a stage callback. Each stage is a submission of its own.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails, and errors of the callback. A solve that does not converge is a status
    /// in the report.
    pub fn step_observed(&mut self, observer: Observer) -> Result<StepReport, Error> {
        self.step(self.next_time_step(), Some(observer))
    }

    /// Computes one sub-step.
    pub(super) fn step(&mut self, time_step: TimeStep, observer: Option<Observer>) -> Result<StepReport, Error> {
        let clock = Instant::now();
        self.write_step(time_step)?;
        let effects = Effects::of(&self.scene);
        let mut sub_step = SubStep {
            path: self,
            dt: time_step.dt,
            recorder: None,
            moved: Vec::new(),
            readback: StepReadback::default(),
            observer,
        };
        step::run(&mut sub_step, &effects, true)?;
        let mut readback = sub_step.readback;
        if let Some((liquid, report)) = self.liquid.as_mut().zip(readback.liquid.as_mut()) {
            liquid.seed_rest(&self.gpu, report, self.head.step)?;
        }
        let mut report = self.finish(time_step, readback);
        report.seconds_total = clock.elapsed().as_secs_f64();
        Ok(report)
    }

    /// Advances the clock and returns the report of the sub-step.
    fn finish(&mut self, time_step: TimeStep, mut readback: StepReadback) -> StepReport {
        let TimeStep { dt, floored, wave_cfl, .. } = time_step;
        if let Some(liquid) = &self.liquid {
            self.head.sources_running = liquid.running_after(&self.head).running.into();
        }
        self.head.advance_clock(dt, self.scene.time.frames_per_second);
        let liquid = self.liquid.as_mut();
        let liquid = liquid.zip(readback.pressure.zip(readback.liquid));
        let solids = self.solids.as_mut();
        if let Some(((_, contact), report)) = readback.velocity.as_mut().zip(readback.solids) {
            contact.closing_rate = contact.closing_rate.max(report.closing_rate);
        }
        let before = self.head.contact_step;
        self.head.contact_step = readback.velocity.as_ref().map_or(0.0, |(_, contact)| contact.next_step(dt, before));
        let solids = solids.zip(readback.velocity.zip(readback.solids));
        StepReport {
            dt,
            dt_floored: floored,
            wave_cfl,
            liquid: liquid.map(|(liquid, (outcome, report))| liquid.finish(&outcome, report)),
            solid: solids.map(|(solids, ((outcome, contact), report))| solids.finish(&outcome, contact, report)),
            coupling: readback.coupling,
            seconds: by_stage(&readback.seconds),
            seconds_total: 0.0,
        }
    }
}

/// The recording in progress, or a new one.
fn recording<'r>(recorder: &'r mut Option<Recorder>, gpu: &Gpu) -> &'r mut Recorder {
    recorder.get_or_insert_with(|| Recorder::timed(gpu))
}

/// The recording in progress, or an empty one, to be submitted.
fn end_recording(recorder: &mut Option<Recorder>, gpu: &Gpu) -> Recorder {
    recorder.take().unwrap_or_else(|| Recorder::timed(gpu))
}

impl Backend for SubStep<'_, '_> {
    fn run(&mut self, stage: Stage) -> Result<(), Error> {
        match stage {
            Stage::MoveSolid => self.move_solid(),
            Stage::Clip => self.clip(),
            Stage::RightHandSide => self.right_hand_side(),
            Stage::Solve => self.solve(),
            Stage::Diagnose => self.diagnose(),
            _ => self.record(stage),
        }
    }

    fn after(&mut self, stage: Stage) -> Result<(), Error> {
        let Some(observer) = &mut self.observer else {
            return Ok(());
        };
        if let Some(recorder) = self.recorder.take() {
            recorder.submit();
        }
        observer(stage, self.path)
    }
}

impl SubStep<'_, '_> {
    /// Stages that only record dispatches.
    fn record(&mut self, stage: Stage) -> Result<(), Error> {
        self.record_liquid(stage);
        let to = recording(&mut self.recorder, &self.path.gpu);
        if let Some(solids) = &self.path.solids {
            match stage {
                Stage::Forces => solids.stages.forces.record(to),
                Stage::SolidMatrices => to.stage(stage.name(), |pass| {
                    solids.stages.rotations.record_in(pass);
                    solids.stages.system.record_matrices(pass);
                }),
                _ => {}
            }
        }
        Ok(())
    }

    /// The liquid's part of a stage that only records dispatches.
    fn record_liquid(&mut self, stage: Stage) {
        let to = recording(&mut self.recorder, &self.path.gpu);
        let coupling = self.path.coupling.as_ref();
        let liquid = self.path.liquid.as_ref();
        if let Some(GpuLiquid { buffers, solver, stages, .. }) = liquid {
            stages.record(stage, to);
            match stage {
                Stage::ActiveCells => {
                    if let Some(coupling) = coupling {
                        coupling.record_clear(to);
                    }
                    to.stage(stage.name(), |pass| {
                        stages.active_cells.record(pass, solver, buffers.within());
                    });
                }
                Stage::ClosedComponents => to.stage(stage.name(), |pass| {
                    let seal = coupling.map(|coupling| &coupling.stages.closed_components);
                    stages.closed_components.label(pass, solver, seal);
                }),
                _ => {}
            }
        }
    }

    /// With liquid it also reads back the displacements for the clipping.
    fn move_solid(&mut self) -> Result<(), Error> {
        let to = recording(&mut self.recorder, &self.path.gpu);
        let Some(solids) = &self.path.solids else {
            return Ok(());
        };
        if let Some(coupling) = &self.path.coupling {
            coupling.record_before(to, solids);
        }
        to.stage(Stage::MoveSolid.name(), |pass| {
            solids.stages.ballistic.record_in(pass);
            if let Some(coupling) = &self.path.coupling {
                coupling.stages.move_solid.record_in(pass);
            }
            solids.stages.move_solid.record_in(pass);
        });
        let Some(coupling) = &mut self.path.coupling else {
            return Ok(());
        };
        to.read(&solids.buffers.displacement, &mut coupling.moved);
        if let Some(timing) = self.recorder.take().map(Recorder::submit) {
            let moved = coupling.moved.wait(&self.path.gpu)?;
            self.readback.seconds.append(&mut timing.wait()?);
            self.moved = solids.buffers.displacement_of(&moved);
        }
        Ok(())
    }

    /// The host clips, the device scatters the cut quads.
    fn clip(&mut self) -> Result<(), Error> {
        let clock = Instant::now();
        let GpuPath { gpu, scene, head, liquid, solids, coupling, obstacles, .. } = &mut *self.path;
        let (time, dt) = (head.time + self.dt, self.dt);
        let Some(liquid) = liquid else {
            return Ok(());
        };
        if let Some(obstacles) = obstacles {
            obstacles.update_clip(gpu, liquid, time, dt)?;
        }
        if let Some((coupling, solids)) = coupling.as_mut().zip(solids.as_ref()) {
            let dt_last = head.dt_last;
            let at = ClipTime::SubStep { time, dt, dt_last };
            coupling.update_clip(gpu, scene, (liquid, solids), (&self.moved, &head.cavity_volume), at)?;
        }
        let seconds = (Stage::Clip.name(), clock.elapsed().as_secs_f64());
        self.readback.seconds.push(seconds);
        let to = recording(&mut self.recorder, gpu);
        if let Some(coupling) = coupling {
            coupling.stages.clip.record(to);
            coupling.record_slopes(to);
        }
        if let Some(obstacles) = obstacles {
            obstacles.stage.record(to);
        }
        Ok(())
    }

    /// Makes the right-hand side of closed components compatible.
    fn remove_means(&mut self) {
        let to = recording(&mut self.recorder, &self.path.gpu);
        let coupling = self.path.coupling.as_ref();
        if let Some(GpuLiquid { stages, .. }) = &self.path.liquid {
            to.stage(Stage::ClosedComponents.name(), |pass| {
                if let Some(coupling) = coupling {
                    coupling.record_close(pass);
                }
                stages.closed_components.remove_means(pass);
            });
        }
    }

    fn liquid_right_hand_side(&mut self) {
        let to = recording(&mut self.recorder, &self.path.gpu);
        let Some(GpuLiquid { stages, .. }) = &self.path.liquid else {
            return;
        };
        stages.record(Stage::RightHandSide, to);
        let coupling = self.path.coupling.as_ref();
        if let Some(cavities) = coupling.and_then(|coupling| coupling.stages.filled_cavities.as_ref()) {
            to.stage(Stage::RightHandSide.name(), |pass| cavities.record(pass, &stages.closed_components));
        }
    }

    fn right_hand_side(&mut self) -> Result<(), Error> {
        self.liquid_right_hand_side();
        self.remove_means();
        let to = recording(&mut self.recorder, &self.path.gpu);
        let coupling = self.path.coupling.as_ref();
        if let Some(solids) = &self.path.solids {
            let system = &solids.stages.system;
            let patches = coupling.and_then(|c| c.stages.patch_pressure.as_ref());
            if let Some(patches) = patches {
                patches.record_clear(to);
            }
            to.stage(Stage::RightHandSide.name(), |pass| {
                system.record_right_hand_side(pass);
                if let Some(patches) = patches {
                    patches.record(pass);
                }
                system.record_contacts(pass);
            });
        }
        Ok(())
    }

    /// One solve for liquid and solids if they touch, else one for each. It is repeated where the room of enclosed liquid grows, which then
    /// may separate.
    fn solve(&mut self) -> Result<(), Error> {
        self.solve_liquid()?;
        let squeeze = self.squeeze()?;
        if !squeeze.receding.is_empty() {
            let closed = std::mem::take(&mut self.readback);
            self.open(&squeeze)?;
            self.solve_liquid()?;
            self.readback.add_solve(closed);
        }
        self.flag_squeeze(squeeze.share);
        // A repeated solve begins without the forces of contact.
        if let Some((pushed, solids)) = self.readback.pushed.take().zip(self.path.solids.as_ref()) {
            solids.system.rhs.upload(&self.path.gpu, &pushed);
        }
        let to = recording(&mut self.recorder, &self.path.gpu);
        if let Some(GpuLiquid { stages, .. }) = &mut self.path.liquid {
            to.stage(Stage::ClosedComponents.name(), |pass| {
                stages.closed_components.shift_potential(pass);
            });
            stages.closed_components.clear_opening();
            if let Some(coupling) = &self.path.coupling {
                coupling.record_push(to);
            }
        }
        if !self.readback.together {
            self.solve_velocity()?;
        }
        Ok(())
    }

    fn solve_liquid(&mut self) -> Result<(), Error> {
        self.solve_together()?;
        if !self.readback.together {
            self.solve_pressure()?;
        }
        Ok(())
    }

    /// Assembles the pressure system once more, with components that are no longer closed. Volume control still leaves them out.
    fn open(&mut self, squeeze: &Squeeze) -> Result<(), Error> {
        let GpuPath { gpu, scene, head, liquid, solids, coupling, .. } = &mut *self.path;
        if let Some((coupling, (liquid, solids))) = coupling.as_mut().zip(liquid.as_ref().zip(solids.as_ref())) {
            let pairs = coupling.pairs(&scene.grid());
            coupling.write_patches(gpu, scene, (liquid, solids), &pairs, head.dt_last);
        }
        self.liquid_right_hand_side();
        let GpuPath { gpu, liquid, .. } = &mut *self.path;
        if let Some(GpuLiquid { buffers, solver, stages, .. }) = liquid {
            stages.closed_components.set_opening(gpu, buffers, solver, &squeeze.receding)?;
        }
        for stage in [Stage::ActiveCells, Stage::ClosedComponents] {
            self.record_liquid(stage);
        }
        self.remove_means();
        Ok(())
    }

    fn solve_together(&mut self) -> Result<(), Error> {
        let GpuPath { gpu, scene, head, liquid, solids, coupling, readbacks, .. } = &mut *self.path;
        let both = liquid.as_mut().zip(solids.as_ref());
        let Some((coupling, (liquid, solids))) = coupling.as_ref().zip(both) else {
            return Ok(());
        };
        let both_readbacks = readbacks.coupling.as_mut().zip(readbacks.solids.as_mut());
        let Some((solver, (coupling_readbacks, solid_readbacks))) = coupling.together().zip(both_readbacks) else {
            return Ok(());
        };
        let recorder = end_recording(&mut self.recorder, gpu);
        let targets = &mut head.cavity_volume;
        let (touch, mut seconds) = coupling.touch(gpu, liquid, recorder, coupling_readbacks, targets)?;
        self.readback.seconds.append(&mut seconds);
        self.readback.together = touch.touching;
        if !touch.touching {
            return Ok(());
        }
        let step = solids.buffers.step_of(scene.domain.gravity, self.dt);
        let (solved, mut seconds) = coupling.solve_in_contact(
            gpu,
            solver,
            (liquid, solids),
            solid_readbacks,
            (step, self.dt),
            (touch, &self.moved),
        )?;
        self.readback.seconds.append(&mut seconds);
        let [pressure, velocity] = solved.parts;
        self.readback.condensed = solved.condensed;
        self.readback.pushed = solved.pushed;
        self.readback.pressure = Some(pressure);
        self.readback.velocity = Some((velocity, solved.contact));
        Ok(())
    }

    fn solve_pressure(&mut self) -> Result<(), Error> {
        let GpuPath { gpu, liquid, coupling, .. } = &mut *self.path;
        let Some(liquid) = liquid else {
            return Ok(());
        };
        let mut recorder = end_recording(&mut self.recorder, gpu);
        let seal = coupling.as_ref();
        let seal = seal.map(|coupling| &coupling.stages.closed_components);
        let patches = coupling.as_ref().and_then(|coupling| coupling.stages.patch_pressure.as_ref());
        let with = (seal, None, patches, liquid.stages.solve.tolerance());
        let (LiquidSolve { solver, solve, .. }, rounds) = liquid.rounds(gpu, self.dt, with);
        let seconds = &mut self.readback.seconds;
        let Some(mut rounds) = rounds else {
            let (outcome, mut times) = solve.solve(gpu, recorder, solver)?;
            self.readback.pressure = Some(outcome);
            seconds.append(&mut times);
            return Ok(());
        };
        rounds.record_start(&mut recorder);
        let mut iterations = 0;
        let (mut outcome, recorder) = rounds.search(recorder, |recorder, round, update| {
            let aim = Aim { tolerance: round.tolerance, guess: round.number > 1 };
            let (outcome, mut times, updated) = solve.solve_then(gpu, recorder, (solver, aim), update)?;
            seconds.append(&mut times);
            iterations += outcome.iterations;
            Ok((outcome, updated))
        })?;
        outcome.iterations = iterations;
        outcome.status = rounds.status(outcome.status);
        self.readback.pressure = Some(outcome);
        self.recorder = Some(recorder);
        let report = rounds.report;
        liquid.n_separated = report.cells;
        liquid.separation = Some(report);
        Ok(())
    }

    /// Enclosed liquid components whose volume prescribed motion would change.
    fn squeeze(&mut self) -> Result<Squeeze, Error> {
        let GpuPath { gpu, scene, liquid, solids, coupling, obstacles, readbacks, .. } = &mut *self.path;
        let Some((liquid, outcome)) = liquid.as_ref().zip(self.readback.pressure.as_ref()) else {
            return Ok(Squeeze::default());
        };
        if outcome.status == SolveStatus::NonFinite || outcome.closed_components == 0 || !can_squeeze(scene) {
            return Ok(Squeeze::default());
        }
        let clip = coupling.as_ref().map(|coupling| &coupling.clip);
        let clip = clip.or(obstacles.as_ref().map(|obstacles| &obstacles.clip));
        let fluxes = clip.map_or(&[][..], |clip| clip.obstacles().flux());
        let sources = liquid.taken_by_sources(clip.map(|clip| &clip.cut_cells().open));
        let prescribed = fluxes.iter().copied().chain(sources);
        let together = self.readback.together;
        let nodes = solids.as_ref().zip(clip).filter(|_| together);
        let opens = liquid.stages.separation.is_some() && can_open(scene);
        squeezed(gpu, &mut readbacks.squeeze, liquid, nodes, prescribed, opens)
    }

    /// Prescribed motion that would change the volume of an enclosed liquid component makes the solve incompatible.
    fn flag_squeeze(&mut self, share: f64) {
        if share <= SQUEEZE {
            return;
        }
        let pressure = self.readback.pressure.iter_mut();
        let velocity = self.readback.velocity.iter_mut().map(|(velocity, _)| velocity);
        for outcome in pressure.chain(velocity).filter(|outcome| outcome.status == SolveStatus::Converged) {
            outcome.status = SolveStatus::Incompatible;
        }
    }

    fn solve_velocity(&mut self) -> Result<(), Error> {
        let GpuPath { gpu, solids, readbacks, .. } = &mut *self.path;
        let Some((solids, readbacks)) = solids.as_ref().zip(readbacks.solids.as_mut()) else {
            return Ok(());
        };
        let recorder = end_recording(&mut self.recorder, gpu);
        let polynomial = solids.polynomial(self.dt);
        let (outcome, contact, mut seconds) =
            solids.solve_in_contact(gpu, recorder, &mut readbacks.answer, &polynomial)?;
        self.readback.velocity = Some((outcome, contact));
        self.readback.seconds.append(&mut seconds);
        if contact.unsettled > 0 && solids.contacts.is_none() {
            // The velocities solve a system only if all nodes are constrained.
            recording(&mut self.recorder, gpu).clear(&solids.buffers.freedom);
        }
        Ok(())
    }

    fn diagnose(&mut self) -> Result<(), Error> {
        let GpuPath { gpu, liquid, solids, coupling, readbacks, .. } = &mut *self.path;
        let mut to = end_recording(&mut self.recorder, gpu);
        let mut liquid = liquid.as_ref().zip(readbacks.liquid.as_mut());
        if let Some((liquid, readback)) = &mut liquid {
            liquid.stages.record(Stage::Diagnose, &mut to);
            to.read(&liquid.buffers.report, readback);
        }
        let mut solids = solids.as_ref().zip(readbacks.solids.as_mut());
        if let Some((solids, readbacks)) = &mut solids {
            solids.stages.diagnose.record(&mut to);
            to.read(&solids.buffers.report, &mut readbacks.report);
        }
        let mut coupling = coupling.as_ref().zip(readbacks.coupling.as_mut());
        if let Some((coupling, readbacks)) = &mut coupling {
            coupling.record_report(&mut to, readbacks);
        }
        let timing = to.submit();
        if let Some((_, readback)) = liquid {
            self.readback.liquid = Some(Report::from_words(&readback.wait(gpu)?));
        }
        if let Some((_, readbacks)) = solids {
            self.readback.solids = Some(SolidReport::from_words(&readbacks.report.wait(gpu)?));
        }
        if let Some((coupling, readbacks)) = coupling {
            let condensed = self.readback.condensed;
            self.readback.coupling = Some(coupling.report(gpu, readbacks, condensed)?);
        }
        self.readback.seconds.extend(timing.wait()?);
        Ok(())
    }
}

/// The report of a solve.
pub(super) fn solve_report(outcome: &Outcome) -> SolveReport {
    SolveReport {
        unknowns: outcome.unknowns as usize,
        iterations: outcome.iterations,
        residual: outcome.residual,
        status: outcome.status,
    }
}

/// Sums the times of stages with several passes, in the order of first appearance.
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
