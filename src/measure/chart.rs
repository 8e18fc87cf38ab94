//! Charts with two logarithmic axes: lines through medians, with bars from least to largest.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::statistics::Spread;
use super::table::log_range;

/// What goes wrong in a drawing.
pub(super) type Failure = Box<dyn std::error::Error>;
/// A part of a page.
pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// A point; one of both has a width, as a rule.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub(super) x: Spread,
    pub(super) y: Spread,
}

impl Point {
    /// Whether a logarithmic chart has a place for it.
    fn has_place(&self) -> bool {
        let ends = [self.x.min, self.x.max, self.y.min, self.y.max];
        ends.iter().all(|end| *end > 0.0 && end.is_finite())
    }
}

/// Colour of a line, which can be read on white: twelve, then these again.
pub fn ink(index: usize) -> RGBAColor {
    const READABLE: [usize; 12] = [0, 1, 12, 3, 4, 5, 10, 7, 16, 14, 18, 19];
    Palette99::pick(READABLE[index % READABLE.len()]).to_rgba()
}

/// Points under one name in the key.
#[derive(Clone, Debug)]
pub(super) struct Series {
    pub(super) label: String,
    pub(super) points: Vec<Point>,
}

/// The points of rows that have a place, by what the rows are called, in the order of the names' first appearance.
pub(super) fn series<'a, T: 'a>(
    rows: impl IntoIterator<Item = &'a T>,
    label: impl Fn(&T) -> String,
    point: impl Fn(&T) -> Point,
) -> Vec<Series> {
    let mut all: Vec<Series> = Vec::new();
    for row in rows {
        let (label, point) = (label(row), point(row));
        if !point.has_place() {
            continue;
        }
        match all.iter_mut().find(|series| series.label == label) {
            Some(series) => series.points.push(point),
            None => all.push(Series {
                label,
                points: vec![point],
            }),
        }
    }
    all
}

/// A chart of series, its axes named; nothing where there is no point. The key stands on the left, where the axis begins early enough.
pub(super) fn chart(
    area: &Area,
    caption: &str,
    [x, y]: [&str; 2],
    key: SeriesLabelPosition,
    series: &[Series],
) -> Result<(), Failure> {
    let points = || series.iter().flat_map(|series| &series.points);
    if points().next().is_none() {
        return Ok(());
    }
    let x_range = log_range(points().flat_map(|point| [point.x.min, point.x.max]));
    let x_range = x_range.start * (x_range.start / x_range.end).powf(0.7)..x_range.end;
    let mut chart = ChartBuilder::on(area)
        .caption(caption, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(70)
        .build_cartesian_2d(
            x_range.log_scale(),
            log_range(points().flat_map(|point| [point.y.min, point.y.max])).log_scale(),
        )?;
    chart
        .configure_mesh()
        .x_desc(x)
        .x_labels(8)
        .max_light_lines(1)
        .x_label_formatter(&|x| format!("{x:.1e}"))
        .y_desc(y)
        .y_label_formatter(&|y| format!("{y:.0e}"))
        .draw()?;
    for (index, Series { label, points }) in series.iter().enumerate() {
        let colour = ink(index);
        let line = points.iter().map(|point| (point.x.median, point.y.median));
        chart
            .draw_series(LineSeries::new(line, colour.stroke_width(2)).point_size(3))?
            .label(label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour));
        for Point { x, y } in points {
            let bars = [
                [(x.min, y.median), (x.max, y.median)],
                [(x.median, y.min), (x.median, y.max)],
            ];
            let bars = bars.map(|ends| PathElement::new(ends, colour));
            chart.draw_series(bars)?;
        }
    }
    chart
        .configure_series_labels()
        .position(key)
        .border_style(BLACK)
        .background_style(WHITE.mix(0.8))
        .draw()?;
    Ok(())
}
