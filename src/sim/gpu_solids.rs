//! The solids of a scene on a device: their buffers, their stages and their solver, and what the host keeps of their state.

use crate::Error;
use crate::effects::Effects;
use crate::elastic::{Body, Bounds, Solids};
use crate::fields;
use crate::fields::{ObstacleBuffers, SolidBuffers, SolidPlan, SolidStep};
use crate::geometry::CutCells;
use crate::gpu::{Buffer, Dispatches, Gpu, Pass, Readback, Real, Recorder, StageTimes};
use crate::reference::{MOST_HALVINGS, MOST_SOLVES};
use crate::scene::Scene;
use crate::solver::{
    self, ContactSearch, ObstacleField, Outcome, Polynomial, SolidRows, SolidSolver, SolidSystem,
    SolidSystemBuffers,
};
use crate::stages;
use crate::state::{Carried, ContactReport, SolidReport, SolveStatus, State};

use super::step::solve_report;

/// The solids on the device.
#[derive(Debug)]
pub(super) struct GpuSolids {
    pub(super) solids: Solids,
    bounds: Bounds,
    /// Distance to the obstacles, where there are any.
    obstacles: Option<ObstacleBuffers>,
    /// m/s
    pub(super) max_speed: f64,
    pub(super) buffers: SolidBuffers,
    pub(super) system: SolidSystemBuffers,
    pub(super) stages: SolidStages,
    scripted: Scripted,
    /// Where displacements arrive for the probes, where there are any.
    probed: Option<Readback<[f32; 4]>>,
}

/// Where what the device tells of a sub-step arrives.
#[derive(Debug)]
pub(super) struct SolidReadbacks {
    pub(super) report: Readback<u32>,
    /// What the search for contacts asks.
    pub(super) answer: Readback<u32>,
}

/// What the search for what walls and obstacles hold takes.
pub(super) struct Search<'s, Push> {
    pub(super) search: &'s ContactSearch,
    /// Records what pushes the nodes, once a solve found it.
    pub(super) push: Push,
    /// Whether pressures are found with the velocities, and have to fit them.
    pub(super) together: bool,
}

/// Asks the device in the middle of a sub-step.
struct Ask<'s, 'a> {
    gpu: &'a Gpu,
    /// The answer, and what the kernels are told.
    words: &'s Buffer<u32>,
    readback: &'s mut Readback<u32>,
    seconds: StageTimes,
}

impl Ask<'_, '_> {
    /// Tells kernels of the solve a number, submits them, and waits for what they make of others.
    fn about(
        &mut self,
        of: [u32; 2],
        told: u32,
        record: impl FnOnce(&mut Pass),
    ) -> Result<[u32; 2], Error> {
        let mut to = Recorder::timed(self.gpu);
        self.gpu.upload(self.words, &[of[0], of[1], told]);
        to.stage("solve", record);
        to.read(self.words, self.readback);
        let timing = to.submit();
        let answer = self.readback.wait(self.gpu)?;
        self.seconds.append(&mut timing.wait()?);
        Ok([answer[0], answer[1]])
    }

    /// Tells kernels of the next submission a number; nobody waits for their answer.
    fn tell(&self, told: u32) {
        self.gpu.upload(self.words, &[0, 0, told]);
    }
}

/// What the host follows of scripted nodes, so that they land on their keyframes without being read back. Empty without scripts.
#[derive(Debug, Default)]
struct Scripted {
    /// Displacement of all nodes from rest, m; right for prescribed components only.
    displacement: Vec<[f64; 3]>,
    /// Velocities that the device has for the prescribed components, m/s.
    velocity: Vec<[f64; 3]>,
}

/// The kernels of a step, in its order.
#[derive(Debug)]
pub(super) struct SolidStages {
    pub(super) move_solid: Dispatches,
    pub(super) forces: Dispatches,
    pub(super) rotations: Dispatches,
    pub(super) system: SolidSystem,
    pub(super) solve: SolidSolver,
    pub(super) diagnose: Dispatches,
}

/// What decides the sizes of [`SolidBuffers`] on an adapter with or without f64.
fn solid_plan(scene: &Scene, solids: &Solids, f64: bool) -> SolidPlan {
    let effects = Effects::of(scene);
    SolidPlan {
        grid: scene.grid(),
        n_nodes: solids.rest.len(),
        n_elements: solids.elements.len(),
        n_turning: solids.turning().count(),
        scripts: effects.scripts,
        obstacles: effects.obstacles,
        real: solver::variant(f64, scene.solver.precision).real,
    }
}

