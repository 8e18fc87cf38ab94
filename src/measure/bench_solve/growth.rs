//! Exponents of the growth of seconds and iterations with the grid and with the solids' mesh.

use serde::Serialize;

use super::super::statistics::{Exponents, Spread, exponent};
use super::{Against, CELLS_PER_BRICK, Row, bricks_across};

/// A row of solve_growth.csv: seconds ~ size^exponent through the rows of one solver that converged.
#[derive(Clone, Debug, Serialize)]
pub struct Growth {
    /// As in [`Row`].
    pub formulation: &'static str,
    /// As in [`Row`], or of a rival its name.
    pub solver: &'static str,
    /// As in [`Row`]; `f64` of rivals.
    pub precision: &'static str,
    /// `cells`: active cells grow, nodes stay. `nodes`: those of the solids grow, cells stay. `both`: both grow, on the grids that the beams go with.
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
        // A beam of its own size stays while the grid is refined, and so does one that goes with several grids.
        let along_cells = (sample.nodes == 0).then_some(("cells", None));
        let along_cells = along_cells.unwrap_or(("cells", Some(sample.nodes as usize)));
        let along_nodes = sample.bricks.map(|_| ("nodes", Some(sample.grid)));
        let along_both = (sample.nodes > 0 && sample.bricks.is_none()).then_some(("both", None));
        let ways = [along_both, Some(along_cells), along_nodes];
        for (along, fixed) in ways.into_iter().flatten() {
            let key = (sample.series, along, fixed, sample.bricks.is_some());
            if seen.contains(&key) {
                continue;
            }
            seen.push(key);
            let belongs = |other: &&Sample| {
                let same = match along {
                    "nodes" => Some(other.grid) == fixed,
                    "cells" => other.nodes == sample.nodes,
                    _ => goes_with_its_grid(other, &samples),
                };
                let beam = other.bricks.is_some() == sample.bricks.is_some();
                other.series == sample.series && beam && same
            };
            let members: Vec<&Sample> = samples.iter().filter(belongs).collect();
            all.extend(fit(&members, along, fixed));
        }
    }
    all
}

/// Whether of all grids with its beam, in its series, this one has most nearly as many cells to a brick as the thesis's have: there, grid and beam are
/// refined together.
fn goes_with_its_grid(sample: &Sample, samples: &[Sample]) -> bool {
    let off = |other: &Sample| {
        let cells = CELLS_PER_BRICK * bricks_across(other.grid);
        (other.grid.abs_diff(cells), other.grid)
    };
    let shares = |other: &&Sample| {
        let of = |sample: &Sample| (sample.series, sample.nodes, sample.bricks);
        of(other) == of(sample)
    };
    let nearest = samples.iter().filter(shares).map(off).min();
    sample.nodes > 0 && nearest == Some(off(sample))
}

fn fit(members: &[&Sample], along: &'static str, fixed: Option<usize>) -> Option<Growth> {
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

    #[test]
    fn a_beam_that_stays_is_no_growth_of_both() {
        // The beams of 20 and 40 cells are one, and those of 80 and 170.
        let sizes = [(20, 135), (40, 135), (60, 352), (80, 725), (170, 725)];
        let rows = sizes.map(|(grid, nodes)| Row {
            solid_nodes: nodes,
            formulation: "condensed",
            ..row(grid, "converged")
        });
        let found = growth(&rows, &[]);
        let told = found
            .iter()
            .map(|row| (row.along, row.fixed, row.from, row.to));
        let cubed = |n: u32| n.pow(3);
        let expected = [
            ("both", None, cubed(40), cubed(80)),
            ("cells", Some(135), cubed(20), cubed(40)),
            ("cells", Some(725), cubed(80), cubed(170)),
        ];
        assert_eq!(told.collect::<Vec<_>>(), expected);
        assert_eq!(found[0].rows, 3);
    }
}
