//! Recording: one compute pass per stage, labelled and timed; dispatches split in two dimensions above the limit.

use bytemuck::Pod;

use super::buffer::Arrival;
use super::{Bound, Buffer, Gpu, Readback};

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

/// Records one submission.
#[derive(Debug)]
pub struct Recorder<'a> {
    gpu: &'a Gpu,
    encoder: wgpu::CommandEncoder,
    timer: Option<wgpu::QuerySet>,
    stages: Vec<&'static str>,
    dispatches: Vec<(&'static str, &'static str)>,
}

/// One compute pass: the dispatches of a stage, in order. Each sees what the earlier ones wrote.
#[derive(Debug)]
pub struct Pass<'a> {
    raw: wgpu::ComputePass<'a>,
    stage: &'static str,
    dispatches: &'a mut Vec<(&'static str, &'static str)>,
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
        }
    }

    /// An empty recording whose stages are timed, where the adapter can.
    pub fn timed(gpu: &'a Gpu) -> Recorder<'a> {
        let mut recorder = Recorder::new(gpu);
        recorder.timer = gpu.report().timestamps.then(|| {
            gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("stage times"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * TIMED_STAGES,
            })
        });
        recorder
    }

    /// Records the dispatches of a stage as one pass.
    pub fn stage<R>(&mut self, stage: &'static str, record: impl FnOnce(&mut Pass) -> R) -> R {
        let index = self.stages.len() as u32;
        let timestamp_writes =
            self.timer
                .as_ref()
                .filter(|_| index < TIMED_STAGES)
                .map(|query_set| wgpu::ComputePassTimestampWrites {
                    query_set,
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
        let bytes = ((to.len.max(1) * size_of::<T>()).next_multiple_of(4) as u64).min(from.bytes());
        self.encoder
            .copy_buffer_to_buffer(&from.raw, 0, &to.raw, 0, Some(bytes));
    }

    /// Stage and kernel of every dispatch recorded so far, in order.
    pub fn dispatches(&self) -> &[(&'static str, &'static str)] {
        &self.dispatches
    }

    /// Submits the recording. With a timed recording, the times arrive in the returned read-back.
    pub fn submit(mut self) -> Timing {
        let mut timing = Timing {
            stages: Vec::new(),
            raw: None,
        };
        if let Some(set) = self.timer.take().filter(|_| !self.stages.is_empty()) {
            let n = 2 * self.stages.len() as u32;
            let size = u64::from(n) * 8;
            let make = |label, usage| {
                self.gpu.device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some(label),
                    size,
                    usage,
                    mapped_at_creation: false,
                })
            };
            let resolved = make(
                "stage times",
                wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            );
            let raw = make(
                "stage times (read-back)",
                wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            );
            self.encoder.resolve_query_set(&set, 0..n, &resolved, 0);
            self.encoder
                .copy_buffer_to_buffer(&resolved, 0, &raw, 0, Some(size));
            timing = Timing {
                stages: self.stages,
                raw: Some(raw),
            };
        }
        self.gpu.queue.submit([self.encoder.finish()]);
        timing
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
        self.raw.set_pipeline(&bound.pipeline);
        self.raw.set_bind_group(0, &bound.group, &[]);
    }
}

/// The stage times of a submission on their way.
#[derive(Debug)]
pub struct Timing {
    stages: Vec<&'static str>,
    raw: Option<wgpu::Buffer>,
}

impl Timing {
    /// Waits for the times; empty where the adapter has no timestamps.
    ///
    /// # Errors
    /// [`crate::Error::Gpu`] when the device fails.
    pub fn wait(self, gpu: &Gpu) -> Result<StageTimes, crate::Error> {
        let Some(raw) = self.raw else {
            return Ok(Vec::new());
        };
        Arrival::request(&raw).wait(gpu, "stage times")?;
        let view = raw
            .get_mapped_range(..)
            .map_err(|error| crate::Error::Gpu {
                during: "stage times".to_owned(),
                problem: error.to_string(),
            })?;
        let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(&view);
        let period = f64::from(gpu.queue.get_timestamp_period()) * 1e-9;
        let seconds = |pair: &[u64]| pair[1].saturating_sub(pair[0]) as f64 * period;
        Ok(self
            .stages
            .into_iter()
            .zip(ticks.chunks_exact(2).map(seconds))
            .collect())
    }
}
