//! Recording: one labelled and timed compute pass per stage. Dispatches above the limit are split in two dimensions.

use bytemuck::Pod;

use super::buffer::Arrival;
use super::{Bound, Buffer, BufferPlan, Gpu, Readback, StageKernel};

/// Workgroups along x before a dispatch continues along y; also in `common/dispatch.wgsl`. Below the 65,535 of every
/// adapter, and a power of two so that the kernel can use a shift.
pub const SPLIT: u32 = 32768;

/// Workgroup counts of a dispatch of `n` workgroups.
pub fn groups(n: u32) -> [u32; 3] {
    if n <= SPLIT { [n, 1, 1] } else { [SPLIT, n.div_ceil(SPLIT), 1] }
}

/// Seconds per stage of a recording, by label, in order.
pub type StageTimes = Vec<(&'static str, f64)>;

/// Largest number of timed stages per recording; later ones run untimed.
const TIMED_STAGES: u32 = 64;
/// Dispatches after which a recording is submitted in part, at the end of a stage: the device runs them while the host records the next.
const CHUNK: usize = 64;
/// Bytes of the timestamps.
const TIMES: u64 = 2 * 8 * TIMED_STAGES as u64;

/// Query set and buffers that time a recording; [`Gpu`] reuses them.
#[derive(Debug)]
pub(super) struct Timer {
    set: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    times: wgpu::Buffer,
}

impl Timer {
    /// `None` on a planning device.
    pub(super) fn new(gpu: &Gpu) -> Option<Timer> {
        let words = TIMES as usize / 8;
        let make = |label, usage| {
            let plan = BufferPlan::of::<u64>(label, words);
            let size = plan.bytes();
            gpu.note_allocation(plan);
            Some(gpu.open()?.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage,
                mapped_at_creation: false,
            }))
        };
        let resolved = make("gpu.times", wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC);
        let times = make("gpu.times (read-back)", wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
        Some(Timer {
            set: gpu.open()?.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("gpu.times"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * TIMED_STAGES,
            }),
            resolved: resolved?,
            times: times?,
        })
    }
}

/// Every part of a recording.
const ENCODER: wgpu::CommandEncoderDescriptor = wgpu::CommandEncoderDescriptor { label: Some("cutwater") };

impl Gpu {
    fn take_timer(&self) -> Option<Timer> {
        let kept = self.timers.lock().ok().and_then(|mut list| list.pop());
        kept.or_else(|| Timer::new(self))
    }

    pub(super) fn keep_timer(&self, timer: Timer) {
        if let Ok(mut list) = self.timers.lock() {
            list.push(timer);
        }
    }
}

/// Records commands and submits them: in parts, as soon as there are many. Does nothing on a planning device.
#[derive(Debug)]
pub struct Recorder {
    gpu: Gpu,
    encoder: Option<wgpu::CommandEncoder>,
    timer: Option<Timer>,
    stages: Vec<&'static str>,
    dispatches: Vec<StageKernel>,
    bytes_down: u64,
}

/// One compute pass: the dispatches of a stage in order. Each reads the results of the earlier ones.
#[derive(Debug)]
pub struct Pass<'a> {
    raw: Option<wgpu::ComputePass<'a>>,
    stage: &'static str,
    dispatches: &'a mut Vec<StageKernel>,
}

impl Recorder {
    /// An empty recording.
    pub fn new(gpu: &Gpu) -> Recorder {
        let encoder = gpu.open().map(|open| open.device.create_command_encoder(&ENCODER));
        Recorder { gpu: gpu.clone(), encoder, timer: None, stages: Vec::new(), dispatches: Vec::new(), bytes_down: 0 }
    }

    /// An empty recording with timed stages, if the adapter supports timestamps.
    pub fn timed(gpu: &Gpu) -> Recorder {
        let mut recorder = Recorder::new(gpu);
        if gpu.report().timestamps {
            recorder.timer = gpu.take_timer();
        }
        recorder
    }

    /// Submits the commands recorded so far. Later uploads do not reach them.
    fn flush(&mut self) {
        if let Some((open, encoder)) = self.gpu.open().zip(self.encoder.as_mut()) {
            let next = open.device.create_command_encoder(&ENCODER);
            open.queue.submit([std::mem::replace(encoder, next).finish()]);
        }
        self.gpu.meter.submitted(&self.dispatches, std::mem::take(&mut self.bytes_down));
        self.dispatches.clear();
    }

