//! The table of the validation.

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use cutwater::reference::larger;
use serde::{Deserialize, Serialize};

use crate::page::{self, Chart, Line};

/// A quantity, its expected value and its verdict.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Row {
    /// A section of docs/validation.md.
    #[serde(skip)]
    pub(crate) topic: &'static str,
    pub(crate) id: String,
    pub(crate) what: String,
    pub(crate) expected: String,
    pub(crate) got: String,
    pub(crate) tolerance: String,
    /// None where the number is informational.
    pub(crate) passed: Option<bool>,
    /// Error over the allowed error, where there is a bound.
    pub(crate) share: Option<f64>,
    /// Seconds of the whole case.
    pub(crate) seconds: f64,
}

/// Verdict of a number that is not judged.
pub(crate) const INFORMATIONAL: &str = "informational";

impl Row {
    pub(crate) fn verdict(&self) -> &'static str {
        match self.passed {
            Some(true) => "pass",
            Some(false) => "FAIL",
            None => INFORMATIONAL,
        }
    }

    pub(crate) fn cells(&self) -> [String; 7] {
        [
            self.id.clone(),
            self.what.clone(),
            self.expected.clone(),
            self.got.clone(),
            self.tolerance.clone(),
            self.verdict().to_owned(),
            format!("{:.1}", self.seconds),
        ]
    }

    /// The first two parts of the id: what has three is one of many variants.
    pub(crate) fn case(&self) -> &str {
        let end = self.id.match_indices('/').nth(1);
        &self.id[..end.map_or(self.id.len(), |(at, _)| at)]
    }

    /// Order by closeness to the bound: failures first, rows without a number after those with one, informational rows last.
    fn rank(&self) -> f64 {
        match self.passed {
            Some(true) => self.share.unwrap_or(-1.0),
            Some(false) => f64::INFINITY,
            None => -2.0,
        }
    }
}

pub(crate) const COLUMNS: [&str; 7] = ["case", "what", "expected", "got", "tolerance", "verdict", "seconds"];

/// The rows of one case.
#[derive(Debug, Default)]
pub(crate) struct Sheet {
    rows: Vec<Row>,
    charts: Vec<Chart>,
}

impl Sheet {
    fn row(&mut self, what: &str, expected: String, got: String, tolerance: String, passed: Option<bool>) {
        self.rows.push(Row {
            topic: "",
            id: String::new(),
            what: what.to_owned(),
            expected,
            got,
            tolerance,
            passed,
            share: None,
            seconds: 0.0,
        });
    }

    /// A number that is expected to be on one side of a bound.
    fn bounded(&mut self, what: &str, got: f64, expected: String, passed: bool) {
        self.row(what, expected, number(got), String::new(), Some(passed));
    }

    /// Sets the share of the last row.
    fn share(&mut self, share: f64) {
        if let Some(row) = self.rows.last_mut() {
            row.share = Some(share);
        }
    }

    /// Adds a chart of computed and expected values.
    pub(crate) fn chart(&mut self, title: &str, axes: [&str; 2], lines: Vec<Line>) {
        self.charts.push(Chart { id: String::new(), title: title.to_owned(), axes: axes.map(str::to_owned), lines });
    }

    /// |got - expected| <= tolerance |expected|.
    pub(crate) fn relative(&mut self, what: &str, expected: f64, got: f64, tolerance: f64) {
        let error = (got - expected).abs() / expected.abs();
        self.row(
            what,
            number(expected),
            format!("{} ({:+.1e})", number(got), (got - expected) / expected),
            format!("{tolerance:e} relative"),
            Some(error <= tolerance),
        );
        self.share(error / tolerance);
    }

    /// An error that may not be above its bound.
    pub(crate) fn at_most(&mut self, what: &str, got: f64, bound: f64) {
        self.bounded(what, got, format!("<= {}", short(bound)), got <= bound);
        if bound > 0.0 {
            self.share(larger(0.0, got) / bound);
        }
    }

    /// A number that would be `baseline` or less without errors, and may not be above its bound: the share is that of what lies between.
    pub(crate) fn excess(&mut self, what: &str, got: f64, baseline: f64, bound: f64) {
        self.bounded(what, got, format!("<= {}", short(bound)), got <= bound);
        self.share(larger(0.0, got - baseline) / (bound - baseline));
    }

    /// A rate of convergence.
    pub(crate) fn at_least(&mut self, what: &str, got: f64, bound: f64) {
        self.bounded(what, got, format!(">= {}", short(bound)), got >= bound);
        if bound > 0.0 && got > 0.0 {
            self.share(bound / got);
        }
    }

