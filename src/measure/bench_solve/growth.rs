//! Exponents of the growth of seconds and iterations with the grid and with the solids' mesh.

use serde::Serialize;

use super::super::statistics::{Exponents, Spread, exponent};
use super::{Against, Row};

/// A row of solve_growth.csv: seconds ~ size^exponent through the rows of one solver that converged.
#[derive(Clone, Debug, Serialize)]
pub struct Growth {
    /// As in [`Row`].
    pub formulation: &'static str,
    /// As in [`Row`], or of a rival its name.
    pub solver: &'static str,
    /// As in [`Row`]; `f64` of rivals.
    pub precision: &'static str,
    /// `cells`: active cells grow. `nodes`: those of the solids grow, cells stay. `both`: both grow.
    pub along: &'static str,
    /// What stays: cells along an edge, or nodes.
    pub fixed: Option<usize>,
    /// Rows.
    pub rows: usize,
    /// Least of what grows: active cells, or nodes.
    pub from: u32,
    /// Largest.
    pub to: u32,
    /// Of the median seconds.
    pub exponent: f64,
    /// Of those of the two largest sizes alone, where launches and other fixed costs tell least.
    pub exponent_last: f64,
    /// Least exponent through seconds between least and largest of each row; empty where a row has one run, which tells no spread.
    pub exponent_low: Option<f64>,
    /// Largest.
    pub exponent_high: Option<f64>,
    /// Of the iterations; empty for direct solvers.
    pub iterations: Option<f64>,
}

/// What an exponent is fitted through.
#[derive(Clone, Copy)]
struct Sample {
    series: [&'static str; 3],
    grid: usize,
    cells: u32,
    nodes: u32,
    bricks: Option<usize>,
    seconds: Spread,
    runs: usize,
    iterations: Option<f64>,
}

/// Of all series with two sizes or more.
pub(super) fn growth(rows: &[Row], against: &[Against]) -> Vec<Growth> {
    let converged = rows.iter().filter(|row| row.converged());
    let of_device = converged.map(|row| Sample {
        series: [row.formulation, row.preconditioner, row.precision],
        grid: row.grid,
        cells: row.active_cells,
        nodes: row.solid_nodes,
        bricks: row.bricks,
        seconds: Spread {
            median: row.seconds_median,
            min: row.seconds_min,
            max: row.seconds_max,
        },
        runs: row.runs,
        iterations: Some(f64::from(row.iterations)),
    });
    let converged = against.iter().filter(|row| row.converged());
    let of_rivals = converged.filter_map(|row| {
        Some(Sample {
            series: [row.formulation, row.rival, "f64"],
            grid: row.grid,
            cells: row.active_cells,
            nodes: row.solid_nodes,
            bricks: row.bricks,
            seconds: Spread {
                median: row.seconds_median?,
                min: row.seconds_min?,
                max: row.seconds_max?,
            },
            runs: row.turns,
            iterations: row.iterations.map(f64::from),
        })
    });
    let samples: Vec<Sample> = of_device.chain(of_rivals).collect();
    let mut all: Vec<Growth> = Vec::new();
    let mut seen = Vec::new();
    for sample in &samples {
        // A beam of its own size stays while the grid is refined; that which goes with the grid is refined with it.
        let along_cells = match sample.bricks {
            Some(_) => ("cells", Some(sample.nodes as usize)),
            None if sample.nodes == 0 => ("cells", None),
            None => ("both", None),
        };
        let along_nodes = sample.bricks.map(|_| ("nodes", Some(sample.grid)));
        for (along, fixed) in [Some(along_cells), along_nodes].into_iter().flatten() {
            let key = (sample.series, along, fixed);
            if seen.contains(&key) {
                continue;
            }
            seen.push(key);
            let belongs = |other: &&Sample| {
                let same = match along {
                    "nodes" => Some(other.grid) == fixed && other.bricks.is_some(),
                    "cells" if fixed.is_some() => {
                        Some(other.nodes as usize) == fixed && other.bricks.is_some()
                    }
                    _ => other.bricks.is_none(),
                };
                other.series == sample.series && same
            };
            let members: Vec<&Sample> = samples.iter().filter(belongs).collect();
            all.extend(fit(&members, along, fixed));
        }
    }
    all
}

fn fit(members: &[&Sample], along: &'static str, fixed: Option<usize>) -> Option<Growth> {
    let nodes = members.first()?.nodes;
    // A grid may be refined by less than makes another beam.
    if along == "both" && members.iter().all(|sample| sample.nodes == nodes) {
        return None;
    }
    let size = |sample: &Sample| match along {
        "nodes" => sample.nodes,
        _ => sample.cells,
    };
    let of_size = |sample: &Sample| f64::from(size(sample));
    let seconds = members
        .iter()
        .map(|sample| (of_size(sample), sample.seconds));
    let seconds = Exponents::of(&seconds.collect::<Vec<_>>())?;
    let iterations = members
        .iter()
        .map(|sample| Some((of_size(sample), sample.iterations?)));
    let iterations: Option<Vec<(f64, f64)>> = iterations.collect();
    let sizes = members.iter().map(|sample| size(sample));
    let spread = members.iter().all(|sample| sample.runs > 1);
    let [formulation, solver, precision] = members.first()?.series;
    Some(Growth {
        formulation,
        solver,
        precision,
        along,
        fixed,
        rows: members.len(),
        from: sizes.clone().min()?,
        to: sizes.max()?,
        exponent: seconds.fit,
        exponent_last: seconds.last,
        exponent_low: spread.then_some(seconds.low),
        exponent_high: spread.then_some(seconds.high),
        iterations: iterations.and_then(exponent),
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::row;
    use super::{Growth, Row, growth};

    #[test]
    fn what_did_not_converge_is_in_no_exponent() {
        let mut rows = vec![row(20, "converged"), row(40, "converged")];
        let fitted = growth(&rows, &[]);
        let [found] = &fitted[..] else {
            panic!("{fitted:?}")
        };
        assert_eq!((found.rows, found.from, found.to), (2, 8000, 64000));
        // Seconds grow with the cells.
        for exponent in [found.exponent, found.exponent_last] {
            assert!((exponent - 1.0).abs() < 1e-12, "{found:?}");
        }
        let range = |found: &Growth| [found.exponent_low, found.exponent_high];
        assert_eq!(range(found), [None; 2], "rows of one run have no spread");
        let repeated = rows.clone().into_iter().map(|row| Row { runs: 2, ..row });
        let repeated = growth(&repeated.collect::<Vec<_>>(), &[]);
        assert_eq!(range(&repeated[0]), [Some(found.exponent); 2]);
        for status in ["iteration_limit", "converged_to_rounding"] {
            rows.push(row(60, status));
        }
        rows[2].seconds_median = 1e6;
        let again = growth(&rows, &[]);
        assert_eq!(again.len(), 1, "{again:?}");
        assert_eq!((again[0].rows, again[0].exponent), (2, found.exponent));
        // One size is no growth.
        assert!(growth(&rows[1..], &[]).is_empty());
    }
}
