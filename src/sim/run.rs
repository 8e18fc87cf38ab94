//! The run loop: frames, tables, checkpoints and the manifest of one simulation, from its beginning or from where an earlier part ended.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crate::Error;
use crate::geometry::{self, ObstacleSurfaces, Overlap};
use crate::gpu::AdapterReport;
use crate::output::checkpoint::Checkpoint;
use crate::output::frames::{FrameKinds, FrameWriter};
use crate::output::manifest::{
    AdapterRecord, EarlierAdapter, Manifest, RunOptions, RunStatus, SolidHealth, Tally,
};
use crate::output::tables::{ProbeTable, StepRow, StepTable};
use crate::output::{FolderLock, is_partial};
use crate::scene::{MAX_FRAMES, Scene};
use crate::state::{SolveStatus, State, StepReport};

use super::health::{Health, Now};
use super::{Backend, Simulation};

/// What a run is told beyond its scene.
#[derive(Clone, Debug)]
pub struct Options {
    /// Where the simulation runs.
    pub backend: Backend,
    /// The run's folder; made if absent.
    pub out: PathBuf,
    /// Frames to compute instead of the scene's duration.
    pub frames: Option<u64>,
    /// Whether an earlier run in the folder may be replaced.
    pub overwrite: bool,
    /// Whether the run in the folder is to go on where it ended; where there is none, one begins.
    pub resume: bool,
    /// Whether the run continues after a solid has collapsed.
    pub keep_going: bool,
}

/// What the caller is told after every sub-step.
#[derive(Debug)]
pub struct Progress<'a> {
    /// Frames done.
    pub frame: u64,
    /// Frames in all.
    pub n_frames: u64,
    /// Simulated time, s.
    pub time: f64,
    /// The sub-step.
    pub report: &'a StepReport,
    /// Signs of a run gone wrong that appeared in this sub-step for the first time, a sentence each.
    pub notices: &'a [String],
}

/// What a run came to.
#[derive(Clone, Debug)]
pub struct Summary {
    /// Frames done, those of earlier parts among them, frame 0 not counted.
    pub frames: u64,
    /// Sub-steps, likewise.
    pub steps: u64,
    /// Wall-clock seconds, likewise.
    pub seconds: f64,
    /// What was noticed in all of them.
    pub tally: Tally,
    /// Solids that have collapsed, each with its sub-step: only of a run that was told to keep going.
    pub failed_solids: Vec<(String, u64)>,
    /// Liquid regions, by number, that are too small or too well covered for the cells to hold any of their liquid.
    pub empty_regions: Vec<usize>,
    /// Where the run went on, if it did.
    pub resumed: Option<Resumed>,
}

/// How a run went on.
#[derive(Clone, Debug)]
pub struct Resumed {
    /// Frames that were done before.
    pub frames: u64,
    /// The adapter of those, where it is not that of the others: what followed differs from what it would have been by rounding.
    pub other_adapter: Option<String>,
}

/// How a run starts.
enum Start {
    /// At its first frame, in place of another.
    Anew(Option<Box<Manifest>>),
    /// At a checkpoint.
    From(Box<Checkpoint>),
    /// It has ended.
    Finished(Box<Manifest>),
}

impl Start {
    /// What the folder and the options ask for.
    fn find(scene: &Scene, options: &Options, n_frames: u64) -> Result<Start, Error> {
        let out = &options.out;
        let refused =
            |problem: &str, cure: &str| Err(Error::input(out.display().to_string(), problem, cure));
        let manifest_path = out.join("manifest.json");
        let (manifest, checkpoint) = (manifest_path.exists(), Checkpoint::path(out).exists());
        if !(manifest || checkpoint) {
            // Nobody knows whose these are: a run would write over them.
            let names = ["steps.csv", "probes.csv", "frames", "preview"];
            return match names.iter().find(|name| out.join(name).exists()) {
                Some(name) => Err(Error::input(
                    out.join(name).display().to_string(),
                    "it is in the folder of the run, and there is no manifest.json that says of which run it is",
                    "choose another folder with --out, or remove this one by hand",
                )),
                None => Ok(Start::Anew(None)),
            };
        }
        if options.resume {
            return Start::resume(scene, options, n_frames);
        }
        match (Manifest::read(out), options.overwrite) {
            (Ok(manifest), true) => Ok(Start::Anew(Some(Box::new(manifest)))),
            (Ok(_), false) => refused(
                "the folder holds an earlier run",
                "choose another folder with --out, go on with the run with --resume, or replace it with --overwrite",
            ),
            // Only the manifest tells which files are the run's.
            (Err(error), _) => refused(
                &format!(
                    "the folder holds an earlier run that this version cannot replace: {}",
                    error.to_string().lines().next().unwrap_or_default()
                ),
                match checkpoint {
                    true => {
                        "choose another folder with --out, go on with the run with --resume, or remove this one by hand"
                    }
                    false => "choose another folder with --out, or remove this one by hand",
                },
            ),
        }
    }

