//! The system of a step on the device: levels, buffers, and the kernels that set it up from open areas and liquid distance.

use std::sync::Mutex;

use crate::Error;
use crate::fields::LiquidBuffers;
use crate::gpu::{
    Arrays, Binding, Bound, Buffer, CompactKernels, Compaction, Gpu, Kernel, Pass, Real,
    RealBuffer, Variant, WG_SIZE, groups,
};
use crate::grid::{Grid, Padded};
use crate::scene::Precision;
use crate::step::Stage;

use super::components::STATE_WORDS;
use super::host_residual::PressureReadbacks;
use super::{FOLD_THREADS, Level, TAIL_LEVELS, TAIL_QUADS};

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

/// The solver's data on the device; all levels one after another unless said otherwise.
#[derive(Debug)]
pub struct SolverBuffers {
    /// The levels.
    pub plan: LevelPlan,
    /// Scalar types.
    pub variant: Variant,
    /// Per quad: active lanes (bits 0-3), those in closed components (bits 4-7), and the uniform tag.
    pub flags: Buffer<u32>,
    /// Active quads per level, tagged.
    pub list: Buffer<u32>,
    /// Dispatch size and length of each level's list; after them the length of folded partials.
    pub args: Buffer<u32>,
    /// Weights of the minus faces along x, y, z; free-surface term; reciprocal diagonal: five sections, dimensionless.
    pub matrix: RealBuffer,
    /// Right-hand side b, level 0, m/s.
    pub rhs: RealBuffer,
    /// Potential phi, level 0, m/s. What inactive quads hold means nothing.
    pub potential: RealBuffer,
    /// Per padded cell, where [`Components`](super::Components) found closed ones: the scalar index of the smallest cell of
    /// its component, with the highest bit set unless the component is closed. What inactive quads hold means nothing.
    pub labels: Buffer<u32>,
    /// State of that stage; its first word is the number of closed components.
    pub components: Buffer<u32>,
    pub(super) outer: RealBuffer,
    pub(super) r: RealBuffer,
    pub(super) z: RealBuffer,
    pub(super) z_next: RealBuffer,
    pub(super) search: RealBuffer,
    pub(super) q: RealBuffer,
    pub(super) partials: RealBuffer,
    pub(super) outer_partials: RealBuffer,
    scratch: Buffer<u32>,
    /// Where the system arrives on the host, if residuals are not evaluated in f64 on the device.
    pub(super) to_host: Option<Mutex<PressureReadbacks>>,
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
        let (cells, total) = (plan.levels[0].len(), 4 * plan.total);
        let partials = cells.max(4 * FOLD_THREADS);
        let words = |label: &str, len| gpu.buffer(label, len);
        let inner = |label: &str, len| RealBuffer::new(gpu, label, len, variant.inner);
        let real = |label: &str, len| RealBuffer::new(gpu, label, len, variant.real);
        // Empty lists; sums of two levels end with a fixed number of partials, which the last entry holds.
        let mut args = vec![0; 4 * (plan.len() + 1)];
        args[4 * plan.len() + 3] = FOLD_THREADS as u32;
        Ok(SolverBuffers {
            flags: words("solver.flags", plan.total)?,
            list: words("solver.list", plan.total)?,
            args: gpu.buffer_with("solver.args", &args)?,
            matrix: inner("solver.matrix", 5 * total)?,
            rhs: real("solver.rhs", cells)?,
            potential: real("solver.potential", cells)?,
            labels: words("solver.labels", cells)?,
            components: words("solver.components", STATE_WORDS)?,
            outer: real("solver.outer", cells)?,
            r: inner("solver.r", total)?,
            z: inner("solver.z", total)?,
            z_next: inner("solver.z_next", total)?,
            search: inner("solver.search", 2 * cells)?,
            q: inner("solver.q", cells)?,
            partials: inner("solver.partials", partials)?,
            outer_partials: real("solver.outer_partials", partials)?,
            scratch: words("solver.scratch", Compaction::scratch(plan.levels[0].quads))?,
            to_host: (variant.real == Real::F32)
                .then(|| PressureReadbacks::new(gpu, plan.levels[0].quads).map(Mutex::new))
                .transpose()?,
            plan,
            variant,
        })
    }
}

impl Arrays for SolverBuffers {
    fn array(&self, name: &str) -> Option<Binding<'_>> {
        Some(match name {
            "flags" => (&self.flags).into(),
            "list" => (&self.list).into(),
            "args" => (&self.args).into(),
            "matrix" => (&self.matrix).into(),
            "rhs" => (&self.rhs).into(),
            "potential" => (&self.potential).into(),
            "labels" => (&self.labels).into(),
            _ => return None,
        })
    }
}

impl SolverBuffers {
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
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
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
    ///
    /// # Errors
    /// As [`Kernel::new`].
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
            matrix,
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
        let kernel = Kernel::new(gpu, &crate::wgsl!("clear_system"), inner)?;
        let clear_system = levels
            .iter()
            .map(|level| {
                kernel.bind(
                    gpu,
                    &[
                        ("level", level.into()),
                        ("list", list.into()),
                        ("args", args.into()),
                        ("flags", flags.into()),
                        ("matrix", matrix.into()),
                    ],
                )
            })
            .collect::<Result<Vec<_>, _>>()?;
        let active_cells = Kernel::new(gpu, &crate::wgsl!("active_cells"), inner)?.bind(
            gpu,
            &[
                ("level", (&levels[0]).into()),
                ("settings", (&settings).into()),
                ("list", within.list.into()),
                ("args", within.args.into()),
                ("liquid_distance", liquid_distance.into()),
                ("open", open.into()),
                ("flags", flags.into()),
                ("matrix", matrix.into()),
            ],
        )?;
        let kernel = Kernel::new(gpu, &crate::wgsl!("coarsen"), inner)?;
        let coarsen = levels
            .windows(2)
            .map(|pair| {
                kernel.bind(
                    gpu,
                    &[
                        ("fine", (&pair[0]).into()),
                        ("coarse", (&pair[1]).into()),
                        ("list", list.into()),
                        ("args", args.into()),
                        ("flags", flags.into()),
                        ("matrix", matrix.into()),
                    ],
                )
            })
            .collect::<Result<Vec<_>, _>>()?;
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
