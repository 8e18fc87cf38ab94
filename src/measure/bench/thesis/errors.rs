//! Tables 6.5 and 6.6: one sub-step from rest of the problem of section 6.4 ([`PlaneStrain`]). Its pressure is known and its velocity is 0.
//!
//! Errors are largest magnitudes: of the pressures of all unknowns, the components of the nodes' velocities, and the velocities on open faces
//! beside unknowns. The thesis has patch pressures that are constant over a cell. The error of the pressure is then the weight of the liquid
//! between the block's face and the centre of its cell. With hydrostatic ones it decreases with the square of the cell size.

use super::{MOST_ITERATIONS, Options, TOLERANCE};
use crate::Error;
use crate::linalg::norm;
use crate::measure::bench::ended::is_solved;
use crate::measure::bench::statistics::{Spread, exponent, grouped};
use crate::measure::bench::sub_step::{Done, Mask, open_paths, reference_step, rest_errors, solve_columns, sub_step};
use crate::measure::bench::table::{Row, columns, row};
use crate::measure::bench::{Rows, Run, rounds};
use crate::measure::plane_strain::{PlaneStrain, TABLE_6_5, TABLE_6_6};
use crate::scene::{PatchPressure, Precision, Scene, Solver};
use crate::sim::{reference_path, solids_of};

/// Cells along the tank's height in fits of orders: cell sizes of 0.1 to 0.0125.
const FITTED: std::ops::RangeInclusive<usize> = 10..=80;

/// Cells along the tank's height, and errors of p, v, u.
type Printed = [(usize, [f64; 3]); 5];

/// Thesis, table 6.5.
const PRINTED_6_5: Printed = [
    (5, [4.19e-2, 5.68e-3, 3.75e-3]),
    (10, [4.22e-2, 4.20e-3, 2.66e-3]),
    (20, [1.84e-2, 1.93e-3, 2.31e-3]),
    (40, [6.95e-3, 9.75e-4, 1.14e-3]),
    (80, [1.15e-3, 2.72e-4, 3.01e-4]),
];

/// Thesis, table 6.6.
const PRINTED_6_6: Printed = [
    (5, [9.19e-2, 3.92e-3, 3.02e-3]),
    (10, [3.35e-2, 1.37e-3, 1.06e-3]),
    (20, [6.01e-3, 3.25e-4, 2.08e-4]),
    (40, [7.30e-3, 4.74e-4, 7.57e-4]),
    (80, [1.21e-3, 1.07e-4, 1.92e-4]),
];

columns! {
    ERRORS {
        + table "" "number of the table";
        + grid "" "cells along the tank's height";
        - dx "m" "cell size";
        + backend "" "`cpu` or `gpu`";
        + precision "" "`f32`, `mixed` or `f64`";
        + patch_pressure "" "`cell` or `hydrostatic`";
        - unknowns, solid_unknowns "" "of the pressure, and of the solids";
        + error_p "Pa" "largest error of the pressures of all unknowns";
        + error_v "m/s" "of the components of the nodes' velocities";
        + error_u "m/s" "of the velocities on open faces beside unknowns";
        - rms_v "m/s" "root of the mean square of the components of the nodes' velocities";
        - thesis_p "Pa" "printed";
        - thesis_v, thesis_u "m/s" "printed";
        + ratio_p, ratio_v, ratio_u "" "over the printed one";
        - error_p_over_weight "" "`error_p` over the weight of the liquid from the block's bottom to the centre of its cell";
        + status "" "`converged`, `converged_to_rounding` or why not";
        - iterations "" "0 for a direct solve";
        ~ seconds "s" "seconds of the solve";
    }
    /// Orders of convergence over cell sizes of 0.1 to 0.0125.
    ORDERS {
        + table "" "number of the table";
        + backend "" "`cpu`, `gpu` or, of the printed errors, `thesis`";
        + precision, patch_pressure "" "as in thesis.csv";
        + coarsest, finest "" "cells of the coarsest and the finest grid";
        + order_p, order_v, order_u "" "by least squares of the logarithms";
        - order_rms_v "" "of the root of the mean square of v";
        - least_p, least_v, least_u "" "least order from one grid to the next";
    }
}

/// Problem of a table.
#[derive(Clone, Copy)]
pub(super) struct Problem {
    pub(super) table: &'static str,
    strain: PlaneStrain,
    printed: &'static Printed,
}

pub(super) const PROBLEMS: [Problem; 2] = [
    Problem { table: "6.5", strain: TABLE_6_5, printed: &PRINTED_6_5 },
    Problem { table: "6.6", strain: TABLE_6_6, printed: &PRINTED_6_6 },
];

/// Measured patch pressures.
pub(super) const PATCHES: [PatchPressure; 2] = [PatchPressure::Cell, PatchPressure::Hydrostatic];

