//! `bench stability`: what stays stable. Hostile scenes in strong coupling, the four variants of the thesis's section 6.3, and the limit
//! of added mass that weak coupling has in one dimension.
//!
//! The energy of a run is kinetic, elastic and potential, J: the liquid's by its markers, each of which carries the same share of the
//! mass, so that spray does not inflate it; potential energy counts from the corner of the domain where gravity would take everything.
//! Backward Euler and the projection only take energy away. What gives is the motion: markers fall with the velocities of before, and
//! gain g v dt / 2 per kg with v at most sqrt(2 g H) in a domain H high. A run whose energy exceeds 1.1 times that of its start and this
//! gain of its whole mass fails; so it does where energy of motion and strain exceeds what was there and what gravity can release, where a
//! node or a face is faster than falls make it (budget.rs), where it loses a tenth of its markers, where more than a hundredth of its sub-steps
//! miss a tolerance or leave contacts unsettled, where a value is not finite, and where the simulation errs.
//!
//! Volume is that of the union of the markers' spheres, which spray inflates; markers are mass.

mod budget;
mod cases;
mod limit;
mod picture;

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::Instant;

use glam::DVec3;
use serde::Serialize;

use crate::Error;
use crate::elastic::Solids;
use crate::gpu::Gpu;
use crate::output::FolderLock;
use crate::reference::diagnose_solid;
use crate::scene::Scene;
use crate::sim::{Backend, Simulation};
use crate::state::{SolidDiagnosis, SolidReport, SolveStatus, State, StepReport};

use super::table::{Host, Machine, remove_earlier, write_csv, write_json, write_svg};

use budget::{Budget, MOST_ENERGY, Moment};

pub use cases::{Case, Expected, cases};
pub use limit::{LimitRow, limits};

/// Of the markers that a run may lose.
const MOST_LOST: f64 = 0.1;
/// Where a run whose energy has no bound need not go on: the verdict and its size are clear.
const HOPELESS: f64 = 1e4;
/// Of the sub-steps that may miss a tolerance, and that may leave contacts unsettled.
const MOST_MISSED: f64 = 0.01;
/// Names of cases that an unknown one is told.
const NEAR: usize = 5;
/// Sub-steps in a row over which growth is told.
const GROWTH_STEPS: usize = 4;
/// Energy of a body over all energy of the start, from which on its growth counts. From nothing everything grows.
const GROWTH_FROM: f64 = 1e-3;

/// What to run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Sub-steps of each hostile scene; the thesis's variants have their own.
    pub steps: u64,
    /// Parts of names: cases of which none is in the name are left out. All cases where empty.
    pub cases: Vec<String>,
    /// Multiplies the cells of the thesis's scene.
    pub scale: f64,
    /// Where.
    pub backend: Backend,
}

impl Options {
    /// Whether a name is asked for.
    pub fn asks_for(&self, name: &str) -> bool {
        self.cases.is_empty() || self.cases.iter().any(|part| name.contains(part))
    }

    /// Refuses parts that are in none of the names.
    fn check(&self, names: &[String]) -> Result<(), Error> {
        let known = |part: &str| !part.is_empty() && names.iter().any(|name| name.contains(part));
        let Some(part) = self.cases.iter().find(|part| !known(part)) else {
            return Ok(());
        };
        // Of the whole name, and of the words that it is made of.
        let distance = |name: &str| {
            let words = name.split('_').chain([name]);
            let distances = words.map(|word| strsim::damerau_levenshtein(part, word));
            distances.min()
        };
        let mut near: Vec<&str> = names.iter().map(String::as_str).collect();
        near.sort_by_key(|name| distance(name));
        near.truncate(NEAR);
        let mut groups: Vec<&str> = names.iter().filter_map(|it| it.split('_').next()).collect();
        groups.dedup();
        Err(Error::input(
            format!("--cases {}", self.cases.join(",")),
            format!("no case has `{part}` in its name"),
            format!(
                "use parts of names; near are {}; names begin with {}",
                near.join(", "),
                groups.join(", ")
            ),
        ))
    }
}

