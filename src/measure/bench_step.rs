//! `bench step`: seconds of a sub-step, all stages, against what a copy of the bytes that each stage must touch would take.
//!
//! Sub-steps are timed on the host from the upload of the step's numbers to its report; the stages on the device by timestamps,
//! where the adapter has them. Scenes run from their start; the first sub-step, which warms caches up, is not counted. With
//! a second domain, every sub-step of the scene is followed by one of the same scene in the larger domain, so that what else
//! the machine does falls on both.

use std::path::Path;
use std::time::Instant;

use plotters::prelude::*;
use serde::Serialize;

use crate::Error;
use crate::effects::Effects;
use crate::elastic::Bounds;
use crate::gpu::AdapterChoice;
use crate::output::FolderLock;
use crate::scene::{CouplingScheme, Scene};
use crate::sim::{Backend, GpuPath, Simulation};
use crate::stages::{Clip, extrapolation_layers};
use crate::state::{LiquidReport, SolidReport, StepReport};

use super::bench_solve::{Corrections, SolveBytes};
use super::chart::ink;
use super::solid_bytes::SolidBytes;
use super::statistics::{Spread, exponent};
use super::table::{Machine, remove_earlier, write_csv, write_json, write_svg};

/// What to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Scenes, scaled; the same one may be there at several scales.
    pub scenes: Vec<Scene>,
    /// Frames of each.
    pub frames: u64,
    /// How often each is run from its start.
    pub repeats: usize,
    /// How many times larger the domain of a second run of each scene is along x, y, z.
    pub larger_domain: Option<[usize; 3]>,
    /// Where.
    pub adapter: AdapterChoice,
}

/// A row of step.csv: medians over the sub-steps.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the scene.
    pub scene: String,
    /// What its cells are multiplied by.
    pub scale: f64,
    /// Cells of the domain.
    pub cells: usize,
    /// Markers at the end.
    pub markers: usize,
    /// Unknowns of the pressure solve.
    pub unknowns: f64,
    /// Cells of the band, where the stages work.
    pub band_cells: f64,
    /// Iterations of the pressure solve.
    pub iterations: f64,
    /// Nodes of the solids.
    pub nodes: usize,
    /// Elements of the solids.
    pub elements: usize,
    /// Unknowns of the solids' solve.
    pub solid_unknowns: f64,
    /// Iterations of the solids' solve.
    pub solid_iterations: f64,
    /// Sub-steps timed.
    pub sub_steps: usize,
    /// Wall-clock seconds of a sub-step.
    pub seconds_median: f64,
    /// Least.
    pub seconds_min: f64,
    /// Largest.
    pub seconds_max: f64,
    /// Unknowns of the pressure solve per second of the median.
    pub cells_per_second: f64,
    /// Bytes that a sub-step must move.
    pub bytes: f64,
    /// Bytes per second over the copy bandwidth of the same run.
    pub share_of_copy_bandwidth: f64,
}

/// A row of step_stages.csv.
#[derive(Clone, Debug, Serialize)]
pub struct StageRow {
    /// Name of the scene.
    pub scene: String,
    /// What its cells are multiplied by.
    pub scale: f64,
    /// The stage.
    pub stage: &'static str,
    /// Where its seconds are spent: `device`; those of `clip` on the `host`, or `host and device` where the device tells its own.
    #[serde(rename = "where")]
    pub place: &'static str,
    /// Seconds in a sub-step.
    pub seconds_median: f64,
    /// Least.
    pub seconds_min: f64,
    /// Largest.
    pub seconds_max: f64,
    /// Bytes that the stage must move in a sub-step; 0 for `clip` and `exchange`, which have no model.
    pub bytes: f64,
    /// Bytes per second over the copy bandwidth of the same run; empty where bytes or seconds are 0.
    pub share_of_copy_bandwidth: Option<f64>,
}

/// A scene in its domain and in a larger one.
#[derive(Clone, Debug, Serialize)]
pub struct Pair {
    /// Name of the scene.
    pub scene: String,
    /// What its cells are multiplied by.
    pub scale: f64,
    /// How many times larger the domain is along x, y, z.
    pub larger: [usize; 3],
    /// Median seconds of a sub-step in the larger domain over those in the scene's own.
    pub ratio: f64,
    /// The same of the least seconds, on which other work of the machine tells less.
    pub ratio_of_least: f64,
}