    /// Of a folder with a manifest or a checkpoint.
    fn resume(scene: &Scene, options: &Options, n_frames: u64) -> Result<Start, Error> {
        let out = &options.out;
        let (manifest_path, path) = (out.join("manifest.json"), Checkpoint::path(out));
        let backend = options.backend.name();
        let refused = |what: &Path, problem: String, cure: &str| {
            Err(Error::input(what.display().to_string(), problem, cure))
        };
        let checkpoint = Checkpoint::read(out)?;
        if let Some(Checkpoint { manifest, .. }) = &checkpoint {
            manifest.ensure_same_run(scene, backend, &path)?;
        }
        // That of the checkpoint has all that counts, should this one have been lost.
        let manifest = match Manifest::read(out) {
            Ok(manifest) => Some(manifest),
            Err(_) if checkpoint.is_some() => None,
            Err(error) => return Err(error),
        };
        if let Some(manifest) = &manifest {
            manifest.ensure_same_run(scene, backend, &manifest_path)?;
        }
        let finished = manifest.filter(|of| of.progress.status == RunStatus::Finished);
        let checkpointed = checkpoint.as_ref().map(|checkpoint| checkpoint.state.frame);
        let done = finished.as_ref().map(|manifest| manifest.options.frames);
        let most = done.max(checkpointed).unwrap_or(0);
        if most > n_frames {
            let problem =
                format!("the run has {most} frames, more than the {n_frames} that are asked for");
            return refused(out, problem, "ask for at least as many with --frames");
        }
        match (finished, checkpoint) {
            (Some(manifest), _) if done == Some(n_frames) => {
                Ok(Start::Finished(Box::new(manifest)))
            }
            (_, Some(checkpoint)) => Ok(Start::From(Box::new(checkpoint))),
            (Some(_), None) => refused(
                out,
                format!(
                    "the run ended with frame {most}, and there is no checkpoint.npz to go on from"
                ),
                "start it again with --overwrite and `output.checkpoint_every` above 0",
            ),
            // It ended before its first checkpoint: it begins again.
            (None, None) => Ok(Start::Anew(Some(Box::new(Manifest::read(out)?)))),
        }
    }
}

/// Runs a scene into a folder. `progress` hears of every sub-step; a true `interrupt` ends the run after the sub-step.
///
/// # Errors
/// [`Error::Input`] when the folder holds an earlier run, or something that is none and is to be overwritten, or one that is to go on and
/// is of another scene or broken, or when another process writes into it;
/// [`Error::Interrupted`], and whatever the simulation ends with; the manifest then says so and all frames written stay valid.
pub fn run(
    scene: &Scene,
    options: &Options,
    progress: &mut dyn FnMut(&Progress),
    interrupt: &AtomicBool,
) -> Result<Summary, Error> {
    let out = &options.out;
    let n_frames = options.frames.unwrap_or_else(|| scene.n_frames());
    ensure_frames(n_frames)?;
    // What sources emit until then has to fit.
    let longer = lasting(scene, n_frames);
    let scene = &longer;
    let held = out.exists().then(|| FolderLock::take(out)).transpose()?;
    let mut start = Start::find(scene, options, n_frames)?;
    if let Start::Finished(manifest) = &start {
        return Ok(Summary::of_finished(manifest));
    }
    let mut simulation = Simulation::new(scene, &options.backend)?;
    if interrupt.load(Ordering::Relaxed) {
        return Err(Error::Interrupted);
    }
    // Only now: a scene that does not fit the adapter must not cost the earlier run, nor leave a folder.
    let _lock = match held {
        Some(lock) => lock,
        None => {
            let lock = FolderLock::take(out)?;
            // Another process may have been here.
            start = Start::find(scene, options, n_frames)?;
            lock
        }
    };
    let run_options = RunOptions {
        backend: options.backend.name().to_owned(),
        frames: n_frames,
        scale: scene.scale,
        overrides: scene.overrides.clone(),
    };
    let adapter = simulation.adapter().map(adapter_record);
    let mut manifest = Manifest::new(scene, run_options, adapter)
        .with_sources(simulation.source_flows())
        .with_solids(scene, simulation.solids())?;
    let (mut empty_regions, mut resumed) = (Vec::new(), None);
    let from = match start {
        Start::Finished(manifest) => return Ok(Summary::of_finished(&manifest)),
        Start::Anew(earlier) => {
            prepare_folder(out, earlier.map(|earlier| *earlier))?;
            empty_regions = geometry::empty_regions(scene, &simulation.state()?.markers)?;
            None
        }
        Start::From(checkpoint) => {
            simulation.resume(&checkpoint.state, &checkpoint.carried)?;
            resumed = Some(take_up(&mut manifest, &checkpoint, scene.output.every));
            Some(TablesAt::of(&checkpoint))
        }
    };
    let health = Health::new(scene, options.keep_going);
    let mut recording = Recording::begin(scene, out, manifest, (from, health))?;
    let outcome = match from {
        None => recording.frame(&simulation, n_frames),
        Some(_) => Ok(()),
    };
    let outcome = outcome.and_then(|()| {
        frames(
            n_frames,
            &mut simulation,
            &mut recording,
            progress,
            interrupt,
        )
    });
    let manifest = recording.end(&simulation, outcome)?;
    Ok(Summary {
        empty_regions,
        resumed,
        ..Summary::of(&manifest)
    })
}

