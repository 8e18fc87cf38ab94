//! Recording: one compute pass per stage, labelled and timed; dispatches split in two dimensions above the limit.

use bytemuck::Pod;

use super::buffer::Arrival;
use super::{Bound, Buffer, BufferPlan, Gpu, Readback, StageKernel};

/// Workgroups along x before a dispatch continues along y; `common/dispatch.wgsl` has the same constant. Below the 65,535
/// that every adapter allows, and a power of two so that folding back is a shift.
pub const SPLIT: u32 = 32768;

/// Workgroup counts of a dispatch of `n` workgroups.
pub fn groups(n: u32) -> [u32; 3] {
    if n <= SPLIT {
        [n, 1, 1]
    } else {
        [SPLIT, n.div_ceil(SPLIT), 1]
    }
}

/// Seconds of each stage of a submission, by label, in order.
pub type StageTimes = Vec<(&'static str, f64)>;

/// Stages that one submission can time; later ones run untimed.
const TIMED_STAGES: u32 = 64;
/// Bytes of their timestamps.
const TIMES: u64 = 2 * 8 * TIMED_STAGES as u64;

/// What times a submission; kept by [`Gpu`] from one to the next.
#[derive(Debug)]
pub struct Timer {
    set: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    times: wgpu::Buffer,
}

impl Timer {
    /// The buffers of a timer. A device has one; more only when timed submissions overlap.
    pub fn plan() -> [BufferPlan; 2] {
        let words = TIMES as usize / 8;
        [
            BufferPlan::of::<u64>("gpu.times", words),
            BufferPlan::of::<u64>("gpu.times (read-back)", words),
        ]
    }

    pub(super) fn new(gpu: &Gpu) -> Timer {
        let [resolved, times] = Timer::plan();
        let make = |plan: BufferPlan, usage| {
            gpu.note_allocation(plan.label, plan.bytes());
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(plan.label),
                size: plan.bytes(),
                usage,
                mapped_at_creation: false,
            })
        };
        Timer {
            set: gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("gpu.times"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * TIMED_STAGES,
            }),
            resolved: make(
                resolved,
                wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            ),
            times: make(
                times,
                wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            ),
        }
    }
}

impl Gpu {
    fn take_timer(&self) -> Timer {
        let kept = self.timers.lock().ok().and_then(|mut list| list.pop());
        kept.unwrap_or_else(|| Timer::new(self))
    }

    pub(super) fn keep_timer(&self, timer: Timer) {
        if let Ok(mut list) = self.timers.lock() {
            list.push(timer);
        }
    }
}

/// Records one submission.
#[derive(Debug)]
pub struct Recorder<'a> {
    gpu: &'a Gpu,
    encoder: wgpu::CommandEncoder,
    timer: Option<Timer>,
    stages: Vec<&'static str>,
    dispatches: Vec<StageKernel>,
    bytes_down: u64,
}

/// One compute pass: the dispatches of a stage, in order. Each sees what the earlier ones wrote.
#[derive(Debug)]
pub struct Pass<'a> {
    raw: wgpu::ComputePass<'a>,
    stage: &'static str,
    dispatches: &'a mut Vec<StageKernel>,
}

