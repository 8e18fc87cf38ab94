//! `right_hand_side`, for solids in liquid: forces of the pressure's variation within cells.
//!
//! J^T p assumes a constant pressure per cell. The first-order error is the gradient times the vector from the centre
//! to the patch, so the force on the nodes increases by
//!
//! ```text
//! f_i = sum over the patches of active cells of the integral of N_i (grad p . (x - x_cell)) n dA
//! ```
//!
//! with n into the solid. N_i is linear on a patch, so the integrals are exact. Matrix and liquid are unchanged. Where liquid separates
//! its pressure is 0 in the whole cell: cells that separate in a sub-step have no such force ([`Separation`](super::Separation)).

use glam::DVec3;

use super::pressure_system::Stencil;
use crate::geometry::Patch;
use crate::grid::{Axis, Grid};

/// Forces on nodes, by the cell that exerts them.
#[derive(Clone, Debug, Default)]
pub struct PatchForces {
    n_nodes: usize,
    /// Cell, node, force in N.
    parts: Vec<(usize, usize, DVec3)>,
}

impl PatchForces {
    /// Forces of some cells on all nodes, N.
    pub fn sum_over(&self, counts: impl Fn(usize) -> bool) -> Vec<DVec3> {
        let mut forces = vec![DVec3::ZERO; self.n_nodes];
        for &(_, node, force) in self.parts.iter().filter(|(cell, ..)| counts(*cell)) {
            forces[node] += force;
        }
        forces
    }

    /// Whether a cell exerts one.
    pub fn has(&self, counts: impl Fn(usize) -> bool) -> bool {
        self.parts.iter().any(|(cell, ..)| counts(*cell))
    }
}

/// The forces of all active cells. `triangles`: nodes of the triangles with patches; `gradient`: grad p of a cell, Pa/m.
pub fn patch_pressure(
    stencil: &Stencil,
    patches: &[Patch],
    triangles: &[[u32; 3]],
    n_nodes: usize,
    gradient: impl Fn(usize) -> DVec3,
) -> PatchForces {
    let grid = &stencil.grid;
    let mut parts = Vec::new();
    for patch in patches.iter().filter(|patch| stencil.active(patch.cell)) {
        let slope = gradient(patch.cell);
        let way = patch.centroid - grid.cell_centre(grid.cell_at(patch.cell));
        let corners = patch.barycentric.into_iter().zip(patch.moments);
        for ((weight, moment), node) in corners.zip(triangles[patch.triangle]) {
            let excess = slope.dot(weight * patch.area * way + moment);
            parts.push((patch.cell, node as usize, excess * patch.normal));
        }
    }
    PatchForces { n_nodes, parts }
}

/// Gradient of a sub-step's pressure at a cell's centre, Pa/m, from active neighbours across open faces. Along an
/// axis without one, and in inactive cells, `at_rest`.
pub fn pressure_gradient(
    grid: &Grid,
    open: &[Vec<f64>; 3],
    active: &[bool],
    pressure: &[f64],
    at_rest: DVec3,
    cell: usize,
) -> DVec3 {
    if !active[cell] {
        return at_rest;
    }
    DVec3::from(Axis::ALL.map(|axis| {
        let a = axis.index();
        let slope = |side: usize| {
            let mut face = grid.cell_at(cell);
            face[a] += side;
            let neighbour = grid.face_sides(axis, face)[side]?;
            let known = open[a][grid.face(axis, face)] > 0.0 && active[neighbour];
            let way = if side == 1 { grid.dx } else { -grid.dx };
            known.then(|| (pressure[neighbour] - pressure[cell]) / way)
        };
        match [slope(0), slope(1)] {
            [Some(minus), Some(plus)] => 0.5 * (minus + plus),
            [Some(slope), None] | [None, Some(slope)] => slope,
            [None, None] => at_rest[a],
        }
    }))
}
