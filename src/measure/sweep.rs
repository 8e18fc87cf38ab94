//! Sweeps: every combination of the values of some keys of a scene, a folder for each, and a summary that is made anew from these
//! folders.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::Error;
use crate::output::manifest::{Manifest, RunStatus};
use crate::output::write_atomically;
use crate::scene::Scene;

/// Most runs of a sweep: a folder each.
const MAX_RUNS: usize = 100_000;
/// Longest name of a folder before what makes it unique; file systems allow 255 bytes.
const LONGEST_NAME: usize = 150;
/// What the sweep itself knows of a run, in the run's folder.
const RECORD: &str = "sweep.json";
/// Everything that the run printed, in the run's folder.
pub const LOG: &str = "log.txt";
/// Held by the sweep and the run that it started, in the run's folder; a run alone holds another.
const LOCK: &str = ".sweep.lock";
/// Who makes a summary holds a run's lock for a moment, to see whether it is free: that is no reason to leave the run out.
const LOCK_TRIES: u32 = 20;
const LOCK_PAUSE: Duration = Duration::from_millis(20);

/// A key of the scene and its values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Axis {
    /// Dotted key, such as `solid[0].young`.
    pub key: String,
    /// TOML values as written, none of them twice.
    pub values: Vec<String>,
}

impl FromStr for Axis {
    type Err = Error;

    /// Reads `KEY=V1,V2,...`; commas within brackets, braces and quotes belong to a value.
    fn from_str(text: &str) -> Result<Axis, Error> {
        let refuse =
            |problem: String, cure: &str| Err(Error::input(format!("--set {text}"), problem, cure));
        let cure = "write --set KEY=V1,V2, such as --set liquid.density=800,1000";
        let Some((key, list)) = text.split_once('=') else {
            return refuse("has no `=`".into(), cure);
        };
        let Some(values) = split(list) else {
            let problem = format!("the brackets or quotes of `{list}` do not match");
            return refuse(
                problem,
                "close them; single quotes keep them from the shell",
            );
        };
        if values.iter().any(String::is_empty) {
            return refuse("has an empty value".into(), cure);
        }
        let mut seen = BTreeSet::new();
        if let Some(twice) = values.iter().find(|value| !seen.insert(value.as_str())) {
            return refuse(
                format!("has the value {twice} twice"),
                "give each value once",
            );
        }
        Ok(Axis {
            key: key.trim().to_owned(),
            values,
        })
    }
}

/// The parts between commas that are in no bracket, brace or quotes; `None` where these do not match.
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

/// Which runs of a sweep this process makes: every `count`-th, from the `index`-th on, counted from 1.
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
        let shard = text.split_once('/').and_then(|(index, count)| {
            Some(Shard {
                index: index.parse().ok()?,
                count: count.parse().ok()?,
            })
        });
        shard
            .filter(|shard| (1..=shard.count).contains(&shard.index))
            .ok_or_else(|| "write I/N with I from 1 to N, such as 1/4 to 4/4".to_owned())
    }
}

impl Shard {
    fn holds(self, number: usize) -> bool {
        number % self.count == self.index - 1
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
    /// `KEY=VALUE` of each axis.
    pub overrides: Vec<String>,
    /// SHA-256 of the scene with these overrides, and its frames; or why it is refused.
    scene: Result<(String, u64), Error>,
}

/// How a run stands, judged by its folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// There is nothing.
    Missing,
    /// All frames are there, of this scene, these settings and this version.
    Finished,
    /// It ended with an error.
    Failed,
    /// It was interrupted.
    Interrupted,
    /// It ended without a word: killed, or the machine went down.
    BrokenOff,
    /// Another process is at it.
    Running,
    /// The folder holds a run of another text of the scene, other options, or another version.
    Outdated,
    /// The scene with these settings is refused.
    Refused,
}

impl Standing {
    /// As summary.csv has it.
    pub fn name(self) -> &'static str {
        match self {
            Standing::Missing => "missing",
            Standing::Finished => "finished",
            Standing::Failed => "failed",
            Standing::Interrupted => "interrupted",
            Standing::BrokenOff => "broken_off",
            Standing::Running => "running",
            Standing::Outdated => "outdated",
            Standing::Refused => "refused",
        }
    }
}

/// A row of summary.csv. What a run has not come to is absent.
#[derive(Clone, Debug)]
pub struct Row {
    /// How the run stands.
    pub standing: Standing,
    /// Exit code of `cutwater run`; absent where a signal ended it.
    pub exit_code: Option<i32>,
    /// Frames computed, frame 0 not counted.
    pub frames: Option<u64>,
    /// Sub-steps.
    pub sub_steps: Option<u64>,
    /// Wall clock.
    pub seconds: Option<f64>,
    /// Largest true relative residual of all solves.
    pub worst_residual: Option<f64>,
    /// Least and largest liquid volume over the volume to hold.
    pub volume: Option<[f64; 2]>,
    /// Sub-steps with a solve that missed its tolerance.
    pub missed: Option<u64>,
    /// Sub-steps in which liquid had nowhere to go.
    pub squeezed: Option<u64>,
    /// What went wrong.
    pub problem: Option<String>,
}

