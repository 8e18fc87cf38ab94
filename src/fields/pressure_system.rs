//! Arrays of the pressure's system, with the levels of its hierarchy.

use std::sync::Mutex;

use crate::Error;
use crate::arrays;
use crate::gpu::{Compaction, Gpu, Readback, Real, Variant, WG_SIZE, groups};
use crate::grid::{Grid, Padded};
use crate::scene::Precision;
use crate::state::State;

/// Largest number of quads, spare ones counted, of the levels that one workgroup handles; `vcycle_tail.wgsl` has it too.
pub(crate) const TAIL_QUADS: usize = 256;
/// Most levels in the tail.
pub(crate) const TAIL_LEVELS: usize = 8;
/// Threads of the first level of a long sum; `fold_partials.wgsl` and `separation_openings.wgsl` have it too.
pub(crate) const FOLD_THREADS: usize = 4096;
/// Words of [`SolverBuffers::components`].
pub(crate) const STATE_WORDS: usize = 8;
/// Word with the number of closed components; `shaders/common/components.wgsl` names the words.
pub(crate) const N_CLOSED: usize = 0;
/// Bit of `flags` of the first lane in a ballistic component.
pub(crate) const BALLISTIC: usize = 20;
/// Bit of `flags` of the first filled lane.
pub(crate) const FILLED: usize = 24;

/// The levels of the hierarchy and where they lie: a function of the grid alone.
#[derive(Clone, Debug)]
pub struct LevelPlan {
    /// Layout of each level, the finest first.
    pub levels: Vec<Padded>,
    /// First quad of each level in arrays of all levels.
    pub first: Vec<usize>,
    /// Quads of all levels.
    pub total: usize,
    /// First level that the one-workgroup tail handles.
    pub tail: usize,
}

impl LevelPlan {
    /// Halves the cells until one is left.
    pub fn new(grid: &Grid) -> LevelPlan {
        let mut levels = vec![grid.padded()];
        // One level at least is coarse: the finest never belongs to the tail.
        while levels.len() == 1 || levels[levels.len() - 1].cells != [1; 3] {
            let last = levels[levels.len() - 1];
            levels.push(Padded::new(last.cells.map(|n| n.div_ceil(2))));
        }
        let tail = 1 + levels[1..]
            .iter()
            .position(|level| level.quads <= TAIL_QUADS)
            .expect("a level of one cell fits the tail");
        assert!(levels.len() - tail <= TAIL_LEVELS, "TAIL_QUADS quads are a row of less than 128 cells at most");
        let mut first = Vec::new();
        let mut total = 0;
        for level in &levels {
            first.push(total);
            total += level.quads;
        }
        LevelPlan { levels, first, total, tail }
    }

    /// Padded cells of the finest level.
    pub(crate) fn cells(&self) -> usize {
        self.levels[0].len()
    }

    /// Number of levels.
    pub fn len(&self) -> usize {
        self.levels.len()
    }

    /// Whether there are none; never.
    pub fn is_empty(&self) -> bool {
        self.levels.is_empty()
    }

    /// Whether sums take two levels: one workgroup alone would be slow on a wide device.
    pub fn long_sums(&self) -> bool {
        self.levels[0].quads > 4 * FOLD_THREADS
    }
}

/// The scalar types of a precision on an adapter with or without f64. Without it the outer loop of `mixed` runs on the host.
pub fn variant(f64: bool, precision: Precision) -> Variant {
    match precision {
        Precision::F32 => Real::F32.into(),
        Precision::Mixed if f64 => Variant { real: Real::F64, inner: Real::F32, moving_obstacles: false },
        Precision::Mixed => Real::F32.into(),
        Precision::F64 => Real::F64.into(),
    }
}

/// Refuses a precision that the adapter has not.
pub(crate) fn check_precision(gpu: &Gpu, precision: Precision) -> Result<(), Error> {
    // A plan is checked as a whole.
    gpu.report().check_precision(precision == Precision::F64 && !gpu.is_planning())
}

