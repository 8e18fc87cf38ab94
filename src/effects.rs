//! What a scene calls for, computed in one place. Kernels, buffers and CPU work ask [`Effects`] and nothing else, so an
//! effect that a scene does not have costs no compile time, no bytes and no dispatch.

use crate::scene::{Scene, Surface};

/// The effects of a scene (design: each adds its kernels, buffers and CPU work; an absent one adds none).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effects {
    /// There is liquid: all stages from `advect_velocity` on.
    pub liquid: bool,
    /// The surface moves with markers: `advect_markers`, union of spheres.
    pub markers: bool,
    /// The liquid's volume is held.
    pub volume_control: bool,
    /// There are obstacles: open areas from clipping, push-out, extension of the liquid distance, slip inside solids.
    pub obstacles: bool,
    /// There are probes: the `probe` stage and its few numbers read back.
    pub probes: bool,
}

impl Effects {
    /// The effects of a scene.
    pub fn of(scene: &Scene) -> Effects {
        let markers = scene
            .liquid
            .as_ref()
            .is_some_and(|liquid| liquid.surface == Surface::Markers);
        Effects {
            liquid: scene.liquid.is_some(),
            markers,
            volume_control: markers
                && scene
                    .liquid
                    .as_ref()
                    .is_some_and(|liquid| liquid.volume_control),
            obstacles: !scene.obstacles.is_empty(),
            probes: !scene.probes.is_empty(),
        }
    }
}
