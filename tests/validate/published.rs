//! The published rows, docs/measured/validation: a run replaces those of its cases and leaves the others, each with its own date.

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use cutwater::measure::bench::Machine;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::Case;
use crate::cost;
use crate::page::{self, Chart};
use crate::sheet::{self, Row};

/// A row of validation.csv.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct PublishedRow {
    topic: String,
    case: String,
    what: String,
    expected: String,
    got: String,
    tolerance: String,
    verdict: String,
    /// Seconds of the whole case.
    seconds: f64,
    share: Option<f64>,
    worst: bool,
    /// When the run of the case began, RFC 3339.
    measured: String,
    /// Digest of the sources that it ran.
    sources: String,
}

/// A row of validation_cases.csv.
#[derive(Debug, Serialize)]
struct PublishedCase<'a> {
    topic: &'a str,
    case: &'a str,
    class: &'a str,
    judged: usize,
    failed: usize,
    seconds: f64,
    measured: &'a str,
    sources: &'a str,
}

/// The published rows of each case.
#[derive(Debug, Default)]
pub(crate) struct Published {
    rows: BTreeMap<String, Vec<PublishedRow>>,
    /// Where and when, one for each run of which a row is left.
    parts: Vec<Value>,
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/measured/validation")
}

impl Published {
    /// Reads them; none where nothing is published.
    pub(crate) fn read() -> Result<Published, Box<dyn Error>> {
        let mut published = Published::default();
        let file = folder().join("validation.csv");
        if !file.exists() {
            return Ok(published);
        }
        for row in csv::Reader::from_path(file)?.deserialize() {
            let row: PublishedRow = row?;
            let id = row.case.clone();
            published.rows.entry(id).or_default().push(row);
        }
        let mut machine: Value = serde_json::from_slice(&fs::read(folder().join("validation.json"))?)?;
        published.parts = match machine.get_mut("parts") {
            Some(Value::Array(parts)) => std::mem::take(parts),
            _ => vec![part(&machine)],
        };
        Ok(published)
    }

    /// Published seconds of a case.
    pub(crate) fn seconds(&self, id: &str) -> Option<f64> {
        Some(self.rows.get(id)?.first()?.seconds)
    }

    /// Writes tables and pictures with the rows of a run in place of those published of the same cases. Cases that no longer exist are left out.
    pub(crate) fn merge(
        mut self,
        all: &[Case],
        rows: &[Row],
        charts: &[Chart],
        machine: &Machine,
    ) -> Result<(), Box<dyn Error>> {
        let run: BTreeSet<&str> = rows.iter().map(|row| row.id.as_str()).collect();
        self.rows.retain(|id, _| !run.contains(id.as_str()));
        for row in rows {
            let published = PublishedRow::new(row, machine);
            self.rows.entry(row.id.clone()).or_default().push(published);
        }
        let mut rows: Vec<PublishedRow> = Vec::new();
        for case in all {
            let of_case = self.rows.remove(&case.id).unwrap_or_default();
            rows.extend(of_case.into_iter().map(|row| PublishedRow { topic: case.topic.to_owned(), ..row }));
        }
        let plain: Vec<Row> = rows.iter().map(|row| row.plain(all)).collect();
        let worst = sheet::worst(&plain);
        for (number, row) in rows.iter_mut().enumerate() {
            row.worst = worst.contains(&number);
        }
        let folder = folder();
        fs::create_dir_all(&folder)?;
        let ids: BTreeSet<&str> = all.iter().map(|case| case.id.as_str()).collect();
        page::remove_charts(&folder, &run, &ids)?;
        page::write_pictures(&folder, &plain, charts)?;
        write_csv(&folder.join("validation.csv"), &rows)?;
        let topics = sheet::topics(&plain);
        write_csv(&folder.join("validation_topics.csv"), &topics)?;
        write_csv(&folder.join("validation_cases.csv"), &cases(&rows))?;
        let dates: BTreeSet<&str> = rows.iter().map(|row| row.measured.as_str()).collect();
        let mut parts = std::mem::take(&mut self.parts);
        let mut table = serde_json::to_value(machine)?;
        parts.push(part(&table));
        parts.retain(|part| part["measured"].as_str().is_some_and(|date| dates.contains(date)));
        parts.sort_by_key(|part| part["measured"].to_string());
        parts.dedup_by_key(|part| part["measured"].to_string());
        table["parts"] = Value::Array(parts);
        table["rows"] = serde_json::to_value(&topics)?;
        fs::write(folder.join("validation.json"), serde_json::to_vec_pretty(&table)?)?;
        Ok(())
    }
}

impl PublishedRow {
    fn new(row: &Row, machine: &Machine) -> PublishedRow {
        PublishedRow {
            topic: row.topic.to_owned(),
            case: row.id.clone(),
            what: row.what.clone(),
            expected: row.expected.clone(),
            got: row.got.clone(),
            tolerance: row.tolerance.clone(),
            verdict: row.verdict().to_owned(),
            seconds: (10.0 * row.seconds).round() / 10.0,
            share: row.share,
            worst: false,
            measured: machine.measured.clone(),
            sources: machine.sources.to_owned(),
        }
    }

    fn plain(&self, all: &[Case]) -> Row {
        let case = all.iter().find(|case| case.id == self.case);
        Row {
            topic: case.expect("rows of other cases are left out").topic,
            id: self.case.clone(),
            what: self.what.clone(),
            expected: self.expected.clone(),
            got: self.got.clone(),
            tolerance: self.tolerance.clone(),
            passed: match self.verdict.as_str() {
                "pass" => Some(true),
                "FAIL" => Some(false),
                _ => None,
            },
            share: self.share,
            seconds: self.seconds,
        }
    }
}

/// Date, sources and load of a run, for captions.
fn part(machine: &Value) -> Value {
    json!({
        "measured": machine["measured"],
        "sources": machine["sources"],
        "load": machine["load"],
        "copy_bandwidth": machine["copy_bandwidth"],
    })
}

fn cases(rows: &[PublishedRow]) -> Vec<PublishedCase<'_>> {
    let mut cases: Vec<PublishedCase> = Vec::new();
    for row in rows {
        if cases.last().is_none_or(|case| case.case != row.case) {
            cases.push(PublishedCase {
                topic: &row.topic,
                case: &row.case,
                class: cost::class_of(&row.case).name(),
                judged: 0,
                failed: 0,
                seconds: row.seconds,
                measured: &row.measured,
                sources: &row.sources,
            });
        }
        let case = cases.last_mut().expect("one was pushed");
        case.judged += usize::from(row.verdict != sheet::INFORMATIONAL);
        case.failed += usize::from(row.verdict == "FAIL");
    }
    cases
}

fn write_csv(path: &Path, rows: &[impl Serialize]) -> Result<(), Box<dyn Error>> {
    let mut table = csv::Writer::from_path(path)?;
    for row in rows {
        table.serialize(row)?;
    }
    table.flush()?;
    Ok(())
}
