//! `bench step`: seconds of sub-steps and stages, and the time of a copy of the bytes that each stage must move.
//!
//! The host times a sub-step from the upload of its numbers to its diagnostics; stages have device timestamps. Scenes run from their start, in rounds.
//! The first sub-step of each kind compiles and is not counted. Every run of a scene has the same sub-steps.

mod sizes;

use std::time::Instant;

use super::bytes::{Corrections, SolidBytes, SolveBytes};
use super::chart::{Bars, Page};
use super::statistics::{Spread, grouped};
use super::sub_step::stage_seconds;
use super::table::{Row, Table, Value, columns, row};
use super::{
    Bench, GROWTH, Listener, Machine, Results, Rows, Run, Settings, TRAFFIC, growth, replace, rows,
};
use crate::Error;
use crate::effects::Effects;
use crate::elastic::{Bounds, Solids};
use crate::fields::extrapolation_layers;
use crate::gpu::{AdapterChoice, Gpu, Trace, Traffic};
use crate::scene::{CouplingScheme, Scene};
use crate::sim::{Backend, GpuPath, Simulation};
use crate::state::{LiquidReport, SolidReport, StepReport};
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
        bytes - "B" "least memory traffic of a sub-step";
        share_of_copy_bandwidth - "" "`bytes` per second over the copy bandwidth";
    }
    /// A stage in these sub-steps.
    STAGE {
        stage - "" "name of the stage";
        where - "" "where its seconds are spent: `device`, `host`, `host and device`";
        seconds ~ "s" "as in step.csv";
        bytes - "B" "least memory traffic; 0 for `clip` and `exchange`, which have no model";
        share_of_copy_bandwidth - "" "empty where bytes or seconds are 0";
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
pub fn measure(
    options: &Options,
    settings: &Settings,
    listener: Listener,
) -> Result<Results, Error> {
    if options.scenes.is_empty() {
        let cure = "give one scene file or more";
        return Err(Error::input("bench step", "no scene to measure", cure));
    }
    let machine = Machine::new(&Gpu::new(&options.adapter)?, settings.repeats)?;
    let scenes = options.scenes.iter().map(|case| case.scene.hash.as_str());
    let request = (scenes.collect::<Vec<_>>(), options.frames);
    let mut run = Run::start(bench(), machine, &request, settings, listener)?;
    // Scenes without all their runs are measured again.
    let repeats = settings.repeats.max(1);
    let table = &mut run.results.tables[0];
    table.rows.retain(|row| row.count("runs") == repeats);
    let new = options.scenes.iter().filter(|case| !table.has(&case.key()));
    let mut records: Vec<Record> = new.map(Record::new).collect();
    let (clock, n) = (Instant::now(), records.len());
    for round in 0..repeats {
        for (number, record) in records.iter_mut().enumerate() {
            if record.seconds() > settings.seconds {
                continue;
            }
            record.run(options)?;
            let rows = record.rows(&run.results.machine);
            run.put(rows)?;
            run.progress("runs", round * n + number + 1, repeats * n, clock);
        }
    }
    Ok(run.results)
}

/// Measurements of a scene.
struct Record<'a> {
    case: &'a Case,
    device: Option<Device>,
    /// Sub-steps of each run, without the first of each kind.
    repeats: Vec<Vec<Sample>>,
}

/// Numbers of a scene on a device.
struct Device {
    solids: Solids,
    /// Bytes of the solids' stages, and the bounds of their preconditioner; `None` without solids.
    solid_bytes: Option<(SolidBytes, Bounds)>,
    /// Bytes of a scalar of the unknowns, and of the corrections.
    widths: [f64; 2],
    timestamps: bool,
    /// Bytes of all buffers.
    bytes: u64,
}

/// One sub-step.
struct Sample {
    seconds: f64,
    band_cells: usize,
    /// Share of the active quads whose weights are loaded.
    not_uniform: f64,
    /// Corrections of the coupled solve; `None` if liquid and solids were solved separately.
    corrections: Option<Corrections>,
    report: StepReport,
    traffic: Traffic,
    trace: Trace,
}

impl Sample {
    fn touching(&self) -> bool {
        self.report.coupling.is_some_and(|both| both.touching)
    }

    /// 0 without liquid.
    fn liquid(&self, number: fn(LiquidReport) -> f64) -> f64 {
        self.report.liquid.map_or(0.0, number)
    }

    /// 0 without solids.
    fn solid(&self, number: fn(SolidReport) -> f64) -> f64 {
        self.report.solid.map_or(0.0, number)
    }

