//! `compare`: every stage of every sub-step of the GPU path against its f64 twin, from the same inputs.
//!
//! After each stage the device's fields are downloaded and widened to f64, which is exact. The twin gets what the stage had
//! before it, and its answer is compared with what the stage left. So differences do not pile up: each is the rounding of one
//! stage, and its bound is that stage's roundings counted, k 2^-24 times the size of what is rounded. Where a division counts, it
//! counts for 5: WGSL allows 2.5 units in the last place.
//!
//! Some answers jump: whether a marker is in one cell or the next, whether a face is near enough to an obstacle to slip. Where
//! the two paths decide differently, and moving the input by its rounding makes the twin decide as the GPU did, the number is
//! counted as excused and left out; in all other cases it is a breach.

mod liquid;
mod solids;
mod table;

pub use table::{Place, Row, Worst};

use super::bounds::EPS;
use crate::Error;
use crate::gpu::{AdapterChoice, Real};
use crate::scene::Scene;
use crate::sim::{GpuPath, Snapshot};
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
    /// [`Error::Check`] with the worst row, where a difference is larger than rounding explains.
    pub fn verdict(&self) -> Result<(), Error> {
        let breaches = self.rows.iter().filter(|row| row.breached()).count();
        let Some((row, worst)) = self
            .worst()
            .filter(|row| row.breached())
            .and_then(|row| Some((row, row.worst?)))
        else {
            return Ok(());
        };
        Err(Error::Check(format!(
            "{breaches} of {} quantities differ by more than rounding explains; the worst is {} of {}: {:e} {unit} on the GPU, \
             {:e} {unit} in the twin, bound {:e} {unit}, sub-step {}, {}",
            self.rows.len(),
            row.quantity,
            row.stage,
            worst.gpu,
            worst.twin,
            worst.bound,
            worst.step,
            worst.place,
            unit = row.unit,
        )))
    }
}

/// Runs the GPU path for some frames and compares each stage. `listen` hears of every snapshot before it is judged, with the
/// stage's name; what it changes there is judged as if it came from the device, and not handed to the next twin.
///
/// # Errors
/// Whatever the simulation ends with. A breach is no error here: see [`Comparison::verdict`].
pub fn compare(
    scene: &Scene,
    frames: u64,
    adapter: &AdapterChoice,
    listen: &mut dyn FnMut(&'static str, &mut Snapshot),
) -> Result<Comparison, Error> {
    let mut path = GpuPath::open(scene, adapter)?;
    let mut liquid = LiquidJudge::new(scene, &path)?;
    let mut solids = SolidJudge::new(scene, &path)?;
    while path.clock().frame < frames {
        let dt = path.next_time_step().dt;
        if let Some(judge) = &mut liquid {
            judge.begin(&path, dt);
        }
        if let Some(judge) = &mut solids {
            judge.begin(&path, dt);
        }
        path.step_observed(&mut |stage, path| {
            let held = path.snapshot()?;
            let mut after = held.clone();
            listen(stage, &mut after);
            if let (Some(judge), Some(after)) = (&mut liquid, after.liquid) {
                judge.judge(stage, after, held.liquid)?;
            }
            if let (Some(judge), Some(after)) = (&mut solids, after.solids) {
                judge.judge(stage, after, held.solids)?;
            }
            Ok(())
        })?;
    }
    let liquid = liquid.into_iter().flat_map(|judge| judge.table.rows);
    let rows = liquid.chain(solids.into_iter().flat_map(|judge| judge.table.rows));
    Ok(Comparison {
        rows: rows.collect(),
        steps: path.clock().step,
        adapter: path.gpu().report().name.clone(),
    })
}

/// Largest relative error of a rounding to the scalar type, twice for f64, where it never matters.
fn unit(real: Real) -> f64 {
    match real {
        Real::F32 => EPS,
        Real::F64 => f64::EPSILON,
    }
}
