//! The active effects of a scene, decided in one place. Kernels, arrays and CPU work query [`Effects`] alone. An
//! inactive effect costs no compile time, no memory and no dispatch.

use crate::scene::{ElasticModel, PatchPressure, Scene, Separation, Solid, Surface};

/// An effect and why it is active or inactive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Effect {
    /// Name, as in [`Effects`].
    pub name: &'static str,
    /// Whether the effect is active.
    pub active: bool,
    /// Reason for `active`.
    pub reason: String,
}

/// Declares the table of effects. A row contains a condition and a reason, both functions of the scene and of the
/// effects in earlier rows.
macro_rules! effects {
    ($( $(#[$meta:meta])* $name:ident: $active:expr, $reason:expr; )*) => {
        /// The active effects of a scene.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct Effects {
            $( $(#[$meta])* pub $name: bool, )*
        }

        impl Effects {
            /// The effects of a scene.
            pub fn of(scene: &Scene) -> Effects {
                let mut effects = Effects::default();
                $({
                    const ACTIVE: fn(&Scene, &Effects) -> bool = $active;
                    effects.$name = ACTIVE(scene, &effects);
                })*
                effects
            }

            /// All effects with their reasons, active or not. `self` must be the effects of `scene`.
            pub fn explained(&self, scene: &Scene) -> Vec<Effect> {
                vec![$({
                    const REASON: fn(&Scene, &Effects) -> String = $reason;
                    Effect {
                        name: stringify!($name),
                        active: self.$name,
                        reason: REASON(scene, self),
                    }
                }),*]
            }
        }
    };
}

effects! {
    /// Liquid: all stages from `advect_velocity` on.
    liquid: |scene, _| scene.liquid.is_some(),
        |scene, _| count(scene.liquid.as_ref().map_or(0, |liquid| liquid.regions.len()), "[[liquid.region]]");
    /// A surface that moves with markers: `advect_markers`.
    markers: |scene, _| scene.liquid.as_ref().is_some_and(|liquid| liquid.surface != Surface::Fixed),
        |scene, _| surface(scene).to_owned();
    /// A level set on the grid, bounded by the markers: `advect_level` to `marker_band`, and `spray`.
    level: |scene, _| scene.liquid.as_ref().is_some_and(|liquid| liquid.surface == Surface::Level),
        |scene, _| surface(scene).to_owned();
    /// Second-order transport of the velocity (MacCormack), and its slope in the first layer of air.
    maccormack: |_, effects| effects.level,
        |scene, _| surface(scene).to_owned();
    /// Volume control: a source term in the right-hand side that restores the liquid volume.
    volume_control: |scene, effects| {
            effects.markers && !effects.level && controls_volume(scene)
        },
        |_, effects| match (effects.liquid, effects.markers, effects.volume_control) {
            (false, ..) => NO_LIQUID,
            (_, false, _) => "a fixed surface has a constant volume",
            (_, _, true) => "on by default with markers",
            (_, _, false) if effects.level => "liquid.surface = \"level\" shifts the level instead",
            (_, _, false) => "liquid.volume_control = false",
        }
        .to_owned();
    /// Control of the volume of every liquid component: a shift of the level, and a source where markers crowd.
    volume_shift: |scene, effects| effects.level && controls_volume(scene),
        |scene, effects| match (effects.level, effects.volume_shift) {
            (false, _) => surface(scene),
            (_, true) => "on by default with a level",
            (_, false) => "liquid.volume_control = false",
        }
        .to_owned();
    /// Liquid that leaves walls, obstacles and solids where its pressure would be negative.
    separation: |scene, effects| effects.markers && separation(scene) != Separation::None,
        |scene, effects| match separation(scene) {
            _ if !effects.markers => surface(scene),
            Separation::None => "liquid.separation = \"none\"",
            Separation::Walls => "liquid.separation = \"walls\"",
            Separation::FromAir => "liquid.separation = \"from_air\"",
        }
        .to_owned();
    /// Open sides of the domain: markers beyond them are deleted, and the controlled volume decreases with them.
    open_sides: |scene, _| scene.liquid.is_some() && scene.domain.open.any(),
        |scene, _| match scene.domain.open.any() {
            true => format!("domain.open: {}", scene.domain.open.names().collect::<Vec<_>>().join(", ")),
            false => "no sides in domain.open".to_owned(),
        };
    /// Sources: emitted markers, faces with prescribed flux, and an increase of the controlled volume.
    sources: |scene, _| !scene.sources.is_empty(),
        |scene, _| count(scene.sources.len(), "[[source]]");
    /// Sinks: cells that stay empty.
    sinks: |scene, _| !scene.sinks.is_empty(),
        |scene, _| count(scene.sinks.len(), "[[sink]]");
    /// Elastic solids: `move_solid`, `solid_matrices` and their solve.
    solids: |scene, _| !scene.solids.is_empty(),
        |scene, _| count(scene.solids.len(), "[[solid]]");
    /// Corotational strain: rotations of elements.
    corotation: |scene, _| any_solid(scene, corotational),
        |scene, _| count_solids(scene, corotational, "corotational", "model = \"linear\"");
    /// Damping of a solid, by its mass or by its stiffness.
    damping: |scene, _| any_solid(scene, damped),
        |scene, _| count_solids(scene, damped, "with damping", "no damping above zero");
    /// Constrained nodes.
    pins: |scene, _| any_solid(scene, pins),
        |scene, _| count_solids(scene, pins, "[[solid.pin]]", "no [[solid.pin]]");
    /// Nodes with prescribed motion, whose velocities are uploaded in every step.
    scripts: |scene, _| any_solid(scene, scripts),
        |scene, _| count_solids(scene, scripts, "[[solid.script]]", "no [[solid.script]]");
    /// Constant forces on nodes.
    loads: |scene, _| any_solid(scene, loads),
        |scene, _| count_solids(scene, loads, "[[solid.load]]", "no [[solid.load]]");
    /// Obstacles. With liquid: apertures from clipping, push-out, extension of the liquid distance, free slip. With
    /// solids: contact of nodes.
    obstacles: |scene, _| !scene.obstacles.is_empty(),
        |scene, _| count(scene.obstacles.len(), "[[obstacle]]");
    /// Moving obstacles in liquid: `clip` in every sub-step, their flux J v in the right-hand side, slip relative to
    /// their velocity.
    moving_obstacles: |scene, _| scene.liquid.is_some() && scene.obstacles_move(),
        |scene, effects| {
            let moving = scene.obstacles.iter().filter(|obstacle| obstacle.motion.is_some());
            match (moving.count(), effects.liquid) {
                (_, false) => NO_LIQUID.to_owned(),
                (0, _) => "no [[obstacle]] with keyframes".to_owned(),
                (n, _) => format!("{n} [[obstacle]] with keyframes"),
            }
        };
    /// Moving obstacles that push solids: their distance and motion in every sub-step.
    pushing_obstacles: |scene, effects| effects.solids && scene.obstacles_move(),
        |scene, effects| match (effects.solids, scene.obstacles_move()) {
            (false, _) => "there are no solids",
            (_, false) => "no [[obstacle]] with keyframes",
            (_, true) => "[[solid]] and [[obstacle]] with keyframes",
        }
        .to_owned();
    /// Contact of solids with each other: rows of all contacts in the solve of the solids.
    solid_contact: |scene, effects| effects.solids && scene.solver.solid_contact,
        |scene, effects| match (effects.solids, scene.solver.solid_contact) {
            (false, _) => "there are no solids",
            (_, false) if scene.solids.len() == 1 => "there is one solid, without friction and self_contact",
            (_, false) => "solver.solid_contact = false",
            (_, true) => "solver.solid_contact = true",
        }
        .to_owned();
    /// Friction of solids: tangential rows beside those of contact.
    friction: |scene, effects| effects.solid_contact && scene.has_friction(),
        |scene, effects| match (effects.solids, scene.has_friction()) {
            (false, _) => "there are no solids",
            (_, false) => "no friction above zero",
            (_, true) => "friction of solids, obstacles or walls",
        }
        .to_owned();
    /// Liquid and solids: `clip` in every sub-step, coupling matrix J, and one solve for both while they touch.
    coupling: |scene, effects| scene.liquid.is_some() && effects.solids,
        |_, effects| coupling(effects).to_owned();
    /// Variation of the pressure within cells, as forces on the nodes of the solids' patches.
    patch_correction: |scene, effects| {
            effects.coupling && scene.solver.pressure_on_patches != PatchPressure::Cell
        },
        |scene, effects| match scene.solver.pressure_on_patches {
            _ if !effects.coupling => coupling(effects),
            PatchPressure::Cell => "solver.pressure_on_patches = \"cell\"",
            PatchPressure::Hydrostatic => {
                "solver.pressure_on_patches = \"hydrostatic\": assumes that pressure grows with depth as at rest"
            }
            PatchPressure::Gradient => "solver.pressure_on_patches = \"gradient\"",
        }
        .to_owned();
    /// Probes: stage `probe` and a short readback.
    probes: |scene, _| !scene.probes.is_empty(),
        |scene, _| count(scene.probes.len(), "[[probe]]");
    /// Surface mesh of the liquid, which the host computes for every written frame.
    surface: |scene, _| scene.liquid.is_some() && scene.output.surface,
        |_, effects| match (effects.liquid, effects.surface) {
            (false, _) => NO_LIQUID,
            (_, false) => "output.surface is off",
            (_, true) => "output.surface = true: a mesh of each frame, made by the host",
        }
        .to_owned();
}

const NO_LIQUID: &str = "there is no liquid";

fn surface(scene: &Scene) -> &'static str {
    match scene.liquid.as_ref().map(|liquid| liquid.surface) {
        None => NO_LIQUID,
        Some(Surface::Markers) => "liquid.surface = \"markers\"",
        Some(Surface::Level) => "liquid.surface = \"level\"",
        Some(Surface::Fixed) => "liquid.surface = \"fixed\"",
    }
}

fn separation(scene: &Scene) -> Separation {
    let liquid = scene.liquid.as_ref();
    liquid.map_or(Separation::None, |liquid| liquid.separation)
}

fn controls_volume(scene: &Scene) -> bool {
    scene.liquid.as_ref().is_some_and(|liquid| liquid.volume_control)
}

fn count(n: usize, of: &str) -> String {
    match n {
        0 => format!("no {of} in the scene"),
        n => format!("{n} {of}"),
    }
}

fn any_solid(scene: &Scene, property: fn(&Solid) -> usize) -> bool {
    scene.solids.iter().any(|solid| property(solid) > 0)
}

fn count_solids(scene: &Scene, property: fn(&Solid) -> usize, some: &str, none: &str) -> String {
    match scene.solids.iter().map(property).sum() {
        _ if scene.solids.is_empty() => "there are no solids".to_owned(),
        0 => none.to_owned(),
        sum => format!("{sum} {some}"),
    }
}

fn corotational(solid: &Solid) -> usize {
    usize::from(solid.model == ElasticModel::Corotational)
}

fn damped(solid: &Solid) -> usize {
    usize::from(solid.mass_damping > 0.0 || solid.stiffness_damping > 0.0)
}

fn pins(solid: &Solid) -> usize {
    solid.pins.len() - scripts(solid)
}

fn scripts(solid: &Solid) -> usize {
    let pins = solid.pins.iter();
    pins.filter(|pin| !pin.keyframes.is_empty()).count()
}

fn loads(solid: &Solid) -> usize {
    solid.loads.len()
}

fn coupling(effects: &Effects) -> &'static str {
    match (effects.liquid, effects.solids) {
        (true, true) => "[liquid] and [[solid]]",
        (false, _) => NO_LIQUID,
        (true, false) => "there are no solids",
    }
}

impl Effects {
    /// Whether obstacles or solids cut the grid of the liquid.
    pub fn cuts(&self) -> bool {
        self.liquid && (self.obstacles || self.coupling)
    }

    /// Whether liquid enters or leaves the domain.
    pub fn exchange(&self) -> bool {
        self.open_sides || self.sources || self.sinks
    }

    /// Whether liquid may leave bodies, all of which are at rest.
    pub fn leaves_still_bodies(&self) -> bool {
        self.separation && self.obstacles && !self.clips()
    }

    /// Whether the cuts move: `clip` in every sub-step.
    pub fn clips(&self) -> bool {
        self.coupling || self.moving_obstacles
    }
}
