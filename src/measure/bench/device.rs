//! `bench device`: rates and latencies of an adapter, the bounds of all other numbers: bandwidth, arithmetic, launches, waits.

use std::time::Instant;

use super::statistics::Spread;
use super::table::{Table, columns, row};
use super::{Bench, Case, Listener, Machine, Results, Run, Settings};
use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Pass, Readback, Real, RealBuffer, Recorder};

columns! {
    DEVICE {
        + quantity "" "measured quantity";
        + unit "" "its unit";
        + median, min, max "" "median, least and largest of the repeats";
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
/// Largest number of dispatches of a measurement.
const MOST: usize = 1 << 14;

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
    let tiny = &Tiny::new(gpu)?;
    let cases = QUANTITIES.iter().map(|&(name, unit, measure)| {
        Case::new("device", row! { quantity: name }, move |run| {
            let measured = match measure {
                None => run.results.machine.copy_bandwidth,
                Some(_) if name == "f64_rate" && !gpu.has_f64() => None,
                Some(measure) => Some(measure(tiny, run.settings.repeats)?),
            };
            let row = |Spread { median, min, max }| {
                row! { quantity: name, unit, median, min, max }
            };
            Ok(measured.map(|it| ("device", row(it))).into_iter().collect())
        })
    });
    run.cases(cases.collect())?;
    Ok(run.results)
}

/// Measures a quantity with so many repeats.
type Measure = fn(&Tiny, usize) -> Result<Spread, Error>;

/// Quantities, their units, and their measurements but of the copy bandwidth, which every bench has.
const QUANTITIES: [(&str, &str, Option<Measure>); 8] = [
    ("copy_bandwidth", "byte/s", None),
    ("f32_rate", "flop/s", Some(|tiny, n| arithmetic(tiny.gpu, Real::F32, n))),
    ("f64_rate", "flop/s", Some(|tiny, n| arithmetic(tiny.gpu, Real::F64, n))),
    ("launch", "s", Some(|tiny, n| tiny.per_item(n, |n| tiny.launches(n, false)))),
    ("indirect_launch", "s", Some(|tiny, n| tiny.per_item(n, |n| tiny.launches(n, true)))),
    ("submission", "s", Some(|tiny, n| tiny.per_item(n, |n| tiny.submissions(n)))),
    ("wait", "s", Some(|tiny, n| repeat(n, || tiny.submissions(1)))),
    ("read_back", "s", Some(|tiny, n| repeat(n, || tiny.read_back()))),
];

/// Repeats a measurement; the first, which compiles and warms caches, is not counted.
fn repeat(repeats: usize, mut run: impl FnMut() -> Result<f64, Error>) -> Result<Spread, Error> {
    run()?;
    let values = (0..repeats.max(1)).map(|_| run()).collect::<Result<_, _>>();
    Ok(Spread::of(values?))
}

/// A kernel that copies 16 bytes a thread, between buffers of `n` f32, and its target.
fn copying(gpu: &Gpu, n: usize) -> Result<(Bound, Buffer<f32>), Error> {
    let source: Buffer<f32> = gpu.buffer("bench.source", n)?;
    let target: Buffer<f32> = gpu.buffer("bench.target", n)?;
    let kernel = Kernel::new(gpu, &crate::wgsl!("copy"), Real::F32)?;
    let buffers = [("source", (&source).into()), ("target_out", (&target).into())];
    Ok((kernel.bind(gpu, &buffers, &[])?, target))
}

/// Seconds of submissions of `n` dispatches each, to the end of their work.
fn dispatches(gpu: &Gpu, submissions: usize, n: usize, mut record: impl FnMut(&mut Pass)) -> Result<f64, Error> {
    gpu.wait("bench device")?;
    let clock = Instant::now();
    for _ in 0..submissions {
        let mut recorder = Recorder::new(gpu);
        recorder.stage("bench", |pass| (0..n).for_each(|_| record(pass)));
        recorder.submit();
    }
    gpu.wait("bench device")?;
    Ok(clock.elapsed().as_secs_f64())
}

/// Work per second of a kernel. `work`: of one dispatch.
fn rate(gpu: &Gpu, repeats: usize, bound: &Bound, threads: usize, work: f64) -> Result<Spread, Error> {
    let run = |n: usize| dispatches(gpu, 1, n, |pass| pass.dispatch(bound, threads));
    // The first run compiles; then as many dispatches as hide the latency of submission and wait.
    let mut n = 1;
    run(n)?;
    while run(n)? < LONG_ENOUGH && n < MOST {
        n *= 2;
    }
    repeat(repeats, || Ok(n as f64 * work / run(n)?))
}

/// Bytes read and written per second by a copy between buffers that are larger than the caches of CPUs, and of GPUs.
pub(super) fn copy_bandwidth(gpu: &Gpu, repeats: usize) -> Result<Spread, Error> {
    let report = gpu.report();
    let bytes = match report.kind {
        "software" => 64 << 20,
        _ => (256 << 20).min(report.storage_binding.min(report.buffer) as usize),
    };
    let (copy, _target) = copying(gpu, bytes / 4)?;
    rate(gpu, repeats, &copy, bytes / 16, (2 * bytes) as f64)
}

fn arithmetic(gpu: &Gpu, real: Real, repeats: usize) -> Result<Spread, Error> {
    let target = RealBuffer::new(gpu, "bench.target", THREADS, real)?;
    let kernel = Kernel::new(gpu, &crate::wgsl!("multiply_add"), real)?;
    let bound = kernel.bind(gpu, &[("target_out", (&target).into())], &[])?;
    rate(gpu, repeats, &bound, THREADS, OPERATIONS * THREADS as f64)
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

    /// Seconds of `n` dispatches of one workgroup, each waiting for the one before.
    fn launches(&self, n: usize, indirect: bool) -> Result<f64, Error> {
        dispatches(self.gpu, 1, n, |pass| match indirect {
            true => pass.dispatch_indirect(&self.copy, &self.args, 0),
            false => pass.dispatch(&self.copy, 64),
        })
    }

    /// Seconds of `n` submissions of one dispatch each, to the end of the last.
    fn submissions(&self, n: usize) -> Result<f64, Error> {
        dispatches(self.gpu, n, 1, |pass| pass.dispatch(&self.copy, 64))
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
    fn per_item(&self, repeats: usize, run: impl Fn(usize) -> Result<f64, Error>) -> Result<Spread, Error> {
        repeat(repeats, || {
            let [few, many] = [run(MANY)?, run(2 * MANY)?];
            Ok(((many - few) / MANY as f64).max(0.0))
        })
    }
}
