//! `forces`, for solids: gravity on the nodes, and prescribed velocities.

use glam::DVec3;

use crate::elastic::Solids;

/// v* += dt g in free components; prescribed components are set to `prescribed`, or to 0 if it is empty. Velocities
/// of all nodes, m/s.
pub fn node_forces(solids: &Solids, prescribed: &[[f64; 3]], gravity: DVec3, dt: f64, velocity: &mut [[f64; 3]]) {
    for (node, v) in velocity.iter_mut().enumerate() {
        for axis in 0..3 {
            if solids.prescribed[node][axis] {
                v[axis] = prescribed.get(node).map_or(0.0, |prescribed| prescribed[axis]);
            } else {
                v[axis] += dt * gravity[axis];
            }
        }
    }
}
