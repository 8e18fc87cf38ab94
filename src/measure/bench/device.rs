//! `bench device`: rates and latencies of an adapter, the bounds of all other numbers: bandwidth, arithmetic, launches, waits.

use std::time::Instant;

use super::statistics::Spread;
use super::table::{Table, columns, row};
use super::{Bench, Case, Listener, Machine, Results, Run, Settings};
use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Readback, Real, RealBuffer, Recorder};

columns! {
    DEVICE {
        quantity + "" "measured quantity";
        unit + "" "its unit";
        median + "" "median of the repeats";
        min + "" "least";
        max + "" "largest";
    }
}

/// Threads of an arithmetic dispatch.
const THREADS: usize = 1 << 18;
/// Operations of a thread of `multiply_add`: 256 rounds of 8 fused multiply-adds.
const OPERATIONS: f64 = 256.0 * 8.0 * 2.0;
/// Number of dispatches or submissions that separates their cost from a fixed one.
const MANY: usize = 512;
/// Least duration of a measurement, s.
const LONG_ENOUGH: f64 = 0.02;

/// Measures all quantities: device.csv, device.json.
///
/// # Errors
/// [`Error::Output`] and [`Error::Input`] for the folder, before any work; later the errors of the device.
pub fn measure(gpu: &Gpu, settings: &Settings, listener: Listener) -> Result<Results, Error> {
    let bench = Bench {
        name: "device",
        tables: vec![Table::new("device", &[DEVICE], &["quantity"])],
        derive: |_| {},
        pictures: &[],
    };
    let machine = Machine::new(gpu, settings.repeats)?;
    let mut run = Run::start(bench, machine, &(), settings, listener)?;
    let (copy, tiny) = (run.results.machine.copy_bandwidth, Tiny::new(gpu)?);
    let cases = QUANTITIES.iter().map(|&(name, unit)| {
        let tiny = &tiny;
        Case::new("device", row! { quantity: name }, move |run| {
            let measured = match name {
                "copy_bandwidth" => copy,
                _ => tiny.measure(name, run.settings.repeats)?,
            };
            let row = |Spread { median, min, max }| {
                row! { quantity: name, unit: unit, median: median, min: min, max: max }
            };
            Ok(measured.map(|it| ("device", row(it))).into_iter().collect())
        })
    });
    run.cases(cases.collect())?;
    Ok(run.results)
}

/// Quantities and their units.
const QUANTITIES: [(&str, &str); 8] = [
    ("copy_bandwidth", "byte/s"),
    ("f32_rate", "flop/s"),
    ("f64_rate", "flop/s"),
    ("launch", "s"),
    ("indirect_launch", "s"),
    ("submission", "s"),
    ("wait", "s"),
    ("read_back", "s"),
];

/// Repeats a measurement; the first, which compiles and warms caches, is not counted.
fn repeat(repeats: usize, mut run: impl FnMut() -> Result<f64, Error>) -> Result<Spread, Error> {
    run()?;
    let values = (0..repeats.max(1)).map(|_| run());
    Ok(Spread::of(values.collect::<Result<_, _>>()?))
}

/// A kernel that copies 16 bytes a thread, between buffers of `n` f32, and its target.
pub(super) fn copying(gpu: &Gpu, n: usize) -> Result<(Bound, Buffer<f32>), Error> {
    let source: Buffer<f32> = gpu.buffer("bench.source", n)?;
    let target: Buffer<f32> = gpu.buffer("bench.target", n)?;
    let kernel = Kernel::new(gpu, &crate::wgsl!("copy"), Real::F32)?;
    let buffers = [("source", (&source).into()), ("target_out", (&target).into())];
    Ok((kernel.bind(gpu, &buffers, &[])?, target))
}

/// Seconds of `n` dispatches in one submission, to the end of their work.
pub(super) fn dispatches(gpu: &Gpu, n: usize, mut record: impl FnMut(&mut crate::gpu::Pass)) -> Result<f64, Error> {
    gpu.wait("bench device")?;
    let clock = Instant::now();
    let mut recorder = Recorder::new(gpu);
    recorder.stage("bench", |pass| (0..n).for_each(|_| record(pass)));
    recorder.submit();
    gpu.wait("bench device")?;
    Ok(clock.elapsed().as_secs_f64())
}

