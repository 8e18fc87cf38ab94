//! The run loop: frames, tables and the manifest of one simulation.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crate::Error;
use crate::geometry;
use crate::gpu::AdapterReport;
use crate::output::frames::{FrameKinds, FrameWriter};
use crate::output::manifest::{AdapterRecord, Manifest, RunOptions, RunStatus};
use crate::output::tables::{ProbeTable, StepRow, StepTable};
use crate::scene::Scene;
use crate::state::{SolveStatus, StepReport};

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
}

/// What a run came to.
#[derive(Clone, Debug)]
pub struct Summary {
    /// Frames written, frame 0 not counted.
    pub frames: u64,
    /// Sub-steps.
    pub steps: u64,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Sub-steps with a solve that missed its tolerance.
    pub missed: u64,
    /// Largest true relative residual of all solves.
    pub worst_residual: f64,
    /// Least and largest liquid volume over the volume at the start, where there is liquid.
    pub volume_ratio: Option<[f64; 2]>,
    /// Sub-steps longer than the CFL condition allows.
    pub floored: u64,
    /// Markers lost in obstacles.
    pub dropped: u64,
    /// Least det F of the elements of solids in all sub-steps, where there are any.
    pub min_det: Option<f64>,
    /// Elements with a det F of 0 or less after the last sub-step.
    pub inverted: usize,
    /// Liquid regions, by number, that are too small or too well covered for the cells to hold any of their liquid.
    pub empty_regions: Vec<usize>,
}

/// Runs a scene into a folder. `progress` hears of every sub-step; a true `interrupt` ends the run after the sub-step.
///
/// # Errors
/// [`Error::Input`] when the folder holds an earlier run, or something that is none and is to be overwritten,
/// [`Error::Interrupted`], and whatever the simulation ends with; the manifest then says so and all frames written stay valid.
pub fn run(
    scene: &Scene,
    options: &Options,
    progress: &mut dyn FnMut(&Progress),
    interrupt: &AtomicBool,
) -> Result<Summary, Error> {
    let earlier_run = options.out.join("manifest.json").exists();
    let earlier_run = match (earlier_run, options.overwrite) {
        (true, true) => Some(Manifest::read(&options.out).map_err(|error| {
            Error::input(
                options.out.display().to_string(),
                format!("manifest.json is not of a run that this version can replace: {error}"),
                "choose another folder with --out, or remove this one by hand",
            )
        })?),
        (true, false) => {
            return Err(Error::input(
                options.out.display().to_string(),
                "the folder holds an earlier run",
                "choose another folder with --out, or replace the run with --overwrite",
            ));
        }
        (false, _) => None,
    };
    let mut simulation = Simulation::new(scene, &options.backend)?;
    if interrupt.load(Ordering::Relaxed) {
        return Err(Error::Interrupted);
    }
    // Only now: a scene that does not fit the adapter must not cost the earlier run.
    prepare_folder(&options.out, earlier_run.as_ref())?;
    let n_frames = options.frames.unwrap_or_else(|| scene.n_frames());
    let run_options = RunOptions {
        backend: options.backend.name().to_owned(),
        frames: n_frames,
        scale: scene.scale,
        overrides: scene.overrides.clone(),
    };
    let adapter = simulation.adapter().map(adapter_record);
    let mut manifest =
        Manifest::new(scene, run_options, adapter).with_solids(scene, simulation.solids())?;
    manifest.write(&options.out)?;
    let clock = Instant::now();
    let outcome = frames(
        scene,
        options,
        n_frames,
        &mut simulation,
        &mut manifest,
        progress,
        interrupt,
    );
    manifest.progress.seconds = clock.elapsed().as_secs_f64();
    manifest.progress.status = match &outcome {
        Ok(_) => RunStatus::Finished,
        Err(Error::Interrupted) => RunStatus::Interrupted,
        Err(_) => RunStatus::Failed,
    };
    manifest.progress.error = outcome.as_ref().err().map(ToString::to_string);
    manifest.write(&options.out)?;
    outcome.map(|summary| Summary {
        seconds: manifest.progress.seconds,
        ..summary
    })
}

/// Makes the folder, and takes the earlier run out of it: its frames would mix with the new ones.
fn prepare_folder(out: &Path, earlier_run: Option<&Manifest>) -> Result<(), Error> {
    if let Some(Manifest { scene, .. }) = earlier_run {
        let table = |name: &str| name == "steps.csv" || name == "probes.csv";
        remove(out, &table)?;
        let of_run = |name: &str| {
            let kind = Path::new(name).extension().and_then(|kind| kind.to_str());
            let rest = name.strip_prefix(&scene.name);
            rest.is_some_and(|rest| rest.starts_with(['_', '.']))
                && matches!(kind, Some("vtp" | "vti" | "vtu" | "pvd" | "png"))
        };
        for folder in ["frames", "preview"] {
            remove(&out.join(folder), &of_run)?;
        }
    }
    fs::create_dir_all(out).map_err(|problem| Error::output(out, problem))
}

