//! `plot`: probes and the step table of runs as charts over time, several runs over one another.

use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use plotters::prelude::*;

use crate::Error;
use crate::output::manifest::Manifest;

use super::drawing::{Area, Failure, ink, write_svg};
use super::report::EMPTY;

/// Pixels of a chart.
const SIZE: (u32, u32) = (620, 320);
/// Charts beside one another.
const ACROSS: usize = 2;

/// Charts of the step table: title, whether its axis is logarithmic, columns.
const OF_STEPS: [(&str, bool, &[&str]); 12] = [
    ("length of the sub-steps, s", false, &["dt"]),
    ("iterations", false, &["iterations", "solid_iterations", "solid_solves"]),
    ("true relative residuals", true, &["residual_p", "residual_v"]),
    ("largest divergence, 1/s", true, &["divergence"]),
    ("volume of the liquid over the volume to hold", false, &["volume_ratio"]),
    ("energies of the liquid, J", false, &["kinetic_energy", "potential_energy"]),
    ("energies of the solids, J", false, &["solid_kinetic_energy", "solid_elastic_energy", "solid_potential_energy"]),
    ("largest speeds, m/s", false, &["max_speed", "solid_max_speed"]),
    ("momentum of the liquid, kg m/s", false, &["momentum_x", "momentum_y", "momentum_z"]),
    ("force of the liquid on the solids, N", false, &["force_x", "force_y", "force_z"]),
    ("least det F", false, &["min_det_f"]),
    ("seconds of a sub-step", false, &["seconds_total", "seconds_solve"]),
];

/// A table of a run: its columns by their names.
pub(crate) struct Run {
    /// In the keys of the charts; empty where there is one run.
    pub(crate) name: String,
    /// Abscissas, such as times, s.
    pub(crate) times: Vec<f64>,
    /// Names and values of the columns.
    pub(crate) columns: Vec<(String, Vec<Option<f64>>)>,
}

/// A chart of columns over time.
pub(crate) struct Chart {
    pub(crate) title: String,
    pub(crate) logarithmic: bool,
    pub(crate) columns: Vec<String>,
    /// Name of the abscissa with its unit.
    pub(crate) across: &'static str,
}

const TIME: &str = "t, s";

/// Draws `steps.svg` and, where the scenes have probes, `probes.svg` of runs into a folder; the files.
///
/// # Errors
/// [`Error::Input`] where a folder holds no run or its tables are broken; [`Error::Output`].
pub fn plot(runs: &[PathBuf], out: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut files = Vec::new();
    let mut pages = Vec::new();
    let steps = tables(runs, "steps.csv")?;
    if steps.is_empty() {
        let what = runs.first().map_or(String::new(), |run| run.display().to_string());
        let cure = "give the folder of a run, which has steps.csv";
        return Err(Error::input(what, "no run to plot", cure));
    }
    let charts = OF_STEPS.into_iter().map(|(title, logarithmic, columns)| {
        let there = columns.iter().filter(|column| {
            let mut runs = steps.iter();
            runs.any(|run| run.column(column).is_some())
        });
        Chart {
            title: title.to_owned(),
            logarithmic,
            columns: there.map(|column| (*column).to_owned()).collect(),
            across: TIME,
        }
    });
    let charts: Vec<Chart> = charts.filter(|chart| !chart.columns.is_empty()).collect();
    pages.push(("steps.svg", steps, charts));
    let (probes, charts) = probe_charts(runs)?;
    if !charts.is_empty() {
        pages.push(("probes.svg", probes, charts));
    }
    for (name, runs, charts) in pages {
        let charts: Vec<(&Chart, &[Run])> = charts.iter().map(|chart| (chart, &*runs)).collect();
        files.push(write_page(out, name, &charts)?);
    }
    Ok(files)
}

