//! Error against seconds of the solve.

use plotters::prelude::*;

use super::super::chart::{Failure, Point, chart, series};
use super::super::statistics::Spread;
use super::grids::{self, GridRow};
use super::states::{Row, states};

/// An error of a row, by its name.
type Named<T> = (&'static str, fn(&T) -> f64);

const SECONDS: &str = "seconds of the solve";

/// An error and the seconds that it takes.
fn point(seconds: Spread, error: f64) -> Point {
    Point {
        x: seconds,
        y: Spread::exact(error),
    }
}

/// Charts of a state.
const OF_A_STATE: [Named<Row>; 4] = [
    ("error of p", |row| row.error_p),
    ("error of v", |row| row.error_v),
    ("error of u, against the f64 path", |row| row.step_error_u),
    ("divergence, 1/s", |row| row.divergence),
];

/// Pixels of the page of states.
pub(super) fn size_of_states(rows: &[Row]) -> (u32, u32) {
    let lines = states(rows).len() * OF_A_STATE.len() / 2;
    (1200, 480 * lines as u32)
}

/// Two lines of charts per state: of pressure and velocities against the stored system, and of what the sub-step comes to.
pub(super) fn draw_states(rows: &[Row], page: SVGBackend) -> Result<(), Failure> {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let states = states(rows);
    let charts = root.split_evenly((states.len() * OF_A_STATE.len() / 2, 2));
    let label = |row: &Row| {
        format!(
            "{} {} {}",
            row.precision, row.preconditioner, row.formulation
        )
    };
    for ((scene, frame), charts) in states.iter().zip(charts.chunks(OF_A_STATE.len())) {
        for ((name, error), area) in OF_A_STATE.iter().zip(charts) {
            let here = |row: &&Row| row.scene == *scene && row.frame == *frame;
            let lines = series(rows.iter().filter(here), label, |row| {
                point(row.seconds(), error(row))
            });
            let caption = format!("{scene}, frame {frame}");
            let key = SeriesLabelPosition::LowerLeft;
            chart(area, &caption, [SECONDS, name], key, &lines)?;
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
    let errors: [Named<GridRow>; 2] = [
        ("error of p over the largest p", |row| row.error_p),
        ("speed over g dt", |row| row.error_u.unwrap_or(0.0)),
    ];
    for (problem, charts) in problems.iter().zip(charts.chunks(2)) {
        for ((name, error), area) in errors.iter().zip(charts) {
            let here = rows.iter().filter(|row| row.problem == *problem);
            let lines = series(here, label, |row| point(row.seconds(), error(row)));
            let key = SeriesLabelPosition::LowerLeft;
            chart(area, problem, [SECONDS, name], key, &lines)?;
        }
    }
    root.present()?;
    Ok(())
}
