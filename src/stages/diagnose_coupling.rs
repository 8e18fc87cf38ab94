//! `diagnose`: the forces of the liquid on the solids, as sums over all nodes.

use crate::Error;
use crate::gpu::{Bound, Gpu, Kernel, RealBuffer, Recorder};
use crate::solver::{CouplingBuffers, SolverBuffers};
use crate::wgsl;

use super::CouplingReport;

/// The stage: pressure and J to the report.
#[derive(Debug)]
pub struct DiagnoseCoupling {
    n_nodes: usize,
    measure: Bound,
    report: Vec<Bound>,
}

impl DiagnoseCoupling {
    /// The stage's name.
    pub const NAME: &'static str = "diagnose";

    /// Compiles and binds. `correction`: forces of the pressure's variation within cells, N, `Real4` per node, where they act.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Gpu::buffer`].
    pub fn new(
        gpu: &Gpu,
        liquid: &SolverBuffers,
        coupling: &CouplingBuffers,
        correction: Option<&RealBuffer>,
    ) -> Result<DiagnoseCoupling, Error> {
        let joint = ("coupling", (&coupling.coupling).into());
        let measure = Kernel::new(gpu, &wgsl!("measure_coupling"), coupling.partials.real)?.bind(
            gpu,
            &[
                joint,
                ("words", (&coupling.words).into()),
                ("pairs", (&coupling.node_pairs).into()),
                ("flags", (&liquid.flags).into()),
                ("p", (&liquid.potential).into()),
                ("partials", (&coupling.partials).into()),
            ],
        )?;
        let report = |(forces, word): (&RealBuffer, u32)| {
            let first = gpu.uniform("coupling.first", &[word, 0, 0, 0])?;
            Kernel::new(gpu, &wgsl!("report_coupling"), forces.real)?.bind(
                gpu,
                &[
                    joint,
                    ("first", (&first).into()),
                    ("partials", forces.into()),
                    ("report", (&coupling.report).into()),
                ],
            )
        };
        let forces = [(&coupling.partials, CouplingReport::FORCE)].into_iter();
        let corrections = correction.map(|correction| (correction, CouplingReport::CORRECTION));
        Ok(DiagnoseCoupling {
            n_nodes: coupling.n_nodes,
            measure,
            report: forces
                .chain(corrections)
                .map(report)
                .collect::<Result<_, _>>()?,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder) {
        recorder.stage(DiagnoseCoupling::NAME, |pass| {
            pass.dispatch(&self.measure, self.n_nodes);
            for report in &self.report {
                pass.dispatch(report, 1);
            }
        });
    }
}
