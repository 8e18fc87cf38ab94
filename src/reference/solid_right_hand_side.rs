//! `right_hand_side`, for solids: the right-hand side of S v.

use glam::DVec3;

use super::SolidMatrices;
use crate::elastic::Solids;

/// The right-hand side of a step, N.
#[derive(Clone, Debug)]
pub struct SolidRightHandSide {
    /// M v*/dt - (K x* - b) + load per node; 0 in prescribed components.
    pub values: Vec<[f64; 3]>,
    /// ||M v*/dt|| + ||K x* - b|| + ||load|| over the free components: scale of the rounding error.
    pub scale: f64,
}

impl SolidRightHandSide {
    /// Adds forces on all nodes, N, except in prescribed components.
    pub fn add(&mut self, solids: &Solids, forces: &[DVec3]) {
        let mut squares = 0.0;
        let nodes = self.values.iter_mut().zip(forces).zip(&solids.prescribed);
        for ((values, force), prescribed) in nodes {
            for axis in (0..3).filter(|&axis| !prescribed[axis]) {
                values[axis] += force[axis];
                squares += force[axis] * force[axis];
            }
        }
        self.scale += squares.sqrt();
    }
}

/// The right-hand side from v* (m/s, of all nodes).
pub fn solid_right_hand_side(
    solids: &Solids,
    matrices: &SolidMatrices,
    velocity: &[[f64; 3]],
    dt: f64,
) -> SolidRightHandSide {
    let mut elastic = vec![DVec3::ZERO; solids.rest.len()];
    for (corners, forces) in solids.elements.iter().zip(&matrices.element_forces) {
        for (&node, &force) in corners.iter().zip(forces) {
            elastic[node as usize] += force;
        }
    }
    let mut squares = DVec3::ZERO;
    let values = (0..solids.rest.len()).map(|node| {
        let inertia = solids.mass[node] / dt * DVec3::from(velocity[node]);
        let load = solids.load[node];
        std::array::from_fn(|axis| {
            if solids.prescribed[node][axis] {
                return 0.0;
            }
            let terms = DVec3::new(inertia[axis], elastic[node][axis], load[axis]);
            squares += terms * terms;
            terms.x - terms.y + terms.z
        })
    });
    let values = values.collect();
    SolidRightHandSide { values, scale: squares.x.sqrt() + squares.y.sqrt() + squares.z.sqrt() }
}
