//! `bench step`: seconds of sub-steps and of their stages.
//!
//! The host times a sub-step from the upload of its numbers to its diagnostics; stages have device timestamps. Scenes run from their start, in rounds.
//! The first sub-step of each kind compiles and is not counted. Every run of a scene has the same sub-steps.

mod sizes;

use std::time::Instant;

use super::chart::{Bars, Page};
use super::statistics::{Spread, grouped};
use super::sub_step::stage_seconds;
use super::table::{Row, Table, Value, columns, row};
use super::{
    Bench, GROWTH, Listener, Machine, Results, Rows, Run, Settings, TRAFFIC, allocated_bytes, growth, hashes, replace,
    rows, traffic_counts,
};
use crate::Error;
use crate::gpu::{AdapterChoice, Gpu, Trace};
use crate::sim::{Backend, GpuPath, Simulation};
use crate::state::{SolveReport, StepReport};
use crate::step::Stage;

pub use sizes::{Case, largest, largest_scale, units};

/// Scenes to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Scaled scenes; a scene may appear at several scales.
    pub scenes: Vec<Case>,
    /// Frames of each run.
    pub frames: u64,
    /// Adapter.
    pub adapter: AdapterChoice,
}

columns! {
    /// Identity of the sub-steps of a kind.
    KIND {
        scene = "" "name of the scene";
        scale + "" "factor of its cells";
        solids_scale - "" "refinement of its solids' meshes";
        kind + "" "`touching`: liquid and solids touch; `apart`: the others";
    }
    /// Sub-steps.
    STEP {
        cells + "" "cells of the domain";
        nodes + "" "nodes of the solids";
        elements - "" "elements of the solids";
        sub_steps + "" "sub-steps of a run";
        simulated - "s" "time that they simulate";
        markers - "" "markers after the last of them";
        unknowns + "" "unknowns of the pressure, mean over the sub-steps";
        band_cells - "" "cells of the narrow band, mean";
        iterations + "" "iterations of the pressure, mean";
        solid_unknowns - "" "unknowns of the solids, mean";
        solid_iterations - "" "iterations of the solids, mean";
        runs - "" "runs from the start";
        seconds ~ "s" "mean over the sub-steps of a run; spread over the runs";
        sub_step_seconds ~ "s" "median over the runs; spread over the sub-steps";
        cells_per_second - "1/s" "unknowns of the pressure over `seconds_median`";
    }
    /// A stage in these sub-steps.
    STAGE {
        stage - "" "name of the stage";
        where - "" "where its seconds are spent: `device`, `host`, `host and device`";
        seconds ~ "s" "as in step.csv";
        dispatches - "" "mean";
        waits - "" "waits after a submission that ends with this stage, mean";
    }
    SERIES {
        scene = "" "name of the scene";
        kind + "" "as in step.csv";
    }
}

fn bench() -> Bench {
    let key: &[&str] = &["scene", "scale", "solids_scale", "kind"];
    let stage: &[&str] = &["scene", "scale", "solids_scale", "kind", "stage"];
    Bench {
        name: "step",
        tables: vec![
            Table::new("step", &[KIND, STEP, TRAFFIC], key),
            Table::new("step_stages", &[KIND, STAGE], stage),
            Table::new("step_growth", &[SERIES, GROWTH], &[]),
        ],
        derive,
        pictures: &[("step", draw)],
    }
}

/// Measures all scenes: step.csv, step_stages.csv, step_growth.csv, step.json, step.svg, rewritten after each run.
///
/// # Errors
/// [`Error::Output`]; [`Error::Check`] where the runs of a scene differ; errors of the simulations.
pub fn measure(options: &Options, settings: &Settings, listener: Listener) -> Result<Results, Error> {
    if options.scenes.is_empty() {
        return Err(Error::input("bench step", "no scene to measure", "give one scene file or more"));
    }
    let machine = Machine::new(&Gpu::new(&options.adapter)?, settings.repeats)?;
    let request = (hashes(options.scenes.iter().map(|case| &case.scene)), options.frames);
    let mut run = Run::start(bench(), machine, &request, settings, listener)?;
    // Scenes without all their runs are measured again.
    let repeats = settings.repeats.max(1);
    let table = &mut run.results.tables[0];
    table.rows.retain(|row| row.count("runs") == repeats);
    let new = options.scenes.iter().filter(|case| !table.has(&case.key()));
    let record = |case| Record { case, sizes: Row::default(), timestamps: false, repeats: Vec::new() };
    let mut records: Vec<Record> = new.map(record).collect();
    let (clock, n) = (Instant::now(), records.len());
    for round in 0..repeats {
        for (number, record) in records.iter_mut().enumerate() {
            if record.seconds() > settings.seconds {
                continue;
            }
            record.run(options)?;
            run.put(record.rows())?;
            run.progress("runs", round * n + number + 1, repeats * n, clock);
        }
    }
    Ok(run.results)
}

