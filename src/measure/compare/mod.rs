//! `compare`: every stage of every sub-step of the GPU path against its f64 twin, from the same inputs.
//!
//! After each stage the device's fields are downloaded and widened to f64, which is exact. The twin gets what the stage had
//! before it, and its answer is compared with what the stage left. So differences do not pile up: each is the rounding of one
//! stage, and its bound is that stage's roundings counted, k 2^-24 times the size of what is rounded. Where a division counts, it
//! counts for 5: WGSL allows 2.5 units in the last place.
//!
//! Some answers jump: whether a marker is in one cell or the next, whether a face is near enough to an obstacle to slip. Where
//! the two paths decide differently, and moving the input by its rounding makes the twin decide as the GPU did, the number is
//! counted as excused and left out; in all other cases it is a breach. So it is where more than [`MOST_EXCUSED`] of a row are excused: a
//! rounding decides rarely, and a twin that is wrong everywhere must not pass as one that was never compared.

mod liquid;
mod solids;
mod table;

pub use table::{MOST_EXCUSED, Place, Row, Worst};

use super::bounds::EPS;
use crate::Error;
use crate::effects::Effects;
use crate::elastic::Solids;
use crate::fields::CouplingReport;
use crate::geometry::SolidClip;
use crate::gpu::{AdapterChoice, Real};
use crate::reference::pressure_gradient;
use crate::scene::{CouplingScheme, PatchPressure, Scene};
use crate::sim::{GpuPath, LiquidSnapshot, Snapshot, SolidSnapshot};
use crate::step::Stage;
use glam::DVec3;
use liquid::LiquidJudge;
use solids::SolidJudge;

/// What came out.
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
        self.rows
            .iter()
            .max_by(|a, b| a.ratio().total_cmp(&b.ratio()))
    }

    /// # Errors
    /// [`Error::Check`] with the worst row, where a difference is larger than rounding explains, and with the row that excuses most, where
    /// that is more than [`MOST_EXCUSED`].
    pub fn verdict(&self) -> Result<(), Error> {
        let n = self.rows.len();
        let mut problems = Vec::new();
        if let Some((row, worst)) = self
            .worst()
            .filter(|row| row.ratio() > 1.0)
            .and_then(|row| Some((row, row.worst?)))
        {
            let differ = self.rows.iter().filter(|row| row.ratio() > 1.0).count();
            problems.push(format!(
                "{differ} of {n} quantities differ by more than rounding explains; the worst is {} of {}: {:e} {unit} on the GPU, \
                 {:e} {unit} in the twin, bound {:e} {unit}, sub-step {}, {}",
                row.quantity,
                row.stage,
                worst.gpu,
                worst.twin,
                worst.bound,
                worst.step,
                worst.place,
                unit = row.unit,
            ));
        }
        let excusing = || self.rows.iter().filter(|row| row.excuses_too_much());
        if let Some(row) = excusing().max_by_key(|row| row.excused) {
            problems.push(format!(
                "{} of {n} quantities leave out more numbers than can hang on a rounding; the worst is {} of {}: {} excused and {} compared, \
                 {} may be",
                excusing().count(),
                row.quantity,
                row.stage,
                row.excused,
                row.count,
                row.most_excused(),
            ));
        }
        match problems.is_empty() {
            true => Ok(()),
            false => Err(Error::Check(problems.join("; "))),
        }
    }
}

