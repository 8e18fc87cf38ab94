//! `right_hand_side`, for solids, second part: contact of nodes with walls and obstacles in a sub-step.
//!
//! A node at a gap d (m) with outward normal n must satisfy d + dt v . n >= 0 after the next move. Of a moving obstacle d
//! is the gap that a node at rest has after that move: its gap now less dt times the obstacle's velocity along n. The contact force
//! f >= 0 acts only at contact: f (d + dt v . n) = 0. So v minimises phi(v) = v . S v / 2 - F . v subject to d + dt v
//! . n >= 0. F contains all forces, including those of the liquid.
//!
//! A primal active-set method solves it (Nocedal & Wright, Numerical Optimization, 2006, section 16.5). It adds many
//! constraints at once if possible, as projected Newton methods do (Bertsekas 1982). Each iteration starts from a
//! feasible velocity v and a set of active constraints, v . n = -d/dt. A solve minimises phi under these; w is the
//! minimiser.
//!
//! - w is infeasible: v moves towards w. Steps of 1, 1/2, 1/4, ... with each node projected back to feasibility are
//!   tried until phi does not grow. Otherwise v moves straight to the first surface. Surfaces touched at v and
//!   penetrated at w become active.
//! - w is feasible: v = w, and adhering constraints (f < 0) are released. Without any, w is the solution.
//!
//! Every v is feasible and phi, which is 0 at rest, never grows. Exceptions are nodes that penetrated before, changes
//! of the liquid's forces between solves, and rounding of the solves. The search may stop after any iteration.

use glam::{DMat3, DVec3};

use super::SolidSystem;
use super::diagnose::larger;
use super::sample::normal;
use crate::elastic::Solids;
use crate::geometry::ContactField;
use crate::linalg::{Friction, Row};
use crate::state::ContactReport;

/// Largest number of active-set iterations per sub-step, including the solve for a pressure that matches the final
/// velocities.
pub const MAX_SOLVES: u32 = 20;
/// Largest number of halvings of a step from the feasible velocity towards the minimiser.
pub const MOST_HALVINGS: u32 = 3;
/// Sweeps over the surfaces of a node in the projection to feasibility; each may violate an earlier one.
const SWEEPS: u32 = 4;
/// Gap below which a node is initially constrained if it is pressed to the surface, and largest penetration in a longer sub-step, cells.
const SKIN: f64 = 1e-3;
/// Tolerance of gaps and contact, cells.
const NEAR: f64 = 1e-4;
/// Index of the obstacle among the surfaces of a node, after three walls.
const OBSTACLE: usize = 3;
/// Part of a velocity across a normal that is rounding.
const NO_SLIP: f64 = 1e-9;
/// Smallest cosine between an obstacle's normal and the node's free components; below it the obstacle does not
/// constrain the node.
const LEAST_SHARE: f64 = 0.1;

/// Constraint projector of a node in a sub-step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Freedom {
    /// Components that are not prescribed.
    pub free: [bool; 3],
    /// Projector onto the unconstrained directions among these; symmetric.
    pub projector: DMat3,
}

impl Freedom {
    /// Projector of a node without contact.
    pub fn of(prescribed: [bool; 3]) -> Freedom {
        let free = prescribed.map(|prescribed| !prescribed);
        let ones = free.map(|free| if free { 1.0 } else { 0.0 });
        Freedom { free, projector: DMat3::from_diagonal(DVec3::from(ones)) }
    }

    /// Projector of a node whose walls leave `components`, minus an obstacle's direction: a unit vector in these
    /// components, or 0.
    pub fn left(prescribed: [bool; 3], components: [bool; 3], normal: DVec3) -> Freedom {
        let ones = components.map(|free| if free { 1.0 } else { 0.0 });
        Freedom { projector: DMat3::from_diagonal(DVec3::from(ones)) - square(normal), ..Freedom::of(prescribed) }
    }

    /// Projector of a node whose velocity is fixed.
    pub fn none(prescribed: [bool; 3]) -> Freedom {
        Freedom { projector: DMat3::ZERO, ..Freedom::of(prescribed) }
    }

    /// Projectors of all nodes, without contact.
    pub fn all(solids: &Solids) -> Vec<Freedom> {
        let prescribed = solids.prescribed.iter();
        prescribed.map(|&prescribed| Freedom::of(prescribed)).collect()
    }

