//! `bench step`: seconds of sub-steps and of their stages.
//!
//! The host times a sub-step from the upload of its numbers to its diagnostics; stages have device timestamps. Scenes run from their start, in rounds.
//! The first sub-step of each kind compiles and is not counted. Every run of a scene has the same sub-steps.

mod sizes;

use std::time::Instant;

use super::chart::{Bars, Page};
use super::statistics::{Spread, grouped};
use super::sub_step::stage_seconds;
use super::table::{Row, Table, columns, row};
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
        + scene "" "name of the scene";
        + scale "" "factor of its cells";
        - solids_scale "" "refinement of its solids' meshes";
        + kind "" "`touching`: liquid and solids touch; `apart`: the others";
    }
    /// Sub-steps.
    STEP {
        + cells "" "cells of the domain";
        + nodes "" "nodes of the solids";
        - elements "" "elements of the solids";
        + sub_steps "" "sub-steps of a run";
        - simulated "s" "time that they simulate";
        - markers "" "markers after the last of them";
        + unknowns "" "unknowns of the pressure, mean over the sub-steps";
        - band_cells "" "cells of the narrow band, mean";
        + iterations "" "iterations of the pressure, mean";
        - solid_unknowns "" "unknowns of the solids, mean";
        - solid_iterations "" "iterations of the solids, mean";
        - runs "" "runs from the start";
        ~ seconds "s" "mean over the sub-steps of a run; spread over the runs";
        ~ sub_step_seconds "s" "median over the runs; spread over the sub-steps";
        - cells_per_second "1/s" "unknowns of the pressure over `seconds_median`";
    }
    /// A stage in these sub-steps.
    STAGE {
        - stage "" "name of the stage";
        - where "" "where its seconds are spent: `device`, `host`, `host and device`";
        ~ seconds "s" "as in step.csv";
        - dispatches "" "mean";
        - waits "" "waits after a submission that ends with this stage, mean";
    }
    SERIES {
        + scene "" "name of the scene";
        + kind "" "as in step.csv";
    }
}

/// Measures all scenes: step.csv, step_stages.csv, step_growth.csv, step.json, step.svg, rewritten after each run.
///
/// # Errors
/// [`Error::Output`]; [`Error::Check`] where the runs of a scene differ; errors of the simulations.
pub fn measure(options: &Options, settings: &Settings, listener: Listener) -> Result<Results, Error> {
    let stage: &[&str] = &["scene", "scale", "solids_scale", "kind", "stage"];
    let key = &stage[..stage.len() - 1];
    let bench = Bench {
        name: "step",
        tables: vec![
            Table::new("step", &[KIND, STEP, TRAFFIC], key),
            Table::new("step_stages", &[KIND, STAGE], stage),
            Table::new("step_growth", &[SERIES, GROWTH], &[]),
        ],
        derive,
        pictures: &[("step", draw)],
    };
    let machine = Machine::new(&Gpu::new(&options.adapter)?, settings.repeats)?;
    let request = (hashes(options.scenes.iter().map(|case| &case.scene)), options.frames);
    let mut run = Run::start(bench, machine, &request, settings, listener)?;
    // Scenes without all their runs are measured again.
    let repeats = settings.repeats.max(1);
    let table = &mut run.results.tables[0];
    table.rows.retain(|row| row.count("runs") == repeats);
    let new = options.scenes.iter().filter(|case| !table.has(&case.key()));
    let record = |case| Record { case, sizes: Row::default(), timestamps: false, runs: Vec::new() };
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

struct Record<'a> {
    case: &'a Case,
    /// Columns of the solids and of the bytes of all buffers, at the start of the last run.
    sizes: Row,
    /// Whether the device has timestamps.
    timestamps: bool,
    /// Sub-steps of each run, without the first of each kind.
    runs: Vec<Vec<Sample>>,
}

struct Sample {
    seconds: f64,
    report: StepReport,
    /// Numbers that `step.csv` has as means.
    numbers: Row,
    trace: Trace,
}

impl Sample {
    fn kind(&self) -> &'static str {
        if self.report.touching() { "touching" } else { "apart" }
    }
}

fn path_of(simulation: &Simulation) -> &GpuPath {
    simulation.gpu_path().expect("benches run on the GPU path")
}