/// A row of stability.csv.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the case.
    pub name: String,
    /// What cases beside it vary too.
    pub group: &'static str,
    /// What is hostile about it.
    pub varies: String,
    /// Where it ran: `gpu` or `cpu`, the f64 path.
    pub backend: &'static str,
    /// Cells of the domain.
    pub cells: usize,
    /// Nodes of the solids.
    pub nodes: usize,
    /// Sub-steps asked for.
    pub steps: u64,
    /// Sub-steps done.
    pub sub_steps: u64,
    /// What has to happen: `completes`, `fails`, `is pushed away` or `stays stiff`.
    pub expected: &'static str,
    /// `completed`, with sub-steps that missed a tolerance or left contacts unsettled, or what failed first, and in which sub-step.
    pub status: String,
    /// Whether what has to happen happened.
    pub passed: bool,
    /// Largest energy over that of the start.
    pub energy_ratio: f64,
    /// What it may be at most.
    pub energy_bound: f64,
    /// Energy after the last sub-step over that of the start.
    pub energy_end: f64,
    /// Largest elastic energy over all energy of the start.
    pub elastic_ratio: f64,
    /// Largest energy of motion and strain, kinetic and elastic, J.
    pub motion: f64,
    /// What it may be at most: what there was, and what gravity can release.
    pub motion_bound: f64,
    /// Largest component of a node's velocity, m/s.
    pub solid_speed: f64,
    /// What it may be at most.
    pub solid_speed_bound: f64,
    /// Largest velocity of a face, m/s.
    pub liquid_speed: f64,
    /// What it may be at most.
    pub liquid_speed_bound: f64,
    /// Values of the last state and its report that are not finite.
    pub non_finite: usize,
    /// Least volume of the liquid over that at the start.
    pub volume_least: f64,
    /// Largest.
    pub volume_most: f64,
    /// Volume at the end over that at the start, less 1.
    pub volume_drift: f64,
    /// Markers lost between surfaces that close on them, over those of the start: liquid that is gone, where the volume of the spheres
    /// also changes as they part.
    pub lost: f64,
    /// Least det F of all sub-steps.
    pub min_det: f64,
    /// Elements with a det F of 0 or less at the end.
    pub inverted: usize,
    /// Sub-steps with a solve that did not converge.
    pub missed: u64,
    /// Sub-steps with contacts that did not settle.
    pub unsettled: u64,
    /// Largest depth to which solids are in each other or in an obstacle, in cells: nothing holds solids off each other.
    pub overlap: f64,
    /// Most iterations of a solve; empty where all were direct.
    pub most_iterations: Option<u32>,
    /// Largest way of the end of the thesis's beam over its length; empty elsewhere.
    pub deflection: Option<f64>,
    /// Largest rise of it against gravity, over the beam's length.
    pub lift: Option<f64>,
    /// Largest mean growth of the beam's speed, the root of its energy, per sub-step over four of them, from a thousandth of all energy
    /// of the start on; empty where it has less.
    pub growth: Option<f64>,
    /// Wall-clock seconds, on the f64 path with other cases beside this one.
    pub seconds: f64,
}

/// Where the cases ran.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Place {
    /// On an adapter.
    Gpu(Machine),
    /// On the f64 path.
    Cpu(Host),
}

/// The tables and where they were measured.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// Where.
    #[serde(flatten)]
    pub place: Place,
    /// `gpu` or `cpu`.
    pub backend: &'static str,
    /// A row per case.
    pub rows: Vec<Row>,
    /// A row per column of liquid on a light piston.
    pub limits: Vec<LimitRow>,
}

impl Table {
    /// Names every failure.
    ///
    /// # Errors
    /// [`Error::Check`] where there is one.
    pub fn verdict(&self) -> Result<(), Error> {
        let of_cases = self.rows.iter().filter(|row| !row.passed);
        let of_cases = of_cases.map(|row| {
            let Row { name, expected, .. } = row;
            format!("\n  {name}: {} where it {expected}", row.status)
        });
        let of_limits = self.limits.iter().filter(|row| !row.passed);
        let of_limits = of_limits.map(|row| {
            let LimitRow { name, expected, .. } = row;
            format!("\n  {name}: a growth of {} for {expected}", row.got)
        });
        let failures: Vec<String> = of_cases.chain(of_limits).collect();
        if failures.is_empty() {
            return Ok(());
        }
        let all = self.rows.len() + self.limits.len();
        let n = failures.len();
        Err(Error::Check(format!(
            "{n} of {all} cases{}",
            failures.concat()
        )))
    }
}

