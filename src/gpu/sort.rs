//! Deterministic, stable radix sort of u32 keys with u32 values, least significant digit first, four bits a pass. The
//! device reads the length of the list.
//!
//! A pass counts the digits of each tile of [`TILE`] entries, scans the counts in one workgroup and scatters. Atomics
//! add integers only, so the result is a function of the list alone.

use super::{Bound, Buffer, BufferPlan, Gpu, Kernel, Pass, Real};
use crate::Error;

/// Entries per workgroup; also in `common/sort.wgsl`.
pub const TILE: usize = 1024;
/// Bits per digit, and number of values of a digit; also in `common/sort.wgsl`.
const DIGIT_BITS: u32 = 4;
const DIGITS: usize = 1 << DIGIT_BITS;

/// The kernels, shared by all [`Sort`]s.
#[derive(Debug)]
pub struct SortKernels {
    begin: Kernel,
    count: Kernel,
    scan: Kernel,
    scatter: Kernel,
}

impl SortKernels {
    /// Compiles the kernels.
    pub fn new(gpu: &Gpu) -> Result<SortKernels, Error> {
        Ok(SortKernels {
            begin: Kernel::new(gpu, &crate::wgsl!("sort_begin"), Real::F32)?,
            count: Kernel::new(gpu, &crate::wgsl!("sort_count"), Real::F32)?,
            scan: Kernel::new(gpu, &crate::wgsl!("sort_scan"), Real::F32)?,
            scatter: Kernel::new(gpu, &crate::wgsl!("sort_scatter"), Real::F32)?,
        })
    }
}

/// Uniform of a pass: `SortPass` in `common/sort.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct SortPass {
    /// Lowest bit of the pass's digit.
    pub shift: u32,
    /// Index of the first of the list's four arguments; the fourth is its length.
    pub args: u32,
}

/// Keys and values of a list of at most `entries` entries.
#[derive(Clone, Copy, Debug)]
pub struct Entries<'a> {
    /// Sort keys.
    pub keys: &'a Buffer<u32>,
    /// Values permuted with the keys.
    pub values: &'a Buffer<u32>,
}

/// A sort in place.
#[derive(Debug)]
pub struct Sort {
    tile_args: Buffer<u32>,
    begin: Bound,
    passes: Vec<[Bound; 3]>,
}

impl Sort {
    /// The scratch buffer of a sort of at most `n` entries, in addition to a second list. Sorts in sequence may share
    /// both.
    pub fn scratch(label: &'static str, n: usize) -> BufferPlan {
        BufferPlan::of::<u32>(label, DIGITS * n.div_ceil(TILE))
    }

    /// Binds a sort of the list in `entries` by the lowest `bits` of its keys, rounded up to whole bytes. The fourth
    /// word of the slot in `args` contains the list's length, at most that of the four buffers. `spare` is
    /// overwritten scratch memory for a second list.
    ///
    /// # Panics
    /// When the buffers' lengths differ or `bits` exceeds 32.
    pub fn new(
        gpu: &Gpu,
        kernels: &SortKernels,
        entries: Entries,
        spare: Entries,
        scratch: &Buffer<u32>,
        (args, slot): (&Buffer<u32>, usize),
        bits: u32,
    ) -> Result<Sort, Error> {
        let n = entries.keys.len();
        let lengths = [entries.values, spare.keys, spare.values].map(|buffer| buffer.len());
        assert_eq!(lengths, [n; 3], "lengths of the lists of a sort");
        assert!(bits <= 32, "keys have 32 bits");
        let tile_args = gpu.buffer("sort.tile_args", 4)?;
        let lists = ("args", args.into());
        let chunks = ("chunks", scratch.into());
        // Two passes per byte, so the result ends in the first list.
        let passes = (0..2 * bits.div_ceil(8)).map(|pass| {
            let radix = SortPass { shift: DIGIT_BITS * pass, args: 4 * slot as u32 };
            let radix = gpu.uniform("sort.radix", &radix)?;
            let radix = ("radix", (&radix).into());
            let [from, to] = if pass.is_multiple_of(2) { [entries, spare] } else { [spare, entries] };
            let keys = ("keys", from.keys.into());
            let scatter = [
                radix,
                lists,
                chunks,
                keys,
                ("values", from.values.into()),
                ("keys_out", to.keys.into()),
                ("values_out", to.values.into()),
            ];
            Ok([
                kernels.count.bind(gpu, &[radix, lists, keys, chunks], &[])?,
                kernels.scan.bind(gpu, &[radix, lists, chunks], &[])?,
                kernels.scatter.bind(gpu, &scatter, &[])?,
            ])
        });
        let passes = passes.collect::<Result<_, Error>>()?;
        let radix = SortPass { shift: 0, args: 4 * slot as u32 };
        let radix = gpu.uniform("sort.radix", &radix)?;
        let begin = [("radix", (&radix).into()), lists, ("tile_args", (&tile_args).into())];
        Ok(Sort { begin: kernels.begin.bind(gpu, &begin, &[])?, tile_args, passes })
    }

    /// Records the dispatches.
    pub fn record(&self, pass: &mut Pass) {
        pass.dispatch(&self.begin, 1);
        for [count, scan, scatter] in &self.passes {
            pass.dispatch_indirect(count, &self.tile_args, 0);
            pass.dispatch(scan, 1);
            pass.dispatch_indirect(scatter, &self.tile_args, 0);
        }
    }
}
