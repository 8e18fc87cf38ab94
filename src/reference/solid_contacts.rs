//! `right_hand_side`, for solids, second part: the directions in which walls and obstacles hold nodes in a sub-step.
//!
//! A node at a gap d (m) from a wall or obstacle with the normal n, away from it, may not be beyond it after the next move,
//! d + dt v . n >= 0, and what keeps it out pushes only, f >= 0, and only where it is on the surface, f (d + dt v . n) = 0: v is where
//! phi(v) = v . S v / 2 - F . v is least among the velocities with d + dt v . n >= 0, F being all forces, those of the liquid too. A
//! primal active-set method finds it (Nocedal & Wright, Numerical Optimization, 2006, section 16.5), that takes many constraints at once
//! where it can (as projected Newton methods do, Bertsekas 1982). Some velocity v that takes no node beyond a surface is known, and some
//! nodes are held on theirs, v . n = -d/dt. A solve finds the least phi with these, w. Where w takes a node beyond a surface, v goes towards
//! w: the whole way with each node put back before its surfaces, or half of it, and so on, if phi does not grow, otherwise straight on until
//! the first node is on a surface; and what is on a surface then and goes on beyond it at w is held too. Where it does not, v = w, and those
//! that are pulled to their surfaces are let go. Once none is, w is the answer. No v on the way takes a node beyond a surface, and phi, which is
//! 0 at rest, does not grow from one to the next, but for nodes that were beyond a surface before, for what the liquid's forces change
//! between solves, and for what solves that end at their rounding are off: the search may end after any of them.

use glam::{DMat3, DVec3};

use super::SolidSystem;
use super::sample::normal;
use crate::elastic::Solids;
use crate::grid::Grid;
use crate::state::ContactReport;

/// Solves of a sub-step in search of what is held, at most, with the one for a pressure that goes with velocities the search ended at.
pub const MOST_SOLVES: u32 = 20;
/// Halvings of the way from a velocity to the one that a solve found, at most, before it is straight on to the first surface.
pub const MOST_HALVINGS: u32 = 3;
/// How often a node is put back before one surface after the other, as it may be beyond the first again then.
const SWEEPS: u32 = 4;
/// A node this near, in cells, is held from the start if it is pressed to the surface.
const SKIN: f64 = 1e-3;
/// How far from where it should be, in cells, a node is left, and from a surface on it.
const NEAR: f64 = 1e-4;
/// Place of an obstacle among the surfaces of a node, after three walls.
const OBSTACLE: usize = 3;
/// An obstacle does not hold a node whose free components are further from its normal: what holds the others does.
const LEAST_SHARE: f64 = 0.1;

/// How a node may move in a sub-step: x in the range of a projector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Freedom {
    /// Components that are not prescribed.
    pub free: [bool; 3],
    /// On the directions among these that nothing holds; symmetric.
    pub projector: DMat3,
}

impl Freedom {
    /// Of a node that touches nothing.
    pub fn of(prescribed: [bool; 3]) -> Freedom {
        let free = prescribed.map(|prescribed| !prescribed);
        let ones = free.map(|free| if free { 1.0 } else { 0.0 });
        Freedom {
            free,
            projector: DMat3::from_diagonal(DVec3::from(ones)),
        }
    }

    /// Of a node that walls leave components, and of which an obstacle holds a direction: a unit vector of these components, or 0.
    pub fn left(prescribed: [bool; 3], components: [bool; 3], held: DVec3) -> Freedom {
        let ones = components.map(|free| if free { 1.0 } else { 0.0 });
        Freedom {
            projector: DMat3::from_diagonal(DVec3::from(ones)) - square(held),
            ..Freedom::of(prescribed)
        }
    }

    /// Of a node that keeps the velocity it has.
    pub fn none(prescribed: [bool; 3]) -> Freedom {
        Freedom {
            projector: DMat3::ZERO,
            ..Freedom::of(prescribed)
        }
    }

    /// Of all nodes, where none touches anything.
    pub fn all(solids: &Solids) -> Vec<Freedom> {
        let prescribed = solids.prescribed.iter();
        prescribed
            .map(|&prescribed| Freedom::of(prescribed))
            .collect()
    }

