//! Sweeps: a run for every combination of values of some keys of a scene. Each has its own folder, and a table summarises the folders.

use std::collections::BTreeSet;
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::OnceLock;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::probe_statistics::{self, NAMES, Statistics};
use super::{cell, remove, write_csv, write_json};
use crate::Error;
use crate::output::manifest::{Manifest, RunStatus, Tally};
use crate::scene::{Scene, names, override_option};

/// Most runs of a sweep: a folder each.
const MAX_RUNS: usize = 100_000;
/// Longest name of a folder without the hash that makes it unique; file systems allow 255 bytes.
const LONGEST_NAME: usize = 150;
/// Record of the sweep about a run, in the run's folder.
const RECORD: &str = "sweep.json";
/// Output of the run, in the run's folder.
pub const LOG: &str = "log.txt";
/// Lock of the sweep and the run that it started, in the run's folder; a run outside a sweep has another.
const LOCK: &str = ".sweep.lock";
/// Attempts to lock a run: a process that writes a summary locks it for a moment to see whether it is free.
const LOCK_TRIES: u32 = 20;
const LOCK_PAUSE: Duration = Duration::from_millis(20);

/// A key of the scene and its values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Axis {
    /// Dotted key, such as `solid[0].young`.
    pub key: String,
    /// Distinct TOML values as written.
    pub values: Vec<String>,
}

impl FromStr for Axis {
    type Err = Error;

    /// Parses `KEY=V1,V2,...`; commas within brackets, braces and quotes are part of a value.
    fn from_str(text: &str) -> Result<Axis, Error> {
        let refused = |problem: String, cure| Error::input(format!("--set {text}"), problem, cure);
        let cure = "write --set KEY=V1,V2, such as --set liquid.density=800,1000";
        let (key, list) = text.split_once('=').ok_or_else(|| refused("has no `=`".into(), cure))?;
        let values = split(list).ok_or_else(|| {
            let problem = format!("the brackets or quotes of `{list}` do not match");
            refused(problem, "close them, within single quotes for the shell")
        })?;
        if values.iter().any(String::is_empty) {
            return Err(refused("has an empty value".into(), cure));
        }
        let mut seen = BTreeSet::new();
        if let Some(twice) = values.iter().find(|value| !seen.insert(value.as_str())) {
            return Err(refused(format!("has the value {twice} twice"), "give each value once"));
        }
        Ok(Axis { key: key.trim().to_owned(), values })
    }
}

/// Parts between commas outside brackets, braces and quotes; `None` if these do not match.
fn split(list: &str) -> Option<Vec<String>> {
    let mut values = vec![String::new()];
    let (mut open, mut quote, mut escaped) = (Vec::new(), None, false);
    for c in list.chars() {
        match (quote, c) {
            (Some(_), _) if escaped => escaped = false,
            (Some('"'), '\\') => escaped = true,
            (Some(mark), _) if mark == c => quote = None,
            (Some(_), _) => {}
            (None, '"' | '\'') => quote = Some(c),
            (None, '[') => open.push(']'),
            (None, '{') => open.push('}'),
            (None, ']' | '}') if open.pop() != Some(c) => return None,
            (None, ',') if open.is_empty() => {
                values.push(String::new());
                continue;
            }
            (None, _) => {}
        }
        values.last_mut()?.push(c);
    }
    let closed = open.is_empty() && quote.is_none();
    closed.then(|| values.iter().map(|value| value.trim().to_owned()).collect())
}

/// Runs of a sweep for this process: every `count`-th, starting with the `index`-th, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// 1 to `count`.
    pub index: usize,
    /// At least 1.
    pub count: usize,
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Shard, String> {
        match text.split_once('/').map(|(index, count)| (index.parse(), count.parse())) {
            Some((Ok(index), Ok(count))) if (1..=count).contains(&index) => Ok(Shard { index, count }),
            _ => Err("write I/N with I from 1 to N, such as 1/4 to 4/4".to_owned()),
        }
    }
}

/// One combination.
#[derive(Debug)]
pub struct Run {
    /// Name of its folder, unique in the sweep.
    pub name: String,
    /// Its folder.
    pub folder: PathBuf,
    /// Its value of each axis.
    pub values: Vec<String>,
    /// `KEY=VALUE` of each axis, and removals.
    pub overrides: Vec<String>,
    /// `--scale`
    pub scale: f64,
    /// Properties of the scene with these overrides, or its error.
    pub(super) scene: Result<Checked, Error>,
    /// Row of a finished run, which does not change.
    finished: OnceLock<Row>,
}

