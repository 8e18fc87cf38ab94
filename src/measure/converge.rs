//! Convergence of the probes with the cell size: observed order and Richardson's estimate from runs at three scales.
//!
//! With values f1, f2, f3 at cell sizes h1 > h2 > h3 and an error C h^p, the order p solves
//! (f1 - f2) / (f2 - f3) = (h1^p - h2^p) / (h2^p - h3^p), and the estimate for h = 0 is
//! f3 + (f3 - f2) h3^p / (h2^p - h3^p) (Roache 1994, Celik et al. 2008).

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::probe_statistics::{NAMES, Statistics};
use super::sweep::{Status, Sweep};
use super::{cell, write_csv, write_json};
use crate::Error;
use crate::output::plot::{Chart, Run, write_page};
use crate::scene::{Scene, Solid, SolidMesh, names};

/// Places in [`Statistics`] of those that are studied: least, largest, mean, last.
const QUANTITIES: [usize; 4] = [0, 2, 4, 5];
/// Relative difference of values that single precision does not resolve.
const ROUNDING: f64 = 1e-6;
/// Orders with an estimate. The method is of first to second order.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 0.5..=3.0;
/// Orders that are searched.
const SEARCHED: [f64; 2] = [1e-3, 20.0];

/// Behaviour of a quantity on the three finest grids.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The values differ by rounding only.
    Constant,
    /// The differences shrink with an order of 0.5 to 3.
    Converges,
    /// The differences have opposite signs: the runs are not in the asymptotic range.
    Oscillates,
    /// The differences grow: the runs are not in the asymptotic range.
    Diverges,
    /// The order is below 0.5: an extrapolation would be a guess.
    TooSlow,
    /// The order is above 3, which the method does not have: the coarsest run is not in the asymptotic range.
    TooFast,
}

names! {
    Verdict: "constant" => Constant, "converges" => Converges, "oscillates" => Oscillates, "diverges" => Diverges,
        "too_slow" => TooSlow, "too_fast" => TooFast;
}

/// Order and estimate from three grids.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Convergence {
    /// Behaviour.
    pub verdict: Verdict,
    /// Observed order; `None` if the differences do not shrink.
    pub order: Option<f64>,
    /// Richardson's estimate for vanishing cells; of a convergent quantity only.
    pub estimate: Option<f64>,
}

impl Convergence {
    /// From values at decreasing cell sizes.
    pub fn new(h: [f64; 3], f: [f64; 3]) -> Convergence {
        let without = |verdict, order| Convergence { verdict, order, estimate: None };
        let [coarse, fine] = [f[0] - f[1], f[1] - f[2]];
        let size = f.iter().fold(0.0, |size: f64, f| size.max(f.abs()));
        if coarse.abs().max(fine.abs()) <= ROUNDING * size {
            return without(Verdict::Constant, None);
        }
        if coarse * fine <= 0.0 {
            return without(Verdict::Oscillates, None);
        }
        // The quotient of differences of h^p, from logarithms to avoid underflow; it increases with p.
        let quotient = |p: f64| {
            let [wide, narrow] = [h[0] / h[1], h[1] / h[2]].map(|ratio| p * ratio.ln());
            wide.exp_m1() / -(-narrow).exp_m1()
        };
        let observed = coarse / fine;
        let [mut low, mut high] = SEARCHED;
        if observed <= quotient(low) {
            return without(Verdict::Diverges, None);
        }
        if observed >= quotient(high) {
            return without(Verdict::TooFast, None);
        }
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if quotient(middle) < observed { low = middle } else { high = middle }
        }
        let order = 0.5 * (low + high);
        if !PLAUSIBLE.contains(&order) {
            let slow = order < *PLAUSIBLE.start();
            return without(if slow { Verdict::TooSlow } else { Verdict::TooFast }, Some(order));
        }
        let gain = (order * (h[1] / h[2]).ln()).exp_m1();
        Convergence { verdict: Verdict::Converges, order: Some(order), estimate: Some(f[2] - fine / gain) }
    }
}