    /// Directions that are free: 0 to 3.
    pub fn rank(&self) -> usize {
        let diagonal = [0, 1, 2].map(|axis| self.projector.col(axis)[axis]);
        diagonal.iter().sum::<f64>().round() as usize
    }

    /// Takes from the free directions what they share with n, and returns the velocity with the rate that v . n is to have. Nothing where
    /// they share little.
    fn hold(&mut self, n: DVec3, rate: f64, v: DVec3) -> DVec3 {
        let Some((direction, share)) = self.shared(n) else {
            return v;
        };
        self.projector -= square(direction);
        v + (rate - v.dot(n)) / share * direction
    }

    /// The free direction nearest to n, and its cosine with n.
    fn shared(&self, n: DVec3) -> Option<(DVec3, f64)> {
        let free = self.projector * n;
        let share = free.length();
        (share >= LEAST_SHARE).then(|| (free / share, share))
    }
}

/// What holds a node in a sub-step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Held {
    /// Per component: whether the nearer wall across it does.
    pub walls: [bool; 3],
    /// Whether an obstacle does.
    pub obstacle: bool,
}

/// n n^T.
fn square(n: DVec3) -> DMat3 {
    let [x, y, z] = n.to_array().map(|part| part * n);
    DMat3::from_cols(x, y, z)
}

/// A wall or obstacle near a node.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Surface {
    /// Unit normal, away from it.
    normal: DVec3,
    /// Distance of the node from it, m.
    gap: f64,
    held: bool,
}

impl Surface {
    fn new(normal: DVec3, gap: f64) -> Surface {
        let held = false;
        Surface { normal, gap, held }
    }
}

/// The walls and obstacles that nodes may meet in a sub-step, and which of them hold nodes.
#[derive(Clone, Debug)]
pub struct Contacts {
    /// Per node: the nearer walls across x, y, z, in the components that are not prescribed, then the obstacles.
    surfaces: Vec<[Option<Surface>; 4]>,
    prescribed: Vec<[bool; 3]>,
    /// s
    dt: f64,
    /// m
    near: f64,
}

impl Contacts {
    /// Before the first solve of a sub-step of dt (s): nodes that touch something are held where their forces M v*/dt - (K x* - b) + load
    /// press them to it. `solid_distance`: per cell, m; `displacement`: m; `forces`: N.
    pub fn new(
        solids: &Solids,
        grid: &Grid,
        solid_distance: &[f64],
        displacement: &[[f64; 3]],
        forces: &[[f64; 3]],
        dt: f64,
    ) -> Contacts {
        let skin = SKIN * grid.dx;
        let pressed = |node: usize, _: usize, surface: &Surface, freedom: &Freedom| {
            let force = freedom.projector * DVec3::from(forces[node]);
            surface.gap <= skin && force.dot(surface.normal) < 0.0
        };
        Contacts::with(solids, grid, solid_distance, displacement, dt, pressed)
    }

    /// Where nodes are held as `held` says of each: how one may move does not tell by what, as an obstacle's face may lie along a wall.
    pub fn holding(
        solids: &Solids,
        grid: &Grid,
        solid_distance: &[f64],
        displacement: &[[f64; 3]],
        held: &[Held],
        dt: f64,
    ) -> Contacts {
        let held = |node: usize, which: usize, _: &Surface, _: &Freedom| match which {
            OBSTACLE => held[node].obstacle,
            axis => held[node].walls[axis],
        };
        Contacts::with(solids, grid, solid_distance, displacement, dt, held)
    }

