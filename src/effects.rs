//! What a scene calls for, computed in one place. Kernels, buffers and CPU work ask [`Effects`] and nothing else, so an
//! effect that a scene does not have costs no compile time, no bytes and no dispatch.

use crate::scene::{ElasticModel, PatchPressure, Scene, Solid, Surface};

/// The effects of a scene (design: each adds its kernels, buffers and CPU work; an absent one adds none).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Effects {
    /// There is liquid: all stages from `advect_velocity` on.
    pub liquid: bool,
    /// The surface moves with markers: `advect_markers`, union of spheres.
    pub markers: bool,
    /// The liquid's volume is held.
    pub volume_control: bool,
    /// Liquid leaves through sides of the domain: markers beyond them are removed, and the volume to hold with them.
    pub open_sides: bool,
    /// Sources emit liquid: markers, held faces, and more volume to hold.
    pub sources: bool,
    /// Sinks take liquid away.
    pub sinks: bool,
    /// There are elastic solids: `move_solid`, `solid_matrices` and their solve.
    pub solids: bool,
    /// A solid measures strain in the frame that turns with each element: rotations of elements.
    pub corotation: bool,
    /// A solid is damped by its mass or by its stiffness.
    pub damping: bool,
    /// Nodes are held.
    pub pins: bool,
    /// Nodes are moved: their velocities are uploaded in every step.
    pub scripts: bool,
    /// Constant forces act on nodes.
    pub loads: bool,
    /// There are obstacles. With liquid: open areas from clipping, push-out, extension of the liquid distance, slip inside them;
    /// with solids: push-out of nodes.
    pub obstacles: bool,
    /// Obstacles move, in liquid: `clip` in every sub-step, their J v in the right-hand side, slip relative to them.
    pub moving_obstacles: bool,
    /// There are liquid and solids: `clip` in every sub-step, J, and one solve for both where they touch.
    pub coupling: bool,
    /// The pressure on the solids' patches varies within cells: forces on their nodes.
    pub patch_correction: bool,
    /// There are probes: the `probe` stage and its few numbers read back.
    pub probes: bool,
    /// The liquid's surface is written as a mesh, which the host makes of every frame that is written.
    pub surface: bool,
}

impl Effects {
    /// Whether obstacles or solids take room from the liquid.
    pub fn cuts(&self) -> bool {
        self.liquid && (self.obstacles || self.coupling)
    }

    /// Whether liquid comes in or goes out.
    pub fn exchange(&self) -> bool {
        self.open_sides || self.sources || self.sinks
    }

    /// Whether what takes room from it moves: `clip` in every sub-step.
    pub fn clips(&self) -> bool {
        self.coupling || self.moving_obstacles
    }

    /// The effects of a scene.
    pub fn of(scene: &Scene) -> Effects {
        let markers = scene
            .liquid
            .as_ref()
            .is_some_and(|liquid| liquid.surface == Surface::Markers);
        let any = |has: fn(&Solid) -> bool| scene.solids.iter().any(has);
        let pin = |scripted: bool| {
            let mut pins = scene.solids.iter().flat_map(|solid| &solid.pins);
            pins.any(|pin| pin.keyframes.is_empty() != scripted)
        };
        Effects {
            liquid: scene.liquid.is_some(),
            markers,
            volume_control: markers
                && scene
                    .liquid
                    .as_ref()
                    .is_some_and(|liquid| liquid.volume_control),
            open_sides: scene.liquid.is_some() && scene.domain.open.any(),
            sources: !scene.sources.is_empty(),
            sinks: !scene.sinks.is_empty(),
            solids: !scene.solids.is_empty(),
            corotation: any(|solid| solid.model == ElasticModel::Corotational),
            damping: any(|solid| solid.mass_damping > 0.0 || solid.stiffness_damping > 0.0),
            pins: pin(false),
            scripts: pin(true),
            loads: any(|solid| !solid.loads.is_empty()),
            obstacles: !scene.obstacles.is_empty(),
            moving_obstacles: scene.liquid.is_some() && scene.obstacles_move(),
            coupling: scene.liquid.is_some() && !scene.solids.is_empty(),
            patch_correction: scene.liquid.is_some()
                && !scene.solids.is_empty()
                && scene.solver.pressure_on_patches != PatchPressure::Cell,
            probes: !scene.probes.is_empty(),
            surface: scene.liquid.is_some() && scene.output.surface,
        }
    }
}
