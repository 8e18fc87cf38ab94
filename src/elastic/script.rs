//! Motions of prescribed nodes.

use glam::{DQuat, DVec3};

use super::Script;
use crate::scene::Keyframe;

impl Script {
    /// Displacement of a node that rests at `rest` (m) at a time (s), m: turned about the centre, then moved. Translation and
    /// turn (axis times angle) are linear between keyframes; before the first and after the last, nothing moves.
    pub fn displacement(&self, rest: DVec3, time: f64) -> DVec3 {
        let after = self.keyframes.partition_point(|frame| frame.time <= time);
        let last = self.keyframes.len() - 1;
        let [a, b] = [after.saturating_sub(1), after.min(last)].map(|frame| &self.keyframes[frame]);
        let turn = |frame: &Keyframe| frame.angle * frame.axis;
        let share = if b.time > a.time {
            (time - a.time) / (b.time - a.time)
        } else {
            0.0
        };
        let arm = rest - self.centre;
        let turned = DQuat::from_scaled_axis(turn(a).lerp(turn(b), share)) * arm;
        (turned - arm) + a.translate.lerp(b.translate, share)
    }

    /// Velocity at a time before the first step, m/s, over a millionth of the way to the next keyframe.
    pub(super) fn velocity(&self, rest: DVec3, time: f64) -> DVec3 {
        let next = self.keyframes.iter().find(|frame| frame.time > time);
        next.map_or(DVec3::ZERO, |next| {
            let span = 1e-6 * (next.time - time);
            (self.displacement(rest, time + span) - self.displacement(rest, time)) / span
        })
    }
}
