//! The page of the validation: summary, fraction of the allowed error of each row, charts with their references, table.

use std::collections::BTreeSet;
use std::error::Error;
use std::fs;
use std::io;
use std::path::Path;

use cutwater::output::drawing::ink;
use plotters::prelude::*;
use serde::{Deserialize, Serialize};

use crate::sheet::{COLUMNS, Row};

/// How a line of a chart is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Mark {
    /// Computed, as a line.
    Line,
    /// Computed, as points.
    Points,
    /// A theory, as a line.
    Theory,
    /// Measurements or other programs' results, as circles.
    Measured,
}

/// One line of a chart.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Line {
    pub(crate) label: String,
    pub(crate) mark: Mark,
    pub(crate) points: Vec<[f64; 2]>,
}

impl Line {
    pub(crate) fn new(label: impl Into<String>, mark: Mark, points: Vec<[f64; 2]>) -> Line {
        let label = label.into();
        Line { label, mark, points }
    }
}

/// Computed and expected values.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Chart {
    /// Case.
    pub(crate) id: String,
    pub(crate) title: String,
    pub(crate) axes: [String; 2],
    pub(crate) lines: Vec<Line>,
}

/// Page and pictures into a folder, for rows and charts in the order of the cases.
pub(crate) fn write(folder: &Path, rows: &[Row], charts: &[Chart], summary: &str) -> Result<(), Box<dyn Error>> {
    let mut page = format!("# Validation\n\n{summary}\n\n");
    if rows.iter().any(|row| row.passed.is_some()) {
        page += "Error over the allowed error, a mark per row. Marks right of the line are failures and drawn as crosses. A ring is a property in words: \
                 at the left end it holds.\n\n![](glance.svg)\n\n";
    }
    write_pictures(folder, rows, charts)?;
    for (number, chart) in charts.iter().enumerate() {
        let name = picture(charts, number);
        page += &format!("![{}: {}]({name})\n\n", chart.id, chart.title);
    }
    page += &format!("| {} |\n", COLUMNS.join(" | "));
    page += &format!("|{}\n", "---|".repeat(COLUMNS.len()));
    for row in rows {
        let cells = row.cells().map(|cell| cell.replace('|', "\\|"));
        page += &format!("| {} |\n", cells.join(" | "));
    }
    fs::write(folder.join("validation.md"), page)?;
    Ok(())
}

/// glance.svg of all judged rows, and a file per chart.
pub(crate) fn write_pictures(folder: &Path, rows: &[Row], charts: &[Chart]) -> Result<(), Box<dyn Error>> {
    let judged: Vec<&Row> = rows.iter().filter(|row| row.passed.is_some()).collect();
    if !judged.is_empty() {
        glance(&folder.join("glance.svg"), &judged)?;
    }
    for (number, chart) in charts.iter().enumerate() {
        draw(&folder.join(picture(charts, number)), chart)?;
    }
    Ok(())
}

/// Removes the charts of the cases in `old`, and those of no case in `ids`.
pub(crate) fn remove_charts(folder: &Path, old: &BTreeSet<&str>, ids: &BTreeSet<&str>) -> io::Result<()> {
    let files = |ids: &BTreeSet<&str>| -> BTreeSet<String> { ids.iter().map(|id| file_stem(id)).collect() };
    let (old, ids) = (files(old), files(ids));
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        if path.extension().is_none_or(|end| end != "svg") || name == "glance" {
            continue;
        }
        // The second chart of F11 is F11-2.
        let first = name.rsplit_once('-').filter(|(_, nth)| nth.parse::<usize>().is_ok());
        let case = match ids.contains(&*name) {
            true => &*name,
            false => first.map_or(&*name, |(case, _)| case),
        };
        if old.contains(case) || !ids.contains(case) {
            fs::remove_file(path)?;
        }
    }
    Ok(())
}

fn file_stem(id: &str) -> String {
    id.replace('/', "-")
}

/// File of a chart: F11.svg, the second of a case F11-2.svg, and A1-mixed.svg of A1/mixed.
fn picture(charts: &[Chart], number: usize) -> String {
    let id = &charts[number].id;
    let before = charts[..number].iter().filter(|other| other.id == *id);
    let nth = match before.count() {
        0 => String::new(),
        n => format!("-{}", n + 1),
    };
    format!("{}{nth}.svg", file_stem(id))
}

