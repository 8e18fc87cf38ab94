//! Machine and time of a bench, and the bandwidth of a copy.

use std::fs;
use std::time::SystemTime;

use serde::Serialize;

use super::device::copy_bandwidth;
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
