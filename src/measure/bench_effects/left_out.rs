//! The effects that can be left out of a scene, and how.

use crate::effects::Effects;
use crate::grid::Sides;
use crate::scene::{ElasticModel, Liquid, PatchPressure, ProbeKind, Scene, Solid, Surface};

/// An effect that can be left out.
#[derive(Clone, Copy, Debug)]
pub struct Effect {
    /// Its name, as in [`Effects`].
    pub name: &'static str,
    /// Whether a scene has it.
    pub present: fn(&Effects) -> bool,
    /// Takes it away, and with it what cannot be without it.
    pub without: fn(&mut Scene),
}

/// Those that can be left out, in the order of [`Effects`].
pub const EFFECTS: [Effect; 16] = [
    Effect {
        name: "liquid",
        present: |effects| effects.liquid,
        without: |scene| {
            scene.liquid = None;
            close(scene);
            scene.probes.retain(|probe| probe.kind.measures_solid());
        },
    },
    Effect {
        name: "markers",
        present: |effects| effects.markers,
        without: |scene| {
            of_liquid(scene, |liquid| liquid.surface = Surface::Fixed);
            close(scene);
        },
    },
    Effect {
        name: "volume_control",
        present: |effects| effects.volume_control,
        without: |scene| of_liquid(scene, |_| {}),
    },
    Effect {
        name: "open_sides",
        present: |effects| effects.open_sides,
        without: |scene| scene.domain.open = Sides::default(),
    },
    Effect {
        name: "sources",
        present: |effects| effects.sources,
        without: |scene| scene.sources.clear(),
    },
    Effect {
        name: "sinks",
        present: |effects| effects.sinks,
        without: |scene| scene.sinks.clear(),
    },
    Effect {
        name: "solids",
        present: |effects| effects.solids,
        without: |scene| {
            scene.solids.clear();
            scene.probes.retain(|probe| probe.kind.measures_liquid());
        },
    },
    Effect {
        name: "corotation",
        present: |effects| effects.corotation,
        without: |scene| of_solids(scene, |solid| solid.model = ElasticModel::Linear),
    },
    Effect {
        name: "damping",
        present: |effects| effects.damping,
        without: |scene| {
            of_solids(scene, |solid| {
                (solid.mass_damping, solid.stiffness_damping) = (0.0, 0.0);
            });
        },
    },
    Effect {
        name: "pins",
        present: |effects| effects.pins,
        without: |scene| {
            of_solids(scene, |solid| {
                solid.pins.retain(|pin| !pin.keyframes.is_empty())
            });
        },
    },
    Effect {
        name: "scripts",
        present: |effects| effects.scripts,
        without: |scene| {
            of_solids(scene, |solid| {
                solid.pins.retain(|pin| pin.keyframes.is_empty())
            });
        },
    },
    Effect {
        name: "loads",
        present: |effects| effects.loads,
        without: |scene| of_solids(scene, |solid| solid.loads.clear()),
    },
    Effect {
        name: "obstacles",
        present: |effects| effects.obstacles,
        without: |scene| scene.obstacles.clear(),
    },
    Effect {
        name: "moving_obstacles",
        present: |effects| effects.moving_obstacles,
        // They stand where they were at first. Without liquid nothing sees what moves, and solids would see what stands.
        without: |scene| {
            if scene.liquid.is_some() {
                let obstacles = scene.obstacles.iter_mut();
                obstacles.for_each(|obstacle| obstacle.motion = None);
            }
        },
    },
    Effect {
        name: "patch_correction",
        present: |effects| effects.patch_correction,
        without: |scene| scene.solver.pressure_on_patches = PatchPressure::Cell,
    },
    Effect {
        name: "probes",
        present: |effects| effects.probes,
        without: |scene| scene.probes.clear(),
    },
];

/// Changes the liquid, whose volume nobody holds then.
fn of_liquid(scene: &mut Scene, change: fn(&mut Liquid)) {
    if let Some(liquid) = &mut scene.liquid {
        change(liquid);
        liquid.volume_control = false;
    }
}

/// Takes away what brings liquid in or lets it out, which only markers know.
fn close(scene: &mut Scene) {
    (scene.sources, scene.sinks) = (Vec::new(), Vec::new());
    scene.domain.open = Sides::default();
}

fn of_solids(scene: &mut Scene, change: fn(&mut Solid)) {
    scene.solids.iter_mut().for_each(change);
}

/// Whether a probe is of a kind.
pub type OfKind = fn(&ProbeKind) -> bool;

/// Kinds of probes, each of which can be left out by itself: the name of its row, and which probes are of it.
pub const PROBES: [(&str, OfKind); 7] = [
    ("probe_height", |kind| {
        matches!(kind, ProbeKind::Height { .. })
    }),
    ("probe_pressure", |kind| {
        matches!(kind, ProbeKind::Pressure { .. })
    }),
    ("probe_velocity", |kind| {
        matches!(kind, ProbeKind::Velocity { .. })
    }),
    ("probe_front", |kind| {
        matches!(kind, ProbeKind::Front { .. })
    }),
    ("probe_node", |kind| matches!(kind, ProbeKind::Node { .. })),
    ("probe_solid", |kind| {
        matches!(kind, ProbeKind::Solid { .. })
    }),
    ("probe_force", |kind| {
        matches!(kind, ProbeKind::Force { .. })
    }),
];
