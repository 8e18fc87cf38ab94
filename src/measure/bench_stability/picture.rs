//! The map of the matrix: a line per case, coloured by its verdict, with its energy, its speeds, its worst element and its volume.

use plotters::prelude::*;

use super::{Place, Row, Table};

const LINE: i32 = 17;
const HEAD: i32 = 74;
const WIDTH: u32 = 1620;
/// Left ends of the columns: verdict, name, energy, energy of motion and strain, speed of nodes, of liquid, worst det F, volume, what happened.
const COLUMNS: [i32; 9] = [12, 34, 220, 400, 515, 630, 745, 860, 1060];
const GOOD: RGBColor = RGBColor(46, 139, 87);
/// Of a case that passes, though sub-steps missed a tolerance or left contacts unsettled.
const MISSED: RGBColor = RGBColor(230, 160, 20);
const BAD: RGBColor = RGBColor(200, 40, 40);
/// Of a bar, pixels.
const BAR: f64 = 60.0;
/// From the left end of a bar to the number beside it.
const BESIDE: i32 = 68;
/// From the top of a line to that of its text, which brings it to the height of the bars.
const DOWN: i32 = 3;

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

    /// What a value is of its bound.
    fn share(&self, (x, y): (i32, i32), value: f64, most: f64) -> Drawn {
        let share = match most > 0.0 {
            true => value / most,
            false => 0.0,
        };
        self.bar((x, y), share.max(0.02), &colour_of(value <= most))?;
        self.text(&format!("{share:.3}"), (x + BESIDE, y + DOWN), 12)
    }

    fn verdict(&self, colour: &RGBColor, y: i32) -> Drawn {
        let [x, ..] = COLUMNS;
        let corners = [(x, y + 1), (x + 16, y + LINE - 3)];
        self.0.draw(&Rectangle::new(corners, colour.filled()))?;
        Ok(())
    }
}

fn colour_of(passed: bool) -> RGBColor {
    match passed {
        true => GOOD,
        false => BAD,
    }
}

fn colour_of_row(row: &Row) -> RGBColor {
    match row.passed && row.missed + row.unsettled > 0 {
        true => MISSED,
        false => colour_of(row.passed),
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
    let where_ = match &table.place {
        Place::Gpu(machine) => machine.adapter.as_str(),
        Place::Cpu(_) => "the f64 path",
    };
    page.text(
        &format!(
            "Stability: {} of {all} cases pass, {where_}{}",
            all - failed,
            match table.rows.iter().any(|row| colour_of_row(row) == MISSED) {
                true =>
                    "; yellow: with sub-steps that missed a tolerance or left contacts unsettled",
                false => "",
            }
        ),
        (COLUMNS[0], 10),
        20,
    )?;
    let heads = [
        "",
        "case",
        "largest energy (its bound)",
        "motion, of bound",
        "nodes, of bound",
        "liquid, of bound",
        "least det F",
        "volume; markers lost",
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
        page.verdict(&colour_of(row.passed), y)?;
        page.text(&row.name, (COLUMNS[1], y + DOWN), 12)?;
        let got = format!(
            "weak coupling, m_a/m_s = {:.4}, {:.2} of the limit: grows by {:.4} a sub-step, expected {:.4}",
            row.ratio, row.over_limit, row.got, row.expected
        );
        page.text(&got, (COLUMNS[2], y + DOWN), 12)?;
        y += LINE;
    }
    page.0.present()?;
    Ok(())
}

fn of_row(page: &Page, row: &Row, y: i32) -> Drawn {
    let [_, name, energy, motion, nodes, liquid, det, volume, text] = COLUMNS;
    page.verdict(&colour_of_row(row), y)?;
    page.text(&row.name, (name, y + DOWN), 12)?;
    // From the energy of the start to what it may come to.
    let gained = (row.energy_ratio - 1.0) / (row.energy_bound - 1.0);
    let within = row.energy_ratio <= row.energy_bound;
    page.bar((energy, y), gained.max(0.02), &colour_of(within))?;
    let numbers = format!("{:.3} (to {:.2})", row.energy_ratio, row.energy_bound);
    page.text(&numbers, (energy + BESIDE, y + DOWN), 12)?;
    page.share((motion, y), row.motion, row.motion_bound)?;
    page.share((nodes, y), row.solid_speed, row.solid_speed_bound)?;
    page.share((liquid, y), row.liquid_speed, row.liquid_speed_bound)?;
    page.bar((det, y), row.min_det, &RGBColor(70, 110, 180))?;
    page.text(&format!("{:.3}", row.min_det), (det + BESIDE, y + DOWN), 12)?;
    let mut volumes = format!("{:.3} to {:.3}", row.volume_least, row.volume_most);
    if row.lost >= 5e-4 {
        volumes += &format!(", lost {:.1} %", 100.0 * row.lost);
    }
    page.text(&volumes, (volume, y + DOWN), 12)?;
    let first_line = row.status.lines().next().unwrap_or_default();
    let plain = row.completed() && row.missed + row.unsettled == 0;
    let happened = match row.passed && plain {
        true => row.varies.clone(),
        false => first_line.to_owned(),
    };
    page.text(&happened, (text, y + DOWN), 12)
}
