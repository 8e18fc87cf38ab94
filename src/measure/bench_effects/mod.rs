//! `bench effects`: what each effect of a scene adds to a sub-step, in time, bytes and dispatches.
//!
//! The scene runs; the state after each frame is given to the scene and to the same scene without one of its effects, for each of them.
//! Sub-steps with and without are done from the same state one after the other, with first in one pair and without first in the next, so that
//! what else the machine does, and what drifts, falls on both; the seconds that an effect adds are the median of the paired differences, with
//! an interval that holds their true median ([`Row::seconds_told_low`]). Bytes are those of all buffers at the end. Dispatches of the solve, which
//! go with its iterations, are told apart from the others. On the same states every output is timed, too ([`super::output_cost`]).
//!
//! What `liquid` and `solids` add where both are there is their coupling, too. What that is by itself has a row of its own ([`COUPLING`]): the
//! scene less its liquid alone less its solids alone.
//!
//! What an absent effect costs is measured in the same way, against the control: one more path, of the scene from which all that it does not
//! have is taken away. Bytes and dispatches have to be the same. What seconds can differ by without a cause is measured against a path of the
//! very same scene ([`ITSELF`]): less is not told apart from nothing.

mod left_out;
mod pairs;
mod picture;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Instant;

use serde::Serialize;

use crate::Error;
use crate::effects::Effects;
use crate::gpu::{AdapterChoice, Gpu};
use crate::output::FolderLock;
use crate::scene::Scene;
use crate::sim::{Backend, GpuPath, Simulation};
use crate::state::State;

use super::output_cost::{self, OutputRow, Scratch};
use super::statistics::Spread;
use super::table::{Machine, Table, write_csv, write_json};

pub use left_out::{EFFECTS, Effect, OfKind, PROBES};
use pairs::{Pair, Taken};

/// Of the shuffling: the same order in every run.
const SEED: u64 = 7;
/// Name of the row of the control, of which the rows of all absent effects are copies.
pub const ABSENT: &str = "absent";
/// Name of the row of the scene against the same scene on a path of its own: the noise of the run.
pub const ITSELF: &str = "itself";
/// Name of the row of what coupling adds. It cannot be taken away, as there is no scene with liquid and solids that do not feel each other
/// (weak coupling clips and pushes, too): without it there are two scenes, one without solids and one without liquid, and their sub-steps from
/// the same state are added. What both need, as obstacles and the device's own buffers, is counted twice, and probes of forces go with it.
pub const COUPLING: &str = "coupling";
/// Chance with which the seconds of an absent effect that costs nothing fail a scene, at most. Twelve pairs then have to go all one way, which
/// has a chance of 1 to 4096; below ten pairs nothing fails.
const FALSE_ALARM: f64 = 1e-3;

/// What to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Scenes, scaled.
    pub scenes: Vec<Scene>,
    /// Frames of each; effects are left out of the sub-step after each of them.
    pub frames: u64,
    /// Where.
    pub adapter: AdapterChoice,
}

/// A row of effects.csv. What was not measured is empty: without a present effect nothing would be left of the scene.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Row {
    /// Name of the scene.
    pub scene: String,
    /// The effect, a kind of probes ([`PROBES`]), [`COUPLING`], [`ABSENT`] or [`ITSELF`].
    pub effect: &'static str,
    /// Whether the scene has it, as it has itself. Where not, the numbers are those of the control.
    pub present: bool,
    /// Seconds of a sub-step of the scene, median.
    pub seconds_with: Option<f64>,
    /// Without the effect.
    pub seconds_without: Option<f64>,
    /// Median of the differences.
    pub seconds_added: Option<f64>,
    /// Their first quartile.
    pub seconds_added_low: Option<f64>,
    /// Their third.
    pub seconds_added_high: Option<f64>,
    /// What the seconds tell: `adds`, `saves`, `not told apart from nothing` where the interval that follows holds 0 or the median is within
    /// what the scene against itself spans, or `too few pairs` where there is no such interval.
    pub seconds_told: &'static str,
    /// Lower end of an interval that holds the true median of the differences with a chance of at least 95 %, whatever their distribution:
    /// two of them in order, of twelve the third and the tenth (96 %). Empty below six pairs.
    pub seconds_told_low: Option<f64>,
    /// Its upper end.
    pub seconds_told_high: Option<f64>,
    /// Bytes of the buffers that it adds, at the end of the run: room for what solids cut grows on the way. Negative where the scene without it
    /// needs others. Without copies for the host that outputs make.
    pub bytes_added: Option<i64>,
    /// Dispatches that it adds to a sub-step outside of the solve, median of the pairs (of an even number the lower one in the middle).
    pub dispatches_added: Option<i64>,
    /// Pairs in which the sub-steps have other numbers of these.
    pub dispatches_differ: Option<usize>,
    /// Dispatches that it adds to the solve, median as above. They go with its iterations, which the device is given in batches.
    pub solve_dispatches_added: Option<i64>,
    /// Kernels that are compiled for it alone: the scene without it does not have them.
    pub kernels: String,
    /// Pairs of sub-steps.
    pub pairs: usize,
    /// Those in which the scene with it took longer.
    #[serde(skip)]
    pub slower: usize,
}