/// Runs the GPU path for some frames and compares each stage. `listen` hears of every snapshot before it is judged, with the
/// stage's name; what it changes there is judged as if it came from the device, and not handed to the next twin.
///
/// # Errors
/// [`Error::Input`] for coupling other than strong; whatever the simulation ends with. A breach is no error here: see [`Comparison::verdict`].
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
    let mut liquid = LiquidJudge::new(scene, &path)?;
    let mut solids = SolidJudge::new(scene, &path)?;
    // The twin of `clip`, for the others.
    let mut clip = path.clip().cloned();
    let mut slopes = Vec::new();
    let mut dt_last = 0.0;
    while path.clock().frame < frames {
        let time_step = path.next_time_step();
        let dt = time_step.dt;
        let end = path.clock().time + dt;
        if let Some(judge) = &mut liquid {
            judge.begin(&path, time_step);
        }
        if let Some(judge) = &mut solids {
            judge.begin(&path, dt);
        }
        path.step_observed(&mut |stage, path| {
            // The f64 path finds enclosed components with the active cells.
            let stage = match stage {
                Stage::ActiveCells => return Ok(()),
                Stage::ClosedComponents => Stage::ActiveCells,
                stage => stage,
            };
            let held = path.snapshot()?;
            let mut after = held.clone();
            listen(stage, &mut after);
            if let (Stage::Clip, Some(clip)) = (stage, &mut clip) {
                clip.move_obstacles(end, dt);
            }
            if let (
                Stage::Clip,
                Some(clip),
                Some(solids),
                Snapshot {
                    liquid: Some(liquid),
                    solids: Some(held),
                    ..
                },
            ) = (stage, &mut clip, path.solids(), &held)
            {
                clip.clip(&solids.moved(&held.displacement));
                slopes = slopes_of(scene, clip, liquid, dt_last);
            }
            let both = after.liquid.as_ref().zip(after.solids.as_ref());
            let both = both.zip(clip.as_ref().zip(path.solids()));
            let both = both.map(|((liquid, solids), (clip, at_rest))| Both {
                clip,
                at_rest,
                liquid,
                solids,
                slopes: &slopes,
                told: after.coupling,
            });
            let density = scene.liquid.as_ref().map_or(0.0, |liquid| liquid.density);
            let together = both
                .as_ref()
                .filter(|both| stage == Stage::Solve && both.touch());
            if let (Some(both), Some(of_liquid), Some(judge)) = (together, &liquid, &mut solids)
                && let Some(parts) = of_liquid.systems(both.liquid, both)
            {
                judge.assembly(both.solids, both, density, parts)?;
            }
            if let (Some(judge), Some(after)) = (&mut liquid, &after.liquid) {
                judge.judge(stage, after, held.liquid, clip.as_ref(), both.as_ref())?;
            }
            if let (Some(judge), Some(after)) = (&mut solids, &after.solids) {
                judge.judge(stage, after, held.solids, both.as_ref())?;
            }
            Ok(())
        })?;
        dt_last = dt;
    }
    let liquid = liquid.into_iter().flat_map(|judge| judge.table.rows);
    let rows = liquid.chain(solids.into_iter().flat_map(|judge| judge.table.rows));
    Ok(Comparison {
        rows: rows.collect(),
        steps: path.clock().step,
        adapter: path.gpu().report().name.clone(),
    })
}

/// Gradients of the pressure within cells, Pa/m, those without patches left out; `before`: the liquid before a sub-step, `dt_last`: the
/// length of the last one, s.
fn slopes_of(scene: &Scene, clip: &SolidClip, before: &LiquidSnapshot, dt_last: f64) -> Vec<DVec3> {
    let grid = scene.grid();
    let density = scene.liquid.as_ref().map_or(0.0, |liquid| liquid.density);
    let at_rest = (density * scene.domain.gravity).as_vec3().as_dvec3();
    match scene.solver.pressure_on_patches {
        PatchPressure::Cell => vec![DVec3::ZERO; grid.n_cells()],
        PatchPressure::Hydrostatic => vec![at_rest; grid.n_cells()],
        PatchPressure::Gradient => {
            let pascal = if dt_last > 0.0 {
                density * grid.dx / dt_last
            } else {
                0.0
            };
            let pressure: Vec<f64> = before.potential.iter().map(|phi| pascal * phi).collect();
            let (open, active) = (&clip.cut_cells().open, &before.active);
            let mut slopes = vec![at_rest; grid.n_cells()];
            for (cell, _) in clip.coupling().cells() {
                slopes[cell] = pressure_gradient(&grid, open, active, &pressure, at_rest, cell);
            }
            slopes
        }
    }
}

/// Liquid and solids of a scene after a stage, for the judges of each.
struct Both<'a> {
    /// As the twin clips the solids where the device has them.
    clip: &'a SolidClip,
    /// The solids at rest.
    at_rest: &'a Solids,
    liquid: &'a LiquidSnapshot,
    solids: &'a SolidSnapshot,
    /// Gradients of the pressure within the cells with patches, Pa/m.
    slopes: &'a [DVec3],
    /// What the device tells of both.
    told: Option<CouplingReport>,
}