/// Measurements of a scene.
struct Record<'a> {
    case: &'a Case,
    /// Columns of the solids and of the bytes of all buffers, at the start of the last run.
    sizes: Row,
    /// Whether the device has timestamps.
    timestamps: bool,
    /// Sub-steps of each run, without the first of each kind.
    repeats: Vec<Vec<Sample>>,
}

/// One sub-step.
struct Sample {
    seconds: f64,
    report: StepReport,
    idle_seconds: f64,
    /// Numbers that `step.csv` has as means.
    numbers: Row,
    trace: Trace,
}

fn path_of(simulation: &Simulation) -> &GpuPath {
    simulation.gpu_path().expect("benches run on the GPU path")
}

impl Record<'_> {
    /// Seconds of all runs.
    fn seconds(&self) -> f64 {
        self.repeats.iter().flatten().map(|sample| sample.seconds).sum()
    }

    /// Another run from the scene's start. Its simulation is dropped at the end: all scenes together may exceed the memory.
    fn run(&mut self, options: &Options) -> Result<(), Error> {
        let mut simulation = Simulation::new(&self.case.scene, &Backend::Gpu(options.adapter.clone()))?;
        let (gpu, solids) = (path_of(&simulation).gpu(), simulation.solids());
        self.timestamps = gpu.report().timestamps;
        self.sizes = row! {
            nodes: solids.rest.len(), elements: solids.elements.len(), device_bytes: allocated_bytes(gpu),
        };
        let (mut samples, mut kinds) = (Vec::new(), [false; 2]);
        while simulation.clock().frame < options.frames {
            let gpu = path_of(&simulation).gpu();
            gpu.start_trace();
            let (before, clock) = (gpu.traffic(), Instant::now());
            let report = simulation.step()?;
            let seconds = clock.elapsed().as_secs_f64();
            let path = path_of(&simulation);
            let traffic = path.gpu().traffic().since(before);
            let trace = path.gpu().take_trace();
            let solve = |solve: Option<SolveReport>| solve.map_or((0, 0), |solve| (solve.unknowns, solve.iterations));
            let (unknowns, iterations) = solve(report.liquid.map(|liquid| liquid.solve));
            let (solid_unknowns, solid_iterations) = solve(report.solid.map(|solid| solid.solve));
            let numbers = traffic_counts(&traffic).with(row! {
                unknowns: unknowns, iterations: iterations, solid_unknowns: solid_unknowns, solid_iterations: solid_iterations,
                band_cells: path.band_cells()?,
            });
            let sample = Sample { seconds, report, idle_seconds: traffic.idle_seconds, numbers, trace };
            // The first of a kind compiles.
            if std::mem::replace(&mut kinds[usize::from(sample.report.touching())], true) {
                samples.push(sample);
            }
        }
        self.repeats.push(samples);
        self.ensure_repeated()?;
        if self.repeats.iter().all(Vec::is_empty) {
            return Err(Error::input(
                format!("--frames {}", options.frames),
                "the first sub-step of a kind is not counted, and there was no other",
                "measure more frames",
            ));
        }
        Ok(())
    }

    /// Refuses a run with other sub-steps than the first: rows compare them one by one.
    fn ensure_repeated(&self) -> Result<(), Error> {
        let [first, .., again] = &self.repeats[..] else { return Ok(()) };
        let kinds = |repeat: &[Sample]| repeat.iter().map(|sample| sample.report.touching()).collect::<Vec<_>>();
        if kinds(first) == kinds(again) {
            return Ok(());
        }
        let [first, again] = [first, again].map(|repeat| {
            let touching = repeat.iter().filter(|sample| sample.report.touching());
            format!("{} sub-steps, {} touching", repeat.len(), touching.count())
        });
        Err(Error::Check(format!(
            "{}: the same run had {first}, then {again}\n  cure: use another adapter (--adapter) or driver: this one is not reproducible",
            self.case.scene.name
        )))
    }

    /// Rows of each kind of sub-steps, and of its stages.
    fn rows(&self) -> Rows {
        let mut rows = Vec::new();
        for (kind, touching) in [("apart", false), ("touching", true)] {
            let of_kind = |sample: &&Sample| sample.report.touching() == touching;
            let repeats: Vec<Vec<&Sample>> =
                self.repeats.iter().map(|repeat| repeat.iter().filter(of_kind).collect()).collect();
            if !repeats[0].is_empty() {
                rows.extend(self.kind_rows(kind, &repeats));
            }
        }
        rows
    }

    /// Rows of the sub-steps of a kind in each run. Numbers other than seconds are the same in all runs.
    fn kind_rows(&self, kind: &str, repeats: &[Vec<&Sample>]) -> Rows {
        let first = &repeats[0];
        let mean = |value: &dyn Fn(&Sample) -> f64| mean(first, value);
        let seconds = over_repeats(repeats, &|sample| sample.seconds);
        let sub_step = |n: usize| Spread::of(repeats.iter().map(|repeat| repeat[n].seconds).collect()).median;
        let kind = self.case.key().with(row! { kind: kind });
        let means = first[0].numbers.names().map(|name| (name, mean(&|sample| sample.numbers.number(name)).into()));
        let last = first.last().and_then(|sample| sample.report.liquid);
        let sizes = row! {
            cells: self.case.scene.grid().n_cells(), sub_steps: first.len(),
            simulated: first.iter().map(|sample| sample.report.dt).sum::<f64>(), markers: last.map_or(0, |liquid| liquid.markers),
            runs: repeats.len(), seconds: seconds, sub_step_seconds: Spread::of((0..first.len()).map(sub_step).collect()),
            cells_per_second: mean(&|sample| sample.numbers.number("unknowns")) / seconds.median,
            idle_seconds: over_repeats(repeats, &|sample| sample.idle_seconds).median,
        };
        let mut rows = vec![("step", kind.clone().with(self.sizes.clone()).with(sizes).with(Row::new(means)))];
        let names = first.iter().flat_map(|sample| &sample.report.seconds);
        for (stage, _) in grouped(names, |(stage, _)| Some(*stage)) {
            let seconds = over_repeats(repeats, &|sample| stage_seconds(&sample.report, &[stage]));
            let place = match (stage == Stage::Clip.name(), self.timestamps) {
                (false, _) => "device",
                (true, true) => "host and device",
                (true, false) => "host",
            };
            let mut row = kind.clone().with(row! {
                stage: stage, seconds: seconds,
                dispatches: mean(&|sample| sample.trace.dispatches.iter().filter(|(name, _)| *name == stage).count() as f64),
                waits: mean(&|sample| sample.trace.waits.iter().filter(|name| **name == stage).count() as f64),
            });
            row.set("where", place);
            rows.push(("step_stages", row));
        }
        rows
    }
}