    /// With the surfaces that `held` says: of a node, which of the four, and what those before it leave free.
    fn with(
        solids: &Solids,
        grid: &Grid,
        solid_distance: &[f64],
        displacement: &[[f64; 3]],
        dt: f64,
        held: impl Fn(usize, usize, &Surface, &Freedom) -> bool,
    ) -> Contacts {
        let surfaces = (0..solids.rest.len()).map(|node| {
            let x = solids.rest[node] + DVec3::from(displacement[node]);
            let wall = |axis: usize| {
                let above = grid.size()[axis] - x[axis];
                let (sign, gap) = if x[axis] <= above {
                    (1.0, x[axis])
                } else {
                    (-1.0, above)
                };
                let free = !solids.prescribed[node][axis];
                free.then(|| Surface::new(sign * DVec3::AXES[axis], gap))
            };
            let obstacle = normal(grid, solid_distance, x)
                .map(|normal| Surface::new(normal, grid.sample_cells(solid_distance, x)));
            let mut found = [wall(0), wall(1), wall(2), obstacle];
            let mut freedom = Freedom::of(solids.prescribed[node]);
            for (which, surface) in found.iter_mut().enumerate() {
                if let Some(surface) = surface {
                    let moves = freedom.shared(surface.normal).is_some();
                    surface.held = moves && held(node, which, surface, &freedom);
                    if surface.held {
                        freedom.hold(surface.normal, 0.0, DVec3::ZERO);
                    }
                }
            }
            found
        });
        Contacts {
            surfaces: surfaces.collect(),
            prescribed: solids.prescribed.clone(),
            dt,
            near: NEAR * grid.dx,
        }
    }

    /// No node moves but those of which a velocity (m/s) is prescribed and those that are beyond a surface.
    pub fn at_rest(&self, velocity: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let nodes = self.prescribed.iter().zip(velocity);
        let mut rest: Vec<[f64; 3]> = nodes
            .map(|(prescribed, v)| {
                [0, 1, 2].map(|axis| if prescribed[axis] { v[axis] } else { 0.0 })
            })
            .collect();
        self.put_back(&mut rest);
        rest
    }

    /// The velocities (m/s) at a share of the way from one to another, put back.
    pub fn approach(&self, from: &[[f64; 3]], to: &[[f64; 3]], share: f64) -> Vec<[f64; 3]> {
        let between = |from: f64, to: f64| from + share * (to - from);
        let pairs = from.iter().zip(to);
        let mut next: Vec<[f64; 3]> = pairs
            .map(|(from, to)| std::array::from_fn(|axis| between(from[axis], to[axis])))
            .collect();
        self.put_back(&mut next);
        next
    }

    /// The share of the way from velocities to others (m/s) at which the first of the nodes that go on beyond a surface is on it.
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

    /// How far, m, a node may be left beyond a surface, or pulled.
    pub fn near(&self) -> f64 {
        self.near
    }

    /// How the nodes may move; the velocities (m/s) get what they are held at.
    pub fn hold(&self, velocity: &mut [[f64; 3]]) -> Vec<Freedom> {
        let nodes = self.surfaces.iter().zip(&self.prescribed).zip(velocity);
        nodes
            .map(|((surfaces, prescribed), velocity)| {
                let mut freedom = Freedom::of(*prescribed);
                let mut v = DVec3::from(*velocity);
                for surface in surfaces.iter().flatten().filter(|surface| surface.held) {
                    v = freedom.hold(surface.normal, -surface.gap / self.dt, v);
                }
                *velocity = v.to_array();
                freedom
            })
            .collect()
    }

    /// What is wrong with the velocities w (m/s) that a solve of a system with all forces found. Less than [`Contacts::near`] beyond or
    /// pulled is not.
    pub fn judge(&self, system: &SolidSystem, found: &[[f64; 3]]) -> Wrong {
        let mut wrong = Wrong::default();
        for (node, push) in self.pushes(system, found).into_iter().enumerate() {
            let gaps = self.gaps(node, DVec3::from(found[node]));
            let held = self.held(node);
            let shares = self.shares(node, held, push);
            for which in 0..=OBSTACLE {
                let far = |length: f64| length < -self.near;
                match shares[which] {
                    Some(share) if held[which] => wrong.pulled += u32::from(far(share)),
                    Some(_) => wrong.beyond += u32::from(far(gaps[which])),
                    None => {}
                }
            }
        }
        wrong
    }

    /// Lets those nodes go that the velocities w (m/s) have pulled to what holds them. `system`: with all forces.
    pub fn let_go(&mut self, system: &SolidSystem, found: &[[f64; 3]]) {
        for (node, push) in self.pushes(system, found).into_iter().enumerate() {
            let shares = self.shares(node, self.held(node), push);
            for (surface, share) in self.surfaces[node].iter_mut().zip(shares) {
                if let Some(surface) = surface {
                    surface.held &= share.is_some_and(|share| share >= -self.near);
                }
            }
        }
    }

