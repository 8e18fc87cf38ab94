//! `move_solid`: x = x* + dt v; nodes beyond a wall are put on it and lose their velocity into it.
//!
//! Free bodies, and those on hinges, move on circles where they turn. Walls do not stop prescribed components. Nodes inside an obstacle
//! are left to the solve.

use crate::Error;
use crate::fields::SolidBuffers;
use crate::gpu::{Dispatches, Gpu, Kernel};
use crate::step::Stage;
use crate::wgsl;

/// Threads per body that turns: `FOLD_SIZE` in `shaders/common/tree.wgsl`.
const TURNING_THREADS: usize = 256;

/// The stage: `displacement` and `velocity` in place, by the velocity of the last sub-step.
///
/// # Errors
/// As [`Kernel::new`] and [`Kernel::bind_arrays`].
pub fn move_solid(gpu: &Gpu, solids: &SolidBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::MoveSolid.name());
    let bound = |source| Kernel::new(gpu, &source, solids.plan.real)?.bind_arrays(gpu, &[solids]);
    let mut list = Vec::new();
    if solids.plan.n_turning > 0 {
        // A workgroup each.
        list.push(bound(wgsl!("turn_solids"))?.threads(TURNING_THREADS * solids.plan.n_turning));
    }
    list.push(bound(wgsl!("move_solid"))?.threads(solids.plan.n_nodes));
    Ok(Dispatches::new(Stage::MoveSolid.name(), list))
}