/// Refuses more frames than file names have digits for.
fn ensure_frames(n_frames: u64) -> Result<(), Error> {
    if n_frames <= MAX_FRAMES {
        return Ok(());
    }
    let problem = format!("file names have room for {MAX_FRAMES} frames");
    Err(Error::input(
        format!("--frames {n_frames}"),
        problem,
        "ask for fewer frames",
    ))
}

/// The scene, with a duration of at least so many frames.
fn lasting(scene: &Scene, n_frames: u64) -> Scene {
    let mut scene = scene.clone();
    let asked = n_frames as f64 / scene.time.frames_per_second;
    scene.time.duration = scene.time.duration.max(asked);
    scene
}

impl Summary {
    fn of(
        Manifest {
            options,
            progress,
            solids,
            ..
        }: &Manifest,
    ) -> Summary {
        let health = solids.iter().zip(&progress.solids);
        let failed = health.filter_map(|(of, health)| Some((of.name.clone(), health.failed_at?)));
        Summary {
            failed_solids: failed.collect(),
            frames: options.frames,
            steps: progress.steps,
            seconds: progress.seconds,
            tally: progress.tally,
            empty_regions: Vec::new(),
            resumed: None,
        }
    }

    fn of_finished(manifest: &Manifest) -> Summary {
        Summary {
            resumed: Some(Resumed {
                frames: manifest.options.frames,
                other_adapter: None,
            }),
            ..Summary::of(manifest)
        }
    }
}

/// Goes on in a manifest with the run of a checkpoint. `every`: frames from one that is written to the next.
fn take_up(manifest: &mut Manifest, checkpoint: &Checkpoint, every: u64) -> Resumed {
    let Checkpoint {
        state,
        manifest: before,
        ..
    } = checkpoint;
    manifest.progress.clone_from(&before.progress);
    let solids = &mut manifest.progress.solids;
    solids.resize(manifest.solids.len(), SolidHealth::default());
    let n_frames = manifest.options.frames;
    // The last frame of a shorter run is none of a longer one.
    let written = &mut manifest.progress.frames_written;
    written.retain(|&frame| has_place(frame, every, n_frames));
    manifest
        .earlier_adapters
        .clone_from(&before.earlier_adapters);
    let mut other_adapter = None;
    if before.adapter != manifest.adapter {
        let name = |adapter: &AdapterRecord| format!("{} ({})", adapter.name, adapter.driver);
        other_adapter = before.adapter.as_ref().map(name);
        manifest.earlier_adapters.push(EarlierAdapter {
            adapter: before.adapter.clone(),
            steps: state.step,
        });
    }
    Resumed {
        frames: state.frame,
        other_adapter,
    }
}

/// Whether a frame is one that a run of so many writes.
fn has_place(frame: u64, every: u64, n_frames: u64) -> bool {
    frame == n_frames || frame < n_frames && frame.is_multiple_of(every)
}

