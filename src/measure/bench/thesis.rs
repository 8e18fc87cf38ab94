//! `bench thesis`: tables of the thesis's chapter 6, printed and measured numbers.
//!
//! Table 6.1 (`scenes`): grids, meshes and sub-steps of the scenes. Tables 6.2 to 6.4 (`systems`): matrices and solves of the formulations on states
//! of the dam break. Tables 6.5 and 6.6 (`errors`): errors of a sub-step with a known solution.

mod errors;
mod scenes;
mod systems;

use std::path::PathBuf;

use super::chart::{Chart, Page, lines};
use super::statistics::grouped;
use super::table::{Row, Table, row};
use super::{Bench, Case, Listener, Machine, Results, Run, Settings, replace, rows};
use crate::Error;
use crate::gpu::{AdapterChoice, Gpu};
use crate::scene::Precision;

/// Relative, of the true residuals.
const TOLERANCE: f64 = 1e-10;
const MOST_ITERATIONS: u32 = 20_000;

/// Tables to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Numbers of tables, such as `6.2`.
    pub tables: Vec<String>,
    /// Cells along an edge of the dam break, or along the tank's height of 1 m; empty: each table's own.
    pub grids: Vec<usize>,
    /// Folder of the scenes of table 6.1.
    pub scenes: PathBuf,
    /// Factor of their cells along each axis.
    pub scale: f64,
    /// Timed sub-steps of each scene from its start, after one that compiles.
    pub steps: usize,
    /// Frames of the dam break whose states are solved from.
    pub frames: Vec<u64>,
    /// Precisions of the device beside the f64 path; those that the adapter lacks are skipped.
    pub precisions: Vec<Precision>,
    /// Adapter.
    pub adapter: AdapterChoice,
}

/// Tables of states of the dam break.
const SYSTEMS: [&str; 3] = ["6.2", "6.3", "6.4"];

impl Options {
    fn has(&self, table: &str) -> bool {
        self.tables.iter().any(|own| own == table)
    }

    /// Grids of a table. Default: those of the thesis that take minutes on two cores.
    fn grids(&self, table: &str) -> Vec<usize> {
        let own: &[usize] = match table {
            "6.1" => &[],
            "6.2" => &[40, 60],
            "6.3" | "6.4" => &[50, 60],
            _ => &[5, 10, 20, 40, 80],
        };
        if self.grids.is_empty() || own.is_empty() { own.to_vec() } else { self.grids.clone() }
    }

    fn check(&self) -> Result<(), Error> {
        for table in &self.tables {
            let systems = SYSTEMS.contains(&table.as_str());
            let ([least, most, unit], problem, cure) = if systems {
                let cure = "give cells from 8 to 256, such as those of the thesis: 40 to 90";
                ([8, 256, 1], "the dam break is too coarse or too large", cure)
            } else {
                let problem = "the liquid's surface at 0.8 m and the walls do not lie on faces of such cells";
                ([5, 320, 5], problem, "give multiples of 5 up to 320")
            };
            let fits = |grid: &usize| (least..=most).contains(grid) && grid.is_multiple_of(unit);
            if let Some(grid) = self.grids(table).into_iter().find(|grid| !fits(grid)) {
                return Err(Error::input(format!("--grids {grid} for table {table}"), problem, cure));
            }
            if systems {
                self.frames.iter().try_for_each(|&frame| systems::ensure_frame(frame))?;
            }
        }
        Ok(())
    }
}

