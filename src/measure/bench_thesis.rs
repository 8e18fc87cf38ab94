//! `bench thesis`: tables of the thesis's chapter 6 beside what they are here.
//!
//! Tables 6.5 and 6.6: one sub-step from rest of the problem of section 6.4 ([`PlaneStrain`]), of which the pressure is known and no
//! velocity should come. Errors are largest magnitudes: of the pressures of all unknowns, of the components of the nodes' velocities, of the
//! velocities on open faces beside unknowns. With pressures that are constant over a cell where they push on the solid, as the thesis has
//! them, the error of the pressure is the weight of the liquid between the block's face and the centre of the cell that holds it, so
//! that it jumps with where that centre happens to be; with the hydrostatic ones it falls with the square of the cell size.

use std::fs;
use std::path::Path;

use plotters::prelude::*;
use serde::Serialize;

use crate::Error;
use crate::gpu::{AdapterChoice, Gpu};
use crate::grid::Axis;
use crate::reference::Reference;
use crate::scene::{PatchPressure, Precision, Scene, Solver};
use crate::sim::{GpuPath, reference_path, solids_of};
use crate::state::{SolveReport, SolveStatus, State};

use super::bench_accuracy::{Answer, Done, sub_step};
use super::bench_solve::name;
use super::plane_strain::{PlaneStrain, TABLE_6_5, TABLE_6_6};
use super::statistics::Spread;
use super::table::{Machine, log_range, write_csv, write_json, write_svg};

/// Relative, of the true residuals: far below every error.
const TOLERANCE: f64 = 1e-10;
const MOST_ITERATIONS: u32 = 20_000;
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

/// A table of the thesis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ThesisTable {
    /// A soft block, narrower than at rest.
    T6_5,
    /// A stiff one, wider than at rest.
    T6_6,
}

impl ThesisTable {
    /// Its number.
    pub fn number(self) -> &'static str {
        match self {
            ThesisTable::T6_5 => "6.5",
            ThesisTable::T6_6 => "6.6",
        }
    }

    /// Its problem.
    pub fn problem(self) -> PlaneStrain {
        match self {
            ThesisTable::T6_5 => TABLE_6_5,
            ThesisTable::T6_6 => TABLE_6_6,
        }
    }

    fn printed(self) -> &'static Printed {
        match self {
            ThesisTable::T6_5 => &PRINTED_6_5,
            ThesisTable::T6_6 => &PRINTED_6_6,
        }
    }
}

/// What to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Tables.
    pub tables: Vec<ThesisTable>,
    /// Cells along the tank's height of 1 m, ascending multiples of 5.
    pub grids: Vec<usize>,
    /// Of the device, beside the f64 path; those that the adapter lacks are left out.
    pub precisions: Vec<Precision>,
    /// Timed sub-steps per row.
    pub repeats: usize,
    /// Where.
    pub adapter: AdapterChoice,
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

/// A row of thesis_orders.csv: orders of convergence over cell sizes of 0.1 to 0.0125.
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
    /// Least order from one grid to the next, of p.
    pub least_p: f64,
    /// Of v.
    pub least_v: f64,
    /// Of u.
    pub least_u: f64,
}

/// The tables and where they were measured.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// Where.
    #[serde(flatten)]
    pub machine: Machine,
    /// A row per table, grid, patch pressure and path.
    pub rows: Vec<Row>,
    /// A row per series of at least two grids, and the thesis's own.
    pub orders: Vec<Order>,
}

/// One way to do the sub-step of one problem on one grid.
struct Case<'a> {
    table: ThesisTable,
    grid: usize,
    scene: &'a Scene,
    /// At rest, deformed.
    state: &'a State,
}

/// What errors count: unknowns and open faces beside them, as the f64 path has them.
struct Mask {
    cells: Vec<bool>,
    faces: [Vec<bool>; 3],
}

