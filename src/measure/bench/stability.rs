//! `bench stability`: hostile scenes in strong coupling, and the variants of the thesis's section 6.3.
//!
//! The energy of a run, J, is kinetic, elastic and potential, by the diagnostics of each sub-step. Potential energy counts from the lowest corner of
//! the domain. Backward Euler and the projection only dissipate. The advection adds g v dt / 2 per kg (`budget`).
//!
//! A run fails if an energy or a speed exceeds its bound (`budget`), if a tenth of the liquid is lost, if more than a hundredth of the sub-steps miss a
//! tolerance or leave contacts unsettled, if a value is not finite, or if the simulation fails.

mod budget;
mod cases;

use std::fs;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::Instant;

use glam::DVec3;

use super::chart::{Bars, Page};
use super::table::{Row, Table, columns, row};
use super::{Bench, Listener, Machine, Results, Run, Settings};
use crate::Error;
use crate::elastic::Solids;
use crate::gpu::Gpu;
use crate::reference::{diagnose_liquid, diagnose_solid};
use crate::scene::Scene;
use crate::sim::{Backend, Simulation};
use crate::state::{Exchange, SolidDiagnosis, SolveStatus, State, StepReport};

pub use budget::{Budget, MOST_ENERGY, Moment};
pub use cases::{Case, Expected, cases};

/// Share of the liquid that a run may lose.
const MOST_LOST: f64 = 0.1;
/// Sub-steps after which missing liquid is lost: [`crate::reference::volume_shift`] can move a surface by a cell in so many.
const LOST_STEPS: usize = 25;
/// Energy ratio above which a run stops: verdict and order of magnitude are clear.
const HOPELESS: f64 = 1e4;
/// Share of the sub-steps that may miss a tolerance, and that may leave contacts unsettled.
const MOST_MISSED: f64 = 0.01;
/// Sub-steps that growth is averaged over.
const GROWTH_STEPS: usize = 4;
/// Least energy of a body, over all energy of the start, whose growth counts.
const GROWTH_FROM: f64 = 1e-3;
/// Status of a run without a failure.
const COMPLETED: &str = "completed";

/// Cases to run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Sub-steps of each hostile scene; the thesis's variants have their own.
    pub steps: u64,
    /// Parts of names of the selected cases; empty for all cases.
    pub cases: Vec<String>,
    /// Factor of the cells of the thesis's scene.
    pub scale: f64,
    /// Backend.
    pub backend: Backend,
}

impl Options {
    fn selects(&self, name: &str) -> bool {
        self.cases.is_empty() || self.cases.iter().any(|part| name.contains(part))
    }

    /// Refuses parts that no name contains.
    ///
    /// # Errors
    /// [`Error::Input`] with similar names.
    pub fn check(&self, names: &[String]) -> Result<(), Error> {
        let known = |part: &str| !part.is_empty() && names.iter().any(|name| name.contains(part));
        let Some(part) = self.cases.iter().find(|part| !known(part)) else { return Ok(()) };
        // Distance to the whole name and to its words.
        let distance =
            |name: &&str| name.split('_').chain([*name]).map(|word| strsim::damerau_levenshtein(part, word)).min();
        let mut near: Vec<&str> = names.iter().map(String::as_str).collect();
        near.sort_by_key(distance);
        near.truncate(5);
        let mut groups: Vec<&str> = names.iter().filter_map(|it| it.split('_').next()).collect();
        groups.dedup();
        Err(Error::input(
            format!("--cases {}", self.cases.join(",")),
            format!("no case has `{part}` in its name"),
            format!("use parts of names; near are {}; names begin with {}", near.join(", "), groups.join(", ")),
        ))
    }
}

