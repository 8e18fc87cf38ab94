//! `report --against`: whether two runs of the same commands say the same.
//!
//! Tables of the same name are compared row by row, number by number. A number has to be the same to the last digit, unless it follows from
//! times. One of those that is told with a spread, as X_median, X_min and X_max, X, X_low and X_high, or mean, least and largest, agrees where
//! both spreads share a value; one without agrees where it differs by no more than the spreads of its row let a quotient of times differ, and
//! is not judged in a row without spreads. Powers (`_growth.csv`) are of rows that are compared themselves, and left out, and so
//! are the choices of fastest rows (`_best.csv`) and the numbers of repeats that a limit of time has ended.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::Error;

use super::insert;
use super::report::{csv_files, records};
use super::statistics::Spread;
use super::table::write_csv;

/// The table's name in the folder.
pub const TABLE: &str = "agreement.csv";
/// Columns, by table, that follow from times and whose names alone do not tell: in other tables numbers that repeat have such names, too.
const OF_TIMES: [(&str, &[&str]); 5] = [
    ("solids.csv", &["ratio"]),
    (
        "solve_against.csv",
        &["ratio_median", "ratio_min", "ratio_max"],
    ),
    ("summary.csv", &["seconds"]),
    (
        "thesis_means.csv",
        &["mean", "low", "high", "least", "largest", "ratio"],
    ),
    (
        "thesis_scenes.csv",
        &[
            "projection_median",
            "projection_min",
            "projection_max",
            "solve_median",
        ],
    ),
];
/// Columns, by table, that say how many repeats there was time for.
const REPEATS: [(&str, &str); 3] = [
    ("solve.csv", "runs"),
    ("solve_against.csv", "turns"),
    ("step.csv", "runs"),
];
/// Columns, by table, with spreads of differences, from which nothing follows for quotients.
const NO_SLACK: [(&str, &str); 2] = [
    ("effects.csv", "seconds_added"),
    ("effects.csv", "seconds_told"),
];
/// Columns, by table, whose ends are none of a spread of repeats: of different sub-steps.
const NO_SPREAD: [(&str, &str); 1] = [("step.csv", "sub_step_seconds_median")];
/// What is over the copy bandwidth of its run is judged times that bandwidth, which is measured once in each.
const SHARE: &str = "share_of_copy_bandwidth";
/// Tables whose columns have names that the user chose, of probes and of keys: these tell nothing.
const NAMED_BY_USERS: [&str; 2] = ["probes.csv", "summary.csv"];

/// What came of a comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct Agreement {
    /// A row per column of the tables that both folders have.
    pub columns: Vec<Row>,
    /// Where one of the folders lacks a table that the other has.
    pub missing: Vec<PathBuf>,
}

impl Agreement {
    /// Counts the columns that differ and the tables that only one of the folders has.
    ///
    /// # Errors
    /// [`Error::Check`] where there is one.
    pub fn verdict(&self) -> Result<(), Error> {
        let differ = self.columns.iter().filter(|row| row.differ > 0).count();
        if differ == 0 && self.missing.is_empty() {
            return Ok(());
        }
        Err(Error::Check(format!(
            "columns that differ: {differ}; tables that only one of the folders has: {}",
            self.missing.len()
        )))
    }
}

/// A row of agreement.csv: a column of a table.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Row {
    /// Table, below both folders.
    pub file: String,
    /// Its column; of one with a spread the median's.
    pub column: String,
    /// Rows with a value in either.
    pub rows: usize,
    /// Of these, those in which both say the same to the last digit.
    pub same: usize,
    /// Those that agree: these, and those within the spreads.
    pub agree: usize,
    /// Those that do not.
    pub differ: usize,
    /// The others, which are not judged: of what follows from times, in rows without spreads.
    pub unjudged: usize,
    /// Least of the other run's numbers over this one's; empty without numbers but 0.
    pub ratio_least: Option<f64>,
    /// Their median.
    pub ratio_median: Option<f64>,
    /// The largest.
    pub ratio_most: Option<f64>,
}

impl Row {
    /// Rows that are judged.
    pub fn judged(&self) -> usize {
        self.agree + self.differ
    }
}

/// A table of one run: heads and rows.
type Table = (csv::StringRecord, Vec<csv::StringRecord>);

/// Compares all tables that are below both folders, and writes `DIR/agreement.csv`.
///
/// # Errors
/// [`Error::Input`] where there is no such folder, none of its tables is in the other, one cannot be read, or one has other columns or rows
/// there; [`Error::Output`].
pub fn agreement(dir: &Path, other: &Path) -> Result<Agreement, Error> {
    for folder in [dir, other] {
        if !folder.is_dir() {
            return Err(Error::input(
                folder.display().to_string(),
                "no such folder",
                "give two folders that the same commands wrote into",
            ));
        }
    }
    let [ours, theirs] = [names(dir)?, names(other)?];
    let missing = ours.symmetric_difference(&theirs).map(|name| {
        let without = if ours.contains(name) { other } else { dir };
        without.join(name)
    });
    let missing = missing.collect();
    let follows = |name: &Path| {
        let name = name.to_string_lossy();
        name.ends_with("_growth.csv") || name.ends_with("_best.csv")
    };
    let both = ours.intersection(&theirs).filter(|name| !follows(name));
    let both: Vec<&PathBuf> = both.collect();
    if both.is_empty() {
        return Err(Error::input(
            other.display().to_string(),
            format!("it has no table of the name of one in {}", dir.display()),
            "give the folder that the same commands wrote into, another time",
        ));
    }
    let mut columns = Vec::new();
    for name in both {
        let [file, beside] = [dir, other].map(|folder| folder.join(name));
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
        let bandwidths = [&file, &beside].map(|file| copy_bandwidth(file));
        let bandwidths = bandwidths[0].zip(bandwidths[1]);
        columns.extend(compare(
            name,
            &tables,
            bandwidths.map_or(1.0, |(a, b)| b / a),
        ));
    }
    write_csv(&columns, &dir.join(TABLE))?;
    Ok(Agreement { columns, missing })
}

