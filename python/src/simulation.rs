//! A simulation that Python advances sub-step by sub-step, and its states.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use cutwater::Error;
use cutwater::elastic::Solids;
use cutwater::gpu::AdapterChoice;
use cutwater::measure::export;
use cutwater::output::checkpoint::Checkpoint;
use cutwater::output::manifest::{Manifest, RunOptions};
use cutwater::output::tables::StepRow;
use cutwater::scene::{self, Keyframe};
use cutwater::sim::{self, Backend};
use numpy::PyArrayDyn;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyBytes, PyDict};

use crate::arrays::{numbers, owned};
use crate::errors::{guarded, internal};
use crate::frame::Frame;
use crate::scene::{KeyframeTuple, Scene, keyframe};

/// Backend of its name and an adapter.
pub(crate) fn backend_of(name: &str, adapter: Option<&str>) -> PyResult<Backend> {
    match name {
        "gpu" => Ok(Backend::Gpu(choice(adapter))),
        "cpu" => Ok(Backend::Cpu),
        other => {
            let problem = format!("backend is {other:?}; use \"gpu\" or \"cpu\"");
            Err(PyValueError::new_err(problem))
        }
    }
}

/// Adapter of its name; the best by default.
pub(crate) fn choice(adapter: Option<&str>) -> AdapterChoice {
    adapter.map_or(AdapterChoice::Best, |name| {
        name.parse().unwrap_or_else(|never: std::convert::Infallible| match never {})
    })
}

struct Inner {
    simulation: sim::Simulation,
    backend: Backend,
    scene: Arc<scene::Scene>,
    solids: Arc<Solids>,
    /// Sub-step, time (s) and probe values of all sub-steps.
    probe_steps: Vec<u64>,
    probe_values: Vec<f64>,
}

impl Inner {
    fn new(scene: Arc<scene::Scene>, backend: Backend) -> Result<Inner, Error> {
        let simulation = sim::Simulation::new(&scene, &backend)?;
        Ok(Inner {
            solids: Arc::new(simulation.solids().clone()),
            simulation,
            backend,
            scene,
            probe_steps: Vec::new(),
            probe_values: Vec::new(),
        })
    }

    /// Stores the scene again after a change.
    fn changed(&mut self) {
        self.scene = Arc::new(self.simulation.scene().clone());
    }

    /// A simulation of another scene from the present state. Gravity and motions that differ between the scenes `before` and `after` change with it;
    /// others remain as they were set.
    fn continued(&self, before: &scene::Scene, after: &scene::Scene) -> Result<Inner, Error> {
        let now = &self.scene;
        if places(before) != places(after) {
            return Err(Error::input(
                "the change",
                "adds or removes an obstacle or a script with keyframes",
                "start a new simulation",
            ));
        }
        let mut scene = after.clone();
        let gravity = |scene: &scene::Scene| {
            let domain = &scene.domain;
            (domain.gravity, domain.gravity_keyframes.clone())
        };
        if gravity(after) == gravity(before) {
            (scene.domain.gravity, scene.domain.gravity_keyframes) = gravity(now);
        }
        let [old, present] = [before, now].map(|of| keyframes(&mut of.clone()));
        let mut wanted = Vec::new();
        for (frames, (old, present)) in keyframes_mut(&mut scene).zip(old.iter().zip(&present)) {
            wanted.push((!same(frames, old)).then(|| frames.clone()));
            frames.clone_from(present);
        }
        let mut next = Inner::new(Arc::new(scene), self.backend.clone())?;
        let (state, carried) = (self.simulation.state()?, self.simulation.carried()?);
        next.simulation.resume(&state, &carried)?;
        let places = places(after);
        for (place, frames) in places.into_iter().zip(wanted) {
            match (place, frames) {
                (_, None) => {}
                (Place::Obstacle(obstacle), Some(frames)) => {
                    next.simulation.set_motion(obstacle, frames)?;
                }
                (Place::Script(solid, script), Some(frames)) => {
                    next.simulation.set_script(solid, script, frames)?;
                }
            }
        }
        next.changed();
        Ok(next)
    }

    fn manifest(&self) -> Result<Manifest, Error> {
        let options = RunOptions {
            backend: self.backend.name().to_owned(),
            frames: self.scene.n_frames(),
            scale: self.scene.scale,
            overrides: self.scene.overrides.clone(),
        };
        Manifest::new(&self.scene, options, None).with_solids(&self.scene, &self.solids)
    }