    /// Holds also what is on a surface with the velocities v and beyond it with w (m/s).
    pub fn hold_stopped(&mut self, best: &[[f64; 3]], found: &[[f64; 3]]) {
        self.hold_touching(best, Some(found));
    }

    /// Holds also what is on a surface with the velocities v (m/s).
    pub fn hold_all_touching(&mut self, best: &[[f64; 3]]) {
        self.hold_touching(best, None);
    }

    /// Holds also what is on a surface with the velocities v and, where there are others w (m/s), beyond it with these.
    fn hold_touching(&mut self, best: &[[f64; 3]], found: Option<&[[f64; 3]]>) {
        for node in 0..best.len() {
            let touches = self
                .gaps(node, best[node].into())
                .map(|gap| gap < self.near);
            let goes_on = match found {
                Some(found) => self
                    .gaps(node, found[node].into())
                    .map(|gap| gap < -self.near),
                None => [true; 4],
            };
            for which in 0..=OBSTACLE {
                // What walls leave of an obstacle's normal is asked after these.
                let shares = self.shares(node, self.held(node), DVec3::ZERO);
                if let Some(surface) = &mut self.surfaces[node][which] {
                    surface.held |= touches[which] && goes_on[which];
                    surface.held &= shares[which].is_some();
                }
            }
        }
    }

    /// The velocities (m/s), of each node the nearest that takes it beyond nothing, or nearly so where surfaces meet.
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

    /// How far, m, a node is beyond a surface at most with the velocities v (m/s).
    pub fn beyond(&self, velocity: &[[f64; 3]]) -> f64 {
        (0..velocity.len()).fold(0.0, |worst, node| {
            let gaps = self.gaps(node, DVec3::from(velocity[node]));
            let free = self.shares(node, self.held(node), DVec3::ZERO);
            let gaps = gaps.into_iter().zip(free);
            gaps.filter(|(_, free)| free.is_some())
                .fold(worst, |worst, (gap, _)| f64::max(worst, -gap))
        })
    }

    /// How far, m, a node is pulled at most to what holds it with the velocities v (m/s). `system`: with all forces.
    pub fn pulled(&self, system: &SolidSystem, velocity: &[[f64; 3]]) -> f64 {
        let pushes = self.pushes(system, velocity).into_iter().enumerate();
        pushes.fold(0.0, |worst, (node, push)| {
            let held = self.held(node);
            let shares = self.shares(node, held, push).into_iter().zip(held);
            shares
                .filter(|(_, held)| *held)
                .fold(worst, |worst, (share, _)| {
                    f64::max(worst, -share.unwrap_or(0.0))
                })
        })
    }

    /// How far the push of what holds each node, S v - F, would move it in a sub-step, alone, m.
    fn pushes(&self, system: &SolidSystem, velocity: &[[f64; 3]]) -> Vec<DVec3> {
        let products = system.multiply(velocity).into_iter().enumerate();
        products
            .map(|(node, product)| {
                let push = product - DVec3::from(system.forces()[node]);
                self.dt * push / system.mean_diagonal(node)
            })
            .collect()
    }

    /// Distances of a node after a move with the velocity v, m; infinite from what is not there.
    fn gaps(&self, node: usize, v: DVec3) -> [f64; 4] {
        let gap = |surface: &Surface| surface.gap + self.dt * v.dot(surface.normal);
        let surfaces = self.surfaces[node].each_ref();
        surfaces.map(|surface| surface.as_ref().map_or(f64::INFINITY, gap))
    }

    fn held(&self, node: usize) -> [bool; 4] {
        self.surfaces[node].map(|surface| surface.is_some_and(|surface| surface.held))
    }

