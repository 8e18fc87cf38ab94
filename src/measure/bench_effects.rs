//! `bench effects`: what each effect of a scene adds to a sub-step, in time, bytes and dispatches.
//!
//! The scene runs; the state after each frame is given to the scene and to the same scene without one of its effects, for each of them.
//! Sub-steps with and without are done from the same state one after the other, in a shuffled order, so that what else the machine does
//! falls on both; the seconds that an effect adds are the median of the paired differences. Bytes are those of all buffers that are made for
//! the scene, dispatches all that are submitted in a sub-step, those of the solver's iterations too. What `solids` and `liquid` add where both
//! are there is their coupling, too. On the same states every output is timed, too ([`super::output_cost`]).
//!
//! What an absent effect costs is measured in the same way, against the control: one more path, of the scene from which all that it does not
//! have is taken away. Bytes and dispatches have to be the same; seconds differ by what the method cannot tell apart.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Instant;

use plotters::prelude::*;
use serde::Serialize;

use crate::Error;
use crate::effects::Effects;
use crate::gpu::{AdapterChoice, Gpu};
use crate::grid::Sides;
use crate::output::FolderLock;
use crate::scene::{ElasticModel, Liquid, PatchPressure, Scene, Solid, Surface};
use crate::sim::{Backend, GpuPath, Simulation};
use crate::state::State;

use super::chart::ink;
use super::output_cost::{self, OutputRow, Scratch};
use super::statistics::Spread;
use super::table::{Machine, Table, write_csv, write_json, write_svg};