    fn state(&self) -> Result<State, Error> {
        Ok(State(Checkpoint {
            state: self.simulation.state()?,
            carried: self.simulation.carried()?,
            steps_bytes: 0,
            probes_bytes: 0,
            manifest: self.manifest()?,
        }))
    }

    /// Columns and texts of the row of a sub-step, and the seconds of its stages.
    fn step(&mut self) -> Result<Report, Error> {
        let report = self.simulation.step()?;
        let clock = self.simulation.clock();
        if !self.scene.probes.is_empty() {
            let values = self.simulation.probes()?;
            self.probe_steps.push(clock.step - 1);
            self.probe_values.push(clock.time);
            self.probe_values.extend(values);
        }
        let row = StepRow {
            step: clock.step - 1,
            time: clock.time,
            report: &report,
            volume_ratio: self.simulation.volume_ratio(&report),
        };
        Ok((row.columns(), row.fields()?, report.seconds.clone()))
    }
}

/// Owner of keyframes.
#[derive(PartialEq)]
enum Place {
    /// Index of the obstacle.
    Obstacle(usize),
    /// Indices of the solid, and of the script in it.
    Script(usize, usize),
}

/// Owners of all keyframes, in the order of [`keyframes_mut`].
fn places(scene: &scene::Scene) -> Vec<Place> {
    let obstacles = scene.obstacles.iter().enumerate();
    let moving = obstacles.filter(|(_, obstacle)| obstacle.motion.is_some());
    let scripts = scene.solids.iter().enumerate().flat_map(|(number, solid)| {
        let scripted = solid.pins.iter().filter(|pin| !pin.keyframes.is_empty());
        (0..scripted.count()).map(move |script| Place::Script(number, script))
    });
    let moving = moving.map(|(number, _)| Place::Obstacle(number));
    moving.chain(scripts).collect()
}

/// Keyframes of all moving obstacles, then of all scripts.
fn keyframes_mut(scene: &mut scene::Scene) -> impl Iterator<Item = &mut Vec<Keyframe>> {
    let obstacles = scene.obstacles.iter_mut();
    let motions = obstacles.filter_map(|obstacle| obstacle.motion.as_mut());
    let motions = motions.map(|motion| &mut motion.keyframes);
    let pins = scene.solids.iter_mut().flat_map(|solid| &mut solid.pins);
    let scripts = pins.map(|pin| &mut pin.keyframes);
    motions.chain(scripts.filter(|frames| !frames.is_empty()))
}

fn keyframes(scene: &mut scene::Scene) -> Vec<Vec<Keyframe>> {
    keyframes_mut(scene).map(|frames| frames.clone()).collect()
}

fn same(a: &[Keyframe], b: &[Keyframe]) -> bool {
    let numbers = |of: &Keyframe| (of.time, of.translate, of.axis, of.angle);
    a.iter().map(numbers).eq(b.iter().map(numbers))
}

type Report = (Vec<&'static str>, Vec<String>, Vec<(&'static str, f64)>);

/// A simulation.
#[pyclass(frozen, module = "cutwater._core")]
pub(crate) struct Simulation {
    inner: Mutex<Inner>,
}

impl Simulation {
    /// Works on the simulation without the GIL. Other threads wait for their turn.
    fn with<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut Inner) -> Result<T, Error> + Send) -> PyResult<T> {
        let done = guarded(py, || match self.inner.lock() {
            Ok(mut inner) => work(&mut inner).map(Some),
            // A panic left it between two states.
            Err(_) => Ok(None),
        });
        done?.ok_or_else(|| internal(py, "an internal error has stopped this simulation before"))
    }
}

#[pymethods]
impl Simulation {
    #[new]
    fn new(py: Python<'_>, scene: &Scene, backend: &str, adapter: Option<&str>) -> PyResult<Simulation> {
        let backend = backend_of(backend, adapter)?;
        let scene = Arc::clone(&scene.0);
        let inner = guarded(py, || Inner::new(scene, backend))?;
        Ok(Simulation { inner: Mutex::new(inner) })
    }

