//! Typed, labelled device buffers, and read-back.

use std::marker::PhantomData;
use std::sync::{Mutex, MutexGuard, PoisonError, mpsc};
use std::time::Duration;

use bytemuck::Pod;

use super::{Gpu, Real, Recorder};
use crate::Error;

/// A buffer to be made: what `plan` prints and [`Gpu::buffer`] allocates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BufferPlan {
    /// Label, `group.name`.
    pub label: String,
    /// Elements.
    pub len: usize,
    /// Bytes of an element.
    pub element: usize,
}

impl BufferPlan {
    /// A plan for `len` elements of `T`.
    pub fn of<T>(label: &str, len: usize) -> BufferPlan {
        BufferPlan { label: label.to_owned(), len, element: size_of::<T>() }
    }

    /// Bytes in all.
    pub fn bytes(&self) -> u64 {
        ((self.len.max(1) * self.element) as u64).next_multiple_of(4)
    }
}

/// Usage of a buffer that kernels, copies and indirect dispatches can use.
const STORAGE: wgpu::BufferUsages = wgpu::BufferUsages::STORAGE
    .union(wgpu::BufferUsages::COPY_SRC)
    .union(wgpu::BufferUsages::COPY_DST)
    .union(wgpu::BufferUsages::INDIRECT);

/// A device buffer of `len` elements `T`, zero at first.
#[derive(Debug)]
pub struct Buffer<T> {
    /// `None` on a planning device.
    pub(super) raw: Option<wgpu::Buffer>,
    len: usize,
    label: String,
    element: PhantomData<T>,
}

impl<T: Pod> Buffer<T> {
    /// Elements.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether it holds nothing.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Label.
    pub fn label(&self) -> &str {
        &self.label
    }

    /// Bytes.
    pub fn bytes(&self) -> u64 {
        BufferPlan::of::<T>("", self.len).bytes()
    }
}

impl Gpu {
    /// A storage buffer that kernels, copies and indirect dispatches can use; never smaller than one element.
    ///
    /// # Errors
    /// [`Error::Limit`] when the adapter does not allow the size.
    pub fn buffer<T: Pod>(&self, label: &str, len: usize) -> Result<Buffer<T>, Error> {
        self.make(BufferPlan::of::<T>(label, len), STORAGE)
    }

    /// A storage buffer with contents.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn buffer_with<T: Pod>(&self, label: &str, values: &[T]) -> Result<Buffer<T>, Error> {
        let buffer = self.buffer(label, values.len())?;
        self.upload(&buffer, values);
        Ok(buffer)
    }

    /// A uniform buffer holding one value.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn uniform<T: Pod>(&self, label: &str, value: &T) -> Result<Buffer<T>, Error> {
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let buffer = self.make(BufferPlan::of::<T>(label, 1), usage)?;
        self.upload(&buffer, std::slice::from_ref(value));
        Ok(buffer)
    }

    fn make<T: Pod>(&self, plan: BufferPlan, usage: wgpu::BufferUsages) -> Result<Buffer<T>, Error> {
        let size = plan.bytes();
        let raw = match self.open() {
            None => None,
            Some(open) => {
                self.report().check_buffer(&plan.label, size)?;
                Some(open.device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some(&plan.label),
                    size,
                    usage,
                    mapped_at_creation: false,
                }))
            }
        };
        let (label, len) = (plan.label.clone(), plan.len * plan.element / size_of::<T>());
        self.note_allocation(plan);
        Ok(Buffer { raw, len, label, element: PhantomData })
    }

    /// Writes values to the start of a buffer, before all work submitted later.
    pub fn upload<T: Pod>(&self, buffer: &Buffer<T>, values: &[T]) {
        assert!(values.len() <= buffer.len, "{}: {} values into {}", buffer.label, values.len(), buffer.len);
        if let Some((open, raw)) = self.open().zip(buffer.raw.as_ref())
            && !values.is_empty()
        {
            let bytes: &[u8] = bytemuck::cast_slice(values);
            open.queue.write_buffer(raw, 0, bytes);
            self.meter.uploaded(bytes.len() as u64);
        }
    }

    /// Waits for all submitted work and reads a whole buffer. For set-up, output and tests; a step uses [`Readback`].
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn download<T: Pod>(&self, buffer: &Buffer<T>) -> Result<Vec<T>, Error> {
        Readback::new(self, &buffer.label, buffer.len)?.fetch(self, buffer)
    }
}

/// A buffer of scalars whose width the precision decides.
#[derive(Debug)]
pub struct RealBuffer {
    /// The words.
    pub words: Buffer<u32>,
    /// The scalar type.
    pub real: Real,
}

