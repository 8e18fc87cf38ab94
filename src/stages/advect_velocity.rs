//! `advect_velocity`: u*(x) = u(x - dt u(x - dt/2 u(x))) per face, semi-Lagrangian along the midpoint rule (Stam 1999). Of
//! faces that are almost closed, whole ones carry a part of the velocity only.

use crate::Error;
use crate::gpu::{Bound, Gpu, Kernel, Pass, Real, Recorder};
use crate::wgsl;

use super::{LiquidBuffers, over_band};

/// The stage: `velocity` to `velocity_next` on the band. Where bodies cut the grid, `velocity` is what slivers show afterwards.
#[derive(Debug)]
pub struct AdvectVelocity {
    /// Where bodies cut the grid: u* of slivers, and what they show to the other faces.
    slivers: Option<[Bound; 2]>,
    /// u* of all faces, or of the others.
    faces: Bound,
}

impl AdvectVelocity {
    /// The stage's name.
    pub const NAME: &'static str = "advect_velocity";

    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(gpu: &Gpu, buffers: &LiquidBuffers) -> Result<AdvectVelocity, Error> {
        let [level, args, list] = over_band(buffers);
        let kernel = |source| Kernel::new(gpu, &source, Real::F32);
        let step = ("step", (&buffers.step).into());
        let velocity = ("velocity", (&buffers.velocity).into());
        let quads = ("quads", (&buffers.velocity).into());
        let velocity_next = ("velocity_next", (&buffers.velocity_next).into());
        let valid = ("valid", (&buffers.valid).into());
        let open = ("open", (&buffers.open).into());
        if !buffers.plan.effects.cuts() {
            let bindings = [level, step, args, list, velocity, quads, velocity_next];
            return Ok(AdvectVelocity {
                slivers: None,
                faces: kernel(wgsl!("advect_velocity"))?.bind(gpu, &bindings)?,
            });
        }
        let shown = [level, args, list, valid, open, velocity];
        let bindings = [
            level,
            step,
            args,
            list,
            velocity,
            quads,
            valid,
            open,
            velocity_next,
        ];
        Ok(AdvectVelocity {
            slivers: Some([
                kernel(wgsl!("advect_slivers"))?.bind(gpu, &bindings)?,
                kernel(wgsl!("show_slivers"))?.bind(gpu, &shown)?,
            ]),
            faces: kernel(wgsl!("advect_beside_slivers"))?.bind(gpu, &bindings)?,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder, buffers: &LiquidBuffers) {
        recorder.stage(AdvectVelocity::NAME, |pass: &mut Pass| {
            for bound in self.slivers.iter().flatten() {
                pass.dispatch_indirect(bound, &buffers.band_args, 0);
            }
            pass.dispatch_indirect(&self.faces, &buffers.band_args, 0);
        });
    }
}
