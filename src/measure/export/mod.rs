//! `export`: the systems of one sub-step and their solutions as Matrix Market files, for other solvers.
//!
//! ```text
//! DIR/spd.mtx       matrix of the solve: symmetric, positive definite except for enclosed liquid components
//! DIR/spd_rhs.mtx   its right-hand side
//! DIR/solution.mtx  solution of the simulator
//! DIR/meta.json     dt, dx and other numbers
//! ```
//!
//! With liquid the matrix is B of B p = E u*; cells.csv lists the cell of each row. With solids it is S of S v = rhs on the free components.
//! nodes.csv lists the node and component of each row. M.mtx, K.mtx and S.mtx are the blocks with all components. If liquid and solids touch, spd.mtx
//! is the two-field matrix of thesis (5.25). The same problem is also written as indefinite.mtx (5.17) and stress.mtx (5.3), each with its right-hand
//! side. The blocks are B, J, M, K, Z1 and Z2. On the GPU path the system is the one stored on the device, widened to f64.

mod coupled;
mod pressure;
mod solids;

use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Map, Value};

use super::{remove, stored};
use crate::Error;
use crate::gpu::AdapterChoice;
use crate::linalg::{Csr, Symmetry, matrix_text, norm, vector_text};
use crate::output::{FolderLock, write_atomically};
use crate::reference::StepSystem;
use crate::scene::Scene;
use crate::sim::{Backend, GpuPath, SolidSnapshot, reference_path};
use crate::state::{Carried, SolveStatus, State, StepReport};

/// Files of all exports; the last one identifies an export.
const FILES: [&str; 18] = [
    "spd.mtx",
    "spd_rhs.mtx",
    "solution.mtx",
    "indefinite.mtx",
    "indefinite_rhs.mtx",
    "stress.mtx",
    "stress_rhs.mtx",
    "B.mtx",
    "J.mtx",
    "M.mtx",
    "K.mtx",
    "S.mtx",
    "Z1.mtx",
    "Z2.mtx",
    "cells.csv",
    "separated.csv",
    "nodes.csv",
    "meta.json",
];

/// Options of an export.
#[derive(Clone, Debug)]
pub struct Options {
    /// Backend of the simulation.
    pub backend: Backend,
    /// Sub-step of the system, from 0 as in steps.csv.
    pub step: u64,
    /// State to start from, of the same scene and backend; `None` for the start of the scene.
    pub start: Option<(State, Carried)>,
    /// Folder, created if absent. An earlier export in it is replaced.
    pub out: PathBuf,
}

/// meta.json.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Meta {
    /// Version of cutwater.
    pub cutwater: &'static str,
    /// Name of the scene.
    pub scene: String,
    /// `--scale`.
    pub scale: f64,
    /// `--set`, in order.
    pub overrides: Vec<String>,
    /// `gpu` or `cpu`.
    pub backend: &'static str,
    /// Name of the adapter; none on the CPU.
    pub adapter: Option<String>,
    /// Sub-step, from 0.
    pub step: u64,
    /// Its length, s.
    pub dt: f64,
    /// Cell size, m.
    pub dx: f64,
    /// Cells along x, y, z.
    pub cells: [usize; 3],
    /// Numbers of liquid and solids: density (kg/m^3), closed_components (enclosed liquid components, each once singular), sigma, alpha, active_cells,
    /// nodes, elements, solids.
    #[serde(flatten)]
    pub part: Map<String, Value>,
    /// Relative tolerance of the simulator's solve.
    pub tolerance: f64,
    /// Status of that solve.
    pub status: &'static str,
    /// Rows of the matrix.
    pub unknowns: usize,
    /// Entries of the matrix, both triangles.
    pub entries: usize,
    /// ||b - A x|| / ||b|| of the written files.
    pub residual: f64,
}

