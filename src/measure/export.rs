//! `export`: the pressure system of one sub-step and its answer as Matrix Market files, for other solvers.
//!
//! ```text
//! DIR/spd.mtx       B, m^3/s per Pa: symmetric, positive definite but for components without a free surface
//! DIR/spd_rhs.mtx   E u*, m^3/s, with volume control and without the means over such components
//! DIR/solution.mtx  p as the simulator solved it, Pa; of mean zero over such components
//! DIR/cells.csv     which cell each row is
//! DIR/meta.json     dt, dx and the like
//! ```
//!
//! B p = E u* (design section 2). On the GPU path the system is the one that the device stored, widened: the system of the step.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::Error;
use crate::elastic::Solids;
use crate::geometry;
use crate::gpu::AdapterChoice;
use crate::linalg::{Csr, Symmetry, matrix_text, norm, vector_text};
use crate::output::write_atomically;
use crate::reference::{PressureSystem, Reference, StepSystem, right_hand_side};
use crate::scene::Scene;
use crate::sim::{Backend, GpuPath, LiquidSnapshot};
use crate::state::SolveStatus;

/// What to export.
#[derive(Clone, Debug)]
pub struct Options {
    /// Where the simulation runs.
    pub backend: Backend,
    /// Sub-step whose system it is, from 0 as in steps.csv.
    pub step: u64,
    /// The folder; made if absent.
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
    /// kg/m^3
    pub density: f64,
    /// Relative tolerance that the simulator solved to.
    pub tolerance: f64,
    /// How its solve ended.
    pub status: &'static str,
    /// Rows of the matrix.
    pub unknowns: usize,
    /// Entries of the matrix, both triangles.
    pub entries: usize,
    /// Components without a free surface: as many times is B singular.
    pub closed_components: usize,
    /// ||E u* - B p|| / ||E u*|| of what was written.
    pub residual: f64,
}

/// Why a sub-step reports of the liquid.
const LIQUID: &str = "the scene's liquid was asked for its density";

/// A system, its answer (Pa), and how it came about.
struct Solved {
    system: PressureSystem,
    pressure: Vec<f64>,
    dt: f64,
    status: SolveStatus,
    adapter: Option<String>,
}

/// Runs a scene to a sub-step and writes that sub-step's system.
///
/// # Errors
/// Whatever the simulation ends with, and [`Error::Output`].
pub fn export(scene: &Scene, options: &Options) -> Result<Meta, Error> {
    let density = density(scene)?;
    let solved = match &options.backend {
        Backend::Gpu(choice) => on_gpu(scene, choice, options.step)?,
        Backend::Cpu => on_cpu(scene, options.step)?,
    };
    let system = &solved.system;
    let cells = system.stencil.active_cells();
    let of_active = |field: &[f64]| cells.iter().map(|&cell| field[cell]).collect::<Vec<f64>>();
    let matrix = system.to_csr();
    let rhs_norm = norm(&system.rhs);
    let residual = norm(&system.residual(&solved.pressure));
    let grid = scene.grid();
    let meta = Meta {
        cutwater: env!("CARGO_PKG_VERSION"),
        scene: scene.name.clone(),
        scale: scene.scale,
        overrides: scene.overrides.clone(),
        backend: options.backend.name(),
        adapter: solved.adapter.clone(),
        step: options.step,
        dt: solved.dt,
        dx: grid.dx,
        cells: grid.cells,
        density,
        tolerance: scene.solver.tolerance,
        status: solved.status.name(),
        unknowns: cells.len(),
        entries: matrix.n_entries(),
        closed_components: system.closed.len(),
        residual: if rhs_norm > 0.0 {
            residual / rhs_norm
        } else {
            0.0
        },
    };
    let out = &options.out;
    std::fs::create_dir_all(out).map_err(|problem| Error::output(out, problem))?;
    write(
        out,
        &matrix,
        &of_active(&system.rhs),
        &of_active(&solved.pressure),
    )?;
    let mut table = String::from("row,i,j,k,x,y,z\n");
    for (row, &cell) in cells.iter().enumerate() {
        let [i, j, k] = grid.cell_at(cell);
        let x = grid.cell_centre([i, j, k]);
        table += &format!("{},{i},{j},{k},{:?},{:?},{:?}\n", row + 1, x.x, x.y, x.z);
    }
    write_atomically(&out.join("cells.csv"), table.as_bytes())?;
    let text = serde_json::to_string_pretty(&meta).expect("the record has no maps") + "\n";
    write_atomically(&out.join("meta.json"), text.as_bytes())?;
    Ok(meta)
}