impl Record<'_> {
    /// Seconds of all runs.
    fn seconds(&self) -> f64 {
        self.runs.iter().flatten().map(|sample| sample.seconds).sum()
    }

    /// Another run from the scene's start. Its simulation is dropped at the end: all scenes together may exceed the memory.
    fn run(&mut self, options: &Options) -> Result<(), Error> {
        let mut simulation = Simulation::new(&self.case.scene, &Backend::Gpu(options.adapter.clone()))?;
        let (gpu, solids) = (path_of(&simulation).gpu(), simulation.solids());
        self.timestamps = gpu.report().timestamps;
        self.sizes = row! {
            cells: self.case.scene.grid().n_cells(), nodes: solids.rest.len(), elements: solids.elements.len(),
            device_bytes: allocated_bytes(gpu),
        };
        let mut samples: Vec<Sample> = Vec::new();
        while simulation.clock().frame < options.frames {
            let gpu = path_of(&simulation).gpu();
            gpu.start_trace();
            let (before, clock) = (gpu.traffic(), Instant::now());
            let report = simulation.step()?;
            let seconds = clock.elapsed().as_secs_f64();
            let path = path_of(&simulation);
            let traffic = path.gpu().traffic().since(before);
            let solve = |solve: Option<SolveReport>| solve.map_or((0, 0), |solve| (solve.unknowns, solve.iterations));
            let (unknowns, iterations) = solve(report.liquid.map(|liquid| liquid.solve));
            let (solid_unknowns, solid_iterations) = solve(report.solid.map(|solid| solid.solve));
            let numbers = traffic_counts(&traffic).with(row! {
                idle_seconds: traffic.idle_seconds, unknowns, iterations, solid_unknowns, solid_iterations,
                band_cells: path.band_cells()?,
            });
            samples.push(Sample { seconds, report, numbers, trace: path.gpu().take_trace() });
        }
        // The first of a kind compiles.
        for kind in ["apart", "touching"] {
            let first = samples.iter().position(|sample| sample.kind() == kind);
            first.map(|first| samples.remove(first));
        }
        if samples.is_empty() {
            let problem = "the first sub-step of a kind is not counted, and there was no other";
            return Err(Error::input(format!("--frames {}", options.frames), problem, "measure more frames"));
        }
        self.runs.push(samples);
        self.ensure_repeated()
    }

    /// Refuses a run with other sub-steps than the first: rows compare them one by one.
    fn ensure_repeated(&self) -> Result<(), Error> {
        let kinds = |run: &[Sample]| run.iter().map(Sample::kind).collect::<Vec<_>>().join(" ");
        let (first, again) = (kinds(&self.runs[0]), kinds(&self.runs[self.runs.len() - 1]));
        if first == again {
            return Ok(());
        }
        Err(Error::Check(format!(
            "{}: the same run had sub-steps {first}, then {again}\n  cure: use another adapter (--adapter) or driver: this one is not reproducible",
            self.case.scene.name
        )))
    }

    /// Rows of each kind of sub-steps, and of its stages. Numbers other than seconds are the same in all runs.
    fn rows(&self) -> Rows {
        let mut rows = Vec::new();
        for kind in ["apart", "touching"] {
            let of_kind = |sample: &&Sample| sample.kind() == kind;
            let runs: Vec<Vec<&Sample>> = self.runs.iter().map(|run| run.iter().filter(of_kind).collect()).collect();
            let first = &runs[0];
            let Some(last) = first.last() else { continue };
            let key = self.case.key().with(row! { kind });
            let sub_step = |n: usize| Spread::of(runs.iter().map(|run| run[n].seconds).collect()).median;
            let names = last.numbers.names();
            let means = Row::new(names.map(|name| (name, mean(first, &|sample| sample.numbers.number(name)).into())));
            let seconds = over_runs(&runs, &|sample| sample.seconds);
            let sizes = row! {
                sub_steps: first.len(), simulated: first.iter().map(|sample| sample.report.dt).sum::<f64>(),
                markers: last.report.liquid.map_or(0, |liquid| liquid.markers), runs: runs.len(), seconds,
                sub_step_seconds: Spread::of((0..first.len()).map(sub_step).collect()),
                cells_per_second: means.number("unknowns") / seconds.median,
                idle_seconds: over_runs(&runs, &|sample| sample.numbers.number("idle_seconds")).median,
            };
            rows.push(("step", key.clone().with(self.sizes.clone()).with(means).with(sizes)));
            let names = first.iter().flat_map(|sample| &sample.report.seconds);
            for (stage, _) in grouped(names, |(stage, _)| Some(*stage)) {
                let place = match (stage == Stage::Clip.name(), self.timestamps) {
                    (false, _) => "device",
                    (true, true) => "host and device",
                    (true, false) => "host",
                };
                let row = key.clone().with(row! {
                    stage, where: place, seconds: over_runs(&runs, &|sample| stage_seconds(&sample.report, stage)),
                    dispatches: mean(first, &|sample| sample.trace.dispatches.iter().filter(|(name, _)| *name == stage).count() as f64),
                    waits: mean(first, &|sample| sample.trace.waits.iter().filter(|name| **name == stage).count() as f64),
                });
                rows.push(("step_stages", row));
            }
        }
        rows
    }
}

fn mean(samples: &[&Sample], value: &dyn Fn(&Sample) -> f64) -> f64 {
    samples.iter().map(|sample| value(sample)).sum::<f64>() / samples.len() as f64
}

/// Spread over the runs of their means.
fn over_runs(runs: &[Vec<&Sample>], value: &dyn Fn(&Sample) -> f64) -> Spread {
    Spread::of(runs.iter().map(|samples| mean(samples, value)).collect())
}

/// Growth with the grid, the solids' meshes, and both.
pub fn derive(tables: &mut [Table]) {
    let mut all = Vec::new();
    let rows = rows(tables, "step");
    for along in ["cells", "nodes", "both"] {
        let size = if along == "nodes" { "nodes" } else { "cells" };
        let groups = grouped(rows, |row| {
            let fixed = match along {
                "cells" => row.get("nodes"),
                "nodes" => row.get("cells"),
                // Rounded, as scales are.
                _ => (1e6 * row.number("scale") / row.number("solids_scale")).round().into(),
            };
            Some((row.only(&["scene", "kind"]), fixed))
        });
        for ((series, fixed), members) in groups {
            let nodes = |row: &Row| row.get("nodes");
            let refined = members.iter().any(|row| nodes(row) != nodes(members[0]));
            let fixed = Some(fixed).filter(|fixed| along != "both" && *fixed != 0);
            if along != "both" || refined {
                let names = series.with(row! { along, fixed });
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