/// Mean over sub-steps.
fn mean(samples: &[&Sample], value: &dyn Fn(&Sample) -> f64) -> f64 {
    samples.iter().map(|sample| value(sample)).sum::<f64>() / samples.len() as f64
}

/// Spread over the runs of their means.
fn over_repeats(repeats: &[Vec<&Sample>], value: &dyn Fn(&Sample) -> f64) -> Spread {
    Spread::of(repeats.iter().map(|samples| mean(samples, value)).collect())
}

/// Growth with the grid, the solids' meshes, and both.
pub fn derive(tables: &mut [Table]) {
    let mut all = Vec::new();
    let rows = rows(tables, "step");
    for along in ["cells", "nodes", "both"] {
        let size = if along == "nodes" { "nodes" } else { "cells" };
        let groups = grouped(rows, |row| {
            let series = row.only(&["scene", "kind"]);
            let (nodes, cells) = (row.get("nodes"), row.get("cells"));
            // Rounded, as scales are.
            let ratio = (1e6 * row.number("scale") / row.number("solids_scale")).round();
            Some(match along {
                "cells" => (series, nodes, 0.0),
                "nodes" => (series, cells, 0.0),
                _ => (series, Value::Empty, ratio),
            })
        });
        for ((series, fixed, _), members) in groups {
            let nodes = |row: &Row| row.get("nodes");
            let refined = members.iter().any(|row| nodes(row) != nodes(members[0]));
            let fixed = Some(fixed).filter(|fixed| *fixed != Value::Count(0));
            if along != "both" || refined {
                let names = series.with(row! { along: along, fixed: fixed });
                all.extend(growth(&members, size).map(|fit| fit.with(names)));
            }
        }
    }
    replace(tables, "step_growth", all);
}

/// Stages of each kind of sub-steps as bars, a mark at the seconds of the wall clock.
fn draw(results: &Results) -> Page {
    let lists = grouped(results.rows("step"), |row| Some(row.text("scene"))).into_iter().map(|(scene, rows)| {
        let bars = rows.into_iter().map(|row| {
            let key = row.only(&["scene", "scale", "solids_scale", "kind"]);
            let stages = results.rows("step_stages").iter();
            let mut end = 0.0;
            let parts = stages.filter(|stage| stage.contains(&key)).map(|stage| {
                let start = end;
                end += 1e3 * stage.number("seconds_median");
                (stage.text("stage").to_owned(), start, end)
            });
            let cells = row.count("cells");
            let name = match row.count("nodes") {
                0 => format!("{cells} cells"),
                nodes => format!("{cells} cells, {nodes} nodes, {}", row.text("kind")),
            };
            (name, parts.collect(), 1e3 * row.number("seconds_median"))
        });
        let title = format!("{scene}: a sub-step, {}", results.machine.name());
        Bars { title, axis: "ms", bars: bars.collect(), key: true }
    });
    Page::Bars(lists.collect())
}
