//! Kernels: a compute pipeline made from one WGSL file, its bindings found by reflection and bound by name.

use std::sync::Arc;

use bytemuck::Pod;

use super::shader::{Source, Variant, compose, validate};
use super::{Buffer, Gpu};
use crate::Error;

/// A compute pipeline. Lives as long as the device, which compiles each one once; owns no data.
#[derive(Clone, Debug)]
pub struct Kernel {
    label: &'static str,
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    slots: Arc<[Slot]>,
    threads: u32,
}

/// One `@group(0) @binding(n)` variable.
#[derive(Debug)]
struct Slot {
    name: String,
    binding: u32,
    /// Bytes of an array element, or of the whole struct or scalar.
    stride: u32,
    uniform: bool,
    read_only: bool,
}

/// A buffer offered to a kernel.
#[derive(Clone, Copy, Debug)]
pub struct Binding<'a> {
    raw: &'a wgpu::Buffer,
    element: usize,
}

impl<'a, T: Pod> From<&'a Buffer<T>> for Binding<'a> {
    fn from(buffer: &'a Buffer<T>) -> Binding<'a> {
        Binding {
            raw: &buffer.raw,
            element: size_of::<T>(),
        }
    }
}

impl<'a> From<&'a super::RealBuffer> for Binding<'a> {
    fn from(buffer: &'a super::RealBuffer) -> Binding<'a> {
        (&buffer.words).into()
    }
}

/// A kernel with its buffers: what a pass dispatches. Made once.
#[derive(Debug)]
pub struct Bound {
    pub(super) label: &'static str,
    pub(super) pipeline: wgpu::ComputePipeline,
    pub(super) group: wgpu::BindGroup,
    pub(super) threads: u32,
}

impl Kernel {
    /// Compiles a WGSL file whose entry point has the file's name, unless the device has it already.
    ///
    /// # Errors
    /// [`Error::Shader`] with file and line, [`Error::Limit`] when it binds more storage buffers than the adapter allows.
    pub fn new(gpu: &Gpu, source: &Source, variant: impl Into<Variant>) -> Result<Kernel, Error> {
        let variant = variant.into();
        if let Some(kernel) = gpu.known_kernel(source, variant) {
            return Ok(kernel);
        }
        let composed = compose(source, variant)?;
        let (module, _) = validate(&composed, variant)?;
        let entry = source.name.rsplit('/').next().unwrap_or(source.name);
        let point = module
            .entry_points
            .iter()
            .find(|point| point.name == entry)
            .ok_or_else(|| Error::Shader {
                file: format!("shaders/{}.wgsl", source.name),
                line: 1,
                problem: format!("no entry point {entry}"),
            })?;
        let threads = point.workgroup_size.iter().product();
        let mut layouter = naga::proc::Layouter::default();
        layouter
            .update(module.to_ctx())
            .map_err(|error| Error::Shader {
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
                    naga::AddressSpace::Storage { access } => {
                        !access.contains(naga::StorageAccess::STORE)
                    }
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
        let available = u64::from(gpu.limits.max_storage_buffers_per_shader_stage);
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
                        wgpu::BufferBindingType::Storage {
                            read_only: slot.read_only,
                        }
                    },
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            })
            .collect();
        let label = source.name;
        let layout = gpu
            .device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(label),
                entries: &entries,
            });
        let pipeline_layout = gpu
            .device
            .create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(label),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            });
        let shader = gpu
            .device
            .create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(label),
                source: wgpu::ShaderSource::Wgsl(composed.text.as_str().into()),
            });
        let pipeline = gpu
            .device
            .create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(label),
                layout: Some(&pipeline_layout),
                module: &shader,
                entry_point: Some(entry),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            });
        gpu.check(label)?;
        let kernel = Kernel {
            label,
            pipeline,
            layout,
            slots: slots.into(),
            threads,
        };
        gpu.keep_kernel(source, variant, &kernel);
        Ok(kernel)
    }

    /// Binds buffers to the kernel's variables, by name.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device refuses.
    ///
    /// # Panics
    /// When a variable is missing, unknown, or of another element size: the caller and the shader disagree.
    pub fn bind(&self, gpu: &Gpu, bindings: &[(&str, Binding)]) -> Result<Bound, Error> {
        let entries: Vec<_> = self
            .slots
            .iter()
            .map(|slot| {
                let (_, binding) = bindings
                    .iter()
                    .find(|(name, _)| *name == slot.name)
                    .unwrap_or_else(|| panic!("{}: nothing bound to {}", self.label, slot.name));
                let (stride, element) = (slot.stride as usize, binding.element);
                assert!(
                    stride.is_multiple_of(element) || element.is_multiple_of(stride),
                    "{}: {} has elements of {stride} bytes, its buffer of {element}",
                    self.label,
                    slot.name
                );
                wgpu::BindGroupEntry {
                    binding: slot.binding,
                    resource: binding.raw.as_entire_binding(),
                }
            })
            .collect();
        for (name, _) in bindings {
            assert!(
                self.slots.iter().any(|slot| slot.name == *name),
                "{}: no variable {name}",
                self.label
            );
        }
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.label),
            layout: &self.layout,
            entries: &entries,
        });
        gpu.check(self.label)?;
        Ok(Bound {
            label: self.label,
            pipeline: self.pipeline.clone(),
            group,
            threads: self.threads,
        })
    }
}
