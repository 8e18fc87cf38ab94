//! thesis.svg: a line of charts per table but table 6.1, each with the printed numbers as crosses.

use plotters::prelude::*;

use super::accuracy::{Row, series_of};
use super::systems::{Mean, plain};
use super::{Table, ThesisTable};
use crate::measure::chart::ink;
use crate::measure::table::log_range;

/// Charts beside each other.
const COLUMNS: usize = 3;
const CHART: (u32, u32) = (520, 460);
/// What a legend needs of a chart's height, over what lines do, and at least as a factor.
const ROOM: f64 = 0.7;
const LEAST_ROOM: f64 = 4.0;
/// Points of the axis along x that are written, at most.
const MOST_KEYS: usize = 8;
/// Room between two of them, of the logarithm of the axis: as wide as six digits are.
const KEYS_APART: f64 = 0.12;

/// A chart.
pub(super) struct Chart {
    caption: String,
    labels: [&'static str; 2],
    lines: Vec<(String, Vec<(f64, f64)>)>,
    printed: Vec<(String, Vec<(f64, f64)>)>,
    /// Whether the legend stands above what is drawn, or below.
    legend_above: bool,
}

/// What a chart of tables 6.5 and 6.6 is of.
struct OfErrors {
    labels: [&'static str; 2],
    point: fn(&Row) -> (f64, f64),
    printed: fn(&Row) -> Option<f64>,
}

const OF_ERRORS: [OfErrors; COLUMNS] = [
    OfErrors {
        labels: ["dx, m", "error of p, Pa"],
        point: |row| (row.dx, row.error_p),
        printed: |row| row.thesis_p,
    },
    OfErrors {
        labels: ["dx, m", "error of v, m/s"],
        point: |row| (row.dx, row.error_v),
        printed: |row| row.thesis_v,
    },
    OfErrors {
        labels: ["seconds of the solve", "error of p, Pa"],
        point: |row| (row.seconds_median, row.error_p),
        printed: |_| None,
    },
];

/// Lines of charts, one after another.
pub(super) fn charts(table: &Table, tables: &[ThesisTable]) -> Vec<Vec<Chart>> {
    let mut lines: Vec<Vec<Chart>> = Vec::new();
    for &number in tables {
        let of_systems = |quantity, label, nodes| of_systems(table, number, quantity, label, nodes);
        lines.push(match number {
            // Scenes differ in more than their size: they are no line.
            ThesisTable::T6_1 => continue,
            ThesisTable::T6_2 => vec![
                of_systems("nonzeros", "nonzeros", None),
                of_systems("log10_condest", "condition number, 1-norm", None),
                of_systems("seconds", "seconds of the solve", None),
            ],
            ThesisTable::T6_3 => [135, 725]
                .map(|nodes| of_systems("frame_seconds", "seconds per frame", Some(nodes)))
                .into(),
            ThesisTable::T6_4 => [135, 725]
                .map(|nodes| of_systems("nonzeros", "nonzeros", Some(nodes)))
                .into(),
            ThesisTable::T6_5 | ThesisTable::T6_6 => {
                let drawn = OF_ERRORS.iter();
                drawn
                    .map(|drawn| of_errors(&table.rows, number, drawn))
                    .collect()
            }
        });
    }
    lines
}

fn of_errors(rows: &[Row], table: ThesisTable, drawn: &OfErrors) -> Chart {
    let series = series_of(rows, table.number()).into_iter();
    let lines = series.map(|series| {
        let of_series = rows.iter().filter(|row| series.holds(row));
        (series.label(), of_series.map(drawn.point).collect())
    });
    let mut printed: Vec<(f64, f64)> = Vec::new();
    for row in rows.iter().filter(|row| row.table == table.number()) {
        let point = (drawn.printed)(row).map(|error| ((drawn.point)(row).0, error));
        printed.extend(point.filter(|point| !printed.contains(point)));
    }
    Chart {
        caption: format!("Table {}", table.number()),
        labels: drawn.labels,
        lines: lines.collect(),
        printed: vec![("printed".to_owned(), printed)],
        legend_above: false,
    }
}

/// A quantity against the grid; `nodes`: of the beam, where the table has several.
fn of_systems(
    table: &Table,
    number: ThesisTable,
    quantity: &str,
    label: &'static str,
    nodes: Option<usize>,
) -> Chart {
    let value = |value| plain(quantity, value);
    let drawn = |mean: &&Mean| {
        mean.table == number.number() && mean.quantity == quantity && mean.series().0 == nodes
    };
    let (mut lines, mut printed) = (Vec::new(), Vec::new());
    let means: Vec<&Mean> = table.means.iter().filter(drawn).collect();
    for mean in &means {
        let [form, solver, backend, precision] = mean.series().1;
        let label = match solver {
            "" => form.to_owned(),
            _ => format!("{backend} {precision}, {form}, {solver}"),
        };
        push(&mut lines, label, (mean.grid as f64, value(mean.mean)));
        // The device's and others of the same form have the same printed number.
        if let (Some(thesis), true) = (mean.thesis, mean.backend == "cpu" && form != "condensed") {
            let label = format!("printed, {form}");
            push(&mut printed, label, (mean.grid as f64, value(thesis)));
        }
    }
    let caption = match nodes {
        Some(nodes) => format!("Table {}, {nodes} nodes", number.number()),
        None => format!("Table {}", number.number()),
    };
    Chart {
        caption,
        labels: ["cells along an edge", label],
        lines,
        printed,
        legend_above: true,
    }
}

fn push(lines: &mut Vec<(String, Vec<(f64, f64)>)>, label: String, point: (f64, f64)) {
    match lines.iter_mut().find(|line| line.0 == label) {
        Some((_, points)) if points.contains(&point) => {}
        Some((_, points)) => points.push(point),
        None => lines.push((label, vec![point])),
    }
}

/// Of the page, in pixels.
pub(super) fn size(charts: &[Vec<Chart>]) -> (u32, u32) {
    (COLUMNS as u32 * CHART.0, charts.len() as u32 * CHART.1)
}

/// Draws a line of charts per table.
pub(super) fn draw(
    charts: &[Vec<Chart>],
    page: SVGBackend,
) -> Result<(), Box<dyn std::error::Error>> {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let places = root.split_evenly((charts.len(), COLUMNS));
    for (line, places) in charts.iter().zip(places.chunks(COLUMNS)) {
        for (chart, place) in line.iter().zip(places) {
            draw_chart(chart, place)?;
        }
    }
    root.present()?;
    Ok(())
}

fn draw_chart(
    chart: &Chart,
    place: &DrawingArea<SVGBackend, plotters::coord::Shift>,
) -> Result<(), Box<dyn std::error::Error>> {
    let all = || chart.lines.iter().chain(&chart.printed);
    let points: Vec<(f64, f64)> = all().flat_map(|(_, points)| points.clone()).collect();
    if points.is_empty() {
        return Ok(());
    }
    let [x_label, y_label] = chart.labels;
    let x = log_range(points.iter().map(|point| point.0));
    let mut y = log_range(points.iter().map(|point| point.1));
    let room = (y.end / y.start).powf(ROOM).max(LEAST_ROOM);
    let position = match chart.legend_above {
        true => {
            y.end *= room;
            SeriesLabelPosition::UpperLeft
        }
        false => {
            y.start /= room;
            SeriesLabelPosition::LowerLeft
        }
    };
    let keys = keys(&points, &x);
    let mut axes = ChartBuilder::on(place)
        .caption(&chart.caption, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(70)
        .build_cartesian_2d(x.log_scale().with_key_points(keys), y.log_scale())?;
    let whole = chart.labels[0].starts_with("cells");
    axes.configure_mesh()
        .x_desc(x_label)
        .max_light_lines(1)
        .x_label_formatter(&|x| match whole {
            true => format!("{x:.0}"),
            false => {
                let text = format!("{x:.4}");
                text.trim_end_matches('0').trim_end_matches('.').to_owned()
            }
        })
        .y_desc(y_label)
        .y_label_formatter(&|y| format!("{y:.0e}"))
        .draw()?;
    for (index, (label, points)) in chart.printed.iter().enumerate() {
        if points.is_empty() {
            continue;
        }
        let colour = [BLACK, RGBColor(130, 130, 130)][index % 2];
        axes.draw_series(LineSeries::new(points.iter().copied(), colour.mix(0.4)))?;
        let crosses = points
            .iter()
            .map(|&at| Cross::new(at, 6, colour.stroke_width(2)));
        axes.draw_series(crosses)?
            .label(label)
            .legend(move |(x, y)| Cross::new((x + 10, y), 5, colour.stroke_width(2)));
    }
    for (index, (label, points)) in chart.lines.iter().enumerate() {
        let colour = ink(index);
        let line = LineSeries::new(points.iter().copied(), colour.stroke_width(2));
        // Lines that lie on each other show.
        let line = line.point_size(2 + (chart.lines.len() - index) as u32);
        axes.draw_series(line)?
            .label(label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour));
    }
    axes.configure_series_labels()
        .position(position)
        .border_style(BLACK)
        .background_style(WHITE.mix(0.8))
        .draw()?;
    Ok(())
}

/// Where the axis along x is written at: where points are, or at powers of ten where they are many.
fn keys(points: &[(f64, f64)], range: &std::ops::Range<f64>) -> Vec<f64> {
    let mut keys: Vec<f64> = points.iter().map(|point| point.0).collect();
    keys.sort_by(f64::total_cmp);
    keys.dedup();
    if keys.len() > MOST_KEYS {
        let powers = (-9..9).map(|power| 10.0_f64.powi(power));
        keys = powers.filter(|key| range.contains(key)).collect();
    }
    // Seconds of small grids lie close to each other.
    let apart = (range.end / range.start).powf(KEYS_APART);
    let mut last = 0.0;
    keys.retain(|&key| {
        let has_room = key >= last * apart;
        if has_room {
            last = key;
        }
        has_room
    });
    keys
}
