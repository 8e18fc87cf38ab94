//! `compare`: every stage of every sub-step of the GPU path against its f64 twin, from the same inputs.
//!
//! After each stage the fields of the device are read back and widened to f64, which is exact. The twin computes from the fields before the stage,
//! and its result is compared with the fields after it. So differences do not accumulate: each is the rounding of one stage. Its bound is k 2^-24
//! times the size of the rounded number, for k roundings. A division counts as 5: WGSL allows 2.5 units in the last place.
//!
//! Some results are discontinuous, such as the cell of a marker near a grid plane. If they differ, the twin runs again with its input moved by its
//! rounding. If it then has the GPU's result, the number is excused: counted, but not compared. Otherwise it is a breach. So are more than
//! [`MOST_EXCUSED`] excused numbers in a row of the table: a twin that is wrong everywhere must not pass.

mod liquid;
mod solids;
mod table;

pub use table::{MOST_EXCUSED, Place, Row, Worst};

use super::bounds::EPS;
use super::stored;
use crate::Error;
use crate::effects::Effects;
use crate::elastic::{Cavities, Solids};
use crate::fields::CouplingReport;
use crate::geometry::SolidClip;
use crate::gpu::{AdapterChoice, Real};
use crate::reference::{TimeStep, pressure_gradient};
use crate::scene::{CouplingScheme, PatchPressure, Scene};
use crate::sim::{GpuPath, LiquidSnapshot, Snapshot, SolidSnapshot};
use crate::step::Stage;
use glam::DVec3;
use liquid::LiquidComparison;
use solids::SolidComparison;

/// Result of a comparison.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// A row per quantity, in the order of the stages.
    pub rows: Vec<Row>,
    /// Sub-steps compared.
    pub steps: u64,
    /// Name of the adapter.
    pub adapter: String,
}

impl Comparison {
    /// # Errors
    /// [`Error::Check`] with the worst row where rounding does not explain a difference, and with the row of most excuses where these are more than
    /// [`MOST_EXCUSED`].
    pub fn verdict(&self) -> Result<(), Error> {
        let n = self.rows.len();
        let mut problems = Vec::new();
        let differing = || self.rows.iter().filter(|row| row.ratio() > 1.0);
        if let Some(&Row { stage, quantity, unit, worst: Some(worst), .. }) =
            differing().max_by(|a, b| a.ratio().total_cmp(&b.ratio()))
        {
            let Worst { gpu, twin, bound, place, step } = worst;
            let differ = differing().count();
            problems.push(format!(
                "{differ} of {n} quantities differ by more than rounding explains; the worst is {quantity} of {stage}: \
                 {gpu:e} {unit} on the GPU, {twin:e} {unit} in the twin, bound {bound:e} {unit}, sub-step {step}, {place}"
            ));
        }
        let excusing = || self.rows.iter().filter(|row| row.excuses_too_much());
        if let Some(row @ Row { stage, quantity, excused, count, .. }) = excusing().max_by_key(|row| row.excused) {
            let (rows, most) = (excusing().count(), row.most_excused());
            problems.push(format!(
                "{rows} of {n} quantities leave out more numbers than can hang on a rounding; the worst is {quantity} of {stage}: \
                 {excused} excused and {count} compared, {most} may be"
            ));
        }
        if problems.is_empty() { Ok(()) } else { Err(Error::Check(problems.join("; "))) }
    }
}

/// Receives every snapshot with its stage.
pub type Listener<'a> = &'a mut dyn FnMut(Stage, &mut Snapshot);