arrays! {
    /// The pressure's system on the device; all levels one after another unless said otherwise.
    pub struct SolverBuffers in "solver" {
        fields {
            /// The levels.
            pub plan: LevelPlan,
            /// Scalar types.
            pub variant: Variant,
            /// Level 0 on the host, where the device rounds the residual.
            pub(crate) to_host: Option<Mutex<PressureReadbacks>>,
        }
        arrays {
            /// Per quad: active lanes (bits 0-3), those in enclosed components (bits 4-7), further ones
            /// (`common/active.wgsl`), and the uniform tag.
            pub array flags: u32 [plan.total],
            /// Active quads per level, tagged.
            pub array list: u32 [plan.total],
            /// Dispatch size and length of each level's list; after them the length of folded partials.
            pub array args: u32 [4 * (plan.len() + 1)],
            /// Weights of the minus faces along x, y, z; free-surface term; reciprocal diagonal: five sections, dimensionless.
            pub real matrix: (variant.inner) [5 * 4 * plan.total],
            /// Right-hand side b, level 0, m/s.
            pub real rhs: (variant.real) [plan.cells()],
            /// Potential phi, level 0, m/s; undefined in inactive quads.
            pub real potential: (variant.real) [plan.cells()],
            /// Per padded cell, where the stage `closed_components` found enclosed ones: the scalar index of the smallest cell of
            /// its component, with the highest bit set unless the component is enclosed. Undefined in inactive quads.
            pub array labels: u32 [plan.cells()],
            /// State of that stage; its first word is the number of enclosed components.
            pub array components: u32 [STATE_WORDS],
            /// True residual, level 0, m/s.
            pub(crate) real outer: (variant.real) [plan.cells()],
            /// Residual of conjugate gradients.
            pub(crate) real r: (variant.inner) [4 * plan.total],
            /// Iterate of the V-cycle, and the next.
            pub(crate) real z: (variant.inner) [4 * plan.total],
            pub(crate) real z_next: (variant.inner) [4 * plan.total],
            /// Search direction, then correction, level 0.
            pub(crate) real search: (variant.inner) [2 * plan.cells()],
            /// B s, level 0.
            pub(crate) real q: (variant.inner) [plan.cells()],
            pub(crate) real partials: (variant.inner) [plan.cells().max(4 * FOLD_THREADS)],
            pub(crate) real outer_partials: (variant.real) [plan.cells().max(4 * FOLD_THREADS)],
            pub(crate) array scratch: u32 [Compaction::scratch(plan.levels[0].quads)],
        }
        views { q_in = q, q_out = q, state = components }
        parts {}
    }
}

impl SolverBuffers {
    /// Allocates for a grid.
    ///
    /// # Errors
    /// [`Error::Limit`] where the adapter is too small, or has no f64 and the precision needs it.
    pub fn new(gpu: &Gpu, grid: &Grid, precision: Precision) -> Result<SolverBuffers, Error> {
        check_precision(gpu, precision)?;
        let plan = LevelPlan::new(grid);
        let variant = variant(gpu.has_f64(), precision);
        let to_host = (variant.real == Real::F32)
            .then(|| PressureReadbacks::new(gpu, plan.levels[0].quads).map(Mutex::new))
            .transpose()?;
        // Empty lists; sums of two levels end with a fixed number of partials, which the last entry contains.
        let mut args = vec![0; 4 * (plan.len() + 1)];
        args[4 * plan.len() + 3] = FOLD_THREADS as u32;
        let buffers = SolverBuffers::allocate(gpu, plan, variant, to_host)?;
        gpu.upload(&buffers.args, &args);
        Ok(buffers)
    }

    /// Writes which cells were active, filled and ballistic in a state, before all work submitted later. The next sub-step puts
    /// all quads back to zero, whatever else they hold.
    pub fn write_active(&self, gpu: &Gpu, grid: &Grid, state: &State) {
        let (filled, ballistic) = (state.filled(), &state.ballistic);
        let padded = grid.padded();
        let mut flags = vec![0; padded.quads];
        for (cell, &active) in state.active.iter().enumerate() {
            let index = padded.index(grid.cell_at(cell));
            let bit = |set: bool, first: usize| u32::from(set) << first;
            let bits = bit(active, 0) | bit(ballistic[cell], BALLISTIC) | bit(filled[cell], FILLED);
            flags[index / 4] |= bits << (index % 4);
        }
        gpu.upload(&self.flags, &flags);
        let (list, args) = everywhere(grid);
        gpu.upload(&self.list, &list);
        gpu.upload(&self.args, &args);
    }
}

/// All quads with cells, and the workgroups and length of their list.
pub(crate) fn everywhere(grid: &Grid) -> (Vec<u32>, [u32; 4]) {
    let slab = grid.padded().stride_z as u32;
    let list: Vec<u32> = (slab..slab * (grid.cells[2] as u32 + 1)).collect();
    let n = list.len() as u32;
    let [x, y, z] = groups(n.div_ceil(WG_SIZE));
    (list, [x, y, z, n])
}

/// Read-backs of level 0 of the stored system, in f32.
#[derive(Debug)]
pub(crate) struct PressureReadbacks {
    /// Weights of the minus faces along x, y, z, and the free-surface term.
    pub(crate) matrix: [Readback<u32>; 4],
    pub(crate) flags: Readback<u32>,
    pub(crate) rhs: Readback<u32>,
    pub(crate) labels: Readback<u32>,
}

impl PressureReadbacks {
    pub(crate) fn new(gpu: &Gpu, quads: usize) -> Result<PressureReadbacks, Error> {
        let section = || Readback::new(gpu, "solver.matrix", 4 * quads);
        Ok(PressureReadbacks {
            matrix: [section()?, section()?, section()?, section()?],
            flags: Readback::new(gpu, "solver.flags", quads)?,
            rhs: Readback::new(gpu, "solver.rhs", 4 * quads)?,
            labels: Readback::new(gpu, "solver.labels", 4 * quads)?,
        })
    }
}