/// Measures all rows and writes thesis.csv, thesis_orders.csv, thesis.json and thesis.svg into `out`; `tell` hears of each row.
///
/// # Errors
/// [`Error::Input`] for grids that the problem does not fit, [`Error::Output`], and what the simulations say.
pub fn bench_thesis(
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(&Row),
) -> Result<Table, Error> {
    for &grid in &options.grids {
        if !(5..=320).contains(&grid) || !grid.is_multiple_of(5) {
            return Err(Error::input(
                format!("--grids {grid}"),
                "the liquid's surface at 0.8 m and the walls do not lie on faces of such cells",
                "give multiples of 5 up to 320",
            ));
        }
    }
    fs::create_dir_all(out).map_err(|problem| Error::output(out, problem))?;
    let machine = Machine::new(&Gpu::new(&options.adapter)?, options.repeats)?;
    let mut rows = Vec::new();
    for &table in &options.tables {
        for patches in [PatchPressure::Cell, PatchPressure::Hydrostatic] {
            for &grid in &options.grids {
                for row in measure(table, patches, grid, options)? {
                    tell(&row);
                    rows.push(row);
                }
            }
        }
    }
    let orders = orders(&rows, &options.tables);
    let table = Table {
        machine,
        rows,
        orders,
    };
    write_csv(&table.rows, &out.join("thesis.csv"))?;
    write_csv(&table.orders, &out.join("thesis_orders.csv"))?;
    write_json(&table, &out.join("thesis.json"))?;
    let size = (1500, 460 * options.tables.len() as u32);
    write_svg(&out.join("thesis.svg"), size, |page| {
        draw(&table.rows, &options.tables, page)
    })?;
    Ok(table)
}

