//! Tables 6.5 and 6.6: one sub-step from rest of the problem of section 6.4 ([`PlaneStrain`]), of which the pressure is known and no
//! velocity should come. Errors are largest magnitudes: of the pressures of all unknowns, of the components of the nodes' velocities, of the
//! velocities on open faces beside unknowns. With pressures that are constant over a cell where they push on the solid, as the thesis has
//! them, the error of the pressure is the weight of the liquid between the block's face and the centre of the cell that holds it, so
//! that it jumps with where that centre happens to be; with the hydrostatic ones it falls with the square of the cell size.

use serde::Serialize;

use super::{MOST_ITERATIONS, Options, PATIENCE, TOLERANCE, ThesisTable};
use crate::Error;
use crate::linalg::norm;
use crate::measure::bench_accuracy::{Done, Mask, reference_step, sub_step};
use crate::measure::bench_solve::{Ended, is_solved, name};
use crate::measure::plane_strain::{PlaneStrain, TABLE_6_5, TABLE_6_6};
use crate::measure::statistics::{Spread, exponent};
use crate::reference::larger;
use crate::scene::{PatchPressure, Precision, Scene, Solver};
use crate::sim::{GpuPath, reference_path, solids_of};
use crate::state::{SolveReport, State};

/// Cells along the tank's height that an order is fitted over: cell sizes of 0.1 to 0.0125.
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

/// What a table is of.
struct Problem {
    table: ThesisTable,
    of: PlaneStrain,
    printed: &'static Printed,
}

impl Problem {
    /// `None` for tables of other things.
    fn of(table: ThesisTable) -> Option<Problem> {
        let (of, printed) = match table {
            ThesisTable::T6_5 => (TABLE_6_5, &PRINTED_6_5),
            ThesisTable::T6_6 => (TABLE_6_6, &PRINTED_6_6),
            _ => return None,
        };
        Some(Problem { table, of, printed })
    }
}

/// A row of thesis.csv. Errors are of p in Pa, of v and u in m/s; what the thesis does not have is empty.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Number of the table.
    pub table: &'static str,
    /// Cells along the tank's height.
    pub grid: usize,
    /// Cell size, m.
    pub dx: f64,
    /// `cpu` or `gpu`.
    pub backend: &'static str,
    /// `f32`, `mixed` or `f64`.
    pub precision: &'static str,
    /// `cell` or `hydrostatic`.
    pub patch_pressure: &'static str,
    /// Cells with a pressure.
    pub unknowns: usize,
    /// Free components of the nodes' velocities.
    pub solid_unknowns: usize,
    /// Of the pressures of all unknowns.
    pub error_p: f64,
    /// Of the components of the nodes' velocities.
    pub error_v: f64,
    /// Of the velocities on open faces beside unknowns.
    pub error_u: f64,
    /// Root of the mean square of the components of the nodes' velocities.
    pub rms_v: f64,
    /// Printed.
    pub thesis_p: Option<f64>,
    /// Printed.
    pub thesis_v: Option<f64>,
    /// Printed.
    pub thesis_u: Option<f64>,
    /// Over the printed one.
    pub ratio_p: Option<f64>,
    /// Over the printed one.
    pub ratio_v: Option<f64>,
    /// Over the printed one.
    pub ratio_u: Option<f64>,
    /// From the block's bottom to the centre of the cell that holds it, m.
    pub distance: f64,
    /// `error_p` over the weight of the liquid along that distance.
    pub error_p_over_weight: f64,
    /// How the solve ended.
    pub status: &'static str,
    /// Conjugate-gradient iterations; 0 for a direct solve.
    pub iterations: u32,
    /// Of the solve.
    pub seconds_median: f64,
    /// Least.
    pub seconds_min: f64,
    /// Largest.
    pub seconds_max: f64,
}

