//! `bench stability`: what stays stable. Hostile scenes in strong coupling, the four variants of the thesis's section 6.3, and the limit
//! of added mass that weak coupling has in one dimension.
//!
//! The energy of a run is kinetic, elastic and potential, J: the liquid's by its markers, each of which carries the same share of the
//! mass, so that spray does not inflate it; potential energy counts from the corner of the domain where gravity would take everything.
//! Backward Euler and the projection only take energy away. What gives is the motion: markers fall with the velocities of before, and
//! gain g v dt / 2 per kg with v at most sqrt(2 g H) in a domain H high. A run whose energy exceeds 1.1 times that of its start and this
//! gain of its whole mass fails; so it does where it loses a tenth of its markers, where a value is not finite, and where the simulation
//! errs.
//!
//! Volume is that of the union of the markers' spheres, which spray inflates; markers are mass.

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
use crate::reference::diagnose_solid;
use crate::scene::Scene;
use crate::sim::{Backend, Simulation};
use crate::state::{SolidDiagnosis, SolveStatus, State, StepReport};

use super::table::{Host, Machine, remove_earlier, write_csv, write_json, write_svg};

pub use cases::{Case, Expected, cases};
pub use limit::{LimitRow, limits};

/// What the energy may come to over that of the start, beside what falling gains: a tenth for what the sums themselves are off.
const MOST_ENERGY: f64 = 1.1;
/// Of the markers that a run may lose.
const MOST_LOST: f64 = 0.1;
/// Where a run whose energy has no bound need not go on: the verdict and its size are clear.
const HOPELESS: f64 = 1e4;
/// Of its length that the stiff beam of the thesis may bend.
const STIFF: f64 = 0.1;
/// Of its length that the wrong buoyancy pushes it away.
const PUSHED_AWAY: f64 = 0.2;
/// What "extreme distortion" is at least: elastic energy over all energy of the start. Not det F, which bending and shear leave as it is.
const TORN: f64 = 10.0;
/// Of its length that a torn beam is bent, besides.
const BENT: f64 = 0.5;

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
    /// Cells of the domain.
    pub cells: usize,
    /// Nodes of the solids.
    pub nodes: usize,
    /// Sub-steps asked for.
    pub steps: u64,
    /// Sub-steps done.
    pub sub_steps: u64,
    /// What has to happen: `completes`, `fails`, `pushed away` or `stays stiff`.
    pub expected: &'static str,
    /// `completed`, or what failed first, and in which sub-step.
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
    /// Most iterations of a solve; empty where all were direct.
    pub most_iterations: Option<u32>,
    /// Largest way of the end of the thesis's beam over its length; empty elsewhere.
    pub deflection: Option<f64>,
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
/// [`Error::Input`] where no case has such a name, [`Error::Adapter`], [`Error::Output`].
pub fn bench_stability(
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(Told),
) -> Result<Table, Error> {
    let scenes = out.join("scenes");
    fs::create_dir_all(&scenes).map_err(|problem| Error::output(&scenes, problem))?;
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
    for limit in limits() {
        if options.asks_for(&limit.name()) {
            let row = limit.run(&options.backend)?;
            tell(Told::Limit(&row));
            table.limits.push(row);
            write(&table, out)?;
        }
    }
    let mut cases = cases(options.steps, options.scale);
    let names: Vec<String> = cases.iter().map(|case| case.name.clone()).collect();
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
    if table.rows.is_empty() && table.limits.is_empty() {
        return Err(Error::input(
            format!("--cases {}", options.cases.join(",")),
            "no case has that in its name",
            format!("use parts of limit, {}", names.join(", ")),
        ));
    }
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
    /// Mass of a marker, kg.
    marker: f64,
    markers: usize,
    /// Potential energy of a kg where gravity would take it, J.
    lowest: f64,
    /// At the start, J.
    energy: f64,
    /// Of liquid and solids, kg.
    mass: f64,
    longest_dt: f64,
}

