//! The picture of the effects.

use std::path::Path;

use plotters::prelude::*;

use crate::Error;

use super::super::chart::{Failure, ink};
use super::super::table::write_svg;
use super::{ABSENT, Row, pairs};

/// Pixels of a row: its label is 12 high.
const ROW: u32 = 20;
/// Pixels beside the rows: caption, axis and margins.
const FRAME: u32 = 120;

/// Draws what each effect adds, in milliseconds: a bar from the first to the third quartile with the median, per scene and effect that was
/// measured, and one for all that are absent; grey where it is not told apart from nothing.
///
/// # Errors
/// [`Error::Output`].
pub(super) fn write(rows: &[Row], path: &Path) -> Result<(), Error> {
    let drawn = rows
        .iter()
        .filter(|row| row.present || row.effect == ABSENT);
    let measured: Vec<(&Row, [f64; 3])> = drawn
        .filter_map(|row| Some((row, row.quartiles()?.map(|seconds| 1e3 * seconds))))
        .collect();
    let height = FRAME + ROW * measured.len() as u32;
    write_svg(path, (900, height), |page| draw(&measured, page))
}

fn draw(measured: &[(&Row, [f64; 3])], page: SVGBackend) -> Result<(), Failure> {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let ends = measured
        .iter()
        .flat_map(|(_, [low, _, high])| [*low, *high]);
    let (least, most) = ends.fold((0.0, 1e-3), |(least, most), x| {
        (f64::min(least, x), f64::max(most, x))
    });
    let margin = 0.05 * (most - least);
    let mut chart = ChartBuilder::on(&root)
        .caption("what effects add to a sub-step", ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(220)
        .build_cartesian_2d(
            least - margin..most + margin,
            (0..measured.len()).into_segmented(),
        )?;
    let label = |at: &SegmentValue<usize>| match at {
        SegmentValue::CenterOf(at) | SegmentValue::Exact(at) => {
            measured.get(*at).map_or(String::new(), |(row, _)| {
                format!("{}: {}", row.scene, row.effect)
            })
        }
        SegmentValue::Last => String::new(),
    };
    chart
        .configure_mesh()
        .disable_y_mesh()
        .x_desc("ms")
        .y_labels(measured.len().max(1))
        .y_label_formatter(&label)
        .draw()?;
    for (at, (row, [low, median, high])) in measured.iter().enumerate() {
        let (bottom, top) = (SegmentValue::Exact(at), SegmentValue::Exact(at + 1));
        let colour = match row.seconds_told == pairs::NOTHING {
            true => BLACK.mix(0.2),
            false => ink(at).mix(0.6),
        };
        let bar = Rectangle::new([(*low, bottom), (*high, top)], colour.filled());
        chart.draw_series([bar])?;
        let line = [
            (*median, SegmentValue::Exact(at)),
            (*median, SegmentValue::Exact(at + 1)),
        ];
        chart.draw_series([PathElement::new(line, BLACK)])?;
    }
    root.present()?;
    Ok(())
}
