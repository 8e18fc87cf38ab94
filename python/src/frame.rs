//! A state of a simulation on the host, and its arrays.

use std::sync::Arc;

use cutwater::Error;
use cutwater::elastic::Solids;
use cutwater::geometry::{CutCells, ObstacleSurfaces};
use cutwater::grid::{Axis, Grid};
use cutwater::output::frames::{FrameKinds, FrameWriter, SurfaceTriangles};
use cutwater::output::manifest::{Manifest, RunOptions};
use cutwater::output::preview::{Colour, PreviewOptions, preview};
use cutwater::scene::Scene;
use cutwater::state::State;
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyBytes};

use crate::arrays::{owned, rows, view};
use crate::errors::guarded;

/// State of a simulation at one time. Its arrays never change.
#[pyclass(frozen, module = "cutwater._core")]
pub(crate) struct Frame {
    pub(crate) scene: Arc<Scene>,
    pub(crate) solids: Arc<Solids>,
    pub(crate) state: State,
    /// Distance of the cell centres to bodies, m; empty without liquid.
    pub(crate) solid_distance: Vec<f64>,
}

/// Name of a solid, and the first and the next number of its nodes, elements and surface triangles.
type BodyRanges = (String, [usize; 2], [usize; 2], [usize; 2]);

impl Frame {
    fn grid(&self) -> Grid {
        self.scene.grid()
    }

    fn cut(&self) -> CutCells {
        CutCells { solid_distance: self.solid_distance.clone(), ..CutCells::default() }
    }
}

#[pymethods]
impl Frame {
    #[getter]
    fn time(&self) -> f64 {
        self.state.time
    }

    #[getter]
    fn step(&self) -> u64 {
        self.state.step
    }

    #[getter]
    fn number(&self) -> u64 {
        self.state.frame
    }

    #[getter]
    fn has_liquid(&self) -> bool {
        self.scene.liquid.is_some()
    }

    /// An array of the state by its name in checkpoint.npz.
    fn array<'py>(slf: &Bound<'py, Frame>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let frame = slf.get();
        let grid = frame.grid();
        let field = |[nx, ny, nz]: [usize; 3]| [nz, ny, nx];
        let state = &frame.state;
        let cells = |length: usize| match length {
            0 => vec![0],
            _ => field(grid.cells).to_vec(),
        };
        let faces = |axis: Axis| match state.velocity[axis.index()].len() {
            0 => vec![0],
            _ => field(grid.faces(axis)).to_vec(),
        };
        let n_markers = state.markers.len();
        let n_nodes = state.displacement.len();
        let [x, y, z] = Axis::ALL;
        match name {
            "markers" => view(slf, |f| f.state.markers.as_flattened(), &[n_markers, 3]),
            "spray" => view(slf, |f| &f.state.spray[..], &[state.spray.len()]),
            "velocity_x" => view(slf, |f| &f.state.velocity[0][..], &faces(x)),
            "velocity_y" => view(slf, |f| &f.state.velocity[1][..], &faces(y)),
            "velocity_z" => view(slf, |f| &f.state.velocity[2][..], &faces(z)),
            "pressure" => view(slf, |f| &f.state.pressure[..], &cells(state.pressure.len())),
            "liquid_distance" => {
                let shape = cells(state.liquid_distance.len());
                view(slf, |f| &f.state.liquid_distance[..], &shape)
            }
            "solid_distance" => {
                let shape = cells(frame.solid_distance.len());
                view(slf, |f| &f.solid_distance[..], &shape)
            }
            "active" => view(slf, |f| &f.state.active[..], &cells(state.active.len())),
            "component" => view(slf, |f| &f.state.component[..], &cells(state.component.len())),
            "displacement" => view(slf, |f| f.state.displacement.as_flattened(), &[n_nodes, 3]),
            "node_velocity" => view(slf, |f| f.state.node_velocity.as_flattened(), &[n_nodes, 3]),
            _ => Err(PyKeyError::new_err(name.to_owned())),
        }
    }

    /// Velocities of the markers, m/s.
    fn marker_velocities<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let velocities = guarded(py, || {
            let (grid, markers) = (self.grid(), 0..self.state.markers.len());
            let velocity = |marker| self.state.velocity_of_marker(&grid, marker).to_array();
            Ok(markers.map(velocity).collect::<Vec<_>>())
        })?;
        rows(py, velocities)
    }

    /// Velocities of the cells, m/s.
    fn cell_velocities<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        if self.state.velocity[0].is_empty() {
            return owned(py, Vec::<f64>::new(), &[0, 3]);
        }
        let grid = self.grid();
        let velocities = guarded(py, || {
            let cells = 0..grid.n_cells();
            let velocity = |cell| grid.cell_velocity(&self.state.velocity, cell).to_array();
            Ok(cells.flat_map(velocity).collect::<Vec<_>>())
        })?;
        let [nx, ny, nz] = grid.cells;
        owned(py, velocities, &[nz, ny, nx, 3])
    }

    /// Von Mises stress (Pa) and det F of all elements.
    fn stresses<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let (stress, det): (Vec<f64>, Vec<f64>) = guarded(py, || {
            let elements = 0..self.solids.elements.len();
            let displacement = &self.state.displacement;
            let both = |element| {
                let [stress, det] = self.solids.stress_and_determinant(element, displacement);
                (stress, det)
            };
            Ok(elements.map(both).unzip())
        })?;
        let n = stress.len();
        Ok((owned(py, stress, &[n])?, owned(py, det, &[n])?))
    }

    /// Names of the solids with the ranges of their nodes, elements and surface triangles.
    fn bodies(&self) -> Vec<BodyRanges> {
        let bodies = self.solids.bodies.iter();
        bodies
            .map(|body| {
                let [nodes, elements, triangles] =
                    [&body.nodes, &body.elements, &body.triangles].map(|of| [of.start, of.end]);
                (body.name.clone(), nodes, elements, triangles)
            })
            .collect()
    }

    /// Rest positions of the nodes (m), corners of the elements and of the surface triangles.
    fn meshes<'py>(&self, py: Python<'py>) -> PyResult<[Bound<'py, PyAny>; 3]> {
        let rest = self.solids.rest.iter().map(|x| x.to_array()).collect();
        Ok([rows(py, rest)?, rows(py, self.solids.elements.clone())?, rows(py, self.solids.triangles.clone())?])
    }

    /// Vertices (m), normals, velocities (m/s) and triangles of the liquid's surface, float32.
    fn surface<'py>(&self, py: Python<'py>) -> PyResult<[Bound<'py, PyAny>; 4]> {
        let surface = guarded(py, || SurfaceTriangles::new(&self.scene, &self.state, &self.cut()))?;
        Ok([
            rows(py, surface.vertices)?,
            rows(py, surface.normals)?,
            rows(py, surface.velocity)?,
            rows(py, surface.triangles)?,
        ])
    }
}