/// A row of thesis_orders.csv: orders of convergence over cell sizes of 0.1 to 0.0125, of rows whose solves passed.
#[derive(Clone, Debug, Serialize)]
pub struct Order {
    /// Number of the table.
    pub table: &'static str,
    /// `cpu`, `gpu` or, of the printed errors, `thesis`.
    pub backend: &'static str,
    /// As in [`Row`]; empty for the thesis.
    pub precision: &'static str,
    /// As in [`Row`].
    pub patch_pressure: &'static str,
    /// Cells of the coarsest grid.
    pub coarsest: usize,
    /// Of the finest.
    pub finest: usize,
    /// Slope of the line through the logarithms of the errors of p, by least squares.
    pub order_p: f64,
    /// Of v.
    pub order_v: f64,
    /// Of u.
    pub order_u: f64,
    /// Of the root of the mean square of v; empty for the thesis.
    pub order_rms_v: Option<f64>,
    /// Least order from one grid to the next, of p.
    pub least_p: f64,
    /// Of v.
    pub least_v: f64,
    /// Of u.
    pub least_u: f64,
}

/// One way to do the sub-step of one problem on one grid.
struct Case<'a> {
    problem: &'a Problem,
    grid: usize,
    scene: &'a Scene,
    /// At rest, deformed.
    state: &'a State,
}

/// Gives `take` all rows of the tables asked for.
pub(super) fn measure(
    options: &Options,
    take: &mut dyn FnMut(Row) -> Result<(), Error>,
) -> Result<(), Error> {
    for &table in &options.tables {
        let Some(problem) = Problem::of(table) else {
            continue;
        };
        for patches in [PatchPressure::Cell, PatchPressure::Hydrostatic] {
            for grid in options.grids_of(table) {
                for row in on_grid(&problem, patches, grid, options)? {
                    take(row)?;
                }
            }
        }
    }
    Ok(())
}

/// The rows of a problem on a grid: of the f64 path and of the device in each precision.
fn on_grid(
    problem: &Problem,
    patches: PatchPressure,
    grid: usize,
    options: &Options,
) -> Result<Vec<Row>, Error> {
    let solver = |precision: Precision| Solver {
        tolerance: TOLERANCE,
        max_iterations: MOST_ITERATIONS,
        precision,
        pressure_on_patches: patches,
        ..Solver::default()
    };
    let mut scene = problem.of.scene(grid, solver(Precision::F64))?;
    let mut path = reference_path(&scene)?;
    let mut state = path.state().clone();
    problem.of.deform(&solids_of(&scene)?, &mut state);
    let (mut seconds, mut done) = (Vec::<f64>::new(), None);
    while again(&seconds, options) {
        let found = reference_step(&mut path, &state)?;
        seconds.push(found.seconds);
        done = Some(found);
    }
    let mask = Mask::of(&path);
    let done = done.expect("there is at least one");
    let case = Case {
        problem,
        grid,
        scene: &scene,
        state: &state,
    };
    let mut rows = vec![case.row("cpu", &mask, Spread::of(seconds), &done)];
    for &precision in &options.precisions {
        scene.solver = solver(precision);
        let case = Case {
            problem,
            grid,
            scene: &scene,
            state: &state,
        };
        let mut path = match GpuPath::open(&scene, &options.adapter) {
            Ok(path) => path,
            Err(Error::Limit { .. }) if precision == Precision::F64 => continue,
            Err(error) => return Err(error),
        };
        let density = scene.liquid.as_ref().map_or(0.0, |liquid| liquid.density);
        // The first compiles.
        let mut done = sub_step(&mut path, case.state, density)?;
        let mut seconds = Vec::<f64>::new();
        while again(&seconds, options) {
            done = sub_step(&mut path, case.state, density)?;
            seconds.push(done.seconds);
        }
        rows.push(case.row("gpu", &mask, Spread::of(seconds), &done));
    }
    Ok(rows)
}

/// Whether runs of these seconds are followed by another.
fn again(seconds: &[f64], options: &Options) -> bool {
    seconds.is_empty() || seconds.len() < options.repeats && seconds.iter().sum::<f64>() <= PATIENCE
}

/// The largest magnitude of those that count; not a number where one is not.
fn largest<'a>(
    values: impl IntoIterator<Item = f64>,
    counts: impl IntoIterator<Item = &'a bool>,
) -> f64 {
    let values = values.into_iter().zip(counts);
    let counted = values.filter(|(_, counts)| **counts);
    counted.fold(0.0, |most, (value, _)| larger(most, value.abs()))
}