impl<'a> Recorder<'a> {
    /// An empty recording.
    pub fn new(gpu: &'a Gpu) -> Recorder<'a> {
        let encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("cutwater"),
            });
        Recorder {
            gpu,
            encoder,
            timer: None,
            stages: Vec::new(),
            dispatches: Vec::new(),
            bytes_down: 0,
        }
    }

    /// An empty recording whose stages are timed, where the adapter can.
    pub fn timed(gpu: &'a Gpu) -> Recorder<'a> {
        let mut recorder = Recorder::new(gpu);
        recorder.timer = gpu.report().timestamps.then(|| gpu.take_timer());
        recorder
    }

    /// Records the dispatches of a stage as one pass.
    pub fn stage<R>(&mut self, stage: &'static str, record: impl FnOnce(&mut Pass) -> R) -> R {
        let index = self.stages.len() as u32;
        let timestamp_writes = self
            .timer
            .as_ref()
            .filter(|_| index < TIMED_STAGES)
            .map(|timer| wgpu::ComputePassTimestampWrites {
                query_set: &timer.set,
                beginning_of_pass_write_index: Some(2 * index),
                end_of_pass_write_index: Some(2 * index + 1),
            });
        if timestamp_writes.is_some() {
            self.stages.push(stage);
        }
        let raw = self
            .encoder
            .begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some(stage),
                timestamp_writes,
            });
        let mut pass = Pass {
            raw,
            stage,
            dispatches: &mut self.dispatches,
        };
        record(&mut pass)
    }

    /// Sets a buffer to zero.
    pub fn clear<T: Pod>(&mut self, buffer: &Buffer<T>) {
        self.encoder.clear_buffer(&buffer.raw, 0, None);
    }

    /// Copies a buffer to another of the same type and length.
    pub fn copy<T: Pod>(&mut self, from: &Buffer<T>, to: &Buffer<T>) {
        assert_eq!(
            from.len(),
            to.len(),
            "copy of {} to {}",
            from.label(),
            to.label()
        );
        self.encoder
            .copy_buffer_to_buffer(&from.raw, 0, &to.raw, 0, Some(from.bytes()));
    }

    /// Copies the start of a buffer to a read-back of the same type.
    pub fn read<T: Pod>(&mut self, from: &Buffer<T>, to: &mut Readback<T>) {
        self.read_part(from, 0, to);
    }

    /// Copies a part of a buffer to a read-back of the same type, from element `first` on. Both ends lie on whole words.
    pub fn read_part<T: Pod>(&mut self, from: &Buffer<T>, first: usize, to: &mut Readback<T>) {
        let start = (first * size_of::<T>()) as u64;
        let bytes = (to.len.max(1) * size_of::<T>()).next_multiple_of(4) as u64;
        let bytes = bytes.min(from.bytes() - start);
        self.bytes_down += bytes;
        self.encoder
            .copy_buffer_to_buffer(&from.raw, start, &to.raw, 0, Some(bytes));
    }

    /// Submits the recording. With a timed recording, the times arrive through the returned `Timing`.
    pub fn submit(mut self) -> Timing<'a> {
        if let Some(timer) = &self.timer {
            let n = 2 * self.stages.len() as u32;
            if n > 0 {
                let bytes = u64::from(n) * 8;
                self.bytes_down += bytes;
                self.encoder
                    .resolve_query_set(&timer.set, 0..n, &timer.resolved, 0);
                self.encoder.copy_buffer_to_buffer(
                    &timer.resolved,
                    0,
                    &timer.times,
                    0,
                    Some(bytes),
                );
            }
        }
        self.gpu.queue.submit([self.encoder.finish()]);
        self.gpu.meter.submitted(&self.dispatches, self.bytes_down);
        Timing {
            gpu: self.gpu,
            stages: self.stages,
            timer: self.timer,
        }
    }
}

impl Pass<'_> {
    /// Runs a kernel on at least `threads` threads.
    pub fn dispatch(&mut self, bound: &Bound, threads: usize) {
        let n = u32::try_from(threads.div_ceil(bound.threads as usize))
            .expect("dispatch sizes are checked with the buffers");
        let [x, y, z] = groups(n);
        self.set(bound);
        self.raw.dispatch_workgroups(x, y, z);
    }

    /// Runs a kernel on the workgroups in `args[4 slot..]`: x, y, z, and the list's length, which kernels may read.
    pub fn dispatch_indirect(&mut self, bound: &Bound, args: &Buffer<u32>, slot: usize) {
        self.set(bound);
        self.raw
            .dispatch_workgroups_indirect(&args.raw, 16 * slot as u64);
    }

    fn set(&mut self, bound: &Bound) {
        self.dispatches.push((self.stage, bound.label));
        self.raw.set_pipeline(bound.pipeline.wait());
        self.raw.set_bind_group(0, &bound.group, &[]);
    }
}

/// The stage times of a submission on their way. Its timer goes back to the device in the end.
#[derive(Debug)]
pub struct Timing<'a> {
    gpu: &'a Gpu,
    stages: Vec<&'static str>,
    timer: Option<Timer>,
}

impl Timing<'_> {
    /// Waits for the times; empty where the adapter has no timestamps.
    ///
    /// # Errors
    /// [`crate::Error::Gpu`] when the device fails.
    pub fn wait(mut self) -> Result<StageTimes, crate::Error> {
        let stages = std::mem::take(&mut self.stages);
        let Some(timer) = self.timer.as_ref().filter(|_| !stages.is_empty()) else {
            return Ok(Vec::new());
        };
        Arrival::request(&timer.times).wait(self.gpu, "stage times")?;
        let view = timer
            .times
            .get_mapped_range(..)
            .map_err(|error| crate::Error::Gpu {
                during: "stage times".to_owned(),
                problem: error.to_string(),
            })?;
        let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(&view);
        drop(view);
        timer.times.unmap();
        let period = f64::from(self.gpu.queue.get_timestamp_period()) * 1e-9;
        let seconds = |pair: &[u64]| pair[1].saturating_sub(pair[0]) as f64 * period;
        Ok(stages
            .into_iter()
            .zip(ticks.chunks_exact(2).map(seconds))
            .collect())
    }
}

impl Drop for Timing<'_> {
    fn drop(&mut self) {
        if let Some(timer) = self.timer.take() {
            self.gpu.keep_timer(timer);
        }
    }
}
