//! The system of a step on the device: levels, buffers, and the kernels that set it up from open areas and liquid distance.

use std::sync::Mutex;

use crate::Error;
use crate::fields::LiquidBuffers;
use crate::gpu::{
    Bound, Buffer, CompactKernels, Compaction, Gpu, Pass, Real, Variant, WG_SIZE, groups,
};
use crate::grid::{Grid, Padded};
use crate::scene::Precision;
use crate::step::Stage;
use crate::{arrays, wgsl};

use super::components::STATE_WORDS;
use super::host_residual::PressureReadbacks;
use super::pcg::Block;
use super::{FOLD_THREADS, Level, TAIL_LEVELS, TAIL_QUADS, bind};

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
        assert!(
            levels.len() - tail <= TAIL_LEVELS,
            "TAIL_QUADS quads are a row of less than 128 cells at most"
        );
        let mut first = Vec::new();
        let mut total = 0;
        for level in &levels {
            first.push(total);
            total += level.quads;
        }
        LevelPlan {
            levels,
            first,
            total,
            tail,
        }
    }

    /// Padded cells of the finest level.
    pub(super) fn cells(&self) -> usize {
        self.levels[0].len()
    }

    /// The uniform of a level.
    pub(super) fn level(&self, level: usize) -> Level {
        Level {
            shape: self.levels[level].layout_at(self.first[level], self.total),
            coefficient: (1u32 << level) as f32,
            args: 4 * level as u32,
            pad_0: 0,
            pad_1: 0,
        }
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
        Precision::Mixed if f64 => Variant {
            real: Real::F64,
            inner: Real::F32,
            moving_obstacles: false,
        },
        Precision::Mixed => Real::F32.into(),
        Precision::F64 => Real::F64.into(),
    }
}

/// Refuses a precision that the adapter has not.
pub(super) fn check_precision(gpu: &Gpu, precision: Precision) -> Result<(), Error> {
    // A plan is checked as a whole.
    gpu.report()
        .check_precision(precision == Precision::F64 && !gpu.is_planning())
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
            pub(super) to_host: Option<Mutex<PressureReadbacks>>,
        }
        arrays {
            /// Per quad: active lanes (bits 0-3), those in enclosed components (bits 4-7), and the uniform tag.
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
            /// Per padded cell, where [`Components`](super::Components) found enclosed ones: the scalar index of the smallest cell of
            /// its component, with the highest bit set unless the component is enclosed. Undefined in inactive quads.
            pub array labels: u32 [plan.cells()],
            /// State of that stage; its first word is the number of enclosed components.
            pub array components: u32 [STATE_WORDS],
            /// True residual, level 0, m/s.
            pub(super) real outer: (variant.real) [plan.cells()],
            /// Residual of conjugate gradients.
            pub(super) real r: (variant.inner) [4 * plan.total],
            /// Iterate of the V-cycle, and the next.
            pub(super) real z: (variant.inner) [4 * plan.total],
            pub(super) real z_next: (variant.inner) [4 * plan.total],
            /// Search direction, then correction, level 0.
            pub(super) real search: (variant.inner) [2 * plan.cells()],
            /// B s, level 0.
            pub(super) real q: (variant.inner) [plan.cells()],
            pub(super) real partials: (variant.inner) [plan.cells().max(4 * FOLD_THREADS)],
            pub(super) real outer_partials: (variant.real) [plan.cells().max(4 * FOLD_THREADS)],
            array scratch: u32 [Compaction::scratch(plan.levels[0].quads)],
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

    /// Potentials as a block of unknowns.
    pub(super) fn block(&self) -> Block<'_> {
        Block {
            level: self.plan.level(0),
            variant: self.variant,
            flags: &self.flags,
            list: &self.list,
            args: &self.args,
            x: &self.potential,
            outer: &self.outer,
            search: &self.search,
        }
    }

    /// Writes which lanes of the quads of the finest level were active in the last sub-step, before all work submitted later. The
    /// next one puts all quads back to zero, whatever else they hold.
    pub fn write_active(&self, gpu: &Gpu, grid: &Grid, flags: &[u32]) {
        gpu.upload(&self.flags, flags);
        let (list, args) = everywhere(grid);
        gpu.upload(&self.list, &list);
        gpu.upload(&self.args, &args);
    }
}

/// Quads of the finest level that may hold liquid, ascending: nothing is looked for elsewhere.
#[derive(Clone, Copy, Debug)]
pub struct Within<'a> {
    /// The quads.
    pub list: &'a Buffer<u32>,
    /// Workgroups and length of the list.
    pub args: &'a Buffer<u32>,
}

impl LiquidBuffers {
    /// The band, to which the search for active cells is limited.
    pub fn within(&self) -> Within<'_> {
        Within {
            list: &self.band_list,
            args: &self.band_args,
        }
    }
}

/// All quads with cells, and the workgroups and length of their list.
fn everywhere(grid: &Grid) -> (Vec<u32>, [u32; 4]) {
    let slab = grid.padded().stride_z as u32;
    let list: Vec<u32> = (slab..slab * (grid.cells[2] as u32 + 1)).collect();
    let n = list.len() as u32;
    let [x, y, z] = groups(n.div_ceil(WG_SIZE));
    (list, [x, y, z, n])
}