/// Of the shuffling: the same order in every run.
const SEED: u64 = 7;
/// Name of the row of the control, of which the rows of all absent effects are copies.
pub const ABSENT: &str = "absent";

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
    /// The effect, or [`ABSENT`].
    pub effect: &'static str,
    /// Whether the scene has it. Where not, the numbers are those of the control.
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
    /// Bytes of the buffers that it adds; negative where the scene without it needs others.
    pub bytes_added: Option<i64>,
    /// Dispatches that it adds to the last of the sub-steps, iterations of the solver included.
    pub dispatches_added: Option<i64>,
    /// Kernels that are compiled for it alone: the scene without it does not have them.
    pub kernels: String,
    /// Pairs of sub-steps.
    pub pairs: usize,
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
        write_svg(&out.join("effects.svg"), (900, 600), |page| {
            draw(&self.effects.rows, page)
        })?;
        write_csv(&self.outputs.rows, &out.join("outputs.csv"))?;
        write_json(&self.outputs, &out.join("outputs.json"))
    }

    /// Names every scene in which absent effects cost something other than time.
    ///
    /// # Errors
    /// [`Error::Check`] where there is one.
    pub fn verdict(&self) -> Result<(), Error> {
        let control = self.effects.rows.iter().filter(|row| row.effect == ABSENT);
        let costs = control.filter(|row| {
            let nothing = [row.bytes_added, row.dispatches_added] == [Some(0); 2];
            !(nothing && row.kernels.is_empty())
        });
        let costs: Vec<String> = costs
            .map(|row| {
                format!(
                    "\n  {}: bytes {}, dispatches {}, kernels: {}",
                    row.scene,
                    row.bytes_added.unwrap_or_default(),
                    row.dispatches_added.unwrap_or_default(),
                    row.kernels,
                )
            })
            .collect();
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

/// An effect that can be left out.
#[derive(Clone, Copy, Debug)]
pub struct Effect {
    /// Its name, as in [`Effects`].
    pub name: &'static str,
    /// Whether a scene has it.
    pub present: fn(&Effects) -> bool,
    /// Takes it away, and with it what cannot be without it.
    pub without: fn(&mut Scene),
}

/// Those that can be left out, in the order of [`Effects`].
pub const EFFECTS: [Effect; 16] = [
    Effect {
        name: "liquid",
        present: |effects| effects.liquid,
        without: |scene| {
            scene.liquid = None;
            close(scene);
            scene.probes.retain(|probe| probe.kind.of_solid());
        },
    },
    Effect {
        name: "markers",
        present: |effects| effects.markers,
        without: |scene| {
            of_liquid(scene, |liquid| liquid.surface = Surface::Fixed);
            close(scene);
        },
    },
    Effect {
        name: "volume_control",
        present: |effects| effects.volume_control,
        without: |scene| of_liquid(scene, |_| {}),
    },
    Effect {
        name: "open_sides",
        present: |effects| effects.open_sides,
        without: |scene| scene.domain.open = Sides::default(),
    },
    Effect {
        name: "sources",
        present: |effects| effects.sources,
        without: |scene| scene.sources.clear(),
    },
    Effect {
        name: "sinks",
        present: |effects| effects.sinks,
        without: |scene| scene.sinks.clear(),
    },
    Effect {
        name: "solids",
        present: |effects| effects.solids,
        without: |scene| {
            scene.solids.clear();
            scene.probes.retain(|probe| probe.kind.of_liquid());
        },
    },
    Effect {
        name: "corotation",
        present: |effects| effects.corotation,
        without: |scene| of_solids(scene, |solid| solid.model = ElasticModel::Linear),
    },
    Effect {
        name: "damping",
        present: |effects| effects.damping,
        without: |scene| {
            of_solids(scene, |solid| {
                (solid.mass_damping, solid.stiffness_damping) = (0.0, 0.0);
            });
        },
    },
    Effect {
        name: "pins",
        present: |effects| effects.pins,
        without: |scene| {
            of_solids(scene, |solid| {
                solid.pins.retain(|pin| !pin.keyframes.is_empty())
            });
        },
    },
    Effect {
        name: "scripts",
        present: |effects| effects.scripts,
        without: |scene| {
            of_solids(scene, |solid| {
                solid.pins.retain(|pin| pin.keyframes.is_empty())
            });
        },
    },
    Effect {
        name: "loads",
        present: |effects| effects.loads,
        without: |scene| of_solids(scene, |solid| solid.loads.clear()),
    },
    Effect {
        name: "obstacles",
        present: |effects| effects.obstacles,
        without: |scene| scene.obstacles.clear(),
    },
    Effect {
        name: "moving_obstacles",
        present: |effects| effects.moving_obstacles,
        // They stand where they were at first. Without liquid nothing sees what moves, and solids would see what stands.
        without: |scene| {
            if scene.liquid.is_some() {
                let obstacles = scene.obstacles.iter_mut();
                obstacles.for_each(|obstacle| obstacle.motion = None);
            }
        },
    },
    Effect {
        name: "patch_correction",
        present: |effects| effects.patch_correction,
        without: |scene| scene.solver.pressure_on_patches = PatchPressure::Cell,
    },
    Effect {
        name: "probes",
        present: |effects| effects.probes,
        without: |scene| scene.probes.clear(),
    },
];

/// Changes the liquid, whose volume nobody holds then.
fn of_liquid(scene: &mut Scene, change: fn(&mut Liquid)) {
    if let Some(liquid) = &mut scene.liquid {
        change(liquid);
        liquid.volume_control = false;
    }
}

/// Takes away what brings liquid in or lets it out, which only markers know.
fn close(scene: &mut Scene) {
    (scene.sources, scene.sinks) = (Vec::new(), Vec::new());
    scene.domain.open = Sides::default();
}

fn of_solids(scene: &mut Scene, change: fn(&mut Solid)) {
    scene.solids.iter_mut().for_each(change);
}

/// A scene that is timed.
struct Run {
    scene: Scene,
    simulation: Simulation,
    /// Bytes of all buffers that were made for it at the start: room for what solids cut grows with them later.
    bytes: u64,
    /// Stage and kernel of each dispatch of the last sub-step.
    dispatches: Vec<(&'static str, &'static str)>,
}

impl Run {
    fn new(scene: Scene, adapter: &AdapterChoice) -> Result<Run, Error> {
        let simulation = Simulation::new(&scene, &Backend::Gpu(adapter.clone()))?;
        let mut run = Run {
            scene,
            simulation,
            bytes: 0,
            dispatches: Vec::new(),
        };
        run.bytes = run.gpu().allocated().iter().map(|(_, bytes)| bytes).sum();
        Ok(run)
    }

    fn gpu(&self) -> &Gpu {
        self.simulation.gpu().expect("benches run on the GPU path")
    }

    /// Seconds of a sub-step from a state of the whole scene, with its probes.
    fn time(&mut self, state: &State) -> Result<f64, Error> {
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
        self.gpu().note_dispatches();
        let clock = Instant::now();
        self.simulation.step()?;
        self.simulation.probes()?;
        let seconds = clock.elapsed().as_secs_f64();
        self.dispatches = self.gpu().noted_dispatches();
        Ok(seconds)
    }

    fn kernels(&self) -> BTreeSet<&'static str> {
        self.gpu().compiled()
    }
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
    let effects = Effects::of(scene);
    let mut parts = Vec::new();
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
            let run = Run::new(without, &options.adapter)?;
            parts.push((effect.name, run, Vec::<[f64; 2]>::new()));
        }
    }
    let control = Run::new(control, &options.adapter)?;
    parts.push((ABSENT, control, Vec::new()));
    let mut random = fastrand::Rng::with_seed(SEED);
    // The first compiles and warms caches.
    for (sample, state) in states.iter().enumerate() {
        random.shuffle(&mut parts);
        for (_, part, pairs) in &mut parts {
            let mut seconds = [0.0; 2];
            let mut order = [0, 1];
            random.shuffle(&mut order);
            for which in order {
                seconds[which] = match which {
                    0 => whole.time(state)?,
                    _ => part.time(state)?,
                };
            }
            if sample > 0 {
                pairs.push(seconds);
            }
        }
    }
    let present = EFFECTS
        .iter()
        .map(|effect| (effect.name, (effect.present)(&effects)));
    let rows = present.chain([(ABSENT, false)]).map(|(effect, present)| {
        let row = Row {
            scene: scene.name.clone(),
            effect,
            present,
            ..Row::default()
        };
        let beside = if present { effect } else { ABSENT };
        let Some((_, part, pairs)) = parts.iter().find(|(name, ..)| *name == beside) else {
            return row;
        };
        let median =
            |which: usize| Spread::of(pairs.iter().map(|pair| pair[which]).collect()).median;
        let [low, added, high] =
            Spread::quartiles(pairs.iter().map(|[with, without]| with - without).collect());
        let alone = &whole.kernels() - &part.kernels();
        Row {
            seconds_with: Some(median(0)),
            seconds_without: Some(median(1)),
            seconds_added: Some(added),
            seconds_added_low: Some(low),
            seconds_added_high: Some(high),
            bytes_added: Some(whole.bytes as i64 - part.bytes as i64),
            dispatches_added: Some(whole.dispatches.len() as i64 - part.dispatches.len() as i64),
            kernels: alone.into_iter().collect::<Vec<_>>().join(" "),
            pairs: pairs.len(),
            ..row
        }
    });
    let rows = rows.collect();
    let outputs = output_cost::measure(scene, &mut whole.simulation, &states, folder, &mut random)?;
    Ok((rows, outputs))
}