    /// Number of free directions: 0 to 3.
    pub fn rank(&self) -> usize {
        let diagonal = [0, 1, 2].map(|axis| self.projector.col(axis)[axis]);
        diagonal.iter().sum::<f64>().round() as usize
    }

    /// Removes the common direction with n. Returns the velocity with the normal velocity `rate`, v . n. No change if
    /// the common part of n is small.
    fn hold(&mut self, n: DVec3, rate: f64, v: DVec3) -> DVec3 {
        let Some((direction, share)) = self.shared(n) else {
            return v;
        };
        self.projector -= square(direction);
        v + (rate - v.dot(n)) / share * direction
    }

    /// The free direction closest to n, and its cosine with n.
    fn shared(&self, n: DVec3) -> Option<(DVec3, f64)> {
        let free = self.projector * n;
        let share = free.length();
        (share >= LEAST_SHARE).then(|| (free / share, share))
    }
}

/// The surfaces that constrain a node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ActiveSurfaces {
    /// Per component: whether the nearer wall across it constrains the node.
    pub walls: [bool; 3],
    /// Whether an obstacle constrains the node.
    pub obstacle: bool,
}

/// n n^T.
fn square(n: DVec3) -> DMat3 {
    let [x, y, z] = n.to_array().map(|part| part * n);
    DMat3::from_cols(x, y, z)
}

/// Friction of a point with a velocity on a surface with another (both m/s); `None` without. `along`: entries of the point's velocity along a
/// direction.
pub(super) fn friction(
    coefficient: f64,
    normal: DVec3,
    velocity: DVec3,
    surface: DVec3,
    along: impl Fn(DVec3) -> Vec<(usize, f64)>,
) -> Option<Friction> {
    if coefficient == 0.0 {
        return None;
    }
    let slip = velocity - surface;
    let tangential = slip.reject_from_normalized(normal);
    let first = match tangential.length() > NO_SLIP * slip.length() {
        true => tangential.normalize(),
        false => normal.any_orthonormal_vector(),
    };
    let tangents = [first, normal.cross(first)].map(|tangent| (along(tangent), surface.dot(tangent)));
    Some(Friction { coefficient, tangents })
}

/// A wall or obstacle near a node.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Surface {
    /// Unit outward normal.
    normal: DVec3,
    /// Gap of the node after the next move if the node rests, m.
    gap: f64,
    /// Velocity of the surface, m/s, and along the normal.
    velocity: DVec3,
    rate: f64,
    /// Coefficient of friction.
    friction: f64,
    active: bool,
}

impl Surface {
    fn at_rest(normal: DVec3, gap: f64, friction: f64) -> Surface {
        Surface { normal, gap, velocity: DVec3::ZERO, rate: 0.0, friction, active: false }
    }
}

/// The walls and obstacles near nodes, and the active set.
#[derive(Clone, Debug)]
pub struct Contacts {
    /// Per node: the nearer walls across x, y, z in components that are not prescribed, then the obstacle.
    surfaces: Vec<[Option<Surface>; 4]>,
    prescribed: Vec<[bool; 3]>,
    /// Length of the sub-step, s.
    dt: f64,
    /// Tolerance, m.
    near: f64,
    /// [`SKIN`], m.
    skin: f64,
}

impl Contacts {
    /// Initial active set of a sub-step of dt (s): nodes in contact whose forces M v*/dt - (K x* - b) + load press
    /// them to the surface, or too little to keep up with it. `displacement` in m; `forces` in N.
    pub fn new(
        solids: &Solids,
        obstacles: &ContactField,
        displacement: &[[f64; 3]],
        forces: &[[f64; 3]],
        dt: f64,
    ) -> Contacts {
        let skin = SKIN * obstacles.grid.dx;
        let pressed = |node: usize, _: usize, surface: &Surface, freedom: &Freedom| {
            let force = freedom.projector * DVec3::from(forces[node]);
            let least = surface.rate * solids.mass[node] / dt;
            surface.gap <= skin && force.dot(surface.normal) < least
        };
        Contacts::with(solids, obstacles, displacement, dt, pressed)
    }

    /// Contacts with an active set. The projectors do not determine it, as an obstacle's face may lie along a
    /// wall.
    pub fn holding(
        solids: &Solids,
        obstacles: &ContactField,
        displacement: &[[f64; 3]],
        active: &[ActiveSurfaces],
        dt: f64,
    ) -> Contacts {
        let active = |node: usize, which: usize, _: &Surface, _: &Freedom| match which {
            OBSTACLE => active[node].obstacle,
            axis => active[node].walls[axis],
        };
        Contacts::with(solids, obstacles, displacement, dt, active)
    }

