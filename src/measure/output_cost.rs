//! What each output of a scene costs a frame, in seconds and bytes, for `bench effects`.
//!
//! Frames are written by the writers that a run has, each output alone, in a shuffled order. What all of them need first, the state on the
//! host, is a row of its own, `read_back`: a run in which no frame and no checkpoint is due does not read it. An output that is off takes
//! nothing: its writer is not there.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;

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

/// A row of outputs.csv.
#[derive(Clone, Debug, Default, Serialize)]
pub struct OutputRow {
    /// Name of the scene.
    pub scene: String,
    /// The output: a key of `[output]`, or what else a run makes of a frame.
    pub output: &'static str,
    /// Whether the scene as it is has it, without options on the command line.
    pub present: bool,
    /// Seconds of a frame, median.
    pub seconds: f64,
    /// First quartile.
    pub seconds_low: f64,
    /// Third.
    pub seconds_high: f64,
    /// Bytes of its files of a frame, mean; without the lists of frames (`.pvd`). A checkpoint replaces the one before.
    pub bytes: u64,
    /// Frames.
    pub frames: usize,
}

/// Something that is made of a frame.
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

/// A folder for frames that are only timed, below that of the results, where a run may have frames that stay. It goes, with what is in it, when
/// this is dropped.
#[derive(Debug)]
pub(super) struct Scratch {
    folder: PathBuf,
}

impl Scratch {
    /// Makes it below `out`, without what a bench that was killed has left in it.
    ///
    /// # Errors
    /// [`Error::Output`].
    pub(super) fn new(out: &Path) -> Result<Scratch, Error> {
        let folder = out.join(".bench_effects");
        let failed = |problem: io::Error| Error::unwritten(&folder, &problem);
        match fs::remove_dir_all(&folder) {
            Err(problem) if problem.kind() != ErrorKind::NotFound => return Err(failed(problem)),
            _ => fs::create_dir_all(&folder).map_err(failed)?,
        }
        Ok(Scratch { folder })
    }

    /// Where the frames are: `report` passes over folders of this name, should they be left.
    pub(super) fn frames(&self) -> PathBuf {
        self.folder.join("frames")
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // The next bench tries again, and tells.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Measures all outputs that the scene can have on states of it; the first only warms up. `folder` is empty, and is left so.
pub(super) fn measure(
    scene: &Scene,
    simulation: &mut Simulation,
    states: &[State],
    folder: &Path,
    random: &mut fastrand::Rng,
) -> Result<Vec<OutputRow>, Error> {
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
        OutputRow {
            scene: scene.name.clone(),
            output: name,
            present: outputs
                .iter()
                .any(|(own, present, _)| *own == name && *present),
            seconds: median,
            seconds_low,
            seconds_high,
            bytes: bytes[name] / frames as u64,
            frames,
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
    for (name, possible, present, alone) in [
        (
            "particles",
            markers,
            kinds.markers,
            FrameKinds { markers, ..none },
        ),
        (
            "fields",
            liquid.is_some(),
            kinds.fields,
            FrameKinds {
                fields: true,
                ..none
            },
        ),
        (
            "surface",
            liquid.is_some(),
            kinds.surface.is_some(),
            FrameKinds { surface, ..none },
        ),
        (
            "solids",
            !scene.solids.is_empty(),
            kinds.solids,
            FrameKinds {
                solids: true,
                ..none
            },
        ),
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

#[cfg(test)]
mod tests {
    use std::fs;

    use crate::scene::Scene;
    use crate::sim::{Backend, Simulation};

    use super::{Scratch, measure};

    const POOL: &str = "
[domain]
size = [1.0, 1.0, 1.0]
cells = [8, 8, 8]

[time]
duration = 0.5

[camera]
size = [160, 90]

[[liquid.region]]
box = { min = [0.0, 0.0, 0.0], max = [1.0, 0.5, 1.0] }
";

    #[test]
    fn frames_are_timed_in_a_folder_that_goes() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let scene = Scene::parse("pool.toml".as_ref(), POOL, &[], 1.0).unwrap();
        let mut simulation = Simulation::new(&scene, &Backend::Cpu).unwrap();
        let first = simulation.state().unwrap();
        let mut second = first.clone();
        (second.frame, second.time) = (1, 1.0 / scene.time.frames_per_second);
        // Where the effects' sub-steps leave it.
        simulation.reset(&second).unwrap();
        // Of a bench that was killed, and of a run: both larger than what is written here.
        let frame = "frames/particles/frames/pool_000001.vtp";
        let [left, of_run] = [".bench_effects", ""].map(|own| out.join(own).join(frame));
        for file in [&left, &of_run] {
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(file, vec![0u8; 1 << 20]).unwrap();
        }
        let scratch = Scratch::new(out).unwrap();
        assert!(!left.exists());
        let rows = measure(
            &scene,
            &mut simulation,
            &[first, second],
            &scratch.frames(),
            &mut fastrand::Rng::with_seed(7),
        )
        .unwrap();
        let written: Vec<(&str, bool)> = rows
            .iter()
            .map(|row| (row.output, (1..1 << 20).contains(&row.bytes)))
            .collect();
        let expected = [
            ("read_back", false),
            ("particles", true),
            ("fields", true),
            ("surface", true),
            ("checkpoint", true),
            ("preview", true),
        ];
        assert_eq!(written, expected, "{rows:?}");
        drop(scratch);
        let entries = fs::read_dir(out).unwrap();
        let names: Vec<_> = entries.map(|entry| entry.unwrap().file_name()).collect();
        assert_eq!(names, ["frames"]);
        assert_eq!(fs::metadata(of_run).unwrap().len(), 1 << 20);
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(".bench_effects");
        fs::write(&file, "not the bench's").unwrap();
        for out in [folder.path(), file.as_path()] {
            let error = Scratch::new(out).unwrap_err();
            assert_eq!(error.exit_code(), 2, "{error}");
            assert!(error.to_string().contains(".bench_effects"), "{error}");
        }
        assert!(file.is_file());
    }
}
