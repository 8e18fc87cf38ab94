//! `bench step`: seconds of sub-steps, all stages, beside the time of a copy of the bytes that each stage must move.
//!
//! A sub-step counts on the host from the upload of its numbers to its diagnostics; stages count by device timestamps. Scenes run from their start,
//! in rounds. The first sub-step of each kind, which compiles and warms caches, is not counted. Every run of a scene has the same sub-steps.

mod sizes;

use std::time::Instant;

use super::bytes::{Corrections, SolidBytes, SolveBytes};
use super::chart::{Bars, Page};
use super::statistics::{Spread, grouped};
use super::table::{Row, Table, Value, columns, row};
use super::{
    Bench, GROWTH, Listener, Machine, Results, Run, Settings, TRAFFIC, growth, replace, rows,
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
    /// Scenes, scaled; a scene may be there at several scales.
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

/// Measures all scenes: step.csv, step_stages.csv, step_growth.csv, step.json, step.svg, anew after each run.
///
/// # Errors
/// [`Error::Output`]; [`Error::Check`] where the runs of a scene differ; errors of the simulations.
pub fn measure(
    options: &Options,
    settings: &Settings,
    listener: Listener,
) -> Result<Results, Error> {
    if options.scenes.is_empty() {
        return Err(Error::input(
            "bench step",
            "no scene to measure",
            "give one scene file or more",
        ));
    }
    let machine = Machine::new(&Gpu::new(&options.adapter)?, settings.repeats)?;
    let scenes: Vec<&str> = options
        .scenes
        .iter()
        .map(|case| case.scene.hash.as_str())
        .collect();
    let mut run = Run::start(
        bench(),
        machine,
        &(scenes, options.frames),
        settings,
        listener,
    )?;
    // Rows of scenes without all their runs are measured anew.
    let repeats = settings.repeats.max(1);
    run.results.tables[0]
        .rows
        .retain(|row| row.count("runs") == repeats);
    let done = run.results.tables[0].rows.clone();
    let kept = |case: &&Case| {
        let of_case = case.key();
        done.iter()
            .any(|row| row.only(&["scene", "scale", "solids_scale"]) == of_case)
    };
    let mut records: Vec<Record> = options
        .scenes
        .iter()
        .filter(|case| !kept(case))
        .map(Record::new)
        .collect();
    let (clock, of) = (Instant::now(), repeats * records.len());
    for round in 0..repeats {
        for number in 0..records.len() {
            let record = &mut records[number];
            if record.taken() > settings.seconds {
                continue;
            }
            record.run(options)?;
            let rows = record.rows(&run.results.machine);
            run.put(rows)?;
            run.progress("runs", round * records.len() + number + 1, of, clock);
        }
    }
    Ok(run.results)
}

/// Measurements of a scene.
struct Record<'a> {
    case: &'a Case,
    device: Option<Device>,
    /// Sub-steps of each run but for the first of each kind.
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
    /// Corrections of the solve for liquid and solids; `None` where each was solved alone.
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
        let scheme = scene.solver.coupling;
        let touching = report.coupling.filter(|both| both.touching);
        let Some((both, (_, bounds))) = touching.zip(self.solid_bytes.as_ref()) else {
            return Ok(None);
        };
        let (solids, dt) = (&self.solids, report.dt);
        Ok(match scheme {
            CouplingScheme::Weak => None,
            _ if both.condensed => Some(Corrections::Condensed {
                wet_nodes: path.wet_nodes()?,
            }),
            CouplingScheme::Strong => Some(Corrections::TwoField {
                degree: bounds.chebyshev_degree(solids, dt),
            }),
            // With mass and damping alone. The solve for elasticity before it, of which no report tells, is left out.
            CouplingScheme::DampingOnly => Some(Corrections::TwoField {
                degree: bounds.chebyshev_degree_for(solids, |body| {
                    [1.0 / dt + body.mass_damping, body.stiffness_damping]
                }),
            }),
        })
    }

    /// Bytes that a stage must move in a sub-step, every array that a kernel needs once, reads and writes.
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
            bytes += solids.of_stage(stage, effects.scripts, effects.obstacles);
        }
        bytes
    }

    /// Bytes of all solves of a sub-step.
    fn solve_bytes(&self, scene: &Scene, sample: &Sample) -> f64 {
        let [real, inner] = self.widths;
        // Refinement steps: one with corrections in f64, as a rule two in f32.
        let rounds = |bytes: f64| if bytes < 8.0 { 2.0 } else { 1.0 };
        let liquid = SolveBytes {
            unknowns: sample.unknowns(),
            not_uniform: sample.not_uniform,
            iterations: sample.iterations(),
            rounds: rounds(inner),
            widths: [inner, real],
            preconditioner: scene.solver.preconditioner,
        };
        // The size of the right-hand side.
        let start = liquid.unknowns * real;
        let Some((solids, bounds)) = &self.solid_bytes else {
            return start + liquid.of_pressure();
        };
        if let Some(corrections) = sample.corrections {
            return start + liquid.of_both(solids, corrections);
        }
        let degree = bounds.chebyshev_degree(&self.solids, sample.report.dt) as f64;
        // The corrections of solids by themselves are as precise as their residuals.
        start
            + liquid.of_pressure()
            + solids.of_solve(degree, sample.solid_iterations(), rounds(real))
    }

    /// Per cell of the band, per unknown, per marker, and per padded cell of the domain where flags are counted. Words of a quad
    /// (flags, marks, list entries) count a byte per cell.
    fn liquid_bytes(&self, scene: &Scene, stage: &str, sample: &Sample) -> f64 {
        let effects = Effects::of(scene);
        let [real, inner] = self.widths;
        let padded = scene.grid().padded().len() as f64;
        // The coarser levels hold a seventh of the finest.
        let all_levels = padded * 8.0 / 7.0;
        let band = sample.band_cells as f64;
        let unknowns = sample.unknowns();
        let markers = if effects.markers {
            sample.liquid(|liquid| liquid.markers as f64)
        } else {
            0.0
        };
        let bodies = f64::from(u8::from(effects.cuts()));
        let layers = extrapolation_layers(scene.time.cfl) as f64;
        match stage {
            // Position read and written; velocity.
            "advect_markers" => markers * 32.0 + band * (12.0 + 4.0 * bodies),
            // Position, occupied; flags counted through the domain, list.
            "band" => markers * 16.0 + band * 3.0 + padded,
            // With bodies marks and list for slivers, too.
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
            // Labels written, joined, asked.
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

    fn taken(&self) -> f64 {
        self.repeats
            .iter()
            .flatten()
            .map(|sample| sample.seconds)
            .sum()
    }

    /// Another run from the scene's start. Its simulation is dropped after it: all scenes together may need more memory than there is.
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

    /// Refuses a run with other sub-steps than the first: rows compare them number by number.
    fn ensure_repeated(&self) -> Result<(), Error> {
        let kinds = |repeat: &[Sample]| repeat.iter().map(Sample::touching).collect::<Vec<_>>();
        let count = |repeat: &[Sample]| {
            let touching = kinds(repeat).into_iter().filter(|&touching| touching);
            format!("{} sub-steps, {} touching", repeat.len(), touching.count())
        };
        match &self.repeats[..] {
            [first, .., again] if kinds(first) != kinds(again) => Err(Error::Check(format!(
                "{}: the same run had {}, then {}\n  cure: use another adapter (--adapter) or driver: this one does not repeat",
                self.case.scene.name,
                count(first),
                count(again)
            ))),
            _ => Ok(()),
        }
    }

    /// Rows of each kind of sub-steps, and of its stages.
    fn rows(&self, machine: &Machine) -> Vec<(&'static str, Row)> {
        let mut rows = Vec::new();
        for touching in [false, true] {
            let repeats = self.repeats.iter();
            let repeats = repeats.map(|repeat| {
                repeat
                    .iter()
                    .filter(|sample| sample.touching() == touching)
                    .collect()
            });
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
    ) -> Vec<(&'static str, Row)> {
        let (scene, solids) = (&self.case.scene, &device.solids);
        let first = &repeats[0];
        let mean_of = |samples: &[&Sample], value: &dyn Fn(&Sample) -> f64| {
            samples.iter().map(|sample| value(sample)).sum::<f64>() / samples.len() as f64
        };
        let mean = |value: &dyn Fn(&Sample) -> f64| mean_of(first, value);
        let over_repeats = |value: &dyn Fn(&Sample) -> f64| {
            Spread::of(
                repeats
                    .iter()
                    .map(|samples| mean_of(samples, value))
                    .collect(),
            )
        };
        let seconds = over_repeats(&|sample| sample.seconds);
        let of_number =
            |n: usize| Spread::of(repeats.iter().map(|repeat| repeat[n].seconds).collect()).median;
        let kind = self
            .case
            .key()
            .with(row! { kind: if touching { "touching" } else { "apart" } });
        let bytes = mean(&|sample| {
            STAGES
                .iter()
                .map(|stage| device.bytes(scene, stage, sample))
                .sum()
        });
        let unknowns = mean(&Sample::unknowns);
        let last = first.last().and_then(|sample| sample.report.liquid);
        let step = row! {
            cells: scene.grid().n_cells(), nodes: solids.rest.len(), elements: solids.elements.len(), sub_steps: first.len(),
            simulated: first.iter().map(|sample| sample.report.dt).sum::<f64>(), markers: last.map_or(0, |liquid| liquid.markers),
            unknowns: unknowns, band_cells: mean(&|sample| sample.band_cells as f64), iterations: mean(&Sample::iterations),
            solid_unknowns: mean(&|sample| sample.solid(|solid| solid.solve.unknowns as f64)),
            solid_iterations: mean(&Sample::solid_iterations), runs: repeats.len(), seconds: seconds,
            sub_step_seconds: Spread::of((0..first.len()).map(of_number).collect()), cells_per_second: unknowns / seconds.median,
            bytes: bytes, share_of_copy_bandwidth: machine.share(bytes, seconds.median),
            waits: mean(&|sample| sample.traffic.waits as f64), submissions: mean(&|sample| sample.traffic.submissions as f64),
            dispatches: mean(&|sample| sample.traffic.dispatches as f64), bytes_up: mean(&|sample| sample.traffic.bytes_up as f64),
            bytes_down: mean(&|sample| sample.traffic.bytes_down as f64),
            idle_seconds: over_repeats(&|sample| sample.traffic.idle_seconds).median, device_bytes: device.bytes,
        };
        let mut rows = vec![("step", kind.clone().with(step))];
        let names = first.iter().flat_map(|sample| &sample.report.seconds);
        for (stage, _) in grouped(names, |(stage, _)| Some(*stage)) {
            let seconds = over_repeats(&|sample| {
                let own = sample
                    .report
                    .seconds
                    .iter()
                    .filter(|(name, _)| *name == stage);
                own.map(|(_, seconds)| seconds).sum()
            });
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

/// Stages with a model of their bytes, which make up those of a sub-step.
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
            // Rounded, for scales are.
            let ratio = (1e6 * row.number("scale") / row.number("solids_scale")).round();
            Some(match along {
                "cells" => (series, nodes, 0.0),
                "nodes" => (series, cells, 0.0),
                _ => (series, Value::Empty, ratio),
            })
        });
        for ((series, fixed, _), members) in groups {
            let refined = members
                .iter()
                .any(|row| row.get("nodes") != members[0].get("nodes"));
            let fixed = if fixed == Value::Count(0) {
                Value::Empty
            } else {
                fixed
            };
            if along != "both" || refined {
                let fit = growth(&members, size);
                all.extend(
                    fit.map(|fit| fit.with(series).with(row! { along: along, fixed: fixed })),
                );
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
            let same = |stage: &&Row| {
                let key = ["scene", "scale", "solids_scale", "kind"];
                stage.only(&key) == row.only(&key)
            };
            let mut end = 0.0;
            let parts = results
                .rows("step_stages")
                .iter()
                .filter(same)
                .map(|stage| {
                    let start = end;
                    end += 1e3 * stage.number("seconds_median");
                    (stage.text("stage").to_owned(), start, end)
                });
            let name = match row.count("nodes") {
                0 => format!("{} cells", row.count("cells")),
                nodes => format!(
                    "{} cells, {nodes} nodes, {}",
                    row.count("cells"),
                    row.text("kind")
                ),
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
