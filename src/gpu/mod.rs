//! The GPU layer: device, limits, typed buffers, kernels, shader composition, recording, read-back and timing.
//!
//! It contains no physics. Lifetimes: a [`Kernel`] lives as long as the device, a [`Buffer`] as long as a grid, a
//! [`Readback`] from one submission to the next.
//!
//! Device errors (validation, memory, loss) are collected. The next call that waits returns them: [`Gpu::check`],
//! [`Readback::wait`], [`Gpu::download`].

mod buffer;
mod compact;
mod device;
mod kernel;
mod quiet;
mod record;
mod shader;
mod sort;
mod surroundings;
mod traffic;

pub(crate) use buffer::lock;
pub use buffer::{Buffer, BufferPlan, Readback, RealBuffer};
pub use compact::{CompactKernels, Compaction, Range};
pub use device::{AdapterChoice, AdapterReport, Gpu, NeededLimit};
pub(crate) use kernel::bind;
pub use kernel::{Arrays, Binding, Bound, Kernel};
pub use record::{Dispatch, Dispatches, Pass, Recorder, SPLIT, StageTimes, Timing, groups};
pub use shader::{COMMON, Composed, Real, Source, Variant, WG_SIZE, compose, validate};
pub use sort::{Entries, Sort, SortKernels, SortPass, TILE};
pub use surroundings::Surroundings;
pub use traffic::{StageKernel, Trace, Traffic};

/// The WGSL file `shaders/NAME.wgsl`, embedded.
#[macro_export]
macro_rules! wgsl {
    ($name:literal) => {
        $crate::gpu::Source {
            name: $name,
            text: include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/", $name, ".wgsl")),
        }
    };
}
