//! Motions of prescribed nodes.

use glam::{DQuat, DVec3};

use super::{Script, Solids};
use crate::scene::Keyframe;

impl Solids {
    /// The speed that no scripted node is above from a time on for so long (both s), m/s.
    pub fn max_script_speed(&self, time: f64, span: f64) -> f64 {
        let speed = |script: &Script| {
            let nodes = script.nodes.iter();
            let arms = nodes.map(|&node| self.rest[node as usize].distance(script.centre));
            script.max_speed(arms.fold(0.0, f64::max), time, span)
        };
        self.scripts.iter().map(speed).fold(0.0, f64::max)
    }
}

impl Script {
    /// Displacement of a node that rests at `rest` (m) at a time (s), m: turned about the centre, then moved. Translation and
    /// turn (axis times angle) are linear between keyframes; before the first and after the last, nothing moves.
    pub fn displacement(&self, rest: DVec3, time: f64) -> DVec3 {
        let (turn, translate) = Keyframe::pose(&self.keyframes, time);
        let arm = rest - self.centre;
        let turned = DQuat::from_scaled_axis(turn) * arm;
        (turned - arm) + translate
    }

    /// The speed that no component of its nodes is above from a time on for so long (both s), m/s; `radius`: of the farthest node from
    /// the centre, m.
    fn max_speed(&self, radius: f64, time: f64, span: f64) -> f64 {
        let frames = self.keyframes.windows(2);
        let met = frames.filter(|pair| pair[1].time > time && pair[0].time < time + span);
        let speeds = met.map(|pair| {
            let turn = |frame: &Keyframe| frame.angle * frame.axis;
            let way = pair[1].translate.distance(pair[0].translate)
                + turn(&pair[1]).distance(turn(&pair[0])) * radius;
            way / (pair[1].time - pair[0].time)
        });
        speeds.fold(0.0, f64::max)
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
