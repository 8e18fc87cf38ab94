//! Scenes: text, overrides and scale of the Python class, checked by the library.

use std::path::PathBuf;
use std::sync::Arc;

use cutwater::scene::{self, Keyframe};
use cutwater::sim;
use glam::DVec3;
use pyo3::prelude::*;

use crate::errors::guarded;

/// Time (s), translation (m), axis and angle (rad) of a keyframe.
pub(crate) type KeyframeTuple = (f64, [f64; 3], [f64; 3], f64);

/// Keyframe of a tuple.
pub(crate) fn keyframe(&(time, translate, axis, angle): &KeyframeTuple) -> Keyframe {
    Keyframe { time, translate: translate.into(), axis: DVec3::from(axis).normalize_or_zero(), angle }
}

/// A checked scene.
#[pyclass(frozen, module = "cutwater._core")]
pub(crate) struct Scene(pub(crate) Arc<scene::Scene>);

#[pymethods]
impl Scene {
    /// Checks a text, or without one the file.
    #[new]
    fn new(py: Python<'_>, path: PathBuf, text: Option<String>, overrides: Vec<String>, scale: f64) -> PyResult<Scene> {
        let scene = guarded(py, || match &text {
            Some(text) => scene::Scene::parse(&path, text, &overrides, scale),
            None => scene::Scene::load(&path, &overrides, scale),
        });
        Ok(Scene(Arc::new(scene?)))
    }

    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    #[getter]
    fn cells(&self) -> [usize; 3] {
        self.0.domain.cells
    }

    #[getter]
    fn size(&self) -> [f64; 3] {
        self.0.domain.size.to_array()
    }

    #[getter]
    fn dx(&self) -> f64 {
        self.0.grid().dx
    }

    #[getter]
    fn n_frames(&self) -> u64 {
        self.0.n_frames()
    }

    #[getter]
    fn frames_per_second(&self) -> f64 {
        self.0.time.frames_per_second
    }

    #[getter]
    fn gravity(&self) -> [f64; 3] {
        self.0.domain.gravity.to_array()
    }

    /// Columns of the probes and their units.
    fn probes(&self) -> Vec<(String, &'static str)> {
        let probes = self.0.probes.iter();
        probes.flat_map(|probe| probe.columns().into_iter().zip(probe.units().iter().copied())).collect()
    }

    /// Keyframes of an obstacle; none for one at rest.
    fn motion(&self, obstacle: usize) -> Option<Vec<KeyframeTuple>> {
        let motion = self.0.obstacles.get(obstacle)?.motion.as_ref()?;
        let tuple = |of: &Keyframe| (of.time, of.translate.to_array(), of.axis.to_array(), of.angle);
        Some(motion.keyframes.iter().map(tuple).collect())
    }

    /// Translation (m) and rotation vector (rad) of a moving obstacle at a time (s).
    fn pose(&self, obstacle: usize, time: f64) -> Option<([f64; 3], [f64; 3])> {
        let motion = self.0.obstacles.get(obstacle)?.motion.as_ref()?;
        let (rotation, translate) = Keyframe::pose(&motion.keyframes, time);
        Some((translate.to_array(), rotation.to_array()))
    }

    /// Parts that were removed because they refer to one that an override removed.
    #[getter]
    fn removed(&self) -> Vec<String> {
        self.0.removed.clone()
    }

    fn warnings(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        guarded(py, || sim::warnings(&self.0))
    }
}

/// The keys that a text and overrides give, as JSON.
#[pyfunction]
pub(crate) fn scene_tree(py: Python<'_>, path: PathBuf, text: String, overrides: Vec<String>) -> PyResult<String> {
    let tree = guarded(py, || scene::Scene::tree(&path, &text, &overrides))?;
    Ok(tree.to_string())
}