/// The tables below a folder, without what comparisons wrote.
fn names(folder: &Path) -> Result<BTreeSet<PathBuf>, Error> {
    let files = csv_files(folder)?.into_iter();
    let names = files.map(|file| file.strip_prefix(folder).unwrap_or(&file).to_owned());
    Ok(names
        .filter(|name| name.file_name() != Some(TABLE.as_ref()))
        .collect())
}

/// Bytes per second of a copy in the run that a table is of.
fn copy_bandwidth(table: &Path) -> Option<f64> {
    let json = insert::beside(table)?;
    json.pointer("/copy_bandwidth/median")?.as_f64()
}

/// A row per column, but for the ends of spreads. `bandwidth`: of copies in the other run over that in this one.
fn compare(file: &Path, [(heads, ours), (_, theirs)]: &[Table; 2], bandwidth: f64) -> Vec<Row> {
    let table = file.file_name().unwrap_or_default().to_string_lossy();
    let timed: Vec<bool> = heads.iter().map(|name| of_times(&table, name)).collect();
    let place: BTreeMap<&str, usize> = heads
        .iter()
        .enumerate()
        .map(|(at, name)| (name, at))
        .collect();
    // Rows of thesis_means.csv say themselves what their numbers are of.
    let quantity = place.get("quantity").copied();
    let row_timed =
        |row: &csv::StringRecord| quantity.is_none_or(|quantity| tells_times(&row[quantity]));
    // Columns that have a spread, with those of its ends.
    let spreads: BTreeMap<usize, [usize; 2]> = place
        .iter()
        .filter(|&(&name, &at)| timed[at] && !NO_SPREAD.contains(&(&*table, name)))
        .filter_map(|(&name, &at)| {
            let [least, most] = match name.strip_suffix("_median") {
                Some(stem) => ["min", "max"].map(|end| format!("{stem}_{end}")),
                None if name == "mean" => ["low", "high"].map(str::to_owned),
                None if place.contains_key(format!("{name}_min").as_str()) => {
                    ["min", "max"].map(|end| format!("{name}_{end}"))
                }
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
            let of_repeats = spreads
                .iter()
                .filter(|(at, _)| !NO_SLACK.contains(&(&*table, &heads[**at])));
            let widths = of_repeats.filter_map(|(_, &columns)| {
                let ([a, b], [c, d]) = (ends(ours, columns)?, ends(theirs, columns)?);
                (a > 0.0 && c > 0.0).then(|| (d / a).max(b / c))
            });
            widths.reduce(f64::max).map(|width| width.max(1.0))
        })
        .collect();
    let is_end = |at: usize| spreads.values().any(|ends| ends.contains(&at));
    let judged = heads.iter().enumerate();
    let judged = judged.filter(|(_, column)| !REPEATS.contains(&(&*table, *column)));
    let compared = judged.map(|(at, column)| {
        let mut row = Row {
            file: file.display().to_string(),
            column: column.to_owned(),
            ..Row::default()
        };
        let mut ratios = Vec::new();
        for ((ours, theirs), &slack) in ours.iter().zip(theirs).zip(&slack) {
            let cells = [&ours[at], &theirs[at]];
            let timed = timed[at] && row_timed(ours);
            if cells == [""; 2] || (timed && is_end(at)) {
                continue;
            }
            let ratio = number(ours, at).zip(number(theirs, at));
            let ratio = ratio.map(|(a, b)| b / a);
            let ratio = ratio.filter(|ratio| ratio.is_finite() && *ratio > 0.0);
            let same = cells[0] == cells[1];
            let of_spreads = spreads
                .get(&at)
                .and_then(|&columns| ends(ours, columns).zip(ends(theirs, columns)));
            let agrees = match (of_spreads, slack) {
                _ if same => Some(true),
                _ if !timed || cells.contains(&"") => Some(false),
                (Some(([a, b], [c, d])), _) => Some(a <= d && c <= b),
                (None, Some(slack)) => {
                    let divided = if column == SHARE { bandwidth } else { 1.0 };
                    let ratio = ratio.map(|ratio| ratio * divided);
                    Some(ratio.is_some_and(|ratio| ratio.max(1.0 / ratio) <= slack))
                }
                (None, None) => None,
            };
            row.rows += 1;
            row.same += usize::from(same);
            match agrees {
                Some(true) => row.agree += 1,
                Some(false) => row.differ += 1,
                None => row.unjudged += 1,
            }
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

/// Whether a column of a table follows from times: [`OF_TIMES`] says so, or its name, but for what users named and the thesis printed.
fn of_times(table: &str, column: &str) -> bool {
    let mut listed = OF_TIMES.iter().filter(|(name, _)| *name == table);
    let named = !NAMED_BY_USERS.contains(&table) && !column.starts_with("thesis_");
    listed.any(|(_, columns)| columns.contains(&column)) || (named && tells_times(column))
}

/// Whether a word of a name is one of times.
fn tells_times(name: &str) -> bool {
    let words = ["second", "seconds", "bandwidth"];
    name.split('_').any(|word| words.contains(&word))
}
