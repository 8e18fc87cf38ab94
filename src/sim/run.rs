//! The run loop: frames, tables, checkpoints and the manifest of a simulation, from its beginning or from a
//! checkpoint.

use std::cell::Cell;
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
    AdapterRecord, CameraRecord, EarlierAdapter, Manifest, RunOptions, RunStatus, SceneRecord, SolidHealth,
    SurfaceRecord, Tally,
};
use crate::output::tables::{ProbeTable, StepRow, StepTable};
use crate::output::{FolderLock, is_partial};
use crate::scene::{MAX_FRAMES, Scene};
use crate::state::{SolveStatus, State, StepReport};

use super::health::{Health, Now};
use super::{Backend, Simulation};

/// Options of a run beyond its scene.
#[derive(Clone, Debug)]
pub struct Options {
    /// Backend of the simulation.
    pub backend: Backend,
    /// Output folder, created if absent.
    pub out: PathBuf,
    /// Number of frames; `None` for the scene's duration.
    pub frames: Option<u64>,
    /// Whether to replace an earlier run in the folder.
    pub overwrite: bool,
    /// Whether to resume the run in the folder; without one, a new run starts.
    pub resume: bool,
    /// Whether to continue after a solid has collapsed.
    pub keep_going: bool,
}

/// Progress after a sub-step.
#[derive(Debug)]
pub struct Progress<'a> {
    /// Completed frames.
    pub frame: u64,
    /// Number of frames of the run.
    pub n_frames: u64,
    /// Simulated time, s.
    pub time: f64,
    /// The sub-step.
    pub report: &'a StepReport,
    /// Notices that occur for the first time, one sentence each.
    pub notices: &'a [String],
}

/// Result of a run.
#[derive(Clone, Debug)]
pub struct Summary {
    /// Completed frames, including earlier parts, without frame 0.
    pub frames: u64,
    /// Completed sub-steps, including earlier parts.
    pub steps: u64,
    /// Wall-clock time, including earlier parts, s.
    pub seconds: f64,
    /// Counts of all notices.
    pub tally: Tally,
    /// Collapsed solids with the sub-step of collapse, if the run kept going.
    pub failed_solids: Vec<(String, u64)>,
    /// Indices of liquid regions without markers: too small for the cells, or covered.
    pub empty_regions: Vec<usize>,
    /// Resumption, if any.
    pub resumed: Option<Resumed>,
}

/// Resumption of a run.
#[derive(Clone, Debug)]
pub struct Resumed {
    /// Frames completed before.
    pub frames: u64,
    /// The adapter of the earlier part if it differs. Later results then differ by rounding.
    pub other_adapter: Option<String>,
    /// Whether skins were removed: of frames that were computed again, or animations without the later frames.
    pub skins_removed: bool,
}

/// Start of a run.
enum Start {
    /// At the first frame, replacing an earlier run.
    Anew(Option<Box<Manifest>>),
    /// At a checkpoint.
    From(Box<Checkpoint>),
    /// The run is complete.
    Finished(Box<Manifest>),
}

