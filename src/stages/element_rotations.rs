//! `solid_matrices`, first part: what the elements make of the displacements. Rotations, rotated gradients, elastic forces and
//! energies; the rows of the system are gathered from them in [`crate::solver`].

use crate::Error;
use crate::gpu::{Bound, Gpu, Kernel, Pass};
use crate::wgsl;

use super::SolidBuffers;

/// The part: `displacement` to `rotated` and `element_forces`.
#[derive(Debug)]
pub struct ElementRotations {
    n_elements: usize,
    element_rotations: Bound,
}

impl ElementRotations {
    /// The name of the stage that it is part of.
    pub const NAME: &'static str = "solid_matrices";

    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(gpu: &Gpu, solids: &SolidBuffers) -> Result<ElementRotations, Error> {
        let kernel = Kernel::new(gpu, &wgsl!("element_rotations"), solids.plan.real)?;
        let element_rotations = kernel.bind(
            gpu,
            &[
                ("step", (&solids.step).into()),
                ("elements", (&solids.elements).into()),
                ("displacement", (&solids.displacement).into()),
                ("rest_gradients", (&solids.rest_gradients).into()),
                ("damping", (&solids.damping).into()),
                ("rotated", (&solids.rotated).into()),
                ("element_forces", (&solids.element_forces).into()),
            ],
        )?;
        Ok(ElementRotations {
            n_elements: solids.plan.n_elements,
            element_rotations,
        })
    }

    /// Records it in the pass of the stage.
    pub fn dispatch(&self, pass: &mut Pass) {
        pass.dispatch(&self.element_rotations, self.n_elements);
    }
}
