//! The solids of a scene on a device: buffers, stages, solver, and the host's share of their state.

use crate::Error;
use crate::effects::Effects;
use crate::elastic::{Body, Bounds, Solids};
use crate::fields;
use crate::fields::{ObstacleBuffers, SolidBuffers, SolidPlan, SolidRows, SolidStep, SolidSystemBuffers, variant};
use crate::geometry::{ContactField, ObstacleCut};
use crate::gpu::{Buffer, Dispatches, Gpu, Pass, Readback, Real, Recorder, StageTimes};
use crate::linalg::Row;
use crate::reference::{MAX_SOLVES, MOST_HALVINGS, MOST_MEETINGS};
use crate::scene::Scene;
use crate::solver::{
    ContactSearch, ObstacleField, Outcome, Polynomial, RowsOf, SolidSolver, SolidSystem, check_contact,
};
use crate::stages;
use crate::state::{Carried, ContactReport, SolidReport, SolveStatus, State};
use crate::step::Stage;

use super::gpu_contacts::GpuContacts;
use super::step::solve_report;

/// The solids on the device.
#[derive(Debug)]
pub(super) struct GpuSolids {
    pub(super) solids: Solids,
    bounds: Bounds,
    /// Distance to the obstacles, if any.
    obstacles: Option<ObstacleBuffers>,
    /// Moving obstacles, if any.
    moving: Option<ContactField>,
    /// Where solids touch each other.
    pub(super) contacts: Option<GpuContacts>,
    /// Largest node speed, m/s.
    pub(super) max_speed: f64,
    pub(super) buffers: SolidBuffers,
    pub(super) system: SolidSystemBuffers,
    pub(super) stages: SolidStages,
    scripted: Scripted,
    /// Displacements for the probes, if any.
    probed: Option<Readback<[f32; 4]>>,
    /// Velocities for the probes that need them, if any.
    probed_velocity: Option<Readback<u32>>,
}

/// Readbacks of a sub-step.
#[derive(Debug)]
pub(super) struct SolidReadbacks {
    pub(super) report: Readback<u32>,
    /// Result of a query of the active-set search.
    pub(super) answer: Readback<u32>,
}

/// Input of the active-set search.
pub(super) struct Search<'s, Push> {
    pub(super) search: &'s ContactSearch,
    /// Records the pressure forces on the nodes after a solve.
    pub(super) push: Push,
    /// Whether the solve includes pressures, which must match the velocities.
    pub(super) together: bool,
}

/// Queries the device during the active-set search.
struct ContactQuery<'s, 'a> {
    gpu: &'a Gpu,
    /// Parameters and result of a query (`shaders/common/ask.wgsl`).
    words: &'s Buffer<u32>,
    readback: &'s mut Readback<u32>,
    seconds: StageTimes,
}

impl ContactQuery<'_, '_> {
    /// Runs kernels with a parameter and initial counters. Waits for the counters and returns them.
    fn run(&mut self, counters: [u32; 2], parameter: u32, record: impl FnOnce(&mut Pass)) -> Result<[u32; 2], Error> {
        let mut to = Recorder::timed(self.gpu);
        self.gpu.upload(self.words, &[counters[0], counters[1], parameter]);
        to.stage(Stage::Solve.name(), record);
        to.read(self.words, self.readback);
        let timing = to.submit();
        let answer = self.readback.wait(self.gpu)?;
        self.seconds.append(&mut timing.wait()?);
        Ok([answer[0], answer[1]])
    }

    /// Writes a parameter for the next submission, without a readback.
    fn set_parameter(&self, parameter: u32) {
        self.gpu.upload(self.words, &[0, 0, parameter]);
    }
}

/// Host copy of the prescribed motion, so that scripted nodes reach their keyframes without a readback. Empty without
/// scripts.
#[derive(Debug, Default)]
struct Scripted {
    /// Displacement of all nodes from rest, m; valid for prescribed components only.
    displacement: Vec<[f64; 3]>,
    /// Velocities of the prescribed components on the device, m/s.
    velocity: Vec<[f64; 3]>,
}

/// The kernels of a sub-step, in order.
#[derive(Debug)]
pub(super) struct SolidStages {
    /// First part of `move_solid`.
    pub(super) ballistic: Dispatches,
    pub(super) move_solid: Dispatches,
    pub(super) forces: Dispatches,
    pub(super) rotations: Dispatches,
    pub(super) system: SolidSystem,
    pub(super) solve: SolidSolver,
    pub(super) diagnose: Dispatches,
}

