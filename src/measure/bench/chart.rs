//! Pictures of benches: charts with two logarithmic axes, and bar charts.

use std::ops::Range;
use std::path::Path;

use plotters::prelude::*;

use super::statistics::{Spread, grouped};
use super::table::Row;
use crate::Error;
use crate::measure::remove;
use crate::output::drawing::{Area, Failure, ink, write_svg};

/// A page of pictures.
#[derive(Clone, Debug)]
pub(crate) enum Page {
    /// Number of columns, and charts.
    Charts(usize, Vec<Chart>),
    /// Bar charts below each other.
    Bars(Vec<Bars>),
}

/// Lines over two logarithmic axes.
#[derive(Clone, Debug)]
pub(crate) struct Chart {
    pub(crate) title: String,
    pub(crate) axes: [&'static str; 2],
    /// Names and points.
    pub(crate) lines: Vec<(String, Vec<[Spread; 2]>)>,
    /// Whether the lines fall: the key is then below them.
    pub(crate) falling: bool,
}

/// Name of a bar, its parts (name, start, end), and the place of its mark.
pub(crate) type Bar = (String, Vec<(String, f64, f64)>, f64);

#[derive(Clone, Debug)]
pub(crate) struct Bars {
    pub(crate) title: String,
    pub(crate) axis: &'static str,
    pub(crate) bars: Vec<Bar>,
    /// Whether the parts have a key.
    pub(crate) key: bool,
}

/// Lines of rows by name, with two columns as points; those that a logarithmic chart cannot show are left out.
pub(crate) fn lines<'r>(
    rows: impl IntoIterator<Item = &'r Row>,
    name: impl Fn(&Row) -> String,
    columns: [&str; 2],
) -> Vec<(String, Vec<[Spread; 2]>)> {
    let value = |row: &Row, name| row.spread(name).unwrap_or_else(|| Spread::exact(row.number(name)));
    let point = |row: &Row| columns.map(|name| value(row, name));
    let shown = |row: &&Row| point(row).iter().all(|end| end.min > 0.0 && end.max.is_finite());
    let groups = grouped(rows.into_iter().filter(shown), |row| Some(name(row)));
    groups.into_iter().map(|(name, rows)| (name, rows.into_iter().map(point).collect())).collect()
}

impl Page {
    /// Writes the page; an empty page is no file.
    pub(super) fn write(&self, path: &Path) -> Result<(), Error> {
        match self {
            Page::Charts(across, charts) => {
                let charts: Vec<&Chart> = charts.iter().filter(|chart| !chart.lines.is_empty()).collect();
                if charts.is_empty() {
                    return remove(path);
                }
                let across = charts.len().min(*across);
                let down = charts.len().div_ceil(across);
                let width = if across == 1 { 900 } else { 580 * across as u32 };
                write_svg(path, (width, 480 * down as u32), |root| {
                    let areas = root.split_evenly((down, across));
                    areas.iter().zip(charts).try_for_each(|(area, chart)| chart.draw(area))
                })
            }
            Page::Bars(lists) => {
                let lists: Vec<&Bars> = lists.iter().filter(|list| !list.bars.is_empty()).collect();
                if lists.is_empty() {
                    return remove(path);
                }
                let heights: Vec<u32> = lists.iter().map(|list| list.height()).collect();
                write_svg(path, (1100, heights.iter().sum()), |root| {
                    let mut rest = root.clone();
                    for (list, height) in lists.into_iter().zip(heights) {
                        let (area, below) = rest.split_vertically(height);
                        list.draw(&area)?;
                        rest = below;
                    }
                    Ok(())
                })
            }
        }
    }
}

/// Range of a logarithmic axis of positive values.
fn log_range(values: impl Iterator<Item = f64> + Clone) -> Range<f64> {
    let least = values.clone().fold(f64::INFINITY, f64::min);
    least / 1.5..1.5 * values.fold(0.0, f64::max)
}

