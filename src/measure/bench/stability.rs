//! `bench stability`: hostile scenes in strong coupling, the variants of the thesis's section 6.3, and the limit of added mass that weak coupling
//! has in one dimension.
//!
//! The energy of a run is kinetic, elastic and potential, J: the liquid's by its markers, each with the same share of the mass, so that spray does
//! not inflate it; potential energy counts from the lowest corner of the domain. Backward Euler and the projection only take energy away. Markers
//! fall with the velocities of before and gain g v dt / 2 per kg. A run fails where an energy or a speed is above its bound (`budget`), where it
//! loses a tenth of its markers, where more than a hundredth of its sub-steps miss a tolerance or leave contacts unsettled, where a value is not
//! finite, and where the simulation fails.

mod budget;
mod cases;
mod limit;

use std::fs;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::Instant;

use glam::DVec3;

use super::chart::{Bars, Page};
use super::table::{Row, Table, columns, row};
use super::{Bench, Case as BenchCase, Listener, Machine, Results, Run, Settings};
use crate::Error;
use crate::elastic::Solids;
use crate::gpu::Gpu;
use crate::reference::diagnose_solid;
use crate::scene::Scene;
use crate::sim::{Backend, Simulation};
use crate::state::{SolidDiagnosis, SolidReport, SolveStatus, State, StepReport};

use limit::LIMIT;

pub use budget::{Budget, MOST_ENERGY, Moment};
pub use cases::{Case, Expected, KNOWN_FAILURES, cases};
pub use limit::{Limit, limits};

/// Share of the markers that a run may lose.
const MOST_LOST: f64 = 0.1;
/// Energy ratio above which a run ends: verdict and order of magnitude are clear.
const HOPELESS: f64 = 1e4;
/// Share of the sub-steps that may miss a tolerance, and that may leave contacts unsettled.
const MOST_MISSED: f64 = 0.01;
/// Sub-steps over which growth is a mean.
const GROWTH_STEPS: usize = 4;
/// Energy of a body over all energy of the start from which on its growth counts.
const GROWTH_FROM: f64 = 1e-3;
/// Status of a run without a failure.
const COMPLETED: &str = "completed";

