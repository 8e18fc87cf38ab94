//! Error against seconds, both logarithmic.

use std::ops::Range;

use plotters::coord::Shift;
use plotters::prelude::*;

use super::grids::{self, GridRow};
use super::states::{Row, states};

/// A point with the spread of its seconds.
struct Point {
    seconds: [f64; 3],
    error: f64,
}

/// Points under one name in the key.
struct Series {
    label: String,
    points: Vec<Point>,
}

type Failure = Box<dyn std::error::Error>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Least and largest with some room, of a logarithmic axis.
fn range(values: impl Iterator<Item = f64>) -> Range<f64> {
    let ends = values.fold([f64::INFINITY, 0.0], |[least, most], value| {
        [f64::min(least, value), f64::max(most, value)]
    });
    ends[0] / 1.5..ends[1] * 1.5
}

/// Of those with an error above 0; nothing where there is none.
fn chart(area: &Area, caption: &str, error: &str, series: &[Series]) -> Result<(), Failure> {
    let points = || series.iter().flat_map(|series| &series.points);
    if points().next().is_none() {
        return Ok(());
    }
    let mut chart = ChartBuilder::on(area)
        .caption(caption, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(70)
        .build_cartesian_2d(
            range(points().flat_map(|point| point.seconds)).log_scale(),
            range(points().map(|point| point.error)).log_scale(),
        )?;
    chart
        .configure_mesh()
        .x_desc("seconds of the solve")
        .x_labels(6)
        .max_light_lines(1)
        .x_label_formatter(&|seconds| format!("{seconds:.1e}"))
        .y_desc(error)
        .y_label_formatter(&|error| format!("{error:.0e}"))
        .draw()?;
    for (index, Series { label, points }) in series.iter().enumerate() {
        let colour = Palette99::pick(index).to_rgba();
        let line = points.iter().map(|point| (point.seconds[0], point.error));
        chart
            .draw_series(LineSeries::new(line, colour.stroke_width(2)).point_size(3))?
            .label(label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour));
        for point in points {
            let spread = [1, 2].map(|end| (point.seconds[end], point.error));
            chart.draw_series([PathElement::new(spread, colour)])?;
        }
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerLeft)
        .border_style(BLACK)
        .background_style(WHITE.mix(0.8))
        .draw()?;
    Ok(())
}

/// The points of rows by what they are called, in the order of the names' first appearance.
fn series<'a, T: 'a>(
    rows: impl Iterator<Item = &'a T>,
    label: impl Fn(&T) -> String,
    point: impl Fn(&T) -> Point,
) -> Vec<Series> {
    let mut all: Vec<Series> = Vec::new();
    for row in rows {
        let (name, point) = (label(row), point(row));
        if !(point.error > 0.0) {
            continue;
        }
        match all.iter_mut().find(|series| series.label == name) {
            Some(series) => series.points.push(point),
            None => all.push(Series {
                label: name,
                points: vec![point],
            }),
        }
    }
    all
}

/// A line of charts per state: of the pressure and of the velocities.
pub(super) fn draw_states(rows: &[Row], page: SVGBackend) -> Result<(), Failure> {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let states = states(rows);
    let charts = root.split_evenly((states.len(), 2));
    let label = |row: &Row| {
        format!(
            "{} {} {}",
            row.precision, row.preconditioner, row.formulation
        )
    };
    let errors: [(&str, fn(&Row) -> f64); 2] = [
        ("error of p", |row| row.error_p),
        ("error of v", |row| row.error_v),
    ];
    for ((scene, frame), charts) in states.iter().zip(charts.chunks(2)) {
        for ((name, error), area) in errors.iter().zip(charts) {
            let here = rows
                .iter()
                .filter(|row| row.scene == *scene && row.frame == *frame);
            let point = |row: &Row| Point {
                seconds: [row.seconds_median, row.seconds_min, row.seconds_max],
                error: error(row),
            };
            let caption = format!("{scene}, frame {frame}");
            chart(area, &caption, name, &series(here, label, point))?;
        }
    }
    root.present()?;
    Ok(())
}

/// A line of charts per problem: of the pressure, and of speeds where there should be none.
pub(super) fn draw_grids(rows: &[GridRow], page: SVGBackend) -> Result<(), Failure> {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let problems = grids::problems(rows);
    let charts = root.split_evenly((problems.len(), 2));
    let label = |row: &GridRow| format!("{} cells/m, {}", row.grid, row.precision);
    let errors: [(&str, fn(&GridRow) -> f64); 2] = [
        ("error of p over the largest p", |row| row.error_p),
        ("speed over g dt", |row| row.error_u.unwrap_or(0.0)),
    ];
    for (problem, charts) in problems.iter().zip(charts.chunks(2)) {
        for ((name, error), area) in errors.iter().zip(charts) {
            let here = rows.iter().filter(|row| row.problem == *problem);
            let point = |row: &GridRow| Point {
                seconds: [row.seconds_median, row.seconds_min, row.seconds_max],
                error: error(row),
            };
            chart(area, problem, name, &series(here, label, point))?;
        }
    }
    root.present()?;
    Ok(())
}