impl RealBuffer {
    /// `len` scalars, zero at first.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, label: &str, len: usize, real: Real) -> Result<RealBuffer, Error> {
        let plan = BufferPlan { label: label.to_owned(), len, element: real.bytes() };
        Ok(RealBuffer { words: gpu.make(plan, STORAGE)?, real })
    }

    /// Writes values, rounded to the scalar type, before all work submitted later.
    pub fn upload(&self, gpu: &Gpu, values: &[f64]) {
        match self.real {
            Real::F64 => gpu.upload(&self.words, bytemuck::cast_slice(values)),
            Real::F32 => {
                let narrow: Vec<f32> = values.iter().map(|&value| value as f32).collect();
                gpu.upload(&self.words, bytemuck::cast_slice(&narrow));
            }
        }
    }

    /// Waits for all submitted work and reads everything.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn download(&self, gpu: &Gpu) -> Result<Vec<f64>, Error> {
        Ok(self.widen(&gpu.download(&self.words)?))
    }

    /// The values in words read back from this buffer.
    pub fn widen(&self, words: &[u32]) -> Vec<f64> {
        match self.real {
            Real::F64 => bytemuck::pod_collect_to_vec(words),
            Real::F32 => words.iter().map(|&word| f64::from(f32::from_bits(word))).collect(),
        }
    }
}

/// The news that a buffer is mapped.
#[derive(Debug)]
pub(super) struct Arrival(mpsc::Receiver<Result<(), wgpu::BufferAsyncError>>);

/// How long another thread may take to pass the news on.
const PATIENCE: Duration = Duration::from_secs(60);

impl Arrival {
    /// Asks for a buffer to be mapped for reading after the work submitted so far.
    pub(super) fn request(raw: &wgpu::Buffer) -> Arrival {
        let (send, receive) = mpsc::channel();
        raw.map_async(wgpu::MapMode::Read, .., move |result| {
            // The receiver is gone only when whoever asked gave up.
            let _ = send.send(result);
        });
        Arrival(receive)
    }

    /// Waits for the work, and for the news, which a thread that polled at the same time may be about to pass on.
    pub(super) fn wait(self, gpu: &Gpu, during: &str) -> Result<(), Error> {
        gpu.wait(during)?;
        let fault = |problem: String| Error::Gpu { during: during.to_owned(), problem };
        self.0
            .recv_timeout(PATIENCE)
            .map_err(|_| fault("the mapping did not arrive".to_owned()))?
            .map_err(|error| fault(error.to_string()))
    }
}

/// Locks, also after a panic of another thread. Use it for data that such a panic leaves complete or that the next use overwrites.
pub(crate) fn lock<T>(data: &Mutex<T>) -> MutexGuard<'_, T> {
    data.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A host-visible copy of (the start of) a buffer, filled by [`Recorder::read`] and fetched after the submission.
#[derive(Debug)]
pub struct Readback<T> {
    /// `None` on a planning device.
    pub(super) raw: Option<wgpu::Buffer>,
    pub(super) len: usize,
    label: String,
    arrival: Option<Arrival>,
    element: PhantomData<T>,
}

impl<T: Pod> Readback<T> {
    /// Room for `len` elements.
    ///
    /// # Errors
    /// [`Error::Limit`] when the adapter does not allow the size.
    pub fn new(gpu: &Gpu, label: &str, len: usize) -> Result<Readback<T>, Error> {
        let label = format!("{label} (read-back)");
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let Buffer { raw, len, .. } = gpu.make::<T>(BufferPlan::of::<T>(&label, len), usage)?;
        Ok(Readback { raw, len, label, arrival: None, element: PhantomData })
    }

    /// Waits for all submitted work and returns the first elements of a buffer.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn fetch(&mut self, gpu: &Gpu, from: &Buffer<T>) -> Result<Vec<T>, Error> {
        let mut recorder = Recorder::new(gpu);
        recorder.read(from, self);
        recorder.submit();
        self.wait(gpu)
    }

    /// Asks for the contents as of the work submitted so far; the host goes on meanwhile.
    pub fn start(&mut self) {
        self.arrival = self.raw.as_ref().map(Arrival::request);
    }

    /// Waits for the contents; starts the request if [`Readback::start`] was not called.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn wait(&mut self, gpu: &Gpu) -> Result<Vec<T>, Error> {
        // Mapped memory need not be aligned for f64, so the bytes are copied.
        let mut values = vec![T::zeroed(); self.len];
        if self.arrival.is_none() {
            self.start();
        }
        let Some((arrival, raw)) = self.arrival.take().zip(self.raw.as_ref()) else {
            return Ok(values);
        };
        arrival.wait(gpu, &self.label)?;
        let view = raw
            .get_mapped_range(..)
            .map_err(|error| Error::Gpu { during: self.label.clone(), problem: error.to_string() })?;
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut values);
        let n = bytes.len();
        bytes.copy_from_slice(&view[..n]);
        drop(view);
        raw.unmap();
        Ok(values)
    }
}
