//! Kernels: compute pipelines, one per WGSL file. Reflection lists their variables, which bind by name.

use std::borrow::Cow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use bytemuck::Pod;
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::device::Open;
use super::shader::{Source, Variant, WG_SIZE, compose, parse};
use super::{Buffer, Gpu};
use crate::Error;

/// A compute pipeline. It contains no data and lives as long as the device, which compiles each kernel once.
#[derive(Clone, Debug)]
pub struct Kernel {
    label: &'static str,
    /// `None` on a planning device.
    program: Option<Program>,
}

/// A kernel on a driver's device.
#[derive(Clone, Debug)]
struct Program {
    pipeline: Pipeline,
    layout: wgpu::BindGroupLayout,
    slots: Arc<[Slot]>,
    threads: u32,
}

/// One `@group(0) @binding(n)` variable.
#[derive(Debug)]
struct Slot {
    name: String,
    binding: u32,
    /// Bytes per array element, or of the whole struct or scalar.
    stride: u32,
    uniform: bool,
    read_only: bool,
}

/// A buffer that can be bound to a variable.
#[derive(Clone, Copy, Debug)]
pub struct Binding<'a> {
    raw: Option<&'a wgpu::Buffer>,
    element: usize,
}

impl<'a, T: Pod> From<&'a Buffer<T>> for Binding<'a> {
    fn from(buffer: &'a Buffer<T>) -> Binding<'a> {
        Binding { raw: buffer.raw.as_ref(), element: size_of::<T>() }
    }
}

impl<'a> From<&'a super::RealBuffer> for Binding<'a> {
    fn from(buffer: &'a super::RealBuffer) -> Binding<'a> {
        (&buffer.words).into()
    }
}

/// Device arrays by the names of the WGSL variables.
pub trait Arrays {
    /// The array with a name.
    fn array(&self, name: &str) -> Option<Binding<'_>>;
}

/// A few buffers that several kernels share, as a table.
impl<const N: usize> Arrays for [(&str, Binding<'_>); N] {
    fn array(&self, name: &str) -> Option<Binding<'_>> {
        let mut bindings = self.iter();
        let (_, binding) = bindings.find(|(known, _)| *known == name)?;
        Some(*binding)
    }
}

impl<A: Arrays> Arrays for Option<&A> {
    fn array(&self, name: &str) -> Option<Binding<'_>> {
        self.as_ref()?.array(name)
    }
}

/// A kernel with its bound buffers, ready to dispatch.
#[derive(Debug)]
pub struct Bound {
    pub(super) label: &'static str,
    pub(super) threads: u32,
    /// `None` on a planning device.
    pub(super) binding: Option<BoundProgram>,
}

/// A pipeline and its buffers.
#[derive(Debug)]
pub(super) struct BoundProgram {
    pub(super) pipeline: Pipeline,
    pub(super) group: wgpu::BindGroup,
}

/// A compute pipeline that the driver compiles on another thread.
#[derive(Clone, Debug)]
pub(super) struct Pipeline(Arc<OnceLock<Option<wgpu::ComputePipeline>>>);

impl Pipeline {
    /// A separate thread pool. Threads of rayon's global pool may wait for a dispatch, and would then deadlock on a
    /// pipeline.
    fn threads() -> Option<&'static ThreadPool> {
        static THREADS: OnceLock<Option<ThreadPool>> = OnceLock::new();
        let build = || ThreadPoolBuilder::new().thread_name(|n| format!("compile {n}")).build().ok();
        THREADS.get_or_init(build).as_ref()
    }

    /// Starts the compilation, which `closing` omits. Device errors are returned by the next call that waits for the device.
    fn compile(closing: Arc<AtomicBool>, compile: impl FnOnce() -> wgpu::ComputePipeline + Send + 'static) -> Pipeline {
        let pipeline = Pipeline(Arc::default());
        let slot = Arc::clone(&pipeline.0);
        let task = move || {
            let needed = !closing.load(Ordering::Relaxed);
            let _ = slot.set(needed.then(|| catch_unwind(AssertUnwindSafe(compile)).ok()).flatten());
        };
        match Pipeline::threads() {
            Some(threads) => threads.spawn(task),
            None => task(),
        }
        pipeline
    }

    /// Waits for the compilation.
    ///
    /// # Panics
    /// When the driver's compiler panicked.
    pub(super) fn wait(&self) -> &wgpu::ComputePipeline {
        let pipeline = self.0.wait();
        pipeline.as_ref().expect("the driver's compiler panicked")
    }
}

impl Kernel {
    /// Waits until the driver neither compiles nor will compile the kernel.
    pub(super) fn end_compilation(&self) {
        if let Some(program) = &self.program {
            program.pipeline.0.wait();
        }
    }

    /// Compiles a WGSL file, whose entry point has the file's name, unless the device has compiled it. Returns before
    /// the driver has finished; the first dispatch waits.
    ///
    /// # Errors
    /// [`Error::Shader`] with file and line; [`Error::Limit`] when the kernel has more storage buffers than the
    /// adapter allows.
    pub fn new(gpu: &Gpu, source: &Source, variant: impl Into<Variant>) -> Result<Kernel, Error> {
        let variant = variant.into();
        gpu.note_kernel(source.name);
        if let Some(kernel) = gpu.known_kernel(source, variant) {
            return Ok(kernel);
        }
        let program = match gpu.open() {
            Some(open) => Some(Program::new(open, source, variant)?),
            None => None,
        };
        let kernel = Kernel { label: source.name, program };
        gpu.keep_kernel(source, variant, &kernel);
        Ok(kernel)
    }

