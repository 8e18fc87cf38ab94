//! `liquid_distance`: phi = min(2 dx, distance to the nearest marker) - r at cell centres, the union of spheres around the markers
//! (Zhu and Bridson 2005), - dx deep inside, made again in solids as a mean of what its known neighbours say; and the volume
//! that it encloses.
//!
//! The minimum is formed by scattering with integer atomics, so it does not depend on any order. Only markers within two cells of
//! an empty one scatter, and only to cells that are not deep inside: work follows the surface.

use crate::Error;
use crate::gpu::{Bound, Gpu, Kernel, Real, Recorder};
use crate::wgsl;

use super::{LiquidBuffers, Sinks, over_band};

/// How many cells deep the distance is extended into solids. Odd, so that the last pass leaves it beside its own buffer.
const PASSES: usize = 3;

/// The stage with markers: `liquid_distance` and the volume in the report.
#[derive(Debug)]
pub struct LiquidDistance {
    n_markers: usize,
    classify_near: Bound,
    classify_far: Bound,
    spread_markers: Bound,
    union_of_spheres: Bound,
    extension: Option<Extension>,
    volume: Volume,
}

#[derive(Debug)]
struct Extension {
    /// From the distance to its other buffer, and back.
    there: Bound,
    back: Bound,
    finish: Bound,
}

impl LiquidDistance {
    /// The stage's name.
    pub const NAME: &'static str = "liquid_distance";

    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    ///
    /// # Panics
    /// When the buffers have no markers.
    pub fn new(gpu: &Gpu, buffers: &LiquidBuffers) -> Result<LiquidDistance, Error> {
        let markers = buffers.markers.as_ref().expect("the scene has markers");
        let [level, args, list] = over_band(buffers);
        let step = ("step", (&buffers.step).into());
        let occupied = ("occupied", (&markers.occupied).into());
        let classes = ("classes", (&markers.classes).into());
        let squares = ("squares", (&buffers.liquid_distance).into());
        let kernel = |source| Kernel::new(gpu, &source, Real::F32);
        let extension = || {
            // From the advection to the write-back nobody needs the velocity of the last sub-step.
            let next = &buffers.velocity;
            let pass = kernel(wgsl!("extend_into_solids"))?;
            let flags = ("flags", (&buffers.band_flags).into());
            let open = ("open", (&buffers.open).into());
            let between = |from: &crate::gpu::Buffer<f32>, to: &crate::gpu::Buffer<f32>| {
                let ends = [("distance_in", from.into()), ("distance_out", to.into())];
                pass.bind(
                    gpu,
                    &[level, step, args, list, flags, open, ends[0], ends[1]],
                )
            };
            Ok::<_, Error>(Extension {
                there: between(&buffers.liquid_distance, next)?,
                back: between(next, &buffers.liquid_distance)?,
                finish: kernel(wgsl!("finish_extension"))?.bind(
                    gpu,
                    &[
                        step,
                        args,
                        list,
                        ("distance_in", next.into()),
                        ("distance_out", (&buffers.liquid_distance).into()),
                    ],
                )?,
            })
        };
        Ok(LiquidDistance {
            n_markers: markers.positions.len(),
            classify_near: kernel(wgsl!("classify_near"))?
                .bind(gpu, &[level, args, list, occupied, classes, squares])?,
            classify_far: kernel(wgsl!("classify_far"))?
                .bind(gpu, &[level, args, list, occupied, classes])?,
            spread_markers: kernel(wgsl!("spread_markers"))?.bind(
                gpu,
                &[
                    level,
                    step,
                    ("markers", (&markers.positions).into()),
                    occupied,
                    squares,
                ],
            )?,
            union_of_spheres: kernel(wgsl!("union_of_spheres"))?.bind(
                gpu,
                &[
                    level,
                    step,
                    args,
                    list,
                    occupied,
                    classes,
                    ("liquid_distance", (&buffers.liquid_distance).into()),
                ],
            )?,
            extension: buffers.plan.effects.cuts().then(extension).transpose()?,
            volume: Volume::new(gpu, buffers)?,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder, buffers: &LiquidBuffers) {
        self.record_with(recorder, buffers, None);
    }

    /// Records it with the cells of sinks empty.
    pub fn record_with(
        &self,
        recorder: &mut Recorder,
        buffers: &LiquidBuffers,
        sinks: Option<&Sinks>,
    ) {
        recorder.stage(LiquidDistance::NAME, |pass| {
            let mut over_band = |bound| pass.dispatch_indirect(bound, &buffers.band_args, 0);
            over_band(&self.classify_near);
            over_band(&self.classify_far);
            pass.dispatch(&self.spread_markers, self.n_markers);
            let mut over_band = |bound| pass.dispatch_indirect(bound, &buffers.band_args, 0);
            over_band(&self.union_of_spheres);
            if let Some(extension) = &self.extension {
                for n in 0..PASSES {
                    over_band(if n % 2 == 0 {
                        &extension.there
                    } else {
                        &extension.back
                    });
                }
                over_band(&extension.finish);
            }
            if let Some(sinks) = sinks {
                sinks.empty(pass);
            }
            self.volume.dispatch(pass);
        });
    }
}

/// The stage with `surface = "fixed"`, where the distance stays: its volume and potential energy, once.
#[derive(Debug)]
pub struct Volume {
    n_threads: usize,
    measure_volume: Bound,
    volume_rate: Bound,
}

impl Volume {
    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(gpu: &Gpu, buffers: &LiquidBuffers) -> Result<Volume, Error> {
        let [level, args, list] = over_band(buffers);
        let step = ("step", (&buffers.step).into());
        let partials = ("partials", (&buffers.partials).into());
        let real = buffers.partials.real;
        Ok(Volume {
            n_threads: buffers.plan.n_summing(),
            measure_volume: Kernel::new(gpu, &wgsl!("measure_volume"), real)?.bind(
                gpu,
                &[
                    level,
                    step,
                    args,
                    list,
                    ("liquid_distance", (&buffers.liquid_distance).into()),
                    ("solid_distance", (&buffers.obstacles.solid_distance).into()),
                    partials,
                ],
            )?,
            volume_rate: Kernel::new(gpu, &wgsl!("volume_rate"), real)?
                .bind(gpu, &[step, partials, ("report", (&buffers.report).into())])?,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder) {
        recorder.stage(LiquidDistance::NAME, |pass| self.dispatch(pass));
    }

    fn dispatch(&self, pass: &mut crate::gpu::Pass) {
        pass.dispatch(&self.measure_volume, self.n_threads);
        pass.dispatch(&self.volume_rate, 1);
    }
}
