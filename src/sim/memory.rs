//! Checks host memory before any allocation of the grid's size.

use crate::Error;
use crate::effects::Effects;
use crate::elastic::Solids;
use crate::geometry;
use crate::gpu::AdapterReport;
use crate::scene::Scene;

/// Lower bounds of host memory during set-up, bytes per cell and per marker. Largest resident sets at 128^3 and 192^3
/// cells were 117 and 119 with `--backend cpu`, 40 to 55 on a device, and 54 per marker.
const PER_CELL_CPU: u64 = 110;
const PER_CELL_GPU: u64 = 35;
const PER_MARKER: u64 = 48;

/// Host memory of a scene, and free memory of this machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostMemory {
    /// Lower bound of the scene's memory, bytes.
    pub needed: u64,
    /// Free memory, bytes: [`free_memory`].
    pub available: u64,
}

impl HostMemory {
    /// Memory of a scene on the CPU, or on a device with its own memory.
    pub fn new(scene: &Scene, solids: &Solids, on_cpu: bool) -> Result<HostMemory, Error> {
        let grid = scene.grid();
        let (displacement, _) = solids.initial_state(scene);
        // The state of a level has markers in its band alone.
        let markers = match Effects::of(scene).level {
            true => 0,
            false => geometry::estimate_markers(scene, &grid, &solids.moved(&displacement))? as u64,
        };
        let per_cell = if on_cpu { PER_CELL_CPU } else { PER_CELL_GPU };
        Ok(HostMemory { needed: grid.n_cells() as u64 * per_cell + markers * PER_MARKER, available: free_memory() })
    }

    /// Adds the buffers of an adapter without its own memory, bytes.
    pub fn beside(self, buffers: u64, adapter: &AdapterReport) -> HostMemory {
        match adapter.kind {
            "software" => HostMemory { needed: self.needed + buffers, ..self },
            _ => self,
        }
    }

    /// Returns an error when the scene needs more than the free memory.
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

/// Free memory of this machine or its container, including swap, bytes.
pub fn free_memory() -> u64 {
    let mut system = sysinfo::System::new();
    system.refresh_memory();
    let available = system.available_memory() + system.free_swap();
    let limits = system.cgroup_limits();
    limits.map_or(available, |limits| available.min(limits.free_memory + limits.free_swap))
}