impl Case<'_> {
    fn row(&self, backend: &'static str, mask: &Mask, seconds: Spread, done: &Done) -> Row {
        let grid = self.scene.grid();
        let solver = &self.scene.solver;
        let pressures = done.answer.pressure.iter().enumerate();
        let off = pressures.map(|(cell, p)| {
            let height = grid.cell_centre(grid.cell_at(cell)).y;
            p - PlaneStrain::pressure(height)
        });
        let velocities = done.answer.velocity.as_flattened();
        let faces = done.faces.iter().zip(&mask.faces);
        let faces = faces.map(|(faces, counts)| largest(faces.iter().copied(), counts));
        let errors = [
            largest(off, &mask.cells),
            velocities.iter().fold(0.0, |most, v| larger(most, v.abs())),
            faces.fold(0.0, larger),
        ];
        let [error_p, error_v, error_u] = errors;
        let mut printed = self.problem.printed.iter();
        let printed = printed.find(|(cells, _)| *cells == self.grid);
        let thesis = |of: usize| printed.map(|(_, errors)| errors[of]);
        let ratio = |of: usize| thesis(of).map(|printed| errors[of] / printed);
        let distance = self.problem.of.distance(grid.dx);
        let solves: Vec<SolveReport> = done.report.solves().collect();
        Row {
            table: self.problem.table.number(),
            grid: self.grid,
            dx: grid.dx,
            backend,
            precision: name(solver.precision),
            patch_pressure: patches_name(solver.pressure_on_patches),
            unknowns: solves[0].unknowns,
            solid_unknowns: solves[1].unknowns,
            error_p,
            error_v,
            error_u,
            rms_v: norm(velocities) / (velocities.len() as f64).sqrt(),
            thesis_p: thesis(0),
            thesis_v: thesis(1),
            thesis_u: thesis(2),
            ratio_p: ratio(0),
            ratio_v: ratio(1),
            ratio_u: ratio(2),
            distance,
            error_p_over_weight: error_p / (PlaneStrain::WEIGHT * distance),
            status: Ended::of_reports(&solves).name(TOLERANCE),
            // Both are solved for together, and each has all of them.
            iterations: solves[0].iterations,
            seconds_median: seconds.median,
            seconds_min: seconds.min,
            seconds_max: seconds.max,
        }
    }
}

fn patches_name(patches: PatchPressure) -> &'static str {
    match patches {
        PatchPressure::Cell => "cell",
        PatchPressure::Hydrostatic => "hydrostatic",
        PatchPressure::Gradient => "gradient",
    }
}