/// How the seconds of a scene grow with its cells.
#[derive(Clone, Debug, Serialize)]
pub struct Growth {
    /// Name of the scene.
    pub scene: String,
    /// Cells of the domain at its least scale.
    pub from: usize,
    /// At its largest.
    pub to: usize,
    /// Of the median seconds of a sub-step, by the cells.
    pub exponent: f64,
}

/// The tables and where they were measured.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// Where.
    #[serde(flatten)]
    pub machine: Machine,
    /// A row per scene and domain.
    pub rows: Vec<Row>,
    /// A row per scene, domain and stage.
    pub stages: Vec<StageRow>,
    /// A row per scene, where a larger domain was asked for.
    pub pairs: Vec<Pair>,
    /// A row per scene with two scales or more.
    pub growth: Vec<Growth>,
}

/// Measures all scenes and writes step.csv, step_stages.csv, step_growth.csv where a scene has several scales, step.json and step.svg into `out`,
/// anew after each scene; `tell` hears of each row.
///
/// # Errors
/// Before any work [`Error::Output`] where the folder cannot be written and [`Error::Input`] where another process writes into it; then what
/// the simulations say.
pub fn bench_step(
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(&Row),
) -> Result<Table, Error> {
    let _held = FolderLock::take(out)?;
    remove_earlier(out, &["step_growth.csv"])?;
    let mut table: Option<Table> = None;
    for scene in &options.scenes {
        let mut runs = vec![Run::new(scene, &options.adapter)?];
        if let Some(factors) = options.larger_domain {
            let scene = in_larger_domain(scene, factors);
            runs.push(Run::new(&scene, &options.adapter)?);
        }
        let table = match &mut table {
            Some(table) => table,
            None => table.insert(empty_table(&runs[0], options.repeats)?),
        };
        interleave(&mut runs, options)?;
        let first = table.rows.len();
        for run in &runs {
            let (row, stages) = run.rows(&table.machine);
            tell(&row);
            table.rows.push(row);
            table.stages.extend(stages);
        }
        if let (Some(larger), [own, other]) = (options.larger_domain, &table.rows[first..]) {
            table.pairs.push(Pair {
                scene: scene.name.clone(),
                scale: scene.scale,
                larger,
                ratio: other.seconds_median / own.seconds_median,
                ratio_of_least: other.seconds_min / own.seconds_min,
            });
        }
        table.write(out)?;
    }
    table.ok_or_else(|| {
        Error::input(
            "bench step",
            "no scene to measure",
            "give one scene file or more",
        )
    })
}

impl Table {
    /// Makes again what follows from the rows, and writes what there is.
    fn write(&mut self, out: &Path) -> Result<(), Error> {
        self.growth = growth(&self.rows);
        write_csv(&self.rows, &out.join("step.csv"))?;
        write_csv(&self.growth, &out.join("step_growth.csv"))?;
        write_csv(&self.stages, &out.join("step_stages.csv"))?;
        write_json(self, &out.join("step.json"))?;
        // The right part is for the names of the stages.
        let width = 360 + 160 * self.rows.len() as u32;
        write_svg(&out.join("step.svg"), (width, 600), |page| draw(self, page))
    }
}

/// Of each scene that was measured at several scales.
fn growth(rows: &[Row]) -> Vec<Growth> {
    let mut names: Vec<&String> = rows.iter().map(|row| &row.scene).collect();
    names.sort();
    names.dedup();
    let of_scene = names.into_iter().filter_map(|name| {
        let rows: Vec<&Row> = rows.iter().filter(|row| row.scene == *name).collect();
        let cells = rows.iter().map(|row| row.cells);
        let points = rows
            .iter()
            .map(|row| (row.cells as f64, row.seconds_median));
        Some(Growth {
            scene: name.clone(),
            from: cells.clone().min()?,
            to: cells.max()?,
            exponent: exponent(points)?,
        })
    });
    of_scene.collect()
}

fn empty_table(run: &Run, repeats: usize) -> Result<Table, Error> {
    let gpu = run.simulation.gpu().expect("benches run on the GPU path");
    Ok(Table {
        machine: Machine::new(gpu, repeats)?,
        rows: Vec::new(),
        stages: Vec::new(),
        pairs: Vec::new(),
        growth: Vec::new(),
    })
}

/// The scene in a domain that many times larger, with cells of the same size and the same regions and obstacles: what filled the
/// domain is a block in its low corner.
pub fn in_larger_domain(scene: &Scene, factors: [usize; 3]) -> Scene {
    let mut scene = scene.clone();
    let [x, y, z] = factors;
    scene.name = format!("{} x {x},{y},{z}", scene.name);
    for (axis, &factor) in factors.iter().enumerate() {
        scene.domain.size[axis] *= factor as f64;
        scene.domain.cells[axis] *= factor;
    }
    scene
}

