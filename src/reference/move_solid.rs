//! `move_solid`: moves the nodes and projects them out of walls.

use glam::DVec3;

use super::turn_solids;
use crate::elastic::Solids;
use crate::grid::Grid;

/// u += dt v, after [`turn_solids`], and dt^2 g / 2 for ballistic bodies. A node beyond a domain wall is projected onto it and loses its velocity into it.
/// The solve constrains such nodes; the remainder is rounding, rotation on circles, or an unfinished active-set
/// search. Prescribed components move freely. Nodes inside obstacles, for example near curved surfaces, remain. The
/// next solve pushes them out with the elements behind; a projection of the node alone would compress these.
///
/// `falls`: gravity (m/s^2), and which bodies are ballistic. `displacement` (m) and `velocity` (m/s) of all nodes are updated in place.
pub fn move_solid(
    solids: &Solids,
    grid: &Grid,
    dt: f64,
    falls: (DVec3, &[bool]),
    displacement: &mut [[f64; 3]],
    velocity: &mut [[f64; 3]],
) {
    turn_solids(solids, dt, displacement, velocity);
    let (gravity, ballistic) = falls;
    let mut fall = vec![DVec3::ZERO; displacement.len()];
    for (body, _) in solids.bodies.iter().zip(ballistic).filter(|(_, falls)| **falls) {
        fall[body.nodes.clone()].fill(0.5 * dt * dt * gravity);
    }
    for (node, (u, v)) in displacement.iter_mut().zip(velocity).enumerate() {
        let free = solids.prescribed[node].map(|prescribed| !prescribed);
        let rest = solids.rest[node];
        for axis in 0..3 {
            u[axis] += dt * v[axis] + fall[node][axis];
            let x = rest[axis] + u[axis];
            let wall = x.clamp(0.0, grid.size()[axis]);
            if free[axis] && wall != x {
                u[axis] = wall - rest[axis];
                v[axis] = if x < wall { v[axis].max(0.0) } else { v[axis].min(0.0) };
            }
        }
    }
}
