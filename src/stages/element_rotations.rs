//! `solid_matrices`, first part: rotations of the elements, rotated gradients, elastic forces and energies.
//! [`crate::solver`] assembles the rows of the system from them.

use crate::Error;
use crate::fields::SolidBuffers;
use crate::gpu::{Dispatches, Gpu, Kernel};
use crate::step::Stage;
use crate::wgsl;

/// The part: `displacement` to `rotated` and `element_forces`.
pub fn element_rotations(gpu: &Gpu, solids: &SolidBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::SolidMatrices.name());
    let kernel = Kernel::new(gpu, &wgsl!("element_rotations"), solids.plan.real)?;
    let element_rotations = kernel.bind(gpu, &[], &[solids])?;
    Ok(Dispatches::new(Stage::SolidMatrices.name(), [element_rotations.threads(solids.plan.n_elements)]))
}
