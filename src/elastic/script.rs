//! Motion of scripted nodes.

use glam::{DQuat, DVec3};

use super::{Script, Solids};
use crate::scene::{Acceleration, Keyframe, Scene};

impl Solids {
    /// Upper bound of the speed of scripted nodes between a time and `span` (both s) later, m/s.
    pub fn max_script_speed(&self, time: f64, span: f64) -> f64 {
        let speeds =
            self.scripts_and_radii().map(|(script, radius)| Keyframe::max_speed(&script.keyframes, radius, time, span));
        speeds.fold(0.0, f64::max)
    }

    /// Prescribed accelerations of all scripted nodes.
    pub fn accelerations(&self) -> Vec<Acceleration> {
        let scripts = self.scripts_and_radii();
        let of = scripts.map(|(script, radius)| Keyframe::accelerations(&script.keyframes, radius));
        of.flatten().collect()
    }

    /// Copies the keyframes of the scripts of a scene that has the same solids otherwise.
    pub fn follow(&mut self, scene: &Scene) {
        let pins = scene.solids.iter().flat_map(|solid| &solid.pins);
        let scripted = pins.filter(|pin| !pin.keyframes.is_empty());
        for (script, pin) in self.scripts.iter_mut().zip(scripted) {
            script.keyframes.clone_from(&pin.keyframes);
        }
    }

    /// The scripts, with the largest distance of their nodes to the centre, m.
    fn scripts_and_radii(&self) -> impl Iterator<Item = (&Script, f64)> {
        self.scripts.iter().map(|script| {
            let nodes = script.nodes.iter();
            let arms = nodes.map(|&node| self.rest[node as usize].distance(script.centre));
            (script, arms.fold(0.0, f64::max))
        })
    }
}

impl Script {
    /// Displacement (m) at a time (s) of a node with rest position `rest` (m): rotation about the centre, then translation.
    /// Both are linear between keyframes and constant outside.
    pub fn displacement(&self, rest: DVec3, time: f64) -> DVec3 {
        let (turn, translate) = Keyframe::pose(&self.keyframes, time);
        let arm = rest - self.centre;
        let turned = DQuat::from_scaled_axis(turn) * arm;
        (turned - arm) + translate
    }

    /// Initial velocity, m/s: difference quotient over a millionth of the time to the next keyframe.
    pub(super) fn velocity(&self, rest: DVec3, time: f64) -> DVec3 {
        let next = Keyframe::next_time(&self.keyframes, time);
        next.map_or(DVec3::ZERO, |next| {
            let span = 1e-6 * (next - time);
            (self.displacement(rest, time + span) - self.displacement(rest, time)) / span
        })
    }
}
