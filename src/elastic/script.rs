//! Motions of prescribed nodes.

use glam::{DQuat, DVec3};

use super::Script;
use crate::scene::Keyframe;

impl Script {
    /// Displacement of a node that rests at `rest` (m) at a time (s), m: turned about the centre, then moved. Translation and
    /// turn (axis times angle) are linear between keyframes; before the first and after the last, nothing moves.
    pub fn displacement(&self, rest: DVec3, time: f64) -> DVec3 {
        let (turn, translate) = Keyframe::pose(&self.keyframes, time);
        let arm = rest - self.centre;
        let turned = DQuat::from_scaled_axis(turn) * arm;
        (turned - arm) + translate
    }

    /// Velocity at a time before the first step, m/s, over a millionth of the way to the next keyframe.
    pub(super) fn velocity(&self, rest: DVec3, time: f64) -> DVec3 {
        let next = Keyframe::next_time(&self.keyframes, time);
        next.map_or(DVec3::ZERO, |next| {
            let span = 1e-6 * (next - time);
            (self.displacement(rest, time + span) - self.displacement(rest, time)) / span
        })
    }
}
