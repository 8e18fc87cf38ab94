//! `report --against`: whether two runs of the same commands say the same.
//!
//! Tables of the same name are compared row by row, number by number. What is told with a spread, as X_median, X_min and X_max, X, X_low and
//! X_high, or mean, least and largest, agrees where both spreads share a value. What has none has to be the same to the last digit, but for
//! what follows from times: it agrees where it differs by no more than the spreads of its row let a quotient of times differ, and is not
//! judged in a row without spreads. Powers (`_growth.csv`) are of rows that are compared themselves, and left out.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use crate::Error;

use super::report::{csv_files, records};
use super::statistics::Spread;
use super::table::write_csv;

/// The table's name in the folder.
pub const TABLE: &str = "agreement.csv";

/// A row of agreement.csv: a column of a table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Table, below both folders.
    pub file: String,
    /// Its column; of one with a spread the median's.
    pub column: String,
    /// Rows with a value.
    pub rows: usize,
    /// Of these, those in which both say the same to the last digit.
    pub same: usize,
    /// Those that agree: these, and those within the spreads; empty for what follows from times that have no spread.
    pub agree: Option<usize>,
    /// Least of the other run's numbers over this one's; empty without numbers but 0.
    pub ratio_least: Option<f64>,
    /// Their median.
    pub ratio_median: Option<f64>,
    /// The largest.
    pub ratio_most: Option<f64>,
}

impl Row {
    /// Whether it agrees in all rows, as far as it is judged.
    pub fn agrees(&self) -> bool {
        self.agree.is_none_or(|agree| agree == self.rows)
    }
}

/// A table of one run: heads and rows.
type Table = (csv::StringRecord, Vec<csv::StringRecord>);

/// Compares all tables below `dir` that are below `other` too, and writes `DIR/agreement.csv`.
///
/// # Errors
/// [`Error::Input`] where there is no such folder or table, one cannot be read, or one has other columns or rows there; [`Error::Output`].
pub fn agreement(dir: &Path, other: &Path) -> Result<Vec<Row>, Error> {
    for folder in [dir, other] {
        if !folder.is_dir() {
            return Err(Error::input(
                folder.display().to_string(),
                "no such folder",
                "give two folders that the same commands wrote into",
            ));
        }
    }
    let (mut rows, mut compared) = (Vec::new(), 0);
    for file in csv_files(dir)? {
        let name = file.strip_prefix(dir).unwrap_or(&file);
        let beside = other.join(name);
        let of_powers = name.to_string_lossy().ends_with("_growth.csv");
        if name == Path::new(TABLE) || of_powers || !beside.is_file() {
            continue;
        }
        compared += 1;
        let tables = [records(&file)?, records(&beside)?];
        let shape = |(heads, rows): &Table| (heads.clone(), rows.len());
        if shape(&tables[0]) != shape(&tables[1]) {
            return Err(Error::input(
                beside.display().to_string(),
                format!(
                    "its columns or the number of its rows are not those of {}",
                    file.display()
                ),
                "give folders that the same version wrote with the same options",
            ));
        }
        rows.extend(compare(&name.display().to_string(), &tables));
    }
    if compared == 0 {
        return Err(Error::input(
            other.display().to_string(),
            format!("it has no table of the name of one in {}", dir.display()),
            "give the folder that the same commands wrote into, another time",
        ));
    }
    write_csv(&rows, &dir.join(TABLE))?;
    Ok(rows)
}

/// A row per column, but for the ends of spreads.
fn compare(file: &str, [(heads, ours), (_, theirs)]: &[Table; 2]) -> Vec<Row> {
    let place: BTreeMap<&str, usize> = heads
        .iter()
        .enumerate()
        .map(|(at, name)| (name, at))
        .collect();
    // Columns that have a spread, with those of its ends.
    let spreads: BTreeMap<usize, [usize; 2]> = place
        .iter()
        .filter_map(|(&name, &at)| {
            let [least, most] = match name.strip_suffix("_median") {
                Some(stem) => ["min", "max"].map(|end| format!("{stem}_{end}")),
                None if name == "mean" => ["least", "largest"].map(str::to_owned),
                None => ["low", "high"].map(|end| format!("{name}_{end}")),
            };
            let ends = [least, most].map(|end| place.get(end.as_str()).copied());
            Some((at, [ends[0]?, ends[1]?]))
        })
        .collect();
    let number = |row: &csv::StringRecord, at: usize| row[at].parse::<f64>().ok();
    let ends = |row: &csv::StringRecord, [min, max]: [usize; 2]| {
        Some([number(row, min)?, number(row, max)?])
    };
    // What quotients of times of a pair of rows may differ by, at least 1; none where they have no spread.
    let slack: Vec<Option<f64>> = ours
        .iter()
        .zip(theirs)
        .map(|(ours, theirs)| {
            let widths = spreads.values().filter_map(|&columns| {
                let ([a, b], [c, d]) = (ends(ours, columns)?, ends(theirs, columns)?);
                // Of differences, which may be below 0, nothing follows for quotients.
                (a > 0.0 && c > 0.0).then(|| (d / a).max(b / c))
            });
            widths.reduce(f64::max).map(|width| width.max(1.0))
        })
        .collect();
    let is_end = |at: usize| spreads.values().any(|ends| ends.contains(&at));
    let columns = heads.iter().enumerate().filter(|&(at, _)| !is_end(at));
    let compared = columns.map(|(at, column)| {
        let mut row = Row {
            file: file.to_owned(),
            column: column.to_owned(),
            rows: 0,
            same: 0,
            agree: Some(0),
            ratio_least: None,
            ratio_median: None,
            ratio_most: None,
        };
        let mut ratios = Vec::new();
        for ((ours, theirs), &slack) in ours.iter().zip(theirs).zip(&slack) {
            if ours[at].is_empty() && theirs[at].is_empty() {
                continue;
            }
            let ratio = number(ours, at).zip(number(theirs, at));
            let ratio = ratio.map(|(a, b)| b / a);
            let ratio = ratio.filter(|ratio| ratio.is_finite() && *ratio > 0.0);
            let same = ours[at] == theirs[at];
            let of_spreads = spreads
                .get(&at)
                .and_then(|&columns| ends(ours, columns).zip(ends(theirs, columns)));
            let within = match (of_spreads, slack) {
                (Some(([a, b], [c, d])), _) => Some(a <= d && c <= b),
                (None, _) if !follows_from_times(column) => Some(false),
                (None, Some(slack)) => {
                    Some(ratio.is_some_and(|ratio| ratio.max(1.0 / ratio) <= slack))
                }
                (None, None) => None,
            };
            row.rows += 1;
            row.same += usize::from(same);
            let agrees = if same { Some(true) } else { within };
            row.agree = row
                .agree
                .zip(agrees)
                .map(|(agree, agrees)| agree + usize::from(agrees));
            ratios.extend(ratio);
        }
        if !ratios.is_empty() {
            let Spread { median, min, max } = Spread::of(ratios);
            (row.ratio_least, row.ratio_median, row.ratio_most) =
                (Some(min), Some(median), Some(max));
        }
        row
    });
    compared.filter(|row| row.rows > 0).collect()
}

/// Whether a number is a time, or one over or per another.
fn follows_from_times(column: &str) -> bool {
    let parts = ["second", "ratio", "share"];
    parts.iter().any(|part| column.contains(part))
}
