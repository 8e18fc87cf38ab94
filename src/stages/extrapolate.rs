//! `extrapolate`: velocities beyond the liquid, layer by layer, for the next advection; nothing through walls, free slip along
//! obstacles, and along solids as they move. Faces that are almost closed show a part of their velocity only.

use crate::Error;
use crate::gpu::{Bound, Gpu, Kernel, Real, RealBuffer, Recorder};
use crate::wgsl;

use super::{ClipBuffers, LiquidBuffers, extrapolation_layers, over_band};

/// The stage: `velocity` in place, from the `valid` faces outwards.
#[derive(Debug)]
pub struct Extrapolate {
    n_layers: usize,
    /// Where bodies cut the grid: what slivers show, and the exchange with what they have.
    slivers: Option<[Bound; 2]>,
    /// The layers by turns: marks from `valid` to `valid_next`, and back.
    layer: [Bound; 2],
    walls: Bound,
    /// How fast solids and obstacles move beside the liquid, where they do, and the number of places.
    wall_velocities: Option<(Bound, usize)>,
    slip: Option<[Bound; 2]>,
}

impl Extrapolate {
    /// The stage's name.
    pub const NAME: &'static str = "extrapolate";

    /// Compiles and binds. `moving`, where solids or obstacles move: the clipping, and with solids `Real4` per node, m/s.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(
        gpu: &Gpu,
        buffers: &LiquidBuffers,
        moving: Option<(&ClipBuffers, Option<&RealBuffer>)>,
    ) -> Result<Extrapolate, Error> {
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
        let slivers = || {
            let valid = ("valid", (&buffers.valid).into());
            let open = ("open", (&buffers.open).into());
            let bindings = [level, args, list, valid, open, velocity, velocity_next];
            Ok::<_, Error>([
                kernel(wgsl!("blend_slivers"))?.bind(gpu, &bindings)?,
                kernel(wgsl!("swap_slivers"))?.bind(gpu, &bindings)?,
            ])
        };
        let slip = || {
            // u* and the marks of the last layer but one are no longer needed.
            let [valid, slipping] = [marks[n_layers % 2], marks[1 - n_layers % 2]];
            let slipping = ("slipping", slipping.into());
            let mut source = wgsl!("slip");
            let mut bindings = vec![
                level,
                step,
                args,
                list,
                ("solid_distance", (&buffers.obstacles.solid_distance).into()),
                velocity,
                ("valid", valid.into()),
                velocity_next,
                slipping,
            ];
            if let Some((clip, _)) = moving {
                source = wgsl!("slip_along_solids");
                bindings.push(("clipped", (&clip.clipped).into()));
                bindings.push(("walls", (&clip.walls).into()));
            }
            Ok::<_, Error>([
                kernel(source)?.bind(gpu, &bindings)?,
                kernel(wgsl!("apply_slip"))?
                    .bind(gpu, &[level, args, list, slipping, velocity_next, velocity])?,
            ])
        };
        let wall_velocities = |(clip, velocity): (&ClipBuffers, Option<&RealBuffer>)| {
            let mut bindings = vec![
                ("clipped", (&clip.clipped).into()),
                ("places", (&clip.places).into()),
                ("walls", (&clip.walls).into()),
            ];
            let kernel = match velocity {
                Some(velocity) => {
                    bindings.push(("velocity", velocity.into()));
                    Kernel::new(gpu, &wgsl!("wall_velocities"), velocity.real)
                }
                None => kernel(wgsl!("obstacle_velocities")),
            };
            let bound = kernel?.bind(gpu, &bindings)?;
            Ok::<_, Error>((bound, clip.size.places))
        };
        let cuts = buffers.plan.effects.cuts();
        Ok(Extrapolate {
            n_layers,
            slivers: cuts.then(slivers).transpose()?,
            wall_velocities: moving.map(wall_velocities).transpose()?,
            layer: [layer(0)?, layer(1)?],
            walls: kernel(wgsl!("extrapolate_walls"))?.bind(
                gpu,
                &[
                    level,
                    args,
                    list,
                    ("valid", (&buffers.valid).into()),
                    velocity,
                ],
            )?,
            slip: cuts.then(slip).transpose()?,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder, buffers: &LiquidBuffers) {
        recorder.stage(Extrapolate::NAME, |pass| {
            let mut over_band = |bound| pass.dispatch_indirect(bound, &buffers.band_args, 0);
            for bound in self.slivers.iter().flatten() {
                over_band(bound);
            }
            for n in 0..self.n_layers {
                over_band(&self.layer[n % 2]);
            }
            over_band(&self.walls);
            if let Some((wall_velocities, n_places)) = &self.wall_velocities {
                pass.dispatch(wall_velocities, *n_places);
            }
            let mut over_band = |bound| pass.dispatch_indirect(bound, &buffers.band_args, 0);
            for bound in self.slip.iter().flatten() {
                over_band(bound);
            }
            if let Some([_, swap_slivers]) = &self.slivers {
                over_band(swap_slivers);
            }
        });
    }
}
