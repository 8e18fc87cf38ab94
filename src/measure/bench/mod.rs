//! Benches: one skeleton, and a file of cases and columns for each.
//!
//! A bench declares its tables ([`table::Table`]) and a list of `Case`s. `Run::cases` measures them in order, adds their rows to the tables and
//! rewrites all files after each case: CSV, JSON with machine and request, SVG. With `--resume` finished rows of an earlier run with the same
//! request remain. `rounds` repeats timed jobs in a shuffled order; ratios are within a round.

pub mod accuracy;
mod bytes;
pub mod chart;
pub mod device;
pub mod effects;
pub mod ended;
mod machine;
pub mod solve;
pub mod stability;
pub mod statistics;
pub mod step;
mod sub_step;
pub mod table;

use std::fmt::Debug;
use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value as Json;

use super::write_json;
use crate::Error;
use crate::gpu::{Gpu, Traffic};
use crate::output::FolderLock;
use crate::scene::Scene;
use chart::Page;
use statistics::Spread;
use table::{Row, Table, row};

pub use machine::{Machine, SOURCES};

/// Seed of the shuffle: the same order in every run.
const SEED: u64 = 20;
/// Time between two messages of progress.
const PAUSE: Duration = Duration::from_secs(5);

/// Options of every bench.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Folder of the results.
    pub out: PathBuf,
    /// Timed runs per row, at most.
    pub repeats: usize,
    /// Total seconds of a row above which it is not repeated.
    pub seconds: f64,
    /// Whether to keep finished rows of an earlier run with the same request.
    pub resume: bool,
}

/// Messages of a bench.
#[derive(Clone, Copy, Debug)]
pub enum Event<'a> {
    /// A row was measured.
    Row(&'a Table, &'a Row),
    /// Progress in words.
    Progress(&'a str),
}

/// Receives the messages.
pub type Listener<'a> = &'a mut dyn FnMut(Event);

/// Stem of a picture, and its drawing.
type Picture = (&'static str, fn(&Results) -> Page);

pub(crate) struct Bench {
    /// Stem of its JSON file.
    pub(crate) name: &'static str,
    /// Its tables; the first has the key `rows` in JSON.
    pub(crate) tables: Vec<Table>,
    /// Computes tables from others.
    pub(crate) derive: fn(&mut [Table]),
    /// Pictures of the tables; an empty page is no file.
    pub(crate) pictures: &'static [Picture],
}

/// Tables of a bench and their machine.
#[derive(Clone, Debug, Serialize)]
pub struct Results {
    /// Machine of the measurement.
    #[serde(flatten)]
    pub machine: Machine,
    request: String,
    /// Runs that measured the rows, first to last: several if rows were kept.
    parts: Vec<Json>,
    /// All tables, also empty ones.
    #[serde(flatten, serialize_with = "by_key")]
    pub tables: Vec<Table>,
    /// Failed checks, a line each.
    #[serde(skip)]
    pub failures: Vec<String>,
}

impl Results {
    /// Rows of a table by the stem of its file; empty for an unknown table.
    pub fn rows(&self, name: &str) -> &[Row] {
        rows(&self.tables, name)
    }

    /// # Errors
    /// [`Error::Check`] with all failed checks.
    pub fn verdict(&self) -> Result<(), Error> {
        if self.failures.is_empty() { Ok(()) } else { Err(Error::Check(self.failures.join("\n  "))) }
    }
}

/// Digests of scenes, for requests.
fn hashes<'s>(scenes: impl IntoIterator<Item = &'s Scene>) -> Vec<&'s str> {
    scenes.into_iter().map(|scene| scene.hash.as_str()).collect()
}

/// Bytes of all buffers of a device so far.
fn allocated_bytes(gpu: &Gpu) -> u64 {
    gpu.allocated().iter().map(|(_, bytes)| bytes).sum()
}

/// Rows of a table by its name.
fn rows<'a>(tables: &'a [Table], name: &str) -> &'a [Row] {
    tables.iter().find(|table| table.name == name).map_or(&[], |table| &table.rows)
}

/// Replaces the rows of a table by its name.
fn replace(tables: &mut [Table], name: &str, rows: Vec<Row>) {
    if let Some(table) = tables.iter_mut().find(|table| table.name == name) {
        table.rows = rows;
    }
}

/// Key of a table in JSON: the end of its name; `rows` for the first.
fn json_key(at: usize, table: &Table) -> &'static str {
    let end = table.name.split_once('_').map_or(table.name, |(_, end)| end);
    if at == 0 { "rows" } else { end }
}

fn by_key<S: Serializer>(tables: &[Table], to: S) -> Result<S::Ok, S::Error> {
    to.collect_map(tables.iter().enumerate().map(|(at, table)| (json_key(at, table), table)))
}