/// All quads with cells, for systems that stand alone.
#[derive(Debug)]
pub struct Everywhere {
    list: Buffer<u32>,
    args: Buffer<u32>,
}

impl Everywhere {
    /// Lists them.
    pub fn new(gpu: &Gpu, grid: &Grid) -> Result<Everywhere, Error> {
        let (list, args) = everywhere(grid);
        Ok(Everywhere {
            list: gpu.buffer_with("solver.everywhere", &list)?,
            args: gpu.buffer_with("solver.everywhere_args", &args)?,
        })
    }

    /// As [`PressureSystem::new`] takes them.
    pub fn within(&self) -> Within<'_> {
        let Everywhere { list, args } = self;
        Within { list, args }
    }
}

/// Stage `active_cells`: sets the system up from open areas and liquid distance, every step.
///
/// Flags and matrix are zero outside the lists, before and after: a step begins with putting back to zero what the lists of the
/// last one name, so its work follows the liquid, whatever state was put in place in between.
#[derive(Debug)]
pub struct PressureSystem {
    clear_system: Vec<Bound>,
    active_cells: Bound,
    coarsen: Vec<Bound>,
    compact: Vec<Compaction>,
}

/// Where the pressure is 0.
#[derive(Clone, Copy, Debug)]
pub struct FreeSurface {
    /// Smallest distance to the surface, cells.
    pub theta_floor: f64,
    /// Whether it is 0 on the planes of open sides of the domain too: those whose faces are open.
    pub open_sides: bool,
}

impl From<f64> for FreeSurface {
    /// On the surface of a liquid between walls.
    fn from(theta_floor: f64) -> FreeSurface {
        FreeSurface {
            theta_floor,
            open_sides: false,
        }
    }
}

/// The doppelganger of `ActiveSettings` in `shaders/active_cells.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ActiveSettings {
    /// Smallest theta.
    pub theta_floor: f32,
    /// 1 where sides of the domain are open.
    pub open_sides: u32,
    /// Nothing.
    pub pad_0: f32,
    /// Nothing.
    pub pad_1: f32,
}

impl PressureSystem {
    /// Compiles and binds.
    pub fn new(
        gpu: &Gpu,
        buffers: &SolverBuffers,
        open: &Buffer<f32>,
        liquid_distance: &Buffer<f32>,
        within: Within,
        free_surface: impl Into<FreeSurface>,
    ) -> Result<PressureSystem, Error> {
        let gpu = &gpu.at(Stage::ActiveCells.name());
        let FreeSurface {
            theta_floor,
            open_sides,
        } = free_surface.into();
        let SolverBuffers {
            plan,
            variant,
            flags,
            list,
            args,
            scratch,
            ..
        } = buffers;
        let inner = variant.inner;
        let levels = (0..plan.len())
            .map(|level| gpu.uniform("solver.level", &plan.level(level)))
            .collect::<Result<Vec<_>, _>>()?;
        let settings = ActiveSettings {
            theta_floor: theta_floor as f32,
            open_sides: open_sides.into(),
            pad_0: 0.0,
            pad_1: 0.0,
        };
        let settings = gpu.uniform("solver.active_settings", &settings)?;
        let clear_system = levels.iter().map(|level| {
            let own = [("level", level.into())];
            bind(gpu, &wgsl!("clear_system"), inner, own, &[buffers])
        });
        let clear_system = clear_system.collect::<Result<Vec<_>, _>>()?;
        let own = [
            ("level", (&levels[0]).into()),
            ("settings", (&settings).into()),
            ("list", within.list.into()),
            ("args", within.args.into()),
            ("liquid_distance", liquid_distance.into()),
            ("open", open.into()),
        ];
        let active_cells = bind(gpu, &wgsl!("active_cells"), inner, own, &[buffers])?;
        let coarsen = levels.windows(2).map(|pair| {
            let own = [("fine", (&pair[0]).into()), ("coarse", (&pair[1]).into())];
            bind(gpu, &wgsl!("coarsen"), inner, own, &[buffers])
        });
        let coarsen = coarsen.collect::<Result<Vec<_>, _>>()?;
        let kernels = CompactKernels::new(gpu)?;
        let compact = (0..plan.len())
            .map(|level| {
                let range = [plan.first[level], plan.levels[level].quads];
                Compaction::new(gpu, &kernels, flags, list, args, scratch, range, level)
            })
            .collect::<Result<Vec<_>, _>>()?;
        Ok(PressureSystem {
            clear_system,
            active_cells,
            coarsen,
            compact,
        })
    }

    /// Records the stage. `buffers` and `within`: those it was made with.
    pub fn record(&self, pass: &mut Pass, buffers: &SolverBuffers, within: Within) {
        for (level, clear_system) in self.clear_system.iter().enumerate() {
            pass.dispatch_indirect(clear_system, &buffers.args, level);
        }
        pass.dispatch_indirect(&self.active_cells, within.args, 0);
        for (level, compact) in self.compact.iter().enumerate() {
            if level > 0 {
                pass.dispatch_indirect(&self.coarsen[level - 1], &buffers.args, level - 1);
            }
            compact.record(pass);
        }
    }
}