columns! {
    STABILITY {
        + passed "" "whether the expected behaviour was found";
        + name "" "name of the case";
        - group "" "cases that vary the same";
        - varies "" "what is hostile about it";
        - backend "" "`gpu` or `cpu`";
        - cells "" "cells of the domain";
        - nodes "" "nodes of the solids";
        - steps "" "sub-steps asked for";
        + sub_steps "" "sub-steps done";
        - expected "" "`completes`, `fails`, `is pushed away` or `stays stiff`";
        + status "" "`completed`, or the first failure and its sub-step";
        + energy_ratio "" "largest energy over that of the start";
        - energy_bound "" "its bound";
        - energy_end "" "energy at the end over that of the start";
        - elastic_ratio "" "largest elastic energy over all energy of the start";
        + motion "J" "largest kinetic and elastic energy";
        - motion_bound "J" "energy of the start and what gravity can release";
        + solid_speed "m/s" "largest component of a node's velocity";
        - solid_speed_bound "m/s" "its bound";
        + liquid_speed "m/s" "largest velocity of a face";
        - liquid_speed_bound "m/s" "its bound";
        - non_finite "" "values that are not finite";
        - volume_least, volume_most "" "least and largest volume of the liquid over that of the start";
        - volume_drift "" "volume at the end over that of the start, less 1";
        - lost "" "largest volume missing for 25 sub-steps over that of the start";
        + min_det "" "least det F";
        - inverted "" "elements with det F <= 0 at the end";
        + missed "" "sub-steps with a solve that did not converge";
        - unsettled "" "sub-steps with unsettled contacts";
        - overlap "cells" "largest overlap of solids with each other or with obstacles";
        - most_iterations "" "of a solve; empty for direct solves";
        - deflection "" "displacement of the end of the thesis's beam over its length, largest";
        - lift "" "its rise against gravity, largest";
        - growth "" "largest mean growth of the beam's speed per sub-step over four of them";
        + seconds "s" "wall clock, on the f64 path with other cases beside this one";
    }
}

/// Runs all selected cases: stability.csv, stability.json, stability.svg, and scenes/NAME.toml for `cutwater run`. Failed
/// cases are rows like others and failures of the results.
///
/// # Errors
/// [`Error::Input`] for a part that no name contains; [`Error::Adapter`]; [`Error::Output`].
pub fn measure(options: &Options, settings: &Settings, listener: Listener) -> Result<Results, Error> {
    let mut cases = cases(options.steps, options.scale)?;
    options.check(&cases.iter().map(|case| case.name.clone()).collect::<Vec<_>>())?;
    let bench = Bench {
        name: "stability",
        tables: vec![Table::new("stability", &[STABILITY], &["name"])],
        derive: sort,
        pictures: &[("stability", draw)],
    };
    let machine = match &options.backend {
        Backend::Gpu(choice) => Machine::new(&Gpu::new(choice)?, 3)?,
        Backend::Cpu => Machine::host(),
    };
    let request = (options.steps, options.scale, options.backend.name());
    let mut run = Run::start(bench, machine, &request, settings, listener)?;
    let scenes = settings.out.join("scenes");
    fs::create_dir_all(&scenes).map_err(|problem| Error::unwritten(&scenes, &problem))?;
    cases.retain(|case| options.selects(&case.name));
    cases.iter().try_for_each(|case| case.write(&scenes))?;
    let known = cases.clone();
    cases.retain(|case| !run.results.tables[0].has(&row! { name: case.name.as_str() }));
    let (clock, total, mut done) = (Instant::now(), cases.len(), 0);
    run_all(&cases, &options.backend, |row| {
        done += 1;
        run.put(vec![("stability", row)])?;
        run.progress("cases", done, total, clock);
        Ok(())
    })?;
    run.results.failures = failures(&run.results, &known);
    Ok(run.results)
}

/// A line per failed case.
fn failures(results: &Results, cases: &[Case]) -> Vec<String> {
    let rows = results.rows("stability");
    let failed = rows.iter().filter(|row| !row.flag("passed")).map(|row| {
        let [name, status, expected] = ["name", "status", "expected"].map(|name| row.text(name));
        let cause = cases.iter().find(|case| case.name == name).and_then(|case| case.known_failure.as_ref());
        let known = cause.map_or(String::new(), |cause| format!(" (known: {cause})"));
        format!("{name}: {status} where it {expected}{known}")
    });
    let mut failures: Vec<String> = failed.collect();
    if !failures.is_empty() {
        failures.insert(0, format!("{} of {} cases", failures.len(), rows.len()));
    }
    failures
}