    /// Time (s), sub-steps and frames done.
    fn clock(&self, py: Python<'_>) -> PyResult<(f64, u64, u64)> {
        self.with(py, |inner| {
            let clock = inner.simulation.clock();
            Ok((clock.time, clock.step, clock.frame))
        })
    }

    /// Name and driver of the adapter; `None` on the CPU.
    fn adapter(&self, py: Python<'_>) -> PyResult<Option<(String, String)>> {
        self.with(py, |inner| {
            let adapter = inner.simulation.adapter();
            Ok(adapter.map(|adapter| (adapter.name.clone(), adapter.driver.clone())))
        })
    }

    /// The scene with its changes.
    fn scene(&self, py: Python<'_>) -> PyResult<Scene> {
        self.with(py, |inner| Ok(Scene(Arc::clone(&inner.scene))))
    }

    /// Computes a sub-step; returns its row of steps.csv and the seconds of its stages.
    fn step<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (columns, fields, seconds) = self.with(py, Inner::step)?;
        let report = PyDict::new(py);
        for (column, field) in columns.into_iter().zip(fields) {
            if let Ok(count) = field.parse::<u64>() {
                report.set_item(column, count)?;
            } else if let Ok(number) = field.parse::<f64>() {
                report.set_item(column, number)?;
            } else {
                report.set_item(column, field)?;
            }
        }
        for (stage, seconds) in seconds {
            report.set_item(format!("seconds_{stage}"), seconds)?;
        }
        Ok(report)
    }

    /// Reads back the present state.
    fn frame(&self, py: Python<'_>) -> PyResult<Frame> {
        self.with(py, |inner| {
            Ok(Frame {
                state: inner.simulation.state()?,
                solid_distance: match inner.scene.liquid {
                    Some(_) => inner.simulation.cut_cells().solid_distance.clone(),
                    None => Vec::new(),
                },
                scene: Arc::clone(&inner.scene),
                solids: Arc::clone(&inner.solids),
            })
        })
    }

    /// Sub-steps, and a row per sub-step with the time (s) and the values of all columns.
    fn probes<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let (steps, values) = self.with(py, |inner| Ok((inner.probe_steps.clone(), inner.probe_values.clone())))?;
        let n = steps.len();
        let columns = values.len().checked_div(n).unwrap_or_default();
        Ok((owned(py, steps, &[n])?, owned(py, values, &[n, columns])?))
    }

    fn state(&self, py: Python<'_>) -> PyResult<State> {
        self.with(py, |inner| inner.state())
    }

    /// Resumes from a state; with `same_scene` of the same scene and backend only.
    fn resume(&self, py: Python<'_>, state: &State, same_scene: bool) -> PyResult<()> {
        self.with(py, |inner| {
            let Checkpoint { state, carried, manifest, .. } = &state.0;
            if same_scene {
                let backend = inner.backend.name();
                manifest.ensure_same_run(&inner.scene, backend, Path::new("the state"))?;
            }
            inner.simulation.resume(state, carried)?;
            inner.probe_steps.retain(|&step| step < state.step);
            let columns = inner.scene.probes.iter().map(|probe| probe.columns().len());
            let columns = 1 + columns.sum::<usize>();
            inner.probe_values.truncate(columns * inner.probe_steps.len());
            Ok(())
        })
    }

    /// Continues with another scene, a change of the scene `before`, from the present state.
    fn change(&self, py: Python<'_>, scene: &Scene, before: &Scene) -> PyResult<()> {
        self.with(py, |inner| {
            let mut next = inner.continued(&before.0, &scene.0)?;
            let columns = |of: &Inner| -> Vec<String> {
                let probes = of.scene.probes.iter();
                probes.flat_map(scene::Probe::columns).collect()
            };
            if columns(inner) == columns(&next) {
                next.probe_steps = std::mem::take(&mut inner.probe_steps);
                next.probe_values = std::mem::take(&mut inner.probe_values);
            }
            *inner = next;
            Ok(())
        })
    }

    fn set_gravity(&self, py: Python<'_>, gravity: [f64; 3]) -> PyResult<()> {
        self.with(py, |inner| {
            inner.simulation.set_gravity(gravity.into())?;
            inner.changed();
            Ok(())
        })
    }

    fn set_motion(&self, py: Python<'_>, obstacle: usize, keyframes: Vec<KeyframeTuple>) -> PyResult<()> {
        let keyframes = keyframes.iter().map(keyframe).collect();
        self.with(py, |inner| {
            inner.simulation.set_motion(obstacle, keyframes)?;
            inner.changed();
            Ok(())
        })
    }

    fn set_script(&self, py: Python<'_>, solid: usize, script: usize, keyframes: Vec<KeyframeTuple>) -> PyResult<()> {
        let keyframes = keyframes.iter().map(keyframe).collect();
        self.with(py, |inner| {
            inner.simulation.set_script(solid, script, keyframes)?;
            inner.changed();
            Ok(())
        })
    }

    /// Replaces velocities of the faces, and of the nodes, m/s.
    fn set_velocity<'py>(
        &self,
        py: Python<'py>,
        faces: Option<[Bound<'py, PyArrayDyn<f64>>; 3]>,
        nodes: Option<Bound<'py, PyArrayDyn<f64>>>,
    ) -> PyResult<()> {
        let faces = match &faces {
            Some([x, y, z]) => Some([numbers(x)?, numbers(y)?, numbers(z)?]),
            None => None,
        };
        let nodes = nodes.as_ref().map(numbers).transpose()?;
        let nodes = nodes.map(|nodes| nodes.as_chunks::<3>().0.to_vec());
        self.with(py, |inner| inner.simulation.set_velocity(faces, nodes))
    }

    /// Writes the system of the next sub-step into a folder.
    fn export(&self, py: Python<'_>, out: PathBuf) -> PyResult<()> {
        let (scene, backend, checkpoint) = self.with(py, |inner| {
            let mut scene = scene::Scene::clone(&inner.scene);
            let State(checkpoint) = inner.state()?;
            // The sub-step may be beyond the duration.
            let end = (checkpoint.state.frame + 1) as f64 / scene.time.frames_per_second;
            scene.time.duration = scene.time.duration.max(end);
            Ok((scene, inner.backend.clone(), checkpoint))
        })?;
        guarded(py, || {
            let options = export::Options {
                backend,
                step: checkpoint.state.step,
                start: Some((checkpoint.state, checkpoint.carried)),
                out,
            };
            export::export(&scene, &options).map(drop)
        })
    }
}