impl Both<'_> {
    /// Whether a patch lies in an active cell.
    fn touch(&self) -> bool {
        let mut cells = self.clip.coupling().cells();
        cells.any(|(cell, _)| self.liquid.active[cell])
    }

    /// J v of the cells (m/s, over dx^2), 0 in inactive ones; and the same of magnitudes.
    fn flux(&self, dx: f64, active: &[bool]) -> [Vec<f64>; 2] {
        let velocity = &self.solids.velocity;
        let mut sums = [(); 2].map(|()| vec![0.0; active.len()]);
        for pair in self.clip.coupling().pairs() {
            if active[pair.cell] {
                let (value, v) = (pair.value / (dx * dx), DVec3::from(velocity[pair.node]));
                sums[0][pair.cell] += value.dot(v);
                sums[1][pair.cell] += value.abs().dot(v.abs());
            }
        }
        sums
    }

    /// J v of what prescription, walls and obstacles hold of v, likewise.
    fn flux_of_held(&self, dx: f64, active: &[bool]) -> Vec<f64> {
        let mut sums = vec![0.0; active.len()];
        for pair in self.clip.coupling().pairs() {
            if active[pair.cell] {
                let v = DVec3::from(self.solids.velocity[pair.node]);
                let held = v - self.solids.freedom[pair.node].projector * v;
                sums[pair.cell] += (pair.value / (dx * dx)).dot(held);
            }
        }
        sums
    }

    /// J^T p of the nodes, N, three numbers each, of a potential (m/s) times this many Pa; and the same of magnitudes.
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

/// Largest relative error of a rounding to the scalar type, twice for f64, where it never matters.
fn unit(real: Real) -> f64 {
    match real {
        Real::F32 => EPS,
        Real::F64 => f64::EPSILON,
    }
}

#[cfg(test)]
mod tests {
    use super::table::Table;
    use super::*;

    /// Rows with so many numbers compared, all equal, and so many excused.
    fn comparison(rows: &[(&'static str, u64, u64)]) -> Comparison {
        let mut table = Table::default();
        for &(quantity, count, excused) in rows {
            let numbers = (0..count).map(|_| (1.0, 1.0, 0.0, Place::Whole));
            table.add(["forces", quantity, "m/s"], numbers);
            table.row("forces", quantity, "m/s").excused = excused;
        }
        Comparison {
            rows: table.rows,
            steps: 1,
            adapter: String::new(),
        }
    }

    #[test]
    fn excuses_have_a_cap() {
        // A single decision may hang on a rounding however few there are; of 10,000 numbers, 20.
        let within = comparison(&[("a", 10_000, 0), ("b", 9_980, 20), ("c", 3, 1)]);
        assert!(within.verdict().is_ok(), "{:?}", within.verdict());
        for (beyond, told) in [
            (
                (9_979, 21),
                "b of forces: 21 excused and 9979 compared, 20 may be",
            ),
            (
                (100, 2),
                "b of forces: 2 excused and 100 compared, 1 may be",
            ),
            ((0, 1), "b of forces: 1 excused and 0 compared"),
            ((0, 5_000), "b of forces: 5000 excused and 0 compared"),
        ] {
            let spoilt = comparison(&[("a", 10_000, 0), ("b", beyond.0, beyond.1), ("c", 3, 1)]);
            let breached: Vec<bool> = spoilt.rows.iter().map(Row::breached).collect();
            assert_eq!(breached, [false, true, false]);
            let error = spoilt.verdict().unwrap_err();
            assert_eq!(error.exit_code(), 1);
            let message = error.to_string();
            assert!(
                message.contains("1 of 3 quantities leave out") && message.contains(told),
                "{message}"
            );
        }
    }

    /// One is not hidden behind the other.
    #[test]
    fn differences_and_excuses_are_both_told() {
        let mut both = comparison(&[("a", 10, 0), ("b", 10, 7)]);
        both.rows[0].worst = Some(Worst {
            gpu: f64::NAN,
            twin: 1.0,
            bound: 1.0,
            place: Place::Whole,
            step: 4,
        });
        let message = both.verdict().unwrap_err().to_string();
        for told in [
            "the worst is a of forces: NaN m/s",
            "sub-step 4",
            "b of forces: 7 excused",
        ] {
            assert!(message.contains(told), "{told}: {message}");
        }
    }
}