/// The frame of which a file is, by its name.
fn frame_of(file: &str, scene: &str) -> Option<u64> {
    let (number, _) = file
        .strip_prefix(scene)?
        .strip_prefix('_')?
        .split_once('.')?;
    let kinds = ["obstacles_", "surface_"];
    let number = kinds
        .iter()
        .find_map(|kind| number.strip_prefix(kind))
        .unwrap_or(number);
    number.parse().ok()
}

/// Removes the files and pictures of frames that a longer or a shorter part of the run has written and this one will not.
fn remove_frames_without_place(out: &Path, scene: &Scene, n_frames: u64) -> Result<(), Error> {
    remove_partial(out)?;
    let without_place = |name: &str| {
        let frame = frame_of(name, &scene.name);
        frame.is_some_and(|frame| !has_place(frame, scene.output.every, n_frames))
    };
    for folder in ["frames", "preview"] {
        remove(&out.join(folder), &without_place)?;
    }
    Ok(())
}

/// Makes the folder, and takes the earlier run out of it: its frames would mix with the new ones.
fn prepare_folder(out: &Path, earlier_run: Option<Manifest>) -> Result<(), Error> {
    remove_partial(out)?;
    if let Some(mut earlier) = earlier_run {
        // Whoever finds the folder half cleared must not take the run for whole, and needs its name to clear the rest.
        let progress = &mut earlier.progress;
        progress.status = RunStatus::Interrupted;
        progress.error = Some("is being replaced".to_owned());
        progress.frames_written.clear();
        earlier.write(out)?;
        let of_run = |name: &str| ["checkpoint.npz", "steps.csv", "probes.csv"].contains(&name);
        remove(out, &of_run)?;
        let of_run = |name: &str| {
            let kind = Path::new(name).extension().and_then(|kind| kind.to_str());
            let rest = name.strip_prefix(&earlier.scene.name);
            rest.is_some_and(|rest| rest.starts_with(['_', '.']))
                && matches!(kind, Some("vtp" | "vti" | "vtu" | "ply" | "pvd" | "png"))
        };
        for folder in ["frames", "preview"] {
            remove(&out.join(folder), &of_run)?;
        }
    }
    Ok(())
}

/// Removes what a run that was killed left of files that it was writing.
fn remove_partial(out: &Path) -> Result<(), Error> {
    for folder in [out, &out.join("frames"), &out.join("preview")] {
        remove(folder, &is_partial)?;
    }
    Ok(())
}

/// Removes the files of a folder, if there is one, whose names are meant, and the folder where nothing is left of it.
fn remove(folder: &Path, meant: &dyn Fn(&str) -> bool) -> Result<(), Error> {
    let Ok(entries) = fs::read_dir(folder) else {
        return Ok(());
    };
    let mut left = false;
    for entry in entries {
        let entry = entry.map_err(|problem| Error::unwritten(folder, &problem))?;
        if entry.file_name().to_str().is_some_and(meant) {
            let path = entry.path();
            fs::remove_file(&path).map_err(|problem| Error::unwritten(&path, &problem))?;
        } else {
            left = true;
        }
    }
    if left {
        return Ok(());
    }
    fs::remove_dir(folder).map_err(|problem| Error::unwritten(folder, &problem))
}

/// How long the tables are, bytes.
#[derive(Clone, Copy, Debug)]
struct TablesAt {
    steps: u64,
    probes: u64,
}

impl TablesAt {
    fn of(checkpoint: &Checkpoint) -> TablesAt {
        TablesAt {
            steps: checkpoint.steps_bytes,
            probes: checkpoint.probes_bytes,
        }
    }
}

/// What a run writes as it goes.
struct Recording<'a> {
    scene: &'a Scene,
    out: &'a Path,
    clock: Instant,
    /// Seconds of earlier parts.
    seconds_before: f64,
    writer: FrameWriter,
    obstacles: ObstacleSurfaces,
    steps: StepTable,
    probes: Option<ProbeTable>,
    manifest: Manifest,
    health: Health,
    /// The last moment that was read, where there are to be checkpoints, unless its checkpoint is on the disk.
    unsaved: Option<Checkpoint>,
}