fn write(out: &Path, matrix: &Csr, rhs: &[f64], pressure: &[f64]) -> Result<(), Error> {
    let names = "B, m^3/s per Pa; cells.csv says which cell a row is";
    for (name, text) in [
        ("spd.mtx", matrix_text(matrix, Symmetry::Symmetric, names)),
        ("spd_rhs.mtx", vector_text(rhs, "E u*, m^3/s")),
        ("solution.mtx", vector_text(pressure, "p, Pa")),
    ] {
        write_atomically(&out.join(name), text.as_bytes())?;
    }
    Ok(())
}

/// kg/m^3
fn density(scene: &Scene) -> Result<f64, Error> {
    let liquid = scene.liquid.as_ref().ok_or_else(|| {
        Error::input(
            scene.file.display().to_string(),
            "the scene has no liquid, so there is no pressure",
            "add a [liquid] section with a region",
        )
    })?;
    Ok(liquid.density)
}

fn on_gpu(scene: &Scene, choice: &AdapterChoice, step: u64) -> Result<Solved, Error> {
    let mut path = GpuPath::open(scene, choice)?;
    loop {
        let dt = path.next_time_step().dt;
        let wanted = path.clock().step == step;
        let mut solved = None;
        let report = path.step_observed(&mut |stage, path| {
            if wanted && stage == "solve" {
                solved = path.snapshot()?.liquid;
            }
            Ok(())
        })?;
        if let Some(snapshot) = solved {
            return Ok(Solved {
                adapter: Some(path.gpu().report().name.clone()),
                status: report.liquid.expect(LIQUID).solve.status,
                ..stored(scene, &path, &snapshot, dt)?
            });
        }
    }
}

/// The system in the device's memory, in SI units.
fn stored(
    scene: &Scene,
    path: &GpuPath,
    snapshot: &LiquidSnapshot,
    dt: f64,
) -> Result<Solved, Error> {
    let grid = scene.grid();
    let (area, density) = (grid.dx * grid.dx, density(scene)?);
    let active = snapshot.active_cells(&grid);
    let open = &path.cut_cells().open;
    let mut rhs = right_hand_side(&grid, open, &snapshot.velocity_next, &active, None);
    rhs.values = snapshot.rhs.iter().map(|b| area * b).collect();
    let mut system = PressureSystem::new(active, rhs, dt, density);
    let mut values = std::mem::take(&mut system.rhs);
    // What rounding to f32 left of them, where the device has no f64.
    system.remove_closed_means(&mut values);
    system.rhs = values;
    let pascal = density * grid.dx / dt;
    let potential = snapshot.potential.iter();
    Ok(Solved {
        system,
        pressure: potential.map(|potential| pascal * potential).collect(),
        dt,
        status: SolveStatus::Converged,
        adapter: None,
    })
}

fn on_cpu(scene: &Scene, step: u64) -> Result<Solved, Error> {
    let grid = scene.grid();
    let cut = geometry::cut_cells(scene, &grid)?;
    let state = geometry::initial_state(scene, &grid, &cut)?;
    let mut path = Reference::new(scene, cut, Solids::default(), state)?;
    loop {
        let time_step = path.next_time_step();
        let wanted = path.state().step == step;
        let mut solved = None;
        let report = path.step_observed(time_step, &mut |of_step| {
            if let (StepSystem::Pressure(system, pressure), true) = (of_step, wanted) {
                solved = Some((system.clone(), pressure.to_vec()));
            }
        })?;
        if let Some((system, pressure)) = solved {
            return Ok(Solved {
                system,
                pressure,
                dt: time_step.dt,
                status: report.liquid.expect(LIQUID).solve.status,
                adapter: None,
            });
        }
    }
}