/// What each effect adds, in milliseconds: a bar from the first to the third quartile with the median, per scene and effect that was measured,
/// and one for all that are absent.
fn draw(rows: &[Row], page: SVGBackend) -> Result<(), Box<dyn std::error::Error>> {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let drawn = rows
        .iter()
        .filter(|row| row.present || row.effect == ABSENT);
    let measured: Vec<(&Row, [f64; 3])> = drawn
        .filter_map(|row| Some((row, row.quartiles()?.map(|seconds| 1e3 * seconds))))
        .collect();
    let ends = measured
        .iter()
        .flat_map(|(_, [low, _, high])| [*low, *high]);
    let (least, most) = ends.fold((0.0, 1e-3), |(least, most), x| {
        (f64::min(least, x), f64::max(most, x))
    });
    let margin = 0.05 * (most - least);
    let mut chart = ChartBuilder::on(&root)
        .caption("what effects add to a sub-step", ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(220)
        .build_cartesian_2d(
            least - margin..most + margin,
            (0..measured.len()).into_segmented(),
        )?;
    let label = |at: &SegmentValue<usize>| match at {
        SegmentValue::CenterOf(at) | SegmentValue::Exact(at) => {
            measured.get(*at).map_or(String::new(), |(row, _)| {
                format!("{}: {}", row.scene, row.effect)
            })
        }
        SegmentValue::Last => String::new(),
    };
    chart
        .configure_mesh()
        .disable_y_mesh()
        .x_desc("ms")
        .y_labels(measured.len().max(1))
        .y_label_formatter(&label)
        .draw()?;
    for (at, (_, [low, median, high])) in measured.iter().enumerate() {
        let (bottom, top) = (SegmentValue::Exact(at), SegmentValue::Exact(at + 1));
        let bar = Rectangle::new([(*low, bottom), (*high, top)], ink(at).mix(0.6).filled());
        chart.draw_series([bar])?;
        let line = [
            (*median, SegmentValue::Exact(at)),
            (*median, SegmentValue::Exact(at + 1)),
        ];
        chart.draw_series([PathElement::new(line, BLACK)])?;
    }
    root.present()?;
    Ok(())
}