impl<'a> Recording<'a> {
    /// New files, or those of the run after so many bytes of its tables.
    fn begin(
        scene: &'a Scene,
        out: &'a Path,
        manifest: Manifest,
        (from, health): (Option<TablesAt>, Health),
    ) -> Result<Recording<'a>, Error> {
        // First what says whose the folder is, wherever it ends; but tables that are not those of the run leave it as it was.
        if from.is_none() {
            manifest.write(out)?;
        }
        let steps = match from {
            None => StepTable::create(out)?,
            Some(at) => StepTable::go_on(out, at.steps)?,
        };
        let probes = match from {
            _ if scene.probes.is_empty() => None,
            None => Some(ProbeTable::create(out, &scene.probes)?),
            Some(at) => Some(ProbeTable::go_on(out, &scene.probes, at.probes)?),
        };
        if from.is_some() {
            remove_frames_without_place(out, scene, manifest.options.frames)?;
            manifest.write(out)?;
        }
        let kinds = FrameKinds::of(scene);
        let mut writer = FrameWriter::create(out, &scene.name, scene.grid(), kinds)?;
        let obstacles = ObstacleSurfaces::new(scene, &scene.grid())?;
        writer.write_obstacles(&obstacles.at(0.0))?;
        if from.is_some() {
            let frames = &manifest.progress.frames_written;
            writer.go_on(frames, scene.time.frames_per_second)?;
        }
        Ok(Recording {
            clock: Instant::now(),
            seconds_before: manifest.progress.seconds,
            writer,
            obstacles,
            steps,
            probes,
            manifest,
            health,
            unsaved: None,
            scene,
            out,
        })
    }

    /// Writes the rows of a sub-step. Returns what is noticed in it for the first time.
    ///
    /// # Errors
    /// Where a solid has failed, with the rows written.
    fn sub_step(
        &mut self,
        simulation: &mut Simulation,
        report: &StepReport,
    ) -> Result<Vec<String>, Error> {
        let clock = simulation.clock();
        let volume_ratio = simulation.volume_ratio(report);
        let row = StepRow {
            step: clock.step - 1,
            time: clock.time,
            report,
            volume_ratio,
        };
        self.steps.push(&row)?;
        if let Some(table) = &mut self.probes {
            table.push(clock.step - 1, clock.time, &simulation.probes()?)?;
        }
        let progress = &mut self.manifest.progress;
        (progress.steps, progress.time) = (clock.step, clock.time);
        notice(&mut progress.tally, report, volume_ratio);
        let now = Now {
            step: clock.step - 1,
            time: clock.time,
            report,
            volume_ratio,
        };
        let mut notices = self.health.liquid(&now, &mut progress.tally);
        notices.extend(self.health.solids(
            (self.scene, simulation.solids()),
            &now,
            &mut progress.solids,
            || simulation.displacement(),
            || simulation.state(),
        )?);
        Ok(notices)
    }

    /// Writes what is due when a frame is done.
    fn frame(&mut self, simulation: &Simulation, n_frames: u64) -> Result<(), Error> {
        let frame = simulation.clock().frame;
        let output = &self.scene.output;
        let checkpoints = output.checkpoint_every > 0;
        let write = has_place(frame, output.every, n_frames);
        let save = checkpoints && frame > 0 && has_place(frame, output.checkpoint_every, n_frames);
        self.steps.flush()?;
        if let Some(table) = &mut self.probes {
            table.flush()?;
        }
        if !(write || save) {
            return Ok(());
        }
        let state = simulation.state()?;
        if write {
            if self.scene.obstacles_move() {
                let surfaces = self.obstacles.at(state.time);
                self.writer.write_moved_obstacles(&state, &surfaces)?;
            }
            let solids = simulation.solids();
            self.writer.write(&state, simulation.cut_cells(), solids)?;
            let at = &mut self.manifest.progress;
            if self.scene.liquid.is_none() && solids.bodies.len() > 1 {
                let mesh = solids.moved(&state.displacement);
                let overlap = Overlap::of_solids(&self.scene.grid(), &mesh);
                at.tally.overlap = at.tally.overlap.max(overlap.depth);
            }
            at.frames_written.push(state.frame);
            self.manifest.write(self.out)?;
        }
        if checkpoints && frame > 0 {
            self.keep(simulation, state, save)?;
        }
        if save { self.save() } else { Ok(()) }
    }

    /// Keeps the present moment for a checkpoint; to be written, if `sync`, after the tables.
    fn keep(&mut self, simulation: &Simulation, state: State, sync: bool) -> Result<(), Error> {
        self.manifest.progress.seconds = self.seconds();
        let probes = self.probes.as_mut().map(|table| table.bytes(sync));
        self.unsaved = Some(Checkpoint {
            state,
            carried: simulation.carried()?,
            steps_bytes: self.steps.bytes(sync)?,
            probes_bytes: probes.transpose()?.unwrap_or(0),
            manifest: self.manifest.clone(),
        });
        Ok(())
    }

    fn save(&mut self) -> Result<(), Error> {
        if let Some(checkpoint) = &mut self.unsaved {
            checkpoint.write(self.out)?;
            self.unsaved = None;
        }
        Ok(())
    }

    fn seconds(&self) -> f64 {
        self.seconds_before + self.clock.elapsed().as_secs_f64()
    }

    /// Saves what is left to save, and says in the manifest how the run ended.
    fn end(
        mut self,
        simulation: &Simulation,
        outcome: Result<(), Error>,
    ) -> Result<Manifest, Error> {
        let saved = match &outcome {
            Ok(()) => Ok(()),
            Err(Error::Interrupted) => simulation
                .state()
                .and_then(|state| self.keep(simulation, state, true))
                .and_then(|()| self.save()),
            // The last whole frame. Where that cannot be written either, the first error is the one to tell.
            Err(_) => self.save(),
        };
        let seconds = self.seconds();
        let progress = &mut self.manifest.progress;
        progress.seconds = seconds;
        progress.status = match &outcome {
            Ok(()) => RunStatus::Finished,
            Err(Error::Interrupted) => RunStatus::Interrupted,
            Err(_) => RunStatus::Failed,
        };
        progress.error = outcome.as_ref().err().map(ToString::to_string);
        let written = self.manifest.write(self.out);
        match outcome {
            Ok(()) => written.map(|()| self.manifest),
            Err(Error::Interrupted) => saved.and(written).and(Err(Error::Interrupted)),
            Err(error) => Err(error),
        }
    }
}

