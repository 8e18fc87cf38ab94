//! Measurements: benches, comparisons, reports. Speed is claimed here only, as medians with their spread.

pub mod base_scene;
pub mod bench;
pub mod bounds;
pub mod compare;
pub mod converge;
pub mod export;
pub mod probe_statistics;
mod stored;
pub mod sweep;

use std::fmt::Debug;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;

use serde::Serialize;

use crate::Error;
use crate::output::write_atomically;

/// Removes a file if it exists.
fn remove(path: &Path) -> Result<(), Error> {
    match fs::remove_file(path) {
        Err(problem) if problem.kind() != ErrorKind::NotFound => Err(Error::unwritten(path, &problem)),
        _ => Ok(()),
    }
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<(), Error> {
    let text = serde_json::to_vec_pretty(value).map_err(|problem| Error::output(path, problem))?;
    write_atomically(path, &text)
}

/// Writes records, the head line first.
fn write_csv<T: Serialize>(path: &Path, records: impl IntoIterator<Item = Vec<T>>) -> Result<(), Error> {
    let bytes = || {
        let mut to = csv::Writer::from_writer(Vec::new());
        records.into_iter().try_for_each(|record| to.serialize(record))?;
        Ok(to.into_inner().map_err(|problem| problem.into_error())?)
    };
    let bytes = bytes().map_err(|problem: csv::Error| Error::output(path, problem))?;
    write_atomically(path, &bytes)
}

/// Cell of a CSV file; empty without a value.
fn cell<T: Debug>(value: Option<T>) -> String {
    value.map_or(String::new(), |value| format!("{value:?}"))
}