/// A quantity of a probe.
#[derive(Clone, Debug, Serialize)]
pub struct Quantity {
    /// Column of probes.csv.
    pub probe: String,
    /// Unit of the values.
    pub unit: &'static str,
    /// `least`, `largest`, `mean` over time, or `last`.
    pub quantity: &'static str,
    /// Values of the runs.
    pub values: Vec<f64>,
    /// From the three finest grids.
    #[serde(flatten)]
    pub convergence: Convergence,
    /// Difference of the finest run from the estimate over the estimate.
    pub error: Option<f64>,
}

/// A study of all probes.
#[derive(Clone, Debug, Serialize)]
pub struct Study {
    /// `--scale` of the runs, ascending.
    pub scales: Vec<f64>,
    /// Cell sizes, m.
    pub cell_sizes: Vec<f64>,
    /// Sub-steps of the runs.
    pub sub_steps: Vec<u64>,
    /// Wall-clock time of the runs, s.
    pub seconds: Vec<f64>,
    /// Quantities of all probes.
    pub quantities: Vec<Quantity>,
}

impl Study {
    /// From a sweep over three or more ascending scales, whose runs are finished.
    pub fn new(sweep: &Sweep) -> Study {
        let rows: Vec<_> = (0..sweep.runs.len()).map(|number| sweep.row(number)).collect();
        debug_assert!(rows.iter().all(|row| row.status == Status::Finished));
        let runs = sweep.runs.iter();
        let cell_sizes: Vec<f64> = runs.clone().filter_map(|run| Some(run.scene.as_ref().ok()?.cell_size)).collect();
        let mut quantities = Vec::new();
        for (probe, unit) in sweep.probes() {
            let statistics = rows.iter().map(|row| row.statistics(&probe));
            let Some(statistics) = statistics.collect::<Option<Vec<Statistics>>>() else { continue };
            for place in QUANTITIES {
                let values: Vec<f64> = statistics.iter().map(|numbers| numbers[place]).collect();
                let finest = |list: &[f64]| *list.last_chunk().expect("a study has three scales or more");
                let (h, f) = (finest(&cell_sizes), finest(&values));
                let convergence = Convergence::new(h, f);
                let error = convergence.estimate.map(|estimate| (f[2] - estimate).abs() / estimate.abs());
                quantities.push(Quantity {
                    probe: probe.clone(),
                    unit,
                    quantity: NAMES[place],
                    values,
                    convergence,
                    error: error.filter(|error| error.is_finite()),
                });
            }
        }
        Study {
            scales: runs.map(|run| run.scale).collect(),
            cell_sizes,
            sub_steps: rows.iter().filter_map(|row| row.sub_steps).collect(),
            seconds: rows.iter().filter_map(|row| row.seconds).collect(),
            quantities,
        }
    }

    /// Writes convergence.csv, convergence.json and convergence.svg; the files.
    pub fn write(&self, out: &Path) -> Result<Vec<PathBuf>, Error> {
        let scales = self.scales.iter().map(|scale| format!("scale={scale}"));
        let names = ["probe", "unit", "quantity"].map(str::to_owned).into_iter();
        let ends = ["order", "estimate", "error", "verdict"].map(str::to_owned);
        let heads = names.chain(scales).chain(ends).collect();
        let records = self.quantities.iter().map(|row| {
            let names = [&row.probe, row.unit, row.quantity].map(str::to_owned).into_iter();
            let values = row.values.iter().map(|&value| cell(Some(value)));
            let Convergence { verdict, order, estimate } = row.convergence;
            let ends = [cell(order), cell(estimate), cell(row.error), verdict.name().to_owned()];
            names.chain(values).chain(ends).collect()
        });
        let mut files = ["convergence.csv", "convergence.json"].map(|name| out.join(name)).to_vec();
        write_csv(&files[0], std::iter::once(heads).chain(records))?;
        write_json(&files[1], self)?;
        let pages: Vec<(Chart, [Run; 1])> = self.charts().collect();
        if !pages.is_empty() {
            let charts: Vec<(&Chart, &[Run])> = pages.iter().map(|(chart, runs)| (chart, &runs[..])).collect();
            files.push(write_page(out, "convergence.svg", &charts)?);
        }
        Ok(files)
    }

