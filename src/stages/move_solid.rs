//! `move_solid`: x = x* + dt v. Nodes that penetrate a wall are projected onto it and lose their velocity into it.
//!
//! Nodes of free and hinged bodies move on circles. Walls do not stop prescribed components. The solve pushes nodes
//! out of obstacles.

use crate::Error;
use crate::fields::SolidBuffers;
use crate::gpu::{Dispatches, Gpu, Kernel};
use crate::step::Stage;
use crate::wgsl;

/// Threads per body: `FOLD_SIZE` in `shaders/common/tree.wgsl`.
pub(super) const BODY_THREADS: usize = 256;

/// The stage: updates `displacement` and `velocity` by the velocity of the last sub-step.
pub fn move_solid(gpu: &Gpu, solids: &SolidBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::MoveSolid.name());
    let bound = |source| Kernel::new(gpu, &source, solids.plan.real)?.bind(gpu, &[], &[solids]);
    let mut list = Vec::new();
    if solids.plan.n_turning > 0 {
        // One workgroup per body.
        list.push(bound(wgsl!("turn_solids"))?.threads(BODY_THREADS * solids.plan.n_turning));
    }
    list.push(bound(wgsl!("move_solid"))?.threads(solids.plan.n_nodes));
    Ok(Dispatches::new(Stage::MoveSolid.name(), list))
}
