//! Adapter choice, device, limits, and collected device errors.

use std::collections::{BTreeSet, HashMap};
use std::fmt::Write as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock};

use super::quiet::quietly;
use super::record::Timer;
use super::traffic::{Meter, StageKernel, Trace, Traffic};
use super::{BufferPlan, Kernel, Source, Surroundings, Variant};
use crate::Error;

/// Choice of the adapter.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub enum AdapterChoice {
    /// Discrete first, then integrated, virtual, software.
    #[default]
    Best,
    /// Index in [`Gpu::adapters`].
    Index(usize),
    /// First adapter of a kind: `discrete`, `integrated`, `virtual`, `software`.
    Kind(wgpu::DeviceType),
    /// First adapter whose name contains the text, ignoring case.
    Name(String),
    /// That of an open device, which is shared with its compiled kernels: simulations start sooner. An error of the device is returned to the first
    /// user that checks for it.
    Open(Gpu),
}

impl std::str::FromStr for AdapterChoice {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<AdapterChoice, Self::Err> {
        Ok(match text {
            "discrete" => AdapterChoice::Kind(wgpu::DeviceType::DiscreteGpu),
            "integrated" => AdapterChoice::Kind(wgpu::DeviceType::IntegratedGpu),
            "virtual" => AdapterChoice::Kind(wgpu::DeviceType::VirtualGpu),
            "software" | "cpu" => AdapterChoice::Kind(wgpu::DeviceType::Cpu),
            _ => text.parse().map_or_else(|_| AdapterChoice::Name(text.to_owned()), AdapterChoice::Index),
        })
    }
}

/// Name of a kind, as in `--adapter`.
fn kind_name(kind: wgpu::DeviceType) -> &'static str {
    match kind {
        wgpu::DeviceType::DiscreteGpu => "discrete",
        wgpu::DeviceType::IntegratedGpu => "integrated",
        wgpu::DeviceType::VirtualGpu => "virtual",
        wgpu::DeviceType::Cpu => "software",
        wgpu::DeviceType::Other => "other",
    }
}

impl std::fmt::Display for AdapterChoice {
    fn fmt(&self, text: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            AdapterChoice::Best => write!(text, "the best"),
            AdapterChoice::Index(index) => write!(text, "index {index}"),
            AdapterChoice::Kind(kind) => write!(text, "kind {}", kind_name(*kind)),
            AdapterChoice::Name(name) => write!(text, "the name \"{name}\""),
            AdapterChoice::Open(gpu) => write!(text, "the open {}", gpu.report.name),
        }
    }
}

/// A limit that every scene requires of an adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NeededLimit {
    /// Name in wgpu.
    pub name: &'static str,
    /// Purpose.
    pub what: &'static str,
    /// Smallest sufficient value.
    pub needed: u32,
    /// Value of the adapter.
    pub available: u32,
}

/// Properties of an adapter, queried without opening a device. The default has all features and no limits.
#[derive(Clone, Debug)]
pub struct AdapterReport {
    /// Name.
    pub name: String,
    /// Driver and version.
    pub driver: String,
    /// Graphics API, such as `vulkan`.
    pub backend: String,
    /// `discrete`, `integrated`, `virtual`, `software` or `other`.
    pub kind: &'static str,
    /// Whether WGSL f64 works: required by precision `f64` and used by `mixed`.
    pub f64: bool,
    /// Whether the device supports timestamps for stages.
    pub timestamps: bool,
    /// Largest number of storage buffers per kernel.
    pub storage_buffers: u32,
    /// Largest storage binding, bytes.
    pub storage_binding: u64,
    /// Largest buffer, bytes.
    pub buffer: u64,
    /// Threads per workgroup.
    pub threads: u32,
    /// Workgroups per dimension.
    pub workgroups: u32,
}

impl Default for AdapterReport {
    fn default() -> AdapterReport {
        AdapterReport {
            name: "none".to_owned(),
            driver: String::new(),
            backend: String::new(),
            kind: "other",
            f64: true,
            timestamps: true,
            storage_buffers: u32::MAX,
            storage_binding: u64::MAX,
            buffer: u64::MAX,
            threads: u32::MAX,
            workgroups: u32::MAX,
        }
    }
}

impl AdapterReport {
    fn new(adapter: &wgpu::Adapter) -> AdapterReport {
        let info = adapter.get_info();
        let limits = adapter.limits();
        let features = adapter.features();
        AdapterReport {
            name: info.name,
            driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
            backend: info.backend.to_str().to_owned(),
            kind: kind_name(info.device_type),
            f64: features.contains(wgpu::Features::SHADER_F64),
            timestamps: features.contains(wgpu::Features::TIMESTAMP_QUERY),
            storage_buffers: limits.max_storage_buffers_per_shader_stage,
            storage_binding: limits.max_storage_buffer_binding_size,
            buffer: limits.max_buffer_size,
            threads: limits.max_compute_invocations_per_workgroup,
            workgroups: limits.max_compute_workgroups_per_dimension,
        }
    }

