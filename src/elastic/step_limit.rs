//! How long a sub-step solids bear.

use glam::DVec3;

use super::{Body, Solids};

/// Part of a body's height that contact may press it by.
const PRESSED: f64 = 0.01;
/// Part of a brick that a node may cross in a sub-step: what goes deeper into a wall is strained by the way out.
const CROSSED: f64 = 0.2;
/// Part of a body's height in which lie the nodes that it stands on.
const SOLE: f64 = 0.05;

/// Limits of the sub-step that walls and obstacles set, since they stop nodes after a solve that knows nothing of them. A body of mass M
/// on nodes of mass m gives these its weight: within dt they gain (M/m) g dt, and are put back by (M/m) g dt (dt + tau_K) at the end, which
/// is what the body is pressed by, whatever its stiffness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepLimit {
    /// For bodies that stand, s; infinite without weight.
    standing: f64,
    /// Edge of the least brick, m, six mean elements of a body large; infinite without solids.
    brick: f64,
}

impl StepLimit {
    /// Of all solids under a gravity, m/s^2. Bodies of which a node is held against it do not stand.
    pub fn new(solids: &Solids, gravity: DVec3) -> StepLimit {
        let least = |numbers: &mut dyn Iterator<Item = f64>| numbers.fold(f64::INFINITY, f64::min);
        let bodies = || solids.bodies.iter();
        StepLimit {
            standing: least(&mut bodies().map(|body| standing(solids, body, gravity))),
            brick: least(&mut bodies().map(|body| {
                let volume: f64 = solids.volume[body.elements.clone()].iter().sum();
                (6.0 * volume / body.elements.len() as f64).cbrt()
            })),
        }
    }

    /// The longest sub-step, s, where nodes move at most at a speed, m/s.
    pub fn longest(&self, speed: f64) -> f64 {
        self.standing.min(CROSSED * self.brick / speed)
    }
}

/// dt of (M/m) g dt (dt + tau_K) = PRESSED times the height; infinite for what is held or weighs nothing.
fn standing(solids: &Solids, body: &Body, gravity: DVec3) -> f64 {
    let g = gravity.length();
    let along = |axis: usize| gravity[axis] != 0.0;
    let mut nodes = body.nodes.clone();
    let held = nodes.any(|node| (0..3).any(|axis| along(axis) && solids.prescribed[node][axis]));
    if g == 0.0 || held {
        return f64::INFINITY;
    }
    let height = |node: usize| -solids.rest[node].dot(gravity) / g;
    let heights = body.nodes.clone().map(height);
    let low = heights.clone().fold(f64::INFINITY, f64::min);
    let size = heights.fold(f64::NEG_INFINITY, f64::max) - low;
    let standing = |node: &usize| height(*node) <= low + SOLE * size;
    let sum =
        |nodes: &mut dyn Iterator<Item = usize>| nodes.map(|node| solids.mass[node]).sum::<f64>();
    let ratio = sum(&mut body.nodes.clone()) / sum(&mut body.nodes.clone().filter(standing));
    let square = PRESSED * size / (ratio * g);
    let half = 0.5 * body.stiffness_damping;
    // The positive root of dt^2 + 2 half dt = square, without cancellation.
    square / (half + (half * half + square).sqrt())
}
