//! `diagnose`, for solids: momentum, angular momentum, energies, largest speed, worst element.
//!
//! Determinants and elastic energies are those that `solid_matrices` found for the same displacements. A fixed number of threads
//! adds fixed shares of the nodes and elements, one workgroup adds their sums in a tree: sums repeat bit for bit.

use crate::Error;
use crate::gpu::{Bound, Gpu, Kernel, Recorder};
use crate::wgsl;

use super::{Diagnose, SolidBuffers};

/// The stage for solids: nodes and elements to their report.
#[derive(Debug)]
pub struct DiagnoseSolid {
    n_threads: usize,
    measure_solid: Bound,
    report_solid: Bound,
}

impl DiagnoseSolid {
    /// The stage's name.
    pub const NAME: &'static str = Diagnose::NAME;

    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(gpu: &Gpu, solids: &SolidBuffers) -> Result<DiagnoseSolid, Error> {
        let kernel = |source| Kernel::new(gpu, &source, solids.plan.real);
        let partials = ("partials", (&solids.partials).into());
        let extremes = ("extremes", (&solids.extremes).into());
        Ok(DiagnoseSolid {
            n_threads: solids.plan.n_summing(),
            measure_solid: kernel(wgsl!("measure_solid"))?.bind(
                gpu,
                &[
                    ("step", (&solids.step).into()),
                    ("rest", (&solids.rest).into()),
                    ("displacement", (&solids.displacement).into()),
                    ("velocity", (&solids.velocity).into()),
                    ("rotated", (&solids.rotated).into()),
                    ("element_forces", (&solids.element_forces).into()),
                    partials,
                    extremes,
                ],
            )?,
            report_solid: kernel(wgsl!("report_solid"))?.bind(
                gpu,
                &[partials, extremes, ("report", (&solids.report).into())],
            )?,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder, solids: &SolidBuffers) {
        recorder.clear(&solids.extremes);
        recorder.stage(DiagnoseSolid::NAME, |pass| {
            pass.dispatch(&self.measure_solid, self.n_threads);
            pass.dispatch(&self.report_solid, 1);
        });
    }
}
