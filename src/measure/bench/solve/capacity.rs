//! Room for a grid on an adapter and this machine, checked before any allocation of its size.

use crate::Error;
use crate::fields::SolverBuffers;
use crate::gpu::{AdapterReport, BufferPlan, Gpu};
use crate::grid::Grid;
use crate::scene::Solver;
use crate::sim::{HostMemory, free_memory};
use crate::solver::PressureSolver;
use crate::stages::{Components, PressureSystem, Within};

/// Largest number of cells along an edge of the base block: 2^30 in all, as in a scene.
pub const LARGEST_GRID: usize = 1024;
/// The search for the largest grid uses multiples of it.
const STEP: usize = 10;

/// Least bytes per cell on the host during the set-up of the device, in f64: 7 numbers of the block (apertures, velocities, distance), twice with a
/// beam, 11 of clipping, 7 of stencil and right-hand sides, 5 of the state, 2 of uploads.
pub const PER_CELL: u64 = 8 * (14 + 11 + 7 + 5 + 2);

/// Cells along an edge of the largest base block that fits on the adapter and this machine with any of these solvers: a multiple of 10. Memory of solvers on
/// the CPU is not included.
///
/// # Errors
/// [`Error::Limit`] and [`Error::Memory`] if 10 cells do not fit.
pub fn largest_grid(adapter: &AdapterReport, solvers: &[Solver]) -> Result<usize, Error> {
    let mut capacity = Capacity::new(adapter);
    // The bench checks again when it begins; other programs may use some memory until then.
    capacity.memory = capacity.memory / 10 * 9;
    capacity.check(STEP, solvers)?;
    Ok(capacity.largest(solvers).unwrap_or(STEP))
}

/// Room of an adapter and this machine.
#[derive(Clone, Copy, Debug)]
pub struct Capacity<'a> {
    /// Adapter.
    pub adapter: &'a AdapterReport,
    /// Free bytes of this machine.
    pub memory: u64,
}

impl<'a> Capacity<'a> {
    /// Room now.
    pub fn new(adapter: &'a AdapterReport) -> Capacity<'a> {
        Capacity { adapter, memory: free_memory() }
    }

    /// Refuses a grid that is too large; the cure names the largest that fits.
    ///
    /// # Errors
    /// [`Error::Limit`], [`Error::Memory`].
    pub fn check(self, grid: usize, solvers: &[Solver]) -> Result<(), Error> {
        let mut checked = self.fits(grid, solvers);
        if let Err(Error::Limit { cure, .. } | Error::Memory { cure, .. }) = &mut checked {
            let smaller = |largest| format!("give grids of at most {largest} cells (--grids max), or ");
            let smaller = self.largest(solvers).map_or(String::new(), smaller);
            *cure = format!("{smaller}use another adapter (--adapter) or machine");
        }
        checked
    }

    /// Cells along an edge of the largest block that fits.
    pub fn largest(self, solvers: &[Solver]) -> Option<usize> {
        let mut grids = (1..=LARGEST_GRID / STEP).rev().map(|n| n * STEP);
        grids.find(|&grid| self.fits(grid, solvers).is_ok())
    }

    fn fits(self, grid: usize, solvers: &[Solver]) -> Result<(), Error> {
        solvers.iter().try_for_each(|solver| {
            let plans = buffers(grid, solver, self.adapter)?;
            for plan in &plans {
                self.adapter.check_buffer(&plan.label, plan.bytes())?;
            }
            let memory = HostMemory { needed: PER_CELL * (grid as u64).pow(3), available: self.memory };
            memory.beside(plans.iter().map(BufferPlan::bytes).sum(), self.adapter).check()
        })
    }
}

/// All buffers of a bench of the pressure on an adapter.
fn buffers(grid: usize, solver: &Solver, adapter: &AdapterReport) -> Result<Vec<BufferPlan>, Error> {
    let grid = Grid { cells: [grid; 3], dx: 1.0 / grid as f64 };
    let gpu = Gpu::planning(adapter.clone());
    let n = grid.padded().len();
    let (open, velocity) = (gpu.buffer("bench.open", 3 * n)?, gpu.buffer("bench.velocity", 3 * n)?);
    let distance = gpu.buffer("bench.liquid_distance", n)?;
    let buffers = SolverBuffers::new(&gpu, &grid, solver.precision)?;
    let (list, args) = (gpu.buffer("bench.list", 0)?, gpu.buffer("bench.args", 4)?);
    PressureSystem::new(&gpu, &buffers, &open, &distance, Within { list: &list, args: &args }, solver.theta_floor)?;
    Components::new(&gpu, &buffers, false)?;
    PressureSolver::new(&gpu, &buffers, &velocity, &open, solver)?;
    Ok(gpu.buffer_plans())
}
