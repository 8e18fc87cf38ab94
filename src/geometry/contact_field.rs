//! Obstacles as the nodes of solids meet them: distance of the cell centres, and rigid motion of the nearest moving
//! obstacle.

use glam::DVec3;

use super::distance::{BAND, Body};
use super::obstacles::MovingBody;
use crate::grid::Grid;
use crate::scene::{Acceleration, Keyframe, Scene};

/// Rigid velocity field v(x) = velocity + spin x (x - centre). Its net flux through a closed surface is zero.
#[derive(Clone, Copy, Debug)]
pub struct RigidVelocity {
    /// m/s
    pub velocity: DVec3,
    /// rad/s
    pub spin: DVec3,
    /// m
    pub centre: DVec3,
}

impl RigidVelocity {
    /// The velocity of a point (m), m/s.
    pub fn at(&self, x: DVec3) -> DVec3 {
        self.velocity + self.spin.cross(x - self.centre)
    }
}

/// Coefficients of friction of walls and obstacles at rest.
#[derive(Clone, Debug, Default)]
pub struct SurfaceFriction {
    /// Of the walls.
    pub walls: f64,
    /// Per cell, of the nearest obstacle at rest; empty without friction of these.
    pub at_rest: Vec<f64>,
}

/// Distance to the obstacles, and their motions.
#[derive(Clone, Debug)]
pub struct ContactField {
    /// The grid.
    pub grid: Grid,
    /// Signed distance of the cell centres to the union of the obstacles, m.
    pub distance: Vec<f64>,
    /// Per cell: number of the nearest moving obstacle, from 1; 0 beside obstacles at rest and more than three cells off.
    /// Empty without moving obstacles.
    pub nearest: Vec<u32>,
    /// Motions of the moving obstacles.
    pub motions: Vec<RigidVelocity>,
    /// Friction of walls and obstacles at rest.
    pub friction: SurfaceFriction,
    bodies: Vec<MovingBody>,
    /// Distance to the obstacles at rest, m.
    at_rest: Vec<f64>,
    /// Cells with another distance than to the obstacles at rest, ascending.
    changed: Vec<usize>,
}

impl ContactField {
    /// Obstacles at rest, without friction. `distance` of the cell centres, m.
    pub fn at_rest(grid: &Grid, distance: Vec<f64>) -> ContactField {
        ContactField {
            grid: *grid,
            distance,
            nearest: Vec::new(),
            motions: Vec::new(),
            friction: SurfaceFriction::default(),
            bodies: Vec::new(),
            at_rest: Vec::new(),
            changed: Vec::new(),
        }
    }

    /// These obstacles at rest, and moving ones, which must be moved to a time first.
    pub(super) fn with_moving(self, bodies: Vec<MovingBody>) -> ContactField {
        ContactField { nearest: vec![0; self.distance.len()], at_rest: self.distance.clone(), bodies, ..self }
    }

    /// Copies the keyframes from a scene with the same obstacles.
    pub fn follow(&mut self, scene: &Scene) {
        let motions = scene.obstacles.iter().filter_map(|of| of.motion.as_ref());
        for (body, motion) in self.bodies.iter_mut().zip(motions) {
            body.motion.keyframes.clone_from(&motion.keyframes);
        }
    }

    /// Whether an obstacle moves.
    pub fn moves(&self) -> bool {
        !self.nearest.is_empty()
    }

    /// Upper bound of the speed of all obstacles between a time and `span` (both s) later, m/s.
    pub fn max_speed(&self, time: f64, span: f64) -> f64 {
        let bodies = self.bodies.iter();
        let speeds = bodies.map(|body| Keyframe::max_speed(&body.motion.keyframes, body.radius, time, span));
        speeds.fold(0.0, f64::max)
    }

    /// Prescribed accelerations of all obstacles.
    pub fn accelerations(&self) -> Vec<Acceleration> {
        let of = |body: &MovingBody| Keyframe::accelerations(&body.motion.keyframes, body.radius);
        self.bodies.iter().flat_map(of).collect()
    }

    /// Moves the obstacles to a time (s). Their velocities lead to their poses dt (s) later; with dt = 0 they are
    /// instantaneous.
    pub fn move_to(&mut self, time: f64, dt: f64) {
        self.moved_to(time, dt);
    }

    /// The same; returns the moved obstacles.
    pub(super) fn moved_to(&mut self, time: f64, dt: f64) -> Vec<Body> {
        for cell in self.changed.drain(..) {
            (self.distance[cell], self.nearest[cell]) = (self.at_rest[cell], 0);
        }
        let (grid, bodies) = (self.grid, &self.bodies);
        let velocities = bodies.iter().map(|body| body.velocity(time, dt));
        self.motions = velocities.collect();
        let now: Vec<Body> = bodies.iter().map(|body| body.at(time).beyond_walls(&grid)).collect();
        for (number, body) in (1..).zip(&now) {
            for (cell, distance) in body.near(&grid) {
                if distance < self.distance[cell] {
                    self.changed.push(cell);
                    self.distance[cell] = distance;
                    self.nearest[cell] = match distance > -BAND * grid.dx {
                        true => number,
                        false => 0,
                    };
                }
            }
        }
        self.changed.sort_unstable();
        self.changed.dedup();
        now
    }

    /// Cells with another distance than to the obstacles at rest, ascending.
    pub(super) fn changed(&self) -> &[usize] {
        &self.changed
    }

    /// Velocity of the moving obstacle that is nearest to the cell of a point (m), at the point, m/s.
    pub fn velocity(&self, x: DVec3) -> Option<DVec3> {
        Some(self.motions[self.moving_near(self.cell(x))?].at(x))
    }

    /// Coefficient of friction of the obstacle that is nearest to the cell of a point, m.
    pub fn friction(&self, x: DVec3) -> f64 {
        let cell = self.cell(x);
        match self.moving_near(cell) {
            Some(number) => self.bodies.get(number).map_or(0.0, |body| body.friction),
            None => self.friction.at_rest.get(cell).copied().unwrap_or(0.0),
        }
    }

    fn cell(&self, x: DVec3) -> usize {
        let cells = self.grid.cells;
        let at = (x / self.grid.dx).to_array();
        self.grid.cell(std::array::from_fn(|axis| (at[axis].max(0.0) as usize).min(cells[axis] - 1)))
    }

    /// Number of the moving obstacle that is nearest to a cell, from 0.
    fn moving_near(&self, cell: usize) -> Option<usize> {
        (*self.nearest.get(cell)? as usize).checked_sub(1)
    }
}