    fn unknowns(&self) -> f64 {
        self.liquid(|liquid| liquid.solve.unknowns as f64)
    }

    fn iterations(&self) -> f64 {
        self.liquid(|liquid| f64::from(liquid.solve.iterations))
    }

    fn solid_iterations(&self) -> f64 {
        self.solid(|solid| f64::from(solid.solve.iterations))
    }
}

fn path_of(simulation: &Simulation) -> &GpuPath {
    simulation.gpu_path().expect("benches run on the GPU path")
}

impl Device {
    fn new(simulation: &Simulation) -> Device {
        let path = path_of(simulation);
        let widths = path.scalar_bytes();
        let solids = path.solids();
        Device {
            solid_bytes: solids
                .map(|solids| (SolidBytes::new(solids, widths), Bounds::new(solids))),
            solids: simulation.solids().clone(),
            widths: widths.map(|bytes| bytes as f64),
            timestamps: path.gpu().report().timestamps,
            bytes: path.gpu().allocated().iter().map(|(_, bytes)| bytes).sum(),
        }
    }

    /// Corrections of the solve for liquid and solids in the last sub-step of a path.
    fn corrections(
        &self,
        scene: &Scene,
        path: &GpuPath,
        report: &StepReport,
    ) -> Result<Option<Corrections>, Error> {
        let touching = report.coupling.filter(|both| both.touching);
        let Some((both, (_, bounds))) = touching.zip(self.solid_bytes.as_ref()) else {
            return Ok(None);
        };
        let (solids, dt) = (&self.solids, report.dt);
        let degree = match scene.solver.coupling {
            CouplingScheme::Weak => return Ok(None),
            _ if both.condensed => {
                let wet_nodes = path.wet_nodes()?;
                return Ok(Some(Corrections::Condensed { wet_nodes }));
            }
            CouplingScheme::Strong => bounds.chebyshev_degree(solids, dt),
            // Mass and damping alone. The solve for elasticity before it has no report and is left out.
            CouplingScheme::DampingOnly => bounds.chebyshev_degree_for(solids, |body| {
                [1.0 / dt + body.mass_damping, body.stiffness_damping]
            }),
        };
        Ok(Some(Corrections::TwoField { degree }))
    }

    /// Least memory traffic of a stage in a sub-step, B: each array that a kernel needs, once.
    fn bytes(&self, scene: &Scene, stage: &str, sample: &Sample) -> f64 {
        if stage == "solve" {
            return self.solve_bytes(scene, sample);
        }
        let mut bytes = 0.0;
        if scene.liquid.is_some() {
            bytes += self.liquid_bytes(scene, stage, sample);
        }
        if let Some((solids, _)) = &self.solid_bytes {
            let effects = Effects::of(scene);
            bytes += solids.stage(stage, effects.scripts, effects.obstacles);
        }
        bytes
    }

    /// Bytes of all solves of a sub-step.
    fn solve_bytes(&self, scene: &Scene, sample: &Sample) -> f64 {
        let [real, inner] = self.widths;
        // Refinement steps: one with corrections in f64, usually two in f32.
        let refinements = |bytes: f64| if bytes < 8.0 { 2.0 } else { 1.0 };
        let liquid = SolveBytes {
            unknowns: sample.unknowns(),
            not_uniform: sample.not_uniform,
            iterations: sample.iterations(),
            refinements: refinements(inner),
            widths: [inner, real],
            preconditioner: scene.solver.preconditioner,
        };
        // The size of the right-hand side.
        let start = liquid.unknowns * real;
        let Some((solids, bounds)) = &self.solid_bytes else {
            return start + liquid.pressure();
        };
        if let Some(corrections) = sample.corrections {
            return start + liquid.coupled(solids, corrections);
        }
        let degree = bounds.chebyshev_degree(&self.solids, sample.report.dt) as f64;
        // In a solve of solids alone the corrections have the scalar type of the residuals.
        start
            + liquid.pressure()
            + solids.solve(degree, sample.solid_iterations(), refinements(real))
    }