/// Sizes of [`SolidBuffers`] on an adapter with or without f64.
fn solid_plan(scene: &Scene, solids: &Solids, f64: bool) -> SolidPlan {
    let effects = Effects::of(scene);
    SolidPlan {
        scripts: effects.scripts,
        obstacles: effects.obstacles,
        n_moving: match effects.pushing_obstacles {
            true => scene.obstacles.iter().filter(|it| it.motion.is_some()).count(),
            false => 0,
        },
        ..SolidPlan::new(scene.grid(), solids, variant(f64, scene.solver.precision).real)
    }
}

/// Rounds to the f32 values on the device.
fn round_to_f32(velocity: &mut [[f64; 3]]) {
    for v in velocity.iter_mut().flatten() {
        *v = f64::from(*v as f32);
    }
}

fn has_probes(scene: &Scene) -> bool {
    scene.probes.iter().any(|probe| probe.kind.measures_solid())
}

impl GpuSolids {
    /// Allocates and compiles. Obstacles and state must be written afterwards.
    pub(super) fn new(gpu: &Gpu, scene: &Scene, solids: Solids) -> Result<GpuSolids, Error> {
        let plan = solid_plan(scene, &solids, gpu.has_f64());
        check_contact(&scene.solver)?;
        let rows = SolidRows::new(&solids)?;
        let buffers = SolidBuffers::new(gpu, plan, &solids)?;
        let system = SolidSystemBuffers::new(gpu, &rows, &scene.solver)?;
        let obstacles = || ObstacleBuffers::new(gpu, &plan.grid, true);
        let obstacles = plan.obstacles.then(obstacles).transpose()?;
        let field = buffers
            .level
            .as_ref()
            .zip(obstacles.as_ref())
            .map(|(level, obstacles)| ObstacleField { level, solid_distance: &obstacles.solid_distance });
        let stages = SolidStages {
            ballistic: stages::ballistic_bodies(gpu, &buffers, field)?,
            move_solid: stages::move_solid(gpu, &buffers)?,
            forces: stages::node_forces(gpu, &buffers)?,
            rotations: stages::element_rotations(gpu, &buffers)?,
            system: SolidSystem::new(gpu, &system, &buffers, field)?,
            solve: SolidSolver::new(gpu, &system, &buffers, &scene.solver)?,
            diagnose: stages::diagnose_solid(gpu, &buffers)?,
        };
        let probed = || Readback::new(gpu, "solid.displacement", 2 * plan.n_nodes);
        let words = buffers.velocity.real.bytes() * plan.n_nodes;
        let probed_velocity = || Readback::new(gpu, "solid.velocity", words);
        let mut probes = scene.probes.iter();
        let needs_velocity = probes.any(|probe| probe.kind.needs_node_velocity());
        let contacts = || GpuContacts::new(gpu, &plan.grid, (&solids, &buffers));
        let contacts = Effects::of(scene).solid_contact.then(contacts);
        Ok(GpuSolids {
            obstacles,
            moving: None,
            contacts: contacts.transpose()?,
            bounds: Bounds::new(&solids),
            max_speed: 0.0,
            buffers,
            system,
            stages,
            scripted: Scripted::default(),
            probed: has_probes(scene).then(probed).transpose()?,
            probed_velocity: needs_velocity.then(probed_velocity).transpose()?,
            solids,
        })
    }

    /// Copies the keyframes from a scene that is the same otherwise.
    pub(super) fn follow(&mut self, scene: &Scene) {
        self.solids.follow(scene);
        if let Some(field) = &mut self.moving {
            field.follow(scene);
        }
        if let Some(contacts) = &mut self.contacts {
            contacts.field.follow(scene);
        }
    }

    /// Writes the distance to the obstacles.
    pub(super) fn write_obstacles(&mut self, gpu: &Gpu, cut: &ObstacleCut) {
        if let Some(contacts) = &mut self.contacts {
            contacts.field = cut.contact_field(&self.buffers.plan.grid);
        }
        let Some(obstacles) = &self.obstacles else {
            return;
        };
        obstacles.write(gpu, &cut.static_cut().solid_distance);
        if self.buffers.plan.n_moving > 0 {
            self.moving = Some(cut.contact_field(&self.buffers.plan.grid));
        }
    }

    /// Moves the obstacles to the end of a sub-step of dt (s) that starts at a time (s), and writes them.
    fn move_obstacles(&mut self, gpu: &Gpu, time: f64, dt: f64) {
        if let Some((field, obstacles)) = self.moving.as_mut().zip(self.obstacles.as_ref()) {
            field.move_to(time + dt, dt);
            obstacles.write(gpu, &field.distance);
            self.buffers.write_motions(gpu, field);
        }
    }