/// Removes the files of a folder, if there is one, whose names are meant, and the folder where nothing is left of it.
fn remove(folder: &Path, meant: &dyn Fn(&str) -> bool) -> Result<(), Error> {
    let Ok(entries) = fs::read_dir(folder) else {
        return Ok(());
    };
    let mut left = false;
    for entry in entries {
        let entry = entry.map_err(|problem| Error::output(folder, problem))?;
        if entry.file_name().to_str().is_some_and(meant) {
            let path = entry.path();
            fs::remove_file(&path).map_err(|problem| Error::output(&path, problem))?;
        } else {
            left = true;
        }
    }
    if left {
        return Ok(());
    }
    fs::remove_dir(folder).map_err(|problem| Error::output(folder, problem))
}

fn frames(
    scene: &Scene,
    options: &Options,
    n_frames: u64,
    simulation: &mut Simulation,
    manifest: &mut Manifest,
    progress: &mut dyn FnMut(&Progress),
    interrupt: &AtomicBool,
) -> Result<Summary, Error> {
    let out = &options.out;
    let mut writer = FrameWriter::create(out, &scene.name, scene.grid(), FrameKinds::of(scene))?;
    writer.write_obstacles(&geometry::obstacle_surfaces(scene, &scene.grid())?)?;
    let mut steps = StepTable::create(out)?;
    let mut probes = (!scene.probes.is_empty())
        .then(|| ProbeTable::create(out, &scene.probes))
        .transpose()?;
    let mut write_frame = |simulation: &Simulation, manifest: &mut Manifest| {
        let state = simulation.state()?;
        writer.write(&state, simulation.cut_cells(), simulation.solids())?;
        let at = &mut manifest.progress;
        at.frames_written.push(state.frame);
        (at.steps, at.time) = (state.step, state.time);
        manifest.write(out)
    };
    write_frame(simulation, manifest)?;
    let mut summary = Summary {
        frames: 0,
        steps: 0,
        seconds: 0.0,
        missed: 0,
        worst_residual: 0.0,
        volume_ratio: scene.liquid.as_ref().map(|_| [1.0; 2]),
        floored: 0,
        min_det: None,
        inverted: 0,
        dropped: 0,
        empty_regions: geometry::empty_regions(scene, &simulation.state()?.markers)?,
    };
    while simulation.clock().frame < n_frames {
        let before = simulation.clock().frame;
        let report = simulation.step()?;
        let clock = simulation.clock();
        let volume_ratio = simulation.volume_ratio(&report);
        let row = StepRow {
            step: clock.step - 1,
            time: clock.time,
            report: &report,
            volume_ratio,
        };
        steps.push(&row)?;
        if let Some(table) = &mut probes {
            table.push(clock.step - 1, clock.time, &simulation.probes()?)?;
        }
        summary.steps += 1;
        summary.missed += u64::from(
            report
                .solves()
                .any(|solve| solve.status != SolveStatus::Converged),
        );
        for solve in report.solves() {
            summary.worst_residual = summary.worst_residual.max(solve.residual);
        }
        if let (Some([least, largest]), Some(ratio)) = (&mut summary.volume_ratio, volume_ratio) {
            *least = least.min(ratio);
            *largest = largest.max(ratio);
        }
        summary.floored += u64::from(report.dt_floored);
        if let Some(solid) = report.solid {
            let least = summary.min_det.unwrap_or(f64::INFINITY);
            summary.min_det = Some(least.min(solid.diagnosis.min_det));
            summary.inverted = solid.diagnosis.inverted;
        }
        summary.dropped += report.liquid.map_or(0, |liquid| liquid.dropped);
        if clock.frame > before {
            summary.frames += 1;
            steps.flush()?;
            if let Some(table) = &mut probes {
                table.flush()?;
            }
            if clock.frame.is_multiple_of(scene.output.every) || clock.frame == n_frames {
                write_frame(simulation, manifest)?;
            }
        }
        progress(&Progress {
            frame: clock.frame,
            n_frames,
            time: clock.time,
            report: &report,
        });
        if interrupt.load(Ordering::Relaxed) {
            steps.flush()?;
            return Err(Error::Interrupted);
        }
    }
    Ok(summary)
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