    /// Contacts with the surfaces for which `active` is true. Its arguments: node, index of the surface, and the
    /// directions that earlier surfaces leave free.
    fn with(
        solids: &Solids,
        obstacles: &ContactField,
        displacement: &[[f64; 3]],
        dt: f64,
        active: impl Fn(usize, usize, &Surface, &Freedom) -> bool,
    ) -> Contacts {
        let ContactField { grid, distance, friction, .. } = obstacles;
        let surfaces = (0..solids.rest.len()).map(|node| {
            let x = solids.rest[node] + DVec3::from(displacement[node]);
            let rubbing = |other: f64| solids.body_of_node(node).friction.max(other);
            let wall = |axis: usize| {
                let above = grid.size()[axis] - x[axis];
                let (sign, gap) = if x[axis] <= above { (1.0, x[axis]) } else { (-1.0, above) };
                let free = !solids.prescribed[node][axis];
                free.then(|| Surface::at_rest(sign * DVec3::AXES[axis], gap, rubbing(friction.walls)))
            };
            let obstacle = normal(grid, distance, x).map(|normal| {
                let velocity = obstacles.velocity(x).unwrap_or_default();
                let rate = velocity.dot(normal);
                let gap = grid.sample_cells(distance, x) - dt * rate;
                Surface { velocity, rate, ..Surface::at_rest(normal, gap, rubbing(obstacles.friction(x))) }
            });
            let mut surfaces = [wall(0), wall(1), wall(2), obstacle];
            let mut freedom = Freedom::of(solids.prescribed[node]);
            for (which, surface) in surfaces.iter_mut().enumerate() {
                if let Some(surface) = surface {
                    let moves = freedom.shared(surface.normal).is_some();
                    surface.active = moves && active(node, which, surface, &freedom);
                    if surface.active {
                        freedom.hold(surface.normal, 0.0, DVec3::ZERO);
                    }
                }
            }
            surfaces
        });
        let [near, skin] = [NEAR, SKIN].map(|cells| cells * grid.dx);
        Contacts { surfaces: surfaces.collect(), prescribed: solids.prescribed.clone(), dt, near, skin }
    }

    /// The rows of all surfaces that nodes may reach within a distance, m. `velocity`: of the nodes without rows, m/s, three numbers each.
    pub fn rows(&self, reach: f64, velocity: &[f64]) -> Vec<Row> {
        let nodes = self.surfaces.iter().zip(velocity.as_chunks::<3>().0).enumerate();
        let rows = nodes.flat_map(|(node, (surfaces, v))| {
            let prescribed = self.prescribed[node];
            // A row of prescribed components alone cannot be met.
            let free = move |normal: DVec3| (0..3).any(|axis| !prescribed[axis] && normal[axis] != 0.0);
            let near = move |surface: &&Surface| surface.gap <= reach && free(surface.normal);
            surfaces.iter().flatten().filter(near).map(move |surface| {
                let along = |n: DVec3| (0..3).map(|axis| (3 * node + axis, n[axis])).collect();
                Row {
                    entries: along(surface.normal),
                    least: -surface.gap / self.dt,
                    friction: friction(surface.friction, surface.normal, DVec3::from(*v), surface.velocity, along),
                }
            })
        });
        rows.collect()
    }

    /// Without active surfaces.
    pub fn none_active(mut self) -> Contacts {
        for surface in self.surfaces.iter_mut().flatten().flatten() {
            surface.active = false;
        }
        self
    }

    /// A feasible initial velocity, m/s: zero except for prescribed components and penetrating nodes.
    pub fn at_rest(&self, velocity: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let nodes = self.prescribed.iter().zip(velocity);
        let mut rest: Vec<[f64; 3]> =
            nodes.map(|(prescribed, v)| [0, 1, 2].map(|axis| if prescribed[axis] { v[axis] } else { 0.0 })).collect();
        self.put_back(&mut rest);
        rest
    }