/// A system of a sub-step with its solution and further files.
struct System {
    matrix: Csr,
    rhs: Vec<f64>,
    solution: Vec<f64>,
    /// Comments of matrix, right-hand side and solution, with units.
    comments: [&'static str; 3],
    others: Vec<File>,
    part: Value,
}

/// Name and text of a file.
type File = (&'static str, String);

fn symmetric(name: &'static str, matrix: &Csr, comment: &str) -> File {
    (name, matrix_text(matrix, Symmetry::Symmetric, comment))
}

fn vector(name: &'static str, values: &[f64], comment: &str) -> File {
    (name, vector_text(values, comment))
}

/// Result of a sub-step.
struct SubStep {
    /// s
    dt: f64,
    report: StepReport,
    adapter: Option<String>,
    /// Displacements of the nodes after it, m; of the f64 path only.
    displacement: Vec<[f64; 3]>,
    /// The solids after the solve; of the GPU path only.
    solids: Option<SolidSnapshot>,
}

/// Runs a scene to a sub-step and writes the system of that sub-step. An earlier export is replaced, but only if there is a system to write.
///
/// # Errors
/// [`Error::Input`] if the folder contains a run, or files of the same names that are not of an earlier export, or if another process writes into it;
/// errors of the simulation; [`Error::Output`].
pub fn export(scene: &Scene, options: &Options) -> Result<Meta, Error> {
    let out = &options.out;
    // Checked first, since the simulation may be long.
    ensure_replaceable(out)?;
    let (system, ran) = match (scene.liquid.is_some(), scene.solids.is_empty()) {
        (_, true) => pressure::system(scene, options)?,
        (false, false) => solids::system(scene, options)?,
        (true, false) => coupled::system(scene, options)?,
    };
    let status = ran.report.solves().next().map_or(SolveStatus::Converged, |solve| solve.status);
    if matches!(status, SolveStatus::Breakdown | SolveStatus::NonFinite) {
        let problem = format!("the solve ended with {}: there is no system to write", status.name());
        return Err(Error::Stage { stage: "solve", step: options.step, problem });
    }
    let mut product = vec![0.0; system.rhs.len()];
    system.matrix.multiply(&system.solution, &mut product);
    let residual: Vec<f64> = system.rhs.iter().zip(product).map(|(b, product)| b - product).collect();
    let (rhs_norm, residual) = (norm(&system.rhs), norm(&residual));
    let meta = Meta {
        cutwater: env!("CARGO_PKG_VERSION"),
        scene: scene.name.clone(),
        scale: scene.scale,
        overrides: scene.overrides.clone(),
        backend: options.backend.name(),
        adapter: ran.adapter,
        step: options.step,
        dt: ran.dt,
        dx: scene.grid().dx,
        cells: scene.grid().cells,
        part: system.part.as_object().cloned().unwrap_or_default(),
        tolerance: scene.solver.tolerance,
        status: status.name(),
        unknowns: system.matrix.n_rows(),
        entries: system.matrix.n_entries(),
        residual: if rhs_norm > 0.0 { residual / rhs_norm } else { 0.0 },
    };
    let [matrix, rhs, solution] = system.comments;
    let json = serde_json::to_string_pretty(&meta).map_err(|problem| Error::output(out, problem))?;
    let mut files = vec![
        symmetric("spd.mtx", &system.matrix, matrix),
        vector("spd_rhs.mtx", &system.rhs, rhs),
        vector("solution.mtx", &system.solution, solution),
    ];
    files.extend(system.others);
    files.push(("meta.json", json + "\n"));
    let _lock = FolderLock::take(out)?;
    // Another process may have written meanwhile.
    ensure_replaceable(out)?;
    FILES.iter().try_for_each(|file| remove(&out.join(file)))?;
    for (name, text) in files {
        write_atomically(&out.join(name), text.as_bytes())?;
    }
    Ok(meta)
}

/// Refuses a folder with other contents than an earlier export: the owner of its files is unknown.
fn ensure_replaceable(out: &Path) -> Result<(), Error> {
    let (name, problem, cure) = if out.join("manifest.json").exists() {
        ("manifest.json", "the folder holds a run", "choose another folder with --out")
    } else if let Some(name) = FILES.iter().find(|name| out.join(name).exists())
        && !is_meta(&out.join("meta.json"))
    {
        let problem = "the export would replace it, and no meta.json says that it is of an earlier one";
        (*name, problem, "choose another folder with --out, or remove by hand what is in this one")
    } else {
        return Ok(());
    };
    Err(Error::input(out.join(name).display().to_string(), problem, cure))
}

/// Whether a file is the meta.json of an export, of this version or another.
fn is_meta(path: &Path) -> bool {
    let text = fs::read(path).unwrap_or_default();
    let meta: Value = serde_json::from_slice(&text).unwrap_or_default();
    ["cutwater", "step", "unknowns", "residual"].iter().all(|key| meta.get(key).is_some())
}

/// Runs to a sub-step and returns the first value that `read` extracts from a system.
fn value_of<T>(
    scene: &Scene,
    options: &Options,
    mut read: impl FnMut(StepSystem) -> Option<T>,
) -> Result<(T, SubStep), Error> {
    let mut value = None;
    let mut read = |system: StepSystem| value = value.take().or_else(|| read(system));
    let sub_step = match &options.backend {
        Backend::Gpu(choice) => on_gpu(scene, choice, options, &mut read)?,
        Backend::Cpu => on_cpu(scene, options, &mut read)?,
    };
    Ok((value.ok_or_else(|| no_system_of_both(options.step))?, sub_step))
}

/// Runs the GPU path to a sub-step.
fn on_gpu(
    scene: &Scene,
    choice: &AdapterChoice,
    options: &Options,
    read: &mut dyn FnMut(StepSystem),
) -> Result<SubStep, Error> {
    let mut path = GpuPath::open(scene, choice)?;
    if let Some((state, carried)) = &options.start {
        path.resume(state, carried)?;
    }
    loop {
        let clock = path.clock();
        ensure_within(scene, options.step, (clock.step, clock.frame))?;
        if clock.step != options.step {
            path.step_observed(&mut |_, _| Ok(()))?;
            continue;
        }
        let (dt, mut solids) = (path.next_time_step().dt, None);
        let report = stored::step_observed(&mut path, &mut |_, snapshot, system| {
            solids.clone_from(&snapshot.solids);
            read(system);
            Ok(())
        })?;
        let adapter = Some(path.gpu().report().name.clone());
        return Ok(SubStep { dt, report, adapter, displacement: Vec::new(), solids });
    }
}

/// Runs the f64 path to a sub-step.
fn on_cpu(scene: &Scene, options: &Options, read: &mut dyn FnMut(StepSystem)) -> Result<SubStep, Error> {
    let mut path = reference_path(scene)?;
    if let Some((state, _)) = &options.start {
        path.reset(state.clone())?;
    }
    loop {
        ensure_within(scene, options.step, (path.state().step, path.state().frame))?;
        let time_step = path.next_time_step();
        if path.state().step != options.step {
            path.step(time_step)?;
            continue;
        }
        let report = path.step_observed(time_step, read)?;
        let displacement = path.state().displacement.clone();
        return Ok(SubStep { dt: time_step.dt, report, adapter: None, displacement, solids: None });
    }
}

/// Refuses a sub-step beyond the frames of a scene, after so many sub-steps and frames.
fn ensure_within(scene: &Scene, step: u64, (done, frame): (u64, u64)) -> Result<(), Error> {
    if frame < scene.n_frames() {
        return Ok(());
    }
    let last = done.saturating_sub(1);
    Err(Error::input(
        format!("--step {step}"),
        format!("the scene is over after {done} sub-steps"),
        format!("choose one from 0 to {last}, or let the scene last longer: --set time.duration=..."),
    ))
}

/// Error for a sub-step in which liquid and solids are solved separately.
fn no_system_of_both(step: u64) -> Error {
    Error::input(
        format!("--step {step}"),
        "liquid and solids do not touch in this sub-step, so there is no system of both",
        "choose a sub-step in which `touching` of steps.csv is 1",
    )
}
