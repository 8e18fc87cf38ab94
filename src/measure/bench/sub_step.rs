//! One sub-step from a state on the device and on the f64 path, and its errors.

use std::time::Instant;

use super::ended::Ended;
use super::statistics::Spread;
use super::table::{Row, row};
use crate::Error;
use crate::grid::Axis;
use crate::measure::stored;
use crate::reference::Reference;
use crate::sim::{GpuPath, Snapshot};
use crate::state::{SolveReport, State, StepReport};
use crate::step::Stage;

/// Solution: a pressure per cell, Pa, and velocities of the nodes, m/s.
pub(super) struct Solution {
    pub(super) pressure: Vec<f64>,
    pub(super) velocity: Vec<[f64; 3]>,
}

pub(super) struct Done {
    /// Seconds of the solve.
    pub(super) seconds: f64,
    pub(super) report: StepReport,
    pub(super) solution: Solution,
    /// Face velocities, m/s.
    pub(super) faces: [Vec<f64>; 3],
}

/// Unknowns of the f64 path and the open faces beside them: errors count there.
pub(super) struct Mask {
    pub(super) cells: Vec<bool>,
    pub(super) faces: [Vec<bool>; 3],
}

impl Mask {
    pub(super) fn new(path: &Reference) -> Mask {
        let (grid, cells) = (path.scene().grid(), &path.state().active);
        let open = &path.cut_cells().open;
        let faces = Axis::ALL.map(|axis| {
            let counts = |face: usize| {
                let mut sides = grid.face_sides(axis, grid.face_at(axis, face)).into_iter().flatten();
                // Without liquid no cell has an entry.
                let beside = sides.any(|cell| cells.get(cell).is_some_and(|active| *active));
                beside && open[axis.index()][face] > 0.0
            };
            (0..grid.n_faces(axis)).map(counts).collect()
        });
        Mask { cells: cells.clone(), faces }
    }
}

/// Last stages before the set-up of the solve; the second is absent with a fixed surface and fixed bodies.
const BEFORE: [Stage; 2] = [Stage::Forces, Stage::LiquidDistance];

/// Computes the sub-step after a state. The seconds of the solve include its set-up: active cells and hierarchy, rotations of
/// the elements, right-hand sides.
pub(super) fn sub_step(path: &mut GpuPath, state: &State) -> Result<Done, Error> {
    path.write_state(state)?;
    let mut clock = None;
    let (mut seconds, mut solution, mut faces) = (0.0, None, Default::default());
    let dt = path.next_time_step().dt;
    let report = path.step_observed(&mut |stage, path| {
        if BEFORE.contains(&stage) {
            path.gpu().wait("bench")?;
            clock = Some(Instant::now());
        } else if stage == Stage::Solve {
            path.gpu().wait("bench")?;
            seconds = clock.map_or(0.0, |clock: Instant| clock.elapsed().as_secs_f64());
            let Snapshot { liquid, solids, .. } = path.snapshot()?;
            let pressure = |liquid| stored::pressure(path, &liquid, dt);
            solution = Some(Solution {
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
    Ok(Done { seconds, report, solution: solution.expect("every sub-step has a solve"), faces })
}

/// The same sub-step on the f64 path.
pub(super) fn reference_step(path: &mut Reference, state: &State) -> Result<Done, Error> {
    path.reset(state.clone())?;
    let report = path.step(path.next_time_step())?;
    let State { pressure, node_velocity: velocity, velocity: faces, .. } = path.state().clone();
    Ok(Done {
        seconds: stage_seconds(&report, Stage::Solve.name()),
        report,
        solution: Solution { pressure, velocity },
        faces,
    })
}

/// Columns of the solves of a sub-step to a tolerance.
pub(super) fn solve_columns(report: &StepReport, tolerance: f64, seconds: Spread) -> Row {
    let unknowns = |solve: Option<SolveReport>| solve.map_or(0, |solve| solve.unknowns);
    let solves: Vec<SolveReport> = report.solves().collect();
    let iterations = solves.iter().map(|solve| solve.iterations);
    // In a coupled solve each report has all iterations.
    let iterations: u32 = if report.touching() { solves[0].iterations } else { iterations.sum() };
    row! {
        unknowns: unknowns(report.liquid.map(|liquid| liquid.solve)), solid_unknowns: unknowns(report.solid.map(|solid| solid.solve)),
        status: Ended::new(&solves).name(tolerance), iterations, seconds,
    }
}

/// Seconds of a stage of a sub-step.
pub(super) fn stage_seconds(report: &StepReport, stage: &str) -> f64 {
    report.seconds.iter().filter(|(name, _)| *name == stage).map(|(_, seconds)| seconds).sum()
}