impl Run {
    fn new(scene: Scene, backend: &Backend) -> Result<Run, Error> {
        let simulation = Simulation::new(&scene, backend)?;
        let state = simulation.state()?;
        let liquid = scene
            .liquid
            .as_ref()
            .map_or(0.0, |liquid| liquid.density * state.volume_0);
        let markers = state.markers.len();
        let (gravity, size) = (scene.domain.gravity, scene.domain.size);
        // Of the corners of the domain.
        let lowest = -(gravity * size).max(DVec3::ZERO).element_sum();
        let mut run = Run {
            marker: liquid / markers.max(1) as f64,
            markers,
            lowest,
            energy: 0.0,
            mass: liquid + simulation.solids().mass.iter().sum::<f64>(),
            longest_dt: 0.0,
            scene,
            simulation,
        };
        let solids = at_start(run.simulation.solids(), &state, gravity);
        run.energy = run.energy_of(&state, &solids);
        Ok(run)
    }

    /// Kinetic, elastic and potential energy, J.
    fn energy_of(&self, state: &State, solids: &SolidDiagnosis) -> f64 {
        let (grid, gravity) = (self.scene.grid(), self.scene.domain.gravity);
        let of_marker = |&x: &[f64; 3]| {
            let x = DVec3::from(x);
            let u = grid.velocity_at(&state.velocity, x);
            0.5 * u.length_squared() - gravity.dot(x) - self.lowest
        };
        let liquid = state.markers.iter().map(of_marker).sum::<f64>();
        let mass = self.simulation.solids().mass.iter().sum::<f64>();
        self.marker * liquid + solids.kinetic_energy + solids.elastic_energy - mass * self.lowest
            + solids.potential_energy
    }

    /// What the energy may be at most, over that of the start.
    fn bound(&self) -> f64 {
        let gravity = self.scene.domain.gravity;
        let (g, height) = (
            gravity.length(),
            gravity
                .normalize_or_zero()
                .abs()
                .dot(self.scene.domain.size),
        );
        let gained = 0.5 * self.mass * g * (2.0 * g * height).sqrt() * self.longest_dt;
        MOST_ENERGY + gained / self.energy
    }
}

/// The solids before the first sub-step.
fn at_start(solids: &Solids, state: &State, gravity: DVec3) -> SolidDiagnosis {
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
        let mut row = Row {
            name: self.name.clone(),
            group: self.group,
            varies: self.varies.clone(),
            cells: 0,
            nodes: 0,
            steps: self.steps,
            sub_steps: 0,
            expected: self.expected.name(),
            status: "completed".to_owned(),
            passed: false,
            energy_ratio: 1.0,
            energy_bound: MOST_ENERGY,
            energy_end: 1.0,
            elastic_ratio: 0.0,
            non_finite: 0,
            volume_least: 1.0,
            volume_most: 1.0,
            volume_drift: 0.0,
            lost: 0.0,
            min_det: 1.0,
            inverted: 0,
            missed: 0,
            unsettled: 0,
            most_iterations: None,
            deflection: None,
            seconds: 0.0,
        };
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
        row.seconds = clock.elapsed().as_secs_f64();
        row.passed = self.expected.holds(&row);
        Ok(row)
    }
}

impl Row {
    fn completed(&self) -> bool {
        self.status == "completed"
    }

    /// The first failure counts.
    fn fail(&mut self, what: String) {
        if self.completed() {
            self.status = what;
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
        row.missed += u64::from(solves().any(|solve| solve.status != SolveStatus::Converged));
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
            let away = tip.length() / cases::BEAM;
            row.deflection = Some(row.deflection.unwrap_or(0.0).max(away));
        }
        if let Some(solid) = report.solid {
            row.min_det = row.min_det.min(solid.diagnosis.min_det);
            row.inverted = solid.diagnosis.inverted;
            row.unsettled += u64::from(solid.contact.unsettled > 0);
            let ratio = run.energy_of(&state, &solid.diagnosis) / run.energy;
            row.energy_ratio = row.energy_ratio.max(ratio);
            row.energy_end = ratio;
            let elastic = solid.diagnosis.elastic_energy / run.energy;
            row.elastic_ratio = row.elastic_ratio.max(elastic);
            row.energy_bound = run.bound();
            if ratio > row.energy_bound {
                row.fail(format!(
                    "step {at}: energy above its bound, {ratio:.2} times that of the start"
                ));
            }
            if ratio > HOPELESS {
                return Ok(());
            }
        }
    }
    Ok(())
}