    /// The velocities (m/s) at a fraction of the step from one to another, projected to feasibility.
    pub fn approach(&self, from: &[[f64; 3]], to: &[[f64; 3]], share: f64) -> Vec<[f64; 3]> {
        let between = |from: f64, to: f64| from + share * (to - from);
        let pairs = from.iter().zip(to);
        let mut next: Vec<[f64; 3]> =
            pairs.map(|(from, to)| std::array::from_fn(|axis| between(from[axis], to[axis]))).collect();
        self.put_back(&mut next);
        next
    }

    /// The fraction of the step between velocities (m/s) at which the first penetrating node reaches its surface.
    pub fn first_stop(&self, from: &[[f64; 3]], to: &[[f64; 3]]) -> f64 {
        let mut first = 1.0;
        for node in 0..from.len() {
            let [before, after] = [from, to].map(|v| self.gaps(node, DVec3::from(v[node])));
            let free = Freedom::of(self.prescribed[node]);
            for (which, surface) in self.surfaces[node].iter().enumerate() {
                let moves = surface.is_some_and(|surface| free.shared(surface.normal).is_some());
                let (before, after) = (before[which], after[which]);
                if moves && after < -self.near && after < before {
                    let before = f64::max(before, 0.0);
                    first = f64::min(first, before / (before - after));
                }
            }
        }
        first
    }

    /// Largest a / (d + s), s a thousandth of a cell, of nodes with velocities (m/s) that close their gap to a surface, d (m) now, at a rate a, 1/s. Sub-steps up to its
    /// inverse take no node further than s through a surface.
    pub fn closing_rate(&self, velocity: &[[f64; 3]]) -> f64 {
        let nodes = self.surfaces.iter().zip(&self.prescribed).zip(velocity);
        let rates = nodes.flat_map(|((surfaces, &prescribed), v)| {
            let moves = move |surface: &&Surface| Freedom::of(prescribed).shared(surface.normal).is_some();
            surfaces.iter().flatten().filter(moves).map(|surface| {
                let gap = surface.gap + self.dt * surface.rate;
                let closing = surface.rate - DVec3::from(*v).dot(surface.normal);
                closing.max(0.0) / (gap.max(0.0) + self.skin)
            })
        });
        rates.fold(0.0, larger)
    }

    /// Tolerance of penetration and adhesion, m.
    pub fn near(&self) -> f64 {
        self.near
    }

    /// Projectors of all nodes; sets the velocities (m/s) in constrained directions.
    pub fn hold(&self, velocity: &mut [[f64; 3]]) -> Vec<Freedom> {
        let nodes = self.surfaces.iter().zip(&self.prescribed).zip(velocity);
        nodes
            .map(|((surfaces, prescribed), velocity)| {
                let mut freedom = Freedom::of(*prescribed);
                let mut v = DVec3::from(*velocity);
                for surface in surfaces.iter().flatten().filter(|surface| surface.active) {
                    v = freedom.hold(surface.normal, -surface.gap / self.dt, v);
                }
                *velocity = v.to_array();
                freedom
            })
            .collect()
    }

    /// Classifies the contacts for the minimiser w (m/s) of a system with all forces. Penetration and adhesion below
    /// [`Contacts::near`] do not count.
    pub fn judge(&self, system: &SolidSystem, minimiser: &[[f64; 3]]) -> Violations {
        let mut violations = Violations::default();
        for (node, push) in self.pushes(system, minimiser).into_iter().enumerate() {
            let gaps = self.gaps(node, DVec3::from(minimiser[node]));
            let active = self.active(node);
            let shares = self.shares(node, active, push);
            for which in 0..=OBSTACLE {
                let far = |length: f64| length < -self.near;
                match shares[which] {
                    Some(share) if active[which] => violations.pulled += u32::from(far(share)),
                    Some(_) => violations.beyond += u32::from(far(gaps[which])),
                    None => {}
                }
            }
        }
        violations
    }

    /// Releases constraints that adhere at the velocities w (m/s). `system` with all forces.
    pub fn let_go(&mut self, system: &SolidSystem, minimiser: &[[f64; 3]]) {
        for (node, push) in self.pushes(system, minimiser).into_iter().enumerate() {
            let shares = self.shares(node, self.active(node), push);
            for (surface, share) in self.surfaces[node].iter_mut().zip(shares) {
                if let Some(surface) = surface {
                    surface.active &= share.is_some_and(|share| share >= -self.near);
                }
            }
        }
    }

