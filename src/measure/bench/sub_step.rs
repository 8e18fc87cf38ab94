//! A sub-step from a state, on the device and on the f64 path, and the unknowns whose errors count.

use std::time::Instant;

use glam::DVec3;

use crate::Error;
use crate::grid::Axis;
use crate::reference::{Reference, larger};
use crate::scene::Scene;
use crate::sim::{GpuPath, Snapshot};
use crate::step::Stage;

use crate::state::{State, StepReport};

use crate::measure::stored;

/// A pressure per cell, Pa, and velocities of the nodes, m/s.
pub(crate) struct Answer {
    pub(crate) pressure: Vec<f64>,
    pub(crate) velocity: Vec<[f64; 3]>,
}

/// Results of a sub-step.
pub(crate) struct Done {
    /// Seconds of the solve.
    pub(crate) seconds: f64,
    pub(crate) report: StepReport,
    pub(crate) answer: Answer,
    pub(crate) faces: [Vec<f64>; 3],
}

/// Unknowns, and open faces beside them, of the f64 path.
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

/// Last stages before the set-up of the solve; the second is absent where the surface and all bodies are fixed.
const BEFORE: [Stage; 2] = [Stage::Forces, Stage::LiquidDistance];

/// Does the sub-step after a state once, with liquid of this density (kg/m^3). The seconds of the solve include its set-up: active cells and
/// hierarchy, rotations of the elements, right-hand sides.
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

/// The same on the f64 path.
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

/// Largest errors of pressure (Pa), node velocity and face velocity (m/s) of a liquid and solids at rest; NaN where a number is not one.
/// `pressure`: the exact one, `None` where errors do not count.
pub(super) fn rest_errors(
    scene: &Scene,
    mask: &Mask,
    done: &Done,
    pressure: impl Fn(DVec3) -> Option<f64>,
) -> [f64; 3] {
    let grid = scene.grid();
    let cells = done.answer.pressure.iter().zip(&mask.cells).enumerate();
    let off = cells.filter(|(_, (_, counts))| **counts);
    let off = off.filter_map(|(cell, (p, _))| {
        let exact = pressure(grid.cell_centre(grid.cell_at(cell)))?;
        Some((p - exact).abs())
    });
    let faces = done.faces.iter().flatten().zip(mask.faces.iter().flatten());
    let faces = faces.filter(|(_, counts)| **counts).map(|(u, _)| u.abs());
    let nodes = done.answer.velocity.as_flattened().iter();
    [
        off.fold(0.0, larger),
        nodes.map(|v| v.abs()).fold(0.0, larger),
        faces.fold(0.0, larger),
    ]
}

/// kg/m^3; 0 without liquid.
pub(super) fn density(scene: &Scene) -> f64 {
    scene.liquid.as_ref().map_or(0.0, |liquid| liquid.density)
}
