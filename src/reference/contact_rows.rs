//! `solve`, for solids that touch each other: velocities under unilateral rows.
//!
//! A row is n . (v_a - v_b) >= -gap / dt for two points of different bodies, or of a body and a wall or obstacle, each a
//! weighted mean of nodes. With all rows G v >= r, the velocities minimise phi(v) = v . S v / 2 - F . v. Then S v = F + G^T
//! lambda with 0 <= lambda, complementary to G v - r, and lambda solves the complementarity problem of G S^-1 G^T, dense and
//! small. S^-1 G^T is computed by the factor of S.
//!
//! In liquid F has J^T p, which depends on v. The rows to hold are first those of this problem at the pressure without rows. Then each solve
//! for pressures and velocities has the held rows as equations, until none pulls and no other is violated.
//!
//! Rows with friction have tangential rows (linalg/unilateral.rs): t . (v_a - v_b) = 0 while they stick, across the row along two tangents, the first
//! along v_a - v_b without rows. Those that slip have the force mu lambda against the slip.
//!
//! The rows hold at the nearest points of the start. Where bodies still meet in the motion by dt v, the rows of these meetings join, and it is solved
//! again, at most four times. The bodies move in the next sub-step: where they still meet after the last solve, it is halved until they do not. Where
//! they would meet in a longer one, it is no longer than this.
//!
//! Where bodies overlap, r = 0 instead of -gap / dt: the velocity does not push them out, so that v = 0 remains admissible and
//! phi, which is 0 at rest, does not grow. Walls and obstacles push nodes out, as they do without contact of solids.

use std::ops::Range;

use glam::DVec3;

use super::coupled_system::CoupledSystem;
use super::solid_contacts::{ActiveSurfaces, Contacts, friction};
use super::solid_system::SolidSystem;
use super::solve_coupled::{CoupledSolution, Together};
use super::solve_solid::SolidSolver;
use super::turn_solids::inverse_inertia;
use crate::Error;
use crate::elastic::Solids;
use crate::geometry::{ContactField, ContactPair, contact_hits, contact_pairs};
use crate::linalg::{Row, RowSearch, UnilateralRows};
use crate::scene::Solver;
use crate::state::{ContactReport, SolveReport};