/// How one run ended, as the sweep saw it.
#[derive(Debug, Serialize, Deserialize)]
struct Record {
    cutwater: String,
    scene_sha256: String,
    exit_code: Option<i32>,
    problem: Option<String>,
}

/// What all runs of a sweep are told alike.
#[derive(Clone, Debug)]
pub struct Options {
    /// Scene file.
    pub scene: PathBuf,
    /// `--scale`
    pub scale: f64,
    /// Frames instead of the scene's duration.
    pub frames: Option<u64>,
    /// `gpu` or `cpu`, as manifests name it.
    pub backend: &'static str,
    /// Folder of the sweep.
    pub out: PathBuf,
}

/// A sweep: its runs in order, the last axis fastest.
#[derive(Debug)]
pub struct Sweep {
    axes: Vec<Axis>,
    options: Options,
    /// All runs, of all shards.
    pub runs: Vec<Run>,
    /// Rows of finished runs, which do not change any more.
    finished: Mutex<BTreeMap<usize, Row>>,
}

impl Sweep {
    /// Makes all combinations and reads the scene with each; nothing is written.
    ///
    /// # Errors
    /// [`Error::Input`] for a key that comes twice and for more than 100,000 runs; the scene's own error where it is refused with
    /// every combination.
    pub fn new(axes: Vec<Axis>, options: Options) -> Result<Sweep, Error> {
        let mut seen = BTreeSet::new();
        if let Some(twice) = axes.iter().find(|axis| !seen.insert(axis.key.as_str())) {
            return Err(Error::input(
                format!("--set {}", twice.key),
                "is given twice",
                "give all values of a key in one --set, with commas between them",
            ));
        }
        let count = axes
            .iter()
            .try_fold(1usize, |count, axis| count.checked_mul(axis.values.len()))
            .filter(|&count| count <= MAX_RUNS);
        let Some(count) = count else {
            return Err(Error::input(
                "--set",
                format!("the settings make more than {MAX_RUNS} runs"),
                "give fewer values, or split them into several sweeps",
            ));
        };
        let labels = labels(&axes);
        let mut runs = Vec::with_capacity(count);
        for number in 0..count {
            let mut rest = number;
            let mut picks = vec![0; axes.len()];
            for (pick, axis) in picks.iter_mut().zip(&axes).rev() {
                (*pick, rest) = (rest % axis.values.len(), rest / axis.values.len());
            }
            let of_axes = || axes.iter().zip(&picks);
            let values: Vec<String> = of_axes()
                .map(|(axis, &pick)| axis.values[pick].clone())
                .collect();
            let overrides: Vec<String> = of_axes()
                .map(|(axis, &pick)| format!("{}={}", axis.key, axis.values[pick]))
                .collect();
            let parts: Vec<&str> = labels
                .iter()
                .zip(&picks)
                .map(|(of_axis, &pick)| of_axis[pick].as_str())
                .collect();
            let name = folder_name(&parts.join("_"));
            let scene = Scene::load(&options.scene, &overrides, options.scale);
            runs.push(Run {
                folder: options.out.join(&name),
                name,
                values,
                overrides,
                scene: scene.map(|scene| {
                    let frames = options.frames.unwrap_or_else(|| scene.n_frames());
                    (scene.hash, frames)
                }),
            });
        }
        if runs.iter().all(|run| run.scene.is_err())
            && let Err(error) = runs.swap_remove(0).scene
        {
            return Err(error);
        }
        Ok(Sweep {
            axes,
            options,
            runs,
            finished: Mutex::default(),
        })
    }

    /// The numbers of the runs of a shard.
    pub fn of_shard(&self, shard: Shard) -> Vec<usize> {
        (0..self.runs.len())
            .filter(|&number| shard.holds(number))
            .collect()
    }

    /// How a run stands.
    pub fn row(&self, number: usize) -> Row {
        if let Some(row) = self.lock_finished().get(&number) {
            return row.clone();
        }
        let row = self.read_row(&self.runs[number]);
        if row.standing == Standing::Finished {
            self.lock_finished().insert(number, row.clone());
        }
        row
    }

