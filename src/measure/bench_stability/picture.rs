//! The map of the matrix: a line per case, coloured by its verdict, with its energy, its worst element and its volume.

use plotters::prelude::*;

use super::{Row, Table};

const LINE: i32 = 17;
const HEAD: i32 = 74;
const WIDTH: u32 = 1180;
/// Left ends of the columns: verdict, name, energy, worst det F, volume, what happened.
const COLUMNS: [i32; 6] = [12, 34, 240, 460, 620, 800];
/// Of a bar, pixels.
const BAR: f64 = 130.0;

/// Of the page, pixels.
pub(super) fn size(table: &Table) -> (u32, u32) {
    let lines = table.rows.len() + table.limits.len() + 2;
    (WIDTH, HEAD as u32 + lines as u32 * LINE as u32)
}

type Drawn = Result<(), Box<dyn std::error::Error>>;

struct Page<'a>(DrawingArea<SVGBackend<'a>, plotters::coord::Shift>);

impl Page<'_> {
    fn text(&self, text: &str, at: (i32, i32), size: i32) -> Drawn {
        let style = ("sans-serif", size);
        self.0.draw(&Text::new(text.to_owned(), at, style))?;
        Ok(())
    }

    fn bar(&self, (x, y): (i32, i32), length: f64, colour: &RGBColor) -> Drawn {
        let length = (length.clamp(0.0, 1.0) * BAR).round() as i32;
        let corners = [(x, y + 2), (x + length, y + LINE - 4)];
        self.0
            .draw(&Rectangle::new(corners, colour.mix(0.7).filled()))?;
        Ok(())
    }

    fn verdict(&self, passed: bool, y: i32) -> Drawn {
        let [x, ..] = COLUMNS;
        let corners = [(x, y + 1), (x + 16, y + LINE - 3)];
        let colour = colour_of(passed);
        self.0.draw(&Rectangle::new(corners, colour.filled()))?;
        Ok(())
    }
}

fn colour_of(passed: bool) -> RGBColor {
    match passed {
        true => RGBColor(46, 139, 87),
        false => RGBColor(200, 40, 40),
    }
}

/// Draws it.
pub(super) fn draw(table: &Table, page: SVGBackend) -> Drawn {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let page = Page(root);
    let failed = table.rows.iter().filter(|row| !row.passed).count()
        + table.limits.iter().filter(|row| !row.passed).count();
    let all = table.rows.len() + table.limits.len();
    let where_ = match table.adapter.as_str() {
        "" => "the f64 path",
        adapter => adapter,
    };
    page.text(
        &format!("Stability: {} of {all} cases pass, {where_}", all - failed),
        (COLUMNS[0], 10),
        20,
    )?;
    let heads = [
        "",
        "case",
        "largest energy over the start's",
        "least det F",
        "volume, least to largest",
        "",
    ];
    for (head, x) in heads.iter().zip(COLUMNS) {
        page.text(head, (x, 46), 13)?;
    }
    let mut y = HEAD;
    let mut group = "";
    for row in &table.rows {
        if row.group != group {
            group = row.group;
            let line = [(COLUMNS[0], y - 1), (WIDTH as i32 - 12, y - 1)];
            page.0
                .draw(&PathElement::new(line, RGBColor(170, 170, 170)))?;
        }
        of_row(&page, row, y)?;
        y += LINE;
    }
    y += LINE;
    for row in &table.limits {
        page.verdict(row.passed, y)?;
        page.text(&row.name, (COLUMNS[1], y), 12)?;
        let got = format!(
            "weak coupling, m_a/m_s = {:.4}, {:.2} of the limit: grows by {:.4} a sub-step, formula {:.4}",
            row.ratio, row.over_limit, row.got, row.expected
        );
        page.text(&got, (COLUMNS[2], y), 12)?;
        y += LINE;
    }
    page.0.present()?;
    Ok(())
}

fn of_row(page: &Page, row: &Row, y: i32) -> Drawn {
    let [_, name, energy, det, volume, text] = COLUMNS;
    page.verdict(row.passed, y)?;
    page.text(&row.name, (name, y), 12)?;
    // 1 is the energy of the start, the end of the bar a hundred times it.
    let decades = row.energy_ratio.max(1.0).log10() / 2.0;
    let within = row.energy_ratio <= row.energy_bound;
    page.bar((energy, y), 0.02 + decades, &colour_of(within))?;
    let numbers = format!("{:.3} (to {:.2})", row.energy_ratio, row.energy_bound);
    page.text(&numbers, (energy + 70, y), 12)?;
    page.bar((det, y), row.min_det, &RGBColor(70, 110, 180))?;
    page.text(&format!("{:.3}", row.min_det), (det + 70, y), 12)?;
    let volumes = format!("{:.3} to {:.3}", row.volume_least, row.volume_most);
    page.text(&volumes, (volume, y), 12)?;
    let first_line = row.status.lines().next().unwrap_or_default();
    let happened = match row.passed && row.status == "completed" {
        true => row.varies.clone(),
        false => first_line.to_owned(),
    };
    page.text(&happened, (text, y), 12)
}