/// Errors of p, v, u per cell size, coarsest first, as orders; none of fewer than two sizes.
fn order(
    [table, backend, precision, patch_pressure]: [&'static str; 4],
    points: &[(usize, [f64; 3])],
) -> Option<Order> {
    let points: Vec<_> = points
        .iter()
        .filter(|(grid, _)| FITTED.contains(grid))
        .collect();
    let [first, .., last] = &points[..] else {
        return None;
    };
    let sizes = |of: usize| -> Vec<(f64, f64)> {
        let points = points.iter();
        points
            .map(|(grid, errors)| (1.0 / *grid as f64, errors[of]))
            .collect()
    };
    let fitted = |of: usize| exponent(sizes(of));
    let least = |of: usize| {
        let points = sizes(of);
        let steps = points
            .windows(2)
            .filter_map(|pair| exponent(pair.iter().copied()));
        steps.fold(f64::INFINITY, f64::min)
    };
    Some(Order {
        table,
        backend,
        precision,
        patch_pressure,
        coarsest: first.0,
        finest: last.0,
        order_p: fitted(0)?,
        order_v: fitted(1)?,
        order_u: fitted(2)?,
        order_rms_v: None,
        least_p: least(0),
        least_v: least(1),
        least_u: least(2),
    })
}

/// Of all series, where their solves passed, and of the printed errors.
pub(super) fn orders(rows: &[Row], tables: &[ThesisTable]) -> Vec<Order> {
    let mut orders = Vec::new();
    for problem in tables.iter().filter_map(|&table| Problem::of(table)) {
        let number = problem.table.number();
        orders.extend(order([number, "thesis", "", "cell"], problem.printed));
        for series in series_of(rows, number) {
            let passed = |row: &&Row| series.holds(row) && is_solved(row.status);
            let of_series: Vec<&Row> = rows.iter().filter(passed).collect();
            let errors = |row: &&Row| (row.grid, [row.error_p, row.error_v, row.error_u]);
            let points: Vec<_> = of_series.iter().map(errors).collect();
            let fitted = of_series.iter().filter(|row| FITTED.contains(&row.grid));
            let means: Vec<(f64, f64)> = fitted.map(|row| (row.dx, row.rms_v)).collect();
            orders.extend(order(series.0, &points).map(|order| Order {
                order_rms_v: exponent(means),
                ..order
            }));
        }
    }
    orders
}

/// Table, backend, precision and patch pressure.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct Series([&'static str; 4]);

impl Series {
    fn of(row: &Row) -> Series {
        Series([row.table, row.backend, row.precision, row.patch_pressure])
    }

    pub(super) fn holds(&self, row: &Row) -> bool {
        *self == Series::of(row)
    }

    pub(super) fn label(&self) -> String {
        let [_, backend, precision, patches] = self.0;
        format!("{backend} {precision}, {patches}")
    }
}

/// Those of a table, in the order of its rows.
pub(super) fn series_of(rows: &[Row], table: &str) -> Vec<Series> {
    let mut found: Vec<Series> = Vec::new();
    for row in rows.iter().filter(|row| row.table == table) {
        let series = Series::of(row);
        if !found.contains(&series) {
            found.push(series);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::{Row, ThesisTable, largest, order, orders};
    use crate::state::SolveStatus;

    /// Of the device, with errors that are the cell size.
    fn row(grid: usize, status: SolveStatus) -> Row {
        let dx = 1.0 / grid as f64;
        Row {
            table: ThesisTable::T6_5.number(),
            grid,
            dx,
            backend: "gpu",
            precision: "mixed",
            patch_pressure: "cell",
            unknowns: 1,
            solid_unknowns: 1,
            error_p: dx,
            error_v: dx,
            error_u: dx,
            rms_v: dx,
            thesis_p: None,
            thesis_v: None,
            thesis_u: None,
            ratio_p: None,
            ratio_v: None,
            ratio_u: None,
            distance: dx,
            error_p_over_weight: 1.0,
            status: status.name(),
            iterations: 1,
            seconds_median: 1.0,
            seconds_min: 1.0,
            seconds_max: 1.0,
        }
    }

    #[test]
    fn what_did_not_converge_has_no_order() {
        let mut rows = [10, 20, 40].map(|grid| row(grid, SolveStatus::Converged));
        let of_rows = |rows: &[Row]| {
            let orders = orders(rows, &[ThesisTable::T6_5]).into_iter();
            let of_device = orders.filter(|order| order.backend == "gpu");
            of_device.collect::<Vec<_>>()
        };
        let found = of_rows(&rows);
        assert_eq!([found[0].coarsest, found[0].finest], [10, 40]);
        rows[2] = Row {
            error_p: 1.0,
            rms_v: 1.0,
            ..row(40, SolveStatus::IterationLimit)
        };
        let found = of_rows(&rows);
        assert_eq!([found[0].coarsest, found[0].finest], [10, 20]);
        for order in [found[0].order_p, found[0].order_rms_v.unwrap()] {
            assert!((order - 1.0).abs() < 1e-12, "{order}");
        }
        assert!(of_rows(&rows[1..]).is_empty(), "one grid has no order");
    }

    #[test]
    fn one_grid_twice_has_no_order() {
        let names = ["6.5", "gpu", "mixed", "cell"];
        let [coarse, fine] = [10, 20].map(|grid: usize| (grid, [1.0 / grid as f64; 3]));
        assert!(order(names, &[coarse, coarse]).is_none());
        let order = order(names, &[coarse, coarse, fine]).unwrap();
        assert!((order.order_p - 1.0).abs() < 1e-12, "{order:?}");
        assert!((order.least_p - 1.0).abs() < 1e-12, "{order:?}");
    }

    #[test]
    fn what_is_not_a_number_is_no_error() {
        let values = [1.0, f64::NAN, 2.0];
        assert!(largest(values, &[true; 3]).is_nan());
        assert_eq!(largest(values, &[true, false, true]), 2.0);
    }
}