impl Row {
    /// First quartile, median and third of the seconds that it adds.
    fn quartiles(&self) -> Option<[f64; 3]> {
        Some([
            self.seconds_added_low?,
            self.seconds_added?,
            self.seconds_added_high?,
        ])
    }

    /// Whether the row, of the control, says that effects which are absent cost something. Of seconds with a chance of an error of
    /// [`FALSE_ALARM`] at most, by a sign test, and only where they are beyond what the scene differs by from itself.
    fn costs(&self) -> bool {
        let counts = [
            self.bytes_added,
            self.dispatches_added,
            self.solve_dispatches_added,
        ];
        let same = counts == [Some(0); 3] && self.dispatches_differ == Some(0);
        let chance = pairs::at_most(self.pairs - self.slower, self.pairs);
        let slower = self.seconds_told == pairs::ADDS && chance <= FALSE_ALARM;
        !(same && self.kernels.is_empty()) || slower
    }
}

/// What was measured.
#[derive(Clone, Debug)]
pub struct Tables {
    /// Of the effects.
    pub effects: Table<Row>,
    /// Of the outputs.
    pub outputs: Table<OutputRow>,
}

impl Tables {
    /// Writes what there is.
    fn write(&self, out: &Path) -> Result<(), Error> {
        write_csv(&self.effects.rows, &out.join("effects.csv"))?;
        write_json(&self.effects, &out.join("effects.json"))?;
        picture::write(&self.effects.rows, &out.join("effects.svg"))?;
        write_csv(&self.outputs.rows, &out.join("outputs.csv"))?;
        write_json(&self.outputs, &out.join("outputs.json"))
    }

    /// Names every scene in which absent effects cost something.
    ///
    /// # Errors
    /// [`Error::Check`] where there is one.
    pub fn verdict(&self) -> Result<(), Error> {
        let control = self.effects.rows.iter().filter(|row| row.effect == ABSENT);
        let costs = control.filter(|row| row.costs()).map(|row| {
            format!(
                "\n  {}: bytes {}, dispatches {} and in the solve {} (in {} of {} pairs), kernels: {}; seconds {:.2e}, more in {} pairs",
                row.scene,
                row.bytes_added.unwrap_or_default(),
                row.dispatches_added.unwrap_or_default(),
                row.solve_dispatches_added.unwrap_or_default(),
                row.dispatches_differ.unwrap_or_default(),
                row.pairs,
                row.kernels,
                row.seconds_added.unwrap_or_default(),
                row.slower,
            )
        });
        let costs: Vec<String> = costs.collect();
        if costs.is_empty() {
            return Ok(());
        }
        Err(Error::Check(format!(
            "effects that a scene does not have cost something{}",
            costs.concat()
        )))
    }
}

