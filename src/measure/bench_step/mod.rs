//! `bench step`: seconds of a sub-step, all stages, against what a copy of the bytes that each stage must touch would take.
//!
//! Sub-steps are timed on the host from the upload of the step's numbers to its report; the stages on the device by timestamps,
//! where the adapter has them. Scenes run from their start, one after the other and then all again; the first sub-step of each kind, which compiles and
//! warms caches up, is not counted. Every run of a scene has the same sub-steps; those in which liquid and solids touch are told apart from the others. With
//! a second domain, every sub-step of the scene is followed by one of the same scene in the larger domain, so that what else
//! the machine does falls on both.

mod growth;
mod picture;
mod run;
mod sizes;

use std::path::Path;

use serde::Serialize;

use crate::Error;
use crate::gpu::{AdapterChoice, Gpu};
use crate::output::FolderLock;
use crate::scene::Scene;

use super::table::{Machine, remove_earlier, write_csv, write_json, write_svg};

pub use growth::Growth;
use run::Group;
pub use sizes::{Case, largest_scale};

/// What to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Scenes, scaled; the same one may be there at several scales.
    pub scenes: Vec<Case>,
    /// Frames of each.
    pub frames: u64,
    /// How often each is run from its start; no more are begun once its sub-steps have taken a minute.
    pub repeats: usize,
    /// How many times larger the domain of a second run of each scene is along x, y, z.
    pub larger_domain: Option<[usize; 3]>,
    /// Where.
    pub adapter: AdapterChoice,
}

/// A row of step.csv: the sub-steps of a kind. What is counted in a sub-step is told as the mean over them; it is the same in every run.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the scene.
    pub scene: String,
    /// What its cells are multiplied by.
    pub scale: f64,
    /// What the edges of its solids' elements are divided by.
    pub solids_scale: f64,
    /// Cells of the domain.
    pub cells: usize,
    /// Nodes of the solids.
    pub nodes: usize,
    /// Elements of the solids.
    pub elements: usize,
    /// `touching`: those in which liquid and solids touch; `apart`: the others.
    pub kind: &'static str,
    /// Sub-steps of a run.
    pub sub_steps: usize,
    /// The time that they simulate, s.
    pub simulated: f64,
    /// Markers after the last of them.
    pub markers: usize,
    /// Unknowns of the pressure solve.
    pub unknowns: f64,
    /// Cells of the band, where the stages work.
    pub band_cells: f64,
    /// Iterations of the pressure solve.
    pub iterations: f64,
    /// Unknowns of the solids' solve.
    pub solid_unknowns: f64,
    /// Iterations of the solids' solve.
    pub solid_iterations: f64,
    /// Runs from the start.
    pub runs: usize,
    /// Wall-clock seconds of a sub-step, the mean over those of a run: median of the runs.
    pub seconds_median: f64,
    /// Least.
    pub seconds_min: f64,
    /// Largest.
    pub seconds_max: f64,
    /// Wall-clock seconds of each sub-step, the median over the runs: median of the sub-steps.
    pub sub_step_seconds_median: f64,
    /// Of the shortest.
    pub sub_step_seconds_min: f64,
    /// Of the longest.
    pub sub_step_seconds_max: f64,
    /// Unknowns of the pressure solve per second of `seconds_median`.
    pub cells_per_second: f64,
    /// Bytes that a sub-step must move.
    pub bytes: f64,
    /// Bytes per second over the copy bandwidth of the same run.
    pub share_of_copy_bandwidth: f64,
    /// Times that the host waits for the device in a sub-step.
    pub waits: f64,
    /// Submissions in a sub-step.
    pub submissions: f64,
    /// Dispatches in a sub-step.
    pub dispatches: f64,
    /// Bytes that the host writes to buffers in a sub-step.
    pub bytes_up: f64,
    /// Bytes that the host reads back in a sub-step.
    pub bytes_down: f64,
    /// Seconds of a sub-step in which nothing is queued on the device, the mean over those of a run: median of the runs.
    pub idle_seconds: f64,
    /// Bytes of all device buffers.
    pub device_bytes: u64,
}

