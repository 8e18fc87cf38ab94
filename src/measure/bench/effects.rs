//! `bench effects`: time, bytes and dispatches that each effect of a scene adds to a sub-step.
//!
//! From the state after each frame, a sub-step runs with all effects and without one of them, in alternating order. The seconds that an effect adds are
//! the median of the paired differences, with an interval that contains their true median. Bytes are those of all buffers at the end. Dispatches of
//! the solve depend on its iterations and have their own column.
//!
//! `liquid` and `solids` include their coupling. The row [`COUPLING`] is the scene less its liquid alone less its solids alone.

mod left_out;
pub mod pairs;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use super::chart::{Bars, Page};
use super::statistics::Spread;
use super::table::{Row, Table, columns, row};
use super::{Bench, Case, Listener, Machine, Results, Rows, Run, SEED, Settings, hashes};
use crate::Error;
use crate::effects::Effects;
use crate::gpu::{AdapterChoice, Gpu};
use crate::scene::Scene;
use crate::sim::{Backend, GpuPath, Simulation};
use crate::state::State;

pub use left_out::{EFFECTS, Effect, PROBES};
use pairs::{Cost, Pair};

/// Row of the control, copied by all absent effects: the scene against itself with these effects removed. Bytes and dispatches must be equal.
pub const ABSENT: &str = "absent";
/// Row of the scene against itself: its seconds are noise.
pub const ITSELF: &str = "itself";
/// Row of the coupling. No scene has liquid and solids without coupling, so it is compared with the sum of two scenes, one without solids and one without
/// liquid. Their common parts count twice.
pub const COUPLING: &str = "coupling";
/// Largest probability that an absent effect without cost fails by its seconds: of ten pairs all have to be slower.
const FALSE_ALARM: f64 = 1e-3;

/// Columns that are 0 of effects without cost.
const COUNTS: [&str; 4] = ["bytes_added", "dispatches_added", "solve_dispatches_added", "dispatches_differ"];

/// Scenes to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Scaled scenes.
    pub scenes: Vec<Scene>,
    /// Frames of each scene, with a pair of sub-steps per effect after each frame.
    pub frames: u64,
    /// Adapter.
    pub adapter: AdapterChoice,
}

columns! {
    EFFECT {
        + scene "" "name of the scene";
        + effect "" "effect, kind of probes, `coupling`, `absent` or `itself`";
        + present "" "whether the scene has it; if not, the numbers are those of the row `absent`";
        - seconds_with "s" "sub-step of the scene, median";
        - seconds_without "s" "without the effect; empty where no scene is left";
        + seconds_added "s" "median of the paired differences";
        - seconds_added_low, seconds_added_high "s" "their first and third quartile";
        + seconds_told "" "`adds`, `saves`, `not told apart from nothing` or `too few pairs`";
        - seconds_told_low, seconds_told_high "s" "interval that contains the true median with at least 95 %";
        + bytes_added "B" "buffers that the effect adds";
        + dispatches_added "" "outside of the solve, median";
        - dispatches_differ "" "pairs with different numbers of these";
        - solve_dispatches_added "" "in the solve, median";
        - kernels "" "kernels that only the effect compiles";
        - pairs "" "pairs of sub-steps";
        - slower "" "pairs in which the scene with it took longer";
    }
}

/// Measures all scenes: effects.csv, effects.json, effects.svg. Failures: scenes with absent effects that have a cost.
///
/// # Errors
/// [`Error::Output`], before any work if the folder cannot be written; errors of the simulations.
pub fn measure(options: &Options, settings: &Settings, listener: Listener) -> Result<Results, Error> {
    let bench = Bench {
        name: "effects",
        tables: vec![Table::new("effects", &[EFFECT], &["scene", "effect"])],
        derive: |_| {},
        pictures: &[("effects", draw)],
    };
    // A separate device, whose buffers do not count.
    let machine = Machine::new(&Gpu::new(&options.adapter)?, 3)?;
    let mut run = Run::start(bench, machine, &(hashes(&options.scenes), options.frames), settings, listener)?;
    let cases = options.scenes.iter().map(|scene| {
        let key = row! { scene: scene.name.as_str(), effect: ITSELF };
        Case::new("effects", key, |_| scene_rows(scene, options))
    });
    run.cases(cases.collect())?;
    let failed = run.results.rows("effects").iter().filter(|row| row.text("effect") == ABSENT && costs(row));
    run.results.failures = failed.map(failure).collect();
    Ok(run.results)
}

/// Whether absent effects have a cost, by a row of the control; for seconds with an error probability of `FALSE_ALARM`.
pub fn costs(row: &Row) -> bool {
    let same = COUNTS.iter().all(|name| row.number(name) == 0.0);
    let [pairs, slower] = ["pairs", "slower"].map(|name| row.count(name));
    let slower = row.text("seconds_told") == pairs::ADDS && pairs::at_most(pairs - slower, pairs) <= FALSE_ALARM;
    !(same && row.text("kernels").is_empty()) || slower
}