    /// Of the push on a node, what each of the surfaces that hold it has along its normal, m, and what any other would have besides.
    /// `None` where there is no surface, or walls leave an obstacle nothing to hold.
    fn shares(&self, node: usize, held: [bool; 4], push: DVec3) -> [Option<f64>; 4] {
        let surfaces = self.surfaces[node];
        let mut freedom = Freedom::of(self.prescribed[node]);
        for (surface, held) in surfaces[..OBSTACLE].iter().zip(held) {
            if let (Some(surface), true) = (surface, held) {
                freedom.hold(surface.normal, 0.0, DVec3::ZERO);
            }
        }
        let of_obstacle = surfaces[OBSTACLE].and_then(|surface| {
            let (direction, share) = freedom.shared(surface.normal)?;
            Some((push.dot(direction) / share, surface.normal))
        });
        // Walls have what an obstacle leaves them.
        let left = match of_obstacle {
            Some((share, normal)) if held[OBSTACLE] => push - share * normal,
            _ => push,
        };
        let mut shares = surfaces.map(|surface| surface.map(|surface| left.dot(surface.normal)));
        shares[OBSTACLE] = of_obstacle.map(|(share, _)| share);
        shares
    }
}

/// What is wrong with what a solve found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wrong {
    /// Nodes that end beyond a surface.
    pub beyond: u32,
    /// Nodes that are pulled to a surface.
    pub pulled: u32,
}

/// The search of a sub-step for what walls and obstacles hold, from one solve to the next.
#[derive(Debug)]
pub struct ContactSearch<'a> {
    contacts: &'a mut Contacts,
    /// The best velocity that takes no node beyond a surface, m/s; none before a solve that found another.
    best: Option<Vec<[f64; 3]>>,
    solves: u32,
    most: u32,
}

/// What a solve was to the search.
#[derive(Clone, Debug, PartialEq)]
pub struct Searched {
    /// What it found, if that settles the search, otherwise the best so far, m/s.
    pub velocity: Vec<[f64; 3]>,
    /// Whether the search is at its end.
    pub ended: bool,
    /// How it stands.
    pub report: ContactReport,
}

impl<'a> ContactSearch<'a> {
    /// Before the first solve, of so many at most. `contacts`: what it is solved with.
    pub fn new(contacts: &'a mut Contacts, most: u32) -> ContactSearch<'a> {
        ContactSearch {
            contacts,
            best: None,
            solves: 0,
            most,
        }
    }

    /// After a solve that found velocities, m/s: holds what the next one is to hold. `system`: the one solved, with all forces; `last`:
    /// whether no other solve can follow.
    pub fn after(&mut self, system: &SolidSystem, found: Vec<[f64; 3]>, last: bool) -> Searched {
        self.solves += 1;
        let wrong = self.contacts.judge(system, &found);
        let report = ContactReport {
            solves: self.solves,
            unsettled: wrong.beyond + wrong.pulled,
        };
        if report.unsettled == 0 {
            return Searched {
                velocity: found,
                ended: true,
                report,
            };
        }
        let velocity = if wrong.beyond == 0 {
            self.contacts.let_go(system, &found);
            found
        } else {
            let from = self.best.take();
            let from = from.unwrap_or_else(|| self.contacts.at_rest(&found));
            let next = self.towards(system, &from, &found);
            self.contacts.hold_stopped(&next, &found);
            next
        };
        self.best = Some(velocity.clone());
        Searched {
            velocity,
            ended: last || self.solves == self.most,
            report,
        }
    }

    /// Goes from velocities to others (m/s) as far as it goes.
    fn towards(
        &self,
        system: &SolidSystem,
        from: &[[f64; 3]],
        found: &[[f64; 3]],
    ) -> Vec<[f64; 3]> {
        let stop = self.contacts.first_stop(from, found);
        let shares = (0..=MOST_HALVINGS).map(|halvings| 0.5_f64.powi(halvings as i32));
        // Less than up to the first surface leaves the next solve what this one had.
        for share in shares.take_while(|share| *share > stop) {
            let next = self.contacts.approach(from, found, share);
            if system.gain(from, &next) <= 0.0 {
                return next;
            }
        }
        self.contacts.approach(from, found, stop)
    }

    /// Holds also what velocities (m/s) leave on a surface.
    pub fn hold_all_touching(&mut self, velocity: &[[f64; 3]]) {
        self.contacts.hold_all_touching(velocity);
    }

    /// How the nodes may move in the next solve; the velocities (m/s) get what they are held at.
    pub fn hold(&self, velocity: &mut [[f64; 3]]) -> Vec<Freedom> {
        self.contacts.hold(velocity)
    }
}