/// One scene being timed.
struct Run {
    scene: Scene,
    simulation: Simulation,
    samples: Vec<Sample>,
    /// Share of the active quads whose weights are loaded.
    not_uniform: f64,
    /// What decides the bytes of the solids' stages, and the degree of their preconditioner; `None` without solids.
    solids: Option<(SolidBytes, Bounds)>,
}

/// One sub-step.
struct Sample {
    seconds: f64,
    band_cells: usize,
    /// How liquid and solids were solved for together; `None` where each was by itself.
    corrections: Option<Corrections>,
    report: StepReport,
}

impl Sample {
    /// What the step did to the liquid, as a number; 0 without liquid.
    fn of_liquid(&self, number: fn(LiquidReport) -> f64) -> f64 {
        self.report.liquid.map_or(0.0, number)
    }

    /// What the step did to the solids, as a number; 0 without solids.
    fn of_solids(&self, number: fn(SolidReport) -> f64) -> f64 {
        self.report.solid.map_or(0.0, number)
    }

    fn unknowns(&self) -> f64 {
        self.of_liquid(|liquid| liquid.solve.unknowns as f64)
    }

    fn iterations(&self) -> f64 {
        self.of_liquid(|liquid| f64::from(liquid.solve.iterations))
    }

    fn solid_iterations(&self) -> f64 {
        self.of_solids(|solid| f64::from(solid.solve.iterations))
    }
}

impl Run {
    fn new(scene: &Scene, adapter: &AdapterChoice) -> Result<Run, Error> {
        let simulation = Simulation::new(scene, &Backend::Gpu(adapter.clone()))?;
        let path = simulation.gpu_path().expect("benches run on the GPU path");
        let widths = path.scalar_bytes();
        let solids = path.solids();
        Ok(Run {
            scene: scene.clone(),
            solids: solids.map(|solids| (SolidBytes::new(solids, widths), Bounds::new(solids))),
            simulation,
            samples: Vec::new(),
            not_uniform: 1.0,
        })
    }

    fn path(&self) -> &GpuPath {
        let path = self.simulation.gpu_path();
        path.expect("benches run on the GPU path")
    }

    fn step(&mut self, count: bool) -> Result<(), Error> {
        let clock = Instant::now();
        let report = self.simulation.step()?;
        let seconds = clock.elapsed().as_secs_f64();
        if count {
            self.not_uniform = self.path().share_not_uniform()?;
            let sample = Sample {
                seconds,
                band_cells: self.path().band_cells()?,
                corrections: self.corrections(&report)?,
                report,
            };
            self.samples.push(sample);
        }
        Ok(())
    }

