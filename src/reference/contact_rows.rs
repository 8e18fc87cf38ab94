//! `solve`, for solids that touch each other: velocities under unilateral rows.
//!
//! A row is n . (v_a - v_b) >= -gap / dt for two points of different bodies, or of a body and a wall or obstacle, each a
//! weighted mean of nodes. With all rows G v >= r, the velocities minimise phi(v) = v . S v / 2 - F . v. Then S v = F + G^T
//! lambda with 0 <= lambda, complementary to G v - r, and lambda solves the complementarity problem of G S^-1 G^T, dense and
//! small. S^-1 G^T is computed by the factor of S.
//!
//! In liquid F has J^T p, which depends on v. The rows to hold are first those of this problem at the pressure without rows. Then each solve
//! for pressures and velocities has the held rows as equations, and the wrong ones are exchanged.
//!
//! Where bodies overlap, r = 0 instead of -gap / dt: the velocity does not push them out, so that v = 0 remains admissible and
//! phi, which is 0 at rest, does not grow. Walls and obstacles push nodes out, as they do without contact of solids.

use glam::DVec3;

use super::coupled_system::CoupledSystem;
use super::solid_contacts::Contacts;
use super::solid_system::SolidSystem;
use super::solve_coupled::{CoupledSolution, Together};
use super::solve_solid::SolidSolver;
use crate::Error;
use crate::elastic::Solids;
use crate::geometry::contact_pairs;
use crate::linalg::{Row, RowSearch, UnilateralRows};
use crate::scene::Solver;
use crate::state::{ContactReport, SolveReport};

/// Distance within which rows are set up: this times dt times the largest speed, since both bodies may move.
const REACH: f64 = 2.0;
/// And at least this, in cells.
const LEAST_REACH: f64 = 0.05;
/// Largest number of coupled solves of a sub-step.
pub const MOST_COUPLED: u32 = 12;

/// The bodies and surfaces that may touch in a sub-step.
#[derive(Clone, Copy, Debug)]
pub struct Touching<'a> {
    /// Bodies.
    pub solids: &'a Solids,
    /// Walls and obstacles.
    pub contacts: &'a Contacts,
    /// Positions of all nodes, m.
    pub positions: &'a [DVec3],
    /// Length of the sub-step, s.
    pub dt: f64,
    /// A cell, m.
    pub dx: f64,
}

impl Touching<'_> {
    /// The rows of all contacts in reach of nodes with these velocities, m/s, three numbers per node; `None` where the velocities meet them.
    pub fn rows(&self, velocity: &[f64]) -> Option<Vec<Row>> {
        let (nodes, _) = velocity.as_chunks::<3>();
        let speeds = nodes.iter().map(|v| DVec3::from(*v).length());
        let reach = (REACH * self.dt * speeds.fold(0.0, f64::max)).max(LEAST_REACH * self.dx);
        let mut rows = self.contacts.rows(reach);
        let Solids {
            bodies, triangles, ..
        } = self.solids;
        let bodies: Vec<_> = bodies.iter().map(|body| body.triangles.clone()).collect();
        for pair in contact_pairs(self.positions, triangles, &bodies, reach) {
            let points = pair.points.iter();
            let entries = points.flat_map(|&(node, weight)| {
                let n = (weight * pair.normal).to_array().into_iter().enumerate();
                n.map(move |(axis, n)| (3 * node as usize + axis, n))
            });
            rows.push(Row {
                entries: entries.collect(),
                least: -pair.gap.max(0.0) / self.dt,
            });
        }
        let met = rows.iter().all(|row| row.slack(velocity) >= 0.0);
        (!met).then_some(rows)
    }
}

/// X and W of rows; `None` where S has no factor in f64.
///
/// # Errors
/// When the factor does not fit into memory.
fn unilateral(
    solver: &SolidSolver,
    system: &SolidSystem,
    rows: Vec<Row>,
) -> Result<Option<UnilateralRows>, Error> {
    let Some(factor) = solver.factorise(system)? else {
        return Ok(None);
    };
    let components = system.components();
    let n = system.rhs.len();
    let solve = |force: Vec<f64>| {
        let mut x: Vec<f64> = components.iter().map(|&at| force[at]).collect();
        factor.solve(&mut x);
        let mut full = vec![0.0; n];
        components.iter().zip(x).for_each(|(&at, x)| full[at] = x);
        full
    };
    Ok(Some(UnilateralRows::new(rows, n, solve)))
}

/// Velocities of all nodes (m/s) under the rows of `touching`. `system` without constraints of contact, afterwards with the contact forces.
///
/// # Errors
/// When the factor does not fit into memory.
pub(super) fn solve_in_rows(
    solver: &SolidSolver,
    system: &mut SolidSystem,
    touching: Touching,
    settings: &Solver,
) -> Result<(Vec<[f64; 3]>, SolveReport, ContactReport), Error> {
    let (free, report) = solver.solve(touching.solids, system, settings)?;
    let none = ContactReport {
        solves: 1,
        unsettled: 0,
    };
    let Some(rows) = touching.rows(free.as_flattened()) else {
        return Ok((free, report, none));
    };
    let Some(rows) = unilateral(solver, system, rows)? else {
        return Ok((free, report, none));
    };
    let found = rows.solve(free.as_flattened());
    system.push(&rows.forces(&found.z));
    let (velocity, mut under) = solver.solve(touching.solids, system, settings)?;
    under.iterations += report.iterations;
    let report = ContactReport {
        solves: found.pivots,
        unsettled: found.wrong,
    };
    Ok((velocity, under, report))
}

/// Pressures and velocities under the rows of `touching`; `together` without them. Returns the last system, with the contact forces, and its
/// solution.
///
/// # Errors
/// As those of the solves.
pub(super) fn solve_coupled_in_rows(
    mut together: Together,
    solid: &SolidSystem,
    touching: Touching,
) -> Result<(CoupledSystem, CoupledSolution, ContactReport), Error> {
    let (system, solution) = together.solve(solid, None)?;
    let mut report = ContactReport {
        solves: 1,
        unsettled: 0,
    };
    let found_all = solution.reports[0].status.is_best_attainable();
    let rows = touching.rows(solution.velocity.as_flattened());
    let Some(rows) = rows.filter(|_| found_all) else {
        return Ok((system, solution, report));
    };
    let Some(rows) = unilateral(together.solver, solid, rows)? else {
        return Ok((system, solution, report));
    };
    let mut search = RowSearch::new(&rows, solution.velocity.as_flattened());
    let mut best = (system, solution);
    while let Some(held) = rows.hold(search.held()) {
        let (mut system, solution) = together.solve(solid, Some(&held))?;
        report.solves += 1;
        let v = solution.velocity.as_flattened();
        // G_F S^-1 (F + J^T p - S v) is what the rows lack at this pressure.
        let lambda = held.cancelling(&system.unbalanced(&solution));
        system.push(&held.forces(&lambda));
        let found_all = solution.reports[0].status.is_best_attainable();
        let (wrong, exchanged) = search.exchange(&rows, &lambda, v);
        report.unsettled = wrong as u32;
        best = (system, solution);
        if !exchanged || !found_all || report.solves == MOST_COUPLED {
            break;
        }
    }
    let (system, solution) = best;
    Ok((system, solution, report))
}
