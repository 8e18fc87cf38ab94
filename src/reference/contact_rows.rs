//! `solve`, for solids that touch each other: velocities under unilateral rows.
//!
//! A row is n . (v_a - v_b) >= -gap / dt for two points of different bodies, or of a body and a wall or obstacle, each a
//! weighted mean of nodes. With all rows G v >= r, the velocities minimise phi(v) = v . S v / 2 - F . v. Then S v = F + G^T
//! lambda with 0 <= lambda, complementary to G v - r, and lambda solves the complementarity problem of G S^-1 G^T, dense and
//! small. S^-1 G^T is computed by the factor of S.
//!
//! Where bodies overlap, r = 0 instead of -gap / dt: the velocity does not push them out, so that v = 0 remains admissible and
//! phi, which is 0 at rest, does not grow. Walls and obstacles push nodes out, as they do without contact of solids.

use glam::DVec3;

use super::solid_contacts::Contacts;
use super::solid_system::SolidSystem;
use super::solve_solid::SolidSolver;
use crate::Error;
use crate::elastic::Solids;
use crate::geometry::contact_pairs;
use crate::linalg::complementarity;
use crate::scene::Solver;
use crate::state::{ContactReport, SolveReport};

/// Distance within which rows are set up: this times dt times the largest speed, since both bodies may move.
const REACH: f64 = 2.0;
/// And at least this, in cells.
const LEAST_REACH: f64 = 0.05;
/// Relative increase of the diagonal of G S^-1 G^T: redundant rows share their force.
const COMPLIANCE: f64 = 1e-11;

/// A unilateral row: sum of n_i . v_i over nodes >= least.
#[derive(Clone, Debug)]
pub(super) struct Row {
    pub(super) nodes: Vec<(usize, DVec3)>,
    /// m/s
    pub(super) least: f64,
}

impl Row {
    fn product(&self, v: &[f64]) -> f64 {
        let nodes = self.nodes.iter();
        nodes
            .map(|(node, n)| n.dot(DVec3::from_slice(&v[3 * node..])))
            .sum()
    }
}

/// Velocities of all nodes (m/s) under the rows of `contacts` and of the bodies with each other. `system` without
/// constraints of contact, afterwards with the contact forces; `positions` in m, `dx` a cell.
///
/// # Errors
/// When the factor does not fit into memory.
pub(super) fn solve_in_rows(
    solver: &SolidSolver,
    (solids, system): (&Solids, &mut SolidSystem),
    (contacts, positions): (&Contacts, &[DVec3]),
    dx: f64,
    settings: &Solver,
) -> Result<(Vec<[f64; 3]>, SolveReport, ContactReport), Error> {
    let (free, report) = solver.solve(solids, system, settings)?;
    let dt = system.dt();
    let speeds = free.iter().map(|v| DVec3::from(*v).length());
    let reach = (REACH * dt * speeds.fold(0.0, f64::max)).max(LEAST_REACH * dx);
    let mut rows = contacts.rows(reach);
    let bodies: Vec<_> = (solids.bodies.iter())
        .map(|body| body.triangles.clone())
        .collect();
    for pair in contact_pairs(positions, &solids.triangles, &bodies, reach) {
        let nodes = pair.points.iter();
        rows.push(Row {
            nodes: nodes
                .map(|&(node, weight)| (node as usize, weight * pair.normal))
                .collect(),
            least: -pair.gap.max(0.0) / dt,
        });
    }
    let none = ContactReport {
        solves: 1,
        unsettled: 0,
    };
    let flat = free.as_flattened();
    if rows.iter().all(|row| row.product(flat) >= row.least) {
        return Ok((free, report, none));
    }
    let Some(factor) = solver.factorise(system)? else {
        return Ok((free, report, none));
    };
    let components = system.components();
    let mut column = vec![0.0; flat.len()];
    let columns: Vec<Vec<f64>> = (rows.iter())
        .map(|row| {
            for &(node, n) in &row.nodes {
                column[3 * node..3 * node + 3].copy_from_slice(&n.to_array());
            }
            let mut x: Vec<f64> = components.iter().map(|&at| column[at]).collect();
            factor.solve(&mut x);
            for &(node, _) in &row.nodes {
                column[3 * node..3 * node + 3].fill(0.0);
            }
            let mut full = vec![0.0; flat.len()];
            components.iter().zip(x).for_each(|(&at, x)| full[at] = x);
            full
        })
        .collect();
    let n = rows.len();
    let mut matrix = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..=i {
            let entry = 0.5 * (rows[i].product(&columns[j]) + rows[j].product(&columns[i]));
            (matrix[n * i + j], matrix[n * j + i]) = (entry, entry);
        }
        matrix[n * i + i] *= 1.0 + COMPLIANCE;
    }
    // Rows of prescribed components alone cannot be met.
    let movable: Vec<usize> = (0..n).filter(|&i| matrix[n * i + i] > 0.0).collect();
    let q: Vec<f64> = (movable.iter())
        .map(|&i| rows[i].product(flat) - rows[i].least)
        .collect();
    let found = complementarity(|i, j| matrix[n * movable[i] + movable[j]], &q);
    let mut forces = vec![0.0; flat.len()];
    for (&i, lambda) in movable.iter().zip(&found.z) {
        for &(node, n) in &rows[i].nodes {
            for axis in 0..3 {
                forces[3 * node + axis] += lambda * n[axis];
            }
        }
    }
    system.push(&forces);
    let (velocity, mut under) = solver.solve(solids, system, settings)?;
    under.iterations += report.iterations;
    let report = ContactReport {
        solves: found.pivots,
        unsettled: found.wrong,
    };
    Ok((velocity, under, report))
}
