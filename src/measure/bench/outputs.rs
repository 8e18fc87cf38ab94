//! Seconds and bytes of each output of a frame, for `bench effects`.
//!
//! The writers of a run write frames, each output alone, in a shuffled order. The read-back of the state, which all of them need first, is a row
//! of its own, `read_back`. An output that is off costs nothing: its writer is not there.

use std::collections::BTreeMap;
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
        scene = "" "name of the scene";
        output + "" "key of `[output]`, or another product of a frame";
        present + "" "whether the scene has it";
        seconds + "s" "seconds of a frame, median";
        seconds_low - "s" "first quartile";
        seconds_high - "s" "third";
        bytes + "B" "bytes of its files of a frame, mean; without lists of frames (`.pvd`)";
        frames - "" "frames";
    }
}

/// An output.
enum Output<'a> {
    /// The state comes to the host.
    ReadBack,
    /// Files of one kind.
    Frames(FrameWriter),
    /// The surfaces of the obstacles that move.
    Obstacles(FrameWriter, &'a ObstacleSurfaces),
    /// `checkpoint.npz`.
    Checkpoint(Box<Manifest>),
    /// A picture of the frame that its writer has written before.
    Preview(FrameWriter, Box<Pictures>),
}

/// Folder for frames that are only timed, below that of the results; removed on drop.
#[derive(Debug)]
pub struct Scratch {
    folder: PathBuf,
}

impl Scratch {
    /// Makes it below `out`, without frames of a bench that was killed.
    ///
    /// # Errors
    /// [`Error::Output`].
    pub fn new(out: &Path) -> Result<Scratch, Error> {
        let folder = out.join(".bench_effects");
        let failed = |problem: io::Error| Error::unwritten(&folder, &problem);
        match fs::remove_dir_all(&folder) {
            Err(problem) if problem.kind() != ErrorKind::NotFound => return Err(failed(problem)),
            _ => fs::create_dir_all(&folder).map_err(failed)?,
        }
        Ok(Scratch { folder })
    }

