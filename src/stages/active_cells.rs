//! Stage `active_cells`: the pressure's system from face apertures and liquid distance.

use crate::Error;
use crate::fields::{LiquidBuffers, SolverBuffers, everywhere};
use crate::gpu::{Bound, Buffer, CompactKernels, Compaction, Gpu, Pass, bind};
use crate::grid::Grid;
use crate::scene::ThetaFloor;
use crate::step::Stage;
use crate::wgsl;

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
        Within { list: &self.band_list, args: &self.band_args }
    }
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

/// Surfaces of zero pressure.
#[derive(Clone, Copy, Debug)]
pub struct FreeSurface {
    /// Smallest distance to the surface, cells.
    pub theta_floor: ThetaFloor,
    /// Whether it is 0 on the planes of open sides of the domain too: those whose faces are open.
    pub open_sides: bool,
}

impl<Floor: Into<ThetaFloor>> From<Floor> for FreeSurface {
    /// On the surface of a liquid between walls.
    fn from(theta_floor: Floor) -> FreeSurface {
        FreeSurface { theta_floor: theta_floor.into(), open_sides: false }
    }
}

/// Settings of the stage.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ActiveSettings {
    /// Smallest theta, as [`ThetaFloor::whole`].
    pub theta_floor: f32,
    /// As [`ThetaFloor::closing`].
    pub closing_theta_floor: f32,
    /// 1 where sides of the domain are open.
    pub open_sides: u32,
    /// Nothing.
    pub pad: f32,
}

impl From<FreeSurface> for ActiveSettings {
    fn from(FreeSurface { theta_floor, open_sides }: FreeSurface) -> ActiveSettings {
        ActiveSettings {
            theta_floor: theta_floor.whole as f32,
            closing_theta_floor: theta_floor.closing as f32,
            open_sides: open_sides.into(),
            pad: 0.0,
        }
    }
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
        let SolverBuffers { plan, variant, flags, list, args, scratch, .. } = buffers;
        let inner = variant.inner;
        let levels = (0..plan.len())
            .map(|level| gpu.uniform("solver.level", &plan.level(level)))
            .collect::<Result<Vec<_>, _>>()?;
        let settings = gpu.uniform("solver.active_settings", &ActiveSettings::from(free_surface.into()))?;
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
        Ok(PressureSystem { clear_system, active_cells, coarsen, compact })
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