/// Cases to run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Sub-steps of each hostile scene; the thesis's variants have their own.
    pub steps: u64,
    /// Parts of names: cases without any of them are left out. All cases where empty.
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

    /// Refuses parts that no name has.
    ///
    /// # Errors
    /// [`Error::Input`] with similar names.
    pub fn check(&self, names: &[String]) -> Result<(), Error> {
        let known = |part: &str| !part.is_empty() && names.iter().any(|name| name.contains(part));
        let Some(part) = self.cases.iter().find(|part| !known(part)) else {
            return Ok(());
        };
        // Distance to the whole name and to its words.
        let distance = |name: &&str| {
            name.split('_')
                .chain([*name])
                .map(|word| strsim::damerau_levenshtein(part, word))
                .min()
        };
        let mut near: Vec<&str> = names.iter().map(String::as_str).collect();
        near.sort_by_key(distance);
        near.truncate(5);
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

columns! {
    STABILITY {
        passed + "" "whether the expected behaviour was found";
        name = "" "name of the case";
        group - "" "cases that vary the same";
        varies - "" "what is hostile about it";
        backend - "" "`gpu` or `cpu`";
        cells - "" "cells of the domain";
        nodes - "" "nodes of the solids";
        steps - "" "sub-steps asked for";
        sub_steps + "" "sub-steps done";
        expected - "" "`completes`, `fails`, `is pushed away` or `stays stiff`";
        status + "" "`completed`, or the first failure and its sub-step";
        energy_ratio + "" "largest energy over that of the start";
        energy_bound - "" "its bound";
        energy_end - "" "energy at the end over that of the start";
        elastic_ratio - "" "largest elastic energy over all energy of the start";
        motion + "J" "largest kinetic and elastic energy";
        motion_bound - "J" "energy of the start and what gravity can release";
        solid_speed + "m/s" "largest component of a node's velocity";
        solid_speed_bound - "m/s" "its bound";
        liquid_speed + "m/s" "largest velocity of a face";
        liquid_speed_bound - "m/s" "its bound";
        non_finite - "" "values that are not finite";
        volume_least - "" "least volume of the liquid over that of the start";
        volume_most - "" "largest";
        volume_drift - "" "volume at the end over that of the start, less 1";
        lost - "" "markers lost over those of the start";
        min_det + "" "least det F";
        inverted - "" "elements with det F <= 0 at the end";
        missed + "" "sub-steps with a solve that did not converge";
        unsettled - "" "sub-steps with unsettled contacts";
        overlap - "cells" "largest overlap of solids with each other or with obstacles";
        most_iterations - "" "of a solve; empty for direct solves";
        deflection - "" "displacement of the end of the thesis's beam over its length, largest";
        lift - "" "its rise against gravity, largest";
        growth - "" "largest mean growth of the beam's speed per sub-step over four of them";
        seconds + "s" "wall clock, on the f64 path with other cases beside this one";
    }
}

/// Runs all cases asked for: stability.csv, stability_limit.csv, stability.json, stability.svg, and scenes/NAME.toml for `cutwater run`. Failed cases
/// are rows like others and failures of the results.
///
/// # Errors
/// [`Error::Input`] for a part that no name has; [`Error::Adapter`]; [`Error::Output`].
pub fn measure(
    options: &Options,
    settings: &Settings,
    listener: Listener,
) -> Result<Results, Error> {
    let mut cases = cases(options.steps, options.scale);
    let limits = limits();
    let names = limits
        .iter()
        .map(Limit::name)
        .chain(cases.iter().map(|case| case.name.clone()));
    options.check(&names.collect::<Vec<_>>())?;
    let bench = Bench {
        name: "stability",
        tables: vec![
            Table::new("stability", &[STABILITY], &["name"]),
            Table::new("stability_limit", &[LIMIT], &["name"]),
        ],
        derive: sort,
        pictures: &[("stability", draw)],
    };
    let machine = match &options.backend {
        Backend::Gpu(choice) => Machine::new(&Gpu::new(choice)?, 3)?,
        Backend::Cpu => Machine::host(),
    };
    let mut run = Run::start(
        bench,
        machine,
        &(options.steps, options.scale, options.backend.name()),
        settings,
        listener,
    )?;
    let scenes = settings.out.join("scenes");
    fs::create_dir_all(&scenes).map_err(|problem| Error::unwritten(&scenes, &problem))?;
    let selected = limits.iter().filter(|limit| options.selects(&limit.name()));
    let of_limits = selected.map(|limit| BenchCase {
        key: ("stability_limit", row! { name: limit.name() }),
        measure: Box::new(|_| Ok(vec![("stability_limit", limit.run(&options.backend)?)])),
    });
    run.cases(of_limits.collect())?;
    let pairs = limit::step_lengths(run.results.rows("stability_limit")).into_iter();
    let pairs: Vec<_> = pairs.map(|row| ("stability_limit", row)).collect();
    if !pairs.is_empty() {
        run.put(pairs)?;
    }
    cases.retain(|case| options.selects(&case.name));
    cases.iter().try_for_each(|case| case.write(&scenes))?;
    cases.retain(|case| !run.results.tables[0].has(&row! { name: case.name.as_str() }));
    let (clock, of, mut done) = (Instant::now(), cases.len(), 0);
    run_all(&cases, &options.backend, |row| {
        done += 1;
        run.put(vec![("stability", row)])?;
        run.progress("cases", done, of, clock);
        Ok(())
    })?;
    run.results.failures = failures(&run.results);
    Ok(run.results)
}

/// A line per failed case.
fn failures(results: &Results) -> Vec<String> {
    let failed = |name| results.rows(name).iter().filter(|row| !row.flag("passed"));
    let of_cases = failed("stability").map(|row| {
        let name = row.text("name");
        let known = KNOWN_FAILURES.iter().find(|known| known.0 == name);
        let known = known.map_or(String::new(), |(_, cause)| format!(" (known: {cause})"));
        format!(
            "{name}: {} where it {}{known}",
            row.text("status"),
            row.text("expected")
        )
    });
    let of_limits = failed("stability_limit").map(|row| {
        format!(
            "{}: a growth of {} for {}",
            row.text("name"),
            row.number("got"),
            row.number("expected")
        )
    });
    let mut failures: Vec<String> = of_cases.chain(of_limits).collect();
    if !failures.is_empty() {
        let all: usize = results.tables.iter().map(|table| table.rows.len()).sum();
        failures.insert(0, format!("{} of {all} cases", failures.len()));
    }
    failures
}

/// Runs cases and hands on their rows as they are measured. The f64 path leaves most of a sub-step to one processor, so there one case runs for
/// each of rayon's threads.
fn run_all(
    cases: &[Case],
    backend: &Backend,
    mut take: impl FnMut(Row) -> Result<(), Error>,
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
    let names: Vec<String> = cases(1, 1.0).into_iter().map(|case| case.name).collect();
    tables[0]
        .rows
        .sort_by_key(|row| names.iter().position(|name| *name == row.text("name")));
}

/// Whether a row has no failure.
pub fn completed(row: &Row) -> bool {
    row.text("status").starts_with(COMPLETED)
}

/// The first failure counts.
fn fail(row: &mut Row, problem: String) {
    if completed(row) {
        row.set("status", problem);
    }
}

/// Largest mean growth of a speed per sub-step within `GROWTH_STEPS`, by energies that are at least `GROWTH_FROM` before.
pub fn growth(energies: &[f64]) -> Option<f64> {
    let of = |at: usize| {
        let later = energies[at + 1..].iter().take(GROWTH_STEPS);
        let grown = later.copied().reduce(f64::max)? / energies[at];
        (energies[at] >= GROWTH_FROM).then(|| grown.powf(0.5 / GROWTH_STEPS as f64))
    };
    (0..energies.len()).filter_map(of).reduce(f64::max)
}

/// Diagnosis of a state of the solids.
pub fn solid_diagnosis(solids: &Solids, state: &State, gravity: DVec3) -> SolidDiagnosis {
    let elements = 0..solids.elements.len();
    let deformations: Vec<_> = elements
        .map(|element| solids.deformation(element, &state.displacement))
        .collect();
    diagnose_solid(
        solids,
        &deformations,
        &state.displacement,
        &state.node_velocity,
        gravity,
    )
}

/// Values that are not finite.
fn non_finite(state: &State, report: &StepReport) -> usize {
    let nodes = [&state.markers, &state.displacement, &state.node_velocity];
    let nodes = nodes.into_iter().flat_map(|list| list.as_flattened());
    let cells = state.pressure.iter().chain(&state.liquid_distance);
    let of_state = state
        .velocity
        .iter()
        .flatten()
        .chain(nodes)
        .chain(cells)
        .copied();
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
    let all = of_state.chain(of_liquid.into_iter().chain(of_solids).flatten());
    all.filter(|value| !value.is_finite()).count()
}

impl Case {
    /// Runs it; a failure is the status of the row.
    ///
    /// # Errors
    /// [`Error::Adapter`].
    pub fn run(&self, backend: &Backend) -> Result<Row, Error> {
        let clock = Instant::now();
        let mut row = self.row(backend);
        match self.scene() {
            Ok(scene) => match simulate(&scene, backend, &mut row) {
                // No case can run then.
                Err(error @ Error::Adapter { .. }) => return Err(error),
                Err(error) if row.count("sub_steps") == 0 => {
                    fail(&mut row, format!("does not start: {error}"))
                }
                Err(error) => fail(&mut row, error.to_string()),
                Ok(()) => {}
            },
            Err(error) => fail(&mut row, format!("does not start: {error}")),
        }
        name_misses(&mut row);
        row.set("seconds", clock.elapsed().as_secs_f64());
        row.set("passed", self.expected.holds(&row));
        Ok(row)
    }

    /// Its row before the first sub-step.
    pub fn row(&self, backend: &Backend) -> Row {
        row! {
            name: self.name.as_str(), group: self.group, varies: self.varies.as_str(), backend: backend.name(), cells: 0_usize, nodes: 0_usize,
            steps: self.steps, sub_steps: 0_usize, expected: self.expected.name(), status: COMPLETED, passed: false, energy_ratio: 1.0,
            energy_bound: MOST_ENERGY, energy_end: 1.0, elastic_ratio: 0.0, motion: 0.0, motion_bound: 0.0, solid_speed: 0.0,
            solid_speed_bound: 0.0, liquid_speed: 0.0, liquid_speed_bound: 0.0, non_finite: 0_usize, volume_least: 1.0, volume_most: 1.0,
            volume_drift: 0.0, lost: 0.0, min_det: 1.0, inverted: 0_usize, missed: 0_usize, unsettled: 0_usize, overlap: 0.0,
        }
    }
}

/// Counts a sub-step with solves that missed a tolerance, and one with unsettled contacts.
pub fn count(row: &mut Row, missed: bool, unsettled: bool) {
    // One in any run.
    let most = (MOST_MISSED * row.number("steps")).ceil() as usize;
    let (at, percent) = (
        row.count("sub_steps").saturating_sub(1),
        100.0 * MOST_MISSED,
    );
    for (name, counts, problem) in [
        ("missed", missed, "missed their tolerance"),
        ("unsettled", unsettled, "with contacts that did not settle"),
    ] {
        row.set(name, row.count(name) + usize::from(counts));
        if row.count(name) > most {
            fail(
                row,
                format!("step {at}: more than {percent} % of the sub-steps {problem}"),
            );
        }
    }
}

/// Names missed tolerances and unsettled contacts in the status of a run that completes.
pub fn name_misses(row: &mut Row) {
    let mut status = COMPLETED.to_owned();
    for (name, problem) in [
        ("missed", "missed a tolerance"),
        ("unsettled", "with contacts that did not settle"),
    ] {
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

/// Raises a number to the value.
fn raise(row: &mut Row, name: &'static str, value: f64) {
    row.set(name, row.number(name).max(value));
}

/// Checks the last sub-step of a run with sub-steps of up to `dt` s.
pub fn check(row: &mut Row, moment: &Moment, budget: &Budget, dt: f64) {
    let ratio = moment.energy() / budget.energy;
    row.set("energy_end", ratio);
    raise(row, "elastic_ratio", moment.elastic / budget.energy);
    let at = row.count("sub_steps").saturating_sub(1);
    for (name, bound_name, what, value, bound, unit) in [
        (
            "energy_ratio",
            "energy_bound",
            "energy",
            ratio,
            budget.energy_bound(dt),
            "times that of the start",
        ),
        (
            "motion",
            "motion_bound",
            "energy of motion and strain",
            moment.motion(),
            budget.motion_bound(dt),
            "J",
        ),
        (
            "solid_speed",
            "solid_speed_bound",
            "speed of a node",
            moment.solid_speed,
            budget.solid_speed_bound(dt),
            "m/s",
        ),
        (
            "liquid_speed",
            "liquid_speed_bound",
            "speed of the liquid",
            moment.liquid_speed,
            budget.liquid_speed_bound(dt),
            "m/s",
        ),
    ] {
        raise(row, name, value);
        row.set(bound_name, bound);
        if value > bound {
            fail(
                row,
                format!(
                    "step {at}: {what} above its bound, {value:.3} {unit} where {bound:.3} are the most"
                ),
            );
        }
    }
}

fn simulate(scene: &Scene, backend: &Backend, row: &mut Row) -> Result<(), Error> {
    let mut simulation = Simulation::new(scene, backend)?;
    let start = simulation.state()?;
    let gravity = scene.domain.gravity;
    let diagnosis = solid_diagnosis(simulation.solids(), &start, gravity);
    let budget = Budget::new(scene, simulation.solids(), &start, &diagnosis);
    let (mut longest, mut energies) = (0.0, Vec::new());
    row.set("cells", scene.grid().n_cells());
    row.set("nodes", simulation.solids().rest.len());
    for at in 0..row.count("steps") {
        let report = simulation.step()?;
        let state = simulation.state()?;
        row.set("sub_steps", at + 1);
        longest = f64::max(longest, report.dt);
        if let Some(volume) = simulation.volume_ratio(&report) {
            row.set("volume_least", row.number("volume_least").min(volume));
            raise(row, "volume_most", volume);
            row.set("volume_drift", volume - 1.0);
        }
        let lost = state.markers_dropped as f64 / start.markers.len().max(1) as f64;
        row.set("lost", lost);
        if lost > MOST_LOST {
            fail(
                row,
                format!(
                    "step {at}: more than {} % of the markers lost",
                    100.0 * MOST_LOST
                ),
            );
        }
        let missed = report
            .solves()
            .any(|solve| solve.status != SolveStatus::Converged);
        let unsettled = |solid: SolidReport| solid.contact.unsettled > 0;
        count(row, missed, report.solid.is_some_and(unsettled));
        if let Some(coupling) = report.coupling {
            raise(row, "overlap", coupling.overlap_depth / scene.grid().dx);
        }
        let most = report
            .solves()
            .map(|solve| solve.iterations)
            .max()
            .unwrap_or(0);
        if most > 0 && most as usize > row.count("most_iterations") {
            row.set("most_iterations", most);
        }
        let bad = non_finite(&state, &report);
        row.set("non_finite", bad);
        if bad > 0 {
            fail(row, format!("step {at}: {bad} values are not finite"));
            return Ok(());
        }
        if !scene.probes.is_empty() {
            let tip = DVec3::from_slice(&simulation.probes()?[..3]) / cases::BEAM;
            raise(row, "deflection", tip.length());
            raise(
                row,
                "lift",
                f64::max(0.0, -tip.dot(gravity.normalize_or_zero())),
            );
        }
        if let Some(solid) = report.solid {
            let diagnosis = solid.diagnosis;
            row.set("min_det", row.number("min_det").min(diagnosis.min_det));
            row.set("inverted", diagnosis.inverted);
            let of_liquid = report.liquid.map_or(0.0, |it| it.diagnosis.max_speed);
            let moment = budget.moment(&state, &diagnosis, of_liquid);
            check(row, &moment, &budget, longest);
            energies.push(moment.solids() / budget.energy);
            if row.has("deflection") {
                row.set("growth", growth(&energies));
            }
            if row.number("energy_end") > HOPELESS {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// Largest fraction of a bound of each case, and a mark at the bound.
fn draw(results: &Results) -> Page {
    let bars = results.rows("stability").iter().map(|row| {
        let share = |name: &str| row.number(name) / row.number(&format!("{name}_bound"));
        let energy = (row.number("energy_ratio") - 1.0) / (row.number("energy_bound") - 1.0);
        let most = ["motion", "solid_speed", "liquid_speed"]
            .map(share)
            .into_iter()
            .fold(energy, f64::max);
        let verdict = match (
            row.flag("passed"),
            row.count("missed") + row.count("unsettled"),
        ) {
            (true, 0) => "passes",
            (true, _) => "passes, some sub-steps missed a tolerance",
            (false, _) => "fails",
        };
        (
            row.text("name").to_owned(),
            vec![(verdict.to_owned(), 0.0, most.clamp(0.0, 2.0))],
            1.0,
        )
    });
    Page::Bars(vec![Bars {
        title: format!("Stability, {}", results.machine.name()),
        axis: "largest energy or speed over its bound, to 2",
        bars: bars.collect(),
        key: true,
    }])
}