/// Draws `probes.svg` with the chosen probes or columns only; the file.
///
/// # Errors
/// [`Error::Input`] as of [`plot`], and for a name that no run has; [`Error::Output`].
pub fn plot_probes(runs: &[PathBuf], chosen: &[String], out: &Path) -> Result<PathBuf, Error> {
    let (probes, mut charts) = probe_charts(runs)?;
    let probe = |column: &str| {
        let end = ["_x", "_y", "_z"].iter().find_map(|end| column.strip_suffix(end));
        end.unwrap_or(column).to_owned()
    };
    let is = |name: &String, column: &String| *name == *column || *name == probe(column);
    let columns: Vec<String> = charts.iter().flat_map(|chart| chart.columns.clone()).collect();
    if let Some(name) = chosen.iter().find(|name| !columns.iter().any(|column| is(name, column))) {
        let problem = format!("no run has a probe \"{name}\"");
        let cure = match columns.is_empty() {
            true => "the runs have no probes: add a [[probe]] to the scene".to_owned(),
            false => format!("choose among {}", columns.join(", ")),
        };
        return Err(Error::input("--probes", problem, cure));
    }
    for chart in &mut charts {
        chart.columns.retain(|column| chosen.iter().any(|name| is(name, column)));
    }
    charts.retain(|chart| !chart.columns.is_empty());
    let charts: Vec<(&Chart, &[Run])> = charts.iter().map(|chart| (chart, &*probes)).collect();
    write_page(out, "probes.svg", &charts)
}

/// Folders of runs: those of the finished runs in place of the folder of a sweep.
///
/// # Errors
/// [`Error::Input`] for a sweep without a finished run, and for a broken summary.csv.
pub fn with_sweeps(folders: &[PathBuf]) -> Result<Vec<PathBuf>, Error> {
    let mut runs = Vec::new();
    for folder in folders {
        let summary = folder.join("summary.csv");
        if folder.join("manifest.json").is_file() || !summary.is_file() {
            runs.push(folder.clone());
            continue;
        }
        let refused = |problem: String| {
            let cure = "run `cutwater sweep` again, which writes it";
            Error::input(summary.display().to_string(), problem, cure)
        };
        let mut table = csv::Reader::from_path(&summary).map_err(|p| refused(p.to_string()))?;
        let heads = table.headers().map_err(|p| refused(p.to_string()))?;
        let place = |name: &str| heads.iter().position(|head| head == name);
        let (Some(status), Some(name)) = (place("status"), place("folder")) else {
            return Err(refused("has no columns `status` and `folder`".to_owned()));
        };
        let before = runs.len();
        for row in table.records() {
            let row = row.map_err(|problem| refused(problem.to_string()))?;
            if row.get(status) == Some("finished") {
                runs.push(folder.join(row.get(name).unwrap_or_default()));
            }
        }
        if runs.len() == before {
            return Err(refused("has no finished run".to_owned()));
        }
    }
    Ok(runs)
}

/// The tables of probes, and a chart of each probe.
fn probe_charts(runs: &[PathBuf]) -> Result<(Vec<Run>, Vec<Chart>), Error> {
    let probes = tables(runs, "probes.csv")?;
    let units = runs.iter().filter_map(|run| Manifest::read(run).ok());
    let units = units.flat_map(|manifest| manifest.probe_units).collect();
    let charts = of_probes(&probes, &units);
    Ok((probes, charts))
}

/// Writes charts, each with its runs, into a file of a folder.
pub(crate) fn write_page(out: &Path, name: &str, charts: &[(&Chart, &[Run])]) -> Result<PathBuf, Error> {
    fs::create_dir_all(out).map_err(|problem| Error::unwritten(out, &problem))?;
    let path = out.join(name);
    let lines = charts.len().div_ceil(ACROSS);
    let size = (SIZE.0 * ACROSS as u32, SIZE.1 * lines as u32);
    write_svg(&path, size, |root| {
        let areas = root.split_evenly((lines, ACROSS));
        areas.iter().zip(charts).try_for_each(|(area, (chart, runs))| draw(area, chart, runs))
    })?;
    Ok(path)
}

/// A table of each run that has it.
fn tables(runs: &[PathBuf], file: &str) -> Result<Vec<Run>, Error> {
    let several = runs.len() > 1;
    let mut tables = Vec::new();
    for run in runs {
        if !run.join("steps.csv").is_file() {
            let cure = "give the folder of a run, which has steps.csv";
            return Err(Error::input(run.display().to_string(), "it holds no run", cure));
        }
        let path = run.join(file);
        if path.is_file() {
            let name = match several {
                true => run.file_name().unwrap_or(run.as_os_str()).to_string_lossy().into_owned(),
                false => String::new(),
            };
            tables.push(Run::read(&path, name)?);
        }
    }
    Ok(tables)
}