    /// The limits that every scene requires, independent of its size.
    pub fn needed_limits(&self) -> [NeededLimit; 3] {
        [
            NeededLimit {
                name: "max_compute_invocations_per_workgroup",
                what: "a kernel's workgroup",
                needed: NEEDED_THREADS,
                available: self.threads,
            },
            NeededLimit {
                name: "max_storage_buffers_per_shader_stage",
                what: "a kernel",
                needed: STORAGE_BUFFERS,
                available: self.storage_buffers,
            },
            NeededLimit {
                name: "max_compute_workgroups_per_dimension",
                what: "a dispatch",
                needed: super::SPLIT,
                available: self.workgroups,
            },
        ]
    }

    /// Checks the limits that every scene requires.
    pub fn check_limits(&self) -> Result<(), Error> {
        let mut limits = self.needed_limits().into_iter();
        match limits.find(|limit| limit.available < limit.needed) {
            None => Ok(()),
            Some(limit) => Err(Error::Limit {
                what: format!("{} ({})", limit.what, limit.name),
                needed: limit.needed.into(),
                available: limit.available.into(),
                unit: "units",
                cure: "choose another adapter with --adapter, or run with --backend cpu".to_owned(),
            }),
        }
    }

    /// Checks that the adapter supports f64 in all kernels if `wanted`.
    pub fn check_precision(&self, wanted: bool) -> Result<(), Error> {
        if self.f64 || !wanted {
            return Ok(());
        }
        Err(Error::Limit {
            what: "precision f64".to_owned(),
            needed: 1,
            available: 0,
            unit: "feature (SHADER_F64)",
            cure: "use precision \"mixed\", which reaches the same tolerance, or --backend cpu".to_owned(),
        })
    }

    /// Checks the size of a storage buffer against the limits.
    pub fn check_buffer(&self, label: &str, bytes: u64) -> Result<(), Error> {
        let (available, unit) = if self.storage_binding <= self.buffer {
            (self.storage_binding, "bytes (max_storage_buffer_binding_size)")
        } else {
            (self.buffer, "bytes (max_buffer_size)")
        };
        if bytes <= available {
            return Ok(());
        }
        Err(Error::Limit {
            what: format!("buffer {label}"),
            needed: bytes,
            available,
            unit,
            cure: "make it smaller, use another adapter (--adapter), or --backend cpu".to_owned(),
        })
    }
}

/// Threads per workgroup that the shaders assume.
const NEEDED_THREADS: u32 = 256;
/// Largest number of storage buffers that a kernel binds.
const STORAGE_BUFFERS: u32 = 8;

/// Error for a system without any adapter.
fn no_adapter() -> Error {
    let surroundings = cfg!(target_os = "linux").then(Surroundings::of_system);
    let mut cures = surroundings.map_or(Vec::new(), |diagnostics| diagnostics.cures(false));
    cures.push(
        "install a Vulkan driver (Debian: apt-get install mesa-vulkan-drivers installs those of AMD and Intel GPUs, and the software \
         adapter llvmpipe), point VK_DRIVER_FILES at a driver's JSON file, or run with --backend cpu"
            .to_owned(),
    );
    Error::Adapter {
        problem: "none found; `cutwater adapters` lists the diagnostics".to_owned(),
        cure: cures.join("; else "),
    }
}

/// An open device with its queue, or a planning device without a driver. Clones share it.
///
/// A planning device ([`Gpu::planning`]) records buffers and kernels. It does not allocate, compile, upload or run.
#[derive(Clone, Debug)]
pub struct Gpu {
    shared: Arc<Shared>,
    /// Stage of the kernels that are compiled next: see [`Gpu::at`].
    stage: &'static str,
}

/// State shared by the clones of a [`Gpu`]: buffers, kernels and traffic of one user of the device.
#[derive(Debug)]
pub struct Shared {
    /// `None` on a planning device.
    open: Option<Arc<Open>>,
    report: AdapterReport,
    allocated: Mutex<Vec<BufferPlan>>,
    /// Stage and name of every kernel, in order of first use.
    stage_kernels: Mutex<Vec<StageKernel>>,
    pub(super) meter: Meter,
    /// Idle timers.
    pub(super) timers: Mutex<Vec<Timer>>,
}

/// An open device of a driver.
#[derive(Debug)]
pub(super) struct Open {
    adapter: wgpu::Adapter,
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) limits: wgpu::Limits,
    faults: Arc<Mutex<Option<String>>>,
    kernels: Mutex<HashMap<(Source, Variant), Kernel>>,
    /// Whether kernels that are not yet being compiled are not needed any more.
    pub(super) closing: Arc<AtomicBool>,
}