/// A row that is done.
#[derive(Clone, Copy, Debug)]
pub enum Told<'a> {
    /// Of an effect.
    Effect(&'a Row),
    /// Of an output.
    Output(&'a OutputRow),
}

/// A scene that is timed.
struct Run {
    scene: Scene,
    simulation: Simulation,
    /// Buffers that were made for it at the start.
    at_start: usize,
}

impl Run {
    fn new(scene: Scene, adapter: &AdapterChoice) -> Result<Run, Error> {
        let simulation = Simulation::new(&scene, &Backend::Gpu(adapter.clone()))?;
        let mut run = Run {
            scene,
            simulation,
            at_start: 0,
        };
        run.at_start = run.gpu().allocated().len();
        Ok(run)
    }

    fn gpu(&self) -> &Gpu {
        self.simulation.gpu().expect("benches run on the GPU path")
    }

    /// Bytes of its buffers now.
    fn bytes(&self) -> u64 {
        bytes_in_use(&self.gpu().allocated(), self.at_start)
    }

    /// What a sub-step from a state of the whole scene takes, with its probes.
    fn time(&mut self, state: &State) -> Result<Taken, Error> {
        let mut state = state.clone();
        if self.scene.solids.is_empty() {
            state.displacement.clear();
            state.node_velocity.clear();
        }
        let markers = Effects::of(&self.scene).markers;
        if !markers {
            state.markers.clear();
        }
        // Without sources there is no room for what they have emitted.
        let room = self.simulation.gpu_path().and_then(GpuPath::marker_room);
        state.markers.truncate(room.unwrap_or(0));
        self.simulation.reset(&state)?;
        self.gpu().start_trace();
        let clock = Instant::now();
        self.simulation.step()?;
        self.simulation.probes()?;
        let seconds = clock.elapsed().as_secs_f64();
        let noted = self.gpu().take_trace().dispatches;
        let solve = noted.iter().filter(|(stage, _)| *stage == "solve").count();
        Ok(Taken {
            seconds,
            dispatches: noted.len() - solve,
            solve_dispatches: solve,
        })
    }

    fn kernels(&self) -> BTreeSet<&'static str> {
        self.gpu().compiled()
    }
}

/// Bytes of the buffers in use, of the labels and bytes of all that were made, the first `at_start` of them before the first sub-step. Those that
/// outgrow their room are made anew, all of a label together. Copies for the host are those of the start: later ones are of one download.
fn bytes_in_use(made: &[(String, u64)], at_start: usize) -> u64 {
    let mut of_label: BTreeMap<&str, (usize, Vec<u64>)> = BTreeMap::new();
    for (at, (label, bytes)) in made.iter().enumerate() {
        let (first, all) = of_label.entry(label).or_default();
        *first += usize::from(at < at_start);
        all.push(*bytes);
    }
    let sums = of_label.into_iter().map(|(label, (first, all))| {
        let in_use = match label.ends_with("(read-back)") {
            true => &all[..first],
            false => &all[all.len() - first.max(1)..],
        };
        in_use.iter().sum::<u64>()
    });
    sums.sum()
}

/// A scene without something, and its pairs of sub-steps with the whole scene.
struct Part {
    name: &'static str,
    run: Run,
    pairs: Vec<Pair>,
}

/// Measures all scenes and writes effects.csv, effects.json, effects.svg, outputs.csv and outputs.json into `out`, anew after each; `tell` hears
/// of each row.
///
/// # Errors
/// [`Error::Output`], before anything is measured where nothing can be written into `out`; and what the simulations say.
pub fn bench_effects(
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(Told),
) -> Result<Tables, Error> {
    let _held = FolderLock::take(out)?;
    let scratch = Scratch::new(out)?;
    // A device of its own: nothing of this is counted.
    let machine = Machine::new(&Gpu::new(&options.adapter)?, 3)?;
    let mut tables = Tables {
        effects: Table {
            machine: machine.clone(),
            rows: Vec::new(),
        },
        outputs: Table {
            machine,
            rows: Vec::new(),
        },
    };
    for scene in &options.scenes {
        let (effects, outputs) = measure(scene, options, &scratch.frames())?;
        effects.iter().for_each(|row| tell(Told::Effect(row)));
        outputs.iter().for_each(|row| tell(Told::Output(row)));
        tables.effects.rows.extend(effects);
        tables.outputs.rows.extend(outputs);
        tables.write(out)?;
    }
    Ok(tables)
}

/// States of a scene at its start and after each frame.
fn states(scene: &Scene, options: &Options) -> Result<Vec<State>, Error> {
    let mut simulation = Simulation::new(scene, &Backend::Gpu(options.adapter.clone()))?;
    let mut states = vec![simulation.state()?];
    for frame in 0..options.frames {
        while simulation.clock().frame == frame {
            simulation.step()?;
        }
        states.push(simulation.state()?);
    }
    Ok(states)
}

