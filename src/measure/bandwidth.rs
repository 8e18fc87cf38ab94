//! The bandwidth of a plain copy on the device.

use std::time::Instant;

use crate::Error;
use crate::gpu::{Buffer, Gpu, Kernel, Real, Recorder};

use super::statistics::Spread;

/// Bytes of each of the two buffers on software adapters, whose caches are those of the CPU.
const BYTES: usize = 64 << 20;
/// Bytes of each of them on hardware, whose caches hold up to some 130 MB.
const BYTES_ON_HARDWARE: usize = 256 << 20;
/// Copies in a submission, at the least.
const COPIES: usize = 8;
/// Seconds of a submission, at the least: its fixed cost of some 50 us does not count then.
const LONG_ENOUGH: f64 = 0.01;

/// Bytes read and written per second by a kernel that copies 16 bytes a thread.
///
/// # Errors
/// [`Error::Gpu`] when the device fails.
pub fn copy_bandwidth(gpu: &Gpu, repeats: usize) -> Result<Spread, Error> {
    let report = gpu.report();
    let bytes = match report.kind {
        "software" => BYTES,
        _ => BYTES_ON_HARDWARE.min(report.storage_binding.min(report.buffer) as usize),
    };
    let source: Buffer<f32> = gpu.buffer("bench.source", bytes / 4)?;
    let target: Buffer<f32> = gpu.buffer("bench.target", bytes / 4)?;
    let kernel = Kernel::new(gpu, &crate::wgsl!("copy"), Real::F32)?;
    let buffers = [
        ("source", (&source).into()),
        ("target_out", (&target).into()),
    ];
    let copy = kernel.bind(gpu, &buffers)?;
    let run = |copies: usize| {
        let clock = Instant::now();
        let mut recorder = Recorder::new(gpu);
        recorder.stage("copy", |pass| {
            for _ in 0..copies {
                pass.dispatch(&copy, bytes / 16);
            }
        });
        recorder.submit();
        gpu.wait("copy")?;
        Ok::<f64, Error>(clock.elapsed().as_secs_f64())
    };
    let mut copies = COPIES;
    run(copies)?;
    while run(copies)? < LONG_ENOUGH && copies < 1 << 12 {
        copies *= 2;
    }
    let moved = (2 * bytes * copies) as f64;
    let rates = (0..repeats.max(1)).map(|_| Ok(moved / run(copies)?));
    Ok(Spread::of(rates.collect::<Result<_, Error>>()?))
}
