//! Seconds and bytes of each output of a frame, for `bench effects`.
//!
//! The writers of a run write frames, each output alone, in a shuffled order. The read-back of the state, which precedes all of them, has its own row,
//! `read_back`. An inactive output costs nothing: it has no writer.

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

/// Product of a frame.
enum Product<'a> {
    /// The state, read back.
    ReadBack,
    /// Files of one kind.
    Frames(FrameWriter),
    /// Surfaces of the moving obstacles.
    Obstacles(FrameWriter, &'a ObstacleSurfaces),
    /// `checkpoint.npz`.
    Checkpoint(Box<Manifest>),
    /// A picture of a frame that its writer has written.
    Preview(FrameWriter, Box<Pictures>),
}

/// Name of an output, whether the scene has it, and its product.
type Output<'a> = (&'static str, bool, Product<'a>);

/// Folder for timed frames, below that of the results; removed on drop.
#[derive(Debug)]
pub struct Scratch {
    folder: PathBuf,
}

impl Scratch {
    /// Creates it below `out`, and removes the frames of a killed bench.
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

    /// Folder of the frames; `report` ignores folders of this name.
    pub fn frames(&self) -> PathBuf {
        self.folder.join("frames")
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // After a failure the next bench tries again and reports it.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Measures all outputs that the scene can have, for several of its states. The first state is a warm-up. `folder` is empty before and after.
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
    let order: Vec<(&'static str, bool)> = outputs.iter().map(|it| (it.0, it.1)).collect();
    let mut seconds: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
    let mut bytes: BTreeMap<&'static str, u64> = BTreeMap::new();
    for (sample, state) in states.iter().enumerate() {
        simulation.reset(state)?;
        random.shuffle(&mut outputs);
        for (name, _, product) in &mut outputs {
            let run = folder.join(*name);
            if let Product::Preview(writer, _) = product {
                // Not timed: a run writes the frame anyway.
                write_all(writer, &surfaces, simulation, state)?;
            }
            let before = bytes_in(&run)?;
            let clock = Instant::now();
            make(product, simulation, state, &run)?;
            let elapsed = clock.elapsed().as_secs_f64();
            if sample > 0 {
                seconds.entry(name).or_default().push(elapsed);
                let after = bytes_in(&run)?;
                *bytes.entry(name).or_default() += match product {
                    // Each replaces the one before.
                    Product::Checkpoint(_) => after,
                    _ => after.saturating_sub(before),
                };
            }
        }
    }
    for (name, _) in &order {
        let run = folder.join(*name);
        if run.is_dir() {
            fs::remove_dir_all(&run).map_err(|problem| Error::unwritten(&run, &problem))?;
        }
    }
    let rows = order.into_iter().map(|(output, present)| {
        let seconds = seconds.remove(output).unwrap_or_default();
        let frames = seconds.len();
        let [low, median, high] = Spread::quartiles(seconds);
        row! {
            scene: scene.name.as_str(), output: output, present: present, seconds: median, seconds_low: low, seconds_high: high,
            bytes: bytes[output] / frames as u64, frames: frames,
        }
    });
    Ok(rows.collect())
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
    let mut outputs = vec![("read_back", true, Product::ReadBack)];
    for (name, present, kinds) in frame_kinds(scene, &kinds) {
        outputs.push((name, present, Product::Frames(writer(name, kinds)?)));
    }
    if kinds.moving_obstacles {
        let name = "moving_obstacles";
        let alone = FrameKinds { moving_obstacles: true, ..FrameKinds::default() };
        outputs.push((name, true, Product::Obstacles(writer(name, alone)?, surfaces)));
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
    let saves = scene.output.checkpoint_every > 0;
    let checkpoint = Product::Checkpoint(Box::new(manifest.clone()));
    outputs.push(("checkpoint", saves, checkpoint));
    if kinds.markers || kinds.fields || kinds.solids {
        let run = folder.join("preview");
        let mut writer = writer("preview", kinds)?;
        manifest.write(&run)?;
        writer.write_obstacles(&surfaces.at(0.0))?;
        write_all(&mut writer, surfaces, simulation, &simulation.state()?)?;
        let pictures = Box::new(Pictures::new(&run, &PreviewOptions::default())?);
        outputs.push(("preview", false, Product::Preview(writer, pictures)));
    }
    Ok(outputs)
}

/// Kinds of files that a scene can have: name, whether it has them, and the kind alone.
fn frame_kinds(scene: &Scene, kinds: &FrameKinds) -> Vec<(&'static str, bool, FrameKinds)> {
    let none = FrameKinds::default();
    let mut all = Vec::new();
    if let Some(liquid) = &scene.liquid {
        let (markers, surface) = match liquid.surface {
            Surface::Markers => (true, SurfaceSource::Markers(scene.surface)),
            Surface::Level => (true, SurfaceSource::Level),
            Surface::Fixed => (false, SurfaceSource::Distance),
        };
        if markers {
            all.push(("particles", kinds.markers, FrameKinds { markers, ..none }));
        }
        let (fields, surface) = (true, Some(surface));
        all.push(("fields", kinds.fields, FrameKinds { fields, ..none }));
        let present = kinds.surface.is_some();
        all.push(("surface", present, FrameKinds { surface, ..none }));
    }
    if !scene.solids.is_empty() {
        let solids = true;
        all.push(("solids", kinds.solids, FrameKinds { solids, ..none }));
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

/// Makes one product of the current state of the simulation.
fn make(product: &mut Product, simulation: &Simulation, state: &State, run: &Path) -> Result<(), Error> {
    match product {
        Product::ReadBack => simulation.state().map(drop),
        Product::Frames(writer) => writer.write(state, simulation.cut_cells(), simulation.solids()),
        Product::Obstacles(writer, surfaces) => writer.write_moved_obstacles(state, &surfaces.at(state.time)),
        Product::Checkpoint(manifest) => Checkpoint {
            state: state.clone(),
            carried: simulation.carried()?,
            steps_bytes: 0,
            probes_bytes: 0,
            manifest: (**manifest).clone(),
        }
        .write(run),
        Product::Preview(_, pictures) => pictures.draw(&mut |_, _| true),
    }
}

/// Bytes of the files of frames below a folder; 0 without the folder.
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
