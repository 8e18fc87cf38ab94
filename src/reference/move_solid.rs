//! `move_solid`: nodes move with their velocities, then out of walls.

use super::turn_solids;
use crate::elastic::Solids;
use crate::grid::Grid;

/// u += dt v, after [`turn_solids`]. Then a node beyond a wall of the domain is put on the wall and loses its velocity into it: the solve
/// held it there, up to rounding, to the circles on which bodies turn, and to searches for contacts that did not end. Prescribed components
/// move, but nothing stops them. Nodes inside obstacles stay, as where surfaces curve: the next solve takes them out with what lies behind,
/// where putting a node on the surface by itself would squeeze it.
///
/// `displacement` (m) and `velocity` (m/s): of all nodes, in place.
pub fn move_solid(
    solids: &Solids,
    grid: &Grid,
    dt: f64,
    displacement: &mut [[f64; 3]],
    velocity: &mut [[f64; 3]],
) {
    turn_solids(solids, dt, displacement, velocity);
    for (node, (u, v)) in displacement.iter_mut().zip(velocity).enumerate() {
        let free = solids.prescribed[node].map(|prescribed| !prescribed);
        let rest = solids.rest[node];
        for axis in 0..3 {
            u[axis] += dt * v[axis];
            let x = rest[axis] + u[axis];
            let wall = x.clamp(0.0, grid.size()[axis]);
            if free[axis] && wall != x {
                u[axis] = wall - rest[axis];
                v[axis] = if x < wall {
                    v[axis].max(0.0)
                } else {
                    v[axis].min(0.0)
                };
            }
        }
    }
}