    fn lock_finished(&self) -> MutexGuard<'_, BTreeMap<usize, Row>> {
        self.finished
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    fn read_row(&self, run: &Run) -> Row {
        let mut row = Row {
            standing: Standing::Missing,
            exit_code: None,
            frames: None,
            sub_steps: None,
            seconds: None,
            worst_residual: None,
            volume: None,
            missed: None,
            squeezed: None,
            problem: None,
        };
        let (hash, frames) = match &run.scene {
            Ok(wanted) => wanted,
            Err(error) => {
                row.standing = Standing::Refused;
                row.exit_code = Some(error.exit_code().into());
                row.problem = Some(one_line(&error.to_string()));
                return row;
            }
        };
        let record = fs::read(run.folder.join(RECORD)).ok();
        let record: Option<Record> = record.and_then(|text| serde_json::from_slice(&text).ok());
        let record = record.filter(|record| {
            record.scene_sha256 == *hash && record.cutwater == env!("CARGO_PKG_VERSION")
        });
        let manifest = Manifest::read(&run.folder).ok();
        let of_this = |manifest: &Manifest| {
            manifest.scene.sha256 == *hash
                && manifest.cutwater == env!("CARGO_PKG_VERSION")
                && manifest.options.frames == *frames
                && manifest.options.backend == self.options.backend
        };
        let held = matches!(
            File::open(run.folder.join(LOCK)).map(|lock| lock.try_lock_shared()),
            Ok(Err(TryLockError::WouldBlock))
        );
        match (manifest, record) {
            (Some(manifest), record) if of_this(&manifest) => {
                (row.standing, row.exit_code) = match manifest.progress.status {
                    RunStatus::Finished => (Standing::Finished, Some(0)),
                    RunStatus::Interrupted => (
                        Standing::Interrupted,
                        Some(Error::Interrupted.exit_code().into()),
                    ),
                    RunStatus::Failed => (Standing::Failed, None),
                    RunStatus::Running => (Standing::BrokenOff, None),
                };
                row.sub_steps = Some(manifest.progress.steps);
                row.seconds = Some(manifest.progress.seconds);
                row.problem = manifest.progress.error.as_deref().map(one_line);
                if let Some(record) = record {
                    row.exit_code = row.exit_code.or(record.exit_code);
                    row.problem = row.problem.or(record.problem);
                }
                if manifest.progress.status == RunStatus::Running {
                    row.seconds = None;
                }
                row.frames = manifest.progress.frames_written.last().copied();
                let tally = manifest.progress.tally;
                row.worst_residual = Some(tally.worst_residual);
                row.volume = tally.volume_ratio;
                row.missed = Some(tally.missed);
                row.squeezed = Some(tally.squeezed);
            }
            (Some(_), _) => row.standing = Standing::Outdated,
            (None, Some(record)) => {
                row.standing = match record.exit_code {
                    None => Standing::BrokenOff,
                    Some(130) => Standing::Interrupted,
                    Some(_) => Standing::Failed,
                };
                row.exit_code = record.exit_code;
                row.problem = record.problem;
            }
            (None, None) => {}
        }
        if held {
            row.standing = Standing::Running;
        }
        row
    }

    /// Takes a run for this process, or `None` where another has it. Its folder is made, and what is left of an earlier attempt's
    /// record removed. The run is free again when the file and all that were made from it are closed: give it to the process that
    /// runs, so that no second one starts beside it when this one is killed.
    ///
    /// # Errors
    /// [`Error::Output`] where the folder cannot be written.
    pub fn take(&self, number: usize) -> Result<Option<File>, Error> {
        let folder = &self.runs[number].folder;
        let failed = |problem: std::io::Error| Error::unwritten(folder, &problem);
        fs::create_dir_all(folder).map_err(failed)?;
        let lock = lock_of(folder).map_err(failed)?;
        let mut tries = 0;
        // Not every file system has locks; there the user keeps sweeps apart.
        while let Err(TryLockError::WouldBlock) = lock.try_lock() {
            tries += 1;
            if tries > LOCK_TRIES {
                return Ok(None);
            }
            std::thread::sleep(LOCK_PAUSE);
        }
        match fs::remove_file(folder.join(RECORD)) {
            Err(problem) if problem.kind() != std::io::ErrorKind::NotFound => Err(failed(problem)),
            _ => Ok(Some(lock)),
        }
    }

    /// Writes down how a run ended: its exit code, or `None` where a signal ended it, and what went wrong.
    ///
    /// # Errors
    /// [`Error::Output`] where it cannot be written.
    pub fn note(
        &self,
        number: usize,
        exit_code: Option<i32>,
        problem: Option<String>,
    ) -> Result<(), Error> {
        let run = &self.runs[number];
        let Ok((hash, _)) = &run.scene else {
            return Ok(());
        };
        let record = Record {
            cutwater: env!("CARGO_PKG_VERSION").to_owned(),
            scene_sha256: hash.clone(),
            exit_code,
            problem,
        };
        let path = run.folder.join(RECORD);
        let text =
            serde_json::to_vec_pretty(&record).map_err(|problem| Error::output(&path, problem))?;
        write_atomically(&path, &text)
    }

