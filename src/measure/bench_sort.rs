//! `bench sort`: the sort of the GPU layer against the length of the list, and against a copy of the bytes that it must move.
//!
//! A run counts from the submission of a sort of random keys to the end of its work. The first run of each row, which compiles,
//! is not counted; its result is checked.

use std::path::Path;
use std::time::Instant;

use serde::Serialize;

use crate::Error;
use crate::gpu::{Buffer, Entries, Gpu, Recorder, Sort, SortKernels};
use crate::output::FolderLock;

use super::statistics::Spread;
use super::table::{Machine, write_csv, write_json};

/// What to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Entries of the lists.
    pub entries: Vec<usize>,
    /// Bits of the keys.
    pub bits: u32,
    /// Timed runs per row.
    pub repeats: usize,
}

/// A row of sort.csv.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Entries of the list.
    pub entries: usize,
    /// Bits of the keys.
    pub bits: u32,
    /// Seconds of a sort.
    pub seconds_median: f64,
    /// Least.
    pub seconds_min: f64,
    /// Largest.
    pub seconds_max: f64,
    /// Bytes that it must move.
    pub bytes: f64,
    /// Bytes per second over the copy bandwidth of the same run.
    pub share_of_copy_bandwidth: f64,
}

/// A row per length.
pub type Table = super::table::Table<Row>;

/// Measures all rows and writes sort.csv and sort.json into `out`, anew after each; `tell` hears of each row.
///
/// # Errors
/// Before any work [`Error::Output`] where the folder cannot be written and [`Error::Input`] where another process writes into it; then
/// what the device says, and [`Error::Check`] when a list is not sorted.
pub fn bench_sort(
    gpu: &Gpu,
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(&Row),
) -> Result<Table, Error> {
    let _held = FolderLock::take(out)?;
    let mut table = Table {
        machine: Machine::new(gpu, options.repeats)?,
        rows: Vec::new(),
    };
    for &n in &options.entries {
        let row = measure(gpu, n, options, &table.machine)?;
        tell(&row);
        table.rows.push(row);
        write_csv(&table.rows, &out.join("sort.csv"))?;
        write_json(&table, &out.join("sort.json"))?;
    }
    Ok(table)
}

fn measure(gpu: &Gpu, n: usize, options: &Options, machine: &Machine) -> Result<Row, Error> {
    let bits = options.bits;
    let list = |label| gpu.buffer::<u32>(label, n);
    let source = list("bench.shuffled")?;
    let (keys, values) = (list("bench.keys")?, list("bench.values")?);
    let (spare_keys, spare_values) = (list("bench.spare_keys")?, list("bench.spare_values")?);
    let scratch = Sort::scratch("bench.chunks", n);
    let scratch: Buffer<u32> = gpu.buffer(scratch.label, scratch.len)?;
    let args = gpu.buffer_with("bench.args", &[0, 0, 0, n as u32])?;
    // Made once the lists are known to fit.
    let shuffled: Vec<u32> = (0..n as u32).map(|ix| hash(ix) >> (32 - bits)).collect();
    gpu.upload(&source, &shuffled);
    let entries = Entries {
        keys: &keys,
        values: &values,
    };
    let spare = Entries {
        keys: &spare_keys,
        values: &spare_values,
    };
    let kernels = SortKernels::new(gpu)?;
    let sort = Sort::new(gpu, &kernels, entries, spare, &scratch, (&args, 0), bits)?;
    let run = || -> Result<f64, Error> {
        let mut recorder = Recorder::new(gpu);
        recorder.copy(&source, &keys);
        recorder.submit();
        gpu.wait("bench sort")?;
        let clock = Instant::now();
        let mut recorder = Recorder::new(gpu);
        recorder.stage("sort", |pass| sort.record(pass));
        recorder.submit();
        gpu.wait("bench sort")?;
        Ok(clock.elapsed().as_secs_f64())
    };
    run()?;
    let mut expected = shuffled;
    expected.sort_unstable();
    if gpu.download(&keys)? != expected {
        return Err(Error::Check(format!(
            "the list of {n} entries is not sorted"
        )));
    }
    let seconds = (0..options.repeats.max(1))
        .map(|_| run())
        .collect::<Result<_, _>>()?;
    let seconds = Spread::of(seconds);
    let bytes = Sort::bytes(n, bits);
    Ok(Row {
        entries: n,
        bits,
        seconds_median: seconds.median,
        seconds_min: seconds.min,
        seconds_max: seconds.max,
        bytes,
        share_of_copy_bandwidth: machine.share_of_copy_bandwidth(bytes, seconds.median),
    })
}

/// Murmur3's finalizer (Appleby 2011): a permutation of the 32-bit numbers without a pattern.
fn hash(x: u32) -> u32 {
    let x = (x ^ x >> 16).wrapping_mul(0x85eb_ca6b);
    let x = (x ^ x >> 13).wrapping_mul(0xc2b2_ae35);
    x ^ x >> 16
}