/// Runs cases and passes on their rows as they are measured. The f64 path leaves most of a sub-step to one processor, so one case runs there for
/// each of rayon's threads.
fn run_all(cases: &[Case], backend: &Backend, mut take: impl FnMut(Row) -> Result<(), Error>) -> Result<(), Error> {
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
                while let Some(case) = cases.get(next.fetch_add(1, Ordering::Relaxed)) {
                    // After an error nobody receives.
                    if to.send(case.run(backend)).is_err() {
                        break;
                    }
                }
            });
        }
        drop(to);
        rows.into_iter().try_for_each(|row| take(row?))
    })
}

/// Sorts the rows in the order of the cases.
fn sort(tables: &mut [Table]) {
    let cases = cases(1, 1.0).unwrap_or_default();
    tables[0].rows.sort_by_key(|row: &Row| cases.iter().position(|case| case.name == row.text("name")));
}

/// Whether a row has no failure.
pub fn completed(row: &Row) -> bool {
    row.text("status").starts_with(COMPLETED)
}

/// Records a failure; the first one counts.
fn fail(row: &mut Row, problem: String) {
    if completed(row) {
        row.set("status", problem);
    }
}

/// Records a failure of the last sub-step.
fn fail_step(row: &mut Row, problem: String) {
    let step = row.count("sub_steps").saturating_sub(1);
    fail(row, format!("step {step}: {problem}"));
}

/// Largest mean growth of a speed per sub-step within `GROWTH_STEPS`, from energies that were at least `GROWTH_FROM`.
pub fn growth(energies: &[f64]) -> Option<f64> {
    let after = |at: usize| {
        let grown = energies[at + 1..].iter().take(GROWTH_STEPS).copied().reduce(f64::max)? / energies[at];
        (energies[at] >= GROWTH_FROM).then(|| grown.powf(0.5 / GROWTH_STEPS as f64))
    };
    (0..energies.len()).filter_map(after).reduce(f64::max)
}

/// Largest share of the liquid that is missing for `LOST_STEPS` sub-steps. `missing`: share in each sub-step.
pub fn lost(missing: &[f64]) -> f64 {
    let least = |shares: &[f64]| shares.iter().copied().fold(f64::INFINITY, f64::min);
    missing.windows(LOST_STEPS).map(least).fold(0.0, f64::max)
}

/// Diagnosis of a state of the solids.
pub fn solid_diagnosis(solids: &Solids, state: &State, gravity: DVec3) -> SolidDiagnosis {
    let (displacement, velocity) = (&state.displacement, &state.node_velocity);
    diagnose_solid(solids, &solids.deformations(displacement), displacement, velocity, gravity)
}

/// Number of values that are not finite.
fn non_finite(state: &State, report: &StepReport) -> usize {
    let vectors = [&state.markers, &state.displacement, &state.node_velocity].map(|list| list.as_flattened());
    let cells = [&state.pressure[..], &state.liquid_distance];
    let fields = state.velocity.iter().map(|list| &list[..]).chain(vectors).chain(cells).flatten();
    let liquid = report.liquid.map(|liquid| liquid.diagnosis);
    let liquid = liquid.map(|it| [it.volume, it.kinetic_energy, it.max_speed, it.divergence]);
    let solids = report.solid.map(|solid| solid.diagnosis);
    let solids = solids.map(|it| [it.kinetic_energy, it.elastic_energy, it.max_speed, it.min_det]);
    let diagnoses = liquid.into_iter().chain(solids).flatten();
    fields.copied().chain(diagnoses).filter(|value| !value.is_finite()).count()
}

