//! `export`: the systems of one sub-step and their answers as Matrix Market files, for other solvers.
//!
//! ```text
//! DIR/spd.mtx       the matrix that was solved with: symmetric, positive definite but for components without a free surface
//! DIR/spd_rhs.mtx   its right-hand side
//! DIR/solution.mtx  the answer as the simulator found it
//! DIR/meta.json     dt, dx and the like
//! ```
//!
//! With liquid the matrix is B of B p = E u* (design section 2) and cells.csv tells which cell each row is; with solids it is S of
//! S v = rhs on the free components, nodes.csv tells which component of which node each row is, and M.mtx, K.mtx and S.mtx are the
//! blocks with all components. Where both touch, spd.mtx is the matrix of the two fields of thesis (5.25), and the same problem is written
//! as indefinite.mtx (5.17) and stress.mtx (5.3), each with its right-hand side, and as the blocks B, J, M, K, Z1 and Z2.
//! On the GPU path the system is the one that the device stored, widened: the system of the step.

mod coupled;
mod pressure;
mod solids;

use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Map, Value};

use super::bench::remove;
use crate::Error;
use crate::gpu::AdapterChoice;
use crate::linalg::{Csr, norm};
use crate::output::{FolderLock, write_atomically};
use crate::reference::{Reference, StepSystem};
use crate::scene::Scene;
use crate::sim::{Backend, GpuPath, reference_path};
use crate::state::{SolveReport, SolveStatus, StepReport};
use crate::step::Stage;

/// All that exports write, whatever the system; last what says of which system the others are.
const FILES: [&str; 17] = [
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
    "nodes.csv",
    "meta.json",
];

/// What to export.
#[derive(Clone, Debug)]
pub struct Options {
    /// Where the simulation runs.
    pub backend: Backend,
    /// Sub-step whose system it is, from 0 as in steps.csv.
    pub step: u64,
    /// The folder; made if absent. An earlier export in it is replaced.
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
    /// Numbers of liquid and solids: density (kg/m^3), closed_components (components without a free surface, each once singular), sigma, alpha,
    /// active_cells, nodes, elements, solids.
    #[serde(flatten)]
    pub part: Map<String, Value>,
    /// Relative tolerance that the simulator solved to.
    pub tolerance: f64,
    /// How its solve ended.
    pub status: &'static str,
    /// Rows of the matrix.
    pub unknowns: usize,
    /// Entries of the matrix, both triangles.
    pub entries: usize,
    /// ||b - A x|| / ||b|| of what was written.
    pub residual: f64,
}