    /// How liquid and solids were solved for together in the last sub-step, whose report this is.
    fn corrections(&self, report: &StepReport) -> Result<Option<Corrections>, Error> {
        let scheme = self.scene.solver.coupling;
        let touching = report.coupling.filter(|both| both.touching);
        let Some((both, (_, bounds))) = touching.zip(self.solids.as_ref()) else {
            return Ok(None);
        };
        let (solids, dt) = (self.simulation.solids(), report.dt);
        Ok(match scheme {
            CouplingScheme::Weak => None,
            _ if both.condensed => Some(Corrections::Condensed {
                wet_nodes: self.path().wet_nodes()?,
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

    fn rows(&self, machine: &Machine) -> (Row, Vec<StageRow>) {
        let median = |value: &dyn Fn(&Sample) -> f64| {
            Spread::of(self.samples.iter().map(value).collect()).median
        };
        let seconds = Spread::of(self.samples.iter().map(|sample| sample.seconds).collect());
        let names = |sample: &Sample| -> Vec<&'static str> {
            let seconds = sample.report.seconds.iter();
            seconds.map(|(stage, _)| *stage).collect()
        };
        let timestamps = self.path().gpu().report().timestamps;
        let stages = self.samples.first().map(names).unwrap_or_default();
        let stages: Vec<StageRow> = stages
            .into_iter()
            .map(|stage| {
                let spent = |sample: &Sample| {
                    let seconds = sample.report.seconds.iter();
                    seconds
                        .filter(|(name, _)| *name == stage)
                        .map(|(_, seconds)| seconds)
                        .sum::<f64>()
                };
                let seconds = Spread::of(self.samples.iter().map(spent).collect());
                let bytes = median(&|sample| self.bytes(stage, sample));
                let share = || machine.share_of_copy_bandwidth(bytes, seconds.median);
                StageRow {
                    scene: self.scene.name.clone(),
                    scale: self.scene.scale,
                    stage,
                    place: place(stage, timestamps),
                    seconds_median: seconds.median,
                    seconds_min: seconds.min,
                    seconds_max: seconds.max,
                    bytes,
                    share_of_copy_bandwidth: (bytes > 0.0 && seconds.median > 0.0).then(share),
                }
            })
            .collect();
        let bytes = median(&|sample| STAGES.iter().map(|stage| self.bytes(stage, sample)).sum());
        let last = self
            .samples
            .last()
            .and_then(|sample| sample.report.liquid)
            .map_or(0, |liquid| liquid.markers);
        let unknowns = median(&Sample::unknowns);
        let row = Row {
            scene: self.scene.name.clone(),
            scale: self.scene.scale,
            cells: self.scene.grid().n_cells(),
            markers: last,
            unknowns,
            band_cells: median(&|sample| sample.band_cells as f64),
            iterations: median(&Sample::iterations),
            nodes: self.simulation.solids().rest.len(),
            elements: self.simulation.solids().elements.len(),
            solid_unknowns: median(&|sample| sample.of_solids(|solid| solid.solve.unknowns as f64)),
            solid_iterations: median(&Sample::solid_iterations),
            sub_steps: self.samples.len(),
            seconds_median: seconds.median,
            seconds_min: seconds.min,
            seconds_max: seconds.max,
            cells_per_second: unknowns / seconds.median,
            bytes,
            share_of_copy_bandwidth: machine.share_of_copy_bandwidth(bytes, seconds.median),
        };
        (row, stages)
    }

    /// Bytes of a scalar of the solve's unknowns, and of its corrections.
    fn scalar_bytes(&self) -> [f64; 2] {
        self.path().scalar_bytes().map(|bytes| bytes as f64)
    }

    /// Bytes that a stage must move in a sub-step, every array that a kernel needs once, reads and writes.
    fn bytes(&self, stage: &str, sample: &Sample) -> f64 {
        if stage == "solve" {
            return self.solve_bytes(sample);
        }
        let mut bytes = 0.0;
        if self.scene.liquid.is_some() {
            bytes += self.liquid_bytes(stage, sample);
        }
        if let Some((solids, _)) = &self.solids {
            let effects = Effects::of(&self.scene);
            bytes += solids.of_stage(stage, effects.scripts, effects.obstacles);
        }
        bytes
    }

    /// Of all solves of a sub-step.
    fn solve_bytes(&self, sample: &Sample) -> f64 {
        let [real, inner] = self.scalar_bytes();
        let liquid = SolveBytes {
            unknowns: sample.unknowns(),
            not_uniform: self.not_uniform,
            iterations: sample.iterations(),
            rounds: rounds(inner),
            widths: [inner, real],
            preconditioner: self.scene.solver.preconditioner,
        };
        // The size of the right-hand side.
        let start = liquid.unknowns * real;
        let Some((solids, bounds)) = &self.solids else {
            return start + liquid.of_pressure();
        };
        if let Some(corrections) = sample.corrections {
            return start + liquid.of_both(solids, corrections);
        }
        let degree = bounds.chebyshev_degree(self.simulation.solids(), sample.report.dt) as f64;
        // The corrections of solids by themselves are as precise as their residuals.
        let of_solids = solids.of_solve(degree, sample.solid_iterations(), rounds(real));
        start + liquid.of_pressure() + of_solids
    }

    /// Per cell of the band, per unknown, per marker, and per padded cell of the domain where flags are counted. Words of a quad
    /// (flags, marks, list entries) count a byte per cell.
    fn liquid_bytes(&self, stage: &str, sample: &Sample) -> f64 {
        let effects = Effects::of(&self.scene);
        let [real, inner] = self.scalar_bytes();
        let padded = self.scene.grid().padded().len() as f64;
        // The coarser levels hold a seventh of the finest.
        let all_levels = padded * 8.0 / 7.0;
        let band = sample.band_cells as f64;
        let unknowns = sample.unknowns();
        let markers = if effects.markers {
            sample.of_liquid(|liquid| liquid.markers as f64)
        } else {
            0.0
        };
        let bodies = f64::from(u8::from(effects.cuts()));
        let layers = extrapolation_layers(self.scene.time.cfl) as f64;
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

/// Rounds of a solve whose corrections have scalars of so many bytes: one in f64 does it all; in f32 it takes another, as a rule.
fn rounds(of_corrections: f64) -> f64 {
    if of_corrections < 8.0 { 2.0 } else { 1.0 }
}

/// Where the seconds of a stage are spent, on a device that tells its own or does not.
fn place(stage: &str, timestamps: bool) -> &'static str {
    match (stage == Clip::NAME, timestamps) {
        (false, _) => "device",
        (true, true) => "host and device",
        (true, false) => "host",
    }
}

/// The stages whose bytes are known; they make up those of a sub-step.
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

/// Sub-steps by turns, until each run has its frames, as often as asked.
fn interleave(runs: &mut [Run], options: &Options) -> Result<(), Error> {
    let starts = runs
        .iter()
        .map(|run| run.simulation.state())
        .collect::<Result<Vec<_>, _>>()?;
    for repeat in 0..options.repeats.max(1) {
        if repeat > 0 {
            for (run, start) in runs.iter_mut().zip(&starts) {
                run.simulation.reset(start)?;
            }
        }
        let mut first = true;
        while runs
            .iter()
            .any(|run| run.simulation.clock().frame < options.frames)
        {
            for run in &mut *runs {
                if run.simulation.clock().frame < options.frames {
                    run.step(!first)?;
                }
            }
            first = false;
        }
    }
    if runs.iter().any(|run| run.samples.is_empty()) {
        return Err(Error::input(
            format!("--frames {}", options.frames),
            "the first sub-step is not counted, and there was no other",
            "measure more frames",
        ));
    }
    Ok(())
}

/// A bar per scene: the stages' medians one above another, and a mark at the wall-clock median.
fn draw(table: &Table, page: SVGBackend) -> Result<(), Box<dyn std::error::Error>> {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let of_row = |row: &Row| -> Vec<&StageRow> {
        let stages = table.stages.iter();
        let of_row = |stage: &&StageRow| stage.scene == row.scene && stage.scale == row.scale;
        stages.filter(of_row).collect()
    };
    let milliseconds = |seconds: f64| 1e3 * seconds;
    let top = table
        .rows
        .iter()
        .map(|row| {
            let sum: f64 = of_row(row).iter().map(|stage| stage.seconds_median).sum();
            milliseconds(sum.max(row.seconds_median))
        })
        .fold(0.0, f64::max);
    let n = table.rows.len() as f64;
    let mut chart = ChartBuilder::on(&root)
        .caption(
            format!("Sub-step, {}", table.machine.adapter),
            ("sans-serif", 20),
        )
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(70)
        .build_cartesian_2d(0.0..n + 1.2, 0.0..1.1 * top)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .disable_x_axis()
        .y_desc("ms a sub-step")
        .draw()?;
    let mut names: Vec<&'static str> = Vec::new();
    for row in &table.stages {
        if !names.contains(&row.stage) {
            names.push(row.stage);
        }
    }
    for (index, stage) in names.into_iter().enumerate() {
        let colour = ink(index);
        let bars = table.rows.iter().enumerate().filter_map(|(number, row)| {
            let stages = of_row(row);
            let at = stages.iter().position(|other| other.stage == stage)?;
            let below: f64 = stages[..at].iter().map(|stage| stage.seconds_median).sum();
            let height = stages[at].seconds_median;
            let x = number as f64;
            Some(Rectangle::new(
                [
                    (x + 0.2, milliseconds(below)),
                    (x + 0.8, milliseconds(below + height)),
                ],
                colour.filled(),
            ))
        });
        chart
            .draw_series(bars)?
            .label(stage)
            .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 14, y + 5)], colour.filled()));
    }
    for (number, row) in table.rows.iter().enumerate() {
        let x = number as f64;
        let y = milliseconds(row.seconds_median);
        chart.draw_series([PathElement::new(
            [(x + 0.1, y), (x + 0.9, y)],
            BLACK.stroke_width(2),
        )])?;
        let label = format!("{}, {} cells: {y:.1} ms", row.scene, row.cells);
        let at = (x + 0.1, y + 0.03 * top);
        chart.draw_series([Text::new(label, at, ("sans-serif", 13))])?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::MiddleRight)
        .border_style(BLACK)
        .background_style(WHITE)
        .draw()?;
    root.present()?;
    Ok(())
}
