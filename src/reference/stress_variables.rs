//! Pressures and stresses as unknowns (thesis 5.3, after Robinson-Mosher et al. 2011): K = G^T G, z = G v.
//!
//! With D = zeta_M M and G scaled by the root of zeta_K, S = D + G^T G, and eliminating v leaves
//!
//! ```text
//! [B + J D^-1 J^T, -J D^-1 G^T; ., I + G D^-1 G^T] [p; z] = [E u* + J D^-1 w; -G D^-1 w],   v = D^-1 (J^T p - G^T z - w)
//! ```
//!
//! G has six rows per element: the root of its volume times L times its strain in its own frame. The thesis leaves
//! out the volume and the frame in (5.37), and the last block of L in (5.38) is 2 sqrt(mu) I.

use glam::DVec3;

use super::coupled_system::Blocks;
use crate::Error;
use crate::elastic::{Body, Deformation, Solids};
use crate::linalg::Csr;

/// G of all solids, with the root of zeta_K: six rows per element, three columns per node.
#[derive(Clone, Debug, PartialEq)]
pub struct StressVariables {
    matrix: Csr,
}

impl StressVariables {
    /// G of deformed elements, with the zeta_K (s) of each body.
    pub fn new(solids: &Solids, deformations: &[Deformation], zeta: impl Fn(&Body) -> f64) -> StressVariables {
        let n = 6 * solids.elements.len();
        let mut rows = Vec::new();
        let matrix = Csr::from_rows(n, 3 * solids.rest.len(), |row, entries| {
            let element = row / 6;
            if row % 6 == 0 {
                let zeta = zeta(solids.body_of_element(element));
                rows = element_rows(solids, element, &deformations[element], zeta);
            }
            entries.append(&mut rows[row % 6]);
        });
        StressVariables { matrix }
    }

    /// G.
    pub fn matrix(&self) -> &Csr {
        &self.matrix
    }

    /// G P, with P the projector on the free directions, and the matrix over pressures and stresses.
    ///
    /// # Errors
    /// When it does not fit into memory.
    pub fn system(&self, blocks: &Blocks) -> Result<(StressSystem, Csr), Error> {
        let n_z = self.matrix.n_rows();
        let g = self.matrix.product(&blocks.free)?;
        let inverse: Vec<f64> = blocks.mass.iter().map(|mass| 1.0 / mass).collect();
        let j_over_d = blocks.j.clone().scaled(&vec![1.0; blocks.cells.len()], &inverse);
        let g_over_d = g.clone().scaled(&vec![1.0; n_z], &inverse);
        let transposed = g.transpose();
        let pp = blocks.b.plus(1.0, &j_over_d.product(&blocks.j.transpose())?);
        let pz = j_over_d.product(&transposed)?;
        let pz = pz.scaled(&vec![-1.0; blocks.cells.len()], &vec![1.0; n_z]);
        let zz = Csr::diagonal_of(&vec![1.0; n_z]).plus(1.0, &g_over_d.product(&transposed)?);
        let matrix = Csr::bordered(&pp, &pz, 1.0, &zz);
        let system = StressSystem { j_over_d, g_over_d, inverse };
        Ok((system, matrix))
    }
}

/// Transformation between pressures and velocities, and pressures and stresses.
#[derive(Clone, Debug)]
pub struct StressSystem {
    j_over_d: Csr,
    g_over_d: Csr,
    inverse: Vec<f64>,
}

impl StressSystem {
    /// Right-hand side from that of B p + J v = e, S v - J^T p = -w, given as \[e; -w\].
    pub fn rhs(&self, rhs: &[f64]) -> Vec<f64> {
        let (e, minus_w) = rhs.split_at(self.j_over_d.n_rows());
        let mut flux = vec![0.0; e.len()];
        self.j_over_d.multiply(minus_w, &mut flux);
        let mut stress = vec![0.0; self.g_over_d.n_rows()];
        self.g_over_d.multiply(minus_w, &mut stress);
        let pressure_part = e.iter().zip(flux).map(|(e, flux)| e - flux);
        pressure_part.chain(stress).collect()
    }

    /// Pressures and velocities from pressures and stresses.
    pub fn unknowns(&self, x: &[f64], rhs: &[f64]) -> Vec<f64> {
        let (pressure, stress) = x.split_at(self.j_over_d.n_rows());
        let (mut pressure_part, mut stress_part) = (vec![0.0; self.inverse.len()], vec![0.0; self.inverse.len()]);
        self.j_over_d.transpose().multiply(pressure, &mut pressure_part);
        self.g_over_d.transpose().multiply(stress, &mut stress_part);
        let minus_w = &rhs[pressure.len()..];
        let velocity =
            (0..pressure_part.len()).map(|at| pressure_part[at] - stress_part[at] + minus_w[at] * self.inverse[at]);
        pressure.iter().copied().chain(velocity).collect()
    }
}

/// The six rows of an element, columns ascending.
fn element_rows(solids: &Solids, element: usize, deformation: &Deformation, zeta: f64) -> Vec<Vec<(usize, f64)>> {
    let body = solids.body_of_element(element);
    let (lambda, mu) = (body.lambda, body.mu);
    let factor = (zeta * solids.volume[element]).sqrt();
    // L of (5.38): L^T L = 2 mu I + lambda 1 1^T on the diagonal strains, 4 mu I on the others.
    let root = (2.0 * mu + lambda).sqrt();
    let square = (mu * mu + lambda * mu).sqrt();
    let upper = [
        [root, lambda / root, lambda / root],
        [0.0, 2.0 * square / root, lambda * mu / (square * root)],
        [0.0, 0.0, mu * (4.0 * mu * mu + 8.0 * lambda * mu + 3.0 * lambda * lambda).sqrt() / (square * root)],
    ];
    let mut rows = vec![Vec::new(); 6];
    let mut corners: Vec<(usize, DVec3)> = solids.elements[element]
        .iter()
        .zip(solids.gradients[element])
        .map(|(&node, gradient)| (node as usize, gradient))
        .collect();
    corners.sort_by_key(|corner| corner.0);
    for (node, gradient) in corners {
        for axis in 0..3 {
            // A unit velocity along an axis, in the frame of the element.
            let turned = deformation.rotation.transpose() * DVec3::AXES[axis];
            let straight = turned * gradient;
            let shear = |i: usize, j: usize| 0.5 * (turned[i] * gradient[j] + turned[j] * gradient[i]);
            let across = [shear(1, 2), shear(0, 2), shear(0, 1)];
            for k in 0..3 {
                let value = DVec3::from(upper[k]).dot(straight);
                rows[k].push((3 * node + axis, factor * value));
                rows[3 + k].push((3 * node + axis, factor * 2.0 * mu.sqrt() * across[k]));
            }
        }
    }
    rows
}