/// Runs the GPU path for some frames and compares each stage. `listen` receives every snapshot before it is compared, with its stage. Its changes
/// are compared as if they came from the device, but are no input of the next twin.
///
/// # Errors
/// [`Error::Input`] for coupling other than strong; errors of the simulation. A breach is no error here: see [`Comparison::verdict`].
pub fn compare(scene: &Scene, frames: u64, adapter: &AdapterChoice, listen: Listener) -> Result<Comparison, Error> {
    if Effects::of(scene).coupling && scene.solver.coupling != CouplingScheme::Strong {
        return Err(Error::input(
            scene.file.display().to_string(),
            "solver.coupling other than \"strong\" has no comparison stage by stage",
            "add --set solver.coupling=strong, or compare a run with one of --backend cpu",
        ));
    }
    let mut path = GpuPath::open(scene, adapter)?;
    let start = path.snapshot()?;
    let mut twins = Twins {
        scene,
        liquid: start.liquid.map(|liquid| LiquidComparison::new(scene, &path, liquid)),
        solids: start.solids.map(|solids| SolidComparison::new(scene, &path, solids)),
        clip: path.clip().cloned(),
        slopes: Vec::new(),
        time_step: TimeStep::NONE,
    };
    while path.clock().frame < frames {
        // In the sub-step markers keep their slots.
        let moved = path.make_room()?;
        twins.time_step = path.next_time_step();
        if let Some(twin) = &mut twins.liquid {
            twin.begin(&path, twins.time_step, moved)?;
        }
        if let Some(twin) = &mut twins.solids {
            twin.begin(&path, twins.time_step);
        }
        path.step_observed(&mut |stage, path| match stage {
            // The f64 path labels enclosed components with the active cells.
            Stage::ActiveCells => Ok(()),
            Stage::ClosedComponents => twins.stage(Stage::ActiveCells, path, listen),
            stage => twins.stage(stage, path, listen),
        })?;
    }
    let liquid = twins.liquid.into_iter().flat_map(|twin| twin.table.rows);
    let solids = twins.solids.into_iter().flat_map(|twin| twin.table.rows);
    Ok(Comparison {
        rows: liquid.chain(solids).collect(),
        steps: path.clock().step,
        adapter: path.gpu().report().name.clone(),
    })
}

/// The twins of a scene.
struct Twins<'a> {
    scene: &'a Scene,
    liquid: Option<LiquidComparison<'a>>,
    solids: Option<SolidComparison<'a>>,
    /// The twin of `clip`, an input of other twins.
    clip: Option<SolidClip>,
    /// Gradients of the pressure within the cells with patches, Pa/m.
    slopes: Vec<DVec3>,
    time_step: TimeStep,
}

impl Twins<'_> {
    /// Compares the fields after a stage.
    fn stage(&mut self, stage: Stage, path: &GpuPath, listen: Listener) -> Result<(), Error> {
        let device = path.snapshot()?;
        let mut after = device.clone();
        listen(stage, &mut after);
        if stage == Stage::Clip {
            self.clip(path, &device);
        }
        let clip = self.clip.as_ref();
        let both = || {
            Some(Both {
                clip: clip?,
                at_rest: path.solids()?,
                cavities: path.cavities()?,
                liquid: after.liquid.as_ref()?,
                solids: after.solids.as_ref()?,
                slopes: &self.slopes,
                report: after.coupling,
            })
        };
        let both = both();
        let both = both.as_ref();
        if let (Some(twin), Some(after), Some(device)) = (&mut self.liquid, &after.liquid, device.liquid) {
            if stage == Stage::Solve {
                twin.release(after, clip, both);
                if let (Some(both), Some(solids)) = (both.filter(|both| both.touch()), &mut self.solids)
                    && let Some(systems) = twin.systems(after, both)
                {
                    solids.assembly(both, systems)?;
                }
            }
            twin.compare(stage, after, clip, both)?;
            twin.before = device;
        }
        if let (Some(twin), Some(after), Some(device)) = (&mut self.solids, &after.solids, device.solids) {
            twin.compare(stage, after, both)?;
            twin.before = device;
        }
        Ok(())
    }

    /// The twin of `clip`, from the displacements of the device, and the gradients of the pressure of the last sub-step.
    fn clip(&mut self, path: &GpuPath, device: &Snapshot) {
        let Some(clip) = &mut self.clip else { return };
        clip.move_obstacles(path.clock().time + self.time_step.dt, self.time_step.dt);
        let snapshots = device.liquid.as_ref().zip(device.solids.as_ref());
        let Some(((before, held), solids)) = snapshots.zip(path.solids()) else { return };
        clip.clip(&solids.moved(&held.displacement));
        let (scene, grid, dt_last) = (self.scene, self.scene.grid(), path.last_step());
        let density = scene.liquid.as_ref().map_or(0.0, |liquid| liquid.density);
        let at_rest = (density * path.gravity(self.time_step)).as_vec3().as_dvec3();
        let kind = scene.solver.pressure_on_patches;
        // Cells without patches do not count.
        self.slopes = vec![if kind == PatchPressure::Cell { DVec3::ZERO } else { at_rest }; grid.n_cells()];
        if kind == PatchPressure::Gradient {
            let pascal = if dt_last > 0.0 { density * grid.dx / dt_last } else { 0.0 };
            let pressure: Vec<f64> = before.potential.iter().map(|phi| pascal * phi).collect();
            let (open, active) = (&clip.cut_cells().open, &before.active);
            for (cell, _) in clip.coupling().cells() {
                self.slopes[cell] = pressure_gradient(&grid, open, active, &pressure, at_rest, cell);
            }
        }
    }
}

