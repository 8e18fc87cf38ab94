//! Problems with a known pressure, on grids.

use glam::DVec3;

use super::{Options, ensure_truth};
use crate::Error;
use crate::measure::bench::sub_step::{Done, Mask, open_paths, reference_step, rest_errors, solve_columns, sub_step};
use crate::measure::bench::table::row;
use crate::measure::bench::{Rows, Run, rounds};
use crate::measure::plane_strain::{PlaneStrain, TABLE_6_5};
use crate::reference::larger;
use crate::scene::{Scene, Solver, names};
use crate::sim::{reference_path, solids_of};

/// Weight of water, N/m^3.
const WEIGHT: f64 = 1000.0 * 9.81;
/// Depth of the pool, m: inside a cell on any grid.
const DEPTH: f64 = 0.613;
/// Width and height of the dam, m.
const DAM: f64 = 0.5;
/// Distance from the dam's foot within which errors do not count, m: the acceleration is infinite there.
const FOOT: f64 = 0.125;

/// A problem with a known solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exact {
    /// An elastic block at rest in a liquid, thesis section 6.4, table 6.5.
    Block,
    /// A pool at rest around a turned obstacle, its surface inside cells.
    Rest,
    /// A column of water at the instant when its dam is removed, Pohle 1950.
    Dam,
}

names! { Exact: "elastic_block" => Block, "pool_at_rest" => Rest, "dam_release" => Dam; }

impl Exact {
    /// Its scene; `cells` along 1 m: a multiple of 10.
    fn scene(self, cells: usize, solver: Solver) -> Result<Scene, Error> {
        let text = match self {
            Exact::Block => return TABLE_6_5.scene(cells, solver),
            Exact::Rest => include_str!("pool_at_rest.toml"),
            Exact::Dam => include_str!("dam_release.toml"),
        };
        let mut scene = Scene::parse(self.name().as_ref(), text, &[], cells as f64 / 10.0)?;
        scene.solver = solver;
        Ok(scene)
    }

    /// Exact pressure at a point, Pa; `None` where errors do not count.
    fn pressure(self, x: DVec3) -> Option<f64> {
        match self {
            Exact::Block => Some(PlaneStrain::pressure(x.y)),
            Exact::Rest => Some(WEIGHT * (DEPTH - x.y)),
            Exact::Dam => {
                let counts = (x.x - DAM).hypot(x.y) > FOOT;
                counts.then(|| WEIGHT * DAM * dam_release(x.x / DAM, x.y / DAM))
            }
        }
    }

    /// Rows of a problem on a grid.
    pub(super) fn measure(self, run: &mut Run, grid: usize, options: &Options) -> Result<Rows, Error> {
        let solver = super::exact(Solver::default());
        let scene = self.scene(grid, solver)?;
        let mut reference = reference_path(&scene)?;
        let mut state = reference.state().clone();
        if self == Exact::Block {
            TABLE_6_5.deform(&solids_of(&scene)?, &mut state);
        }
        let exact = reference_step(&mut reference, &state)?;
        let what = format!("{}, {grid} cells along 1 m", self.name());
        ensure_truth(&format!("{what}, the f64 path"), state.step, exact.report.solves())?;
        let mask = Mask::new(&reference);
        // Nothing should move where no dam is removed.
        let rests = self != Exact::Dam;
        let [grid_p, grid_u] = self.errors(&scene, &mask, &exact);
        let solvers = options.precisions.iter().map(|&precision| Solver {
            precision,
            tolerance: options.tolerances[0],
            max_iterations: options.max_iterations,
            ..solver
        });
        let mut paths = open_paths(&scene, solvers, &state, &options.adapter)?;
        let n = options.tolerances.len();
        let timed = rounds(run, &format!("solves of {what}"), n * paths.len(), |job| {
            let path = &mut paths[job / n].1;
            path.set_tolerance(options.tolerances[job % n]);
            let done = sub_step(path, &state)?;
            Ok((done.seconds, done))
        })?;
        let rows = timed.into_iter().enumerate().map(|(job, timed)| {
            let (tolerance, done) = (options.tolerances[job % n], &timed.outcome);
            let [error_p, error_u] = self.errors(&scene, &mask, done);
            let row = row! {
                problem: self.name(), grid, precision: paths[job / n].0.name(), tolerance, error_p, grid_error_p: grid_p,
                error_u: rests.then_some(error_u), grid_error_u: rests.then_some(grid_u),
            };
            ("accuracy_grids", row.with(solve_columns(&done.report, tolerance, timed.spread())))
        });
        Ok(rows.collect())
    }

    /// Errors of the pressure over the largest pressure, and of speeds over g dt.
    fn errors(self, scene: &Scene, mask: &Mask, done: &Done) -> [f64; 2] {
        let [p, v, u] = rest_errors(scene, mask, done, |x| self.pressure(x));
        let fall = scene.domain.gravity.length() * scene.time.fixed_step.unwrap_or(0.0);
        let largest = match self {
            Exact::Block => PlaneStrain::pressure(0.0),
            Exact::Rest => WEIGHT * DEPTH,
            Exact::Dam => WEIGHT * DAM,
        };
        [p / largest, larger(v, u) / fall]
    }
}

/// Pressure over rho g H at the instant when a dam of width and height H is removed; `x` and `y` over H. The column is free at the top and at
/// x = 1. Separation of variables: Stoker, Water Waves, 1957.
pub fn dam_release(x: f64, y: f64) -> f64 {
    let term = |n: u32| {
        let k = (f64::from(n) + 0.5) * std::f64::consts::PI;
        // cosh(k x) / cosh(k), without overflow.
        let ratio = ((k * (x - 1.0)).exp() + (-k * (x + 1.0)).exp()) / (1.0 + (-2.0 * k).exp());
        2.0 / (k * k) * (k * y).cos() * ratio
    };
    1.0 - y - (0..4000).map(term).sum::<f64>()
}