/// State of a simulation, from which the same scene resumes bitwise.
#[pyclass(frozen, module = "cutwater._core")]
pub(crate) struct State(Checkpoint);

#[pymethods]
impl State {
    #[getter]
    fn time(&self) -> f64 {
        self.0.state.time
    }

    #[getter]
    fn step(&self) -> u64 {
        self.0.state.step
    }

    #[getter]
    fn frame(&self) -> u64 {
        self.0.state.frame
    }

    /// Writes an .npz file.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        guarded(py, || self.0.clone().write_file(&path))
    }

    /// Reads an .npz file, of a state or of a run.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<State> {
        guarded(py, || match Checkpoint::read_file(&path)? {
            Some(checkpoint) => Ok(State(checkpoint)),
            None => Err(Error::input(
                path.display().to_string(),
                "there is no such file",
                "give the path of a saved state, or of the checkpoint.npz of a run",
            )),
        })
    }

    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = guarded(py, || {
            let folder = scratch()?;
            let path = folder.path().join("state.npz");
            self.0.clone().write_file(&path)?;
            std::fs::read(&path).map_err(|problem| Error::output(&path, problem))
        })?;
        Ok(PyBytes::new(py, &bytes))
    }

    #[staticmethod]
    fn from_bytes(py: Python<'_>, bytes: &[u8]) -> PyResult<State> {
        let bytes = bytes.to_vec();
        let (folder, path) = guarded(py, || {
            let folder = scratch()?;
            let path = folder.path().join("state.npz");
            std::fs::write(&path, &bytes).map_err(|problem| Error::output(&path, problem))?;
            Ok((folder, path))
        })?;
        let state = State::load(py, path);
        drop(folder);
        state
    }

    fn __eq__(&self, other: &State) -> bool {
        let ([a, b], [c, d]) = ([&self.0.state, &other.0.state], [&self.0.carried, &other.0.carried]);
        a == b && c == d
    }
}

fn scratch() -> Result<tempfile::TempDir, Error> {
    tempfile::tempdir().map_err(|problem| Error::output(&std::env::temp_dir(), problem))
}