impl Drop for Open {
    /// Waits for the driver's compiler: NVIDIA's crashes where the process exits meanwhile.
    fn drop(&mut self) {
        self.closing.store(true, Ordering::Relaxed);
        if let Ok(kernels) = self.kernels.get_mut() {
            kernels.values().for_each(Kernel::end_compilation);
        }
    }
}

impl PartialEq for Gpu {
    /// Whether both have the same device.
    fn eq(&self, other: &Gpu) -> bool {
        match (&self.shared.open, &other.shared.open) {
            (Some(open), Some(others)) => Arc::ptr_eq(open, others),
            _ => Arc::ptr_eq(&self.shared, &other.shared),
        }
    }
}

impl Eq for Gpu {}

impl std::ops::Deref for Gpu {
    type Target = Shared;

    fn deref(&self) -> &Shared {
        &self.shared
    }
}

/// The only instance of the process: drivers crash when several instances are destroyed concurrently.
fn instance() -> &'static wgpu::Instance {
    static INSTANCE: OnceLock<wgpu::Instance> = OnceLock::new();
    INSTANCE.get_or_init(|| {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
        descriptor.backends = wgpu::Backends::PRIMARY;
        // Indirect sizes come from our own kernels, which respect the limits. wgpu's validating dispatch would cost
        // 18.7 us instead of 1.3 us on llvmpipe.
        descriptor.flags.remove(wgpu::InstanceFlags::VALIDATION_INDIRECT_CALL);
        quietly(|| wgpu::Instance::new(descriptor))
    })
}

fn enumerate() -> Vec<wgpu::Adapter> {
    let instance = instance();
    quietly(|| pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY)))
}

fn choose(choice: &AdapterChoice) -> Result<wgpu::Adapter, Error> {
    let adapters = enumerate();
    let rank = |adapter: &wgpu::Adapter| match adapter.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    };
    let chosen = match choice {
        AdapterChoice::Best => adapters.iter().min_by_key(|adapter| rank(adapter)),
        AdapterChoice::Index(index) => adapters.get(*index),
        AdapterChoice::Kind(kind) => adapters.iter().find(|adapter| adapter.get_info().device_type == *kind),
        AdapterChoice::Name(name) => {
            let name = name.to_lowercase();
            adapters.iter().find(|adapter| adapter.get_info().name.to_lowercase().contains(&name))
        }
        AdapterChoice::Open(gpu) => gpu.open().map(|open| &open.adapter),
    };
    chosen.cloned().ok_or_else(|| {
        if adapters.is_empty() {
            return no_adapter();
        }
        let mut found = String::new();
        for (index, adapter) in adapters.iter().enumerate() {
            let report = AdapterReport::new(adapter);
            let _ = write!(found, "{}{index}: {} ({})", if index > 0 { ", " } else { "" }, report.name, report.kind);
        }
        Error::Adapter {
            problem: format!("none matches {choice}; found {found}"),
            cure:
                "give --adapter an index, a kind (discrete, integrated, virtual, software) or part of a name, or run \
                   with --backend cpu"
                    .to_owned(),
        }
    })
}

impl Gpu {
    /// All adapters, in the order of [`AdapterChoice::Index`].
    pub fn adapters() -> Vec<AdapterReport> {
        enumerate().iter().map(AdapterReport::new).collect()
    }

    /// The adapter of a choice, without opening a device.
    pub fn find(choice: &AdapterChoice) -> Result<AdapterReport, Error> {
        choose(choice).map(|adapter| AdapterReport::new(&adapter))
    }