impl Run {
    /// Reads a table. Cells without a finite number are empty.
    pub(crate) fn read(path: &Path, name: String) -> Result<Run, Error> {
        let broken = |problem: &dyn std::fmt::Display| {
            let cure = "run the scene again, or move the file elsewhere";
            Error::input(path.display().to_string(), format!("cannot be read: {problem}"), cure)
        };
        let mut reader = csv::Reader::from_path(path).map_err(|problem| broken(&problem))?;
        let heads = reader.headers().map_err(|problem| broken(&problem))?;
        let mut columns: Vec<(String, Vec<Option<f64>>)> =
            heads.iter().map(|head| (head.to_owned(), Vec::new())).collect();
        if columns.is_empty() {
            return Err(broken(&EMPTY));
        }
        for record in reader.records() {
            let record = record.map_err(|problem| broken(&problem))?;
            for ((_, column), cell) in columns.iter_mut().zip(&record) {
                let number = cell.parse().ok();
                column.push(number.filter(|number: &f64| number.is_finite()));
            }
        }
        let times = columns.iter().find(|(head, _)| head == "t");
        let times = times.and_then(|(_, column)| column.iter().copied().collect());
        Ok(Run { name, times: times.ok_or_else(|| broken(&"a row has no time t"))?, columns })
    }

    fn column(&self, name: &str) -> Option<&[Option<f64>]> {
        let (_, column) = self.columns.iter().find(|(head, _)| head == name)?;
        Some(column)
    }

    /// Times and values of a column, where it has any.
    fn points(&self, name: &str, logarithmic: bool) -> Vec<(f64, f64)> {
        let column = self.column(name).unwrap_or_default();
        let points = self.times.iter().zip(column);
        let points = points.filter_map(|(t, value)| Some((*t, (*value)?)));
        points.filter(|(_, value)| !logarithmic || *value > 0.0).collect()
    }
}

/// A chart per probe, its unit in the title: the components of a vector together.
fn of_probes(runs: &[Run], units: &BTreeMap<String, String>) -> Vec<Chart> {
    let mut charts: Vec<Chart> = Vec::new();
    for (head, _) in runs.iter().flat_map(|run| &run.columns) {
        if head == "step" || head == "t" {
            continue;
        }
        let component = ["_x", "_y", "_z"].iter().find_map(|end| head.strip_suffix(end));
        let title = component.unwrap_or(head);
        match charts.iter_mut().find(|chart| chart.title == title) {
            Some(chart) if chart.columns.contains(head) => {}
            Some(chart) => chart.columns.push(head.clone()),
            None => charts.push(Chart {
                title: title.to_owned(),
                logarithmic: false,
                columns: vec![head.clone()],
                across: TIME,
            }),
        }
    }
    for chart in &mut charts {
        if let Some(unit) = units.get(&chart.columns[0]) {
            chart.title += &format!(", {unit}");
        }
    }
    charts
}

/// How numbers of a range are written at its ticks: with so many digits that neighbours differ; what only rounding keeps from 0 is 0.
fn ticks(range: &Range<f64>) -> impl Fn(&f64) -> String + use<> {
    let span = range.end - range.start;
    let largest = range.start.abs().max(range.end.abs());
    // About ten ticks: the digit after that of the span tells them apart.
    let digits = |of: f64| (1.0 + (of / span).log10().ceil()).clamp(0.0, 15.0) as usize;
    let (decimals, digits) = (digits(1.0) + 1, digits(largest));
    move |x: &f64| match x.abs() {
        x if x < 1e-6 * span => "0".to_owned(),
        _ if (1e-3..1e5).contains(&largest) => {
            let text = format!("{x:.decimals$}");
            match text.contains('.') {
                true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
                false => text,
            }
        }
        _ => format!("{x:.digits$e}"),
    }
}