/// Draws frames of one scene through the files of a run in a temporary folder; returns a PNG, of several frames an animated one.
#[pyfunction]
pub(crate) fn draw<'py>(
    py: Python<'py>,
    frames: Vec<Py<Frame>>,
    size: Option<[usize; 2]>,
    colour: &str,
) -> PyResult<Bound<'py, PyBytes>> {
    let colour = match colour {
        "solid" => Colour::Solid,
        "stress" => Colour::Stress,
        "det_f" => Colour::DetF,
        other => {
            let problem = format!("colour is {other:?}; use \"solid\", \"stress\" or \"det_f\"");
            return Err(PyValueError::new_err(problem));
        }
    };
    if frames.is_empty() {
        return Err(PyValueError::new_err("there is no frame to draw"));
    }
    let frames: Vec<&Frame> = frames.iter().map(Py::get).collect();
    let mut interrupted = None;
    let bytes = guarded(py, || {
        let folder = tempfile::tempdir().map_err(|problem| Error::output(&std::env::temp_dir(), problem))?;
        let out = folder.path();
        write(out, &frames)?;
        let options = PreviewOptions { size, colour, animation: frames.len() > 1, ..PreviewOptions::default() };
        let report = preview(out, &options, &mut |_, _| {
            interrupted = Python::attach(|py| py.check_signals()).err();
            interrupted.is_none()
        })?;
        let picture = report.animation.or(report.pictures.into_iter().next_back());
        let picture = picture.unwrap_or_default();
        std::fs::read(&picture).map_err(|problem| Error::output(&picture, problem))
    });
    match interrupted {
        Some(error) => Err(error),
        None => Ok(PyBytes::new(py, &bytes?)),
    }
}

/// Writes frames as a run does.
fn write(out: &std::path::Path, frames: &[&Frame]) -> Result<(), Error> {
    let mut scene = Scene::clone(&frames[0].scene);
    scene.output.particles = true;
    scene.output.solids = true;
    let several = frames.len() > 1;
    if !several && frames[0].state.step > 0 {
        // Between two frames of the scene, too, the picture has the time of the state.
        scene.time.frames_per_second = 1.0 / frames[0].state.time;
    }
    let (kinds, grid) = (FrameKinds::of(&scene), scene.grid());
    let options = RunOptions {
        backend: "gpu".to_owned(),
        frames: scene.n_frames(),
        scale: scene.scale,
        overrides: scene.overrides.clone(),
    };
    let manifest = Manifest::new(&scene, options, None);
    let mut manifest = manifest.with_solids(&scene, &frames[0].solids)?;
    let surfaces = ObstacleSurfaces::new(&scene, &grid)?;
    let mut writer = FrameWriter::create(out, &scene.name, grid, kinds)?;
    writer.write_obstacles(&surfaces.at(0.0))?;
    for frame in frames {
        let mut state = frame.state.clone();
        state.frame = match several {
            true => (state.time * scene.time.frames_per_second).round() as u64,
            false => u64::from(state.step > 0),
        };
        let obstacles = ObstacleSurfaces::new(&frame.scene, &grid)?;
        writer.write_moved_obstacles(&state, &obstacles.at(state.time))?;
        writer.write(&state, &frame.cut(), &frame.solids)?;
        manifest.progress.frames_written.push(state.frame);
    }
    manifest.write(out)
}