impl Start {
    /// Determines the start from the folder and the options.
    fn find(scene: &Scene, options: &Options, n_frames: u64) -> Result<Start, Error> {
        let out = &options.out;
        let refused = |problem: &str, cure: &str| Err(Error::input(out.display().to_string(), problem, cure));
        let manifest_path = out.join("manifest.json");
        let (manifest, checkpoint) = (manifest_path.exists(), Checkpoint::path(out).exists());
        if !(manifest || checkpoint) {
            // Without a manifest these files have no known owner and must not be overwritten.
            let names = ["steps.csv", "probes.csv", "frames", "preview"];
            return match names.iter().find(|name| out.join(name).exists()) {
                Some(name) => Err(Error::input(
                    out.join(name).display().to_string(),
                    "it is in the output folder, but without a manifest.json its run is unknown",
                    "choose another folder with --out, or delete this one",
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
                "the folder contains an earlier run",
                "choose another folder with --out, resume the run with --resume, or replace it with --overwrite",
            ),
            // Only the manifest lists the files of a run.
            (Err(error), _) => refused(
                &format!(
                    "the folder contains an earlier run that this version cannot replace: {}",
                    error.to_string().lines().next().unwrap_or_default()
                ),
                match checkpoint {
                    true => "choose another folder with --out, resume the run with --resume, or delete this one",
                    false => "choose another folder with --out, or delete this one",
                },
            ),
        }
    }

    /// Resumes in a folder with a manifest or a checkpoint.
    fn resume(scene: &Scene, options: &Options, n_frames: u64) -> Result<Start, Error> {
        let out = &options.out;
        let (manifest_path, path) = (out.join("manifest.json"), Checkpoint::path(out));
        let backend = options.backend.name();
        let refused =
            |what: &Path, problem: String, cure: &str| Err(Error::input(what.display().to_string(), problem, cure));
        let checkpoint = Checkpoint::read(out)?;
        if let Some(Checkpoint { manifest, .. }) = &checkpoint {
            manifest.ensure_same_run(scene, backend, &path)?;
            manifest.ensure_same_frames(scene, &path)?;
        }
        // If the manifest is lost, the checkpoint's copy suffices.
        let manifest = match Manifest::read(out) {
            Ok(manifest) => Some(manifest),
            Err(_) if checkpoint.is_some() => None,
            Err(error) => return Err(error),
        };
        if let Some(manifest) = &manifest {
            manifest.ensure_same_run(scene, backend, &manifest_path)?;
            manifest.ensure_same_frames(scene, &manifest_path)?;
        }
        let finished = manifest.filter(|manifest| manifest.progress.status == RunStatus::Finished);
        let checkpointed = checkpoint.as_ref().map(|checkpoint| checkpoint.state.frame);
        let done = finished.as_ref().map(|manifest| manifest.options.frames);
        let most = done.max(checkpointed).unwrap_or(0);
        if most > n_frames {
            let problem = format!("the run has {most} frames, more than the requested {n_frames}");
            return refused(out, problem, "request at least as many with --frames");
        }
        match (finished, checkpoint) {
            (Some(manifest), _) if done == Some(n_frames) => Ok(Start::Finished(Box::new(manifest))),
            (_, Some(checkpoint)) => Ok(Start::From(Box::new(checkpoint))),
            (Some(_), None) => refused(
                out,
                format!("the run ended with frame {most}, and it has no checkpoint.npz to resume from"),
                "restart it with --overwrite and `output.checkpoint_every` above 0",
            ),
            // The run stopped before its first checkpoint and starts again.
            (None, None) => Ok(Start::Anew(Some(Box::new(Manifest::read(out)?)))),
        }
    }
}

/// Runs a scene into a folder. `progress` is called after every sub-step. `interrupt` stops the run after a sub-step.
///
/// # Errors
/// [`Error::Input`] when the folder contains an earlier run, a run of another scene, a broken run or foreign files,
/// or when another process writes to it. [`Error::Interrupted`] and errors of the simulation end the run; the
/// manifest records it, and all written frames are valid.
pub fn run(
    scene: &Scene,
    options: &Options,
    progress: &mut dyn FnMut(&Progress),
    interrupt: &AtomicBool,
) -> Result<Summary, Error> {
    let out = &options.out;
    let n_frames = options.frames.unwrap_or_else(|| scene.n_frames());
    ensure_frames(n_frames)?;
    // The memory must suffice for markers that sources emit until the end.
    let longer = lasting(scene, n_frames);
    let scene = &longer;
    let lock = out.exists().then(|| FolderLock::take(out)).transpose()?;
    let mut start = Start::find(scene, options, n_frames)?;
    if let Start::Finished(manifest) = start {
        return finished(scene, out, *manifest);
    }
    let mut simulation = Simulation::new(scene, &options.backend)?;
    if interrupt.load(Ordering::Relaxed) {
        return Err(Error::Interrupted);
    }
    // Only now: a scene that exceeds the adapter must neither delete the earlier run nor create a folder.
    let _lock = match lock {
        Some(lock) => lock,
        None => {
            let lock = FolderLock::take(out)?;
            // Another process may have changed the folder meanwhile.
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
        Start::Finished(manifest) => return finished(scene, out, *manifest),
        Start::Anew(earlier) => {
            prepare_folder(out, earlier.map(|earlier| *earlier))?;
            empty_regions = geometry::empty_regions(scene, &simulation.state()?.markers)?;
            None
        }
        Start::From(checkpoint) => {
            simulation.resume(&checkpoint.state, &checkpoint.carried)?;
            resumed = Some(update_manifest(&mut manifest, &checkpoint, scene.output.every));
            Some(TablesAt::of(&checkpoint))
        }
    };
    let health = Health::new(scene, options.keep_going);
    let mut recording = Recording::begin(scene, out, manifest, (from, health))?;
    if let Some(resumed) = &mut resumed {
        resumed.skins_removed = recording.skins_removed;
    }
    let outcome = match from {
        None => recording.frame(&simulation, n_frames),
        Some(_) => Ok(()),
    };
    let outcome = outcome.and_then(|()| frames(n_frames, &mut simulation, &mut recording, progress, interrupt));
    let manifest = recording.end(&simulation, outcome)?;
    Ok(Summary { empty_regions, resumed, ..Summary::of(&manifest) })
}

/// Checks that file names have enough digits for the frames.
fn ensure_frames(n_frames: u64) -> Result<(), Error> {
    if n_frames <= MAX_FRAMES {
        return Ok(());
    }
    let problem = format!("file names allow {MAX_FRAMES} frames");
    Err(Error::input(format!("--frames {n_frames}"), problem, "request fewer frames"))
}

/// The scene with a duration of at least so many frames.
fn lasting(scene: &Scene, n_frames: u64) -> Scene {
    let mut scene = scene.clone();
    let seconds = n_frames as f64 / scene.time.frames_per_second;
    scene.time.duration = scene.time.duration.max(seconds);
    scene
}

impl Summary {
    fn of(Manifest { options, progress, solids, .. }: &Manifest) -> Summary {
        let health = solids.iter().zip(&progress.solids);
        let failed = health.filter_map(|(solid, health)| Some((solid.name.clone(), health.failed_at?)));
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

    fn finished(manifest: &Manifest) -> Summary {
        Summary {
            resumed: Some(Resumed { frames: manifest.options.frames, other_adapter: None, skins_removed: false }),
            ..Summary::of(manifest)
        }
    }
}

/// Updates a manifest for the run of a checkpoint. `every`: interval between written frames.
fn update_manifest(manifest: &mut Manifest, checkpoint: &Checkpoint, every: u64) -> Resumed {
    let Checkpoint { state, manifest: before, .. } = checkpoint;
    manifest.progress.clone_from(&before.progress);
    let solids = &mut manifest.progress.solids;
    solids.resize(manifest.solids.len(), SolidHealth::default());
    let n_frames = manifest.options.frames;
    // The last frame of a shorter run may not be due in a longer one. All others stay, also if `every` has changed.
    let written = &mut manifest.progress.frames_written;
    written.retain(|&frame| has_place(frame, every, n_frames) || !before.is_extra(frame));
    manifest.earlier_adapters.clone_from(&before.earlier_adapters);
    let mut other_adapter = None;
    if before.adapter != manifest.adapter {
        let name = |adapter: &AdapterRecord| format!("{} ({})", adapter.name, adapter.driver);
        other_adapter = before.adapter.as_ref().map(name);
        manifest.earlier_adapters.push(EarlierAdapter { adapter: before.adapter.clone(), steps: state.step });
    }
    Resumed { frames: state.frame, other_adapter, skins_removed: false }
}

/// Summary of a finished run. Its manifest gets the edits of the scene that a resumed run may have.
fn finished(scene: &Scene, out: &Path, mut manifest: Manifest) -> Result<Summary, Error> {
    let record = SceneRecord::from(scene);
    if manifest.scene != record {
        manifest.scene = record;
        manifest.options.overrides.clone_from(&scene.overrides);
        manifest.camera = CameraRecord::from(&scene.camera);
        let surface = manifest.surface.as_mut();
        surface.into_iter().for_each(|surface| *surface = SurfaceRecord::from(&scene.surface));
        manifest.write(out)?;
    }
    Ok(Summary::finished(&manifest))
}

/// Whether a run of `n_frames` writes a frame.
fn has_place(frame: u64, every: u64, n_frames: u64) -> bool {
    frame == n_frames || frame < n_frames && frame.is_multiple_of(every)
}

/// Frame number in a file name.
fn frame_of(file: &str, scene: &str) -> Option<u64> {
    let (number, _) = file.strip_prefix(scene)?.strip_prefix('_')?.split_once('.')?;
    let kinds = ["obstacles_", "surface_"];
    let number = kinds.iter().find_map(|kind| number.strip_prefix(kind)).unwrap_or(number);
    number.parse().ok()
}

/// Deletes files and pictures of frames that an earlier part of the run has written and this part will not write, and skins that do not
/// fit the resumed run. Returns whether there were such skins. `manifest`: frames written up to the checkpoint in frame `resumed`.
fn remove_frames_without_place(out: &Path, scene: &Scene, manifest: &Manifest, resumed: u64) -> Result<bool, Error> {
    remove_partial(out)?;
    let stays = |frame: u64| match frame <= resumed {
        true => manifest.progress.frames_written.contains(&frame),
        false => has_place(frame, scene.output.every, manifest.options.frames),
    };
    let without_place = |name: &str| frame_of(name, &scene.name).is_some_and(|frame| !stays(frame));
    for folder in ["frames", "preview"] {
        remove(&out.join(folder), &without_place)?;
    }
    let skins = Cell::new(false);
    let stale = |name: &str| {
        let surface = name.ends_with(".obj") && frame_of(name, &scene.name).is_some_and(|frame| frame > resumed);
        let stale = surface
            || manifest.solids.iter().any(|solid| {
                let skin = name.strip_prefix(&format!("{}_{}", scene.name, solid.name));
                skin.is_some_and(|skin| {
                    let number = skin.strip_prefix('_').and_then(|skin| skin.split_once('.'));
                    let number = number.filter(|(_, kind)| ["ply", "obj"].contains(kind));
                    let number = number.and_then(|(number, _)| number.parse().ok());
                    skin == ".glb" || number.is_some_and(|frame| frame > resumed || !stays(frame))
                })
            });
        skins.set(skins.get() || stale);
        stale
    };
    remove(&out.join("frames"), &stale)?;
    Ok(skins.get())
}

/// Creates the folder and deletes the earlier run, whose frames would mix with the new ones.
fn prepare_folder(out: &Path, earlier_run: Option<Manifest>) -> Result<(), Error> {
    remove_partial(out)?;
    if let Some(mut earlier) = earlier_run {
        // If deletion is interrupted, the manifest must not claim a complete run but still list its files.
        let progress = &mut earlier.progress;
        progress.status = RunStatus::Interrupted;
        progress.error = Some("is being replaced".to_owned());
        progress.frames_written.clear();
        earlier.write(out)?;
        let belongs = |name: &str| ["checkpoint.npz", "steps.csv", "probes.csv"].contains(&name);
        remove(out, &belongs)?;
        let belongs = |name: &str| {
            let kind = Path::new(name).extension().and_then(|kind| kind.to_str());
            let rest = name.strip_prefix(&earlier.scene.name);
            rest.is_some_and(|rest| rest.starts_with(['_', '.']))
                && matches!(kind, Some("vtp" | "vti" | "vtu" | "ply" | "obj" | "glb" | "pvd" | "png" | "gif"))
        };
        for folder in ["frames", "preview"] {
            remove(&out.join(folder), &belongs)?;
        }
    }
    Ok(())
}

/// Deletes partial files that a killed run left.
fn remove_partial(out: &Path) -> Result<(), Error> {
    for folder in [out, &out.join("frames"), &out.join("preview")] {
        remove(folder, &is_partial)?;
    }
    Ok(())
}

/// Deletes files by name from a folder, if it exists, then the folder if it is empty.
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

/// Frame of a checkpoint, and lengths of the tables then, bytes.
#[derive(Clone, Copy, Debug)]
struct TablesAt {
    frame: u64,
    steps: u64,
    probes: u64,
}

impl TablesAt {
    fn of(checkpoint: &Checkpoint) -> TablesAt {
        TablesAt { frame: checkpoint.state.frame, steps: checkpoint.steps_bytes, probes: checkpoint.probes_bytes }
    }
}

/// Output of a run in progress.
struct Recording<'a> {
    scene: &'a Scene,
    out: &'a Path,
    clock: Instant,
    /// Wall-clock time of earlier parts, s.
    seconds_before: f64,
    writer: FrameWriter,
    obstacles: ObstacleSurfaces,
    steps: StepTable,
    probes: Option<ProbeTable>,
    manifest: Manifest,
    health: Health,
    /// The last state for a checkpoint that is not yet on disk.
    unsaved: Option<Checkpoint>,
    /// Whether skins of an earlier part were removed.
    skins_removed: bool,
}

impl<'a> Recording<'a> {
    /// Creates the files, or opens those of the run and truncates its tables to lengths in bytes.
    fn begin(
        scene: &'a Scene,
        out: &'a Path,
        manifest: Manifest,
        (from, health): (Option<TablesAt>, Health),
    ) -> Result<Recording<'a>, Error> {
        // First the manifest, which marks the owner of the folder. Tables that do not belong to the run must stay
        // untouched.
        if from.is_none() {
            manifest.write(out)?;
        }
        let steps = match from {
            None => StepTable::create(out)?,
            Some(at) => StepTable::resume(out, at.steps)?,
        };
        let probes = match from {
            _ if scene.probes.is_empty() => None,
            None => Some(ProbeTable::create(out, &scene.probes)?),
            Some(at) => Some(ProbeTable::resume(out, &scene.probes, at.probes)?),
        };
        let mut skins_removed = false;
        if let Some(at) = from {
            skins_removed = remove_frames_without_place(out, scene, &manifest, at.frame)?;
            manifest.write(out)?;
        }
        let kinds = FrameKinds::of(scene);
        let mut writer = FrameWriter::create(out, &scene.name, scene.grid(), kinds)?;
        let obstacles = ObstacleSurfaces::new(scene, &scene.grid())?;
        writer.write_obstacles(&obstacles.at(0.0))?;
        if from.is_some() {
            let frames = &manifest.progress.frames_written;
            writer.resume(frames, scene.time.frames_per_second)?;
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
            skins_removed,
            scene,
            out,
        })
    }

    /// Writes the rows of a sub-step. Returns new notices.
    ///
    /// # Errors
    /// Fails after a solid has collapsed; the rows are written before.
    fn sub_step(&mut self, simulation: &mut Simulation, report: &StepReport) -> Result<Vec<String>, Error> {
        let clock = simulation.clock();
        let volume_ratio = simulation.volume_ratio(report);
        let row = StepRow { step: clock.step - 1, time: clock.time, report, volume_ratio };
        self.steps.push(&row)?;
        if let Some(table) = &mut self.probes {
            table.push(clock.step - 1, clock.time, &simulation.probes()?)?;
        }
        let progress = &mut self.manifest.progress;
        (progress.steps, progress.time) = (clock.step, clock.time);
        notice(&mut progress.tally, report, volume_ratio);
        let now = Now { step: clock.step - 1, time: clock.time, report, volume_ratio };
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

    /// Writes the output due after a frame.
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
                let overlap = Overlap::between_solids(&self.scene.grid(), &mesh);
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

    /// Stores the state for a checkpoint. With `sync` the tables are flushed to disk first.
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

    /// Writes the last checkpoint, and the end of the run to the manifest.
    fn end(mut self, simulation: &Simulation, outcome: Result<(), Error>) -> Result<Manifest, Error> {
        let saved = match &outcome {
            Ok(()) => Ok(()),
            Err(Error::Interrupted) => {
                simulation.state().and_then(|state| self.keep(simulation, state, true)).and_then(|()| self.save())
            }
            // The last complete frame. If that fails too, the first error is reported.
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
    tally.missed += u64::from(ended(|status| !matches!(status, SolveStatus::Converged | SolveStatus::Incompatible)));
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

/// Computes the remaining frames.
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
        progress(&Progress { frame: clock.frame, n_frames, time: clock.time, report: &report, notices: &notices });
        // A run whose last frame is written is complete.
        if interrupt.load(Ordering::Relaxed) && clock.frame < n_frames {
            return Err(Error::Interrupted);
        }
    }
    Ok(())
}

fn adapter_record(adapter: &AdapterReport) -> AdapterRecord {
    let limits = [
        ("max_buffer_size", adapter.buffer),
        ("max_compute_invocations_per_workgroup", adapter.threads.into()),
        ("max_compute_workgroups_per_dimension", adapter.workgroups.into()),
        ("max_storage_buffer_binding_size", adapter.storage_binding),
        ("max_storage_buffers_per_shader_stage", adapter.storage_buffers.into()),
    ];
    AdapterRecord {
        name: adapter.name.clone(),
        driver: adapter.driver.clone(),
        backend: adapter.backend.clone(),
        software: adapter.kind == "software",
        limits: limits.map(|(name, limit)| (name.to_owned(), limit)).into(),
    }
}