/// The corners of a cube about the origin, with coordinates of 1 and -1.
fn corners() -> impl Iterator<Item = DVec3> {
    (0..8).map(|corner| DVec3::from([0, 1, 2].map(|axis| f64::from(corner >> axis & 1) * 2.0 - 1.0)))
}

/// Liquid and solids of a scene after a stage.
struct Both<'a> {
    /// Twin of the clipping, from the displacements of the device.
    clip: &'a SolidClip,
    /// The solids at rest.
    at_rest: &'a Solids,
    /// Cavities, and their targets before the solve, m^3.
    cavities: (&'a Cavities, &'a [f64]),
    liquid: &'a LiquidSnapshot,
    solids: &'a SolidSnapshot,
    /// Gradients of the pressure within the cells with patches, Pa/m.
    slopes: &'a [DVec3],
    /// Report of the device.
    report: Option<CouplingReport>,
}

impl Both<'_> {
    /// Whether a patch lies in an active cell.
    fn touch(&self) -> bool {
        stored::touches(self.clip.coupling(), self.liquid)
    }

    /// J v of the cells over dx^2, m/s, 0 in inactive cells; the same with magnitudes; and J v of the constrained part of v.
    fn flux(&self, dx: f64, active: &[bool]) -> [Vec<f64>; 3] {
        let mut sums = [(); 3].map(|()| vec![0.0; active.len()]);
        for pair in self.clip.coupling().pairs().iter().filter(|pair| active[pair.cell]) {
            let value = pair.value / (dx * dx);
            let v = DVec3::from(self.solids.velocity[pair.node]);
            let constrained = v - self.solids.freedom[pair.node].projector * v;
            sums[0][pair.cell] += value.dot(v);
            sums[1][pair.cell] += value.abs().dot(v.abs());
            sums[2][pair.cell] += value.dot(constrained);
        }
        sums
    }

    /// J^T p of the nodes, N, and the same with magnitudes. `pascal`: pressure of a potential of 1 m/s, Pa.
    fn force(&self, pascal: f64) -> [Vec<DVec3>; 2] {
        let mut sums = [(); 2].map(|()| vec![DVec3::ZERO; self.solids.velocity.len()]);
        for pair in self.clip.coupling().pairs().iter().filter(|pair| self.liquid.active[pair.cell]) {
            let force = pascal * self.liquid.potential[pair.cell] * pair.value;
            sums[0][pair.node] += force;
            sums[1][pair.node] += force.abs();
        }
        sums
    }
}

/// Largest relative rounding error of a scalar type.
fn unit(real: Real) -> f64 {
    match real {
        Real::F32 => EPS,
        // Twice that of f64: it is negligible.
        Real::F64 => f64::EPSILON,
    }
}

/// Values after rounding to f32.
fn rounded_to_f32(values: &[f64]) -> Vec<f64> {
    values.iter().map(|&value| f64::from(value as f32)).collect()
}

/// Largest value of a list of numbers that are not negative; 0 of none.
fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, f64::max)
}
