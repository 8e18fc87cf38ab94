//! `extrapolate`: velocities outside the liquid, layer by layer, for the next advection. Domain walls are impermeable;
//! obstacles and solids have free slip relative to their velocity. Small-aperture faces contribute in proportion to
//! their aperture. With a level the first layer continues the slope of the liquid.

use crate::Error;
use crate::fields::{ClipBuffers, LiquidBuffers, extrapolation_layers};
use crate::gpu::{Binding, Dispatches, Gpu, Kernel, Real, RealBuffer, Source};
use crate::step::Stage;
use crate::wgsl;

/// The stage: extends `velocity` outwards from the `valid` faces. `moving` (with moving solids or obstacles): the
/// clipping, and with solids the node velocities, `Real4`, m/s.
pub fn extrapolate(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    moving: Option<(&ClipBuffers, Option<&RealBuffer>)>,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Extrapolate.name());
    let clip = moving.map(|(clip, _)| clip);
    let bound = |source: Source, own: &[(&str, Binding)]| {
        Kernel::new(gpu, &source, Real::F32)?.bind(gpu, own, &[liquid, &clip])
    };
    let over_band =
        |source: Source, own: &[(&str, Binding)]| Ok::<_, Error>(bound(source, own)?.indirect(&liquid.band_args, 0));
    let cuts = liquid.plan.effects.cuts();
    let mut list = Vec::new();
    if cuts {
        list.push(over_band(wgsl!("blend_slivers"), &[])?);
        list.push(over_band(wgsl!("swap_slivers"), &[])?);
    }
    // The layers alternate between `valid` and `valid_next`.
    let flags = [&liquid.valid, &liquid.valid_next];
    let n_layers = extrapolation_layers(liquid.plan.cfl);
    for n in 0..n_layers {
        let ends = [("valid_in", flags[n % 2].into()), ("valid_out", flags[1 - n % 2].into())];
        list.push(over_band(wgsl!("extrapolate_layer"), &ends)?);
        if n == 0 && liquid.plan.effects.maccormack {
            list.push(over_band(wgsl!("extrapolate_slope"), &ends[..1])?);
        }
    }
    list.push(over_band(wgsl!("extrapolate_walls"), &[])?);
    if let Some((clip, velocity)) = moving {
        let bound = match velocity {
            Some(velocity) => {
                let velocities = [("velocity", velocity.into())];
                let kernel = Kernel::new(gpu, &wgsl!("wall_velocities"), velocity.real)?;
                kernel.bind(gpu, &velocities, &[clip])?
            }
            None => bound(wgsl!("obstacle_velocities"), &[])?,
        };
        list.push(bound.threads(clip.size.places));
    }
    if cuts {
        // u* and the flags of the second-last layer are free.
        let slipping = ("slipping", flags[1 - n_layers % 2].into());
        let last = [("valid", flags[n_layers % 2].into()), slipping];
        let slip = match moving {
            Some(_) => wgsl!("slip_along_solids"),
            None => wgsl!("slip"),
        };
        list.push(over_band(slip, &last)?);
        list.push(over_band(wgsl!("apply_slip"), &[slipping])?);
        list.push(over_band(wgsl!("swap_slivers"), &[])?);
    }
    Ok(Dispatches::new(Stage::Extrapolate.name(), list))
}
