//! Seconds against unknowns.

use plotters::prelude::*;

use super::super::chart::{Failure, Point, chart, series};
use super::super::statistics::Spread;
use super::{Row, Table};

/// A line per solver on the device, and per solver on the CPU beside it.
pub(super) fn draw(table: &Table, page: SVGBackend) -> Result<(), Failure> {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let beam = |bricks: Option<usize>| match bricks {
        Some(across) => format!(", beam {across} across"),
        None => String::new(),
    };
    let label = |row: &Row| {
        let Row {
            formulation,
            preconditioner,
            precision,
            ..
        } = row;
        format!(
            "{formulation} {preconditioner} {precision}{}",
            beam(row.bricks)
        )
    };
    let mut lines = series(&table.rows, label, |row| Point {
        x: Spread::exact(f64::from(row.active_cells)),
        y: Spread {
            median: row.seconds_median,
            min: row.seconds_min,
            max: row.seconds_max,
        },
    });
    let found = table
        .against
        .iter()
        .filter(|row| row.seconds_median.is_some());
    lines.extend(series(
        found,
        |row| {
            format!(
                "{} {} on the CPU{}",
                row.formulation,
                row.rival,
                beam(row.bricks)
            )
        },
        |row| Point {
            x: Spread::exact(f64::from(row.active_cells)),
            y: Spread {
                median: row.seconds_median.unwrap_or(0.0),
                min: row.seconds_min.unwrap_or(0.0),
                max: row.seconds_max.unwrap_or(0.0),
            },
        },
    ));
    let caption = format!("Solve, {}", table.machine.adapter);
    let axes = ["active cells", "seconds"];
    chart(
        &root,
        &caption,
        axes,
        SeriesLabelPosition::UpperLeft,
        &lines,
    )?;
    root.present()?;
    Ok(())
}
