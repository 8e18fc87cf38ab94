//! Machine and time of a bench, and the bandwidth of a copy.

use std::fs;
use std::time::SystemTime;

use serde::Serialize;

use super::device::{copying, dispatches, enough};
use super::statistics::Spread;
use crate::Error;
use crate::gpu::Gpu;

/// Digest of the sources, shaders and scenes of this build, 12 hexadecimal digits.
pub const SOURCES: &str = env!("CUTWATER_SOURCES");

/// Machine and time of a table; without an adapter on the f64 path.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    /// Version of cutwater.
    pub cutwater: &'static str,
    /// [`SOURCES`]
    pub sources: &'static str,
    /// Start: UTC, RFC 3339.
    pub measured: String,
    /// Model of the CPU if known: software drivers and reference solvers run on it.
    pub cpu: Option<String>,
    /// Hardware threads of the CPU.
    pub threads: usize,
    /// Load average of the minute before, if known.
    pub load: Option<f64>,
    /// Adapter.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adapter: Option<String>,
    /// Driver.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub driver: Option<String>,
    /// Bytes read and written per second by a copy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub copy_bandwidth: Option<Spread>,
}

impl Machine {
    /// The host alone.
    pub fn host() -> Machine {
        let load = fs::read_to_string("/proc/loadavg").ok();
        Machine {
            cutwater: env!("CARGO_PKG_VERSION"),
            sources: SOURCES,
            measured: humantime::format_rfc3339_seconds(SystemTime::now()).to_string(),
            cpu: cpu(),
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            load: load.and_then(|text| text.split(' ').next()?.parse().ok()),
            adapter: None,
            driver: None,
            copy_bandwidth: None,
        }
    }

    /// Host and device; measures the copy bandwidth.
    pub fn new(gpu: &Gpu, repeats: usize) -> Result<Machine, Error> {
        Ok(Machine {
            adapter: Some(gpu.report().name.clone()),
            driver: Some(gpu.report().driver.clone()),
            copy_bandwidth: Some(copy_bandwidth(gpu, repeats)?),
            ..Machine::host()
        })
    }

    /// Name of the adapter, or of the f64 path.
    pub fn name(&self) -> &str {
        self.adapter.as_deref().unwrap_or("the f64 path")
    }

    /// Bytes per second over the copy bandwidth; NaN if bytes or seconds are 0.
    pub(crate) fn share(&self, bytes: f64, seconds: f64) -> f64 {
        match self.copy_bandwidth {
            Some(copy) if bytes > 0.0 && seconds > 0.0 => bytes / seconds / copy.median,
            _ => f64::NAN,
        }
    }
}

/// The line `model name : ...` of the first processor; some CPUs have none.
fn cpu() -> Option<String> {
    let text = fs::read_to_string("/proc/cpuinfo").ok()?;
    let mut lines = text.lines().filter_map(|line| line.split_once(':'));
    lines.find(|(key, _)| key.trim() == "model name").map(|(_, model)| model.trim().to_owned())
}

/// Bytes of each of the two buffers: larger than the caches of CPUs, and of GPUs.
const BYTES: [usize; 2] = [64 << 20, 256 << 20];
/// Least duration of a submission, s, which makes its fixed cost of some 50 us negligible.
const LONG_ENOUGH: f64 = 0.01;

/// Bytes read and written per second by a kernel that copies 16 bytes a thread.
fn copy_bandwidth(gpu: &Gpu, repeats: usize) -> Result<Spread, Error> {
    let report = gpu.report();
    let bytes = match report.kind {
        "software" => BYTES[0],
        _ => BYTES[1].min(report.storage_binding.min(report.buffer) as usize),
    };
    let copy = copying(gpu, bytes / 4)?.0;
    let run = |copies: usize| dispatches(gpu, 1, copies, |pass| pass.dispatch(&copy, bytes / 16));
    let copies = enough(8, 1 << 12, LONG_ENOUGH, run)?;
    let moved = (2 * bytes * copies) as f64;
    let rates = (0..repeats.max(1)).map(|_| Ok(moved / run(copies)?));
    Ok(Spread::of(rates.collect::<Result<_, Error>>()?))
}