impl Problem {
    /// Rows on a grid: the f64 path, and the device in each precision.
    pub(super) fn rows(
        self,
        run: &mut Run,
        patches: PatchPressure,
        grid: usize,
        options: &Options,
    ) -> Result<Rows, Error> {
        let solver = |precision| Solver {
            tolerance: TOLERANCE,
            max_iterations: MOST_ITERATIONS,
            precision,
            pressure_on_patches: patches,
            ..Solver::default()
        };
        let scene = self.strain.scene(grid, solver(Precision::F64))?;
        let mut reference = reference_path(&scene)?;
        let mut state = reference.state().clone();
        self.strain.deform(&solids_of(&scene)?, &mut state);
        let solvers = options.precisions.iter().copied().map(solver);
        let mut paths = open_paths(&scene, solvers, &state, &options.adapter)?;
        let what = format!("solves of table {}, {grid} cells along 1 m", self.table);
        let timed = rounds(run, &what, 1 + paths.len(), |job| {
            let (backend, precision, done) = match job.checked_sub(1).map(|job| &mut paths[job]) {
                None => ("cpu", Precision::F64, reference_step(&mut reference, &state)?),
                Some((precision, path)) => ("gpu", *precision, sub_step(path, &state)?),
            };
            Ok((done.seconds, (backend, precision, done)))
        })?;
        let mask = Mask::new(&reference);
        let rows = timed.into_iter().map(|timed| {
            let (backend, precision, done) = &timed.outcome;
            let row = self.row(&scene, &mask, grid, timed.spread(), done);
            let names = row! { backend: *backend, precision: precision.name(), patch_pressure: patches.name() };
            ("thesis", row.with(names))
        });
        Ok(rows.collect())
    }

    fn row(self, scene: &Scene, mask: &Mask, grid: usize, seconds: Spread, done: &Done) -> Row {
        let errors = rest_errors(scene, mask, done, |x| Some(PlaneStrain::pressure(x.y)));
        let [error_p, error_v, error_u] = errors;
        let velocities = done.solution.velocity.as_flattened();
        let printed = self.printed.iter().find(|(cells, _)| *cells == grid);
        let thesis = [0, 1, 2].map(|of: usize| printed.map(|(_, errors)| errors[of]));
        let ratio = [0, 1, 2].map(|of: usize| thesis[of].map(|printed| errors[of] / printed));
        let dx = scene.grid().dx;
        let row = row! {
            table: self.table, grid, dx, error_p, error_v, error_u, rms_v: norm(velocities) / (velocities.len() as f64).sqrt(),
            thesis_p: thesis[0], thesis_v: thesis[1], thesis_u: thesis[2], ratio_p: ratio[0], ratio_v: ratio[1], ratio_u: ratio[2],
            error_p_over_weight: error_p / (PlaneStrain::WEIGHT * self.strain.distance(dx)),
        };
        row.with(solve_columns(&done.report, TOLERANCE, seconds))
    }
}

/// Orders of a series of rows; `None` for fewer than two sizes.
fn order(rows: &[&Row]) -> Option<Row> {
    let rows: Vec<&Row> = rows.iter().copied().filter(|row| FITTED.contains(&row.count("grid"))).collect();
    let [first, .., last] = rows[..] else { return None };
    let point = |row: &Row, error: &str| (1.0 / row.number("grid"), row.number(error));
    let fit = |error: &str| exponent(rows.iter().map(|row| point(row, error)));
    let least = |error: &str| {
        let steps = rows.windows(2).filter_map(|pair| exponent(pair.iter().map(|row| point(row, error))));
        steps.fold(f64::INFINITY, f64::min)
    };
    Some(row! {
        coarsest: first.count("grid"), finest: last.count("grid"), order_p: fit("error_p")?, order_v: fit("error_v")?,
        order_u: fit("error_u")?, order_rms_v: fit("rms_v"), least_p: least("error_p"), least_v: least("error_v"), least_u: least("error_u"),
    })
}

/// Orders of all series of converged solves, and of the printed errors.
pub(super) fn orders(rows: &[Row]) -> Vec<Row> {
    let mut orders = Vec::new();
    for (table, rows) in grouped(rows, |row| Some(row.text("table"))) {
        let printed = PROBLEMS.iter().filter(|problem| problem.table == table).flat_map(|problem| problem.printed);
        let printed = printed.map(|&(grid, [p, v, u])| row! { grid, error_p: p, error_v: v, error_u: u });
        let printed: Vec<Row> = printed.collect();
        let thesis = row! { table, backend: "thesis", precision: "", patch_pressure: "cell" };
        orders.extend(order(&printed.iter().collect::<Vec<_>>()).map(|order| order.with(thesis)));
        let solved = rows.into_iter().filter(|row| is_solved(row.text("status")));
        let series = |row: &Row| row.only(&["table", "backend", "precision", "patch_pressure"]);
        for (series, rows) in grouped(solved, |row| Some(series(row))) {
            orders.extend(order(&rows).map(|order| order.with(series)));
        }
    }
    orders
}
