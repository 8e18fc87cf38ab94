//! Benches: one skeleton, and a file of cases and columns for each.
//!
//! A bench declares its tables ([`table::Table`]) and gives a list of `Case`s. `Run::cases` measures one after another, puts their rows into
//! the tables and writes all files anew after each: CSV, JSON with machine and request, SVG. With `--resume` finished rows of an earlier run
//! with the same request stay. `rounds` repeats timed jobs in a shuffled order; ratios are of the same round.

pub mod accuracy;
mod bytes;
pub mod chart;
pub mod device;
pub mod effects;
pub mod ended;
mod machine;
pub mod outputs;
pub mod solids;
pub mod solve;
pub mod stability;
pub mod statistics;
pub mod step;
mod sub_step;
pub mod table;
pub mod thesis;

use std::fmt::Debug;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::ser::{Serialize, SerializeMap, Serializer};
use serde_json::Value as Json;

use crate::Error;
use crate::output::{FolderLock, write_atomically};
use chart::Page;
use statistics::Spread;
use table::{Row, Table, row};

pub use machine::{Machine, SOURCES};

/// Seed of the shuffling: the same order in every run.
const SEED: u64 = 20;
/// Time between two messages of progress.
const PAUSE: Duration = Duration::from_secs(5);
/// Cure for rows that a run cannot resume from.
const ANEW: &str = "measure into another folder (--out), or leave --resume out to measure all anew";

/// Options of every bench.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Folder of the results.
    pub out: PathBuf,
    /// Timed runs per row, at most.
    pub repeats: usize,
    /// A row is not repeated once its runs took so many seconds.
    pub seconds: f64,
    /// Whether finished rows of an earlier run with the same request stay.
    pub resume: bool,
}

/// Messages of a bench at work.
#[derive(Clone, Copy, Debug)]
pub enum Event<'a> {
    /// A row was measured.
    Row(&'a Table, &'a Row),
    /// How far the bench is.
    Progress(&'a str),
}

/// Receives the messages.
pub type Listener<'a> = &'a mut dyn FnMut(Event);

/// Stem of a picture, and how it is drawn.
type Picture = (&'static str, fn(&Results) -> Page);

/// What a bench is: its files but for `NAME.json`.
pub(in crate::measure) struct Bench {
    /// Stem of its JSON file.
    pub(in crate::measure) name: &'static str,
    /// Its tables; the first has the key `rows` in JSON.
    pub(in crate::measure) tables: Vec<Table>,
    /// Makes tables that follow from others anew.
    pub(in crate::measure) derive: fn(&mut [Table]),
    /// Stems of its pictures, and each drawn from the tables; an empty page is no file.
    pub(in crate::measure) pictures: &'static [Picture],
}

/// Tables of a bench, and where they were measured.
#[derive(Clone, Debug)]
pub struct Results {
    /// Where.
    pub machine: Machine,
    /// All tables, also those without rows.
    pub tables: Vec<Table>,
    /// Failed checks, a line each.
    pub failures: Vec<String>,
    /// Runs that measured the rows, first to last: several where rows were kept.
    parts: Vec<Json>,
    request: String,
}

impl Results {
    /// Rows of a table by the stem of its file; none of a table that there is not.
    pub fn rows(&self, name: &str) -> &[Row] {
        rows(&self.tables, name)
    }

    /// # Errors
    /// [`Error::Check`] with all failed checks.
    pub fn verdict(&self) -> Result<(), Error> {
        match self.failures.is_empty() {
            true => Ok(()),
            false => Err(Error::Check(self.failures.join("\n  "))),
        }
    }
}

/// Rows of a table by its name.
fn rows<'a>(tables: &'a [Table], name: &str) -> &'a [Row] {
    let table = tables.iter().find(|table| table.name == name);
    table.map_or(&[], |table| &table.rows)
}

/// Replaces the rows of a table by its name.
fn replace(tables: &mut [Table], name: &str, rows: Vec<Row>) {
    if let Some(table) = tables.iter_mut().find(|table| table.name == name) {
        table.rows = rows;
    }
}

impl Serialize for Results {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let mut map = to.serialize_map(None)?;
        let machine = serde_json::to_value(&self.machine).map_err(serde::ser::Error::custom)?;
        for (key, value) in machine.as_object().into_iter().flatten() {
            map.serialize_entry(key, value)?;
        }
        map.serialize_entry("request", &self.request)?;
        map.serialize_entry("parts", &self.parts)?;
        for (at, table) in self.tables.iter().enumerate() {
            let key = table
                .name
                .split_once('_')
                .map_or(table.name, |(_, key)| key);
            map.serialize_entry(if at == 0 { "rows" } else { key }, table)?;
        }
        map.end()
    }
}