    /// A property that holds or does not, in words.
    pub(crate) fn holds(&mut self, what: &str, expected: &str, got: String, passed: bool) {
        self.row(what, expected.into(), got, String::new(), Some(passed));
    }

    /// An informational row: a number that no theory predicts.
    pub(crate) fn info(&mut self, what: &str, got: String) {
        self.row(what, String::new(), got, String::new(), None);
    }

    /// The case ended before its time.
    pub(crate) fn failed(&mut self, problem: &str) {
        self.row(
            "ran to its end",
            "yes".into(),
            problem.lines().collect::<Vec<_>>().join("; "),
            String::new(),
            Some(false),
        );
    }

    /// Rows and charts of a case that took so many seconds.
    pub(crate) fn finish(mut self, topic: &'static str, id: &str, seconds: f64) -> (Vec<Row>, Vec<Chart>) {
        if self.rows.is_empty() {
            self.failed("the case has no rows");
        }
        for row in &mut self.rows {
            (row.topic, row.id, row.seconds) = (topic, id.to_owned(), seconds);
        }
        for chart in &mut self.charts {
            chart.id = id.to_owned();
        }
        (self.rows, self.charts)
    }
}

/// Five digits.
fn number(x: f64) -> String {
    match x.abs() {
        0.01..1e5 => {
            let digits = (4 - x.abs().log10().floor() as i32).max(0);
            format!("{x:.*}", digits as usize)
        }
        0.0 => "0".into(),
        _ => format!("{x:.2e}"),
    }
}

/// The same without zeros at the end.
fn short(x: f64) -> String {
    let text = number(x);
    match text.contains('.') && !text.contains('e') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// Rows as text, one a line.
pub(crate) fn lines(rows: &[Row]) -> String {
    let mut text = String::new();
    for row in rows {
        let [id, what, expected, got, tolerance, verdict, seconds] = row.cells();
        let expected = match expected.is_empty() {
            true => String::new(),
            false => format!(", expected {expected}"),
        };
        let tolerance = match tolerance.is_empty() {
            true => String::new(),
            false => format!(", allowed {tolerance}"),
        };
        writeln!(text, "{verdict} {id:<20} {what}: {got}{expected}{tolerance}  [{seconds} s]")
            .expect("a String takes everything");
    }
    text
}

/// Indices of the row of each case that is closest to its bound; of several that fail, the first.
pub(crate) fn worst(rows: &[Row]) -> BTreeSet<usize> {
    let mut found: BTreeMap<&str, usize> = BTreeMap::new();
    for (number, row) in rows.iter().enumerate() {
        let worst = found.entry(row.case()).or_insert(number);
        if row.rank() > rows[*worst].rank() {
            *worst = number;
        }
    }
    found.into_values().collect()
}

/// A row of validation_topics.csv.
#[derive(Debug, Default, Serialize)]
pub(crate) struct Topic {
    topic: &'static str,
    cases: usize,
    /// Rows with a verdict.
    judged: usize,
    failed: usize,
    /// Rows without.
    informational: usize,
    /// Of all cases, s.
    seconds: f64,
}

/// Sums per topic, of rows in the order of the cases.
pub(crate) fn topics(rows: &[Row]) -> Vec<Topic> {
    let mut topics: Vec<Topic> = Vec::new();
    let mut id = "";
    for row in rows {
        if topics.last().is_none_or(|topic| topic.topic != row.topic) {
            topics.push(Topic { topic: row.topic, ..Topic::default() });
        }
        let topic = topics.last_mut().expect("one was pushed");
        if row.id != id {
            id = &row.id;
            topic.cases += 1;
            topic.seconds += row.seconds;
        }
        topic.judged += usize::from(row.passed.is_some());
        topic.failed += usize::from(row.passed == Some(false));
        topic.informational += usize::from(row.passed.is_none());
    }
    topics
}

/// Where a run writes, `target/validate`.
pub(crate) fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("target/validate")
}

/// Writes page and pictures of a run to [`folder`].
pub(crate) fn write(rows: &[Row], charts: &[Chart], summary: &str) -> Result<(), Box<dyn Error>> {
    let folder = folder();
    fs::create_dir_all(&folder)?;
    // A run of more cases may have left some.
    for entry in fs::read_dir(&folder)? {
        let file = entry?.path();
        if file.extension().is_some_and(|end| end == "svg") {
            fs::remove_file(file)?;
        }
    }
    page::write(&folder, rows, charts, summary)
}