/// From the least to the largest with some room, and more on the right of the times, for the key.
fn range(values: impl Iterator<Item = f64> + Clone, beyond: f64) -> Option<Range<f64>> {
    let least = values.clone().fold(f64::INFINITY, f64::min);
    let most = values.fold(f64::NEG_INFINITY, f64::max);
    let span = match most - least {
        // Smaller differences are rounding, and ticks would need all digits.
        span if span > 1e-9 * most.abs().max(least.abs()) => span,
        _ => most.abs().max(1.0),
    };
    (least <= most).then_some(least - 0.05 * span..most + beyond * span)
}

fn draw(area: &Area, chart: &Chart, runs: &[Run]) -> Result<(), Failure> {
    let Chart { title, logarithmic, columns, across } = chart;
    let mut lines = Vec::new();
    for run in runs {
        for column in columns {
            let points = run.points(column, *logarithmic);
            if !points.is_empty() {
                let label = match run.name.is_empty() {
                    true => column.clone(),
                    false => format!("{}: {column}", run.name),
                };
                lines.push((label, points));
            }
        }
    }
    let all = || lines.iter().flat_map(|(_, points)| points);
    let of_values = match logarithmic {
        true => range(all().map(|point| point.1.log10()), 0.05),
        false => range(all().map(|point| point.1), 0.05),
    };
    let (Some(x), Some(y)) = (range(all().map(|point| point.0), 0.5), of_values) else {
        return Ok(());
    };
    let mut builder = ChartBuilder::on(area);
    builder
        .caption(title, ("sans-serif", 16))
        .margin(10)
        // Half of a tick label, where the last tick is at the end of the axis.
        .margin_right(30)
        .x_label_area_size(36)
        // The longest label has 16 characters: all digits that tell ticks of a narrow range apart.
        .y_label_area_size(110);
    let (of_times, of_values) = (ticks(&x), ticks(&y));
    // Within a decade ticks differ by less than their first digit.
    let digits = usize::from(y.end - y.start < 1.0);
    let power = |y: &f64| format!("{:.digits$e}", 10.0_f64.powf(*y));
    let mut chart = builder.build_cartesian_2d(x, y)?;
    let mut mesh = chart.configure_mesh();
    mesh.x_desc(*across).max_light_lines(1).x_label_formatter(&of_times);
    match logarithmic {
        true => mesh.y_label_formatter(&power).draw()?,
        false => mesh.y_label_formatter(&of_values).draw()?,
    }
    for (index, (label, points)) in lines.into_iter().enumerate() {
        let colour = ink(index);
        let points = points.into_iter().map(|(t, value)| match logarithmic {
            true => (t, value.log10()),
            false => (t, value),
        });
        chart
            .draw_series(LineSeries::new(points, colour.stroke_width(2)))?
            .label(label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .border_style(BLACK)
        .background_style(WHITE.mix(0.8))
        .draw()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::ticks;

    #[test]
    fn ticks_differ_and_nought_is_nought() {
        for (range, x, text) in [
            (0.0..1.0, 0.25, "0.25"),
            (0.0..1.0, 1e-17, "0"),
            (0.0..100.0, 30.0, "30"),
            (0.0..0.3, 0.15, "0.15"),
            (0.12..0.1203, 0.1201, "0.1201"),
            (0.12..0.1203, 0.1202, "0.1202"),
            (0.0..2e-5, 1.5e-5, "1.5e-5"),
            (-3e6..3e6, -2e6, "-2.0e6"),
            (1e6..1.0003e6, 1.0002e6, "1.00020e6"),
        ] {
            assert_eq!(ticks(&range)(&x), text, "{range:?}");
        }
        for span in [1e-9, 1e-4, 0.7, 3.0, 1e4, 1e9] {
            for start in [0.0, 1.0, 100.0 * span] {
                let range = start..start + span;
                let tick = ticks(&range);
                let texts: Vec<String> = (0..=10).map(|n| tick(&(start + 0.1 * f64::from(n) * span))).collect();
                let differ = texts.windows(2).all(|pair| pair[0] != pair[1]);
                assert!(differ, "{range:?}: {texts:?}");
            }
        }
    }
}