impl Case {
    /// Runs the case; a failure is the status of the row.
    ///
    /// # Errors
    /// [`Error::Adapter`].
    pub fn run(&self, backend: &Backend) -> Result<Row, Error> {
        let clock = Instant::now();
        let mut row = self.row(backend);
        match self.scene().and_then(|scene| simulate(&scene, backend, &mut row)) {
            Err(error @ Error::Adapter { .. }) => return Err(error),
            Err(error) if row.count("sub_steps") == 0 => fail(&mut row, format!("does not start: {error}")),
            Err(error) => fail(&mut row, error.to_string()),
            Ok(()) => {}
        }
        name_misses(&mut row);
        row.set("seconds", clock.elapsed().as_secs_f64());
        row.set("passed", self.expected.holds(&row));
        Ok(row)
    }

    /// Its row before the first sub-step.
    pub fn row(&self, backend: &Backend) -> Row {
        row! {
            name: self.name.as_str(), group: self.group(), varies: self.varies.as_str(), backend: backend.name(), steps: self.steps,
            expected: self.expected.name(), status: COMPLETED, energy_ratio: 1.0, energy_bound: MOST_ENERGY, energy_end: 1.0,
            volume_least: 1.0, volume_most: 1.0, min_det: 1.0,
        }
    }
}

/// Counters of imperfect sub-steps, and a phrase for each.
const MISSES: [(&str, &str, &str); 2] = [
    ("missed", "missed their tolerance", "missed a tolerance"),
    ("unsettled", "with contacts that did not settle", "with contacts that did not settle"),
];

/// Counts a sub-step with solves that missed a tolerance, and one with unsettled contacts.
pub fn count(row: &mut Row, missed: bool, unsettled: bool) {
    // One in any run.
    let most = (MOST_MISSED * row.number("steps")).ceil() as usize;
    let percent = 100.0 * MOST_MISSED;
    for ((name, problem, _), counts) in MISSES.into_iter().zip([missed, unsettled]) {
        row.set(name, row.count(name) + usize::from(counts));
        if row.count(name) > most {
            fail_step(row, format!("more than {percent} % of the sub-steps {problem}"));
        }
    }
}

/// Adds missed tolerances and unsettled contacts to the status of a run that completes.
pub fn name_misses(row: &mut Row) {
    let mut status = COMPLETED.to_owned();
    for (name, _, problem) in MISSES {
        status += &match row.count(name) {
            0 => String::new(),
            1 => format!(", 1 sub-step {problem}"),
            n => format!(", {n} sub-steps {problem}"),
        };
    }
    if completed(row) {
        row.set("status", status);
    }
}

fn raise(row: &mut Row, name: &'static str, value: f64) {
    row.set(name, row.number(name).max(value));
}

fn lower(row: &mut Row, name: &'static str, value: f64) {
    row.set(name, row.number(name).min(value));
}

/// Checks the last sub-step of a run against its bounds; `dt`: longest sub-step so far, s.
pub fn check(row: &mut Row, moment: &Moment, budget: &Budget, dt: f64) {
    let ratio = moment.energy() / budget.energy;
    row.set("energy_end", ratio);
    raise(row, "elastic_ratio", moment.elastic / budget.energy);
    let numbers = [
        (["energy_ratio", "energy_bound", "energy", "times that of the start"], ratio),
        (["motion", "motion_bound", "energy of motion and strain", "J"], moment.motion()),
        (["solid_speed", "solid_speed_bound", "speed of a node", "m/s"], moment.solid_speed),
        (["liquid_speed", "liquid_speed_bound", "speed of the liquid", "m/s"], moment.liquid_speed),
    ];
    for (([name, bound_name, what, unit], value), bound) in numbers.into_iter().zip(budget.bounds(dt)) {
        raise(row, name, value);
        row.set(bound_name, bound);
        if value > bound {
            fail_step(row, format!("{what} above its bound, {value:.3} {unit} where {bound:.3} are the most"));
        }
    }
}