/// Measures the selected tables: thesis_scenes.csv; thesis_systems.csv, thesis_means.csv, thesis_growth.csv; thesis.csv, thesis_orders.csv;
/// thesis.json, thesis.svg.
///
/// # Errors
/// [`Error::Input`] for grids and frames that the problems do not have, and missing scenes; [`Error::Output`]; errors of the simulations.
pub fn measure(options: &Options, settings: &Settings, listener: Listener) -> Result<Results, Error> {
    options.check()?;
    let gpu = Gpu::new(&options.adapter)?;
    let scenes = scenes::cases(options, gpu.has_f64())?;
    let bench = Bench {
        name: "thesis",
        tables: vec![
            Table::new("thesis", &[errors::ERRORS], &["table", "patch_pressure", "grid", "backend", "precision"]),
            Table::new("thesis_orders", &[errors::ORDERS], &[]),
            Table::new("thesis_scenes", &[scenes::SCENES], &["scene", "precision"]),
            Table::new(
                "thesis_systems",
                &[systems::SYSTEMS],
                &["table", "grid", "nodes", "frame", "formulation", "solver", "backend", "precision"],
            ),
            Table::new("thesis_means", &[systems::MEANS], &[]),
            Table::new("thesis_growth", &[systems::GROWTH], &[]),
        ],
        derive,
        pictures: &[("thesis", draw)],
    };
    let machine = Machine::new(&gpu, settings.repeats)?;
    let request = (options.scale, options.steps, &options.precisions);
    let mut run = Run::start(bench, machine, &request, settings, listener)?;
    run.cases(scenes)?;
    run.cases(systems::cases(options))?;
    let mut cases = Vec::new();
    for problem in errors::PROBLEMS.iter().filter(|problem| options.has(problem.table)) {
        for patches in errors::PATCHES {
            for grid in options.grids(problem.table) {
                let key = row! { table: problem.table, grid, patch_pressure: patches.name() };
                cases.push(Case::new("thesis", key, move |run| problem.rows(run, patches, grid, options)));
            }
        }
    }
    run.cases(cases)?;
    Ok(run.results)
}

/// Means, growth and orders.
pub fn derive(tables: &mut [Table]) {
    if let Some(table) = tables.iter_mut().find(|table| table.name == "thesis_systems") {
        let sizes = |row: &Row| ["grid", "nodes", "frame"].map(|name| row.count(name));
        table.rows.sort_by_key(|row| (row.text("table").to_owned(), sizes(row)));
    }
    let means = systems::means(rows(tables, "thesis_systems"));
    let growth = systems::growth(&means);
    let orders = errors::orders(rows(tables, "thesis"));
    replace(tables, "thesis_means", means);
    replace(tables, "thesis_growth", growth);
    replace(tables, "thesis_orders", orders);
}

/// Charts of all tables but 6.1, with the printed numbers.
fn draw(results: &Results) -> Page {
    let mut charts = draw_systems(results.rows("thesis_means"));
    for (table, rows) in grouped(results.rows("thesis"), |row| Some(row.text("table"))) {
        for (columns, printed, axes) in [
            (["dx", "error_p"], "thesis_p", ["dx, m", "error of p, Pa"]),
            (["dx", "error_v"], "thesis_v", ["dx, m", "error of v, m/s"]),
            (["seconds_median", "error_p"], "", ["seconds of the solve", "error of p, Pa"]),
        ] {
            let name = |row: &Row| row.join(&["backend", "precision", "patch_pressure"]);
            let thesis = rows.iter().copied().filter(|row| name(row) == "cpu f64 cell");
            let mut all = lines(rows.iter().copied(), name, columns);
            all.extend(lines(thesis, |_| "printed".to_owned(), [columns[0], printed]));
            charts.push(Chart { title: format!("Table {table}"), axes, lines: all, falling: true });
        }
    }
    Page::Charts(3, charts)
}

/// Charts of tables 6.2 to 6.4.
fn draw_systems(means: &[Row]) -> Vec<Chart> {
    let drawn = ["nonzeros", "log10_condest", "seconds", "frame_seconds"];
    let groups = grouped(means, |row| {
        let (table, quantity) = (row.text("table"), row.text("quantity"));
        let quantity = drawn.into_iter().find(|name| *name == quantity)?;
        // Table 6.2 refines the beam with the grid.
        let nodes = if table == "6.2" { 0 } else { row.count("nodes") };
        Some((table, quantity, nodes))
    });
    let charts = groups.into_iter().map(|((table, quantity, nodes), rows)| {
        let name = |row: &Row| row.join(&["backend", "precision", "formulation", "solver"]);
        let thesis =
            rows.iter().copied().filter(|row| row.text("backend") == "cpu" && row.text("formulation") != "condensed");
        let printed = |row: &Row| format!("printed, {}", row.text("formulation"));
        let mut all = lines(rows.iter().copied(), name, ["grid", "mean"]);
        all.extend(lines(thesis, printed, ["grid", "thesis"]));
        let title = match nodes {
            0 => format!("Table {table}"),
            nodes => format!("Table {table}, {nodes} nodes"),
        };
        Chart { title, axes: ["cells along an edge", quantity], lines: all, falling: false }
    });
    charts.collect()
}