    /// Where the frames are: `report` passes over folders of this name, should they be left.
    pub fn frames(&self) -> PathBuf {
        self.folder.join("frames")
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // The next bench tries again and reports.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Measures all outputs that the scene can have on states of it; the first only warms up. `folder` is empty, and is left so.
pub fn measure(
    scene: &Scene,
    simulation: &mut Simulation,
    states: &[State],
    folder: &Path,
    random: &mut fastrand::Rng,
) -> Result<Vec<Row>, Error> {
    let surfaces = ObstacleSurfaces::new(scene, &scene.grid())?;
    // A preview begins with a frame there. It is the one that only warms up: one that is timed would then have its picture.
    simulation.reset(&states[0])?;
    let mut outputs = outputs(scene, simulation, &surfaces, folder)?;
    let order: Vec<&'static str> = outputs.iter().map(|(name, ..)| *name).collect();
    let mut seconds: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
    let mut bytes: BTreeMap<&'static str, u64> = BTreeMap::new();
    for (sample, state) in states.iter().enumerate() {
        simulation.reset(state)?;
        random.shuffle(&mut outputs);
        for (name, _, output) in &mut outputs {
            let run = folder.join(*name);
            if let Output::Preview(writer, _) = output {
                // Its time is that of a run that writes the frame anyway.
                write_all(writer, &surfaces, simulation, state)?;
            }
            let before = bytes_in(&run)?;
            let clock = Instant::now();
            make(output, simulation, state, &run)?;
            let taken = clock.elapsed().as_secs_f64();
            if sample > 0 {
                seconds.entry(name).or_default().push(taken);
                let after = bytes_in(&run)?;
                *bytes.entry(name).or_default() += match output {
                    Output::Checkpoint(_) => after,
                    _ => after.saturating_sub(before),
                };
            }
        }
    }
    for name in &order {
        let run = folder.join(*name);
        if run.is_dir() {
            fs::remove_dir_all(&run).map_err(|problem| Error::unwritten(&run, &problem))?;
        }
    }
    let rows = order.into_iter().map(|name| {
        let seconds = seconds.remove(name).unwrap_or_default();
        let frames = seconds.len();
        let [seconds_low, median, seconds_high] = Spread::quartiles(seconds);
        let present = |(own, present, _): &(&str, bool, Output)| *own == name && *present;
        row! {
            scene: scene.name.as_str(), output: name, present: outputs.iter().any(present), seconds: median, seconds_low: seconds_low,
            seconds_high: seconds_high, bytes: bytes[name] / frames as u64, frames: frames,
        }
    });
    Ok(rows.collect())
}

/// Every output that the scene can have, by name, with whether it has it as it is.
fn outputs<'a>(
    scene: &Scene,
    simulation: &Simulation,
    surfaces: &'a ObstacleSurfaces,
    folder: &Path,
) -> Result<Vec<(&'static str, bool, Output<'a>)>, Error> {
    let kinds = FrameKinds::of(scene);
    let writer = |name: &str, kinds| {
        FrameWriter::create(&folder.join(name), &scene.name, scene.grid(), kinds)
    };
    let none = FrameKinds::default();
    let saves = scene.output.checkpoint_every > 0;
    let mut outputs = vec![("read_back", true, Output::ReadBack)];
    let liquid = scene.liquid.as_ref();
    let surface = liquid.map(|liquid| match liquid.surface {
        Surface::Markers => SurfaceSource::Markers(scene.surface),
        Surface::Fixed => SurfaceSource::Distance,
    });
    let markers = matches!(surface, Some(SurfaceSource::Markers(_)));
    let fields = FrameKinds {
        fields: true,
        ..none
    };
    let solids = FrameKinds {
        solids: true,
        ..none
    };
    for (name, possible, present, alone) in [
        (
            "particles",
            markers,
            kinds.markers,
            FrameKinds { markers, ..none },
        ),
        ("fields", liquid.is_some(), kinds.fields, fields),
        (
            "surface",
            liquid.is_some(),
            kinds.surface.is_some(),
            FrameKinds { surface, ..none },
        ),
        ("solids", !scene.solids.is_empty(), kinds.solids, solids),
    ] {
        if possible {
            outputs.push((name, present, Output::Frames(writer(name, alone)?)));
        }
    }
    if kinds.moving_obstacles {
        let alone = FrameKinds {
            moving_obstacles: true,
            ..none
        };
        let writer = writer("moving_obstacles", alone)?;
        outputs.push((
            "moving_obstacles",
            true,
            Output::Obstacles(writer, surfaces),
        ));
    }
    let options = RunOptions {
        backend: "gpu".to_owned(),
        frames: scene.n_frames(),
        scale: scene.scale,
        overrides: scene.overrides.clone(),
    };
    let manifest = Manifest::new(scene, options, None).with_solids(scene, simulation.solids())?;
    let run = folder.join("checkpoint");
    fs::create_dir_all(&run).map_err(|problem| Error::unwritten(&run, &problem))?;
    outputs.push((
        "checkpoint",
        saves,
        Output::Checkpoint(Box::new(manifest.clone())),
    ));
    if kinds.markers || kinds.fields || kinds.solids {
        let run = folder.join("preview");
        let mut writer = writer("preview", kinds)?;
        manifest.write(&run)?;
        writer.write_obstacles(&surfaces.at(0.0))?;
        write_all(&mut writer, surfaces, simulation, &simulation.state()?)?;
        let pictures = Pictures::new(&run, &PreviewOptions::default())?;
        outputs.push((
            "preview",
            false,
            Output::Preview(writer, Box::new(pictures)),
        ));
    }
    Ok(outputs)
}

/// Every file of a frame that a run writes.
fn write_all(
    writer: &mut FrameWriter,
    surfaces: &ObstacleSurfaces,
    simulation: &Simulation,
    state: &State,
) -> Result<(), Error> {
    writer.write_moved_obstacles(state, &surfaces.at(state.time))?;
    writer.write(state, simulation.cut_cells(), simulation.solids())
}

/// Makes one output of a state that the simulation has.
fn make(
    output: &mut Output,
    simulation: &Simulation,
    state: &State,
    run: &Path,
) -> Result<(), Error> {
    match output {
        Output::ReadBack => simulation.state().map(drop),
        Output::Frames(writer) => writer.write(state, simulation.cut_cells(), simulation.solids()),
        Output::Obstacles(writer, surfaces) => {
            writer.write_moved_obstacles(state, &surfaces.at(state.time))
        }
        Output::Checkpoint(manifest) => Checkpoint {
            state: state.clone(),
            carried: simulation.carried()?,
            steps_bytes: 0,
            probes_bytes: 0,
            manifest: (**manifest).clone(),
        }
        .write(run),
        Output::Preview(_, pictures) => pictures.draw(&mut |_, _| true),
    }
}

/// Bytes of the files of frames below a folder; 0 where there is none.
fn bytes_in(folder: &Path) -> Result<u64, Error> {
    let Ok(entries) = fs::read_dir(folder) else {
        return Ok(0);
    };
    let mut bytes = 0;
    for entry in entries {
        let entry = entry.map_err(|problem| Error::unwritten(folder, &problem))?;
        let path = entry.path();
        let list = path.extension().is_some_and(|kind| kind == "pvd");
        bytes += match entry.metadata() {
            Ok(data) if data.is_dir() => bytes_in(&path)?,
            Ok(data) if !list => data.len(),
            _ => 0,
        };
    }
    Ok(bytes)
}