    /// Bytes per cell of the band, per unknown, per marker, and per padded cell of the domain where flags are counted. A word of a quad (flags, marks,
    /// list entries) is a byte per cell.
    fn liquid_bytes(&self, scene: &Scene, stage: &str, sample: &Sample) -> f64 {
        let effects = Effects::of(scene);
        let [real, inner] = self.widths;
        let padded = scene.grid().padded().len() as f64;
        // The coarser levels hold a seventh of the finest.
        let all_levels = padded * 8.0 / 7.0;
        let band = sample.band_cells as f64;
        let unknowns = sample.unknowns();
        let markers = match effects.markers {
            true => sample.liquid(|liquid| liquid.markers as f64),
            false => 0.0,
        };
        let bodies = f64::from(u8::from(effects.cuts()));
        let layers = extrapolation_layers(scene.time.cfl) as f64;
        match stage {
            // Position read and written; velocity.
            "advect_markers" => markers * 32.0 + band * (12.0 + 4.0 * bodies),
            // Position, occupied; flags counted through the domain, list.
            "band" => markers * 16.0 + band * 3.0 + padded,
            // With bodies also marks and list of small-aperture faces.
            "advect_velocity" => band * (12.0 + 12.0 + 1.0 + bodies * 5.0),
            "forces" => band * (12.0 + 12.0 + 1.0),
            // Classes near (3) and far (2), squares cleared, spread, made a distance, summed; the extension into solids.
            "liquid_distance" if effects.markers => {
                markers * 16.0 + band * (5.0 + 4.0 + 8.0 + 9.0 + 4.0 + bodies * (64.0 + 8.0))
            }
            // Flags counted through the domain; distance and list; open fractions; matrix and flags, cleared and written, of all levels.
            "active_cells" => {
                all_levels + band * 5.0 + unknowns * (12.0 + 8.0 / 7.0 * (10.0 * inner + 4.0))
            }
            // Labels written, joined, read.
            "closed_components" => unknowns * (4.0 + 8.0 + 4.0 + 3.0),
            "right_hand_side" => unknowns * (12.0 + 12.0 + real + 2.0),
            // u*, distance, velocity, marks; potential.
            "write_back" => band * (12.0 + 4.0 + 12.0 + 2.0) + unknowns * real,
            // Marks read and written in each layer, the velocity once; with bodies marks three times more.
            "extrapolate" => band * (layers * 2.0 + 24.0 + bodies * 31.0),
            "diagnose" => band * (12.0 + 4.0 + 1.0) + unknowns * (12.0 + 12.0 + 1.0),
            _ => 0.0,
        }
    }
}

