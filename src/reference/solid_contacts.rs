//! `right_hand_side`, for solids, second part: the directions in which walls and obstacles hold nodes in a sub-step.
//!
//! A node at a gap d (m) from a wall or obstacle with the normal n, away from it, may not be beyond it after the next move,
//! d + dt v . n >= 0, and what keeps it out pushes only, f >= 0, and only where it is on the surface, f (d + dt v . n) = 0. Which nodes
//! are held is found by a primal-dual active set (Hintermueller, Ito & Kunisch 2003): solve with some of them held at v . n = -d/dt, hold
//! also those that are beyond a surface then, let those go that it would have to pull, and solve again while anything changes. On matrices
//! like S this may go in circles, so late solves let none go: a node may then be pulled for a sub-step, but is beyond no surface.

use glam::{DMat3, DVec3};

use super::SolidSystem;
use super::sample::normal;
use crate::elastic::Solids;
use crate::grid::Grid;

/// Solves of a sub-step in search of what is held, at most. What is beyond a surface after the last is put back by the next move.
pub const MOST_SOLVES: u32 = 8;
/// After so many of them no node is let go: the search may go in circles, and each solve then only adds to what is held.
pub const LETTING_GO: u32 = 5;
/// A node this near, in cells, is held from the start if it is pressed to the surface.
const SKIN: f64 = 1e-3;
/// How far from where it should be, in cells, a node is left.
const NEAR: f64 = 1e-4;
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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
            3 => held[node].obstacle,
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
                    surface.held = held(node, which, surface, &freedom);
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

    /// After the solve of a number, counted from 1: holds nodes that are beyond a surface with the velocities v (m/s), and lets those go
    /// that would have to be pulled. How many of both there were. `system`: the one solved.
    pub fn update(&mut self, system: &SolidSystem, velocity: &[[f64; 3]], solve: u32) -> u32 {
        let ways = self.ways(system, velocity);
        let lets_go = solve <= LETTING_GO;
        let mut changes = 0;
        for (surfaces, ways) in self.surfaces.iter_mut().zip(ways) {
            for (surface, way) in surfaces.iter_mut().zip(ways) {
                if let (Some(surface), true) = (surface, way < -self.near)
                    && (lets_go || !surface.held)
                {
                    surface.held = !surface.held;
                    changes += 1;
                }
            }
        }
        changes
    }

    /// How far, m, a node is beyond a surface at most with the velocities v (m/s), or pulled; what is held is left out unless the search
    /// lets go.
    pub fn worst(&self, system: &SolidSystem, velocity: &[[f64; 3]], lets_go: bool) -> f64 {
        let ways = self.ways(system, velocity).into_iter().flatten();
        let judged = self.surfaces.iter().flatten().zip(ways);
        let judged = judged.filter(|(surface, _)| lets_go || surface.is_none_or(|s| !s.held));
        judged.fold(0.0, |worst, (_, way)| f64::max(worst, -way))
    }

    /// How far the push of what holds a node would move it, or where nothing does, how far from the surface it is after the move, m;
    /// infinite where there is nothing.
    fn ways(&self, system: &SolidSystem, velocity: &[[f64; 3]]) -> Vec<[f64; 4]> {
        let moved = system.multiply(velocity);
        let way = |node: usize, surface: &Surface, freedom: &mut Freedom| {
            let Some((direction, _)) = freedom.shared(surface.normal) else {
                return f64::INFINITY;
            };
            if surface.held {
                let push = moved[node] - DVec3::from(system.forces()[node]);
                freedom.hold(surface.normal, 0.0, DVec3::ZERO);
                self.dt * push.dot(direction) / system.mean_diagonal(node)
            } else {
                surface.gap + self.dt * DVec3::from(velocity[node]).dot(surface.normal)
            }
        };
        let nodes = self.surfaces.iter().enumerate();
        nodes
            .map(|(node, surfaces)| {
                let mut freedom = Freedom::of(self.prescribed[node]);
                surfaces.each_ref().map(|surface| match surface {
                    Some(surface) => way(node, surface, &mut freedom),
                    None => f64::INFINITY,
                })
            })
            .collect()
    }
}