/// Properties of a scene that was read.
#[derive(Clone, Debug)]
pub(super) struct Checked {
    /// SHA-256.
    hash: String,
    frames: u64,
    /// Columns of its probes and their units.
    probes: Vec<(String, &'static str)>,
    /// Size of a cell, m.
    pub(super) cell_size: f64,
}

impl Run {
    /// Reads the scene; nothing is written.
    fn new(name: &str, values: Vec<String>, mut overrides: Vec<String>, scale: f64, options: &Options) -> Run {
        let name = folder_name(name);
        // As the command line of a run has them, whose hash depends on their order.
        overrides.sort_by_key(|setting| override_option(setting)[0] == "--without");
        let scene = Scene::load(&options.scene, &overrides, scale);
        Run {
            folder: options.out.join(&name),
            name,
            values,
            overrides,
            scale,
            finished: OnceLock::new(),
            scene: scene.map(|scene| Checked {
                frames: options.frames.unwrap_or_else(|| scene.n_frames()),
                probes: (scene.probes.iter())
                    .flat_map(|probe| probe.columns().into_iter().zip(probe.units().iter().copied()))
                    .collect(),
                cell_size: scene.grid().dx,
                hash: scene.hash,
            }),
        }
    }
}

/// Status of a run, from its folder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Status {
    /// No folder, or an empty one.
    #[default]
    Missing,
    /// All frames exist, of this scene, these settings and this version.
    Finished,
    /// It ended with an error.
    Failed,
    /// It was interrupted.
    Interrupted,
    /// It ended without a record: killed, or by a crash of the machine.
    BrokenOff,
    /// Another process runs it.
    Running,
    /// The folder contains a run of another scene text, other options, or another version.
    Outdated,
    /// The scene with these settings is refused.
    Refused,
}

names! {
    Status: "missing" => Missing, "finished" => Finished, "failed" => Failed, "interrupted" => Interrupted, "broken_off" => BrokenOff,
        "running" => Running, "outdated" => Outdated, "refused" => Refused;
}

/// A row of summary.csv, without the values that the run has not reached.
#[derive(Clone, Debug, Default)]
pub struct Row {
    /// Status of the run.
    pub status: Status,
    /// Exit code of `cutwater run`; absent if a signal ended it.
    pub exit_code: Option<i32>,
    /// Frames computed, frame 0 not counted.
    pub frames: Option<u64>,
    /// Sub-steps.
    pub sub_steps: Option<u64>,
    /// Wall-clock seconds.
    pub seconds: Option<f64>,
    /// Counts and extremes over the sub-steps.
    pub tally: Option<Tally>,
    /// Error message.
    pub problem: Option<String>,
    /// Columns of the probes of a finished run with their statistics.
    pub probes: Vec<(String, Statistics)>,
}

/// End of a run, as seen by the sweep.
#[derive(Debug, Serialize, Deserialize)]
struct Record {
    cutwater: String,
    scene_sha256: String,
    exit_code: Option<i32>,
    problem: Option<String>,
}

/// Options of all runs of a sweep.
#[derive(Clone, Debug)]
pub struct Options {
    /// Scene file.
    pub scene: PathBuf,
    /// Removals of all runs ([`crate::scene::without`]).
    pub without: Vec<String>,
    /// `--scale`
    pub scale: f64,
    /// Frames instead of the scene's duration.
    pub frames: Option<u64>,
    /// `gpu` or `cpu`, as in manifests.
    pub backend: &'static str,
    /// Folder of the sweep.
    pub out: PathBuf,
}

/// A sweep: its runs in order, the last axis fastest.
#[derive(Debug)]
pub struct Sweep {
    axes: Vec<Axis>,
    options: Options,
    /// Runs of all shards.
    pub runs: Vec<Run>,
}