/// Runs a scene to its last sub-step, or until its verdict is clear.
fn simulate(scene: &Scene, backend: &Backend, row: &mut Row) -> Result<(), Error> {
    let mut simulation = Simulation::new(scene, backend)?;
    let start = simulation.state()?;
    let gravity = scene.domain.gravity;
    let diagnosis = solid_diagnosis(simulation.solids(), &start, gravity);
    let liquid = diagnose_liquid(scene, simulation.cut_cells(), &start, 0.0).unwrap_or_default();
    let budget = Budget::new(scene, simulation.solids(), &liquid, &diagnosis);
    let (mut longest, mut outflow) = (0.0, 0.0);
    let (mut energies, mut missing) = (Vec::new(), Vec::new());
    row.set("cells", scene.grid().n_cells());
    row.set("nodes", simulation.solids().rest.len());
    for at in 0..row.count("steps") {
        let report = simulation.step()?;
        let state = simulation.state()?;
        row.set("sub_steps", at + 1);
        longest = f64::max(longest, report.dt);
        if let Some(volume) = simulation.volume_ratio(&report) {
            lower(row, "volume_least", volume);
            raise(row, "volume_most", volume);
            row.set("volume_drift", volume - 1.0);
        }
        if let Some(liquid) = report.liquid {
            outflow += liquid.exchange.map_or(0.0, Exchange::outflow);
            missing.push(budget.missing(&liquid.diagnosis, outflow));
            let lost = lost(&missing);
            row.set("lost", lost);
            if lost > MOST_LOST {
                fail_step(row, format!("more than {} % of the liquid lost", 100.0 * MOST_LOST));
            }
        }
        let missed = report.solves().any(|solve| solve.status != SolveStatus::Converged);
        count(row, missed, report.solid.is_some_and(|solid| solid.contact.unsettled > 0));
        if let Some(coupling) = report.coupling {
            raise(row, "overlap", coupling.overlap_depth / scene.grid().dx);
        }
        let most =
            report.solves().map(|solve| solve.iterations as usize).fold(row.count("most_iterations"), usize::max);
        row.set("most_iterations", (most > 0).then_some(most));
        let bad = non_finite(&state, &report);
        row.set("non_finite", bad);
        if bad > 0 {
            fail_step(row, format!("{bad} values are not finite"));
            return Ok(());
        }
        if !scene.probes.is_empty() {
            let tip = DVec3::from_slice(&simulation.probes()?[..3]) / cases::BEAM;
            let lift = -tip.dot(gravity.normalize_or_zero());
            raise(row, "deflection", tip.length());
            raise(row, "lift", f64::max(0.0, lift));
        }
        let Some(solid) = report.solid else { continue };
        lower(row, "min_det", solid.diagnosis.min_det);
        row.set("inverted", solid.diagnosis.inverted);
        let liquid = report.liquid.map(|liquid| liquid.diagnosis);
        let moment = budget.moment(&liquid.unwrap_or_default(), &solid.diagnosis);
        check(row, &moment, &budget, longest);
        energies.push(moment.solids / budget.energy);
        if row.has("deflection") {
            row.set("growth", growth(&energies));
        }
        if row.number("energy_end") > HOPELESS {
            return Ok(());
        }
    }
    Ok(())
}

/// Largest fraction of a bound of each case, and a mark at the bound.
fn draw(results: &Results) -> Page {
    let bars = results.rows("stability").iter().map(|row| {
        let share = |name: &str| row.number(name) / row.number(&format!("{name}_bound"));
        let energy = (row.number("energy_ratio") - 1.0) / (row.number("energy_bound") - 1.0);
        let shares = ["motion", "solid_speed", "liquid_speed"].map(share);
        let most = shares.into_iter().fold(energy, f64::max).clamp(0.0, 2.0);
        let verdict = match (row.flag("passed"), row.count("missed") + row.count("unsettled")) {
            (true, 0) => "passes",
            (true, _) => "passes, some sub-steps missed a tolerance",
            (false, _) => "fails",
        };
        (row.text("name").to_owned(), vec![(verdict.to_owned(), 0.0, most)], 1.0)
    });
    let title = format!("Stability, {}", results.machine.name());
    let axis = "largest energy or speed over its bound, to 2";
    Page::Bars(vec![Bars { title, axis, bars: bars.collect(), key: true }])
}