    /// The moving obstacles, if any.
    pub(super) fn moving(&self) -> Option<&ContactField> {
        self.moving.as_ref()
    }

    /// Upper bound of the speed of the obstacles between a time and `span` (both s) later, m/s.
    pub(super) fn obstacle_speed(&self, time: f64, span: f64) -> f64 {
        let field = self.moving.as_ref();
        field.map_or(0.0, |field| field.max_speed(time, span))
    }

    /// Allocates the readbacks of a sub-step.
    pub(super) fn readbacks(gpu: &Gpu) -> Result<SolidReadbacks, Error> {
        Ok(SolidReadbacks {
            report: Readback::new(gpu, "solid.report", fields::SolidReport::WORDS)?,
            answer: Readback::new(gpu, "solid.answer", 3)?,
        })
    }

    /// Submits the recording, which ends with the solve of a sub-step, and repeats the solve until the active set of
    /// contacts is unchanged.
    pub(super) fn solve_in_contact(
        &self,
        gpu: &Gpu,
        recorder: Recorder,
        answer: &mut Readback<u32>,
        polynomial: &Polynomial,
    ) -> Result<(Outcome, ContactReport, StageTimes), Error> {
        let GpuSolids { buffers, system, stages, .. } = self;
        if let Some(contacts) = &self.contacts {
            let dx = buffers.plan.grid.dx;
            // Solves leave the displacement as it is: it is read back once.
            let (mut displacement, mut last) = (Vec::new(), Vec::new());
            let mut rows = |velocity: &[f64], known: &[Row]| {
                if displacement.is_empty() {
                    displacement = contacts.displacement(gpu, buffers)?;
                }
                velocity.clone_into(&mut last);
                Ok(contacts.touching(&self.solids, dx, &displacement, |touching| touching.rows(velocity, known)))
            };
            let with = (system, buffers);
            let rows_of = (&mut rows as RowsOf, MOST_MEETINGS);
            let solved = stages.solve.solve_in_rows(gpu, recorder, with, polynomial, rows_of)?;
            let (outcome, mut contact, times) = solved;
            if !last.is_empty() {
                contacts.touching(&self.solids, dx, &displacement, |touching| touching.shorten(&last, &mut contact));
            }
            return Ok((outcome, contact, times));
        }
        let mut iterations = 0;
        let solve = |recorder, _| {
            let fields = buffers;
            let (mut outcome, times) = stages.solve.solve(gpu, recorder, system, fields, polynomial)?;
            iterations += outcome.iterations;
            outcome.iterations = iterations;
            Ok((outcome, outcome.status, times))
        };
        let search = Search { search: stages.system.search(), push: |_: &mut Pass| (), together: false };
        self.iterate_active_set(gpu, recorder, answer, solve, search)
    }

    /// Repeats a solve until the active set of contacts is unchanged. Returns the last result. `solve` appends itself
    /// to a recording and submits it; its argument is the number of earlier solves.
    pub(super) fn iterate_active_set<Solution>(
        &self,
        gpu: &Gpu,
        mut recorder: Recorder,
        answer: &mut Readback<u32>,
        mut solve: impl FnMut(Recorder, u32) -> Result<(Solution, SolveStatus, StageTimes), Error>,
        Search { search, push, together }: Search<impl Fn(&mut Pass)>,
    ) -> Result<(Solution, ContactReport, StageTimes), Error> {
        let mut query = ContactQuery { gpu, words: &self.buffers.answer, readback: answer, seconds: StageTimes::new() };
        for solves in 1.. {
            let (mut solution, status, mut times) = solve(recorder, solves - 1)?;
            query.seconds.append(&mut times);
            let [penetrating, adhering] = query.run([0; 2], 0, |pass| {
                push(pass);
                search.record_judge(pass);
            })?;
            let unsettled = penetrating + adhering;
            let mut contact = ContactReport { solves, unsettled, ..ContactReport::default() };
            if unsettled == 0 || (together && !status.is_best_attainable()) {
                return Ok((solution, contact, query.seconds));
            }
            let most = MAX_SOLVES - u32::from(together);
            let ended = solves == most || !status.is_best_attainable();
            // The pressure does not match the velocities at which a search stops. One more solve, with all touched
            // surfaces constrained, computes one that does.
            let constrain_touching = ended && together;
            let mut next = self.next_active_set(&mut query, search, solves == 1, penetrating, constrain_touching)?;
            if ended && !together {
                query.seconds.append(&mut next.submit().wait()?);
            } else {
                next.stage(Stage::Solve.name(), |pass| self.stages.system.record_hold(pass));
                if !ended {
                    recorder = next;
                    continue;
                }
                (solution, _, times) = solve(next, solves)?;
                contact.solves += 1;
                query.seconds.append(&mut times);
            }
            gpu.upload(&self.buffers.answer, &[unsettled, 0, 0]);
            return Ok((solution, contact, query.seconds));
        }
        unreachable!("the last solve returns")
    }