impl Sweep {
    /// Forms all combinations and reads the scene with each; nothing is written.
    ///
    /// # Errors
    /// [`Error::Input`] for a repeated key and for more than 100,000 runs; the scene's own error if it is refused with every combination.
    pub fn new(axes: Vec<Axis>, options: Options) -> Result<Sweep, Error> {
        let mut seen = BTreeSet::new();
        if let Some(twice) = axes.iter().find(|axis| !seen.insert(axis.key.as_str())) {
            return Err(Error::input(
                format!("--set {}", twice.key),
                "is given twice",
                "give all values of a key in one --set, with commas between them",
            ));
        }
        let count = axes.iter().try_fold(1usize, |count, axis| count.checked_mul(axis.values.len()));
        if count.is_none_or(|count| count > MAX_RUNS) {
            return Err(Error::input(
                "--set",
                format!("the settings make more than {MAX_RUNS} runs"),
                "give fewer values, or split them into several sweeps",
            ));
        }
        let mut picks = vec![Vec::new()];
        for axis in &axes {
            let with_each = |pick: &Vec<usize>| (0..axis.values.len()).map(|at| [&pick[..], &[at]].concat()).collect();
            picks = picks.iter().flat_map::<Vec<_>, _>(with_each).collect();
        }
        let labels = labels(&axes);
        let runs = picks.iter().map(|pick| {
            let values: Vec<String> = axes.iter().zip(pick).map(|(axis, &at)| axis.values[at].clone()).collect();
            let set = axes.iter().zip(&values).map(|(axis, value)| format!("{}={value}", axis.key));
            let overrides = set.chain(options.without.iter().cloned()).collect();
            let parts: Vec<&str> = labels.iter().zip(pick).map(|(label, &at)| label[at].as_str()).collect();
            Run::new(&parts.join("_"), values, overrides, options.scale, &options)
        });
        let runs = runs.collect();
        Sweep::of_runs(axes, runs, options)
    }

    /// A sweep over `--scale`; `settings` are the overrides of each run.
    ///
    /// # Errors
    /// The scene's own error if it is refused with every scale.
    pub fn of_scales(scales: &[f64], settings: impl Fn(f64) -> Vec<String>, options: Options) -> Result<Sweep, Error> {
        let axis = Axis { key: "scale".to_owned(), values: scales.iter().map(f64::to_string).collect() };
        let runs = scales.iter().zip(&axis.values).map(|(&scale, value)| {
            Run::new(&format!("scale={value}"), vec![value.clone()], settings(scale), scale, &options)
        });
        let runs = runs.collect();
        Sweep::of_runs(vec![axis], runs, options)
    }

    fn of_runs(axes: Vec<Axis>, mut runs: Vec<Run>, options: Options) -> Result<Sweep, Error> {
        if runs.iter().all(|run| run.scene.is_err())
            && let Err(error) = runs.swap_remove(0).scene
        {
            return Err(error);
        }
        Ok(Sweep { axes, options, runs })
    }

    /// Indices of the runs of a shard.
    pub fn shard_runs(&self, shard: Shard) -> Vec<usize> {
        (shard.index - 1..self.runs.len()).step_by(shard.count).collect()
    }

    /// Row of a run.
    pub fn row(&self, number: usize) -> Row {
        let run = &self.runs[number];
        let row = run.finished.get().cloned().unwrap_or_else(|| self.read_row(run));
        match row.status {
            Status::Finished => run.finished.get_or_init(|| row).clone(),
            _ => row,
        }
    }

    fn read_row(&self, run: &Run) -> Row {
        let Checked { hash, frames, .. } = match &run.scene {
            Ok(scene) => scene,
            Err(error) => {
                return Row {
                    status: Status::Refused,
                    exit_code: Some(error.exit_code().into()),
                    problem: Some(one_line(&error.to_string())),
                    ..Row::default()
                };
            }
        };
        let version = env!("CARGO_PKG_VERSION");
        let text = fs::read(run.folder.join(RECORD)).unwrap_or_default();
        let record: Option<Record> = serde_json::from_slice(&text).ok();
        let record = record.filter(|record| record.scene_sha256 == *hash && record.cutwater == version);
        let manifest = Manifest::read(&run.folder).ok();
        let current = |manifest: &Manifest| {
            manifest.scene.sha256 == *hash
                && manifest.cutwater == version
                && manifest.options.frames == *frames
                && manifest.options.backend == self.options.backend
        };
        let mut row = match (manifest, record) {
            (Some(manifest), record) if current(&manifest) => manifest_row(&manifest, record),
            (Some(_), _) => Row { status: Status::Outdated, ..Row::default() },
            (None, Some(record)) => Row {
                status: match record.exit_code {
                    None => Status::BrokenOff,
                    Some(130) => Status::Interrupted,
                    Some(_) => Status::Failed,
                },
                exit_code: record.exit_code,
                problem: record.problem,
                ..Row::default()
            },
            (None, None) => Row::default(),
        };
        if row.status == Status::Finished {
            match probe_statistics::read(&run.folder) {
                Ok(probes) => row.probes = probes,
                Err(error) => row.problem = Some(one_line(&error.to_string())),
            }
        }
        let lock = File::open(run.folder.join(LOCK)).map(|lock| lock.try_lock_shared());
        if matches!(lock, Ok(Err(TryLockError::WouldBlock))) {
            row.status = Status::Running;
        }
        row
    }

