//! Scenes being timed, and the bytes that their stages must move.

use std::time::Instant;

use crate::Error;
use crate::effects::Effects;
use crate::elastic::{Bounds, Solids};
use crate::fields::extrapolation_layers;
use crate::gpu::{Trace, Traffic};
use crate::scene::{CouplingScheme, Scene};
use crate::sim::{Backend, GpuPath, Simulation};
use crate::state::{LiquidReport, SolidReport, StepReport};
use crate::step::Stage;

use super::super::bench_solve::{Corrections, SolveBytes};
use super::super::solid_bytes::SolidBytes;
use super::super::statistics::Spread;
use super::super::table::Machine;
use super::{Case, Options, Row, StageRow};

/// No more runs of a scene are begun once its sub-steps have taken so long, s.
const LONG_ENOUGH: f64 = 60.0;

/// What sub-steps do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Liquid and solids do not touch, or there is one of them.
    Apart,
    /// They are solved for together, or with weak coupling one after the other.
    Touching,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Kind::Apart => "apart",
            Kind::Touching => "touching",
        }
    }
}

/// What was measured of a scene.
pub(super) struct Record {
    case: Case,
    solids: Solids,
    /// What decides the bytes of the solids' stages, and the degree of their preconditioner; `None` without solids.
    of_solids: Option<(SolidBytes, Bounds)>,
    /// Bytes of a scalar of the solve's unknowns, and of its corrections.
    widths: [usize; 2],
    /// Whether the device tells the seconds of its stages.
    timestamps: bool,
    /// Bytes of all buffers.
    device_bytes: u64,
    /// Of each run from the start, its sub-steps but for the first of each kind.
    repeats: Vec<Vec<Sample>>,
}

/// A run from a scene's start.
pub(super) struct Run<'a> {
    record: &'a mut Record,
    simulation: Simulation,
    /// Kinds of sub-steps that it has had.
    kinds: Vec<Kind>,
}

/// One sub-step.
struct Sample {
    seconds: f64,
    band_cells: usize,
    /// Share of the active quads whose weights are loaded.
    not_uniform: f64,
    /// How liquid and solids were solved for together; `None` where each was by itself.
    corrections: Option<Corrections>,
    report: StepReport,
    traffic: Traffic,
    trace: Trace,
}

impl Sample {
    fn kind(&self) -> Kind {
        match self.report.coupling {
            Some(coupling) if coupling.touching => Kind::Touching,
            _ => Kind::Apart,
        }
    }

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

impl Run<'_> {
    /// The first of a kind compiles and is not counted.
    fn step(&mut self) -> Result<(), Error> {
        let gpu = path_of(&self.simulation).gpu();
        gpu.start_trace();
        let before = gpu.traffic();
        let clock = Instant::now();
        let report = self.simulation.step()?;
        let seconds = clock.elapsed().as_secs_f64();
        let path = path_of(&self.simulation);
        let traffic = path.gpu().traffic().since(before);
        let trace = path.gpu().take_trace();
        let sample = Sample {
            seconds,
            band_cells: path.band_cells()?,
            not_uniform: path.share_not_uniform()?,
            corrections: self.record.corrections(path, &report)?,
            report,
            traffic,
            trace,
        };
        let kind = sample.kind();
        if !self.kinds.contains(&kind) {
            self.kinds.push(kind);
            return Ok(());
        }
        let repeat = self.record.repeats.last_mut();
        repeat.expect("a run has begun").push(sample);
        Ok(())
    }
}

fn path_of(simulation: &Simulation) -> &GpuPath {
    let path = simulation.gpu_path();
    path.expect("benches run on the GPU path")
}

impl Record {
    /// Of a case that `simulation` is of.
    fn new(case: &Case, simulation: &Simulation) -> Record {
        let path = path_of(simulation);
        let widths = path.scalar_bytes();
        let solids = path.solids();
        Record {
            case: case.clone(),
            of_solids: solids.map(|solids| (SolidBytes::new(solids, widths), Bounds::new(solids))),
            solids: simulation.solids().clone(),
            widths,
            timestamps: path.gpu().report().timestamps,
            device_bytes: path.gpu().allocated().iter().map(|(_, bytes)| bytes).sum(),
            repeats: Vec::new(),
        }
    }

