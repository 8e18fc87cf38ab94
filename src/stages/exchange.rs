//! `exchange`: sinks delete markers and sources emit them. Also the kernels of sinks and sources in other stages.

use crate::Error;
use crate::fields::{LevelBuffers, LiquidBuffers, Sinks, Sources};
use crate::gpu::{Dispatch, Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

impl Sinks {
    /// The sinks' part of `exchange`, after all markers have moved. With a level it also counts the spray that sinks.
    pub fn exchange(
        &self,
        gpu: &Gpu,
        liquid: &LiquidBuffers,
        level: Option<&LevelBuffers>,
    ) -> Result<Dispatches, Error> {
        let gpu = &gpu.at(Stage::Exchange.name());
        let kernel = Kernel::new(gpu, &wgsl!("sink_markers"), Real::F32)?;
        let sink_markers = kernel.bind(gpu, &[], &[self, liquid])?;
        let mut list = vec![sink_markers.threads(liquid.n_markers())];
        if let Some(level) = level {
            let kernel = Kernel::new(gpu, &wgsl!("sink_spray"), Real::F32)?;
            let sink_spray = kernel.bind(gpu, &[], &[liquid, level])?;
            list.push(sink_spray.threads(liquid.n_markers()));
        }
        Ok(Dispatches::new(Stage::Exchange.name(), list))
    }

    /// The sinks' part of `liquid_distance`, before the volume is measured.
    pub(super) fn empty(&self, gpu: &Gpu, liquid: &LiquidBuffers) -> Result<Dispatch, Error> {
        let source = match liquid.plan.effects.level {
            true => wgsl!("empty_level_sinks"),
            false => wgsl!("empty_sinks"),
        };
        let kernel = Kernel::new(gpu, &source, Real::F32)?;
        let empty_sinks = kernel.bind(gpu, &[], &[self, liquid])?;
        Ok(empty_sinks.threads(self.cells.len()))
    }
}

impl Sources {
    /// The sources' parts of three stages. `exchange`: new markers after advection and deletion. `forces`: prescribed
    /// fluxes after all forces. `write_back`: the velocities of the same faces.
    pub fn stages(&self, gpu: &Gpu, liquid: &LiquidBuffers) -> Result<[Dispatches; 3], Error> {
        let bound = |stage: Stage, source| {
            let gpu = &gpu.at(stage.name());
            Kernel::new(gpu, &source, Real::F32)?.bind(gpu, &[], &[self, liquid])
        };
        let exchange = match liquid.plan.effects.level {
            true => [
                bound(Stage::Exchange, wgsl!("count_emitted"))?.threads(self.n_cells()),
                bound(Stage::Exchange, wgsl!("scan_emitted"))?.threads(1),
                bound(Stage::Exchange, wgsl!("emit_markers"))?.threads(self.slots()),
            ],
            false => [
                bound(Stage::Exchange, wgsl!("count_in_sources"))?.threads(liquid.n_markers()),
                bound(Stage::Exchange, wgsl!("plan_seeds"))?.threads(1),
                bound(Stage::Exchange, wgsl!("seed_markers"))?.threads(self.slots()),
            ],
        };
        let hold_faces = bound(Stage::Forces, wgsl!("hold_faces"))?.threads(self.n_faces);
        let carry_faces = bound(Stage::WriteBack, wgsl!("carry_faces"))?.threads(self.n_faces);
        Ok([
            Dispatches::new(Stage::Exchange.name(), exchange).clearing(&self.counts),
            Dispatches::new(Stage::Forces.name(), [hold_faces]).copying(&liquid.open, liquid.solve_open()),
            Dispatches::new(Stage::WriteBack.name(), [carry_faces]),
        ])
    }
}