impl<'a> Record<'a> {
    fn new(case: &'a Case) -> Record<'a> {
        Record {
            case,
            device: None,
            repeats: Vec::new(),
        }
    }

    /// Seconds of all runs.
    fn seconds(&self) -> f64 {
        let samples = self.repeats.iter().flatten();
        samples.map(|sample| sample.seconds).sum()
    }

    /// Another run from the scene's start. Its simulation is dropped at the end: all scenes together may exceed the memory.
    fn run(&mut self, options: &Options) -> Result<(), Error> {
        let scene = &self.case.scene;
        let mut simulation = Simulation::new(scene, &Backend::Gpu(options.adapter.clone()))?;
        let device = self.device.get_or_insert_with(|| Device::new(&simulation));
        let (mut samples, mut kinds) = (Vec::new(), [false; 2]);
        while simulation.clock().frame < options.frames {
            let gpu = path_of(&simulation).gpu();
            gpu.start_trace();
            let (before, clock) = (gpu.traffic(), Instant::now());
            let report = simulation.step()?;
            let seconds = clock.elapsed().as_secs_f64();
            let path = path_of(&simulation);
            let sample = Sample {
                seconds,
                traffic: path.gpu().traffic().since(before),
                trace: path.gpu().take_trace(),
                band_cells: path.band_cells()?,
                not_uniform: path.share_not_uniform()?,
                corrections: device.corrections(scene, path, &report)?,
                report,
            };
            // The first of a kind compiles.
            if std::mem::replace(&mut kinds[usize::from(sample.touching())], true) {
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
        let [first, .., again] = &self.repeats[..] else {
            return Ok(());
        };
        let kinds = |repeat: &[Sample]| repeat.iter().map(Sample::touching).collect::<Vec<_>>();
        if kinds(first) == kinds(again) {
            return Ok(());
        }
        let [first, again] = [first, again].map(|repeat| {
            let touching = repeat.iter().filter(|sample| sample.touching());
            format!("{} sub-steps, {} touching", repeat.len(), touching.count())
        });
        Err(Error::Check(format!(
            "{}: the same run had {first}, then {again}\n  cure: use another adapter (--adapter) or driver: this one is not reproducible",
            self.case.scene.name
        )))
    }

    /// Rows of each kind of sub-steps, and of its stages.
    fn rows(&self, machine: &Machine) -> Rows {
        let mut rows = Vec::new();
        for touching in [false, true] {
            let kind = |sample: &&Sample| sample.touching() == touching;
            let repeats = self.repeats.iter();
            let repeats = repeats.map(|repeat| repeat.iter().filter(kind).collect());
            let repeats: Vec<Vec<&Sample>> = repeats.collect();
            if let (Some(device), false) = (&self.device, repeats[0].is_empty()) {
                rows.extend(self.kind_rows(device, touching, &repeats, machine));
            }
        }
        rows
    }

    /// Rows of the sub-steps of a kind in each run. Numbers other than seconds are the same in all runs.
    fn kind_rows(
        &self,
        device: &Device,
        touching: bool,
        repeats: &[Vec<&Sample>],
        machine: &Machine,
    ) -> Rows {
        let (scene, solids) = (&self.case.scene, &device.solids);
        let first = &repeats[0];
        let mean = |value: &dyn Fn(&Sample) -> f64| mean(first, value);
        let seconds = over_repeats(repeats, &|sample| sample.seconds);
        let sub_step = |n: usize| {
            let runs = repeats.iter().map(|repeat| repeat[n].seconds);
            Spread::of(runs.collect()).median
        };
        let kind = if touching { "touching" } else { "apart" };
        let kind = self.case.key().with(row! { kind: kind });
        let bytes = mean(&|sample| {
            let stages = STAGES.iter();
            stages.map(|stage| device.bytes(scene, stage, sample)).sum()
        });
        let unknowns = mean(&Sample::unknowns);
        let last = first.last().and_then(|sample| sample.report.liquid);
        let sizes = row! {
            cells: scene.grid().n_cells(), nodes: solids.rest.len(), elements: solids.elements.len(), sub_steps: first.len(),
            simulated: first.iter().map(|sample| sample.report.dt).sum::<f64>(), markers: last.map_or(0, |liquid| liquid.markers),
            unknowns: unknowns, band_cells: mean(&|sample| sample.band_cells as f64), iterations: mean(&Sample::iterations),
            solid_unknowns: mean(&|sample| sample.solid(|solid| solid.solve.unknowns as f64)),
            solid_iterations: mean(&Sample::solid_iterations), runs: repeats.len(), device_bytes: device.bytes,
        };
        let times = row! {
            seconds: seconds, sub_step_seconds: Spread::of((0..first.len()).map(sub_step).collect()),
            cells_per_second: unknowns / seconds.median, bytes: bytes, share_of_copy_bandwidth: machine.share(bytes, seconds.median),
            waits: mean(&|sample| sample.traffic.waits as f64), submissions: mean(&|sample| sample.traffic.submissions as f64),
            dispatches: mean(&|sample| sample.traffic.dispatches as f64), bytes_up: mean(&|sample| sample.traffic.bytes_up as f64),
            bytes_down: mean(&|sample| sample.traffic.bytes_down as f64),
            idle_seconds: over_repeats(repeats, &|sample| sample.traffic.idle_seconds).median,
        };
        let mut rows = vec![("step", kind.clone().with(sizes).with(times))];
        let names = first.iter().flat_map(|sample| &sample.report.seconds);
        for (stage, _) in grouped(names, |(stage, _)| Some(*stage)) {
            let seconds = over_repeats(repeats, &|sample| stage_seconds(&sample.report, &[stage]));
            let bytes = mean(&|sample| device.bytes(scene, stage, sample));
            let place = match (stage == Stage::Clip.name(), device.timestamps) {
                (false, _) => "device",
                (true, true) => "host and device",
                (true, false) => "host",
            };
            let mut row = kind.clone().with(row! {
                stage: stage, seconds: seconds, bytes: bytes, share_of_copy_bandwidth: machine.share(bytes, seconds.median),
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
    let means = repeats.iter().map(|samples| mean(samples, value));
    Spread::of(means.collect())
}

/// Stages with a model of their bytes; their sum is that of a sub-step.
const STAGES: [&str; 14] = [
    "move_solid",
    "advect_markers",
    "band",
    "advect_velocity",
    "forces",
    "liquid_distance",
    "active_cells",
    "closed_components",
    "solid_matrices",
    "right_hand_side",
    "solve",
    "write_back",
    "extrapolate",
    "diagnose",
];

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
    let scenes = grouped(results.rows("step"), |row| Some(row.text("scene")));
    let lists = scenes.into_iter().map(|(scene, rows)| {
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
        Bars {
            title: format!("{scene}: a sub-step, {}", results.machine.name()),
            axis: "ms",
            bars: bars.collect(),
            key: true,
        }
    });
    Page::Bars(lists.collect())
}
