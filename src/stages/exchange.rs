//! `exchange`: sinks delete markers, sources emit some; and the parts of both in other stages.

use crate::Error;
use crate::fields::{LiquidBuffers, Sinks, Sources};
use crate::gpu::{Dispatch, Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

impl Sinks {
    /// The part of `exchange` for sinks, after all markers have moved.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind_arrays`].
    pub fn exchange(&self, gpu: &Gpu, liquid: &LiquidBuffers) -> Result<Dispatches, Error> {
        let gpu = &gpu.at(Stage::Exchange.name());
        let kernel = Kernel::new(gpu, &wgsl!("sink_markers"), Real::F32)?;
        let sink_markers = kernel.bind_arrays(gpu, &[self, liquid])?;
        Ok(Dispatches::new(
            Stage::Exchange.name(),
            [sink_markers.threads(liquid.n_markers())],
        ))
    }

    /// The part of `liquid_distance`, before the volume is measured.
    pub(super) fn empty(&self, gpu: &Gpu, liquid: &LiquidBuffers) -> Result<Dispatch, Error> {
        let kernel = Kernel::new(gpu, &wgsl!("empty_sinks"), Real::F32)?;
        let empty_sinks = kernel.bind_arrays(gpu, &[self, liquid])?;
        Ok(empty_sinks.threads(self.cells.len()))
    }
}

impl Sources {
    /// Their parts of three stages: in `exchange` new markers, after all others have moved or are deleted; in `forces` prescribed fluxes,
    /// after all forces have acted; in `write_back` the velocities of the same faces.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind_arrays`].
    pub fn stages(&self, gpu: &Gpu, liquid: &LiquidBuffers) -> Result<[Dispatches; 3], Error> {
        let bound = |stage: Stage, source| {
            let gpu = &gpu.at(stage.name());
            Kernel::new(gpu, &source, Real::F32)?.bind_arrays(gpu, &[self, liquid])
        };
        let exchange = [
            bound(Stage::Exchange, wgsl!("count_in_sources"))?.threads(liquid.n_markers()),
            bound(Stage::Exchange, wgsl!("plan_seeds"))?.threads(1),
            bound(Stage::Exchange, wgsl!("seed_markers"))?.threads(self.slots()),
        ];
        let hold_faces = bound(Stage::Forces, wgsl!("hold_faces"))?.threads(self.n_faces);
        let carry_faces = bound(Stage::WriteBack, wgsl!("carry_faces"))?.threads(self.n_faces);
        Ok([
            Dispatches::new(Stage::Exchange.name(), exchange).clearing(&self.counts),
            Dispatches::new(Stage::Forces.name(), [hold_faces])
                .copying(&liquid.open, liquid.solve_open()),
            Dispatches::new(Stage::WriteBack.name(), [carry_faces]),
        ])
    }
}