/// Operations per second of fused multiply-adds.
fn arithmetic(gpu: &Gpu, real: Real, repeats: usize) -> Result<Spread, Error> {
    let target = RealBuffer::new(gpu, "bench.target", THREADS, real)?;
    let kernel = Kernel::new(gpu, &crate::wgsl!("multiply_add"), real)?;
    let bound = kernel.bind(gpu, &[("target_out", (&target).into())], &[])?;
    let run = |n: usize| dispatches(gpu, n, |pass| pass.dispatch(&bound, THREADS));
    run(1)?;
    // As many dispatches as hide the latency of submission and wait.
    let mut n = 1;
    while run(n)? < LONG_ENOUGH && n < 1 << 14 {
        n *= 2;
    }
    let work = OPERATIONS * (THREADS * n) as f64;
    repeat(repeats, || Ok(work / run(n)?))
}

/// A kernel that does next to nothing.
struct Tiny<'a> {
    gpu: &'a Gpu,
    copy: Bound,
    target: Buffer<f32>,
    args: Buffer<u32>,
}

impl<'a> Tiny<'a> {
    fn new(gpu: &'a Gpu) -> Result<Tiny<'a>, Error> {
        let (copy, target) = copying(gpu, 256)?;
        Ok(Tiny { gpu, copy, args: gpu.buffer_with("bench.args", &[1, 1, 1, 64])?, target })
    }

    /// Measures a quantity other than the copy bandwidth; `None` if the adapter lacks it.
    fn measure(&self, quantity: &str, n: usize) -> Result<Option<Spread>, Error> {
        let spread = match quantity {
            "f32_rate" => arithmetic(self.gpu, Real::F32, n),
            "f64_rate" if self.gpu.has_f64() => arithmetic(self.gpu, Real::F64, n),
            "launch" => self.per_item(n, |tiny, n| tiny.launches(n, false)),
            "indirect_launch" => self.per_item(n, |tiny, n| tiny.launches(n, true)),
            "submission" => self.per_item(n, |tiny, n| tiny.submissions(n)),
            "wait" => repeat(n, || self.submissions(1)),
            "read_back" => repeat(n, || self.read_back()),
            _ => return Ok(None),
        };
        spread.map(Some)
    }

    /// Seconds of `n` dispatches of one workgroup, each waiting for the one before.
    fn launches(&self, n: usize, indirect: bool) -> Result<f64, Error> {
        dispatches(self.gpu, n, |pass| match indirect {
            true => pass.dispatch_indirect(&self.copy, &self.args, 0),
            false => pass.dispatch(&self.copy, 64),
        })
    }

    /// Seconds of `n` submissions of one dispatch each, to the end of the last.
    fn submissions(&self, n: usize) -> Result<f64, Error> {
        self.gpu.wait("bench device")?;
        let clock = Instant::now();
        for _ in 0..n {
            let mut recorder = Recorder::new(self.gpu);
            recorder.stage("bench", |pass| pass.dispatch(&self.copy, 64));
            recorder.submit();
        }
        self.gpu.wait("bench device")?;
        Ok(clock.elapsed().as_secs_f64())
    }

    /// Seconds from the recording of a dispatch to a number of it on the host.
    fn read_back(&self) -> Result<f64, Error> {
        let mut readback: Readback<f32> = Readback::new(self.gpu, "bench.target", 1)?;
        self.gpu.wait("bench device")?;
        let clock = Instant::now();
        let mut recorder = Recorder::new(self.gpu);
        recorder.stage("bench", |pass| pass.dispatch(&self.copy, 64));
        recorder.read(&self.target, &mut readback);
        recorder.submit();
        readback.wait(self.gpu)?;
        Ok(clock.elapsed().as_secs_f64())
    }

    /// Seconds of one more item: [`MANY`] more over their number, without the fixed cost of a submission and a wait.
    fn per_item(&self, repeats: usize, run: impl Fn(&Tiny, usize) -> Result<f64, Error>) -> Result<Spread, Error> {
        repeat(repeats, || {
            let [few, many] = [run(self, MANY)?, run(self, 2 * MANY)?];
            Ok(((many - few) / MANY as f64).max(0.0))
        })
    }
}