    /// Constrains surfaces touched at the velocities v and penetrated at w (m/s).
    pub fn hold_stopped(&mut self, best: &[[f64; 3]], minimiser: &[[f64; 3]]) {
        self.hold_touching(best, Some(minimiser));
    }

    /// Constrains surfaces touched at the velocities v (m/s).
    pub fn hold_all_touching(&mut self, best: &[[f64; 3]]) {
        self.hold_touching(best, None);
    }

    /// Constrains surfaces touched at v and, if w (m/s) is given, penetrated at w.
    fn hold_touching(&mut self, best: &[[f64; 3]], minimiser: Option<&[[f64; 3]]>) {
        for node in 0..best.len() {
            let touches = self.gaps(node, best[node].into()).map(|gap| gap < self.near);
            let penetrates = match minimiser {
                Some(minimiser) => self.gaps(node, minimiser[node].into()).map(|gap| gap < -self.near),
                None => [true; 4],
            };
            for which in 0..=OBSTACLE {
                // The obstacle's share depends on the walls that constrain the node.
                let shares = self.shares(node, self.active(node), DVec3::ZERO);
                if let Some(surface) = &mut self.surfaces[node][which] {
                    surface.active |= touches[which] && penetrates[which];
                    surface.active &= shares[which].is_some();
                }
            }
        }
    }

    /// Projects each node's velocity (m/s) to feasibility: exact for one surface, approximate where surfaces meet.
    fn put_back(&self, velocity: &mut [[f64; 3]]) {
        let nodes = self.surfaces.iter().zip(&self.prescribed).zip(velocity);
        for ((surfaces, prescribed), velocity) in nodes {
            let free = Freedom::of(*prescribed);
            for _ in 0..SWEEPS {
                for surface in surfaces.iter().flatten() {
                    let v = DVec3::from(*velocity);
                    if surface.gap + self.dt * v.dot(surface.normal) < 0.0 {
                        let rate = -surface.gap / self.dt;
                        *velocity = free.clone().hold(surface.normal, rate, v).to_array();
                    }
                }
            }
        }
    }

    /// Largest penetration of a node with the velocities v, m.
    pub fn beyond(&self, velocity: &[[f64; 3]]) -> f64 {
        (0..velocity.len()).fold(0.0, |worst, node| {
            let gaps = self.gaps(node, DVec3::from(velocity[node]));
            let free = self.shares(node, self.active(node), DVec3::ZERO);
            let gaps = gaps.into_iter().zip(free);
            gaps.filter(|(_, free)| free.is_some()).fold(worst, |worst, (gap, _)| f64::max(worst, -gap))
        })
    }

    /// Largest adhesion of a node at its constraints with the velocities v, m. `system` with all forces.
    pub fn pulled(&self, system: &SolidSystem, velocity: &[[f64; 3]]) -> f64 {
        let pushes = self.pushes(system, velocity).into_iter().enumerate();
        pushes.fold(0.0, |worst, (node, push)| {
            let active = self.active(node);
            let shares = self.shares(node, active, push).into_iter().zip(active);
            shares.filter(|(_, active)| *active).fold(worst, |worst, (share, _)| f64::max(worst, -share.unwrap_or(0.0)))
        })
    }

    /// Contact force S v - F of each node, as the displacement that it alone would cause in a sub-step, m.
    fn pushes(&self, system: &SolidSystem, velocity: &[[f64; 3]]) -> Vec<DVec3> {
        let products = system.multiply(velocity).into_iter().enumerate();
        products
            .map(|(node, product)| {
                let push = product - DVec3::from(system.forces()[node]);
                self.dt * push / system.mean_diagonal(node)
            })
            .collect()
    }

    /// Gaps of a node after a move with the velocity v, m; infinite for absent surfaces.
    fn gaps(&self, node: usize, v: DVec3) -> [f64; 4] {
        let gap = |surface: &Surface| surface.gap + self.dt * v.dot(surface.normal);
        let surfaces = self.surfaces[node].each_ref();
        surfaces.map(|surface| surface.as_ref().map_or(f64::INFINITY, gap))
    }

    fn active(&self, node: usize) -> [bool; 4] {
        self.surfaces[node].map(|surface| surface.is_some_and(|surface| surface.active))
    }