/// Rows of the effects and of the outputs of a scene; frames are written into `folder` and removed.
fn measure(
    scene: &Scene,
    options: &Options,
    folder: &Path,
) -> Result<(Vec<Row>, Vec<OutputRow>), Error> {
    // On a path of their own: what grows on the way to them would be in the scene's counts and not in the others'.
    let states = states(scene, options)?;
    let mut whole = Run::new(scene.clone(), &options.adapter)?;
    let mut parts = parts(scene, options)?;
    let mut random = fastrand::Rng::with_seed(SEED);
    // The first compiles and warms caches.
    for (sample, state) in states.iter().enumerate() {
        random.shuffle(&mut parts);
        for part in &mut parts {
            let pair = match sample % 2 {
                0 => {
                    let with = whole.time(state)?;
                    [with, part.run.time(state)?]
                }
                _ => {
                    let without = part.run.time(state)?;
                    [whole.time(state)?, without]
                }
            };
            if sample > 0 {
                part.pairs.push(Pair(pair));
            }
        }
    }
    let rows = rows(scene, &whole, &parts);
    let outputs = output_cost::measure(scene, &mut whole.simulation, &states, folder, &mut random)?;
    Ok((rows, outputs))
}

/// Kinds of probes that a scene has.
fn kinds_of_probes(scene: &Scene) -> Vec<&'static str> {
    let has = |is: OfKind| scene.probes.iter().any(|probe| is(&probe.kind));
    let kinds = PROBES.iter().filter(|(_, is)| has(*is));
    kinds.map(|(name, _)| *name).collect()
}

/// The scene without each of its effects, the control, and the scene once more. A kind of probes that is the only one is all probes.
fn parts(scene: &Scene, options: &Options) -> Result<Vec<Part>, Error> {
    let effects = Effects::of(scene);
    let mut scenes = Vec::new();
    let mut control = scene.clone();
    for effect in &EFFECTS {
        if !(effect.present)(&effects) {
            (effect.without)(&mut control);
            continue;
        }
        let mut without = scene.clone();
        (effect.without)(&mut without);
        let left = Effects::of(&without);
        // A scene of nothing is none.
        if left.liquid || left.solids {
            scenes.push((effect.name, without));
        }
    }
    let kinds = kinds_of_probes(scene);
    let kinds = PROBES
        .iter()
        .filter(|(name, _)| kinds.len() > 1 && kinds.contains(name));
    for (name, is) in kinds {
        let mut without = scene.clone();
        without.probes.retain(|probe| !is(&probe.kind));
        scenes.push((name, without));
    }
    scenes.extend([(ABSENT, control), (ITSELF, scene.clone())]);
    let parts = scenes.into_iter().map(|(name, scene)| {
        Ok(Part {
            name,
            run: Run::new(scene, &options.adapter)?,
            pairs: Vec::new(),
        })
    });
    parts.collect()
}

/// Rows of the effects of a scene.
fn rows(scene: &Scene, whole: &Run, parts: &[Part]) -> Vec<Row> {
    let effects = Effects::of(scene);
    let part = |name: &str| parts.iter().find(|part| part.name == name);
    let control = part(ABSENT).expect("there is a control");
    let itself = part(ITSELF).expect("there is the scene once more");
    let noise = pairs::noise(&itself.pairs);
    let kinds = kinds_of_probes(scene);
    let of_effects = EFFECTS
        .iter()
        .map(|effect| (effect.name, (effect.present)(&effects)));
    let of_probes = PROBES.iter().map(|(name, _)| (*name, kinds.contains(name)));
    let names = of_effects
        .chain([(COUPLING, effects.coupling)])
        .chain(of_probes)
        .chain([(ABSENT, false), (ITSELF, true)]);
    let rows = names.map(|(effect, present)| {
        let row = Row {
            scene: scene.name.clone(),
            effect,
            present,
            ..Row::default()
        };
        let told =
            |pairs: &[Pair], without: &[&Part]| compared(row.clone(), pairs, noise, whole, without);
        if !present {
            return told(&control.pairs, &[control]);
        }
        if effect == COUPLING
            && let (Some(liquid), Some(solids)) = (part("solids"), part("liquid"))
        {
            let pairs = liquid.pairs.iter().zip(&solids.pairs);
            let pairs: Vec<Pair> = pairs.map(|(a, b)| a.against_both(b)).collect();
            return told(&pairs, &[liquid, solids]);
        }
        let only = (kinds == [effect]).then(|| part("probes")).flatten();
        match part(effect).or(only) {
            Some(part) => told(&part.pairs, &[part]),
            // What is left without it is no scene: the whole is all there is to time.
            None => Row {
                seconds_with: Some(pairs::median(&control.pairs, |pair| pair.0[0].seconds)),
                ..row
            },
        }
    });
    rows.collect()
}