    /// Records the dispatches of a stage as one pass.
    pub fn stage<R>(&mut self, stage: &'static str, record: impl FnOnce(&mut Pass) -> R) -> R {
        let index = self.stages.len() as u32;
        let timestamp_writes =
            self.timer.as_ref().filter(|_| index < TIMED_STAGES).map(|timer| wgpu::ComputePassTimestampWrites {
                query_set: &timer.set,
                beginning_of_pass_write_index: Some(2 * index),
                end_of_pass_write_index: Some(2 * index + 1),
            });
        if timestamp_writes.is_some() {
            self.stages.push(stage);
        }
        let descriptor = wgpu::ComputePassDescriptor { label: Some(stage), timestamp_writes };
        let encoder = self.encoder.as_mut();
        let raw = encoder.map(|encoder| encoder.begin_compute_pass(&descriptor));
        let mut pass = Pass { raw, stage, dispatches: &mut self.dispatches };
        let result = record(&mut pass);
        drop(pass);
        if self.dispatches.len() >= CHUNK {
            self.flush();
        }
        result
    }

    /// Sets a buffer to zero.
    pub fn clear<T: Pod>(&mut self, buffer: &Buffer<T>) {
        self.clear_raw(&buffer.raw);
    }

    fn clear_raw(&mut self, buffer: &Option<wgpu::Buffer>) {
        if let Some((encoder, raw)) = self.encoder.as_mut().zip(buffer.as_ref()) {
            encoder.clear_buffer(raw, 0, None);
        }
    }

    /// Copies a buffer to another of the same type and length.
    pub fn copy<T: Pod>(&mut self, from: &Buffer<T>, to: &Buffer<T>) {
        assert_eq!(from.len(), to.len(), "copy of {} to {}", from.label(), to.label());
        self.copy_bytes((&from.raw, 0), &to.raw, from.bytes());
    }

    fn copy_bytes(&mut self, (from, start): (&Option<wgpu::Buffer>, u64), to: &Option<wgpu::Buffer>, bytes: u64) {
        if let (Some(encoder), Some(from), Some(to)) = (&mut self.encoder, from, to) {
            encoder.copy_buffer_to_buffer(from, start, to, 0, Some(bytes));
        }
    }

    /// Copies the first elements of a buffer to a readback of the same type.
    pub fn read<T: Pod>(&mut self, from: &Buffer<T>, to: &mut Readback<T>) {
        self.read_part(from, 0, to);
    }

    /// Copies elements from `first` on to a readback of the same type. Offset and length must be whole words.
    pub fn read_part<T: Pod>(&mut self, from: &Buffer<T>, first: usize, to: &mut Readback<T>) {
        let start = (first * size_of::<T>()) as u64;
        let bytes = (to.len.max(1) * size_of::<T>()).next_multiple_of(4) as u64;
        let bytes = bytes.min(from.bytes() - start);
        self.bytes_down += bytes;
        self.copy_bytes((&from.raw, start), &to.raw, bytes);
    }

    /// Submits the rest of the recording. The returned `Timing` yields the times of a timed recording.
    pub fn submit(mut self) -> Timing {
        if let Some((timer, encoder)) = self.timer.as_ref().zip(self.encoder.as_mut()) {
            let n = 2 * self.stages.len() as u32;
            if n > 0 {
                let bytes = u64::from(n) * 8;
                self.bytes_down += bytes;
                encoder.resolve_query_set(&timer.set, 0..n, &timer.resolved, 0);
                encoder.copy_buffer_to_buffer(&timer.resolved, 0, &timer.times, 0, Some(bytes));
            }
        }
        if let Some((open, encoder)) = self.gpu.open().zip(self.encoder) {
            open.queue.submit([encoder.finish()]);
        }
        self.gpu.meter.submitted(&self.dispatches, self.bytes_down);
        Timing { gpu: self.gpu, stages: self.stages, timer: self.timer }
    }
}

/// A kernel with its buffers and the extent of its dispatch.
#[derive(Debug)]
pub struct Dispatch {
    bound: Bound,
    extent: Extent,
}

#[derive(Debug)]
enum Extent {
    Threads(usize),
    /// Slot of dispatch sizes in a buffer; `None` on a planning device.
    Indirect(Option<wgpu::Buffer>, usize),
}

impl Bound {
    /// At least `threads` threads.
    pub fn threads(self, threads: usize) -> Dispatch {
        Dispatch { bound: self, extent: Extent::Threads(threads) }
    }

    /// The workgroups in `args[4 slot..]`: x, y, z, then the list's length, which kernels can read.
    pub fn indirect(self, args: &Buffer<u32>, slot: usize) -> Dispatch {
        Dispatch { bound: self, extent: Extent::Indirect(args.raw.clone(), slot) }
    }
}

/// Commands of a stage: transfers, then dispatches in order, as one compute pass labelled with the stage.
#[derive(Debug)]
pub struct Dispatches {
    stage: &'static str,
    transfers: Vec<Transfer>,
    list: Vec<Dispatch>,
}

/// A transfer on the device; buffers are `None` on a planning device.
#[derive(Debug)]
enum Transfer {
    Clear(Option<wgpu::Buffer>),
    Copy(Option<wgpu::Buffer>, Option<wgpu::Buffer>, u64),
}