/// To what the device holds in f32.
fn round_to_f32(velocity: &mut [[f64; 3]]) {
    for v in velocity.iter_mut().flatten() {
        *v = f64::from(*v as f32);
    }
}

fn has_probes(scene: &Scene) -> bool {
    scene.probes.iter().any(|probe| probe.kind.of_solid())
}

impl GpuSolids {
    /// Allocates and compiles. Obstacles and state are to be written.
    pub(super) fn new(gpu: &Gpu, scene: &Scene, solids: Solids) -> Result<GpuSolids, Error> {
        let plan = solid_plan(scene, &solids, gpu.has_f64());
        let rows = SolidRows::new(&solids)?;
        let buffers = SolidBuffers::new(gpu, plan, &solids)?;
        let system = SolidSystemBuffers::new(gpu, &rows, &scene.solver)?;
        let obstacles = || ObstacleBuffers::new(gpu, &plan.grid, true);
        let obstacles = plan.obstacles.then(obstacles).transpose()?;
        let field = buffers
            .level
            .as_ref()
            .zip(obstacles.as_ref())
            .map(|(level, obstacles)| ObstacleField {
                level,
                solid_distance: &obstacles.solid_distance,
            });
        let stages = SolidStages {
            move_solid: stages::move_solid(gpu, &buffers)?,
            forces: stages::node_forces(gpu, &buffers)?,
            rotations: stages::element_rotations(gpu, &buffers)?,
            system: SolidSystem::new(gpu, &system, buffers.fields(), field)?,
            solve: SolidSolver::new(gpu, &system, buffers.fields(), &scene.solver)?,
            diagnose: stages::diagnose_solid(gpu, &buffers)?,
        };
        let probed = || Readback::new(gpu, "solid.displacement", 2 * plan.n_nodes);
        Ok(GpuSolids {
            obstacles,
            bounds: Bounds::new(&solids),
            max_speed: 0.0,
            buffers,
            system,
            stages,
            scripted: Scripted::default(),
            probed: has_probes(scene).then(probed).transpose()?,
            solids,
        })
    }

    /// Writes the distance to the obstacles.
    pub(super) fn write_obstacles(&self, gpu: &Gpu, cut: &CutCells) {
        if let Some(obstacles) = &self.obstacles {
            obstacles.write(gpu, cut);
        }
    }

    /// Readbacks of a sub-step.
    pub(super) fn readbacks(gpu: &Gpu) -> Result<SolidReadbacks, Error> {
        Ok(SolidReadbacks {
            report: Readback::new(gpu, "solid.report", fields::SolidReport::WORDS)?,
            answer: Readback::new(gpu, "solid.answer", 3)?,
        })
    }