/// Distance within which rows are set up: this times dt times the largest speed, since both bodies may move.
const REACH: f64 = 2.0;
/// And at least this, in cells.
const LEAST_REACH: f64 = 0.05;
/// Depth behind each other at the end of a motion that counts as a meeting, cells.
const DEPTH: f64 = 1e-3;
/// The same for a body and itself.
const OWN_DEPTH: f64 = 1e-5;
/// The same for a body and itself in a motion that must be shorter.
const OWN_PASSING: f64 = 1e-4;
/// Overlap at the start of a motion that rows keep from growing, cells.
const OVERLAP: f64 = 1e-2;
/// Largest number of solves with rows of meetings that the rows before missed.
pub const MOST_MEETINGS: u32 = 4;
/// Largest growth of the next sub-step.
const GROWTH: f64 = 2.0;
/// Largest number of halvings of the next sub-step.
const MOST_HALVINGS: u32 = 10;
/// Largest number of sets that are held of the same rows, each with a coupled solve; in the two-field form of the device with several.
pub const MOST_COUPLED: u32 = 20;

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
    /// The rows of all contacts in reach of nodes with these velocities (m/s, three numbers per node), and of those that bodies still make; `None`
    /// where the velocities meet all rows. `known`: rows so far.
    pub fn rows(&self, velocity: &[f64], known: &[Row]) -> Option<Vec<Row>> {
        let mut rows = match known {
            [] => self.near(velocity),
            known => known.to_vec(),
        };
        let met = !known.is_empty() || rows.iter().all(|row| row.slack(velocity) >= 0.0);
        if met {
            let (nodes, _) = velocity.as_chunks::<3>();
            let hits = self.hits(velocity, self.dt, OWN_DEPTH);
            let hits = hits.iter().filter_map(|pair| self.row(pair, nodes));
            // Rows that the velocities meet do not help.
            let missed = -0.5 * OWN_DEPTH * self.dx / self.dt;
            let before = rows.len();
            rows.extend(hits.filter(|row| row.slack(velocity) < missed));
            if rows.len() == before {
                return None;
            }
        }
        Some(rows)
    }

    /// The rows of points in reach.
    fn near(&self, velocity: &[f64]) -> Vec<Row> {
        let (nodes, _) = velocity.as_chunks::<3>();
        let speeds = nodes.iter().map(|v| DVec3::from(*v).length());
        let reach = (REACH * self.dt * speeds.fold(0.0, f64::max)).max(LEAST_REACH * self.dx);
        let mut rows = self.contacts.rows(reach, velocity);
        let reach = |one: usize, other: usize| {
            let own = || (REACH * self.dt * self.deforming_speed(one, nodes)).max(LEAST_REACH * self.dx);
            self.solids.may_touch(one, other).then(|| if one == other { own() } else { reach })
        };
        let pairs = contact_pairs(self.positions, &self.solids.triangles, &bodies(self.solids), &reach);
        let apart = pairs.into_iter().map(|pair| ContactPair { gap: pair.gap.max(0.0), ..pair });
        rows.extend(apart.filter_map(|pair| self.row(&pair, nodes)));
        rows
    }

    /// Reports by how much the next sub-step must be shorter, for velocities after the last solve (m/s, three numbers per node), and the meetings
    /// that are left in the shortest. Without velocities there was no solve with rows.
    pub fn shorten(&self, velocity: &[f64], report: &mut ContactReport) {
        report.closing_rate = self.contacts.closing_rate(velocity.as_chunks::<3>().0);
        if velocity.is_empty() || self.hits(velocity, GROWTH * self.dt, OWN_PASSING).is_empty() {
            return;
        }
        let (halvings, left) = halvings(|part| self.hits(velocity, part * self.dt, OWN_PASSING));
        report.next_halvings = Some(halvings);
        report.unsettled += left;
    }

    fn hits(&self, velocity: &[f64], span: f64, own: f64) -> Vec<ContactPair> {
        hits(self.solids, self.positions, velocity.as_chunks::<3>().0, (span, own), self.dx)
    }

    /// Largest speed of a body's node relative to the body's rigid motion, m/s. `velocity`: of all nodes, m/s.
    fn deforming_speed(&self, number: usize, velocity: &[[f64; 3]]) -> f64 {
        let nodes = || self.solids.bodies[number].nodes.clone();
        let [mass, x, v]: [&dyn Fn(usize) -> DVec3; 3] =
            [&|node| DVec3::splat(self.solids.mass[node]), &|node| self.positions[node], &|node| {
                DVec3::from(velocity[node])
            }];
        let whole = nodes().map(mass).sum::<DVec3>();
        let [x_mean, v_mean] = [x, v].map(|of| nodes().map(|node| mass(node) * of(node)).sum::<DVec3>() / whole);
        let momentum: DVec3 = nodes().map(|node| mass(node) * (x(node) - x_mean).cross(v(node) - v_mean)).sum();
        let arms = nodes().map(|node| (&self.solids.mass[node], x(node) - x_mean));
        let spin = inverse_inertia(None, arms).map_or(DVec3::ZERO, |inverse| inverse * momentum);
        let relative = nodes().map(|node| v(node) - v_mean - spin.cross(x(node) - x_mean));
        relative.map(DVec3::length).fold(0.0, f64::max)
    }

    /// The row of a pair; `None` where all its nodes are prescribed. `velocity`: of all nodes, m/s.
    fn row(&self, pair: &ContactPair, velocity: &[[f64; 3]]) -> Option<Row> {
        let prescribed = |node: u32| self.solids.prescribed[node as usize] == [true; 3];
        if pair.points.iter().all(|&(node, _)| prescribed(node)) {
            return None;
        }
        let along = |direction: DVec3| {
            let points = pair.points.iter();
            let entries = points.flat_map(|&(node, weight)| {
                let n = (weight * direction).to_array().into_iter().enumerate();
                n.map(move |(axis, n)| (3 * node as usize + axis, n))
            });
            entries.collect()
        };
        let points = pair.points.iter();
        let apart: DVec3 = points.clone().map(|&(node, weight)| weight * DVec3::from(velocity[node as usize])).sum();
        let coefficients = points.map(|&(node, _)| self.solids.body_of_node(node as usize).friction);
        let coefficient = coefficients.fold(0.0, f64::max);
        Some(Row {
            entries: along(pair.normal),
            least: -pair.gap / self.dt,
            friction: friction(coefficient, pair.normal, apart, DVec3::ZERO, along),
        })
    }
}

fn bodies(solids: &Solids) -> Vec<Range<usize>> {
    solids.bodies.iter().map(|body| body.triangles.clone()).collect()
}

/// The points that meet in the motion of a span (s) with velocities (m/s). `own`: depth of a body behind itself that counts, cells; `positions` in
/// m; `dx`: a cell, m.
fn hits(
    solids: &Solids,
    positions: &[DVec3],
    velocity: &[[f64; 3]],
    (span, own): (f64, f64),
    dx: f64,
) -> Vec<ContactPair> {
    let ways: Vec<DVec3> = velocity.iter().map(|v| span * DVec3::from(*v)).collect();
    let depth =
        |one: usize, other: usize| solids.may_touch(one, other).then_some(dx * if one == other { own } else { DEPTH });
    let hits = contact_hits(positions, &ways, &solids.triangles, (&bodies(solids), &depth), OVERLAP * dx).into_iter();
    let free = |&(node, _): &(u32, f64)| solids.prescribed[node as usize] != [true; 3];
    let hits = hits.filter(|pair| pair.points.iter().any(free));
    hits.map(|pair| ContactPair { gap: pair.gap.max(0.0), ..pair }).collect()
}

/// The fewest halvings of a motion without meetings, and the meetings that the most leave. `hits`: those of a part of the motion.
fn halvings(hits: impl Fn(f64) -> Vec<ContactPair>) -> (u32, u32) {
    let mut left = 0;
    let halvings = (0..=MOST_HALVINGS).find(|&times| {
        left = hits(0.5_f64.powi(times as i32)).len() as u32;
        left == 0
    });
    (halvings.unwrap_or(MOST_HALVINGS), left)
}