    /// Locks a run for this process, or `None` if another has locked it. Creates its folder and removes the record of an earlier attempt. Closing the
    /// file and all its duplicates unlocks the run. Pass it on to the process of the run: that remains alone if this process is killed.
    pub fn lock(&self, number: usize) -> Result<Option<File>, Error> {
        let folder = &self.runs[number].folder;
        let failed = |problem: std::io::Error| Error::unwritten(folder, &problem);
        fs::create_dir_all(folder).map_err(failed)?;
        let lock = lock_of(folder).map_err(failed)?;
        let mut tries = 0;
        // Not every file system has locks; on those the user must not start two sweeps.
        while let Err(TryLockError::WouldBlock) = lock.try_lock() {
            tries += 1;
            if tries > LOCK_TRIES {
                return Ok(None);
            }
            std::thread::sleep(LOCK_PAUSE);
        }
        remove(&folder.join(RECORD))?;
        Ok(Some(lock))
    }

    /// Records the end of a run: its exit code, or `None` if a signal ended it, and its error message.
    pub fn record_end(&self, number: usize, exit_code: Option<i32>, problem: Option<String>) -> Result<(), Error> {
        let run = &self.runs[number];
        let Ok(Checked { hash, .. }) = &run.scene else { return Ok(()) };
        let record =
            Record { cutwater: env!("CARGO_PKG_VERSION").to_owned(), scene_sha256: hash.clone(), exit_code, problem };
        write_json(&run.folder.join(RECORD), &record)
    }

    /// Writes summary.csv from the folders of all runs, also of other shards. A lock orders the processes, so that the last one writes it complete.
    pub fn write_summary(&self) -> Result<(), Error> {
        let out = &self.options.out;
        fs::create_dir_all(out).map_err(|problem| Error::unwritten(out, &problem))?;
        let turn = lock_of(out).map_err(|problem| Error::unwritten(out, &problem))?;
        // Without locks an older summary may remain; any later invocation corrects that.
        let _ = turn.lock();
        let keys = self.axes.iter().map(|axis| axis.key.clone());
        let probes = self.probes();
        let statistics = probes.iter().flat_map(|(probe, _)| NAMES.map(|name| format!("{probe}:{name}")));
        let heads = keys.chain(Row::default().cells("").map(|(name, _)| name.to_owned())).chain(statistics).collect();
        let records = self.runs.iter().enumerate().map(|(number, run)| {
            let row = self.row(number);
            let statistics = probes.iter().flat_map(|(probe, _)| {
                row.statistics(probe).map(|numbers| numbers.map(Some)).unwrap_or_default().map(cell)
            });
            let cells = row.cells(&run.name).map(|(_, cell)| cell);
            run.values.iter().cloned().chain(cells).chain(statistics).collect()
        });
        write_csv(&out.join("summary.csv"), std::iter::once(heads).chain(records))
    }