/// The rows of a problem on a grid: of the f64 path and of the device in each precision.
fn measure(
    table: ThesisTable,
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
    let problem = table.problem();
    let mut scene = problem.scene(grid, solver(Precision::F64))?;
    let mut path = reference_path(&scene)?;
    let mut state = path.state().clone();
    problem.deform(&solids_of(&scene)?, &mut state);
    let (mut seconds, mut done) = (Vec::new(), None);
    for _ in 0..options.repeats.max(1) {
        let found = reference_step(&mut path, &state)?;
        seconds.push(found.seconds);
        done = Some(found);
    }
    let mask = Mask::of(&path);
    let done = done.expect("there is at least one");
    let case = Case {
        table,
        grid,
        scene: &scene,
        state: &state,
    };
    let mut rows = vec![case.row("cpu", &mask, Spread::of(seconds), &done)];
    for &precision in &options.precisions {
        scene.solver = solver(precision);
        let case = Case {
            table,
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
        let mut seconds = Vec::new();
        for _ in 0..options.repeats.max(1) {
            done = sub_step(&mut path, case.state, density)?;
            seconds.push(done.seconds);
        }
        rows.push(case.row("gpu", &mask, Spread::of(seconds), &done));
    }
    Ok(rows)
}

/// The sub-step on the f64 path.
fn reference_step(path: &mut Reference, state: &State) -> Result<Done, Error> {
    path.reset(state.clone())?;
    let report = path.step(path.next_time_step())?;
    let solve = report.seconds.iter().find(|(stage, _)| *stage == "solve");
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

impl Mask {
    /// After a sub-step.
    fn of(path: &Reference) -> Mask {
        let (grid, cells) = (path.scene().grid(), &path.state().active);
        let open = &path.cut_cells().open;
        let faces = Axis::ALL.map(|axis| {
            let counts = |face: usize| {
                let mut sides = grid
                    .face_sides(axis, grid.face_at(axis, face))
                    .into_iter()
                    .flatten();
                open[axis.index()][face] > 0.0 && sides.any(|cell| cells[cell])
            };
            (0..grid.n_faces(axis)).map(counts).collect()
        });
        Mask {
            cells: cells.clone(),
            faces,
        }
    }
}

/// The largest magnitude of those that count.
fn largest<'a>(
    values: impl IntoIterator<Item = f64>,
    counts: impl IntoIterator<Item = &'a bool>,
) -> f64 {
    let values = values.into_iter().zip(counts);
    let counted = values.filter(|(_, counts)| **counts);
    counted.fold(0.0, |most, (value, _)| f64::max(most, value.abs()))
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
        let velocities = done.answer.velocity.as_flattened().iter();
        let faces = done.faces.iter().zip(&mask.faces);
        let faces = faces.map(|(faces, counts)| largest(faces.iter().copied(), counts));
        let errors = [
            largest(off, &mask.cells),
            velocities.fold(0.0, |most, v| f64::max(most, v.abs())),
            faces.fold(0.0, f64::max),
        ];
        let [error_p, error_v, error_u] = errors;
        let mut printed = self.table.printed().iter();
        let printed = printed.find(|(cells, _)| *cells == self.grid);
        let thesis = |of: usize| printed.map(|(_, errors)| errors[of]);
        let ratio = |of: usize| thesis(of).map(|printed| errors[of] / printed);
        let distance = self.table.problem().distance(grid.dx);
        let solves: Vec<SolveReport> = done.report.solves().collect();
        let converged = |solve: &&SolveReport| solve.status == SolveStatus::Converged;
        let failed = solves.iter().find(|solve| !converged(solve));
        Row {
            table: self.table.number(),
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
            thesis_p: thesis(0),
            thesis_v: thesis(1),
            thesis_u: thesis(2),
            ratio_p: ratio(0),
            ratio_v: ratio(1),
            ratio_u: ratio(2),
            distance,
            error_p_over_weight: error_p / (PlaneStrain::WEIGHT * distance),
            status: failed
                .map_or(SolveStatus::Converged, |solve| solve.status)
                .name(),
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

/// Errors of p, v, u per cell size, coarsest first, as orders.
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
    let logarithms = |of: usize| -> Vec<[f64; 2]> {
        let points = points.iter();
        points
            .map(|(grid, errors)| [-(*grid as f64).ln(), errors[of].ln()])
            .collect()
    };
    let fitted = |of: usize| {
        let points = logarithms(of);
        let n = points.len() as f64;
        let middle = [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / n);
        let offsets = points.iter().map(|[x, y]| [x - middle[0], y - middle[1]]);
        let sums = offsets.fold([0.0; 2], |[both, square], [x, y]| {
            [both + x * y, square + x * x]
        });
        sums[0] / sums[1]
    };
    let least = |of: usize| {
        let points = logarithms(of);
        let steps = points
            .windows(2)
            .map(|pair| (pair[1][1] - pair[0][1]) / (pair[1][0] - pair[0][0]));
        steps.fold(f64::INFINITY, f64::min)
    };
    Some(Order {
        table,
        backend,
        precision,
        patch_pressure,
        coarsest: first.0,
        finest: last.0,
        order_p: fitted(0),
        order_v: fitted(1),
        order_u: fitted(2),
        least_p: least(0),
        least_v: least(1),
        least_u: least(2),
    })
}

/// Of all series, and of the printed errors.
fn orders(rows: &[Row], tables: &[ThesisTable]) -> Vec<Order> {
    let mut orders = Vec::new();
    for table in tables {
        let number = table.number();
        orders.extend(order([number, "thesis", "", "cell"], table.printed()));
        let of_table: Vec<&Row> = rows.iter().filter(|row| row.table == number).collect();
        for series in series_of(&of_table) {
            let of_series = rows.iter().filter(|row| series.holds(row));
            let points = of_series.map(|row| (row.grid, [row.error_p, row.error_v, row.error_u]));
            let points: Vec<_> = points.collect();
            orders.extend(order(series.0, &points));
        }
    }
    orders
}

/// Table, backend, precision and patch pressure.
#[derive(Clone, Copy, PartialEq)]
struct Series([&'static str; 4]);

impl Series {
    fn of(row: &Row) -> Series {
        Series([row.table, row.backend, row.precision, row.patch_pressure])
    }

    fn holds(&self, row: &Row) -> bool {
        *self == Series::of(row)
    }

    fn label(&self) -> String {
        let [_, backend, precision, patches] = self.0;
        format!("{backend} {precision}, {patches}")
    }
}

/// Those of some rows, in their order.
fn series_of(rows: &[&Row]) -> Vec<Series> {
    let mut found: Vec<Series> = Vec::new();
    for row in rows {
        let series = Series::of(row);
        if !found.contains(&series) {
            found.push(series);
        }
    }
    found
}

/// What a chart is of.
struct Drawn {
    labels: [&'static str; 2],
    point: fn(&Row) -> (f64, f64),
    printed: fn(&Row) -> Option<f64>,
}

const CHARTS: [Drawn; 3] = [
    Drawn {
        labels: ["dx, m", "error of p, Pa"],
        point: |row| (row.dx, row.error_p),
        printed: |row| row.thesis_p,
    },
    Drawn {
        labels: ["dx, m", "error of v, m/s"],
        point: |row| (row.dx, row.error_v),
        printed: |row| row.thesis_v,
    },
    Drawn {
        labels: ["seconds of the solve", "error of p, Pa"],
        point: |row| (row.seconds_median, row.error_p),
        printed: |_| None,
    },
];

/// A line of charts per table: errors of p and of v against the cell size, with the printed ones, and of p against seconds.
fn draw(
    rows: &[Row],
    tables: &[ThesisTable],
    page: SVGBackend,
) -> Result<(), Box<dyn std::error::Error>> {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let charts = root.split_evenly((tables.len().max(1), CHARTS.len()));
    for (table, charts) in tables.iter().zip(charts.chunks(CHARTS.len())) {
        let number = table.number();
        let rows: Vec<&Row> = rows.iter().filter(|row| row.table == number).collect();
        for (drawn, chart) in CHARTS.iter().zip(charts) {
            let [x_label, y_label] = drawn.labels;
            let of_thesis = rows
                .iter()
                .filter_map(|row| Some(((drawn.point)(row).0, (drawn.printed)(row)?)));
            let of_thesis: Vec<(f64, f64)> = of_thesis.collect();
            let points = rows.iter().map(|row| (drawn.point)(row));
            let points: Vec<(f64, f64)> = points.chain(of_thesis.iter().copied()).collect();
            let mut chart = ChartBuilder::on(chart)
                .caption(format!("Table {number}"), ("sans-serif", 18))
                .margin(12)
                .x_label_area_size(44)
                .y_label_area_size(70)
                .build_cartesian_2d(
                    log_range(points.iter().map(|point| point.0)).log_scale(),
                    log_range(points.iter().map(|point| point.1)).log_scale(),
                )?;
            chart
                .configure_mesh()
                .x_desc(x_label)
                .x_labels(6)
                .max_light_lines(1)
                .x_label_formatter(&|x| format!("{x:.1e}"))
                .y_desc(y_label)
                .y_label_formatter(&|error| format!("{error:.0e}"))
                .draw()?;
            if !of_thesis.is_empty() {
                chart
                    .draw_series(
                        of_thesis
                            .iter()
                            .map(|&at| Cross::new(at, 6, BLACK.stroke_width(2))),
                    )?
                    .label("printed")
                    .legend(|(x, y)| Cross::new((x + 10, y), 5, BLACK.stroke_width(2)));
            }
            for (index, series) in series_of(&rows).iter().enumerate() {
                let of_series = rows.iter().filter(|row| series.holds(row));
                let points = of_series.map(|row| (drawn.point)(row));
                let colour = Palette99::pick(index).to_rgba();
                chart
                    .draw_series(LineSeries::new(points, colour.stroke_width(2)).point_size(3))?
                    .label(series.label())
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour));
            }
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::LowerLeft)
                .border_style(BLACK)
                .background_style(WHITE.mix(0.8))
                .draw()?;
        }
    }
    root.present()?;
    Ok(())
}