    /// Opens a device with all limits of its adapter, or shares an open one.
    pub fn new(choice: &AdapterChoice) -> Result<Gpu, Error> {
        if let AdapterChoice::Open(gpu) = choice {
            return Ok(Gpu::with(gpu.shared.open.clone(), gpu.report.clone()));
        }
        let adapter = choose(choice)?;
        let report = AdapterReport::new(&adapter);
        let limits = adapter.limits();
        report.check_limits()?;
        let features = wgpu::Features::SHADER_F64 | wgpu::Features::TIMESTAMP_QUERY;
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("cutwater"),
            required_features: adapter.features() & features,
            required_limits: limits.clone(),
            ..Default::default()
        }))
        .map_err(|error| Error::Adapter {
            problem: format!("{} does not open: {error}", report.name),
            cure: "choose another adapter with --adapter, or run with --backend cpu".to_owned(),
        })?;
        let faults = Arc::new(Mutex::new(None));
        let keep_first = |faults: &Mutex<Option<String>>, fault: String| {
            if let Ok(mut slot) = faults.lock() {
                slot.get_or_insert(fault);
            }
        };
        let sink = Arc::clone(&faults);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| keep_first(&sink, error.to_string())));
        let sink = Arc::clone(&faults);
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                keep_first(&sink, format!("the device was lost: {message}"));
            }
        });
        let open = Open { adapter, device, queue, limits, faults, kernels: Mutex::default(), closing: Arc::default() };
        Ok(Gpu::with(Some(open.into()), report))
    }

    /// A planning device with the properties of an adapter.
    pub fn planning(report: AdapterReport) -> Gpu {
        Gpu::with(None, report)
    }

    fn with(open: Option<Arc<Open>>, report: AdapterReport) -> Gpu {
        let shared = Shared {
            open,
            report,
            allocated: Mutex::default(),
            stage_kernels: Mutex::default(),
            meter: Meter::default(),
            timers: Mutex::default(),
        };
        let gpu = Gpu { shared: shared.into(), stage: "" };
        if gpu.report.timestamps {
            Timer::new(&gpu).into_iter().for_each(|timer| gpu.keep_timer(timer));
        }
        gpu
    }

    /// A handle to the same device. [`Gpu::stage_kernels`] assigns its kernels to the stage.
    pub fn at(&self, stage: &'static str) -> Gpu {
        Gpu { shared: Arc::clone(&self.shared), stage }
    }

    /// Whether this is a planning device.
    pub fn is_planning(&self) -> bool {
        self.open().is_none()
    }

    /// The driver's device; `None` on a planning device.
    pub(super) fn open(&self) -> Option<&Open> {
        self.shared.open.as_deref()
    }

    /// Properties of the adapter.
    pub fn report(&self) -> &AdapterReport {
        &self.report
    }

    /// Whether kernels may use f64.
    pub fn has_f64(&self) -> bool {
        self.report.f64
    }

    /// Returns the first device error since the last call, if any, with the operation `during` which it occurred.
    pub fn check(&self, during: &str) -> Result<(), Error> {
        let fault = self.open().and_then(|open| open.faults.lock().ok()?.take());
        match fault {
            Some(problem) => Err(Error::Gpu { during: during.to_owned(), problem }),
            None => Ok(()),
        }
    }

    /// Waits until all submitted work is done.
    pub fn wait(&self, during: &str) -> Result<(), Error> {
        let Some(open) = self.open() else {
            return Ok(());
        };
        let polled = open.device.poll(wgpu::PollType::wait_indefinitely());
        self.meter.waited();
        self.check(during)?;
        polled.map(|_| ()).map_err(|error| Error::Gpu { during: during.to_owned(), problem: error.to_string() })
    }

    /// Labels and bytes of all buffers so far.
    pub fn allocated(&self) -> Vec<(String, u64)> {
        let plans = self.buffer_plans().into_iter();
        plans.map(|plan| (plan.label.clone(), plan.bytes())).collect()
    }

    /// All buffers so far.
    pub fn buffer_plans(&self) -> Vec<BufferPlan> {
        self.allocated.lock().map(|list| list.clone()).unwrap_or_default()
    }

    /// Stages (see [`Gpu::at`]) and their kernels, in order of first use.
    pub fn stage_kernels(&self) -> Vec<StageKernel> {
        self.stage_kernels.lock().map(|list| list.clone()).unwrap_or_default()
    }

    /// Names of all kernels so far, sorted.
    pub fn compiled(&self) -> BTreeSet<&'static str> {
        self.stage_kernels().into_iter().map(|(_, kernel)| kernel).collect()
    }

    /// Traffic of this user of the device.
    pub fn traffic(&self) -> Traffic {
        self.meter.traffic()
    }

    /// Starts a new trace of dispatches and waits and discards the last.
    pub fn start_trace(&self) {
        self.meter.start_trace();
    }

    /// Ends the trace and returns the dispatches and waits since [`Gpu::start_trace`].
    pub fn take_trace(&self) -> Trace {
        self.meter.take_trace()
    }

    pub(super) fn known_kernel(&self, source: &Source, variant: Variant) -> Option<Kernel> {
        let kernels = self.open()?.kernels.lock().ok()?;
        kernels.get(&(*source, variant)).cloned()
    }

    pub(super) fn keep_kernel(&self, source: &Source, variant: Variant, kernel: &Kernel) {
        if let Some(Ok(mut kernels)) = self.open().map(|open| open.kernels.lock()) {
            kernels.entry((*source, variant)).or_insert_with(|| kernel.clone());
        }
    }

    pub(super) fn note_allocation(&self, plan: BufferPlan) {
        if let Ok(mut list) = self.allocated.lock() {
            list.push(plan);
        }
    }

    pub(super) fn note_kernel(&self, kernel: &'static str) {
        let stage_kernel = (self.stage, kernel);
        if let Ok(mut list) = self.stage_kernels.lock()
            && !list.contains(&stage_kernel)
        {
            list.push(stage_kernel);
        }
    }
}
