//! Effects that can be removed from a scene.

use crate::effects::Effects;
use crate::grid::Sides;
use crate::scene::{ElasticModel, Liquid, PatchPressure, ProbeKind, Scene, Separation, Solid, Surface};

/// An effect that can be removed.
#[derive(Clone, Copy, Debug)]
pub struct Effect {
    /// Name, as in [`Effects`].
    pub name: &'static str,
    /// Whether a scene has it.
    pub present: fn(&Scene) -> bool,
    /// Removes it and its dependents.
    pub without: fn(&mut Scene),
}

macro_rules! effects {
    ($($name:ident: $without:expr;)*) => {
        /// Effects that can be removed, in the order of [`Effects`].
        pub const EFFECTS: &[Effect] = &[$(Effect {
            name: stringify!($name),
            present: |scene| Effects::of(scene).$name,
            without: $without,
        }),*];
    };
}

effects! {
    liquid: |scene| {
        scene.liquid = None;
        close(scene);
        scene.probes.retain(|probe| probe.kind.measures_solid());
    };
    markers: |scene| {
        change_liquid(scene, |liquid| liquid.surface = Surface::Fixed);
        close(scene);
    };
    level: |scene| change_level(scene, |liquid| liquid.surface = Surface::Markers);
    volume_control: |scene| if Effects::of(scene).volume_control {
        change_liquid(scene, |_| {});
    };
    volume_shift: |scene| change_level(scene, |_| {});
    separation: |scene| if let Some(liquid) = &mut scene.liquid {
        liquid.separation = Separation::None;
    };
    open_sides: |scene| scene.domain.open = Sides::default();
    sources: |scene| scene.sources.clear();
    sinks: |scene| scene.sinks.clear();
    solids: |scene| {
        scene.solids.clear();
        scene.probes.retain(|probe| probe.kind.measures_liquid());
    };
    corotation: |scene| change_solids(scene, |solid| solid.model = ElasticModel::Linear);
    damping: |scene| change_solids(scene, |solid| (solid.mass_damping, solid.stiffness_damping) = (0.0, 0.0));
    pins: |scene| change_solids(scene, |solid| solid.pins.retain(|pin| !pin.keyframes.is_empty()));
    scripts: |scene| change_solids(scene, |solid| solid.pins.retain(|pin| pin.keyframes.is_empty()));
    loads: |scene| change_solids(scene, |solid| solid.loads.clear());
    obstacles: |scene| scene.obstacles.clear();
    // They rest at their first position.
    moving_obstacles: |scene| if scene.liquid.is_some() {
        scene.obstacles.iter_mut().for_each(|obstacle| obstacle.motion = None);
    };
    pushing_obstacles: |scene| if !scene.solids.is_empty() {
        scene.obstacles.iter_mut().for_each(|obstacle| obstacle.motion = None);
    };
    solid_contact: |scene| scene.solver.solid_contact = false;
    friction: |scene| {
        scene.domain.friction = 0.0;
        scene.obstacles.iter_mut().for_each(|obstacle| obstacle.friction = 0.0);
        change_solids(scene, |solid| solid.friction = 0.0);
    };
    patch_correction: |scene| scene.solver.pressure_on_patches = PatchPressure::Cell;
    probes: |scene| scene.probes.clear();
}

/// Changes the liquid and removes volume control.
fn change_liquid(scene: &mut Scene, change: fn(&mut Liquid)) {
    if let Some(liquid) = &mut scene.liquid {
        change(liquid);
        liquid.volume_control = false;
    }
}

/// The same for a level alone.
fn change_level(scene: &mut Scene, change: fn(&mut Liquid)) {
    if Effects::of(scene).level {
        change_liquid(scene, change);
    }
}

/// Removes sources, sinks and open sides, which need markers.
fn close(scene: &mut Scene) {
    (scene.sources, scene.sinks) = (Vec::new(), Vec::new());
    scene.domain.open = Sides::default();
}

fn change_solids(scene: &mut Scene, change: fn(&mut Solid)) {
    scene.solids.iter_mut().for_each(change);
}

macro_rules! probes {
    ($($name:literal: $kind:ident;)*) => {
        /// Kinds of probes.
        pub const PROBES: &[Effect] = &[$(Effect {
            name: $name,
            present: |scene| scene.probes.iter().any(|probe| matches!(probe.kind, ProbeKind::$kind { .. })),
            without: |scene| scene.probes.retain(|probe| !matches!(probe.kind, ProbeKind::$kind { .. })),
        }),*];
    };
}
probes! {
    "probe_height": Height;
    "probe_pressure": Pressure;
    "probe_velocity": Velocity;
    "probe_front": Front;
    "probe_flux": Flux;
    "probe_node": Node;
    "probe_solid": Solid;
    "probe_solid_velocity": SolidVelocity;
    "probe_force": Force;
    "probe_reaction": Reaction;
}
