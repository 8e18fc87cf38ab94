//! Exponents of the growth of a sub-step's seconds with the grid and with the solids' meshes.

use serde::Serialize;

use super::super::statistics::{Exponents, Spread};
use super::Row;

/// How far scales are rounded, relative.
const ROUNDED: f64 = 1e-9;

/// A row of step_growth.csv: seconds of a sub-step of a kind ~ size^exponent, through rows of a scene, over the same frames.
#[derive(Clone, Debug, Serialize)]
pub struct Growth {
    /// Name of the scene.
    pub scene: String,
    /// As in [`Row`].
    pub kind: &'static str,
    /// `cells`: the grid is refined, the solids stay. `nodes`: the solids are refined, the grid stays. `both`: both are alike, and cells count.
    pub along: &'static str,
    /// What stays: nodes of the solids, or cells of the domain.
    pub fixed: Option<usize>,
    /// Rows.
    pub rows: usize,
    /// Least of what grows: cells of the domain, or nodes.
    pub from: usize,
    /// Largest.
    pub to: usize,
    /// Of the median seconds.
    pub exponent: f64,
    /// Of those of the two largest sizes alone.
    pub exponent_last: f64,
    /// Least exponent through seconds between least and largest of each row; empty where a row has one run, which tells no spread.
    pub exponent_low: Option<f64>,
    /// Largest.
    pub exponent_high: Option<f64>,
}

/// Of each scene and kind of sub-steps with two sizes or more.
pub(super) fn growth(rows: &[Row]) -> Vec<Growth> {
    let mut all: Vec<Growth> = Vec::new();
    for (at, row) in rows.iter().enumerate() {
        let series = |other: &Row| (&other.scene, other.kind) == (&row.scene, row.kind);
        let ratio = |other: &Row| other.scale / other.solids_scale;
        let alike = |other: &Row| (ratio(other) / ratio(row) - 1.0).abs() < ROUNDED;
        let fixed_nodes = (row.nodes > 0).then_some(row.nodes);
        type Belongs<'a> = &'a dyn Fn(&Row) -> bool;
        let ways: [(&'static str, Option<usize>, Belongs); 3] = [
            ("cells", fixed_nodes, &|other| other.nodes == row.nodes),
            ("nodes", Some(row.cells), &|other| other.cells == row.cells),
            ("both", None, &alike),
        ];
        for (along, fixed, belongs) in ways {
            let member = |other: &&Row| series(other) && belongs(other);
            if rows[..at].iter().any(|earlier| member(&earlier)) {
                continue;
            }
            let members: Vec<&Row> = rows.iter().filter(member).collect();
            all.extend(fit(&members, along, fixed));
        }
    }
    all
}

fn fit(members: &[&Row], along: &'static str, fixed: Option<usize>) -> Option<Growth> {
    let first = members.first()?;
    if along == "both" && members.iter().all(|row| row.nodes == first.nodes) {
        return None;
    }
    let size = |row: &Row| match along {
        "nodes" => row.nodes,
        _ => row.cells,
    };
    let points = members.iter().map(|row| {
        let seconds = Spread {
            median: row.seconds_median,
            min: row.seconds_min,
            max: row.seconds_max,
        };
        (size(row) as f64, seconds)
    });
    let exponents = Exponents::of(&points.collect::<Vec<_>>())?;
    let sizes = members.iter().map(|row| size(row));
    let spread = members.iter().all(|row| row.runs > 1);
    Some(Growth {
        scene: first.scene.clone(),
        kind: first.kind,
        along,
        fixed,
        rows: members.len(),
        from: sizes.clone().min()?,
        to: sizes.max()?,
        exponent: exponents.fit,
        exponent_last: exponents.last,
        exponent_low: spread.then_some(exponents.low),
        exponent_high: spread.then_some(exponents.high),
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::row;
    use super::{Growth, growth};

    fn found(growth: &[Growth]) -> Vec<(&'static str, Option<usize>, usize, usize, usize)> {
        let ways = growth.iter();
        ways.map(|g| (g.along, g.fixed, g.rows, g.from, g.to))
            .collect()
    }

    #[test]
    fn grid_and_solids_grow_apart_and_together() {
        let rows = [
            row(0.2, 0.5, [1000, 50]),
            row(0.2, 1.0, [1000, 400]),
            row(0.4, 0.5, [8000, 50]),
            row(0.4, 1.0, [8000, 400]),
        ];
        let fitted = growth(&rows);
        let expected = [
            ("cells", Some(50), 2, 1000, 8000),
            ("nodes", Some(1000), 2, 50, 400),
            // Scales 0.2 and 0.5, 0.4 and 1.
            ("both", None, 2, 1000, 8000),
            ("cells", Some(400), 2, 1000, 8000),
            ("nodes", Some(8000), 2, 50, 400),
        ];
        assert_eq!(found(&fitted), expected, "{fitted:?}");
        for growth in &fitted {
            // Seconds are as the cells.
            let exponent = if growth.along == "nodes" { 0.0 } else { 1.0 };
            assert!((growth.exponent - exponent).abs() < 1e-12, "{growth:?}");
        }
    }

    #[test]
    fn what_is_not_alike_is_in_no_exponent() {
        let mut rows = vec![row(0.2, 1.0, [1000, 0]), row(0.4, 1.0, [8000, 0])];
        rows.push(row(0.8, 1.0, [64000, 0]));
        rows[2].kind = "apart";
        let fitted = growth(&rows);
        assert_eq!(found(&fitted), [("cells", None, 2, 1000, 8000)]);
        // One size is no growth, nor are meshes that no scale changes refined.
        let same = [row(0.2, 0.5, [1000, 50]), row(0.4, 1.0, [8000, 50])];
        assert_eq!(found(&growth(&same)), [("cells", Some(50), 2, 1000, 8000)]);
        assert!(growth(&rows[..1]).is_empty());
    }
}
