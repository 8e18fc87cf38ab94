//! Seconds and bytes of each output of a frame, for `bench effects`.
//!
//! The writers of a run write frames, each output alone, in a shuffled order. The read-back of the state, which precedes all of them, has its own row,
//! `read_back`. An inactive output costs nothing: it has no writer.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::Error;
use crate::geometry::ObstacleSurfaces;
use crate::output::checkpoint::Checkpoint;
use crate::output::frames::{FrameKinds, FrameWriter, SurfaceSource};
use crate::output::manifest::{Manifest, RunOptions};
use crate::output::preview::{Pictures, PreviewOptions};
use crate::scene::{Scene, Surface};
use crate::sim::Simulation;
use crate::state::State;

use super::statistics::Spread;
use super::table::{Row, columns, row};

columns! {
    OUTPUT {
        + scene "" "name of the scene";
        + output "" "key of `[output]`, or another product of a frame";
        + present "" "whether the scene has it";
        + seconds "s" "seconds of a frame, median";
        - seconds_low, seconds_high "s" "first and third quartile";
        + bytes "B" "bytes of its files of a frame, mean; without lists of frames (`.pvd`)";
        - frames "" "frames";
    }
}

const CHECKPOINT: &str = "checkpoint";

/// Makes an output of the current state of a simulation.
type Make<'a> = Box<dyn FnMut(&Simulation, &State) -> Result<(), Error> + 'a>;

/// An output of a frame.
struct Output<'a> {
    name: &'static str,
    /// Whether the scene has it.
    present: bool,
    /// Writer of the frame that it draws, not timed: a run writes the frame anyway.
    drawn: Option<FrameWriter>,
    make: Make<'a>,
    /// Seconds of each frame.
    seconds: Vec<f64>,
    /// Bytes of all of them.
    bytes: u64,
}

/// Creates a folder for timed frames below that of the results, without the frames of a killed bench.
pub fn scratch(out: &Path) -> Result<PathBuf, Error> {
    let folder = out.join(".bench_effects");
    let failed = |problem: io::Error| Error::unwritten(&folder, &problem);
    match fs::remove_dir_all(&folder) {
        Err(problem) if problem.kind() != ErrorKind::NotFound => return Err(failed(problem)),
        _ => fs::create_dir_all(&folder).map_err(failed)?,
    }
    Ok(folder)
}

/// Measures all outputs that the scene can have, for several of its states. The first state is a warm-up. `folder` is absent before and after.
pub fn measure(
    scene: &Scene,
    simulation: &mut Simulation,
    states: &[State],
    folder: &Path,
    random: &mut fastrand::Rng,
) -> Result<Vec<Row>, Error> {
    let surfaces = ObstacleSurfaces::new(scene, &scene.grid())?;
    // The preview needs a first frame. It is the warm-up state: the picture of a timed one would exist already.
    simulation.reset(&states[0])?;
    let mut outputs = outputs(scene, simulation, &surfaces, folder)?;
    let mut order: Vec<usize> = (0..outputs.len()).collect();
    for (sample, state) in states.iter().enumerate() {
        simulation.reset(state)?;
        random.shuffle(&mut order);
        for &number in &order {
            let Output { name, drawn, make, seconds, bytes, .. } = &mut outputs[number];
            let run = folder.join(*name);
            if let Some(writer) = drawn {
                write_all(writer, &surfaces, simulation, state)?;
            }
            // A checkpoint replaces the one before.
            let before = if *name == CHECKPOINT { 0 } else { bytes_in(&run)? };
            let clock = Instant::now();
            make(simulation, state)?;
            let elapsed = clock.elapsed().as_secs_f64();
            if sample > 0 {
                seconds.push(elapsed);
                *bytes += bytes_in(&run)?.saturating_sub(before);
            }
        }
    }
    let rows = outputs.into_iter().map(|Output { name, present, seconds, bytes, .. }| {
        let frames = seconds.len();
        let [low, median, high] = Spread::quartiles(seconds);
        row! {
            scene: scene.name.as_str(), output: name, present, seconds: median, seconds_low: low, seconds_high: high,
            bytes: bytes / frames as u64, frames,
        }
    });
    let rows = rows.collect();
    fs::remove_dir_all(folder).map_err(|problem| Error::unwritten(folder, &problem))?;
    Ok(rows)
}