fn failure(row: &Row) -> String {
    let names = COUNTS.into_iter().chain(["kernels", "seconds_added", "pairs", "slower"]);
    let numbers: Vec<String> = names.map(|name| format!("{name} {}", row.get(name))).collect();
    format!("effects that {} does not have cost something: {}", row.text("scene"), numbers.join(", "))
}

/// A scene or a reduced one, and the pairs of sub-steps of the whole scene with it.
struct Part {
    name: &'static str,
    scene: Scene,
    simulation: Simulation,
    /// Number of buffers at the start.
    at_start: usize,
    pairs: Vec<Pair>,
}

impl Part {
    fn new(name: &'static str, scene: Scene, adapter: &AdapterChoice) -> Result<Part, Error> {
        let simulation = Simulation::new(&scene, &Backend::Gpu(adapter.clone()))?;
        let at_start = simulation.gpu().map_or(0, |gpu| gpu.allocated().len());
        Ok(Part { name, scene, simulation, at_start, pairs: Vec::new() })
    }

    fn gpu(&self) -> &Gpu {
        self.simulation.gpu().expect("benches run on the GPU path")
    }

    fn bytes(&self) -> u64 {
        bytes_in_use(&self.gpu().allocated(), self.at_start)
    }

    /// Times a sub-step from a state of the whole scene, with its probes.
    fn time(&mut self, state: &State) -> Result<Cost, Error> {
        let mut state = state.clone();
        if self.scene.solids.is_empty() {
            state.displacement.clear();
            state.node_velocity.clear();
        }
        if !Effects::of(&self.scene).markers {
            state.markers.clear();
        }
        // Without sources there is no room for emitted markers.
        state.markers.truncate(self.simulation.gpu_path().and_then(GpuPath::marker_room).unwrap_or(0));
        self.simulation.reset(&state)?;
        self.gpu().start_trace();
        let clock = Instant::now();
        self.simulation.step()?;
        self.simulation.probes()?;
        let seconds = clock.elapsed().as_secs_f64();
        let dispatches = self.gpu().take_trace().dispatches;
        let solve_dispatches = dispatches.iter().filter(|(stage, _)| *stage == "solve").count();
        Ok(Cost { seconds, dispatches: dispatches.len() - solve_dispatches, solve_dispatches })
    }
}

/// Bytes of the buffers in use, from labels and bytes of all created buffers, of which the first `at_start` precede the first sub-step. A growing buffer
/// replaces all of its label. Copies for the host are those of the start: later ones are of one download.
pub fn bytes_in_use(made: &[(String, u64)], at_start: usize) -> u64 {
    let mut labels: BTreeMap<&str, (usize, Vec<u64>)> = BTreeMap::new();
    for (at, (label, bytes)) in made.iter().enumerate() {
        let (first, all) = labels.entry(label).or_default();
        *first += usize::from(at < at_start);
        all.push(*bytes);
    }
    let in_use = labels.iter().flat_map(|(label, (first, all))| match label.ends_with("(read-back)") {
        true => &all[..*first],
        false => &all[all.len() - first.max(&1)..],
    });
    in_use.sum()
}

/// Rows of the effects of a scene.
fn scene_rows(scene: &Scene, options: &Options) -> Result<Rows, Error> {
    // States at the start and after each frame, from a separate path: buffers that grow meanwhile would count for the whole scene only.
    let mut simulation = Simulation::new(scene, &Backend::Gpu(options.adapter.clone()))?;
    let mut states = vec![simulation.state()?];
    for frame in 0..options.frames {
        while simulation.clock().frame == frame {
            simulation.step()?;
        }
        states.push(simulation.state()?);
    }
    drop(simulation);
    let mut whole = Part::new("", scene.clone(), &options.adapter)?;
    let mut parts = parts(scene, options)?;
    let mut random = fastrand::Rng::with_seed(SEED);
    // The first compiles and warms caches.
    for (sample, state) in states.iter().enumerate() {
        random.shuffle(&mut parts);
        for part in &mut parts {
            let without = (sample % 2 == 1).then(|| part.time(state)).transpose()?;
            let with = whole.time(state)?;
            let without = without.map_or_else(|| part.time(state), Ok)?;
            if sample > 0 {
                part.pairs.push([with, without]);
            }
        }
    }
    Ok(rows(scene, &whole, &parts).into_iter().map(|row| ("effects", row)).collect())
}

