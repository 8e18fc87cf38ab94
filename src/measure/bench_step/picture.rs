//! The stages of sub-steps, one upon another.

use plotters::prelude::*;

use super::super::chart::{Area, Failure, ink};
use super::{Row, StageRow, Table};

/// Bars side by side.
const BARS: usize = 8;
/// Of a panel with as many.
const PANEL: (u32, u32) = (1340, 460);

/// Width and height of the page.
pub(super) fn size(table: &Table) -> (u32, u32) {
    let (width, height) = PANEL;
    (width, height * panels(table).len().max(1) as u32)
}

/// The rows of each panel: of one scene.
fn panels(table: &Table) -> Vec<&[Row]> {
    let scenes = table.rows.chunk_by(|a, b| a.scene == b.scene);
    scenes.flat_map(|rows| rows.chunks(BARS)).collect()
}

/// A bar per row: the stages' seconds one above another, and a mark at those of the wall clock.
pub(super) fn draw(table: &Table, page: SVGBackend) -> Result<(), Failure> {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let mut names: Vec<&'static str> = Vec::new();
    for row in &table.stages {
        if !names.contains(&row.stage) {
            names.push(row.stage);
        }
    }
    let panels = panels(table);
    for (area, rows) in root.split_evenly((panels.len(), 1)).iter().zip(panels) {
        draw_panel(table, rows, &names, area)?;
    }
    root.present()?;
    Ok(())
}

fn draw_panel(
    table: &Table,
    rows: &[Row],
    names: &[&'static str],
    area: &Area<'_>,
) -> Result<(), Failure> {
    let of_row = |row: &Row| -> Vec<&StageRow> {
        let stages = table.stages.iter();
        stages.filter(|stage| stage.belongs_to(row)).collect()
    };
    let milliseconds = |seconds: f64| 1e3 * seconds;
    let top = rows
        .iter()
        .map(|row| {
            let sum: f64 = of_row(row).iter().map(|stage| stage.seconds_median).sum();
            milliseconds(sum.max(row.seconds_median))
        })
        .fold(0.0, f64::max);
    let scene = rows.first().map_or("", |row| &row.scene);
    let caption = format!("{scene}: a sub-step, {}", table.machine.adapter);
    // The right part is for the names of the stages, the upper one for what a bar is of.
    let mut chart = ChartBuilder::on(area)
        .caption(caption, ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(10)
        .y_label_area_size(80)
        .build_cartesian_2d(0.0..BARS as f64 + 1.3, 0.0..1.3 * top)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .disable_x_axis()
        .y_desc("ms a sub-step")
        .draw()?;
    for (index, &stage) in names.iter().enumerate() {
        let colour = ink(index);
        let bars = rows.iter().enumerate().filter_map(|(number, row)| {
            let stages = of_row(row);
            let at = stages.iter().position(|other| other.stage == stage)?;
            let below: f64 = stages[..at].iter().map(|stage| stage.seconds_median).sum();
            let height = stages[at].seconds_median;
            let x = number as f64;
            Some(Rectangle::new(
                [
                    (x + 0.2, milliseconds(below)),
                    (x + 0.8, milliseconds(below + height)),
                ],
                colour.filled(),
            ))
        });
        chart
            .draw_series(bars)?
            .label(stage)
            .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 14, y + 5)], colour.filled()));
    }
    for (number, row) in rows.iter().enumerate() {
        let x = number as f64;
        let y = milliseconds(row.seconds_median);
        chart.draw_series([PathElement::new(
            [(x + 0.1, y), (x + 0.9, y)],
            BLACK.stroke_width(2),
        )])?;
        let sum: f64 = of_row(row).iter().map(|stage| stage.seconds_median).sum();
        let above = y.max(milliseconds(sum));
        let lines = match row.nodes {
            0 => vec![format!("{} cells", row.cells)],
            nodes => vec![
                format!("{} cells", row.cells),
                format!("{nodes} nodes, {}", row.kind),
            ],
        };
        let lines = [format!("{y:.1} ms")]
            .into_iter()
            .chain(lines.into_iter().rev());
        for (line, text) in lines.enumerate() {
            let at = (x + 0.1, above + (0.06 + 0.06 * line as f64) * top);
            chart.draw_series([Text::new(text, at, ("sans-serif", 13))])?;
        }
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::MiddleRight)
        .border_style(BLACK)
        .background_style(WHITE)
        .draw()?;
    Ok(())
}
