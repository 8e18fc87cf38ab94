//! Motion of scripted nodes.

use glam::{DQuat, DVec3};

use super::{Script, Solids};
use crate::scene::Keyframe;

impl Solids {
    /// Upper bound of the speed of scripted nodes between a time and `span` (both s) later, m/s.
    pub fn max_script_speed(&self, time: f64, span: f64) -> f64 {
        self.max_of_scripts(|keyframes, radius| Keyframe::max_speed(keyframes, radius, time, span))
    }

    /// Largest acceleration of scripted nodes until a time (s), m/s^2.
    pub fn max_script_acceleration(&self, until: f64) -> f64 {
        self.max_of_scripts(|keyframes, radius| {
            Keyframe::max_acceleration(keyframes, radius, until)
        })
    }

    /// Largest value over the scripts of a function of the keyframes and of the largest distance to the centre (m).
    fn max_of_scripts(&self, of: impl Fn(&[Keyframe], f64) -> f64) -> f64 {
        let values = self.scripts.iter().map(|script| {
            let nodes = script.nodes.iter();
            let arms = nodes.map(|&node| self.rest[node as usize].distance(script.centre));
            of(&script.keyframes, arms.fold(0.0, f64::max))
        });
        values.fold(0.0, f64::max)
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
