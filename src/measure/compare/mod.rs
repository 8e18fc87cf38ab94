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
    /// The row with the largest difference over its bound.
    pub fn worst(&self) -> Option<&Row> {
        self.rows.iter().max_by(|a, b| a.ratio().total_cmp(&b.ratio()))
    }

    /// # Errors
    /// [`Error::Check`] with the worst row where rounding does not explain a difference, and with the row of most excuses where these are more than
    /// [`MOST_EXCUSED`].
    pub fn verdict(&self) -> Result<(), Error> {
        let n = self.rows.len();
        let mut problems = Vec::new();
        if let Some(&Row { stage, quantity, unit, worst: Some(worst), .. }) =
            self.worst().filter(|row| row.ratio() > 1.0)
        {
            let Worst { gpu, twin, bound, place, step } = worst;
            let differ = self.rows.iter().filter(|row| row.ratio() > 1.0).count();
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

/// Runs the GPU path for some frames and compares each stage. `listen` receives every snapshot before it is compared, with its stage. Its changes
/// are compared as if they came from the device, but are no input of the next twin.
///
/// # Errors
/// [`Error::Input`] for coupling other than strong; errors of the simulation. A breach is no error here: see [`Comparison::verdict`].
pub fn compare(
    scene: &Scene,
    frames: u64,
    adapter: &AdapterChoice,
    listen: &mut dyn FnMut(Stage, &mut Snapshot),
) -> Result<Comparison, Error> {
    if Effects::of(scene).coupling && scene.solver.coupling != CouplingScheme::Strong {
        return Err(Error::input(
            scene.file.display().to_string(),
            "solver.coupling other than \"strong\" has no comparison stage by stage",
            "add --set solver.coupling=strong, or compare a run with one of --backend cpu",
        ));
    }
    let mut path = GpuPath::open(scene, adapter)?;
    let mut twins = Twins::new(scene, &path)?;
    while path.clock().frame < frames {
        // In the sub-step markers keep their slots.
        let moved = path.make_room()?;
        twins.begin(&path, path.next_time_step(), moved)?;
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
    /// End of the sub-step, its length and that of the last one, s.
    end: f64,
    dt: f64,
    dt_last: f64,
    /// Mean over the sub-step, m/s^2.
    gravity: DVec3,
}

impl<'a> Twins<'a> {
    fn new(scene: &'a Scene, path: &GpuPath) -> Result<Twins<'a>, Error> {
        Ok(Twins {
            scene,
            liquid: LiquidComparison::new(scene, path)?,
            solids: SolidComparison::new(scene, path)?,
            clip: path.clip().cloned(),
            slopes: Vec::new(),
            end: 0.0,
            dt: 0.0,
            dt_last: 0.0,
            gravity: DVec3::ZERO,
        })
    }

    /// Begins a sub-step. `moved`: markers have other slots than after the last one.
    fn begin(&mut self, path: &GpuPath, time_step: TimeStep, moved: bool) -> Result<(), Error> {
        let dt = time_step.dt;
        (self.dt_last, self.dt, self.end) = (self.dt, dt, path.clock().time + dt);
        self.gravity = path.gravity(time_step);
        if let Some(twin) = &mut self.liquid {
            twin.begin(path, time_step, moved)?;
        }
        if let Some(twin) = &mut self.solids {
            twin.begin(path, dt, self.gravity);
        }
        Ok(())
    }

    /// Compares the fields after a stage.
    fn stage(
        &mut self,
        stage: Stage,
        path: &GpuPath,
        listen: &mut dyn FnMut(Stage, &mut Snapshot),
    ) -> Result<(), Error> {
        let device = path.snapshot()?;
        let mut after = device.clone();
        listen(stage, &mut after);
        if stage == Stage::Clip {
            self.clip(path, &device);
        }
        let (clip, slopes, report) = (self.clip.as_ref(), &self.slopes[..], after.coupling);
        let bodies = clip.zip(path.solids()).zip(path.cavities());
        let both = after.liquid.as_ref().zip(after.solids.as_ref()).zip(bodies);
        let both = both.map(|((liquid, solids), ((clip, at_rest), cavities))| Both {
            clip,
            at_rest,
            cavities,
            liquid,
            solids,
            slopes,
            report,
        });
        let both = both.as_ref();
        if let (Some(twin), Some(after)) = (&mut self.liquid, &after.liquid) {
            if stage == Stage::Solve {
                twin.release(after, clip, both);
                if let (Some(both), Some(solids)) = (both.filter(|both| both.touch()), &mut self.solids)
                    && let Some(systems) = twin.systems(after, both)
                {
                    solids.assembly(both, systems)?;
                }
            }
            twin.compare(stage, after, device.liquid, clip, both)?;
        }
        if let (Some(twin), Some(after)) = (&mut self.solids, &after.solids) {
            twin.compare(stage, after, device.solids, both)?;
        }
        Ok(())
    }

    /// The twin of `clip`, from the displacements of the device.
    fn clip(&mut self, path: &GpuPath, device: &Snapshot) {
        let Some(clip) = &mut self.clip else { return };
        clip.move_obstacles(self.end, self.dt);
        let snapshots = device.liquid.as_ref().zip(device.solids.as_ref());
        if let Some(((liquid, held), solids)) = snapshots.zip(path.solids()) {
            clip.clip(&solids.moved(&held.displacement));
            self.slopes = slopes(self.scene, clip, liquid, (self.gravity, self.dt_last));
        }
    }
}

/// Gradients of the pressure within cells, Pa/m; those of cells without patches do not count. `before`: the liquid before the sub-step; `dt_last`:
/// length of the last one, s.
fn slopes(scene: &Scene, clip: &SolidClip, before: &LiquidSnapshot, (gravity, dt_last): (DVec3, f64)) -> Vec<DVec3> {
    let grid = scene.grid();
    let density = scene.liquid.as_ref().map_or(0.0, |liquid| liquid.density);
    let at_rest = (density * gravity).as_vec3().as_dvec3();
    let kind = scene.solver.pressure_on_patches;
    let mut slopes = vec![if kind == PatchPressure::Cell { DVec3::ZERO } else { at_rest }; grid.n_cells()];
    if kind == PatchPressure::Gradient {
        let pascal = if dt_last > 0.0 { density * grid.dx / dt_last } else { 0.0 };
        let pressure: Vec<f64> = before.potential.iter().map(|phi| pascal * phi).collect();
        let (open, active) = (&clip.cut_cells().open, &before.active);
        for (cell, _) in clip.coupling().cells() {
            slopes[cell] = pressure_gradient(&grid, open, active, &pressure, at_rest, cell);
        }
    }
    slopes
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

    /// J v of the cells over dx^2, m/s, 0 in inactive cells; and the same with magnitudes.
    fn flux(&self, dx: f64, active: &[bool]) -> [Vec<f64>; 2] {
        self.flux_of(dx, active, |_, v| v)
    }

    /// J v of the constrained part of v, likewise.
    fn constrained_flux(&self, dx: f64, active: &[bool]) -> Vec<f64> {
        let [flux, _] = self.flux_of(dx, active, |node, v| v - self.solids.freedom[node].projector * v);
        flux
    }

    /// The same of a part of each node's velocity.
    fn flux_of(&self, dx: f64, active: &[bool], part: impl Fn(usize, DVec3) -> DVec3) -> [Vec<f64>; 2] {
        let mut sums = [(); 2].map(|()| vec![0.0; active.len()]);
        for pair in self.clip.coupling().pairs().iter().filter(|pair| active[pair.cell]) {
            let value = pair.value / (dx * dx);
            let v = part(pair.node, self.solids.velocity[pair.node].into());
            sums[0][pair.cell] += value.dot(v);
            sums[1][pair.cell] += value.abs().dot(v.abs());
        }
        sums
    }

    /// J^T p of the nodes, N, three numbers each, and the same with magnitudes. `pascal`: pressure of a potential of 1 m/s, Pa.
    fn force(&self, pascal: f64) -> [Vec<f64>; 2] {
        let mut sums = [(); 2].map(|()| vec![0.0; 3 * self.solids.velocity.len()]);
        for pair in self.clip.coupling().pairs() {
            if self.liquid.active[pair.cell] {
                let force = pascal * self.liquid.potential[pair.cell] * pair.value;
                for axis in 0..3 {
                    sums[0][3 * pair.node + axis] += force[axis];
                    sums[1][3 * pair.node + axis] += force[axis].abs();
                }
            }
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

#[cfg(test)]
mod tests {
    use super::table::Table;
    use super::*;
    use crate::grid::Grid;

    /// Rows with so many numbers compared, all equal, and so many excused.
    fn comparison(rows: &[(&'static str, u64, u64)]) -> Comparison {
        let mut table = Table::new(Grid { cells: [1; 3], dx: 1.0 });
        table.stage = "forces";
        for &(quantity, count, excused) in rows {
            let numbers = (0..count).map(|_| (1.0, 1.0, 0.0, Place::Whole));
            table.add([quantity, "m/s"], numbers);
            table.row([quantity, "m/s"]).excused = excused;
        }
        Comparison { rows: table.rows, steps: 1, adapter: String::new() }
    }

    #[test]
    fn excuses_have_a_cap() {
        // A single decision may hang on a rounding however few there are; of 10,000 numbers, 20.
        let within = comparison(&[("a", 10_000, 0), ("b", 9_980, 20), ("c", 3, 1)]);
        assert!(within.verdict().is_ok(), "{:?}", within.verdict());
        for (beyond, told) in [
            ((9_979, 21), "b of forces: 21 excused and 9979 compared, 20 may be"),
            ((100, 2), "b of forces: 2 excused and 100 compared, 1 may be"),
            ((0, 1), "b of forces: 1 excused and 0 compared"),
            ((0, 5_000), "b of forces: 5000 excused and 0 compared"),
        ] {
            let spoilt = comparison(&[("a", 10_000, 0), ("b", beyond.0, beyond.1), ("c", 3, 1)]);
            let breached: Vec<bool> = spoilt.rows.iter().map(Row::breached).collect();
            assert_eq!(breached, [false, true, false]);
            let error = spoilt.verdict().unwrap_err();
            assert_eq!(error.exit_code(), 1);
            let message = error.to_string();
            assert!(message.contains("1 of 3 quantities leave out") && message.contains(told), "{message}");
        }
    }

    /// One is not hidden behind the other.
    #[test]
    fn differences_and_excuses_are_both_reported() {
        let mut both = comparison(&[("a", 10, 0), ("b", 10, 7)]);
        both.rows[0].worst = Some(Worst { gpu: f64::NAN, twin: 1.0, bound: 1.0, place: Place::Whole, step: 4 });
        let message = both.verdict().unwrap_err().to_string();
        for told in ["the worst is a of forces: NaN m/s", "sub-step 4", "b of forces: 7 excused"] {
            assert!(message.contains(told), "{told}: {message}");
        }
    }
}
