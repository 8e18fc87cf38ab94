//! Deterministic, stable sort of u32 keys, each with a u32 value: least significant digit first, four bits a pass. The length
//! of the list is read on the device.
//!
//! A pass counts the digits of each tile of [`TILE`] entries, scans the counts in one workgroup and scatters. Only integers are
//! added by atomics, so the result is a function of the list alone.

use super::{Bound, Buffer, BufferPlan, Gpu, Kernel, Pass, Real};
use crate::Error;

/// Entries that one workgroup handles; `common/sort.wgsl` has the same constant.
pub const TILE: usize = 1024;
/// Bits of a digit, and the values that it can have: likewise.
const DIGIT_BITS: u32 = 4;
const DIGITS: usize = 1 << DIGIT_BITS;

/// The kernels; one set serves any number of [`Sort`]s.
#[derive(Debug)]
pub struct SortKernels {
    begin: Kernel,
    count: Kernel,
    scan: Kernel,
    scatter: Kernel,
}

impl SortKernels {
    /// Compiles them.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu) -> Result<SortKernels, Error> {
        Ok(SortKernels {
            begin: Kernel::new(gpu, &crate::wgsl!("sort_begin"), Real::F32)?,
            count: Kernel::new(gpu, &crate::wgsl!("sort_count"), Real::F32)?,
            scan: Kernel::new(gpu, &crate::wgsl!("sort_scan"), Real::F32)?,
            scatter: Kernel::new(gpu, &crate::wgsl!("sort_scatter"), Real::F32)?,
        })
    }
}

/// What a pass is told: `SortPass` in `common/sort.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct SortPass {
    /// Lowest bit of its digit.
    pub shift: u32,
    /// First word of the list's arguments, whose fourth is its length.
    pub args: u32,
}

/// Keys and values of a list, `entries` long at most.
#[derive(Clone, Copy, Debug)]
pub struct Entries<'a> {
    /// What is sorted by.
    pub keys: &'a Buffer<u32>,
    /// What goes with the keys.
    pub values: &'a Buffer<u32>,
}

/// A list to be sorted in place.
#[derive(Debug)]
pub struct Sort {
    tile_args: Buffer<u32>,
    begin: Bound,
    passes: Vec<[Bound; 3]>,
}

impl Sort {
    /// The scratch buffer that a sort of at most `n` entries needs beside room for a second list; sorts that run in order may
    /// share both.
    pub fn scratch(label: &'static str, n: usize) -> BufferPlan {
        BufferPlan::of::<u32>(label, DIGITS * n.div_ceil(TILE))
    }

    /// Binds a sort of the list in `entries` by the lowest `bits` of its keys, rounded up to whole bytes. Its length stands in
    /// `args`, the fourth word of the slot given, and is at most that of the four buffers. `spare`: room for a second list,
    /// overwritten.
    ///
    /// # Errors
    /// [`Error::Limit`] or [`Error::Gpu`].
    ///
    /// # Panics
    /// When the buffers' lengths differ, or there are more than 32 bits.
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
        // There and back again: two digits, a byte.
        let passes = (0..2 * bits.div_ceil(8)).map(|pass| {
            let radix = SortPass {
                shift: DIGIT_BITS * pass,
                args: 4 * slot as u32,
            };
            let radix = gpu.uniform("sort.radix", &radix)?;
            let radix = ("radix", (&radix).into());
            let [from, to] = if pass.is_multiple_of(2) {
                [entries, spare]
            } else {
                [spare, entries]
            };
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
                kernels.count.bind(gpu, &[radix, lists, keys, chunks])?,
                kernels.scan.bind(gpu, &[radix, lists, chunks])?,
                kernels.scatter.bind(gpu, &scatter)?,
            ])
        });
        let passes = passes.collect::<Result<_, Error>>()?;
        let radix = SortPass {
            shift: 0,
            args: 4 * slot as u32,
        };
        let radix = gpu.uniform("sort.radix", &radix)?;
        let begin = [
            ("radix", (&radix).into()),
            lists,
            ("tile_args", (&tile_args).into()),
        ];
        Ok(Sort {
            begin: kernels.begin.bind(gpu, &begin)?,
            tile_args,
            passes,
        })
    }

    /// Records its dispatches.
    pub fn record(&self, pass: &mut Pass) {
        pass.dispatch(&self.begin, 1);
        for [count, scan, scatter] in &self.passes {
            pass.dispatch_indirect(count, &self.tile_args, 0);
            pass.dispatch(scan, 1);
            pass.dispatch_indirect(scatter, &self.tile_args, 0);
        }
    }
}
