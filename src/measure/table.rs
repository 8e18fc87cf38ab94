//! What the tables of the benches share: where they were measured, and how they are written.

use std::fs;
use std::io::ErrorKind;
use std::ops::Range;
use std::path::Path;
use std::time::SystemTime;

use plotters::prelude::SVGBackend;
use serde::Serialize;

use crate::Error;
use crate::gpu::{AdapterReport, Gpu};
use crate::output::write_atomically;

use super::bandwidth::copy_bandwidth;
use super::statistics::Spread;

/// A digest of the sources, shaders and scenes that this was built from, 12 hexadecimal digits: the same where these are the same to the byte.
pub const SOURCES: &str = env!("CUTWATER_SOURCES");

/// When a table was measured, and on which CPU: what runs without an adapter says no more.
#[derive(Clone, Debug, Serialize)]
pub struct Host {
    /// Version of cutwater.
    pub cutwater: &'static str,
    /// The sources that it was built from: [`SOURCES`].
    pub sources: &'static str,
    /// When it began, UTC, as RFC 3339 has it.
    pub measured: String,
    /// Model of the CPU, where the system tells: software drivers and rivals run on it.
    pub cpu: Option<String>,
    /// Threads that the CPU runs at once.
    pub threads: usize,
    /// Load average of the minute before, where the system tells: what else the machine did.
    pub load: Option<f64>,
}

impl Host {
    /// Asks the system.
    pub fn now() -> Host {
        let load = fs::read_to_string("/proc/loadavg").ok();
        Host {
            cutwater: env!("CARGO_PKG_VERSION"),
            sources: SOURCES,
            measured: humantime::format_rfc3339_seconds(SystemTime::now()).to_string(),
            cpu: cpu(),
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            load: load.and_then(|text| text.split(' ').next()?.parse().ok()),
        }
    }
}

/// The line `model name : ...` of the first processor; some kinds of CPU have none.
fn cpu() -> Option<String> {
    let text = fs::read_to_string("/proc/cpuinfo").ok()?;
    let mut lines = text.lines().filter_map(|line| line.split_once(':'));
    let (_, model) = lines.find(|(key, _)| key.trim() == "model name")?;
    Some(model.trim().to_owned())
}

/// Where a table was measured.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    /// CPU and date.
    #[serde(flatten)]
    pub host: Host,
    /// Adapter.
    pub adapter: String,
    /// Driver.
    pub driver: String,
    /// Bytes per second of a copy, read and written.
    pub copy_bandwidth: Spread,
}

impl Machine {
    /// Measures the copy bandwidth.
    ///
    /// # Errors
    /// What the device says.
    pub fn new(gpu: &Gpu, repeats: usize) -> Result<Machine, Error> {
        let AdapterReport { name, driver, .. } = gpu.report().clone();
        Ok(Machine {
            host: Host::now(),
            adapter: name,
            driver,
            copy_bandwidth: copy_bandwidth(gpu, repeats)?,
        })
    }

    /// Bytes per second over the copy bandwidth.
    pub fn share_of_copy_bandwidth(&self, bytes: f64, seconds: f64) -> f64 {
        bytes / seconds / self.copy_bandwidth.median
    }
}

/// A table and where it was measured.
#[derive(Clone, Debug, Serialize)]
pub struct Table<Row> {
    /// Where.
    #[serde(flatten)]
    pub machine: Machine,
    /// The rows.
    pub rows: Vec<Row>,
}

/// Removes files of an earlier run into the same folder, which this one may not write: they would stand beside a JSON that says nothing of
/// them.
///
/// # Errors
/// [`Error::Output`] where one cannot be removed.
pub(super) fn remove_earlier(out: &Path, files: &[&str]) -> Result<(), Error> {
    files.iter().try_for_each(|file| remove(&out.join(file)))
}

/// Removes a file where there is one.
fn remove(path: &Path) -> Result<(), Error> {
    match fs::remove_file(path) {
        Err(problem) if problem.kind() != ErrorKind::NotFound => {
            Err(Error::unwritten(path, &problem))
        }
        _ => Ok(()),
    }
}

/// Writes rows with a head line; a number that is not finite is an empty cell, as it is `null` in JSON. Where there are no rows, nothing tells
/// the names of the columns: then there is no file, nor one of an earlier run.
///
/// # Errors
/// [`Error::Output`].
pub(super) fn write_csv<T: Serialize>(rows: &[T], path: &Path) -> Result<(), Error> {
    if rows.is_empty() {
        return remove(path);
    }
    let bytes = csv_bytes(rows).map_err(|error| Error::output(path, error))?;
    write_atomically(path, &bytes)
}

fn csv_bytes<T: Serialize>(rows: &[T]) -> Result<Vec<u8>, csv::Error> {
    let mut as_numbers_are = csv::Writer::from_writer(Vec::new());
    for row in rows {
        as_numbers_are.serialize(row)?;
    }
    let bytes = as_numbers_are.into_inner().map_err(|e| e.into_error())?;
    let mut written = csv::Writer::from_writer(Vec::new());
    for record in csv::ReaderBuilder::new()
        .has_headers(false)
        .from_reader(&bytes[..])
        .records()
    {
        let record = record?;
        written.write_record(record.iter().map(|cell| match cell {
            "NaN" | "inf" | "-inf" => "",
            _ => cell,
        }))?;
    }
    Ok(written.into_inner().map_err(|e| e.into_error())?)
}

/// Writes a table with all that belongs to it.
///
/// # Errors
/// [`Error::Output`].
pub(super) fn write_json<T: Serialize>(table: &T, path: &Path) -> Result<(), Error> {
    let text = serde_json::to_vec_pretty(table).map_err(|error| Error::output(path, error))?;
    write_atomically(path, &text)
}

/// Writes what `draw` draws on a page of `size` pixels.
///
/// # Errors
/// [`Error::Output`].
pub(super) fn write_svg(
    path: &Path,
    size: (u32, u32),
    draw: impl FnOnce(SVGBackend) -> Result<(), Box<dyn std::error::Error>>,
) -> Result<(), Error> {
    let mut text = String::new();
    draw(SVGBackend::with_string(&mut text, size)).map_err(|error| Error::output(path, error))?;
    write_atomically(path, text.as_bytes())
}

/// What a logarithmic axis of positive values spans: from below the least to above the largest.
pub(super) fn log_range(values: impl Iterator<Item = f64> + Clone) -> Range<f64> {
    let least = values.clone().fold(f64::INFINITY, f64::min);
    least / 1.5..1.5 * values.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::write_csv;

    #[test]
    fn a_number_that_is_not_finite_is_an_empty_cell() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        let rows = [
            (f64::NAN, -0.5, "a, b"),
            (f64::INFINITY, f64::NEG_INFINITY, ""),
        ];
        write_csv(&rows, &path).unwrap();
        let expected = ",-0.5,\"a, b\"\n,,\n";
        assert_eq!(fs::read_to_string(&path).unwrap(), expected);
    }

    #[test]
    fn a_table_without_rows_is_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        write_csv(&[(1, "a")], &path).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "1,a\n");
        for _ in 0..2 {
            write_csv::<(i32, &str)>(&[], &path).unwrap();
            assert!(!path.exists());
        }
    }
}