/// The scene without each of its effects, the control, and the scene itself.
fn parts(scene: &Scene, options: &Options) -> Result<Vec<Part>, Error> {
    let (mut scenes, mut control) = (Vec::new(), scene.clone());
    // Without its only kind of probes a scene has none: `probes` is the same part.
    let kinds = if PROBES.iter().filter(|kind| (kind.present)(scene)).count() > 1 { PROBES } else { &[] };
    for effect in EFFECTS.iter().chain(kinds) {
        if !(effect.present)(scene) {
            (effect.without)(&mut control);
            continue;
        }
        let mut without = scene.clone();
        (effect.without)(&mut without);
        let left = Effects::of(&without);
        if left.liquid || left.solids {
            scenes.push((effect.name, without));
        }
    }
    scenes.extend([(ABSENT, control), (ITSELF, scene.clone())]);
    scenes.into_iter().map(|(name, scene)| Part::new(name, scene, &options.adapter)).collect()
}

fn rows(scene: &Scene, whole: &Part, parts: &[Part]) -> Vec<Row> {
    let part = |name: &str| parts.iter().find(|part| part.name == name);
    let control = part(ABSENT).expect("there is a control");
    let noise = part(ITSELF).and_then(|part| pairs::noise(&part.pairs));
    let present = |effect: &Effect| (effect.name, (effect.present)(scene));
    let names = EFFECTS.iter().map(present).chain([(COUPLING, Effects::of(scene).coupling)]);
    let names = names.chain(PROBES.iter().map(present)).chain([(ABSENT, false), (ITSELF, true)]);
    let rows = names.map(|(effect, present)| {
        let row = row! { scene: scene.name.as_str(), effect, present };
        let compared = |pairs: &[Pair], without: &[&Part]| row.clone().with(compared(pairs, noise, whole, without));
        if !present {
            return compared(&control.pairs, &[control]);
        }
        if let (COUPLING, Some(liquid), Some(solids)) = (effect, part("solids"), part("liquid")) {
            let both = liquid.pairs.iter().zip(&solids.pairs);
            let pairs: Vec<Pair> = both.map(|(a, b)| pairs::against_both(*a, *b)).collect();
            return compared(&pairs, &[liquid, solids]);
        }
        let only_kind = || part("probes").filter(|_| PROBES.iter().any(|kind| kind.name == effect));
        match part(effect).or_else(only_kind) {
            Some(part) => compared(&part.pairs, &[part]),
            // No scene is left without it.
            None => row.with(row! { seconds_with: pairs::median(&control.pairs, 0), pairs: 0_usize }),
        }
    });
    rows.collect()
}

/// Columns of pairs of the whole scene and a reduced one.
fn compared(pairs: &[Pair], noise: Option<f64>, whole: &Part, without: &[&Part]) -> Row {
    let all = pairs::added(pairs);
    let [low, added, high] = Spread::quartiles(all.clone());
    let interval = pairs::interval(all.clone());
    let bytes: u64 = without.iter().map(|part| part.bytes()).sum();
    let others: BTreeSet<&str> = without.iter().flat_map(|part| part.gpu().compiled()).collect();
    let own: Vec<&str> = whole.gpu().compiled().difference(&others).copied().collect();
    row! {
        seconds_with: pairs::median(pairs, 0), seconds_without: pairs::median(pairs, 1), seconds_added: added, seconds_added_low: low,
        seconds_added_high: high, seconds_told: pairs::verdict(interval, added, noise), seconds_told_low: interval.map(|[low, _]| low),
        seconds_told_high: interval.map(|[_, high]| high), bytes_added: whole.bytes() as i64 - bytes as i64,
        dispatches_added: pairs::middle(pairs, |cost| cost.dispatches), dispatches_differ: pairs::differing(pairs),
        solve_dispatches_added: pairs::middle(pairs, |cost| cost.solve_dispatches), kernels: own.join(" "), pairs: pairs.len(),
        slower: all.iter().filter(|seconds| **seconds > 0.0).count(),
    }
}

/// A bar from the first to the third quartile of the added seconds, a mark at the median; grey where the seconds are noise.
fn draw(results: &Results) -> Page {
    let drawn = |row: &&Row| (row.flag("present") || row.text("effect") == ABSENT) && row.has("seconds_added");
    let bars = results.rows("effects").iter().filter(drawn).map(|row| {
        let [low, median, high] =
            ["seconds_added_low", "seconds_added", "seconds_added_high"].map(|name| 1e3 * row.number(name));
        let verdict = row.text("seconds_told");
        let part = if verdict == pairs::NOTHING { "" } else { verdict };
        let name = format!("{}: {}", row.text("scene"), row.text("effect"));
        (name, vec![(part.to_owned(), low, high)], median)
    });
    let title = "time that effects add to a sub-step".to_owned();
    Page::Bars(vec![Bars { title, axis: "ms", bars: bars.collect(), key: false }])
}
