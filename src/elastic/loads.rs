//! Forces on nodes that change over time.

use super::Solids;
use crate::scene::VectorKeyframe;

/// A load over time.
#[derive(Clone, Debug)]
pub struct TimedLoad {
    /// Nodes and their weights: 1 for a force, areas (m^2) for a traction.
    pub weights: Vec<(u32, f64)>,
    /// Divisor of the weights: the nodes of a force, 1 for a traction.
    pub divisor: f64,
    /// Total force, N, or traction, Pa.
    pub keyframes: Vec<VectorKeyframe>,
}

impl Solids {
    /// Sets the loads to the mean between two times (s). Returns whether loads change over time.
    pub fn set_load(&mut self, times: [f64; 2]) -> bool {
        let timed = !self.timed_loads.is_empty();
        if timed {
            self.load.clone_from(&self.constant_load);
        }
        for load in &self.timed_loads {
            let value = VectorKeyframe::mean(&load.keyframes, times);
            for &(node, weight) in &load.weights {
                self.load[node as usize] += weight * value / load.divisor;
            }
        }
        timed
    }
}