    /// Submits the recording with the solve of a sub-step at its end, and solves again while contacts change.
    pub(super) fn solve_in_contact<'a>(
        &self,
        gpu: &'a Gpu,
        recorder: Recorder,
        answer: &mut Readback<u32>,
        polynomial: &Polynomial,
    ) -> Result<(Outcome, ContactReport, StageTimes), Error> {
        let GpuSolids {
            buffers,
            system,
            stages,
            ..
        } = self;
        let mut iterations = 0;
        let solve = |recorder, _| {
            let fields = buffers.fields();
            let (mut outcome, times) = stages
                .solve
                .solve(gpu, recorder, system, fields, polynomial)?;
            iterations += outcome.iterations;
            outcome.iterations = iterations;
            Ok((outcome, outcome.status, times))
        };
        let search = Search {
            search: stages.system.search(),
            push: |_: &mut Pass| (),
            together: false,
        };
        self.until_settled(gpu, recorder, answer, solve, search)
    }

    /// Solves and, while the search for contacts changes them, again: the last outcome. `solve` submits a recording with itself at the
    /// end, and hears how many solves there were.
    pub(super) fn until_settled<'a, Found>(
        &self,
        gpu: &'a Gpu,
        mut recorder: Recorder,
        answer: &mut Readback<u32>,
        mut solve: impl FnMut(Recorder, u32) -> Result<(Found, SolveStatus, StageTimes), Error>,
        Search {
            search,
            push,
            together,
        }: Search<impl Fn(&mut Pass)>,
    ) -> Result<(Found, ContactReport, StageTimes), Error> {
        let mut ask = Ask {
            gpu,
            words: &self.buffers.answer,
            readback: answer,
            seconds: StageTimes::new(),
        };
        for solves in 1.. {
            let (mut found, status, mut times) = solve(recorder, solves - 1)?;
            ask.seconds.append(&mut times);
            let [beyond, pulled] = ask.about([0; 2], 0, |pass| {
                push(pass);
                search.record_judge(pass);
            })?;
            let unsettled = beyond + pulled;
            let mut contact = ContactReport { solves, unsettled };
            if unsettled == 0 || (together && !status.found_all_it_can()) {
                return Ok((found, contact, ask.seconds));
            }
            let most = MOST_SOLVES - u32::from(together);
            let ended = solves == most || !status.found_all_it_can();
            // The pressure found does not go with the velocities that a search ends at: one more solve finds one that does, with all held
            // that they touch.
            let hold_all = ended && together;
            let mut next = self.search_on(&mut ask, search, solves == 1, beyond, hold_all)?;
            if ended && !together {
                ask.seconds.append(&mut next.submit().wait()?);
            } else {
                next.stage("solve", |pass| self.stages.system.record_hold(pass));
                if !ended {
                    recorder = next;
                    continue;
                }
                (found, _, times) = solve(next, solves)?;
                contact.solves += 1;
                ask.seconds.append(&mut times);
            }
            gpu.upload(&self.buffers.answer, &[unsettled, 0, 0]);
            return Ok((found, contact, ask.seconds));
        }
        unreachable!("the last solve returns")
    }

    /// After a solve that found what is wrong: a recording that leaves the best velocity so far in the fields, and in the freedom of the
    /// nodes what the next solve is to hold, all that this velocity touches where asked to.
    fn search_on<'a>(
        &self,
        ask: &mut Ask<'_, 'a>,
        search: &ContactSearch,
        first: bool,
        beyond: u32,
        hold_all: bool,
    ) -> Result<Recorder, Error> {
        let velocity = &self.buffers.velocity.words;
        let best = &self.system.best.words;
        if beyond == 0 {
            let mut to = Recorder::timed(ask.gpu);
            to.stage("solve", |pass| search.record_judge(pass));
            to.copy(velocity, best);
            if hold_all {
                to.stage("solve", |pass| search.record_hold_stopped(pass));
            }
            ask.tell(1);
            return Ok(to);
        }
        let whole = [1_f32.to_bits(), 0];
        let [stop, _] = ask.about(whole, 0, |pass| {
            if first {
                search.record_rest(pass);
            }
            search.record_first_stop(pass);
        })?;
        let stop = f32::from_bits(stop);
        let halves = (0..=MOST_HALVINGS).map(|halvings| 0.5_f32.powi(halvings as i32));
        // Less than up to the first surface leaves the next solve what this one had.
        for share in halves.take_while(|share| *share > stop).chain([stop]) {
            let told = share.to_bits();
            let [grows, _] = ask.about([0; 2], told, |pass| search.record_approach(pass))?;
            if grows == 0 {
                break;
            }
        }
        let mut to = Recorder::timed(ask.gpu);
        to.copy(&self.system.z.words, best);
        to.stage("solve", |pass| search.record_hold_stopped(pass));
        to.copy(best, velocity);
        ask.tell(u32::from(hold_all));
        Ok(to)
    }

    /// Replaces the solids' part of the state.
    pub(super) fn write_state(&mut self, gpu: &Gpu, state: &State) {
        let speeds = state.node_velocity.iter().flatten().map(|v| v.abs());
        self.max_speed = speeds.fold(0.0, f64::max);
        self.buffers.write_state(gpu, state);
        if self.buffers.plan.scripts {
            self.scripted = Scripted {
                displacement: state.displacement.clone(),
                velocity: state.node_velocity.clone(),
            };
        }
    }

    /// What of them a state does not hold.
    pub(super) fn carry(&self, gpu: &Gpu, carried: &mut Carried) -> Result<(), Error> {
        carried.max_speed[1] = self.max_speed;
        let parts = gpu.download(&self.buffers.displacement)?;
        let wide = |&[x, y, z, _]: &[f32; 4]| [x, y, z].map(f64::from);
        let (high, low) = parts.split_at(self.buffers.plan.n_nodes);
        carried.displacement_high = high.iter().map(wide).collect();
        carried.displacement_low = low.iter().map(wide).collect();
        let Scripted {
            displacement,
            velocity,
        } = &self.scripted;
        carried.scripted_displacement.clone_from(displacement);
        carried.scripted_velocity.clone_from(velocity);
        Ok(())
    }

    /// Takes that up, after the state.
    pub(super) fn take_up(&mut self, gpu: &Gpu, carried: &Carried) {
        self.max_speed = carried.max_speed[1];
        let parts = [&carried.displacement_high, &carried.displacement_low];
        let words = parts.into_iter().flatten();
        let words: Vec<[f32; 4]> = words
            .map(|&[x, y, z]| [x as f32, y as f32, z as f32, 0.0])
            .collect();
        gpu.upload(&self.buffers.displacement, &words);
        self.scripted = Scripted {
            displacement: carried.scripted_displacement.clone(),
            velocity: carried.scripted_velocity.clone(),
        };
    }

    /// Tells the kernels of a sub-step of dt (s) that begins at the time of a clock.
    pub(super) fn write_step(&mut self, gpu: &Gpu, scene: &Scene, clock: &State, dt: f64) {
        let step = self.buffers.step_of(scene.domain.gravity, dt);
        gpu.upload(&self.buffers.step, &[step]);
        let Scripted {
            displacement,
            velocity,
        } = &mut self.scripted;
        if displacement.is_empty() {
            return;
        }
        if clock.step == 0 {
            self.solids
                .start_scripts(displacement, velocity, f64::from(step.dt));
            if self.buffers.plan.real == Real::F32 {
                round_to_f32(velocity);
            }
            self.buffers.write_velocity(gpu, velocity);
        }
        // As `move_solid` will move them.
        for (u, v) in displacement.iter_mut().zip(velocity.iter()) {
            for (u, v) in u.iter_mut().zip(v) {
                *u += f64::from(step.dt) * v;
            }
        }
        *velocity = self
            .solids
            .prescribed_velocity(displacement, clock.time + dt, dt);
        round_to_f32(velocity);
        self.buffers.write_prescribed(gpu, velocity);
    }

    /// The preconditioner's polynomial for a sub-step of dt (s).
    pub(super) fn polynomial(&self, dt: f64) -> Polynomial {
        self.polynomial_for(|body| [body.zeta_mass(dt), body.zeta_stiffness(dt)])
    }

    /// The same for other zeta_M (1/s) and zeta_K (s) of each body.
    pub(super) fn polynomial_for(&self, zeta: impl Fn(&Body) -> [f64; 2]) -> Polynomial {
        let degree = self.bounds.chebyshev_degree_for(&self.solids, &zeta);
        let wanted = self.bounds.wanted_degree_for(&self.solids, zeta);
        Polynomial::new(degree, self.bounds.block_jacobi).wanting(wanted)
    }

    /// Tells the kernels of another system of this sub-step and records it, and with `again` its right-hand side, from the velocities found;
    /// what is held stays held.
    pub(super) fn record_other_system(
        &self,
        gpu: &Gpu,
        to: &mut Recorder,
        step: SolidStep,
        again: bool,
    ) {
        gpu.upload(&self.buffers.step, &[step]);
        let stages = &self.stages;
        to.stage("solve", |pass| {
            stages.rotations.record_in(pass);
            stages.system.record_matrices(pass);
            if again {
                stages.system.record_right_hand_side(pass);
            }
            stages.system.record_hold(pass);
        });
    }

    /// Keeps what the next sub-step needs of the report.
    pub(super) fn finish(
        &mut self,
        outcome: &Outcome,
        contact: ContactReport,
        report: fields::SolidReport,
    ) -> SolidReport {
        self.max_speed = report.diagnosis.max_speed;
        SolidReport {
            solve: solve_report(outcome),
            contact,
            diagnosis: report.diagnosis,
        }
    }

    /// Displacements of all nodes, m.
    pub(super) fn displacement(&self, gpu: &Gpu) -> Result<Vec<[f64; 3]>, Error> {
        let words = gpu.download(&self.buffers.displacement)?;
        Ok(self.buffers.displacement_of(&words))
    }

    /// Displacements of all nodes, m, for the probes. Nothing without probes of solids.
    pub(super) fn probed(&mut self, gpu: &Gpu) -> Result<Vec<[f64; 3]>, Error> {
        let Some(readback) = &mut self.probed else {
            return Ok(Vec::new());
        };
        let mut recorder = Recorder::new(gpu);
        recorder.read(&self.buffers.displacement, readback);
        recorder.submit();
        Ok(self.buffers.displacement_of(&readback.wait(gpu)?))
    }
}