/// Rows, each with the name of its table.
pub(crate) type Rows = Vec<(&'static str, Row)>;

type Measure<'c> = Box<dyn FnMut(&mut Run) -> Result<Rows, Error> + 'c>;

/// A case that `measure` measures. A row with this key, in this table, marks it as measured.
pub(crate) struct Case<'c> {
    table: &'static str,
    key: Row,
    measure: Measure<'c>,
}

impl<'c> Case<'c> {
    pub(crate) fn new(
        table: &'static str,
        key: Row,
        measure: impl FnMut(&mut Run) -> Result<Rows, Error> + 'c,
    ) -> Case<'c> {
        Case { table, key, measure: Box::new(measure) }
    }
}

/// A running bench.
pub(crate) struct Run<'a> {
    bench: Bench,
    pub(crate) settings: Settings,
    pub(crate) results: Results,
    listener: Listener<'a>,
    last_message: Instant,
    _lock: FolderLock,
}

impl<'a> Run<'a> {
    /// Locks the folder, reads the rows to keep or removes files of an earlier run, and writes the JSON file. `request`: options that determine the
    /// rows.
    ///
    /// # Errors
    /// [`Error::Output`] if the folder cannot be written, [`Error::Input`] if another process writes into it or an earlier run had another request.
    pub(crate) fn start(
        bench: Bench,
        machine: Machine,
        request: &dyn Debug,
        settings: &Settings,
        listener: Listener<'a>,
    ) -> Result<Run<'a>, Error> {
        let request = format!("{request:?}, {} repeats, {} s", settings.repeats, settings.seconds);
        let tables = bench.tables.clone();
        let mut run = Run {
            _lock: FolderLock::take(&settings.out)?,
            settings: settings.clone(),
            results: Results { machine, request, parts: Vec::new(), tables, failures: Vec::new() },
            bench,
            listener,
            last_message: Instant::now(),
        };
        if settings.resume {
            run.resume()?;
        }
        run.write()?;
        Ok(run)
    }

    fn file(&self, name: &str, end: &str) -> PathBuf {
        self.settings.out.join(format!("{name}.{end}"))
    }

    /// Reads the rows of an earlier run.
    fn resume(&mut self) -> Result<(), Error> {
        let path = self.file(self.bench.name, "json");
        let Ok(text) = fs::read_to_string(&path) else { return Ok(()) };
        let refused = |problem: String| {
            let cure = "measure into another folder (--out), or leave --resume out to measure all anew";
            Error::input(path.display().to_string(), problem, cure)
        };
        let unreadable = |problem| refused(format!("cannot be read: {problem}"));
        let then: Json = serde_json::from_str(&text).map_err(unreadable)?;
        let now = serde_json::to_value(&self.results).map_err(|problem| Error::output(&path, problem))?;
        for key in ["cutwater", "sources", "adapter", "driver", "cpu", "threads", "request"] {
            if then[key] != now[key] {
                return Err(refused(format!("it has {key} {}, this run {}", then[key], now[key])));
            }
        }
        self.results.parts = then["parts"].as_array().cloned().unwrap_or_default();
        for (at, table) in self.results.tables.iter_mut().enumerate() {
            table.rows = Vec::deserialize(&then[json_key(at, table)]).map_err(unreadable)?;
        }
        Ok(())
    }

    /// Measures all cases without kept rows, and writes all files after each.
    pub(crate) fn cases(&mut self, cases: Vec<Case>) -> Result<(), Error> {
        let (clock, total) = (Instant::now(), cases.len());
        for (done, mut case) in cases.into_iter().enumerate() {
            if !self.results.rows(case.table).iter().any(|row| row.contains(&case.key)) {
                let rows = (case.measure)(self)?;
                self.put(rows)?;
                self.progress("cases", done + 1, total, clock);
            }
        }
        Ok(())
    }

    /// Adds rows to their tables and writes all files.
    pub(crate) fn put(&mut self, rows: Rows) -> Result<(), Error> {
        for (name, row) in rows {
            let table = self.results.tables.iter_mut().find(|table| table.name == name);
            let table = table.expect("the bench declares the table");
            table.put(row.clone());
            (self.listener)(Event::Row(table, &row));
        }
        let machine = &self.results.machine;
        let part = serde_json::json!({
            "measured": machine.measured, "load": machine.load, "copy_bandwidth": machine.copy_bandwidth,
        });
        if self.results.parts.last() != Some(&part) {
            self.results.parts.push(part);
        }
        self.write()
    }

    /// Reports progress every few seconds.
    pub(crate) fn progress(&mut self, what: &str, done: usize, total: usize, clock: Instant) {
        if done < total && self.last_message.elapsed() >= PAUSE {
            self.last_message = Instant::now();
            let left = clock.elapsed().as_secs_f64() * (total - done) as f64 / done as f64;
            (self.listener)(Event::Progress(&format!("{done} of {total} {what}, {left:.0} s left")));
        }
    }

    /// Writes all files.
    fn write(&mut self) -> Result<(), Error> {
        (self.bench.derive)(&mut self.results.tables);
        write_json(&self.file(self.bench.name, "json"), &self.results)?;
        for table in &self.results.tables {
            table.write_csv(&self.file(table.name, "csv"))?;
        }
        for (name, draw) in self.bench.pictures {
            draw(&self.results).write(&self.file(name, "svg"))?;
        }
        Ok(())
    }
}

