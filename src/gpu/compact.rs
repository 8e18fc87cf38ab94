//! Deterministic stream compaction: the indices of all non-zero flags, ascending, and the dispatch size for them. An
//! entry includes the highest bit of its flag, which saves kernels over the list a load.
//!
//! Three dispatches without atomics: counts per chunk, a scan of the counts in one workgroup, and the write. The list
//! is a function of the flags alone.

use super::{Bound, Buffer, Dispatch, Gpu, Kernel, Pass, Real};
use crate::Error;

/// Flags per thread of the count and write kernels: four times `CHUNK_GROUPS` in `common/compact.wgsl`.
const CHUNK: usize = 16;

/// The kernels, shared by all [`Compaction`]s.
#[derive(Debug)]
pub struct CompactKernels {
    count: Kernel,
    scan: Kernel,
    write: Kernel,
}

impl CompactKernels {
    /// Compiles the kernels.
    pub fn new(gpu: &Gpu) -> Result<CompactKernels, Error> {
        Ok(CompactKernels {
            count: Kernel::new(gpu, &crate::wgsl!("compact_count"), Real::F32)?,
            scan: Kernel::new(gpu, &crate::wgsl!("compact_scan"), Real::F32)?,
            write: Kernel::new(gpu, &crate::wgsl!("compact_write"), Real::F32)?,
        })
    }
}

/// A compaction of flags to a list. The slot of `args` receives workgroups x, y, z for the list and its length.
#[derive(Debug)]
pub struct Compaction {
    threads: usize,
    count: Bound,
    scan: Bound,
    write: Bound,
}

/// Uniform of a compaction: `Range` in `common/compact.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Range {
    /// Index of the first flag.
    pub first: u32,
    /// Number of flags.
    pub n_flags: u32,
    /// Index of the first word of the arguments in `args`.
    pub args: u32,
    /// Number of chunks.
    pub n_chunks: u32,
}

impl Compaction {
    /// Words of scratch memory for a compaction of `n_flags` flags. Compactions in sequence may share it.
    pub fn scratch(n_flags: usize) -> usize {
        n_flags.div_ceil(CHUNK)
    }

    /// Compacts `flags[first .. first + n_flags]` (both multiples of 4) into `list[first ..]`. The list contains
    /// indices into `flags`.
    #[expect(clippy::too_many_arguments, reason = "four buffers and where to look in them, each named at the call")]
    pub fn new(
        gpu: &Gpu,
        kernels: &CompactKernels,
        flags: &Buffer<u32>,
        list: &Buffer<u32>,
        args: &Buffer<u32>,
        scratch: &Buffer<u32>,
        [first, n_flags]: [usize; 2],
        slot: usize,
    ) -> Result<Compaction, Error> {
        assert!(first.is_multiple_of(4) && n_flags.is_multiple_of(4), "compaction works on groups of four flags");
        let n_chunks = n_flags.div_ceil(CHUNK);
        let range =
            Range { first: first as u32, n_flags: n_flags as u32, args: 4 * slot as u32, n_chunks: n_chunks as u32 };
        let range = gpu.uniform("compact.range", &range)?;
        let range = ("range", (&range).into());
        let flags = ("flags", flags.into());
        let scratch = ("chunks", scratch.into());
        Ok(Compaction {
            threads: n_chunks,
            count: kernels.count.bind(gpu, &[range, flags, scratch], &[])?,
            scan: kernels.scan.bind(gpu, &[range, scratch, ("args", args.into())], &[])?,
            write: kernels.write.bind(gpu, &[range, flags, scratch, ("list", list.into())], &[])?,
        })
    }

    /// The three dispatches.
    pub fn into_dispatches(self) -> [Dispatch; 3] {
        [self.count.threads(self.threads), self.scan.threads(1), self.write.threads(self.threads)]
    }

    /// Records the three dispatches.
    pub fn record(&self, pass: &mut Pass) {
        pass.dispatch(&self.count, self.threads);
        pass.dispatch(&self.scan, 1);
        pass.dispatch(&self.write, self.threads);
    }
}