    /// A chart of each probe: its quantities over the cell size, with the estimates at 0.
    fn charts(&self) -> impl Iterator<Item = (Chart, [Run; 1])> + '_ {
        self.quantities.chunk_by(|a, b| a.probe == b.probe).map(|rows| {
            let times = self.cell_sizes.iter().copied().chain([0.0]).collect();
            let columns = rows.iter().map(|row| {
                let values = row.values.iter().copied().map(Some).chain([row.convergence.estimate]);
                (row.quantity.to_owned(), values.collect())
            });
            let run = Run { name: String::new(), times, columns: columns.collect() };
            let chart = Chart {
                title: format!("{}, {}", rows[0].probe, rows[0].unit),
                logarithmic: false,
                columns: rows.iter().map(|row| row.quantity.to_owned()).collect(),
                across: "cell size, m (0: estimate)",
            };
            (chart, [run])
        })
    }
}

/// Overrides of the scene at a scale, after `settings`. Besides the cells of the grid, the scale divides `time.fixed_step` and `time.max_step` with
/// `steps`, and the elements of the solids with `elements`.
///
/// # Errors
/// [`Error::Input`] if the scene has nothing to refine, and for solids from files of tetrahedra.
pub fn refined(
    scene: &Scene,
    settings: &[String],
    steps: bool,
    elements: bool,
) -> Result<impl Fn(f64) -> Vec<String> + use<>, Error> {
    let (time, slab) = (scene.time.clone(), scene.domain.slab);
    if steps && time.fixed_step.is_none() && time.max_step.is_none() {
        return Err(Error::input(
            "--steps",
            "the scene has neither time.fixed_step nor time.max_step",
            "add --set time.fixed_step=0.01, the sub-step at scale 1 in s, or leave --steps away: time.cfl is measured in cells",
        ));
    }
    if scene.liquid.is_none() && !steps && !elements {
        return Err(Error::input(
            "--scales",
            "the scene has no liquid, and cells alone refine nothing of its solids",
            "add --elements, --steps or both",
        ));
    }
    if elements {
        if scene.solids.is_empty() {
            return Err(Error::input("--elements", "the scene has no [[solid]]", "leave it away"));
        }
        let from_file = |solid: &Solid| matches!(solid.mesh, SolidMesh::File { .. });
        if let Some(number) = scene.solids.iter().position(from_file) {
            return Err(Error::input(
                scene.at(&format!("solid[{number}].mesh")),
                "the tetrahedra of a file cannot be refined by --elements",
                "fill its surface: mesh = { surface = { file, cell_size } }, or leave --elements away",
            ));
        }
    }
    // By name, since a removal among the settings may change indices.
    let meshes: Vec<(String, SolidMesh)> =
        scene.solids.iter().map(|solid| (solid.name.clone(), solid.mesh.clone())).collect();
    let settings = settings.to_vec();
    Ok(move |scale: f64| {
        let mut all = settings.clone();
        if steps {
            let keys = [("fixed_step", time.fixed_step), ("max_step", time.max_step)];
            let present = keys.into_iter().filter_map(|(key, step)| Some((key, step?)));
            all.extend(present.map(|(key, step)| format!("time.{key}={:?}", step / scale)));
        }
        for (name, mesh) in meshes.iter().filter(|_| elements) {
            let size = |kind, cell_size| format!("{kind}.cell_size={:?}", cell_size / scale);
            let length = match mesh {
                SolidMesh::Box { cells, .. } => {
                    let mut bricks = cells.map(|n| (n as f64 * scale).round().max(1.0));
                    // Nothing varies across a slab.
                    if let Some(slab) = slab {
                        bricks[slab.axis] = cells[slab.axis] as f64;
                    }
                    let [x, y, z] = bricks;
                    format!("box.cells=[{x}, {y}, {z}]")
                }
                SolidMesh::Sphere { cell_size, .. } => size("sphere", cell_size),
                SolidMesh::Shell { cell_size, .. } => size("shell", cell_size),
                SolidMesh::Surface { cell_size, .. } => size("surface", cell_size),
                SolidMesh::File { .. } => continue,
            };
            all.push(format!("solid.{name}.mesh.{length}"));
        }
        all
    })
}
