//! `report --against`: whether two runs of the same commands say the same.
//!
//! Tables of the same name are compared row by row, number by number. What is told with a spread, X_median between X_min and X_max, agrees
//! where both spreads share a value. What has none of its own agrees where it is the same to the last digit, or where both differ by no more
//! than the spreads of their rows let a quotient of times differ.

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
    /// Those that agree: these, and those within the spreads.
    pub agree: usize,
    /// Least of the other run's numbers over this one's; empty without numbers but 0.
    pub ratio_least: Option<f64>,
    /// Their median.
    pub ratio_median: Option<f64>,
    /// The largest.
    pub ratio_most: Option<f64>,
}

/// A table of one run: heads and rows.
type Table = (csv::StringRecord, Vec<csv::StringRecord>);

/// Compares all tables below `dir` that are below `other` too, and writes `DIR/agreement.csv`.
///
/// # Errors
/// [`Error::Input`] where there is no such table, one cannot be read, or one has other columns or rows there; [`Error::Output`].
pub fn agreement(dir: &Path, other: &Path) -> Result<Vec<Row>, Error> {
    let mut rows = Vec::new();
    for file in csv_files(dir)? {
        let name = file.strip_prefix(dir).unwrap_or(&file);
        let beside = other.join(name);
        if name == Path::new(TABLE) || !beside.is_file() {
            continue;
        }
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
    if rows.is_empty() {
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
    // Columns of medians with those of their ends.
    let spreads: BTreeMap<usize, [usize; 2]> = place
        .iter()
        .filter_map(|(name, &at)| {
            let stem = name.strip_suffix("_median")?;
            let end = |end: &str| place.get(format!("{stem}_{end}").as_str()).copied();
            Some((at, [end("min")?, end("max")?]))
        })
        .collect();
    let number = |row: &csv::StringRecord, at: usize| row[at].parse::<f64>().ok();
    let ends = |row: &csv::StringRecord, [min, max]: [usize; 2]| {
        Some([number(row, min)?, number(row, max)?])
    };
    // What times of a pair of rows may differ by, as a quotient of at least 1.
    let slack: Vec<f64> = ours
        .iter()
        .zip(theirs)
        .map(|(ours, theirs)| {
            let widths = spreads.values().filter_map(|&columns| {
                let ([a, b], [c, d]) = (ends(ours, columns)?, ends(theirs, columns)?);
                Some((d / a).max(b / c)).filter(|width| width.is_finite())
            });
            widths.fold(1.0, f64::max)
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
            agree: 0,
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
            let ratio = ratio
                .map(|(a, b)| b / a)
                .filter(|ratio| ratio.is_finite() && *ratio > 0.0);
            let same = ours[at] == theirs[at];
            let within = match spreads
                .get(&at)
                .map(|&columns| (ends(ours, columns), ends(theirs, columns)))
            {
                Some((Some([a, b]), Some([c, d]))) => a <= d && c <= b,
                _ => ratio.is_some_and(|ratio| ratio.max(1.0 / ratio) <= slack),
            };
            row.rows += 1;
            row.same += usize::from(same);
            row.agree += usize::from(same || within);
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