    /// Columns of the probes of all runs and their units, in the order of the first run with each.
    pub fn probes(&self) -> Vec<(String, &'static str)> {
        let mut probes: Vec<(String, &'static str)> = Vec::new();
        let scenes = self.runs.iter().filter_map(|run| run.scene.as_ref().ok());
        for (probe, unit) in scenes.flat_map(|scene| &scene.probes) {
            if !probes.iter().any(|(name, _)| name == probe) {
                probes.push((probe.clone(), *unit));
            }
        }
        probes
    }
}

impl Row {
    /// Columns of summary.csv after the keys, and their cells.
    fn cells(&self, folder: &str) -> [(&'static str, String); 12] {
        let volume = self.tally.and_then(|tally| tally.volume_ratio);
        [
            ("status", self.status.name().to_owned()),
            ("exit_code", cell(self.exit_code)),
            ("frames", cell(self.frames)),
            ("sub_steps", cell(self.sub_steps)),
            ("seconds", cell(self.seconds)),
            ("worst_residual", cell(self.tally.map(|tally| tally.worst_residual))),
            ("volume_least", cell(volume.map(|[least, _]| least))),
            ("volume_largest", cell(volume.map(|[_, largest]| largest))),
            ("missed", cell(self.tally.map(|tally| tally.missed))),
            ("squeezed", cell(self.tally.map(|tally| tally.squeezed))),
            ("folder", folder.to_owned()),
            ("problem", self.problem.clone().unwrap_or_default()),
        ]
    }

    /// Statistics of a column of the probes.
    pub(super) fn statistics(&self, probe: &str) -> Option<Statistics> {
        self.probes.iter().find(|(name, _)| name == probe).map(|(_, statistics)| *statistics)
    }
}

/// Row of a run with a manifest.
fn manifest_row(manifest: &Manifest, record: Option<Record>) -> Row {
    let progress = &manifest.progress;
    let (status, exit_code) = match progress.status {
        RunStatus::Finished => (Status::Finished, Some(0)),
        RunStatus::Interrupted => (Status::Interrupted, Some(Error::Interrupted.exit_code().into())),
        RunStatus::Failed => (Status::Failed, None),
        RunStatus::Running => (Status::BrokenOff, None),
    };
    Row {
        status,
        exit_code: exit_code.or(record.as_ref().and_then(|record| record.exit_code)),
        frames: progress.frames_written.last().copied(),
        sub_steps: Some(progress.steps),
        seconds: (status != Status::BrokenOff).then_some(progress.seconds),
        tally: Some(progress.tally),
        problem: progress.error.as_deref().map(one_line).or(record.and_then(|record| record.problem)),
        probes: Vec::new(),
    }
}

/// The lock file of a folder.
fn lock_of(folder: &Path) -> std::io::Result<File> {
    let mut options = File::options();
    options.create(true).truncate(false).read(true).write(true);
    options.open(folder.join(LOCK))
}

fn one_line(text: &str) -> String {
    text.lines().map(str::trim).collect::<Vec<_>>().join("; ")
}

/// `key=value` of every value of every axis, for file names: the shortest unique end of the key, and the value without brackets and quotes. A hash
/// distinguishes values from which other characters were removed, and equal ones.
fn labels(axes: &[Axis]) -> Vec<Vec<String>> {
    let axis_labels = |axis: &Axis| {
        let steps: Vec<&str> = axis.key.split('.').collect();
        let ends = (0..steps.len()).rev().map(|from| steps[from..].join("."));
        let others = || axes.iter().filter(|other| other.key != axis.key);
        let alone = |end: &String| !others().any(|other| other.key == *end || other.key.ends_with(&format!(".{end}")));
        let key = ends.into_iter().find(alone).unwrap_or_else(|| axis.key.clone());
        let key: String = key.chars().filter(|c| !"[] \"".contains(*c)).collect();
        let mut taken = BTreeSet::new();
        let label = |value: &String| {
            let bare: String = value.chars().filter(|c| !"[]{}\"' ".contains(*c)).collect();
            let safe = |c: char| c.is_ascii_alphanumeric() || "._+-,".contains(c);
            let label: String = bare.chars().map(|c| if safe(c) { c } else { '-' }).collect();
            let nested = value.matches(['[', '{']).count() > 1;
            let faithful = label == bare && !nested && !label.is_empty() && !label.ends_with('.');
            // Some file systems do not distinguish capitals.
            let unique = taken.insert(label.to_lowercase());
            match faithful && unique {
                true => format!("{key}={label}"),
                false => format!("{key}={label}~{}", short_hash(value)),
            }
        };
        axis.values.iter().map(label).collect()
    };
    axes.iter().map(axis_labels).collect()
}

/// The name, shortened to what file systems allow.
fn folder_name(name: &str) -> String {
    match name.get(..LONGEST_NAME) {
        Some(start) if start.len() < name.len() => format!("{start}~{}", short_hash(name)),
        _ => name.to_owned(),
    }
}

fn short_hash(text: &str) -> String {
    Sha256::digest(text.as_bytes())[..4].iter().map(|byte| format!("{byte:02x}")).collect()
}