/// A line per case, variants on one, a mark per row: error over what is allowed, logarithmic. Rows without such a share are at the ends.
fn glance(path: &Path, rows: &[&Row]) -> Result<(), Box<dyn Error>> {
    let mut cases: Vec<&str> = Vec::new();
    for row in rows {
        if !cases.contains(&row.case()) {
            cases.push(row.case());
        }
    }
    let n = cases.len() as u32;
    let root = SVGBackend::new(path, (1000, 120 + 16 * n)).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .caption("Error over what is allowed", ("sans-serif", 18))
        .margin(12)
        .top_x_label_area_size(30)
        .x_label_area_size(36)
        .y_label_area_size(190)
        .build_cartesian_2d((1e-6..1e2).log_scale(), 0.0..f64::from(n))?;
    chart
        .configure_mesh()
        .disable_y_mesh()
        .max_light_lines(0)
        .y_labels(0)
        .x_label_formatter(&|share| format!("{share:.0e}"))
        .draw()?;
    let bound = [(1.0, 0.0), (1.0, f64::from(n))];
    chart.draw_series([PathElement::new(bound, BLACK.stroke_width(2))])?;
    for (line, case) in cases.iter().enumerate() {
        let y = f64::from(n) - line as f64 - 0.5;
        for row in rows.iter().filter(|row| row.case() == *case) {
            let passed = row.passed == Some(true);
            // Failures without a bound, and NaN, are at the right end.
            let share = row.share.filter(|share| !share.is_nan());
            let without = if passed { 0.0 } else { 80.0 };
            let at = (share.unwrap_or(without).clamp(1.2e-6, 80.0), y);
            let mark = match (passed, share) {
                (true, Some(_)) => Circle::new(at, 4, ink(3).mix(0.4).filled()).into_dyn(),
                (true, None) => Circle::new(at, 6, ink(3).stroke_width(1)).into_dyn(),
                (false, _) => Cross::new(at, 5, RED.stroke_width(2)).into_dyn(),
            };
            chart.draw_series([mark])?;
        }
        let at = chart.backend_coord(&(1e-6, y));
        let style = ("sans-serif", 12).into_font();
        root.draw(&Text::new((*case).to_owned(), (14, at.1 - 6), style))?;
    }
    root.present()?;
    Ok(())
}

fn draw(path: &Path, chart: &Chart) -> Result<(), Box<dyn Error>> {
    let points = || chart.lines.iter().flat_map(|line| &line.points);
    // Room on the right for the key.
    let range = |axis: usize, beyond: f64| {
        let ends = points().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], point| {
            [low.min(point[axis]), high.max(point[axis])]
        });
        let span = (ends[1] - ends[0]).max(1e-12);
        ends[0] - 0.05 * span..ends[1] + beyond * span
    };
    let root = SVGBackend::new(path, (960, 480)).into_drawing_area();
    root.fill(&WHITE)?;
    let mut area = ChartBuilder::on(&root)
        .caption(format!("{}: {}", chart.id, chart.title), ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(80)
        .build_cartesian_2d(range(0, 0.6), range(1, 0.05))?;
    let number = |x: &f64| match x.abs() {
        0.0 => "0".to_owned(),
        1e-3..1e4 => format!("{x:.3}").trim_end_matches('0').trim_end_matches('.').to_owned(),
        _ => format!("{x:.1e}"),
    };
    area.configure_mesh()
        .x_desc(chart.axes[0].as_str())
        .y_desc(chart.axes[1].as_str())
        .x_label_formatter(&number)
        .y_label_formatter(&number)
        .max_light_lines(1)
        .draw()?;
    for (index, line) in chart.lines.iter().enumerate() {
        let colour = match line.mark {
            Mark::Theory | Mark::Measured => BLACK.to_rgba(),
            Mark::Line | Mark::Points => ink(index),
        };
        let points = line.points.iter().map(|point| (point[0], point[1]));
        match line.mark {
            Mark::Line | Mark::Theory => {
                let style = colour.stroke_width(if line.mark == Mark::Line { 2 } else { 1 });
                area.draw_series(LineSeries::new(points, style))?
                    .label(&line.label)
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], style));
            }
            Mark::Points | Mark::Measured => {
                let style = match line.mark {
                    Mark::Points => colour.filled(),
                    _ => colour.stroke_width(1),
                };
                area.draw_series(points.map(|point| Circle::new(point, 4, style)))?
                    .label(&line.label)
                    .legend(move |(x, y)| Circle::new((x + 10, y), 4, style));
            }
        }
    }
    area.configure_series_labels()
        .position(SeriesLabelPosition::MiddleRight)
        .border_style(BLACK)
        .background_style(WHITE.mix(0.8))
        .draw()?;
    root.present()?;
    Ok(())
}