/// A row of step_stages.csv.
#[derive(Clone, Debug, Serialize)]
pub struct StageRow {
    /// Name of the scene.
    pub scene: String,
    /// What its cells are multiplied by.
    pub scale: f64,
    /// As in [`Row`].
    pub solids_scale: f64,
    /// As in [`Row`].
    pub kind: &'static str,
    /// The stage.
    pub stage: &'static str,
    /// Where its seconds are spent: `device`; those of `clip` on the `host`, or `host and device` where the device tells its own.
    #[serde(rename = "where")]
    pub place: &'static str,
    /// Seconds in a sub-step, the mean over those of a run: median of the runs.
    pub seconds_median: f64,
    /// Least.
    pub seconds_min: f64,
    /// Largest.
    pub seconds_max: f64,
    /// Bytes that the stage must move in a sub-step, mean; 0 for `clip` and `exchange`, which have no model.
    pub bytes: f64,
    /// Bytes per second over the copy bandwidth of the same run; empty where bytes or seconds are 0.
    pub share_of_copy_bandwidth: Option<f64>,
    /// Dispatches in a sub-step, mean.
    pub dispatches: f64,
    /// Waits in a sub-step that follow a submission ending with this stage, mean.
    pub waits: f64,
}

impl StageRow {
    /// Whether it is of these sub-steps.
    fn belongs_to(&self, row: &Row) -> bool {
        let of = (&self.scene, self.scale, self.solids_scale, self.kind);
        of == (&row.scene, row.scale, row.solids_scale, row.kind)
    }
}

/// Sub-steps of a kind of a scene in its domain and in a larger one.
#[derive(Clone, Debug, Serialize)]
pub struct Pair {
    /// Name of the scene.
    pub scene: String,
    /// What its cells are multiplied by.
    pub scale: f64,
    /// As in [`Row`].
    pub solids_scale: f64,
    /// As in [`Row`].
    pub kind: &'static str,
    /// How many times larger the domain is along x, y, z.
    pub larger: [usize; 3],
    /// Median seconds of a sub-step in the larger domain over those in the scene's own.
    pub ratio: f64,
    /// The same of the least seconds, on which other work of the machine tells less.
    pub ratio_of_least: f64,
}

/// The tables and where they were measured.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// Where.
    #[serde(flatten)]
    pub machine: Machine,
    /// A row per scene, domain and kind of sub-steps.
    pub rows: Vec<Row>,
    /// A row for each of them and each stage.
    pub stages: Vec<StageRow>,
    /// A row per scene and kind of sub-steps that both domains have, where a larger domain was asked for.
    pub pairs: Vec<Pair>,
    /// A row per scene, kind of sub-steps and what grows.
    pub growth: Vec<Growth>,
}

/// Measures all scenes and writes step.csv, step_stages.csv, step_growth.csv where a scene has several sizes, step.json and step.svg into `out`,
/// anew after each run; `tell` hears of each row when its scene has had its runs.
///
/// # Errors
/// Before any work [`Error::Output`] where the folder cannot be written and [`Error::Input`] where another process writes into it; then
/// [`Error::Check`] where a scene's runs do not have the same sub-steps, and what the simulations say.
pub fn bench_step(
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(&Row),
) -> Result<Table, Error> {
    let _held = FolderLock::take(out)?;
    remove_earlier(out, &["step_growth.csv"])?;
    if options.scenes.is_empty() {
        return Err(Error::input(
            "bench step",
            "no scene to measure",
            "give one scene file or more",
        ));
    }
    let mut table = Table {
        machine: Machine::new(&Gpu::new(&options.adapter)?, options.repeats)?,
        rows: Vec::new(),
        stages: Vec::new(),
        pairs: Vec::new(),
        growth: Vec::new(),
    };
    let groups = options.scenes.iter().map(|case| {
        let larger = options.larger_domain.map(|factors| Case {
            scene: in_larger_domain(&case.scene, factors),
            ..*case
        });
        Group::new([case.clone()].into_iter().chain(larger).collect())
    });
    let mut groups: Vec<Group> = groups.collect();
    // Every scene once, then all of them again: what the machine does meanwhile is in the spread of each.
    for _ in 0..options.repeats.max(1) {
        for number in 0..groups.len() {
            let group = &mut groups[number];
            if group.is_done(options.repeats) {
                continue;
            }
            group.run(options)?;
            if group.is_done(options.repeats) {
                let rows = group.records().iter();
                let rows = rows.flat_map(|record| record.rows(&table.machine));
                rows.for_each(|(row, _)| tell(&row));
            }
            table.gather(&groups, options.larger_domain);
            table.write(out)?;
        }
    }
    Ok(table)
}