    fn scene(&self) -> &Scene {
        &self.case.scene
    }

    /// Refuses a run whose sub-steps are not those of the first one: they are compared number by number.
    fn ensure_repeated(&self) -> Result<(), Error> {
        let kinds = |repeat: &[Sample]| repeat.iter().map(Sample::kind).collect::<Vec<_>>();
        let count = |repeat: &[Sample]| {
            let touching = kinds(repeat).into_iter().filter(|&k| k == Kind::Touching);
            format!("{} sub-steps, {} touching", repeat.len(), touching.count())
        };
        let [first, .., again] = &self.repeats[..] else {
            return Ok(());
        };
        if kinds(first) == kinds(again) {
            return Ok(());
        }
        Err(Error::Check(format!(
            "{}: the same run had {}, then {}\n  cure: use another adapter (--adapter) or driver: this one does not repeat",
            self.scene().name,
            count(first),
            count(again)
        )))
    }

    fn taken(&self) -> f64 {
        let samples = self.repeats.iter().flatten();
        samples.map(|sample| sample.seconds).sum()
    }

    /// How liquid and solids were solved for together in the last sub-step of a path, whose report this is.
    fn corrections(
        &self,
        path: &GpuPath,
        report: &StepReport,
    ) -> Result<Option<Corrections>, Error> {
        let scheme = self.scene().solver.coupling;
        let touching = report.coupling.filter(|both| both.touching);
        let Some((both, (_, bounds))) = touching.zip(self.of_solids.as_ref()) else {
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

    /// A row, and those of its stages, for each kind of sub-steps that there are.
    pub(super) fn rows(&self, machine: &Machine) -> Vec<(Row, Vec<StageRow>)> {
        let kinds = [Kind::Apart, Kind::Touching].into_iter();
        let rows = kinds.filter_map(|kind| {
            // The same sub-steps in every run.
            let repeats = self.repeats.iter().map(|repeat| {
                let of_kind = repeat.iter().filter(|sample| sample.kind() == kind);
                of_kind.collect()
            });
            let repeats: Vec<Vec<&Sample>> = repeats.collect();
            let any = repeats.first().is_some_and(|first| !first.is_empty());
            any.then(|| self.of_kind(kind, &repeats, machine))
        });
        rows.collect()
    }

    /// Of the sub-steps of a kind in each run.
    fn of_kind(
        &self,
        kind: Kind,
        repeats: &[Vec<&Sample>],
        machine: &Machine,
    ) -> (Row, Vec<StageRow>) {
        let first = &repeats[0];
        // But for times all runs say the same.
        let mean = |value: &dyn Fn(&Sample) -> f64| mean(first, value);
        let seconds = over_repeats(repeats, &|sample| sample.seconds);
        let of_number = |n: usize| {
            let seconds = repeats.iter().map(|repeat| repeat[n].seconds);
            Spread::of(seconds.collect()).median
        };
        let sub_steps = Spread::of((0..first.len()).map(of_number).collect());
        let (scene, solids) = (self.scene(), &self.solids);
        let mut names: Vec<&'static str> = Vec::new();
        for (stage, _) in first.iter().flat_map(|sample| &sample.report.seconds) {
            if !names.contains(stage) {
                names.push(stage);
            }
        }
        let stage_row = |stage: &'static str| {
            let seconds = over_repeats(repeats, &|sample| {
                let seconds = sample.report.seconds.iter();
                let of_stage = seconds.filter(|(name, _)| *name == stage);
                of_stage.map(|(_, seconds)| seconds).sum()
            });
            let bytes = mean(&|sample| self.bytes(stage, sample));
            let dispatches = |sample: &Sample| {
                let of_stage = sample.trace.dispatches.iter();
                of_stage.filter(|(name, _)| *name == stage).count() as f64
            };
            let waits = |sample: &Sample| {
                let of_stage = sample.trace.waits.iter();
                of_stage.filter(|name| **name == stage).count() as f64
            };
            let share = || machine.share_of_copy_bandwidth(bytes, seconds.median);
            StageRow {
                scene: scene.name.clone(),
                scale: scene.scale,
                solids_scale: self.case.solids_scale,
                kind: kind.name(),
                stage,
                place: place(stage, self.timestamps),
                seconds_median: seconds.median,
                seconds_min: seconds.min,
                seconds_max: seconds.max,
                bytes,
                share_of_copy_bandwidth: (bytes > 0.0 && seconds.median > 0.0).then(share),
                dispatches: mean(&dispatches),
                waits: mean(&waits),
            }
        };
        let stages = names.into_iter().map(stage_row).collect();
        let bytes = mean(&|sample| STAGES.iter().map(|stage| self.bytes(stage, sample)).sum());
        let last = first.last().and_then(|sample| sample.report.liquid);
        let unknowns = mean(&Sample::unknowns);
        let row = Row {
            scene: scene.name.clone(),
            scale: scene.scale,
            solids_scale: self.case.solids_scale,
            cells: scene.grid().n_cells(),
            nodes: solids.rest.len(),
            elements: solids.elements.len(),
            kind: kind.name(),
            sub_steps: first.len(),
            simulated: first.iter().map(|sample| sample.report.dt).sum(),
            markers: last.map_or(0, |liquid| liquid.markers),
            unknowns,
            band_cells: mean(&|sample| sample.band_cells as f64),
            iterations: mean(&Sample::iterations),
            solid_unknowns: mean(&|sample| sample.of_solids(|solid| solid.solve.unknowns as f64)),
            solid_iterations: mean(&Sample::solid_iterations),
            runs: repeats.len(),
            seconds_median: seconds.median,
            seconds_min: seconds.min,
            seconds_max: seconds.max,
            sub_step_seconds_median: sub_steps.median,
            sub_step_seconds_min: sub_steps.min,
            sub_step_seconds_max: sub_steps.max,
            cells_per_second: unknowns / seconds.median,
            bytes,
            share_of_copy_bandwidth: machine.share_of_copy_bandwidth(bytes, seconds.median),
            waits: mean(&|sample| sample.traffic.waits as f64),
            submissions: mean(&|sample| sample.traffic.submissions as f64),
            dispatches: mean(&|sample| sample.traffic.dispatches as f64),
            bytes_up: mean(&|sample| sample.traffic.bytes_up as f64),
            bytes_down: mean(&|sample| sample.traffic.bytes_down as f64),
            idle_seconds: over_repeats(repeats, &|sample| sample.traffic.idle_seconds).median,
            device_bytes: self.device_bytes,
        };
        (row, stages)
    }

    /// Bytes of a scalar of the solve's unknowns, and of its corrections.
    fn scalar_bytes(&self) -> [f64; 2] {
        self.widths.map(|bytes| bytes as f64)
    }

    /// Bytes that a stage must move in a sub-step, every array that a kernel needs once, reads and writes.
    fn bytes(&self, stage: &str, sample: &Sample) -> f64 {
        if stage == Stage::Solve.name() {
            return self.solve_bytes(sample);
        }
        let mut bytes = 0.0;
        if self.scene().liquid.is_some() {
            bytes += self.liquid_bytes(stage, sample);
        }
        if let Some((solids, _)) = &self.of_solids {
            let effects = Effects::of(self.scene());
            bytes += solids.of_stage(stage, effects.scripts, effects.obstacles);
        }
        bytes
    }

    /// Of all solves of a sub-step.
    fn solve_bytes(&self, sample: &Sample) -> f64 {
        let [real, inner] = self.scalar_bytes();
        let liquid = SolveBytes {
            unknowns: sample.unknowns(),
            not_uniform: sample.not_uniform,
            iterations: sample.iterations(),
            rounds: rounds(inner),
            widths: [inner, real],
            preconditioner: self.scene().solver.preconditioner,
        };
        // The size of the right-hand side.
        let start = liquid.unknowns * real;
        let Some((solids, bounds)) = &self.of_solids else {
            return start + liquid.of_pressure();
        };
        if let Some(corrections) = sample.corrections {
            return start + liquid.of_both(solids, corrections);
        }
        let degree = bounds.chebyshev_degree(&self.solids, sample.report.dt) as f64;
        // The corrections of solids by themselves are as precise as their residuals.
        let of_solids = solids.of_solve(degree, sample.solid_iterations(), rounds(real));
        start + liquid.of_pressure() + of_solids
    }

    /// Per cell of the band, per unknown, per marker, and per padded cell of the domain where flags are counted. Words of a quad
    /// (flags, marks, list entries) count a byte per cell.
    fn liquid_bytes(&self, stage: &str, sample: &Sample) -> f64 {
        let effects = Effects::of(self.scene());
        let [real, inner] = self.scalar_bytes();
        let padded = self.scene().grid().padded().len() as f64;
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
        let layers = extrapolation_layers(self.scene().time.cfl) as f64;
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
    match (stage == Stage::Clip.name(), timestamps) {
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

/// Of a value of each sub-step.
fn mean(samples: &[&Sample], value: &dyn Fn(&Sample) -> f64) -> f64 {
    samples.iter().map(|sample| value(sample)).sum::<f64>() / samples.len() as f64
}

/// Of the mean over a run's sub-steps, over the runs.
fn over_repeats(repeats: &[Vec<&Sample>], value: &dyn Fn(&Sample) -> f64) -> Spread {
    Spread::of(repeats.iter().map(|samples| mean(samples, value)).collect())
}

/// What is measured of a scene, and of the same one in a larger domain where that is asked for.
pub(super) struct Group {
    cases: Vec<Case>,
    records: Vec<Record>,
}

impl Group {
    pub(super) fn new(cases: Vec<Case>) -> Group {
        Group {
            cases,
            records: Vec::new(),
        }
    }

    pub(super) fn records(&self) -> &[Record] {
        &self.records
    }

    /// Whether it has had as many runs as asked, or as there is time for.
    pub(super) fn is_done(&self, repeats: usize) -> bool {
        let taken = self.records.iter().map(Record::taken).sum::<f64>();
        let runs = self
            .records
            .first()
            .map_or(0, |record| record.repeats.len());
        runs >= repeats.max(1) || taken > LONG_ENOUGH
    }

    /// Another run of each from its start, sub-steps by turns, until each has its frames. What it was made with is gone after it: all scenes together
    /// may be more than there is room for.
    ///
    /// # Errors
    /// [`Error::Check`] where a run does not repeat, [`Error::Input`] where there are no sub-steps to count, and what simulations say.
    pub(super) fn run(&mut self, options: &Options) -> Result<(), Error> {
        let backend = Backend::Gpu(options.adapter.clone());
        let simulations = self.cases.iter();
        let simulations = simulations.map(|case| Simulation::new(&case.scene, &backend));
        let simulations: Vec<Simulation> = simulations.collect::<Result<_, _>>()?;
        if self.records.is_empty() {
            let both = self.cases.iter().zip(&simulations);
            let records = both.map(|(case, simulation)| Record::new(case, simulation));
            self.records = records.collect();
        }
        let mut runs = Vec::new();
        for (record, simulation) in self.records.iter_mut().zip(simulations) {
            record.repeats.push(Vec::new());
            runs.push(Run {
                record,
                simulation,
                kinds: Vec::new(),
            });
        }
        let goes_on = |run: &Run| run.simulation.clock().frame < options.frames;
        while runs.iter().any(goes_on) {
            for run in runs.iter_mut().filter(|run| goes_on(run)) {
                run.step()?;
            }
        }
        let mut records = self.records.iter();
        records.clone().try_for_each(Record::ensure_repeated)?;
        if records.any(|record| record.repeats.iter().all(Vec::is_empty)) {
            return Err(Error::input(
                format!("--frames {}", options.frames),
                "the first sub-step of a kind is not counted, and there was no other",
                "measure more frames",
            ));
        }
        Ok(())
    }
}
