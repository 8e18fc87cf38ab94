//! `extrapolate`: velocities beyond the liquid, layer by layer, for the next advection; nothing through walls, free slip along
//! obstacles.

use crate::Error;
use crate::gpu::{Bound, Gpu, Kernel, Real, Recorder};
use crate::wgsl;

use super::{LiquidBuffers, extrapolation_layers, over_band};

/// The stage: `velocity` in place, from the `valid` faces outwards.
#[derive(Debug)]
pub struct Extrapolate {
    n_layers: usize,
    /// The layers by turns: marks from `valid` to `valid_next`, and back.
    layer: [Bound; 2],
    walls: Bound,
    slip: Option<[Bound; 2]>,
}

impl Extrapolate {
    /// The stage's name.
    pub const NAME: &'static str = "extrapolate";

    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(gpu: &Gpu, buffers: &LiquidBuffers) -> Result<Extrapolate, Error> {
        let [level, args, list] = over_band(buffers);
        let step = ("step", (&buffers.step).into());
        let velocity = ("velocity", (&buffers.velocity).into());
        let velocity_next = ("velocity_next", (&buffers.velocity_next).into());
        let kernel = |source| Kernel::new(gpu, &source, Real::F32);
        let marks = [&buffers.valid, &buffers.valid_next];
        let n_layers = extrapolation_layers(buffers.plan.cfl);
        let layer = kernel(wgsl!("extrapolate_layer"))?;
        let layer = |from: usize| {
            let (from, to) = (marks[from], marks[1 - from]);
            let marks = [("valid_in", from.into()), ("valid_out", to.into())];
            layer.bind(gpu, &[level, args, list, marks[0], marks[1], velocity])
        };
        let slip = || {
            // u* and the marks of the last layer but one are no longer needed.
            let [valid, slipping] = [marks[n_layers % 2], marks[1 - n_layers % 2]];
            let slipping = ("slipping", slipping.into());
            Ok::<_, Error>([
                kernel(wgsl!("slip"))?.bind(
                    gpu,
                    &[
                        level,
                        step,
                        args,
                        list,
                        ("solid_distance", (&buffers.obstacles.solid_distance).into()),
                        velocity,
                        ("valid", valid.into()),
                        velocity_next,
                        slipping,
                    ],
                )?,
                kernel(wgsl!("apply_slip"))?
                    .bind(gpu, &[level, args, list, slipping, velocity_next, velocity])?,
            ])
        };
        Ok(Extrapolate {
            n_layers,
            layer: [layer(0)?, layer(1)?],
            walls: kernel(wgsl!("extrapolate_walls"))?.bind(gpu, &[level, args, list, velocity])?,
            slip: buffers.plan.effects.obstacles.then(slip).transpose()?,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder, buffers: &LiquidBuffers) {
        recorder.stage(Extrapolate::NAME, |pass| {
            let mut over_band = |bound| pass.dispatch_indirect(bound, &buffers.band_args, 0);
            for n in 0..self.n_layers {
                over_band(&self.layer[n % 2]);
            }
            over_band(&self.walls);
            self.slip.iter().flatten().for_each(over_band);
        });
    }
}
