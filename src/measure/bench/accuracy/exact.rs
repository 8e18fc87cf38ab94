//! Problems with a known pressure, on grids.

use glam::DVec3;

use super::{Options, ensure_truth};
use crate::Error;
use crate::measure::bench::sub_step::{Done, Mask, reference_step, solve_columns, sub_step};
use crate::measure::bench::table::row;
use crate::measure::bench::{Rows, Run, rounds};
use crate::reference::larger;
use crate::scene::{Precision, Scene, Solver, names};
use crate::sim::{GpuPath, reference_path};

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
    /// A pool at rest around a turned obstacle, its surface inside cells.
    Rest,
    /// A column of water at the instant when its dam is removed, Pohle 1950.
    Dam,
}

names! { Exact: "pool_at_rest" => Rest, "dam_release" => Dam; }

impl Exact {
    /// Its scene; `cells` along 1 m: a multiple of 10.
    fn scene(self, cells: usize, solver: Solver) -> Result<Scene, Error> {
        let text = match self {
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
        let state = reference.state().clone();
        let exact = reference_step(&mut reference, &state)?;
        let what = format!("{}, {grid} cells along 1 m", self.name());
        ensure_truth(&format!("{what}, the f64 path"), state.step, exact.report.solves())?;
        let mask = Mask::new(&reference);
        // Nothing should move where no dam is removed.
        let rests = self != Exact::Dam;
        let [grid_p, grid_u] = self.errors(&scene, &mask, &exact);
        let mut paths = Vec::new();
        for &precision in &options.precisions {
            let (tolerance, max_iterations) = (options.tolerances[0], options.max_iterations);
            let scene = Scene { solver: Solver { precision, tolerance, max_iterations, ..solver }, ..scene.clone() };
            match GpuPath::open(&scene, &options.adapter) {
                Ok(mut path) => {
                    // Compiles.
                    sub_step(&mut path, &state)?;
                    paths.push((precision, path));
                }
                Err(Error::Limit { .. }) if precision == Precision::F64 => {}
                Err(error) => return Err(error),
            }
        }
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

    /// Largest error of the pressure over the largest pressure, and largest speed over g dt; NaN if any value is.
    fn errors(self, scene: &Scene, mask: &Mask, done: &Done) -> [f64; 2] {
        let grid = scene.grid();
        let cells = done.solution.pressure.iter().zip(&mask.cells).enumerate().filter(|(_, (_, counts))| **counts);
        let off =
            cells.filter_map(|(cell, (p, _))| Some((p - self.pressure(grid.cell_centre(grid.cell_at(cell)))?).abs()));
        let faces = done.faces.iter().flatten().zip(mask.faces.iter().flatten()).filter(|(_, counts)| **counts);
        let fall = scene.domain.gravity.length() * scene.time.fixed_step.unwrap_or(0.0);
        let largest = match self {
            Exact::Rest => WEIGHT * DEPTH,
            Exact::Dam => WEIGHT * DAM,
        };
        [off.fold(0.0, larger) / largest, faces.map(|(u, _)| u.abs()).fold(0.0, larger) / fall]
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