/// One case: measures and returns rows, each with the name of its table.
pub(in crate::measure) struct Case<'c> {
    /// Table and key of a row by which the case counts as measured.
    pub(in crate::measure) key: (&'static str, Row),
    /// Measures it.
    #[expect(clippy::type_complexity, reason = "named once")]
    pub(in crate::measure) measure:
        Box<dyn FnMut(&mut Run) -> Result<Vec<(&'static str, Row)>, Error> + 'c>,
}

/// A bench at work.
pub(in crate::measure) struct Run<'a> {
    bench: Bench,
    pub(in crate::measure) settings: Settings,
    pub(in crate::measure) results: Results,
    listener: Listener<'a>,
    spoke: Instant,
    _lock: FolderLock,
}

impl<'a> Run<'a> {
    /// Locks the folder, reads the rows to resume from or removes files of an earlier run, and writes the JSON file. `request`: options that
    /// decide the rows.
    ///
    /// # Errors
    /// [`Error::Output`] where the folder cannot be written, [`Error::Input`] where another process writes into it or an earlier run had another
    /// request.
    pub(in crate::measure) fn start(
        bench: Bench,
        machine: Machine,
        request: &dyn Debug,
        settings: &Settings,
        listener: Listener<'a>,
    ) -> Result<Run<'a>, Error> {
        let request = format!(
            "{request:?}, {} repeats, {} s",
            settings.repeats, settings.seconds
        );
        let mut run = Run {
            _lock: FolderLock::take(&settings.out)?,
            settings: settings.clone(),
            results: Results {
                machine,
                tables: bench.tables.clone(),
                failures: Vec::new(),
                parts: Vec::new(),
                request,
            },
            bench,
            listener,
            spoke: Instant::now(),
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

    /// Takes the rows of an earlier run over.
    fn resume(&mut self) -> Result<(), Error> {
        let path = self.file(self.bench.name, "json");
        let Ok(text) = fs::read_to_string(&path) else {
            return Ok(());
        };
        let refused = |problem: String| Error::input(path.display().to_string(), problem, ANEW);
        let then: Json = serde_json::from_str(&text)
            .map_err(|problem| refused(format!("cannot be read: {problem}")))?;
        let now =
            serde_json::to_value(&self.results).map_err(|problem| Error::output(&path, problem))?;
        for key in [
            "cutwater", "sources", "adapter", "driver", "cpu", "threads", "request",
        ] {
            if then[key] != now[key] {
                return Err(refused(format!(
                    "it has {key} {}, this run {}",
                    then[key], now[key]
                )));
            }
        }
        self.results.parts = then["parts"].as_array().cloned().unwrap_or_default();
        for table in &mut self.results.tables {
            table.read_csv(&self.settings.out.join(format!("{}.csv", table.name)))?;
        }
        Ok(())
    }

    /// Measures cases, but for those whose rows are kept, and writes all files after each.
    pub(in crate::measure) fn cases(&mut self, cases: Vec<Case>) -> Result<(), Error> {
        let (clock, of) = (Instant::now(), cases.len());
        for (done, Case { key, mut measure }) in cases.into_iter().enumerate() {
            let table = self.results.tables.iter().find(|table| table.name == key.0);
            if table.is_some_and(|table| table.has(&key.1)) {
                continue;
            }
            let rows = measure(self)?;
            self.put(rows)?;
            self.progress("cases", done + 1, of, clock);
        }
        Ok(())
    }

    /// Puts rows into their tables and writes all files.
    pub(in crate::measure) fn put(&mut self, rows: Vec<(&'static str, Row)>) -> Result<(), Error> {
        for (name, row) in rows {
            let table = self
                .results
                .tables
                .iter_mut()
                .find(|table| table.name == name);
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

    /// Tells how far the bench is, every few seconds.
    pub(in crate::measure) fn progress(
        &mut self,
        what: &str,
        done: usize,
        of: usize,
        clock: Instant,
    ) {
        if done < of && self.spoke.elapsed() >= PAUSE {
            self.spoke = Instant::now();
            let left = clock.elapsed().as_secs_f64() * (of - done) as f64 / done as f64;
            (self.listener)(Event::Progress(&format!(
                "{done} of {of} {what}, {left:.0} s left"
            )));
        }
    }

    /// Writes all files.
    fn write(&mut self) -> Result<(), Error> {
        (self.bench.derive)(&mut self.results.tables);
        write_json(&self.results, &self.file(self.bench.name, "json"))?;
        for table in &self.results.tables {
            table.write_csv(&self.file(table.name, "csv"))?;
        }
        for (name, draw) in self.bench.pictures {
            draw(&self.results).write(&self.file(name, "svg"))?;
        }
        Ok(())
    }
}

/// Seconds of a job in each round, none in rounds without it, and its first outcome.
pub(in crate::measure) struct Timed<T> {
    pub(in crate::measure) seconds: Vec<Option<f64>>,
    pub(in crate::measure) outcome: T,
}

impl<T> Timed<T> {
    /// Runs.
    pub(in crate::measure) fn runs(&self) -> usize {
        self.seconds.iter().flatten().count()
    }

    /// Their seconds.
    pub(in crate::measure) fn spread(&self) -> Spread {
        Spread::of(self.seconds.iter().flatten().copied().collect())
    }

    /// Seconds over those of another job in the same round.
    pub(in crate::measure) fn ratio<U>(&self, to: &Timed<U>) -> Spread {
        let pairs = self.seconds.iter().zip(&to.seconds);
        Spread::of(
            pairs
                .filter_map(|(own, other)| Some((*own)? / (*other)?))
                .collect(),
        )
    }
}

/// Does every job once a round, as often as the settings ask, in a shuffled order. A job whose runs took long enough is left out of further
/// rounds. A job returns its seconds and its outcome.
pub(in crate::measure) fn rounds<T>(
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
            let taken = |timed: &Timed<T>| timed.seconds.iter().flatten().sum::<f64>();
            if timed[number]
                .as_ref()
                .is_some_and(|timed| taken(timed) >= most)
            {
                continue;
            }
            let (seconds, outcome) = job(number)?;
            let timed = timed[number].get_or_insert_with(|| Timed {
                seconds: Vec::new(),
                outcome,
            });
            timed.seconds.resize(round, None);
            timed.seconds.push(Some(seconds));
            run.progress(what, round * jobs + done + 1, repeats * jobs, clock);
        }
    }
    Ok(timed.into_iter().flatten().collect())
}

/// Exponents of the growth of `seconds` along a size, of rows of one series.
fn growth(members: &[&Row], size: &str) -> Option<Row> {
    let points = members
        .iter()
        .map(|row| Some((row.number(size), row.spread("seconds")?)));
    let exponents = statistics::Exponents::of(&points.collect::<Option<Vec<_>>>()?)?;
    let sizes = members.iter().map(|row| row.count(size));
    // Rows of one run have no spread.
    let spread = members.iter().all(|row| row.number("runs") > 1.0);
    Some(row! {
        rows: members.len(), from: sizes.clone().min()?, to: sizes.max()?, exponent: exponents.fit, exponent_last: exponents.last,
        exponent_low: spread.then_some(exponents.low), exponent_high: spread.then_some(exponents.high),
    })
}

table::columns! {
    /// Columns of [`growth`].
    GROWTH {
        along + "" "`cells`: the grid is refined, the solids stay; `nodes`: the other way round; `both`: refined together, cells count";
        fixed + "" "what stays: nodes, or the grid";
        rows - "" "rows of the fit";
        from + "" "least of what grows";
        to + "" "largest";
        exponent + "" "e of seconds ~ size^e through the medians";
        exponent_last - "" "of the two largest sizes";
        exponent_low + "" "least fit through values within the spreads; empty for rows of one run";
        exponent_high + "" "largest";
    }
    /// Traffic between host and device, per solve or sub-step.
    TRAFFIC {
        waits + "" "times that the host waits for the device";
        submissions - "" "command buffers";
        dispatches + "" "kernels";
        bytes_up - "B" "bytes that the host writes to buffers";
        bytes_down - "B" "bytes that the host reads back";
        idle_seconds - "s" "seconds without work in the device's queue, median";
        device_bytes - "B" "bytes of all buffers";
    }
}

/// Removes a file where there is one.
pub(in crate::measure) fn remove(path: &Path) -> Result<(), Error> {
    match fs::remove_file(path) {
        Err(problem) if problem.kind() != ErrorKind::NotFound => {
            Err(Error::unwritten(path, &problem))
        }
        _ => Ok(()),
    }
}

fn write_json(value: &impl Serialize, path: &Path) -> Result<(), Error> {
    let text = serde_json::to_vec_pretty(value).map_err(|problem| Error::output(path, problem))?;
    write_atomically(path, &text)
}