/// What is told while the bench runs.
#[derive(Clone, Copy, Debug)]
pub enum Told<'a> {
    /// A case has run.
    Case(&'a Row),
    /// A column has run.
    Limit(&'a LimitRow),
}

/// Runs all that is asked for and writes stability.csv, stability_limit.csv, stability.json and stability.svg into `out`, anew after
/// each row, and the scenes of the matrix, for `cutwater run`, into `out`/scenes; `tell` hears of each row as it comes. Cases that fail are
/// rows like others: [`Table::verdict`] is for afterwards.
///
/// # Errors
/// [`Error::Input`] where a part is in the name of no case, [`Error::Adapter`], [`Error::Output`].
pub fn bench_stability(
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(Told),
) -> Result<Table, Error> {
    let mut cases = cases(options.steps, options.scale);
    let limits = limits();
    let of_limits = limits.iter().map(|limit| limit.name());
    let names: Vec<String> = cases.iter().map(|case| case.name.clone()).collect();
    options.check(&of_limits.chain(names).collect::<Vec<_>>())?;
    let _held = FolderLock::take(out)?;
    let scenes = out.join("scenes");
    fs::create_dir_all(&scenes).map_err(|problem| Error::unwritten(&scenes, &problem))?;
    remove_earlier(out, &["stability_limit.csv"])?;
    let place = match &options.backend {
        Backend::Gpu(choice) => Place::Gpu(Machine::new(&Gpu::new(choice)?, 3)?),
        Backend::Cpu => Place::Cpu(Host::now()),
    };
    let mut table = Table {
        place,
        backend: options.backend.name(),
        rows: Vec::new(),
        limits: Vec::new(),
    };
    for limit in limits {
        if options.asks_for(&limit.name()) {
            let row = limit.run(&options.backend)?;
            tell(Told::Limit(&row));
            table.limits.push(row);
            write(&table, out)?;
        }
    }
    for row in limit::of_step_lengths(&table.limits) {
        tell(Told::Limit(&row));
        table.limits.push(row);
    }
    write(&table, out)?;
    cases.retain(|case| options.asks_for(&case.name));
    for case in &cases {
        case.write(&scenes)?;
    }
    let mut rows = vec![None; cases.len()];
    run_all(&cases, &options.backend, |at, row| {
        tell(Told::Case(&row));
        rows[at] = Some(row);
        table.rows = rows.iter().flatten().cloned().collect();
        write(&table, out)
    })?;
    Ok(table)
}

/// Runs cases and hands on their rows with their places among them, as they come. The f64 path leaves most of a sub-step to one processor, so
/// there one runs for each of rayon's threads. An error is told once what runs has ended.
fn run_all(
    cases: &[Case],
    backend: &Backend,
    mut take: impl FnMut(usize, Row) -> Result<(), Error>,
) -> Result<(), Error> {
    let at_a_time = match backend {
        Backend::Gpu(_) => 1,
        Backend::Cpu => rayon::current_num_threads().min(cases.len()),
    };
    let next = AtomicUsize::new(0);
    let (to, rows) = mpsc::channel();
    thread::scope(|scope| {
        for _ in 0..at_a_time {
            let (to, next) = (to.clone(), &next);
            scope.spawn(move || {
                loop {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    let Some(case) = cases.get(at) else { break };
                    // Nobody listens any more after an error.
                    if to.send((at, case.run(backend))).is_err() {
                        break;
                    }
                }
            });
        }
        drop(to);
        rows.into_iter().try_for_each(|(at, row)| take(at, row?))
    })
}

/// Writes the tables and the picture as they are so far.
fn write(table: &Table, out: &Path) -> Result<(), Error> {
    write_csv(&table.rows, &out.join("stability.csv"))?;
    write_csv(&table.limits, &out.join("stability_limit.csv"))?;
    write_json(table, &out.join("stability.json"))?;
    let size = picture::size(table);
    write_svg(&out.join("stability.svg"), size, |page| {
        picture::draw(table, page)
    })
}

/// A run as it goes.
struct Run {
    scene: Scene,
    simulation: Simulation,
    markers: usize,
    budget: Budget,
    longest_dt: f64,
    /// Of the solids after each sub-step, over all energy of the start.
    energies: Vec<f64>,
}

impl Run {
    fn new(scene: Scene, backend: &Backend) -> Result<Run, Error> {
        let simulation = Simulation::new(&scene, backend)?;
        let state = simulation.state()?;
        let solids = simulation.solids();
        let diagnosis = told_of(solids, &state, scene.domain.gravity);
        Ok(Run {
            markers: state.markers.len(),
            budget: Budget::new(&scene, solids, &state, &diagnosis),
            longest_dt: 0.0,
            energies: Vec::new(),
            scene,
            simulation,
        })
    }
}

/// Largest mean growth of a speed per sub-step within [`GROWTH_STEPS`], by energies that are at least [`GROWTH_FROM`] before.
fn growth(energies: &[f64]) -> Option<f64> {
    let of = |at: usize| {
        let later = energies[at + 1..].iter().take(GROWTH_STEPS);
        let most = later.copied().reduce(f64::max)?;
        let grown = most / energies[at];
        (energies[at] >= GROWTH_FROM).then(|| grown.powf(0.5 / GROWTH_STEPS as f64))
    };
    (0..energies.len()).filter_map(of).reduce(f64::max)
}

/// What a state of the solids amounts to.
fn told_of(solids: &Solids, state: &State, gravity: DVec3) -> SolidDiagnosis {
    let elements = 0..solids.elements.len();
    let deformations: Vec<_> = elements
        .map(|element| solids.deformation(element, &state.displacement))
        .collect();
    let (u, v) = (&state.displacement, &state.node_velocity);
    diagnose_solid(solids, &deformations, u, v, gravity)
}

/// Values that are not finite.
fn non_finite(state: &State, report: &StepReport) -> usize {
    let faces = state.velocity.iter().flatten();
    let nodes = [&state.markers, &state.displacement, &state.node_velocity];
    let nodes = nodes.into_iter().flat_map(|list| list.as_flattened());
    let cells = state.pressure.iter().chain(&state.liquid_distance);
    let of_state = faces.chain(nodes).chain(cells);
    let of_liquid = report.liquid.map(|liquid| {
        let it = liquid.diagnosis;
        [it.volume, it.kinetic_energy, it.max_speed, it.divergence]
    });
    let of_solids = report.solid.map(|solid| {
        let it = solid.diagnosis;
        [
            it.kinetic_energy,
            it.elastic_energy,
            it.max_speed,
            it.min_det,
        ]
    });
    let of_report = of_liquid.into_iter().chain(of_solids).flatten();
    let bad = |value: &&f64| !value.is_finite();
    of_state.filter(bad).count() + of_report.filter(|value| !value.is_finite()).count()
}

impl Case {
    /// Runs it. What fails is told in the row.
    ///
    /// # Errors
    /// [`Error::Adapter`].
    pub fn run(&self, backend: &Backend) -> Result<Row, Error> {
        let clock = Instant::now();
        let mut row = self.row(backend);
        let started = self.scene().and_then(|scene| Run::new(scene, backend));
        match started {
            Ok(mut run) => {
                if let Err(error) = go(&mut run, &mut row) {
                    row.fail(error.to_string());
                }
            }
            // Nothing can run then.
            Err(error @ Error::Adapter { .. }) => return Err(error),
            Err(error) => row.fail(format!("does not start: {error}")),
        }
        row.name_misses();
        row.seconds = clock.elapsed().as_secs_f64();
        row.passed = self.expected.holds(&row);
        Ok(row)
    }

    /// Its row before the first sub-step.
    fn row(&self, backend: &Backend) -> Row {
        Row {
            name: self.name.clone(),
            group: self.group,
            varies: self.varies.clone(),
            backend: backend.name(),
            cells: 0,
            nodes: 0,
            steps: self.steps,
            sub_steps: 0,
            expected: self.expected.name(),
            status: COMPLETED.to_owned(),
            passed: false,
            energy_ratio: 1.0,
            energy_bound: MOST_ENERGY,
            energy_end: 1.0,
            elastic_ratio: 0.0,
            motion: 0.0,
            motion_bound: 0.0,
            solid_speed: 0.0,
            solid_speed_bound: 0.0,
            liquid_speed: 0.0,
            liquid_speed_bound: 0.0,
            non_finite: 0,
            volume_least: 1.0,
            volume_most: 1.0,
            volume_drift: 0.0,
            lost: 0.0,
            min_det: 1.0,
            inverted: 0,
            missed: 0,
            unsettled: 0,
            overlap: 0.0,
            most_iterations: None,
            deflection: None,
            lift: None,
            growth: None,
            seconds: 0.0,
        }
    }
}

/// What the status of a run without a failure begins with.
const COMPLETED: &str = "completed";

impl Row {
    /// Whether nothing failed.
    pub fn completed(&self) -> bool {
        self.status.starts_with(COMPLETED)
    }

    /// The first failure counts.
    fn fail(&mut self, what: String) {
        if self.completed() {
            self.status = what;
        }
    }

    /// Counts a sub-step with solves that missed a tolerance, and one with contacts that did not settle.
    fn count(&mut self, missed: bool, unsettled: bool) {
        self.missed += u64::from(missed);
        self.unsettled += u64::from(unsettled);
        // One in any run.
        let most = (MOST_MISSED * self.steps as f64).ceil() as u64;
        let (at, percent) = (self.sub_steps.saturating_sub(1), 100.0 * MOST_MISSED);
        if self.missed > most {
            self.fail(format!(
                "step {at}: more than {percent} % of the sub-steps missed their tolerance"
            ));
        }
        if self.unsettled > most {
            self.fail(format!(
                "step {at}: more than {percent} % of the sub-steps with contacts that did not settle"
            ));
        }
    }

    /// A run that completes with them is not like one without.
    fn name_misses(&mut self) {
        if !self.completed() {
            return;
        }
        let sub_steps = |n: u64| match n {
            1 => "1 sub-step".to_owned(),
            _ => format!("{n} sub-steps"),
        };
        let mut status = COMPLETED.to_owned();
        if self.missed > 0 {
            status += &format!(", {} missed a tolerance", sub_steps(self.missed));
        }
        if self.unsettled > 0 {
            let n = sub_steps(self.unsettled);
            status += &format!(", {n} with contacts that did not settle");
        }
        self.status = status;
    }

    /// Judges what the last sub-step came to, in a run with sub-steps of up to `dt` s.
    fn judge(&mut self, moment: &Moment, budget: &Budget, dt: f64) {
        let ratio = moment.energy() / budget.energy;
        self.energy_ratio = self.energy_ratio.max(ratio);
        self.energy_end = ratio;
        self.elastic_ratio = self.elastic_ratio.max(moment.elastic / budget.energy);
        self.motion = self.motion.max(moment.motion());
        self.solid_speed = self.solid_speed.max(moment.solid_speed);
        self.liquid_speed = self.liquid_speed.max(moment.liquid_speed);
        self.energy_bound = budget.energy_bound(dt);
        self.motion_bound = budget.motion_bound(dt);
        self.solid_speed_bound = budget.solid_speed_bound(dt);
        self.liquid_speed_bound = budget.liquid_speed_bound(dt);
        let at = self.sub_steps.saturating_sub(1);
        if ratio > self.energy_bound {
            self.fail(format!(
                "step {at}: energy above its bound, {ratio:.2} times that of the start"
            ));
        }
        for (what, value, most, unit) in [
            (
                "energy of motion and strain",
                moment.motion(),
                self.motion_bound,
                "J",
            ),
            (
                "speed of a node",
                moment.solid_speed,
                self.solid_speed_bound,
                "m/s",
            ),
            (
                "speed of the liquid",
                moment.liquid_speed,
                self.liquid_speed_bound,
                "m/s",
            ),
        ] {
            if value > most {
                self.fail(format!(
                    "step {at}: {what} above its bound, {value:.3} {unit} where {most:.3} are the most"
                ));
            }
        }
    }
}

fn go(run: &mut Run, row: &mut Row) -> Result<(), Error> {
    row.cells = run.scene.grid().n_cells();
    row.nodes = run.simulation.solids().rest.len();
    while row.sub_steps < row.steps {
        let report = run.simulation.step()?;
        let state = run.simulation.state()?;
        let at = row.sub_steps;
        row.sub_steps += 1;
        run.longest_dt = run.longest_dt.max(report.dt);
        if let Some(volume) = run.simulation.volume_ratio(&report) {
            row.volume_least = row.volume_least.min(volume);
            row.volume_most = row.volume_most.max(volume);
            row.volume_drift = volume - 1.0;
        }
        row.lost = state.markers_dropped as f64 / run.markers.max(1) as f64;
        if row.lost > MOST_LOST {
            let lost = 100.0 * MOST_LOST;
            row.fail(format!("step {at}: more than {lost} % of the markers lost"));
        }
        let solves = || report.solves();
        let missed = solves().any(|solve| solve.status != SolveStatus::Converged);
        let unsettled = |solid: SolidReport| solid.contact.unsettled > 0;
        row.count(missed, report.solid.is_some_and(unsettled));
        if let Some(coupling) = report.coupling {
            let cells = coupling.overlap_depth / run.scene.grid().dx;
            row.overlap = row.overlap.max(cells);
        }
        let iterations = solves().map(|solve| solve.iterations);
        let most = iterations.filter(|&iterations| iterations > 0).max();
        row.most_iterations = row.most_iterations.max(most);
        row.non_finite = non_finite(&state, &report);
        if row.non_finite > 0 {
            row.fail(format!(
                "step {at}: {} values are not finite",
                row.non_finite
            ));
            return Ok(());
        }
        if !run.scene.probes.is_empty() {
            let tip = DVec3::from_slice(&run.simulation.probes()?[..3]);
            let most = |of: Option<f64>, now: f64| Some(of.unwrap_or(0.0).max(now / cases::BEAM));
            row.deflection = most(row.deflection, tip.length());
            let up = -run.scene.domain.gravity.normalize_or_zero();
            row.lift = most(row.lift, tip.dot(up));
        }
        if let Some(solid) = report.solid {
            let diagnosis = solid.diagnosis;
            row.min_det = row.min_det.min(diagnosis.min_det);
            row.inverted = diagnosis.inverted;
            let of_liquid = report.liquid.map_or(0.0, |it| it.diagnosis.max_speed);
            let moment = run.budget.moment(&state, &diagnosis, of_liquid);
            row.judge(&moment, &run.budget, run.longest_dt);
            run.energies.push(moment.solids() / run.budget.energy);
            if row.deflection.is_some() {
                row.growth = growth(&run.energies);
            }
            if row.energy_end > HOPELESS {
                return Ok(());
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 1.0 / 24.0;

    fn case(name: &str) -> Case {
        let mut cases = cases(2000, 1.0).into_iter();
        cases.find(|case| case.name == name).unwrap()
    }

    /// The row of a case whose nodes have moved by `way` m, and so many of which move at `speed` m/s, upwards.
    fn moved(name: &str, nodes: usize, way: f64, speed: f64) -> Row {
        let case = case(name);
        let run = Run::new(case.scene().unwrap(), &Backend::Cpu).unwrap();
        let mut state = run.simulation.state().unwrap();
        for displacement in &mut state.displacement {
            displacement[1] += way;
        }
        for velocity in state.node_velocity.iter_mut().take(nodes) {
            velocity[1] += speed;
        }
        let gravity = run.scene.domain.gravity;
        let diagnosis = told_of(run.simulation.solids(), &state, gravity);
        let moment = run.budget.moment(&state, &diagnosis, 0.0);
        let mut row = case.row(&Backend::Cpu);
        row.judge(&moment, &run.budget, DT);
        row
    }

    /// A block of 16 g: at 100 m/s it has 78 J, a tenth of what the pool has by lying there.
    #[test]
    fn a_light_solid_that_is_thrown_is_told_from_the_pool_at_rest() {
        let row = moved("density_1e-3", usize::MAX, 0.0, 100.0);
        assert!(!row.completed(), "{row:?}");
        assert!(row.energy_ratio < row.energy_bound, "{row:?}");
        assert!((70.0..90.0).contains(&row.motion), "{row:?}");
        assert!(row.motion > 1.5 * row.motion_bound, "{row:?}");
        assert!(row.solid_speed > 5.0 * row.solid_speed_bound, "{row:?}");
        // A node alone has next to no energy.
        let row = moved("density_1e-3", 1, 0.0, 100.0);
        assert!(row.status.contains("speed of a node"), "{row:?}");
        assert!(row.energy_ratio < row.energy_bound && row.motion < row.motion_bound);
    }

    /// From where it is to the floor, 0.295 m.
    #[test]
    fn a_solid_that_falls_is_within_its_bounds_and_one_that_is_twice_as_fast_is_not() {
        let fall = (2.0 * 9.81 * 0.295_f64).sqrt();
        for name in ["density_1e-3", "density_1", "density_10"] {
            let row = moved(name, usize::MAX, -0.295, -fall);
            assert!(row.completed(), "{row:?}");
            assert!((row.energy_ratio - 1.0).abs() < 1e-9, "{row:?}");
            assert!((row.solid_speed - fall).abs() < 1e-12, "{row:?}");
        }
        // Of 16 kg, which the energy of the pool hides.
        let row = moved("density_1", usize::MAX, -0.295, -2.0 * fall);
        assert!(row.status.contains("energy of motion"), "{row:?}");
        assert!(row.energy_ratio < row.energy_bound, "{row:?}");
        // From the top of the domain to its floor without anything in the way.
        let row = moved("empty_never", usize::MAX, 0.0, -(2.0 * 9.81_f64).sqrt());
        assert!(row.solid_speed < 0.5 * row.solid_speed_bound, "{row:?}");
    }

    #[test]
    fn every_start_is_within_its_bounds() {
        for case in cases(1, 0.4) {
            let run = Run::new(case.scene().unwrap(), &Backend::Cpu).unwrap();
            let state = run.simulation.state().unwrap();
            let gravity = run.scene.domain.gravity;
            let diagnosis = told_of(run.simulation.solids(), &state, gravity);
            let speed = crate::reference::max_speed(&state.velocity);
            let moment = run.budget.moment(&state, &diagnosis, speed);
            let mut row = case.row(&Backend::Cpu);
            row.judge(&moment, &run.budget, DT);
            assert!(row.completed() && row.motion_bound > 0.0, "{row:?}");
            let bounds = [
                row.energy_bound,
                row.motion_bound,
                row.solid_speed_bound,
                row.liquid_speed_bound,
            ];
            assert!(bounds.iter().all(|bound| bound.is_finite()), "{row:?}");
            assert_eq!(state.markers.is_empty(), case.name == "empty_never");
        }
    }

    #[test]
    fn growth_is_the_mean_of_four_sub_steps_and_does_not_count_from_nothing() {
        assert_eq!(growth(&[0.0, 1e-9, 1e-6, 9e-4]), None);
        assert_eq!(growth(&[2e-3; 9]), Some(1.0));
        // Speeds double in each.
        let doubling: Vec<f64> = (0..9).map(|at| 1e-2 * 4f64.powi(at)).collect();
        assert!((growth(&doubling).unwrap() - 2.0).abs() < 1e-12);
        // What is over before four sub-steps are is spread over four.
        let ended = growth(&[1e-3, 0.256]).unwrap();
        assert!((ended - 2.0).abs() < 1e-12, "{ended}");
        assert!(growth(&[1.0, 0.1, 0.01]).unwrap() < 1.0);
    }

    #[test]
    fn sub_steps_that_miss_are_named_and_more_than_a_hundredth_fail() {
        let mut row = case("young_1e9").row(&Backend::Cpu);
        row.count(false, false);
        row.name_misses();
        assert_eq!(row.status, "completed");
        row.count(true, true);
        (0..19).for_each(|_| row.count(true, false));
        row.name_misses();
        let named = "completed, 20 sub-steps missed a tolerance, 1 sub-step with contacts that did not settle";
        assert_eq!(row.status, named);
        assert!(Expected::Completes.holds(&row));
        row.count(true, false);
        row.name_misses();
        assert!(!row.completed() && row.status.contains("missed"), "{row:?}");
        assert!(!Expected::Completes.holds(&row));
        let mut row = case("young_1e9").row(&Backend::Cpu);
        (0..21).for_each(|_| row.count(false, true));
        assert!(!row.completed() && row.status.contains("settle"), "{row:?}");
    }

    #[test]
    fn the_map_shows_a_case_that_passes_with_sub_steps_that_miss() {
        let folder = tempfile::tempdir().unwrap();
        let map = |missed: u64| {
            let mut row = case("young_1e9").row(&Backend::Cpu);
            (row.missed, row.passed) = (missed, true);
            row.name_misses();
            let table = Table {
                place: Place::Cpu(Host::now()),
                backend: "cpu",
                rows: vec![row],
                limits: Vec::new(),
            };
            write(&table, folder.path()).unwrap();
            fs::read_to_string(folder.path().join("stability.svg")).unwrap()
        };
        for (missed, shown) in [(0, false), (1, true)] {
            let map = map(missed);
            for what in ["1 sub-step missed a tolerance", "yellow", "#E6A014"] {
                assert_eq!(map.contains(what), shown, "{what}: {map}");
            }
            // What is hostile about it stands where there is nothing else to say.
            assert_eq!(map.contains("block of E = 1e9 Pa"), !shown, "{map}");
        }
    }

    #[test]
    fn the_wrong_buoyancy_pushes_upwards_and_an_instability_grows() {
        let mut row = case("thesis_damping_only").row(&Backend::Cpu);
        let holds = |row: &Row, way: f64, lift: f64| {
            let mut row = row.clone();
            (row.deflection, row.lift) = (Some(way), Some(lift));
            [Expected::PushedAway, Expected::StaysStiff].map(|expected| expected.holds(&row))
        };
        assert_eq!(holds(&row, 0.28, 0.05), [true, false]);
        // Aside, or down, is not where buoyancy pushes.
        assert_eq!(holds(&row, 0.28, 0.0), [false, false]);
        assert_eq!(holds(&row, 0.06, 0.003), [false, true]);
        assert_eq!(holds(&row, 0.06, 0.03), [false, false]);
        row.fail("step 3: energy above its bound".to_owned());
        assert_eq!(holds(&row, 0.28, 0.05), [false, false]);
        (row.growth, row.elastic_ratio) = (Some(2.0), 8.0);
        assert!(Expected::Fails.holds(&row));
        row.growth = Some(1.1);
        assert!(!Expected::Fails.holds(&row));
        (row.growth, row.elastic_ratio) = (Some(2.0), 0.2);
        assert!(!Expected::Fails.holds(&row));
    }

    #[test]
    fn parts_of_names_that_no_case_has_are_told_with_those_near() {
        let names: Vec<String> = cases(1, 1.0).into_iter().map(|case| case.name).collect();
        let check = |parts: &[&str]| {
            let options = Options {
                steps: 1,
                cases: parts.iter().map(|&part| part.to_owned()).collect(),
                scale: 1.0,
                backend: Backend::Cpu,
            };
            options.check(&names)
        };
        assert!(check(&[]).is_ok() && check(&["gap", "thesis_strong"]).is_ok());
        let error = check(&["gap", "young_1e8"]).unwrap_err().to_string();
        for near in ["`young_1e8`", "young_1e7", "young_1e9", "density"] {
            assert!(error.contains(near), "{error}");
        }
        assert!(check(&["gap", ""]).is_err());
    }
}