    /// Makes summary.csv anew from the folders of all runs, those of other shards too. Processes take turns, so that the last one has
    /// it complete.
    ///
    /// # Errors
    /// [`Error::Output`] where it cannot be written.
    pub fn write_summary(&self) -> Result<(), Error> {
        let out = &self.options.out;
        let path = out.join("summary.csv");
        fs::create_dir_all(out).map_err(|problem| Error::unwritten(out, &problem))?;
        let turn = lock_of(out).map_err(|problem| Error::unwritten(out, &problem))?;
        // Without locks a reader may find the summary of a moment ago; any later invocation mends that.
        let _ = turn.lock();
        let mut table = csv::Writer::from_writer(Vec::new());
        let failed = |problem: csv::Error| Error::output(&path, problem);
        let keys = self.axes.iter().map(|axis| axis.key.as_str());
        let columns = [
            "status",
            "exit_code",
            "frames",
            "sub_steps",
            "seconds",
            "worst_residual",
            "volume_least",
            "volume_largest",
            "missed",
            "squeezed",
            "folder",
            "problem",
        ];
        table.write_record(keys.chain(columns)).map_err(failed)?;
        for (number, run) in self.runs.iter().enumerate() {
            let row = self.row(number);
            let mut fields = run.values.clone();
            fields.push(row.standing.name().to_owned());
            fields.push(text(row.exit_code));
            fields.extend([row.frames, row.sub_steps].map(text));
            let [least, largest] = [0, 1].map(|end| row.volume.map(|range| range[end]));
            fields.extend([row.seconds, row.worst_residual, least, largest].map(text));
            fields.extend([row.missed, row.squeezed].map(text));
            fields.push(run.name.clone());
            fields.push(row.problem.unwrap_or_default());
            table.write_record(fields).map_err(failed)?;
        }
        let bytes = table
            .into_inner()
            .map_err(|problem| Error::output(&path, problem))?;
        write_atomically(&path, &bytes)
    }
}

/// The file in a folder that stands for it where processes take turns.
fn lock_of(folder: &Path) -> std::io::Result<File> {
    let mut options = File::options();
    options.create(true).truncate(false).read(true).write(true);
    options.open(folder.join(LOCK))
}

fn text<T: std::fmt::Debug>(value: Option<T>) -> String {
    value.map_or(String::new(), |value| format!("{value:?}"))
}

fn one_line(text: &str) -> String {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    lines.join("; ")
}

/// `key=value` of every value of every axis, fit for file names: the end of each key that tells it from the others, and the value
/// without brackets and quotes. Where other characters had to go, or two would be the same, a hash tells them apart.
fn labels(axes: &[Axis]) -> Vec<Vec<String>> {
    let of_axis = |axis: &Axis| {
        let steps: Vec<&str> = axis.key.split('.').collect();
        let ends = (0..steps.len()).rev().map(|from| steps[from..].join("."));
        let others = || axes.iter().filter(|other| other.key != axis.key);
        let alone = |end: &String| {
            !others().any(|other| other.key == *end || other.key.ends_with(&format!(".{end}")))
        };
        let key = ends
            .into_iter()
            .find(alone)
            .unwrap_or_else(|| axis.key.clone());
        let key: String = key.chars().filter(|c| !"[] \"".contains(*c)).collect();
        let mut taken = BTreeSet::new();
        let label = |value: &String| {
            let bare: String = value.chars().filter(|c| !"[]{}\"' ".contains(*c)).collect();
            let safe = |c: char| c.is_ascii_alphanumeric() || "._+-,".contains(c);
            let label: String = bare
                .chars()
                .map(|c| if safe(c) { c } else { '-' })
                .collect();
            let nested = value.matches(['[', '{']).count() > 1;
            let faithful = label == bare && !nested && !label.is_empty() && !label.ends_with('.');
            // Some file systems do not tell capitals.
            let unique = taken.insert(label.to_lowercase());
            match faithful && unique {
                true => format!("{key}={label}"),
                false => format!("{key}={label}~{}", short_hash(value)),
            }
        };
        axis.values.iter().map(label).collect()
    };
    axes.iter().map(of_axis).collect()
}

/// The name itself, or as much of it as file systems take.
fn folder_name(name: &str) -> String {
    match name.get(..LONGEST_NAME) {
        Some(start) if start.len() < name.len() => format!("{start}~{}", short_hash(name)),
        _ => name.to_owned(),
    }
}

fn short_hash(text: &str) -> String {
    let digest = Sha256::digest(text.as_bytes());
    digest[..4]
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}
