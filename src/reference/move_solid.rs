//! `move_solid`: nodes move with their velocities, then out of walls and obstacles.

use glam::DVec3;

use super::sample::normal;
use super::turn_solids;
use crate::elastic::Solids;
use crate::grid::Grid;

/// How often a node inside an obstacle is put on its surface.
const PUSHES: usize = 2;

/// u += dt v, after [`turn_solids`]. Then a node beyond a wall of the domain is put on the wall, and one inside an obstacle on its surface along the gradient
/// of the interpolated distance, as far as that is in the domain; both lose their velocity into what they touch. Prescribed components
/// move, but nothing stops them. What the solve held is where it should be: this is for what it did not foresee, as surfaces that curve.
/// A node without a velocity was inside before, as solids may start in obstacles: contact takes it out in the solve, which moves its body
/// with it, where putting it on the surface by itself would squeeze what lies behind.
///
/// `displacement` (m) and `velocity` (m/s): of all nodes, in place; `solid_distance`: per cell, m.
pub fn move_solid(
    solids: &Solids,
    grid: &Grid,
    solid_distance: &[f64],
    dt: f64,
    displacement: &mut [[f64; 3]],
    velocity: &mut [[f64; 3]],
) {
    turn_solids(solids, dt, displacement, velocity);
    for (node, (u, v)) in displacement.iter_mut().zip(velocity).enumerate() {
        let free = solids.prescribed[node].map(|prescribed| !prescribed);
        let rest = solids.rest[node];
        let out_of_walls = |u: &mut [f64; 3], v: &mut [f64; 3]| {
            for axis in (0..3).filter(|&axis| free[axis]) {
                let x = rest[axis] + u[axis];
                let wall = x.clamp(0.0, grid.size()[axis]);
                if wall != x {
                    u[axis] = wall - rest[axis];
                    v[axis] = if x < wall {
                        v[axis].max(0.0)
                    } else {
                        v[axis].min(0.0)
                    };
                }
            }
        };
        for axis in 0..3 {
            u[axis] += dt * v[axis];
        }
        out_of_walls(u, v);
        if *v == [0.0; 3] {
            continue;
        }
        for _ in 0..PUSHES {
            let x = rest + DVec3::from(*u);
            let depth = grid.sample_cells(solid_distance, x);
            if depth >= 0.0 {
                break;
            }
            let Some(outwards) = normal(grid, solid_distance, x) else {
                break;
            };
            let inwards = DVec3::from(*v).dot(outwards).min(0.0);
            for axis in (0..3).filter(|&axis| free[axis]) {
                u[axis] -= depth * outwards[axis];
                v[axis] -= inwards * outwards[axis];
            }
            out_of_walls(u, v);
        }
    }
}