/// Every output that the scene can have.
fn outputs<'a>(
    scene: &Scene,
    simulation: &Simulation,
    surfaces: &'a ObstacleSurfaces,
    folder: &Path,
) -> Result<Vec<Output<'a>>, Error> {
    let kinds = FrameKinds::of(scene);
    let writer = |name: &str, kinds| FrameWriter::create(&folder.join(name), &scene.name, scene.grid(), kinds);
    let mut outputs: Vec<Output> = Vec::new();
    let mut add = |name, present, drawn, make| {
        outputs.push(Output { name, present, drawn, make, seconds: Vec::new(), bytes: 0 });
    };
    add("read_back", true, None, Box::new(|simulation, _| simulation.state().map(drop)));
    for (name, present, kinds) in frame_kinds(scene, &kinds) {
        let mut writer = writer(name, kinds)?;
        let make: Make =
            Box::new(move |simulation, state| writer.write(state, simulation.cut_cells(), simulation.solids()));
        add(name, present, None, make);
    }
    if kinds.moving_obstacles {
        let name = "moving_obstacles";
        let mut writer = writer(name, FrameKinds { moving_obstacles: true, ..FrameKinds::default() })?;
        let make = move |_: &_, state: &State| writer.write_moved_obstacles(state, &surfaces.at(state.time));
        add(name, true, None, Box::new(make));
    }
    let options = RunOptions {
        backend: "gpu".to_owned(),
        frames: scene.n_frames(),
        scale: scene.scale,
        overrides: scene.overrides.clone(),
    };
    let manifest = Manifest::new(scene, options, None).with_solids(scene, simulation.solids())?;
    let run = folder.join(CHECKPOINT);
    fs::create_dir_all(&run).map_err(|problem| Error::unwritten(&run, &problem))?;
    let saved = manifest.clone();
    let save = move |simulation: &Simulation, state: &State| {
        let (state, carried, manifest) = (state.clone(), simulation.carried()?, saved.clone());
        Checkpoint { state, carried, steps_bytes: 0, probes_bytes: 0, manifest }.write(&run)
    };
    add(CHECKPOINT, scene.output.checkpoint_every > 0, None, Box::new(save));
    if kinds.markers || kinds.fields || kinds.solids {
        let run = folder.join("preview");
        let mut writer = writer("preview", kinds)?;
        manifest.write(&run)?;
        writer.write_obstacles(&surfaces.at(0.0))?;
        write_all(&mut writer, surfaces, simulation, &simulation.state()?)?;
        let mut pictures = Pictures::new(&run, &PreviewOptions::default())?;
        add("preview", false, Some(writer), Box::new(move |_, _| pictures.draw(&mut |_, _| true)));
    }
    Ok(outputs)
}

/// Kinds of files that a scene can have: name, whether it has them, and the kind alone.
fn frame_kinds(scene: &Scene, kinds: &FrameKinds) -> Vec<(&'static str, bool, FrameKinds)> {
    let none = FrameKinds::default();
    let mut all = Vec::new();
    if let Some(liquid) = &scene.liquid {
        let surface = match liquid.surface {
            Surface::Markers => SurfaceSource::Markers(scene.surface),
            Surface::Level => SurfaceSource::Level,
            Surface::Fixed => SurfaceSource::Distance,
        };
        if liquid.surface != Surface::Fixed {
            all.push(("particles", kinds.markers, FrameKinds { markers: true, ..none }));
        }
        all.push(("fields", kinds.fields, FrameKinds { fields: true, ..none }));
        all.push(("surface", kinds.surface.is_some(), FrameKinds { surface: Some(surface), ..none }));
    }
    if !scene.solids.is_empty() {
        all.push(("solids", kinds.solids, FrameKinds { solids: true, ..none }));
    }
    all
}

/// Writes all files of a frame of a run.
fn write_all(
    writer: &mut FrameWriter,
    surfaces: &ObstacleSurfaces,
    simulation: &Simulation,
    state: &State,
) -> Result<(), Error> {
    writer.write_moved_obstacles(state, &surfaces.at(state.time))?;
    writer.write(state, simulation.cut_cells(), simulation.solids())
}

/// Bytes of the files of frames below a folder; 0 without the folder.
fn bytes_in(folder: &Path) -> Result<u64, Error> {
    let Ok(entries) = fs::read_dir(folder) else { return Ok(0) };
    let bytes = entries.map(|entry| {
        let entry = entry.map_err(|problem| Error::unwritten(folder, &problem))?;
        let path = entry.path();
        let list = path.extension().is_some_and(|kind| kind == "pvd");
        match entry.metadata() {
            Ok(data) if data.is_dir() => bytes_in(&path),
            Ok(data) if !list => Ok(data.len()),
            _ => Ok(0),
        }
    });
    bytes.sum()
}