/// Seconds of a job in each round, `None` in rounds without it, and its first outcome.
pub(crate) struct Timed<T> {
    pub(crate) seconds: Vec<Option<f64>>,
    pub(crate) outcome: T,
}

impl<T> Timed<T> {
    /// Number of runs.
    pub(crate) fn runs(&self) -> usize {
        self.seconds.iter().flatten().count()
    }

    /// Spread of the seconds.
    pub(crate) fn spread(&self) -> Spread {
        Spread::of(self.seconds.iter().flatten().copied().collect())
    }

    /// Seconds over those of another job in the same round.
    pub(crate) fn ratio<U>(&self, to: &Timed<U>) -> Spread {
        let pairs = self.seconds.iter().zip(&to.seconds);
        Spread::of(pairs.filter_map(|(own, other)| Some((*own)? / (*other)?)).collect())
    }
}

/// Runs every job once per round in a shuffled order, for `repeats` rounds. A job that exceeds the total seconds of the settings is left out of
/// further rounds. A job returns its seconds and its outcome.
pub(crate) fn rounds<T>(
    run: &mut Run,
    what: &str,
    jobs: usize,
    mut job: impl FnMut(usize) -> Result<(f64, T), Error>,
) -> Result<Vec<Timed<T>>, Error> {
    let (repeats, most) = (run.settings.repeats.max(1), run.settings.seconds);
    let mut random = fastrand::Rng::with_seed(SEED);
    let mut order: Vec<usize> = (0..jobs).collect();
    let mut timed: Vec<Option<Timed<T>>> = (0..jobs).map(|_| None).collect();
    let clock = Instant::now();
    for round in 0..repeats {
        random.shuffle(&mut order);
        for (done, &number) in order.iter().enumerate() {
            let total = |timed: &Timed<T>| timed.seconds.iter().flatten().sum::<f64>();
            if timed[number].as_ref().is_some_and(|timed| total(timed) >= most) {
                continue;
            }
            let (seconds, outcome) = job(number)?;
            let timed = timed[number].get_or_insert_with(|| Timed { seconds: Vec::new(), outcome });
            timed.seconds.resize(round, None);
            timed.seconds.push(Some(seconds));
            run.progress(what, round * jobs + done + 1, repeats * jobs, clock);
        }
    }
    Ok(timed.into_iter().flatten().collect())
}

/// Exponents of the growth of `seconds` along a size, for rows of one series.
fn growth(members: &[&Row], size: &str) -> Option<Row> {
    let points = members.iter().map(|row| Some((row.number(size), row.spread("seconds")?)));
    let [fit, last, low, high] = statistics::exponents(&points.collect::<Option<Vec<_>>>()?)?;
    let sizes = members.iter().map(|row| row.count(size));
    // Rows of one run have no spread.
    let spread = members.iter().all(|row| row.number("runs") > 1.0);
    Some(row! {
        rows: members.len(), from: sizes.clone().min()?, to: sizes.max()?, exponent: fit, exponent_last: last,
        exponent_low: spread.then_some(low), exponent_high: spread.then_some(high),
    })
}

/// Columns of [`TRAFFIC`] that are counts.
fn traffic_counts(traffic: &Traffic) -> Row {
    row! {
        waits: traffic.waits, submissions: traffic.submissions, dispatches: traffic.dispatches, bytes_up: traffic.bytes_up,
        bytes_down: traffic.bytes_down,
    }
}

table::columns! {
    /// Columns of [`growth`].
    GROWTH {
        + along "" "`cells`: the grid is refined, the solids stay; `nodes`: the other way round; `both`: refined together, cells count";
        + fixed "" "fixed size: nodes, or the grid";
        - rows "" "rows of the fit";
        + from, to "" "least and largest size";
        + exponent "" "e of seconds ~ size^e through the medians";
        - exponent_last "" "of the two largest sizes";
        + exponent_low, exponent_high "" "least and largest fit through values within the spreads; empty for rows of one run";
    }
    /// Traffic between host and device, per solve or sub-step.
    TRAFFIC {
        + waits "" "times that the host waits for the device";
        - submissions "" "command buffers";
        + dispatches "" "kernels";
        - bytes_up "B" "bytes that the host writes to buffers";
        - bytes_down "B" "bytes that the host reads back";
        - idle_seconds "s" "seconds without work in the device's queue, median";
        - device_bytes "B" "bytes of all buffers";
    }
}