    /// Binds each variable of the kernel to the buffer of its name in `own`, else to the array of its name in the first of
    /// `tables` that contains one.
    ///
    /// # Panics
    /// When a variable has no buffer, or one of another element size, and when a name in `own` is no variable.
    pub fn bind(&self, gpu: &Gpu, own: &[(&str, Binding)], tables: &[&dyn Arrays]) -> Result<Bound, Error> {
        let Some((open, program)) = gpu.open().zip(self.program.as_ref()) else {
            return Ok(Bound { label: self.label, threads: WG_SIZE, binding: None });
        };
        for (name, _) in own {
            assert!(program.slots.iter().any(|slot| slot.name == *name), "{}: no variable {name}", self.label);
        }
        let entry = |slot: &Slot| {
            let name = &*slot.name;
            let own = own.iter().find(|(known, _)| *known == name);
            let binding = own.map(|(_, binding)| *binding);
            let binding = binding.or_else(|| tables.iter().find_map(|table| table.array(name)));
            let binding = binding.unwrap_or_else(|| panic!("{}: nothing bound to {name}", self.label));
            let (stride, element) = (slot.stride as usize, binding.element);
            assert!(
                stride.is_multiple_of(element) || element.is_multiple_of(stride),
                "{}: {name} has elements of {stride} bytes, its buffer of {element}",
                self.label
            );
            let raw = binding.raw.expect("a buffer of a planning device is bound");
            wgpu::BindGroupEntry { binding: slot.binding, resource: raw.as_entire_binding() }
        };
        let entries: Vec<_> = program.slots.iter().map(entry).collect();
        let group = open.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.label),
            layout: &program.layout,
            entries: &entries,
        });
        gpu.check(self.label)?;
        Ok(Bound {
            label: self.label,
            threads: program.threads,
            binding: Some(BoundProgram { pipeline: program.pipeline.clone(), group }),
        })
    }
}

impl Program {
    fn new(open: &Open, source: &Source, variant: Variant) -> Result<Program, Error> {
        let composed = compose(source, variant)?;
        let module = parse(&composed)?;
        let entry = source.name.rsplit('/').next().unwrap_or(source.name);
        let point = module.entry_points.iter().find(|point| point.name == entry).ok_or_else(|| Error::Shader {
            file: format!("shaders/{}.wgsl", source.name),
            line: 1,
            problem: format!("no entry point {entry}"),
        })?;
        let threads = point.workgroup_size.iter().product();
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).map_err(|error| Error::Shader {
            file: format!("shaders/{}.wgsl", source.name),
            line: 1,
            problem: error.to_string(),
        })?;
        let mut slots: Vec<Slot> = module
            .global_variables
            .iter()
            .filter_map(|(_, variable)| {
                let binding = variable.binding?;
                let read_only = match variable.space {
                    naga::AddressSpace::Storage { access } => !access.contains(naga::StorageAccess::STORE),
                    _ => true,
                };
                let stride = match module.types[variable.ty].inner {
                    naga::TypeInner::Array { stride, .. } => stride,
                    _ => layouter[variable.ty].size,
                };
                Some(Slot {
                    name: variable.name.clone().unwrap_or_default(),
                    binding: binding.binding,
                    stride,
                    uniform: variable.space == naga::AddressSpace::Uniform,
                    read_only,
                })
            })
            .collect();
        slots.sort_by_key(|slot| slot.binding);
        let storage = slots.iter().filter(|slot| !slot.uniform).count() as u64;
        let available = u64::from(open.limits.max_storage_buffers_per_shader_stage);
        if storage > available {
            return Err(Error::Limit {
                what: format!("kernel {}", source.name),
                needed: storage,
                available,
                unit: "storage buffers (max_storage_buffers_per_shader_stage)",
                cure: "choose another adapter with --adapter, or run with --backend cpu".to_owned(),
            });
        }
        let entries: Vec<_> = slots
            .iter()
            .map(|slot| wgpu::BindGroupLayoutEntry {
                binding: slot.binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer {
                    ty: if slot.uniform {
                        wgpu::BufferBindingType::Uniform
                    } else {
                        wgpu::BufferBindingType::Storage { read_only: slot.read_only }
                    },
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            })
            .collect();
        let label = source.name;
        let layout = open
            .device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries });
        let pipeline_layout = open.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(label),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let device = open.device.clone();
        let pipeline = Pipeline::compile(Arc::clone(&open.closing), move || {
            let shader = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(label),
                source: wgpu::ShaderSource::Naga(Cow::Owned(module)),
            });
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(label),
                layout: Some(&pipeline_layout),
                module: &shader,
                entry_point: Some(entry),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            })
        });
        Ok(Program { pipeline, layout, slots: slots.into(), threads })
    }
}

/// Binds a kernel: each variable to the array of its name in `own`, which kernels may share, else in the first table that has one.
pub(crate) fn bind<const N: usize>(
    gpu: &Gpu,
    source: &Source,
    variant: impl Into<Variant>,
    own: [(&str, Binding); N],
    tables: &[&dyn Arrays],
) -> Result<Bound, Error> {
    let own: &dyn Arrays = &own;
    Kernel::new(gpu, source, variant)?.bind(gpu, &[], &[&[own], tables].concat())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::Pipeline;

    #[test]
    fn kernels_of_a_closing_device_are_not_compiled() {
        let closing = Arc::new(AtomicBool::new(true));
        let compiled = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&compiled);
        let pipeline = Pipeline::compile(closing, move || {
            flag.store(true, Ordering::Relaxed);
            panic!("compiled");
        });
        assert!(pipeline.0.wait().is_none());
        assert!(!compiled.load(Ordering::Relaxed));
    }
}