    /// Continues the search after a solve that violates constraints. The recording writes the best velocity so far to
    /// the fields and the next constraints to the nodes' projectors. `constrain_touching` adds all surfaces that this
    /// velocity touches.
    fn next_active_set<'a>(
        &self,
        query: &mut ContactQuery<'_, 'a>,
        search: &ContactSearch,
        first: bool,
        penetrating: u32,
        constrain_touching: bool,
    ) -> Result<Recorder, Error> {
        let velocity = &self.buffers.velocity.words;
        let best = &self.system.best.words;
        if penetrating == 0 {
            let mut to = Recorder::timed(query.gpu);
            to.stage(Stage::Solve.name(), |pass| search.record_judge(pass));
            to.copy(velocity, best);
            if constrain_touching {
                to.stage(Stage::Solve.name(), |pass| search.record_hold_stopped(pass));
            }
            query.set_parameter(1);
            return Ok(to);
        }
        let whole = [1_f32.to_bits(), 0];
        let [stop, _] = query.run(whole, 0, |pass| {
            if first {
                search.record_rest(pass);
            }
            search.record_first_stop(pass);
        })?;
        let stop = f32::from_bits(stop);
        let halves = (0..=MOST_HALVINGS).map(|halvings| 0.5_f32.powi(halvings as i32));
        // A step shorter than the one to the first surface would leave the active set unchanged.
        for share in halves.take_while(|share| *share > stop).chain([stop]) {
            let parameter = share.to_bits();
            let [grows, _] = query.run([0; 2], parameter, |pass| search.record_approach(pass))?;
            if grows == 0 {
                break;
            }
        }
        let mut to = Recorder::timed(query.gpu);
        to.copy(&self.system.z.words, best);
        to.stage(Stage::Solve.name(), |pass| search.record_hold_stopped(pass));
        to.copy(best, velocity);
        query.set_parameter(u32::from(constrain_touching));
        Ok(to)
    }

    /// Writes the solids' part of a state.
    pub(super) fn write_state(&mut self, gpu: &Gpu, state: &State) {
        let speeds = state.node_velocity.iter().flatten().map(|v| v.abs());
        self.max_speed = speeds.fold(0.0, f64::max);
        self.buffers.write_state(gpu, state);
        if self.buffers.plan.scripts {
            self.scripted =
                Scripted { displacement: state.displacement.clone(), velocity: state.node_velocity.clone() };
        }
    }

    /// Reads the data of the solids beyond a state, needed to resume.
    pub(super) fn carry(&self, gpu: &Gpu, carried: &mut Carried) -> Result<(), Error> {
        carried.max_speed[1] = self.max_speed;
        let parts = gpu.download(&self.buffers.displacement)?;
        let wide = |&[x, y, z, _]: &[f32; 4]| [x, y, z].map(f64::from);
        let (high, low) = parts.split_at(self.buffers.plan.n_nodes);
        carried.displacement_high = high.iter().map(wide).collect();
        carried.displacement_low = low.iter().map(wide).collect();
        let Scripted { displacement, velocity } = &self.scripted;
        carried.scripted_displacement.clone_from(displacement);
        carried.scripted_velocity.clone_from(velocity);
        Ok(())
    }

    /// Writes that data, after the state.
    pub(super) fn resume(&mut self, gpu: &Gpu, carried: &Carried) {
        self.max_speed = carried.max_speed[1];
        let parts = [&carried.displacement_high, &carried.displacement_low];
        let words = parts.into_iter().flatten();
        let words: Vec<[f32; 4]> = words.map(|&[x, y, z]| [x as f32, y as f32, z as f32, 0.0]).collect();
        gpu.upload(&self.buffers.displacement, &words);
        self.scripted = Scripted {
            displacement: carried.scripted_displacement.clone(),
            velocity: carried.scripted_velocity.clone(),
        };
    }

    /// Writes the parameters of a sub-step of dt (s) that starts at the time of the clock.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub(super) fn write_step(&mut self, gpu: &Gpu, scene: &Scene, clock: &State, dt: f64) -> Result<(), Error> {
        let step = self.buffers.step_of(scene.domain.gravity, dt);
        if let Some(contacts) = &mut self.contacts {
            let with = (&self.solids, &self.buffers);
            let end = [clock.time + dt, dt];
            contacts.begin(gpu, with, &self.buffers.plan.grid, end)?;
        }
        gpu.upload(&self.buffers.step, &[step]);
        if self.solids.set_load([clock.time, clock.time + dt]) {
            self.buffers.write_load(gpu, &self.solids);
        }
        self.move_obstacles(gpu, clock.time, dt);
        let Scripted { displacement, velocity } = &mut self.scripted;
        if displacement.is_empty() {
            return Ok(());
        }
        if clock.step == 0 {
            self.solids.start_scripts(displacement, velocity, f64::from(step.dt));
            if self.buffers.plan.real == Real::F32 {
                round_to_f32(velocity);
            }
            self.buffers.write_velocity(gpu, velocity);
        }
        // Same update as in `move_solid`.
        for (u, v) in displacement.iter_mut().zip(velocity.iter()) {
            for (u, v) in u.iter_mut().zip(v) {
                *u += f64::from(step.dt) * v;
            }
        }
        *velocity = self.solids.prescribed_velocity(displacement, clock.time + dt, dt);
        round_to_f32(velocity);
        self.buffers.write_prescribed(gpu, velocity);
        Ok(())
    }

    /// The Chebyshev preconditioner of a sub-step of dt (s).
    pub(super) fn polynomial(&self, dt: f64) -> Polynomial {
        self.polynomial_for(|body| [body.zeta_mass(dt), body.zeta_stiffness(dt)])
    }

    /// The Chebyshev preconditioner for other zeta_M (1/s) and zeta_K (s) per body.
    pub(super) fn polynomial_for(&self, zeta: impl Fn(&Body) -> [f64; 2]) -> Polynomial {
        Polynomial::for_solids(&self.bounds, &self.solids, zeta)
    }

    /// Records the assembly of another system of this sub-step, and with `again` its right-hand side from the present
    /// velocities. The constraints are unchanged.
    pub(super) fn record_other_system(&self, gpu: &Gpu, to: &mut Recorder, step: SolidStep, again: bool) {
        gpu.upload(&self.buffers.step, &[step]);
        let stages = &self.stages;
        to.stage(Stage::Solve.name(), |pass| {
            stages.rotations.record_in(pass);
            stages.system.record_matrices(pass);
            if again {
                stages.system.record_right_hand_side(pass);
            }
            stages.system.record_hold(pass);
        });
    }

    /// Stores the numbers of the report that the next sub-step needs.
    pub(super) fn finish(
        &mut self,
        outcome: &Outcome,
        contact: ContactReport,
        report: fields::SolidReport,
    ) -> SolidReport {
        self.max_speed = report.diagnosis.max_speed;
        SolidReport { solve: solve_report(outcome), contact, diagnosis: report.diagnosis }
    }

    /// Displacements of all nodes, m.
    pub(super) fn displacement(&self, gpu: &Gpu) -> Result<Vec<[f64; 3]>, Error> {
        let words = gpu.download(&self.buffers.displacement)?;
        Ok(self.buffers.displacement_of(&words))
    }

    /// Displacements (m) and velocities (m/s) of all nodes for the probes. Each is empty if no probe needs it.
    pub(super) fn probed(&mut self, gpu: &Gpu) -> Result<[Vec<[f64; 3]>; 2], Error> {
        let Some(readback) = &mut self.probed else {
            return Ok(Default::default());
        };
        let buffers = &self.buffers;
        let mut recorder = Recorder::new(gpu);
        recorder.read(&buffers.displacement, readback);
        if let Some(readback) = &mut self.probed_velocity {
            recorder.read_part(&buffers.velocity.words, 0, readback);
        }
        recorder.submit();
        let displacement = buffers.displacement_of(&readback.wait(gpu)?);
        let velocity = match &mut self.probed_velocity {
            None => Vec::new(),
            Some(readback) => {
                let words = buffers.velocity.widen(&readback.wait(gpu)?);
                let (nodes, _) = words.as_chunks::<4>();
                nodes.iter().map(|&[x, y, z, _]| [x, y, z]).collect()
            }
        };
        Ok([displacement, velocity])
    }
}