/// The longest first sub-step (s) in which the initial motion takes no solid through a wall, an obstacle or, if solids `meet`, another: at most `longest`,
/// and a 1024th of it at least; 0 without a limit. No solve before it could stop them. `displacement` in m, `velocity` in m/s.
pub fn first_contact_step(
    solids: &Solids,
    (obstacles, meet): (&ContactField, bool),
    displacement: &[[f64; 3]],
    velocity: &[[f64; 3]],
    longest: f64,
) -> f64 {
    let positions = solids.moved(displacement).nodes;
    let dx = obstacles.grid.dx;
    let times = match meet {
        true => halvings(|part| hits(solids, &positions, velocity, (part * longest, OWN_PASSING), dx)).0,
        false => 0,
    };
    let none = vec![ActiveSurfaces::default(); positions.len()];
    let surfaces = Contacts::holding(solids, obstacles, displacement, &none, 0.0);
    let share = |times: u32| 0.5_f64.powi(times as i32);
    let of_surfaces = (longest * share(MOST_HALVINGS)).max(1.0 / surfaces.closing_rate(velocity));
    let first = of_surfaces.min(longest * share(times));
    if first < longest { first } else { 0.0 }
}

/// X and W of rows; `None` where S has no factor in f64.
///
/// # Errors
/// When the factor does not fit into memory.
fn unilateral(solver: &SolidSolver, system: &SolidSystem, rows: Vec<Row>) -> Result<Option<UnilateralRows>, Error> {
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
    let none = ContactReport { solves: 1, ..ContactReport::default() };
    let without = system.clone();
    let mut known = Vec::new();
    let mut solved = (free.clone(), report, none);
    for meetings in 0.. {
        let Some(rows) = touching.rows(solved.0.as_flattened(), &known) else {
            break;
        };
        if meetings > MOST_MEETINGS {
            break;
        }
        known.clone_from(&rows);
        let n = rows.len() as u32;
        let Some(rows) = unilateral(solver, &without, rows)? else {
            solved.2.unsettled += n;
            break;
        };
        let found = rows.solve(free.as_flattened());
        system.clone_from(&without);
        system.push(&rows.forces(&found.z));
        let (velocity, mut report) = solver.solve(touching.solids, system, settings)?;
        report.iterations += solved.1.iterations;
        let mut contact = ContactReport { solves: found.pivots, unsettled: found.wrong, ..ContactReport::default() };
        if meetings > 0 {
            contact.solves += solved.2.solves;
        }
        solved = (velocity, report, contact);
    }
    touching.shorten(solved.0.as_flattened(), &mut solved.2);
    Ok(solved)
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
    let mut report = ContactReport { solves: 1, ..ContactReport::default() };
    let free = solution.velocity.as_flattened().to_vec();
    let (mut known, mut unsettled) = (Vec::new(), 0);
    let mut best = (system, solution);
    for meetings in 0.. {
        let found_all = best.1.reports[0].status.is_best_attainable();
        let rows = touching.rows(best.1.velocity.as_flattened(), &known);
        let Some(rows) = rows.filter(|_| found_all) else {
            break;
        };
        if meetings > MOST_MEETINGS {
            break;
        }
        known.clone_from(&rows);
        let n = rows.len();
        let Some(rows) = unilateral(together.solver, solid, rows)? else {
            unsettled += n;
            break;
        };
        let mut search = RowSearch::new(&rows, &free);
        let mut hold = |search: &RowSearch| -> Result<_, Error> {
            let Some(held) = rows.hold(search.held()) else {
                return Ok(None);
            };
            let mut pushed = solid.clone();
            if let Some(forces) = search.slipping_forces(&rows) {
                pushed.push(&forces);
            }
            let (mut system, solution) = together.solve(&pushed, Some(&held))?;
            report.solves += 1;
            // G_F S^-1 (F + J^T p - S v) is what the rows lack at this pressure.
            let lambda = held.cancelling(&system.unbalanced(&solution));
            system.push(&held.forces(&lambda));
            Ok(Some((lambda, (system, solution))))
        };
        for _ in 0..MOST_COUPLED {
            let Some((lambda, solved)) = hold(&search)? else {
                unsettled = search.held().iter().filter(|held| **held).count();
                break;
            };
            let solution = &solved.1;
            let found_all = solution.reports[0].status.is_best_attainable();
            let exchanged;
            (unsettled, exchanged) = search.exchange(&rows, &lambda, solution.velocity.as_flattened(), found_all);
            best = solved;
            if !exchanged || !found_all {
                break;
            }
        }
        if let Some(wrong) = search.return_to_best()
            && let Some((_, solved)) = hold(&search)?
        {
            (best, unsettled) = (solved, wrong);
        }
    }
    report.unsettled += unsettled as u32;
    let (system, solution) = best;
    touching.shorten(solution.velocity.as_flattened(), &mut report);
    Ok((system, solution, report))
}
