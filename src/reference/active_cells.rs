//! `active_cells`: unknowns of the projection, weights of their faces, and enclosed components.
//!
//! A cell is active where the liquid distance phi is negative and a face is open. The weight of a face between active
//! cells is its aperture. A face is towards air if phi_nb >= 0 in the other cell. There the ghost fluid method (Gibou
//! et al. 2002; thesis 4.43) sets p = 0 at the surface. The face adds aperture / theta to the Dirichlet term. On an
//! open side of the domain p = 0 in the plane of the side, half a cell from the centre: aperture / (1/2).

use super::pressure_system::Stencil;
use crate::geometry::Coupling;
use crate::grid::{Axis, Grid};
use crate::scene::ThetaFloor;

/// The unknowns of a projection.
#[derive(Clone, Debug)]
pub struct ActiveCells {
    /// The operator over them.
    pub stencil: Stencil,
    /// Cells of each enclosed liquid component, ascending. The level of their pressure is undetermined.
    pub closed: Vec<Vec<usize>>,
    /// Cells of each enclosed component whose pressure level the motion of solids determines; none without solids.
    pub sealed: Vec<Vec<usize>>,
}

impl ActiveCells {
    /// The active cells of an operator, and its enclosed components.
    pub fn new(stencil: Stencil) -> ActiveCells {
        let closed = closed_components(&stencil);
        ActiveCells { stencil, closed, sealed: Vec::new() }
    }

    /// Moves enclosed components with a patch on a free node from `closed` to `sealed`. `prescribed`: components of
    /// the nodes.
    pub fn seal(&mut self, coupling: &Coupling, prescribed: &[[bool; 3]]) {
        let gives_way = |component: &[usize]| {
            let mut pairs = component.iter().flat_map(|&cell| coupling.cell_pairs(cell));
            pairs.any(|pair| (0..3).any(|axis| !prescribed[pair.node][axis] && pair.value[axis] != 0.0))
        };
        let closed = std::mem::take(&mut self.closed);
        let (sealed, closed) = closed.into_iter().partition(|cells| gives_way(cells));
        (self.sealed, self.closed) = (sealed, closed);
    }
}

/// Distance of the surface from an inside centre (`inside` < 0), as a fraction of that to an outside one (`outside`
/// >= 0), at least `floor`. The matrix and the velocity update share it.
#[inline]
pub fn theta(inside: f64, outside: f64, floor: f64) -> f64 {
    (inside / (inside - outside)).max(floor)
}

/// Theta on an open side of the domain.
pub(super) const THETA_OF_SIDES: f64 = 0.5;

/// Computes the active cells. `open`: face apertures, 0 on walls; `liquid_distance`: phi per cell, m.
pub fn active_cells(
    grid: &Grid,
    open: &[Vec<f64>; 3],
    liquid_distance: &[f64],
    theta_floor: impl Into<ThetaFloor>,
) -> ActiveCells {
    let theta_floor = theta_floor.into();
    let mut weight = Axis::ALL.map(|axis| vec![0.0; grid.n_faces(axis)]);
    let mut dirichlet = vec![0.0; grid.n_cells()];
    for axis in Axis::ALL {
        let a = axis.index();
        for (face, &fraction) in open[a].iter().enumerate().filter(|(_, fraction)| **fraction > 0.0) {
            let sides = grid.face_sides(axis, grid.face_at(axis, face));
            let [Some(minus), Some(plus)] = sides else {
                let inside = sides.into_iter().flatten();
                inside
                    .filter(|&cell| liquid_distance[cell] < 0.0)
                    .for_each(|cell| dirichlet[cell] += fraction / THETA_OF_SIDES);
                continue;
            };
            let phi = [liquid_distance[minus], liquid_distance[plus]];
            match [phi[0] < 0.0, phi[1] < 0.0] {
                [true, true] => weight[a][face] = fraction,
                [true, false] => dirichlet[minus] += fraction / theta(phi[0], phi[1], theta_floor.of(fraction)),
                [false, true] => dirichlet[plus] += fraction / theta(phi[1], phi[0], theta_floor.of(fraction)),
                [false, false] => {}
            }
        }
    }
    ActiveCells::new(Stencil::new(*grid, weight, dirichlet))
}

/// Components without a Dirichlet term.
pub(super) fn closed_components(stencil: &Stencil) -> Vec<Vec<usize>> {
    let mut closed = components(stencil);
    closed.retain(|component| component.iter().all(|&cell| stencil.dirichlet[cell] == 0.0));
    closed
}

/// Components of active cells, ascending, by flood fill over faces with weight.
pub(super) fn components(stencil: &Stencil) -> Vec<Vec<usize>> {
    let mut seen = vec![false; stencil.grid.n_cells()];
    let mut components = Vec::new();
    for seed in 0..seen.len() {
        if seen[seed] || !stencil.active(seed) {
            continue;
        }
        seen[seed] = true;
        let mut component = vec![seed];
        let mut next = 0;
        while next < component.len() {
            for (neighbour, weight) in stencil.neighbours(component[next]) {
                if weight > 0.0 && !seen[neighbour] {
                    seen[neighbour] = true;
                    component.push(neighbour);
                }
            }
            next += 1;
        }
        component.sort_unstable();
        components.push(component);
    }
    components
}
