//! `diagnose`: momentum, kinetic energy, largest speed and divergence of the liquid. Volume and potential energy were measured
//! with the liquid distance.
//!
//! A fixed number of threads adds fixed shares of the band, one workgroup adds their sums in a tree: the order is a function of
//! the grid and the band, so the sums repeat bit for bit.

use crate::Error;
use crate::gpu::{Binding, Bound, Gpu, Kernel, RealBuffer, Recorder, Variant};
use crate::solver::CouplingBuffers;
use crate::wgsl;

use super::{Active, ClipBuffers, LiquidBuffers, over_band};

/// The stage: fields to the report.
#[derive(Debug)]
pub struct Diagnose {
    n_threads: usize,
    measure_motion: Bound,
    measure_divergence: Bound,
    /// With solids: in quads with patches, how many at most.
    measure_cut_divergence: Option<(Bound, usize)>,
    report_motion: Bound,
}

impl Diagnose {
    /// The stage's name.
    pub const NAME: &'static str = "diagnose";

    /// Compiles and binds. `solids`, where there are any in liquid: the clipping, J, and `Real4` per node, m/s.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(
        gpu: &Gpu,
        buffers: &LiquidBuffers,
        active: &Active,
        solids: Option<(&ClipBuffers, &CouplingBuffers, &RealBuffer)>,
    ) -> Result<Diagnose, Error> {
        let [level, args, list] = over_band(buffers);
        let step = ("step", (&buffers.step).into());
        let velocity = ("velocity", (&buffers.velocity).into());
        let partials = ("partials", (&buffers.partials).into());
        let maxima = ("maxima", (&buffers.maxima).into());
        let kernel = |source| Kernel::new(gpu, &source, buffers.partials.real);
        let flags = ("flags", active.flags.into());
        let open = ("open", buffers.flux_open().into());
        let mut source = wgsl!("measure_divergence");
        let mut divergence = vec![
            level,
            step,
            ("args", active.args.into()),
            ("list", active.list.into()),
            flags,
            velocity,
            open,
            maxima,
        ];
        // Of obstacles that move.
        let flux = buffers.obstacle_flux.as_ref();
        let flux = flux.map(|flux| ("obstacle_flux", Binding::from(flux)));
        divergence.extend(flux);
        let beside = |real| Variant::from(real).beside_obstacles(flux.is_some());
        let mut measure_cut_divergence = None;
        if let Some((clip, coupling, x)) = solids {
            source = wgsl!("measure_uncut_divergence");
            divergence.push(("walls", (&clip.walls).into()));
            let mut bindings = vec![
                level,
                step,
                ("coupling", (&coupling.coupling).into()),
                ("words", (&coupling.words).into()),
                ("pairs", (&coupling.quad_pairs).into()),
                flags,
                ("x", x.into()),
                velocity,
                open,
                maxima,
            ];
            bindings.extend(flux);
            let kernel = Kernel::new(gpu, &wgsl!("measure_cut_divergence"), beside(x.real))?;
            let bound = kernel.bind(gpu, &bindings)?;
            measure_cut_divergence = Some((bound, coupling.size.quads));
        }
        Ok(Diagnose {
            n_threads: buffers.plan.n_summing(),
            measure_motion: kernel(wgsl!("measure_motion"))?.bind(
                gpu,
                &[
                    level,
                    step,
                    args,
                    list,
                    velocity,
                    ("liquid_distance", (&buffers.liquid_distance).into()),
                    ("solid_distance", (&buffers.obstacles.solid_distance).into()),
                    partials,
                    maxima,
                ],
            )?,
            measure_divergence: Kernel::new(gpu, &source, beside(buffers.partials.real))?
                .bind(gpu, &divergence)?,
            measure_cut_divergence,
            report_motion: kernel(wgsl!("report_motion"))?.bind(
                gpu,
                &[partials, maxima, ("report", (&buffers.report).into())],
            )?,
        })
    }

    /// Records it.
    pub fn record(&self, recorder: &mut Recorder, buffers: &LiquidBuffers, active: &Active) {
        recorder.clear(&buffers.maxima);
        recorder.stage(Diagnose::NAME, |pass| {
            pass.dispatch(&self.measure_motion, self.n_threads);
            pass.dispatch_indirect(&self.measure_divergence, active.args, 0);
            if let Some((measure_cut_divergence, n_quads)) = &self.measure_cut_divergence {
                pass.dispatch(measure_cut_divergence, *n_quads);
            }
            pass.dispatch(&self.report_motion, 1);
        });
    }
}