/// A row with what the pairs say of the whole scene and of what is left without something.
fn compared(row: Row, pairs: &[Pair], noise: Option<f64>, whole: &Run, without: &[&Part]) -> Row {
    let [low, added, high] = Spread::quartiles(pairs::added(pairs));
    let interval = pairs::interval(pairs::added(pairs));
    let bytes: u64 = without.iter().map(|part| part.run.bytes()).sum();
    let others: BTreeSet<&str> = without.iter().flat_map(|part| part.run.kernels()).collect();
    let alone: Vec<&str> = whole.kernels().difference(&others).copied().collect();
    Row {
        seconds_with: Some(pairs::median(pairs, |pair| pair.0[0].seconds)),
        seconds_without: Some(pairs::median(pairs, |pair| pair.0[1].seconds)),
        seconds_added: Some(added),
        seconds_added_low: Some(low),
        seconds_added_high: Some(high),
        seconds_told: pairs::told(interval, added, noise),
        seconds_told_low: interval.map(|[low, _]| low),
        seconds_told_high: interval.map(|[_, high]| high),
        bytes_added: Some(whole.bytes() as i64 - bytes as i64),
        dispatches_added: Some(pairs::middle(pairs, |taken| taken.dispatches)),
        dispatches_differ: Some(pairs::differing(pairs)),
        solve_dispatches_added: Some(pairs::middle(pairs, |taken| taken.solve_dispatches)),
        kernels: alone.join(" "),
        pairs: pairs.len(),
        slower: pairs::added(pairs).iter().filter(|s| **s > 0.0).count(),
        ..row
    }
}

#[cfg(test)]
mod tests {
    use super::{Row, bytes_in_use, pairs};

    #[test]
    fn a_buffer_that_grew_counts_once() {
        let made = |list: &[(&str, u64)]| -> Vec<(String, u64)> {
            let list = list.iter();
            list.map(|(label, bytes)| ((*label).to_owned(), *bytes))
                .collect()
        };
        let start = [("a", 1), ("b", 10), ("b", 20), ("c (read-back)", 100)];
        assert_eq!(bytes_in_use(&made(&start), 4), 131);
        let grown = [("b", 30), ("b", 40), ("c (read-back)", 100)];
        let grown = [&start[..], &grown].concat();
        assert_eq!(bytes_in_use(&made(&grown), 4), 171, "b anew");
        let twice = [&grown[..], &[("b", 50), ("b", 60), ("d", 1000)]].concat();
        assert_eq!(bytes_in_use(&made(&twice), 4), 1211, "b again, and d");
        let download = [&start[..], &[("a (read-back)", 1)]].concat();
        assert_eq!(bytes_in_use(&made(&download), 4), 131, "what goes again");
    }

    /// A control that differs in nothing but seconds.
    fn control(pairs: usize, slower: usize) -> Row {
        Row {
            seconds_told: pairs::ADDS,
            bytes_added: Some(0),
            dispatches_added: Some(0),
            dispatches_differ: Some(0),
            solve_dispatches_added: Some(0),
            pairs,
            slower,
            ..Row::default()
        }
    }

    #[test]
    fn absent_effects_cost_what_chance_does_not() {
        // Chances of 1 to 4096, 13 to 4096, 1 to 1024 and 1 to 512.
        for (pairs, slower, costs) in [
            (12, 12, true),
            (12, 11, false),
            (10, 10, true),
            (9, 9, false),
        ] {
            assert_eq!(control(pairs, slower).costs(), costs, "{slower} of {pairs}");
        }
        let within_the_noise = Row {
            seconds_told: pairs::NOTHING,
            ..control(12, 12)
        };
        assert!(!within_the_noise.costs());
        for row in [
            Row {
                bytes_added: Some(-4),
                ..control(2, 1)
            },
            Row {
                dispatches_differ: Some(1),
                ..control(2, 1)
            },
            Row {
                solve_dispatches_added: Some(2),
                ..control(2, 1)
            },
            Row {
                kernels: "slip".to_owned(),
                ..control(2, 1)
            },
        ] {
            assert!(row.costs(), "{row:?}");
        }
    }
}
