//! `forces`: u* += dt g on the faces of the liquid and v* += dt g on free components of the nodes. Prescribed
//! components are set to the prescribed velocity.

use crate::Error;
use crate::fields::{LiquidBuffers, SolidBuffers};
use crate::gpu::{Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

/// Forces on the liquid: `velocity_next` in place on the band.
pub fn forces(gpu: &Gpu, liquid: &LiquidBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Forces.name());
    let forces = Kernel::new(gpu, &wgsl!("forces"), Real::F32)?.bind(gpu, &[], &[liquid])?;
    Ok(Dispatches::new(Stage::Forces.name(), [forces.indirect(&liquid.band_args, 0)]))
}

/// Forces on the nodes of solids: `velocity` in place.
pub fn node_forces(gpu: &Gpu, solids: &SolidBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Forces.name());
    let kernel = Kernel::new(gpu, &wgsl!("node_forces"), solids.plan.real)?;
    let node_forces = kernel.bind(gpu, &[], &[solids])?;
    Ok(Dispatches::new(Stage::Forces.name(), [node_forces.threads(solids.plan.n_nodes)]))
}