fn notice(tally: &mut Tally, report: &StepReport, volume_ratio: Option<f64>) {
    let ended = |with: fn(SolveStatus) -> bool| report.solves().any(|solve| with(solve.status));
    tally.squeezed += u64::from(ended(|status| status == SolveStatus::Incompatible));
    tally.missed += u64::from(ended(|status| {
        !matches!(status, SolveStatus::Converged | SolveStatus::Incompatible)
    }));
    for solve in report.solves() {
        tally.worst_residual = tally.worst_residual.max(solve.residual);
    }
    if let (Some([least, largest]), Some(ratio)) = (&mut tally.volume_ratio, volume_ratio) {
        *least = least.min(ratio);
        *largest = largest.max(ratio);
    }
    tally.floored += u64::from(report.dt_floored);
    if let Some(solid) = report.solid {
        let least = tally.min_det.unwrap_or(f64::INFINITY);
        tally.min_det = Some(least.min(solid.diagnosis.min_det));
        tally.inverted = solid.diagnosis.inverted;
    }
    if let Some(coupling) = report.coupling {
        tally.overlap = tally.overlap.max(coupling.overlap_depth);
    }
}

/// Does the frames that are left.
fn frames(
    n_frames: u64,
    simulation: &mut Simulation,
    recording: &mut Recording,
    progress: &mut dyn FnMut(&Progress),
    interrupt: &AtomicBool,
) -> Result<(), Error> {
    while simulation.clock().frame < n_frames {
        let before = simulation.clock().frame;
        let report = simulation.step()?;
        let notices = recording.sub_step(simulation, &report)?;
        let clock = simulation.clock();
        if clock.frame > before {
            recording.frame(simulation, n_frames)?;
        }
        progress(&Progress {
            frame: clock.frame,
            n_frames,
            time: clock.time,
            report: &report,
            notices: &notices,
        });
        // A run whose last frame is written is done.
        if interrupt.load(Ordering::Relaxed) && clock.frame < n_frames {
            return Err(Error::Interrupted);
        }
    }
    Ok(())
}

fn adapter_record(adapter: &AdapterReport) -> AdapterRecord {
    let limits = [
        ("max_buffer_size", adapter.buffer),
        (
            "max_compute_invocations_per_workgroup",
            adapter.threads.into(),
        ),
        (
            "max_compute_workgroups_per_dimension",
            adapter.workgroups.into(),
        ),
        ("max_storage_buffer_binding_size", adapter.storage_binding),
        (
            "max_storage_buffers_per_shader_stage",
            adapter.storage_buffers.into(),
        ),
    ];
    AdapterRecord {
        name: adapter.name.clone(),
        driver: adapter.driver.clone(),
        backend: adapter.backend.clone(),
        software: adapter.kind == "software",
        limits: limits.map(|(name, limit)| (name.to_owned(), limit)).into(),
    }
}
