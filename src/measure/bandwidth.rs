//! The bandwidth of a plain copy on the device.

use std::time::Instant;

use crate::Error;
use crate::gpu::{Buffer, Gpu, Kernel, Real, Recorder};

use super::statistics::Spread;

/// Bytes of each of the two buffers: beyond the caches of most devices, within the limits of all.
const BYTES: usize = 64 << 20;
/// Copies in a submission, so that its fixed cost does not count.
const COPIES: usize = 8;

/// Bytes read and written per second by a kernel that copies 16 bytes a thread.
///
/// # Errors
/// [`Error::Gpu`] when the device fails.
pub fn copy_bandwidth(gpu: &Gpu, repeats: usize) -> Result<Spread, Error> {
    let source: Buffer<f32> = gpu.buffer("bench.source", BYTES / 4)?;
    let target: Buffer<f32> = gpu.buffer("bench.target", BYTES / 4)?;
    let kernel = Kernel::new(gpu, &crate::wgsl!("copy"), Real::F32)?;
    let copy = kernel.bind(
        gpu,
        &[
            ("source", (&source).into()),
            ("target_out", (&target).into()),
        ],
    )?;
    let run = || {
        let clock = Instant::now();
        let mut recorder = Recorder::new(gpu);
        recorder.stage("copy", |pass| {
            for _ in 0..COPIES {
                pass.dispatch(&copy, BYTES / 16);
            }
        });
        recorder.submit();
        gpu.wait("copy")?;
        Ok::<f64, Error>((2 * BYTES * COPIES) as f64 / clock.elapsed().as_secs_f64())
    };
    run()?;
    Ok(Spread::of(
        (0..repeats.max(1))
            .map(|_| run())
            .collect::<Result<_, _>>()?,
    ))
}