impl Chart {
    fn draw(&self, area: &Area) -> Result<(), Failure> {
        let points = || self.lines.iter().flat_map(|(_, points)| points);
        let [x, y] = [0, 1].map(|axis| log_range(points().flat_map(|point| [point[axis].min, point[axis].max])));
        // Room for the key beside the lines.
        let x = x.start * (x.start / x.end).powf(0.7)..x.end;
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, ("sans-serif", 18))
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(70)
            .build_cartesian_2d(x.log_scale(), y.log_scale())?;
        chart
            .configure_mesh()
            .x_desc(self.axes[0])
            .x_labels(8)
            .max_light_lines(1)
            .x_label_formatter(&|x| format!("{x:.1e}"))
            .y_desc(self.axes[1])
            .y_label_formatter(&|y| format!("{y:.0e}"))
            .draw()?;
        for (index, (name, points)) in self.lines.iter().enumerate() {
            let colour = ink(index);
            let line = points.iter().map(|[x, y]| (x.median, y.median));
            let line = LineSeries::new(line, colour.stroke_width(2));
            chart
                .draw_series(line.point_size(3))?
                .label(name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour));
            for [x, y] in points {
                let bars = [[(x.min, y.median), (x.max, y.median)], [(x.median, y.min), (x.median, y.max)]];
                chart.draw_series(bars.map(|ends| PathElement::new(ends, colour)))?;
            }
        }
        let position = if self.falling { SeriesLabelPosition::LowerLeft } else { SeriesLabelPosition::UpperLeft };
        key(chart.configure_series_labels().position(position))
    }
}

/// Two corners of the bar at a place.
fn side([from, to]: [f64; 2], at: usize) -> [(f64, SegmentValue<usize>); 2] {
    [(from, SegmentValue::Exact(at)), (to, SegmentValue::Exact(at + 1))]
}

fn key<'a, CT: CoordTranslate>(
    labels: &mut plotters::chart::SeriesLabelStyle<'a, '_, SVGBackend<'a>, CT>,
) -> Result<(), Failure> {
    labels.border_style(BLACK).background_style(WHITE.mix(0.8)).draw()?;
    Ok(())
}

impl Bars {
    /// Names of the parts, in the order of first appearance.
    fn parts(&self) -> Vec<&str> {
        let parts = self.bars.iter().flat_map(|(_, parts, _)| parts);
        grouped(parts, |part| Some(part.0.as_str())).into_iter().map(|(name, _)| name).collect()
    }

    /// Pixels.
    fn height(&self) -> u32 {
        let key = u32::from(self.key) * 18 * self.parts().len() as u32;
        110 + (20 * self.bars.len() as u32).max(key)
    }

    fn draw(&self, area: &Area) -> Result<(), Failure> {
        let parts = self.bars.iter().flat_map(|(_, parts, _)| parts);
        let ends = parts.flat_map(|part| [part.1, part.2]).chain(self.bars.iter().map(|bar| bar.2));
        let (least, most) = ends.fold((0.0, 1e-9), |(least, most), x| (f64::min(least, x), f64::max(most, x)));
        // Room for the key on the right.
        let right = most + (most - least) * if self.key { 0.35 } else { 0.05 };
        let n = self.bars.len();
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, ("sans-serif", 18))
            .margin(12)
            // Half of the widest tick label, where the last tick is at the end of the axis.
            .margin_right(40)
            .x_label_area_size(44)
            .y_label_area_size(300)
            .build_cartesian_2d(least - 0.02 * (most - least)..right, (0..n).into_segmented())?;
        let label = |at: &SegmentValue<usize>| match at {
            SegmentValue::CenterOf(at) if *at < n => self.bars[*at].0.clone(),
            _ => String::new(),
        };
        chart.configure_mesh().disable_y_mesh().x_desc(self.axis).y_labels(n).y_label_formatter(&label).draw()?;
        for (index, name) in self.parts().into_iter().enumerate() {
            let colour = if name.is_empty() { BLACK.mix(0.25) } else { ink(index).mix(0.7) };
            let bars = self.bars.iter().enumerate().flat_map(|(at, (_, parts, _))| {
                parts.iter().filter(|part| part.0 == name).map(move |&(_, from, to)| {
                    let mut bar = Rectangle::new(side([from, to], at), colour.filled());
                    bar.set_margin(2, 2, 0, 0);
                    bar
                })
            });
            let bars = chart.draw_series(bars.collect::<Vec<_>>())?;
            if self.key {
                bars.label(name).legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 14, y + 5)], colour.filled()));
            }
        }
        let mark = |(at, bar): (usize, &Bar)| PathElement::new(side([bar.2; 2], at), BLACK.stroke_width(2));
        chart.draw_series(self.bars.iter().enumerate().map(mark))?;
        match self.key {
            true => key(chart.configure_series_labels().position(SeriesLabelPosition::UpperRight)),
            false => Ok(()),
        }
    }
}
