//! A sub-step from a state, on the device and on the f64 path, and what of it counts as an error.

use std::collections::BTreeMap;
use std::time::Instant;

use crate::Error;
use crate::grid::Axis;
use crate::reference::Reference;
use crate::sim::{GpuPath, Snapshot};
use crate::step::Stage;

use crate::state::{State, StepReport};

use super::super::statistics::Spread;
use super::super::stored;
use super::{Counter, Heard, Options, SEED};

/// A pressure per cell, Pa, and velocities of the nodes, m/s.
pub(crate) struct Answer {
    pub(crate) pressure: Vec<f64>,
    pub(crate) velocity: Vec<[f64; 3]>,
}

/// What a sub-step came to.
pub(crate) struct Done {
    /// Of the solve.
    pub(crate) seconds: f64,
    pub(crate) report: StepReport,
    pub(crate) answer: Answer,
    pub(crate) faces: [Vec<f64>; 3],
}

/// What errors count: unknowns and open faces beside them, as the f64 path has them.
pub(crate) struct Mask {
    pub(crate) cells: Vec<bool>,
    pub(crate) faces: [Vec<bool>; 3],
}

impl Mask {
    /// After a sub-step.
    pub(crate) fn of(path: &Reference) -> Mask {
        let (grid, cells) = (path.scene().grid(), &path.state().active);
        let open = &path.cut_cells().open;
        let faces = Axis::ALL.map(|axis| {
            let counts = |face: usize| {
                let sides = grid.face_sides(axis, grid.face_at(axis, face)).into_iter();
                // Without liquid no cell has an entry.
                let active = |cell: usize| cells.get(cell).is_some_and(|active| *active);
                let beside = sides.flatten().any(active);
                beside && open[axis.index()][face] > 0.0
            };
            (0..grid.n_faces(axis)).map(counts).collect()
        });
        Mask {
            cells: cells.clone(),
            faces,
        }
    }
}

/// Stages after which what a solve needs begins to be made: the second is left out where the surface stays.
const BEFORE: [Stage; 2] = [Stage::Forces, Stage::LiquidDistance];

/// Does the sub-step after a state once, with liquid of this density (kg/m^3). Its solve is timed with all that is made for it: active cells and
/// the hierarchy of their matrices, turns of the elements, right-hand sides.
pub(crate) fn sub_step(path: &mut GpuPath, state: &State, density: f64) -> Result<Done, Error> {
    path.write_state(state)?;
    let mut clock = None;
    let (mut seconds, mut answer, mut faces) = (0.0, None, Default::default());
    let dt = path.next_time_step().dt;
    let report = path.step_observed(&mut |stage, path| {
        if BEFORE.contains(&stage) {
            path.gpu().wait("bench")?;
            clock = Some(Instant::now());
        } else if stage == Stage::Solve {
            path.gpu().wait("bench")?;
            let clock: Instant = clock.expect("every sub-step has forces");
            seconds = clock.elapsed().as_secs_f64();
            let Snapshot { liquid, solids, .. } = path.snapshot()?;
            let pressure = |liquid| stored::pressure(path, &liquid, density, dt);
            answer = Some(Answer {
                pressure: liquid.map_or(Vec::new(), pressure),
                velocity: solids.map_or(Vec::new(), |solids| solids.velocity),
            });
        } else if stage == Stage::Diagnose
            && let Some(liquid) = path.snapshot()?.liquid
        {
            faces = liquid.velocity;
        }
        Ok(())
    })?;
    Ok(Done {
        seconds,
        report,
        answer: answer.expect("every sub-step has a solve"),
        faces,
    })
}

/// By number of the way and of the tolerance: the seconds of all repeats, and what the first came to.
pub(super) type Repeats = BTreeMap<(usize, usize), (Spread, Done)>;

/// Does the sub-step, by number of a way and to a tolerance, in all ways and to all tolerances as often as asked, in a shuffled order each time;
/// while there are seconds left. `on`: what it is a sub-step of.
pub(super) fn repeat_shuffled(
    (on, ways): (String, usize),
    options: &Options,
    tell: &mut dyn FnMut(Heard),
    mut step: impl FnMut(usize, f64) -> Result<Done, Error>,
) -> Result<Repeats, Error> {
    let tolerances = 0..options.tolerances.len();
    let all = (0..ways).flat_map(|way| tolerances.clone().map(move |tolerance| (way, tolerance)));
    let mut once: Vec<(usize, usize)> = all.collect();
    let mut random = fastrand::Rng::with_seed(SEED);
    let mut jobs = Vec::new();
    for _ in 0..options.repeats.max(1) {
        random.shuffle(&mut once);
        jobs.extend_from_slice(&once);
    }
    let mut counter = Counter::new(on, "timed solves", jobs.len(), tell);
    let clock = Instant::now();
    let mut found: BTreeMap<(usize, usize), (Vec<f64>, Done)> = BTreeMap::new();
    for (number, job) in jobs.into_iter().enumerate() {
        if number >= once.len() && clock.elapsed().as_secs_f64() > options.seconds {
            break;
        }
        let done = step(job.0, options.tolerances[job.1])?;
        found
            .entry(job)
            .and_modify(|(seconds, _)| seconds.push(done.seconds))
            .or_insert_with(|| (vec![done.seconds], done));
        counter.count();
    }
    let found = found.into_iter();
    Ok(found
        .map(|(job, (seconds, done))| (job, (Spread::of(seconds), done)))
        .collect())
}

/// Does it on the f64 path.
pub(crate) fn reference_step(path: &mut Reference, state: &State) -> Result<Done, Error> {
    path.reset(state.clone())?;
    let report = path.step(path.next_time_step())?;
    let solve = report
        .seconds
        .iter()
        .find(|(stage, _)| *stage == Stage::Solve.name());
    let seconds = solve.map_or(0.0, |(_, seconds)| *seconds);
    let State {
        pressure,
        node_velocity: velocity,
        velocity: faces,
        ..
    } = path.state().clone();
    Ok(Done {
        seconds,
        report,
        answer: Answer { pressure, velocity },
        faces,
    })
}