impl Dispatches {
    /// Dispatches of a stage.
    pub fn new(stage: &'static str, list: impl IntoIterator<Item = Dispatch>) -> Dispatches {
        Dispatches { stage, transfers: Vec::new(), list: list.into_iter().collect() }
    }

    /// Sets a buffer to zero before the dispatches.
    pub fn clearing<T: Pod>(mut self, buffer: &Buffer<T>) -> Dispatches {
        self.transfers.push(Transfer::Clear(buffer.raw.clone()));
        self
    }

    /// Copies a buffer to another of the same type and length before the dispatches.
    pub fn copying<T: Pod>(mut self, from: &Buffer<T>, to: &Buffer<T>) -> Dispatches {
        assert_eq!(from.len(), to.len(), "{}", from.label());
        let copy = Transfer::Copy(from.raw.clone(), to.raw.clone(), from.bytes());
        self.transfers.push(copy);
        self
    }

    /// Name of the stage.
    pub fn stage(&self) -> &'static str {
        self.stage
    }

    /// Records transfers and dispatches.
    pub fn record(&self, recorder: &mut Recorder) {
        for transfer in &self.transfers {
            match transfer {
                Transfer::Clear(buffer) => recorder.clear_raw(buffer),
                Transfer::Copy(from, to, bytes) => recorder.copy_bytes((from, 0), to, *bytes),
            }
        }
        if !self.list.is_empty() {
            recorder.stage(self.stage, |pass| pass.run(&self.list));
        }
    }

    /// Records the dispatches in a pass.
    pub fn record_in(&self, pass: &mut Pass) {
        debug_assert!(self.transfers.is_empty(), "{}: a pass has no transfers", self.stage);
        pass.run(&self.list);
    }
}

impl<'p> Pass<'p> {
    /// Runs dispatches in order.
    pub fn run<'d>(&mut self, dispatches: impl IntoIterator<Item = &'d Dispatch>) {
        for Dispatch { bound, extent } in dispatches {
            match extent {
                Extent::Threads(threads) => self.dispatch(bound, *threads),
                Extent::Indirect(args, slot) => self.indirect(bound, args.as_ref(), *slot),
            }
        }
    }

    /// Runs a kernel on at least `threads` threads.
    pub fn dispatch(&mut self, bound: &Bound, threads: usize) {
        let n = u32::try_from(threads.div_ceil(bound.threads as usize))
            .expect("dispatch sizes are checked with the buffers");
        let [x, y, z] = groups(n);
        if let Some(raw) = self.set(bound) {
            raw.dispatch_workgroups(x, y, z);
        }
    }

    /// Runs a kernel on the workgroups in `args[4 slot..]`: x, y, z, then the list's length, which kernels can read.
    pub fn dispatch_indirect(&mut self, bound: &Bound, args: &Buffer<u32>, slot: usize) {
        self.indirect(bound, args.raw.as_ref(), slot);
    }

    fn indirect(&mut self, bound: &Bound, args: Option<&wgpu::Buffer>, slot: usize) {
        if let Some((raw, args)) = self.set(bound).zip(args) {
            raw.dispatch_workgroups_indirect(args, 16 * slot as u64);
        }
    }

    fn set(&mut self, bound: &Bound) -> Option<&mut wgpu::ComputePass<'p>> {
        self.dispatches.push((self.stage, bound.label));
        let (raw, binding) = self.raw.as_mut().zip(bound.binding.as_ref())?;
        raw.set_pipeline(binding.pipeline.wait());
        raw.set_bind_group(0, &binding.group, &[]);
        Some(raw)
    }
}

/// Pending stage times of a recording. The timer returns to the device when the value is dropped.
#[derive(Debug)]
pub struct Timing {
    gpu: Gpu,
    stages: Vec<&'static str>,
    timer: Option<Timer>,
}

impl Timing {
    /// Waits for the times. Returns an empty list when the adapter has no timestamps.
    pub fn wait(mut self) -> Result<StageTimes, crate::Error> {
        let stages = std::mem::take(&mut self.stages);
        let Some(timer) = self.timer.as_ref().filter(|_| !stages.is_empty()) else {
            return Ok(Vec::new());
        };
        let Some(open) = self.gpu.open() else {
            return Ok(Vec::new());
        };
        Arrival::request(&timer.times).wait(&self.gpu, "stage times")?;
        let view = timer
            .times
            .get_mapped_range(..)
            .map_err(|error| crate::Error::Gpu { during: "stage times".to_owned(), problem: error.to_string() })?;
        let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(&view);
        drop(view);
        timer.times.unmap();
        let period = f64::from(open.queue.get_timestamp_period()) * 1e-9;
        let seconds = |pair: &[u64]| pair[1].saturating_sub(pair[0]) as f64 * period;
        Ok(stages.into_iter().zip(ticks.chunks_exact(2).map(seconds)).collect())
    }
}

impl Drop for Timing {
    fn drop(&mut self) {
        if let Some(timer) = self.timer.take() {
            self.gpu.keep_timer(timer);
        }
    }
}
