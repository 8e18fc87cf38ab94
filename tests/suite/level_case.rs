//! The cases of `liquid_case` with a level set for the twin tests of its stages.

use cutwater::effects::Effects;
use cutwater::fields::{LevelBuffers, LiquidBuffers, LiquidPlan};
use cutwater::gpu::{Gpu, Real};
use cutwater::reference::extend_level;
use glam::DVec3;

use crate::common::Random;
use crate::liquid_case::{Case, cases, single};

/// Every case with a level, spray, and velocities of the markers; with obstacles the level is extended into them. `liquid_distance` is dx times a
/// level that f32 holds.
pub(crate) fn level_cases() -> Vec<Case> {
    cases().into_iter().map(with_level).collect()
}

pub(crate) fn with_level(mut case: Case) -> Case {
    case.effects = Effects { level: true, maccormack: true, volume_shift: true, volume_control: false, ..case.effects };
    let (grid, mut random) = (case.grid, Random(5));
    let size = grid.size() / grid.dx;
    let (pool, ball) = (0.41 * size.y, size * DVec3::new(0.6, 0.8, 0.45));
    let mut level: Vec<f64> = (0..grid.n_cells())
        .map(|cell| {
            let x = grid.cell_centre(grid.cell_at(cell)) / grid.dx;
            let phi = (x.y - pool).min(x.distance(ball) - 0.17 * size.min_element());
            (phi + random.uniform(-0.3, 0.3)).clamp(-5.0, 5.0)
        })
        .collect();
    extend_level(&grid, &case.cut, &mut level);
    case.state.liquid_distance = level.iter().map(|phi| single(phi * grid.dx)).collect();
    let n = case.state.markers.len();
    let mut component = || single(random.uniform(-2.0, 2.0));
    case.state.marker_velocity = (0..n).map(|_| std::array::from_fn(|_| component())).collect();
    case.state.spray = (0..n).map(|n| n % 5 == 0).collect();
    case
}

/// The device's arrays of a level, in a state.
pub(crate) fn level_buffers(gpu: &Gpu, case: &Case, liquid: &LiquidBuffers) -> LevelBuffers {
    let plan = LiquidPlan {
        grid: case.grid,
        effects: case.effects,
        n_markers: case.state.markers.len(),
        cfl: case.cfl,
        real: if gpu.has_f64() { Real::F64 } else { Real::F32 },
    };
    assert_eq!(plan, liquid.plan);
    LevelBuffers::new(gpu, plan).unwrap().unwrap()
}

/// The level of a state as the device has it, cells: m times 1/dx.
pub(crate) fn level_of(case: &Case) -> Vec<f64> {
    let distance = case.state.liquid_distance.iter();
    distance.map(|phi| phi / case.grid.dx).collect()
}