    /// Normal component of a contact force per surface, m: for active surfaces their share, for others the share that
    /// they would add. `None` for absent surfaces, and for an obstacle without a free direction.
    fn shares(&self, node: usize, active: [bool; 4], push: DVec3) -> [Option<f64>; 4] {
        let surfaces = self.surfaces[node];
        let mut freedom = Freedom::of(self.prescribed[node]);
        for (surface, active) in surfaces[..OBSTACLE].iter().zip(active) {
            if let (Some(surface), true) = (surface, active) {
                freedom.hold(surface.normal, 0.0, DVec3::ZERO);
            }
        }
        let obstacle_share = surfaces[OBSTACLE].and_then(|surface| {
            let (direction, share) = freedom.shared(surface.normal)?;
            Some((push.dot(direction) / share, surface.normal))
        });
        // Walls receive the remainder of the obstacle's share.
        let left = match obstacle_share {
            Some((share, normal)) if active[OBSTACLE] => push - share * normal,
            _ => push,
        };
        let mut shares = surfaces.map(|surface| surface.map(|surface| left.dot(surface.normal)));
        shares[OBSTACLE] = obstacle_share.map(|(share, _)| share);
        shares
    }
}

/// Contacts that violate the optimality conditions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Violations {
    /// Penetrating nodes.
    pub beyond: u32,
    /// Adhering nodes.
    pub pulled: u32,
}

/// The active-set search of a sub-step.
#[derive(Debug)]
pub struct ContactSearch<'a> {
    contacts: &'a mut Contacts,
    /// The best feasible velocity, m/s; `None` before the first infeasible solve.
    best: Option<Vec<[f64; 3]>>,
    solves: u32,
    most: u32,
}

/// Result of an active-set iteration.
#[derive(Clone, Debug, PartialEq)]
pub struct SearchStep {
    /// The minimiser if the search has converged, otherwise the best feasible velocity, m/s.
    pub velocity: Vec<[f64; 3]>,
    /// Whether the search has stopped.
    pub ended: bool,
    /// Solves so far, and contacts with a wrong state.
    pub report: ContactReport,
}

impl<'a> ContactSearch<'a> {
    /// Starts a search with at most `most` solves. `contacts`: the initial active set.
    pub fn new(contacts: &'a mut Contacts, most: u32) -> ContactSearch<'a> {
        ContactSearch { contacts, best: None, solves: 0, most }
    }

    /// Updates the active set after a solve with the result `minimiser`, m/s. `system`: the solved one, with all
    /// forces; `last`: whether no other solve can follow.
    pub fn after(&mut self, system: &SolidSystem, minimiser: Vec<[f64; 3]>, last: bool) -> SearchStep {
        self.solves += 1;
        let violations = self.contacts.judge(system, &minimiser);
        let unsettled = violations.beyond + violations.pulled;
        let report = ContactReport { solves: self.solves, unsettled, ..ContactReport::default() };
        if report.unsettled == 0 {
            return SearchStep { velocity: minimiser, ended: true, report };
        }
        let velocity = if violations.beyond == 0 {
            self.contacts.let_go(system, &minimiser);
            minimiser
        } else {
            let from = self.best.take();
            let from = from.unwrap_or_else(|| self.contacts.at_rest(&minimiser));
            let next = self.towards(system, &from, &minimiser);
            self.contacts.hold_stopped(&next, &minimiser);
            next
        };
        self.best = Some(velocity.clone());
        SearchStep { velocity, ended: last || self.solves == self.most, report }
    }

    /// Steps from velocities towards others (m/s) as far as phi does not grow.
    fn towards(&self, system: &SolidSystem, from: &[[f64; 3]], minimiser: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let stop = self.contacts.first_stop(from, minimiser);
        let shares = (0..=MOST_HALVINGS).map(|halvings| 0.5_f64.powi(halvings as i32));
        // A step shorter than the one to the first surface would leave the active set unchanged.
        for share in shares.take_while(|share| *share > stop) {
            let next = self.contacts.approach(from, minimiser, share);
            if system.gain(from, &next) <= 0.0 {
                return next;
            }
        }
        self.contacts.approach(from, minimiser, stop)
    }

    /// Constrains all surfaces that velocities (m/s) touch.
    pub fn hold_all_touching(&mut self, velocity: &[[f64; 3]]) {
        self.contacts.hold_all_touching(velocity);
    }

    /// Projectors of the next solve; sets the velocities (m/s) in constrained directions.
    pub fn hold(&self, velocity: &mut [[f64; 3]]) -> Vec<Freedom> {
        self.contacts.hold(velocity)
    }
}