/// A system of a sub-step with its answer, and the files beside it.
struct System {
    matrix: Csr,
    rhs: Vec<f64>,
    solution: Vec<f64>,
    /// What matrix, right-hand side and answer are, with units.
    comments: [&'static str; 3],
    /// Names and texts of other files.
    others: Vec<(&'static str, String)>,
    part: Value,
}

/// Matrices and vectors as files: name, kind, values, comment.
macro_rules! files {
    ($($name:literal $kind:ident $values:expr, $comment:literal;)*) => {
        vec![$(($name, $crate::measure::export::text::$kind($values, $comment))),*]
    };
}
use files;

/// Texts of Matrix Market files.
mod text {
    use crate::linalg::{Csr, Symmetry, matrix_text, vector_text};

    pub(super) fn symmetric(matrix: &Csr, comment: &str) -> String {
        matrix_text(matrix, Symmetry::Symmetric, comment)
    }

    pub(super) fn general(matrix: &Csr, comment: &str) -> String {
        matrix_text(matrix, Symmetry::General, comment)
    }

    pub(super) fn vector(values: &[f64], comment: &str) -> String {
        vector_text(values, comment)
    }
}

/// How a sub-step went.
struct Ran {
    /// s
    dt: f64,
    report: StepReport,
    adapter: Option<String>,
}

/// Runs a scene to a sub-step and writes that sub-step's system, in place of an earlier export, which stays where there is none to write.
///
/// # Errors
/// [`Error::Input`] where the folder holds a run, or files that the export would replace and that are not of an earlier one, or where another
/// process writes into it; whatever the simulation ends with, and [`Error::Output`].
pub fn export(scene: &Scene, options: &Options) -> Result<Meta, Error> {
    let out = &options.out;
    // First, since the simulation can take long.
    ensure_replaceable(out)?;
    let (system, ran) = match (scene.liquid.is_some(), scene.solids.is_empty()) {
        (_, true) => pressure::system(scene, options)?,
        (false, false) => solids::system(scene, options)?,
        (true, false) => coupled::system(scene, options)?,
    };
    let status = status(&ran.report);
    if matches!(status, SolveStatus::Breakdown | SolveStatus::NonFinite) {
        return Err(Error::Stage {
            stage: "solve",
            step: options.step,
            problem: format!(
                "the solve ended with {}: there is no system to write",
                status.name()
            ),
        });
    }
    let rhs_norm = norm(&system.rhs);
    let residual = norm(&residual(&system));
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
        residual: if rhs_norm > 0.0 {
            residual / rhs_norm
        } else {
            0.0
        },
    };
    let [of_matrix, of_rhs, of_solution] = system.comments;
    let json = serde_json::to_string_pretty(&meta).expect("the record has no maps") + "\n";
    let mut files = vec![
        ("spd.mtx", text::symmetric(&system.matrix, of_matrix)),
        ("spd_rhs.mtx", text::vector(&system.rhs, of_rhs)),
        ("solution.mtx", text::vector(&system.solution, of_solution)),
    ];
    files.extend(system.others);
    files.push(("meta.json", json));
    let _held = FolderLock::take(out)?;
    // Another process may have been here.
    ensure_replaceable(out)?;
    FILES.iter().try_for_each(|file| remove(&out.join(file)))?;
    for (name, text) in files {
        write_atomically(&out.join(name), text.as_bytes())?;
    }
    Ok(meta)
}

/// Refuses a folder that holds something else than an earlier export: nobody knows whose its files are.
fn ensure_replaceable(out: &Path) -> Result<(), Error> {
    let refused = |name: &str, problem: &str, cure: &str| {
        let what = out.join(name).display().to_string();
        Err(Error::input(what, problem, cure))
    };
    let manifest = "manifest.json";
    if out.join(manifest).exists() {
        let cure = "choose another folder with --out";
        return refused(manifest, "the folder holds a run", cure);
    }
    if is_meta(&out.join("meta.json")) {
        return Ok(());
    }
    match FILES.iter().find(|name| out.join(name).exists()) {
        Some(name) => refused(
            name,
            "the export would replace it, and no meta.json says that it is of an earlier one",
            "choose another folder with --out, or remove by hand what is in this one",
        ),
        None => Ok(()),
    }
}

/// Whether a file is the meta.json of an export, of this version or another.
fn is_meta(path: &Path) -> bool {
    let text = fs::read(path).unwrap_or_default();
    let meta: Value = serde_json::from_slice(&text).unwrap_or_default();
    let keys = ["cutwater", "step", "unknowns", "residual"];
    keys.iter().all(|key| meta.get(key).is_some())
}

/// b - A x
fn residual(system: &System) -> Vec<f64> {
    let mut product = vec![0.0; system.rhs.len()];
    system.matrix.multiply(&system.solution, &mut product);
    let pairs = system.rhs.iter().zip(product);
    pairs.map(|(b, product)| b - product).collect()
}

/// How the one solve of a sub-step ended.
fn status(report: &StepReport) -> SolveStatus {
    let liquid = report.liquid.map(|liquid| liquid.solve);
    let solid = report.solid.map(|solid| solid.solve);
    let solve = liquid.or(solid);
    solve.map_or(SolveStatus::Converged, |SolveReport { status, .. }| status)
}

/// Runs the GPU path to a sub-step and takes something off it after one of that sub-step's stages. `take`: given a stage that is over and
/// the length of the sub-step, s; it answers at the solve at the latest.
fn on_gpu<T>(
    scene: &Scene,
    choice: &AdapterChoice,
    step: u64,
    mut take: impl FnMut(Stage, &GpuPath, f64) -> Result<Option<T>, Error>,
) -> Result<(T, Ran), Error> {
    let mut path = GpuPath::open(scene, choice)?;
    loop {
        let clock = path.clock();
        ensure_within(scene, step, (clock.step, clock.frame))?;
        let dt = path.next_time_step().dt;
        let wanted = clock.step == step;
        let mut taken = None;
        let report = path.step_observed(&mut |stage, path| {
            if wanted && taken.is_none() {
                taken = take(stage, path, dt)?;
            }
            Ok(())
        })?;
        if let Some(taken) = taken {
            let adapter = Some(path.gpu().report().name.clone());
            return Ok((
                taken,
                Ran {
                    dt,
                    report,
                    adapter,
                },
            ));
        }
    }
}

/// Runs the f64 path to a sub-step and takes its system; the path is left after it.
fn on_cpu<T>(
    scene: &Scene,
    step: u64,
    mut take: impl FnMut(StepSystem) -> Option<T>,
) -> Result<(T, Ran, Reference), Error> {
    let mut path = reference_path(scene)?;
    loop {
        ensure_within(scene, step, (path.state().step, path.state().frame))?;
        let time_step = path.next_time_step();
        let wanted = path.state().step == step;
        let mut taken = None;
        let report = path.step_observed(time_step, &mut |system| {
            if wanted && taken.is_none() {
                taken = take(system);
            }
        })?;
        if let Some(taken) = taken {
            let ran = Ran {
                dt: time_step.dt,
                report,
                adapter: None,
            };
            return Ok((taken, ran, path));
        }
        if wanted {
            return Err(no_system_of_both(step));
        }
    }
}

/// Refuses to go on to a sub-step when the frames of a scene are over, after so many sub-steps and frames.
fn ensure_within(scene: &Scene, step: u64, (done, frame): (u64, u64)) -> Result<(), Error> {
    if frame < scene.n_frames() {
        return Ok(());
    }
    Err(Error::input(
        format!("--step {step}"),
        format!("the scene is over after {done} sub-steps"),
        format!(
            "choose one from 0 to {}, or let the scene last longer: --set time.duration=...",
            done.saturating_sub(1)
        ),
    ))
}

/// Liquid and solids are solved apart in a sub-step.
fn no_system_of_both(step: u64) -> Error {
    Error::input(
        format!("--step {step}"),
        "liquid and solids do not touch in this sub-step, so there is no system of both",
        "choose a sub-step in which `touching` of steps.csv is 1",
    )
}