impl Table {
    /// Makes all rows again, of what there is so far.
    fn gather(&mut self, groups: &[Group], larger_domain: Option<[usize; 3]>) {
        self.rows.clear();
        self.stages.clear();
        self.pairs.clear();
        for group in groups {
            let mut of_domains = Vec::new();
            for record in group.records() {
                let rows = record.rows(&self.machine);
                let (rows, stages): (Vec<Row>, Vec<_>) = rows.into_iter().unzip();
                self.rows.extend(rows.clone());
                self.stages.extend(stages.into_iter().flatten());
                of_domains.push(rows);
            }
            if let (Some(larger), [own, other]) = (larger_domain, &of_domains[..]) {
                self.pairs.extend(pairs(larger, own, other));
            }
        }
    }

    /// Makes again what follows from the rows, and writes what there is.
    fn write(&mut self, out: &Path) -> Result<(), Error> {
        self.growth = growth::growth(&self.rows);
        write_csv(&self.rows, &out.join("step.csv"))?;
        write_csv(&self.growth, &out.join("step_growth.csv"))?;
        write_csv(&self.stages, &out.join("step_stages.csv"))?;
        write_json(self, &out.join("step.json"))?;
        write_svg(&out.join("step.svg"), picture::size(self), |page| {
            picture::draw(self, page)
        })
    }
}

/// Of the kinds that both domains have.
fn pairs(larger: [usize; 3], own: &[Row], other: &[Row]) -> Vec<Pair> {
    let both = own.iter().filter_map(|own| {
        let other = other.iter().find(|other| other.kind == own.kind)?;
        Some(Pair {
            scene: own.scene.clone(),
            scale: own.scale,
            solids_scale: own.solids_scale,
            kind: own.kind,
            larger,
            ratio: other.seconds_median / own.seconds_median,
            ratio_of_least: other.seconds_min / own.seconds_min,
        })
    });
    both.collect()
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

#[cfg(test)]
mod tests {
    use super::Row;

    /// A row of a scene with so many cells and nodes, whose sub-steps take as many seconds as it has cells.
    pub(super) fn row(scale: f64, solids_scale: f64, [cells, nodes]: [usize; 2]) -> Row {
        let seconds = cells as f64;
        Row {
            scene: "made_up".to_owned(),
            scale,
            solids_scale,
            cells,
            nodes,
            elements: 5 * nodes,
            kind: "touching",
            sub_steps: 2,
            simulated: 0.1,
            markers: 8,
            unknowns: 1.0,
            band_cells: 1.0,
            iterations: 1.0,
            solid_unknowns: 1.0,
            solid_iterations: 1.0,
            runs: 1,
            seconds_median: seconds,
            seconds_min: seconds,
            seconds_max: seconds,
            sub_step_seconds_median: seconds,
            sub_step_seconds_min: seconds,
            sub_step_seconds_max: seconds,
            cells_per_second: 1.0,
            bytes: 1.0,
            share_of_copy_bandwidth: 1.0,
            waits: 1.0,
            submissions: 1.0,
            dispatches: 1.0,
            bytes_up: 1.0,
            bytes_down: 1.0,
            idle_seconds: 0.0,
            device_bytes: 1,
        }
    }
}
