//! Whether this machine has room for a scene, before anything of the grid's size is allocated.

use crate::Error;
use crate::elastic::Solids;
use crate::geometry;
use crate::gpu::AdapterReport;
use crate::scene::Scene;

/// Bytes per cell of the grid that the host holds while a simulation is set up, at the least: measured as the largest resident set
/// at 128^3 and 192^3 cells, 117 and 119 with `--backend cpu`, 40 to 55 on a device; and per marker, 54.
const PER_CELL_CPU: u64 = 110;
const PER_CELL_GPU: u64 = 35;
const PER_MARKER: u64 = 48;

/// What a scene takes of this machine's memory at the least, and what there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostMemory {
    /// Bytes that the scene takes.
    pub needed: u64,
    /// What there is: [`free_memory`].
    pub available: u64,
}

impl HostMemory {
    /// Of a scene on the CPU, or on a device with memory of its own.
    ///
    /// # Errors
    /// [`Error::Input`] where a mesh file cannot be used.
    pub fn new(scene: &Scene, solids: &Solids, on_cpu: bool) -> Result<HostMemory, Error> {
        let grid = scene.grid();
        let (displacement, _) = solids.initial_state(scene);
        let markers =
            geometry::estimate_markers(scene, &grid, &solids.moved(&displacement))? as u64;
        let per_cell = if on_cpu { PER_CELL_CPU } else { PER_CELL_GPU };
        Ok(HostMemory {
            needed: grid.n_cells() as u64 * per_cell + markers * PER_MARKER,
            available: free_memory(),
        })
    }

    /// With the buffers of an adapter that has no memory of its own, bytes.
    pub fn beside(self, buffers: u64, adapter: &AdapterReport) -> HostMemory {
        match adapter.kind {
            "software" => HostMemory {
                needed: self.needed + buffers,
                ..self
            },
            _ => self,
        }
    }

    /// # Errors
    /// [`Error::Memory`] where there is less than the scene takes.
    pub fn check(self) -> Result<(), Error> {
        if self.needed <= self.available {
            return Ok(());
        }
        Err(Error::Memory {
            needed: self.needed,
            available: self.available,
            cure: "use fewer cells (--scale), or a machine with more memory".to_owned(),
        })
    }
}

/// Bytes that this machine, or the container, has left; swap counts.
pub fn free_memory() -> u64 {
    let mut system = sysinfo::System::new();
    system.refresh_memory();
    let available = system.available_memory() + system.free_swap();
    let limits = system.cgroup_limits();
    limits.map_or(available, |limits| {
        available.min(limits.free_memory + limits.free_swap)
    })
}
