//! Assembles the solids of a scene from their meshes: masses, constraints, loads, initial state.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::{
    Body, Deformation, Pivot, RotatingBody, Script, Solids, TimedLoad, lame_parameters, rest_shape, stress, von_mises,
};
use crate::error::{Error, rounded};
use crate::geometry::{MovedMesh, TetMesh, bounds, deepest_obstacle, inside};
use crate::grid::{Axis, Sides};
use crate::scene::{ElasticModel, Keyframe, Load, LoadKind, Pin, Scene, Shape, Solid};

/// Distance of nodes from a straight hinge, relative to its length.
const STRAIGHT: f64 = 1e-6;

impl Solids {
    /// The solids of a scene with their placed meshes.
    ///
    /// # Errors
    /// [`Error::Input`] with file and key: pins and loads without nodes, conflicting pins of one component, rotations about
    /// a shape without centre.
    pub fn new(scene: &Scene, meshes: &[TetMesh]) -> Result<Solids, Error> {
        let mut solids = Solids::from_solids(&scene.solids, meshes, &|key| scene.at(key))?;
        solids.constrain_to_symmetry(scene)?;
        solids.find_probed(scene)?;
        Ok(solids)
    }

    /// Solids without a scene; `at` returns the origin of a key for errors.
    pub fn from_solids(solids: &[Solid], meshes: &[TetMesh], at: &dyn Fn(&str) -> String) -> Result<Solids, Error> {
        let mut all = Solids::default();
        for (number, (solid, mesh)) in solids.iter().zip(meshes).enumerate() {
            all.push(solid, mesh, &|key| at(&format!("solid[{number}].{key}")))?;
        }
        Ok(all)
    }

    /// `at`: origin of a key of the solid.
    fn push(&mut self, solid: &Solid, mesh: &TetMesh, at: &dyn Fn(&str) -> String) -> Result<(), Error> {
        let first_node = self.rest.len();
        let (first_element, first_triangle) = (self.elements.len(), self.triangles.len());
        let n_nodes = first_node + mesh.nodes.len();
        let shifted = |node: u32| node + first_node as u32;
        self.rest.extend(&mesh.nodes);
        self.mass.resize(n_nodes, 0.0);
        self.prescribed.resize(n_nodes, [false; 3]);
        self.constant_load.resize(n_nodes, DVec3::ZERO);
        for corners in &mesh.elements {
            let corners = corners.map(shifted);
            let (gradients, volume) = rest_shape(corners.map(|corner| self.rest[corner as usize]));
            for corner in corners {
                self.mass[corner as usize] += 0.25 * solid.density * volume;
            }
            self.elements.push(corners);
            self.gradients.push(gradients);
            self.volume.push(volume);
        }
        let surface = mesh.surface().into_iter();
        self.triangles.extend(surface.map(|triangle| triangle.map(shifted)));
        let [lambda, mu] = lame_parameters(solid.young, solid.poisson);
        let body = Body {
            name: solid.name.clone(),
            nodes: first_node..n_nodes,
            elements: first_element..self.elements.len(),
            triangles: first_triangle..self.triangles.len(),
            density: solid.density,
            lambda,
            mu,
            model: solid.model,
            mass_damping: solid.mass_damping,
            stiffness_damping: solid.stiffness_damping,
            friction: solid.friction,
            contact: solid.contact,
            no_contact_with: solid.no_contact_with.clone(),
            self_contact: solid.self_contact,
        };
        let mut owners = vec![[None; 3]; mesh.nodes.len()];
        for (number, pin) in solid.pins.iter().enumerate() {
            self.pin(&body, pin, number, at, &mut owners, &solid.pins)?;
        }
        for (number, load) in solid.loads.iter().enumerate() {
            self.load(&body, load, &at(&format!("load[{number}]")))?;
        }
        self.load.clone_from(&self.constant_load);
        self.set_load([0.0; 2]);
        self.bodies.push(body);
        Ok(())
    }

    /// Constrains the nodes on planes of symmetry: they roll along them.
    fn constrain_to_symmetry(&mut self, scene: &Scene) -> Result<(), Error> {
        let (planes, size) = (scene.domain.symmetry, scene.domain.size);
        let slack = WALL_TOLERANCE * size.max_element();
        for (axis, side) in Axis::ALL.into_iter().flat_map(|axis| [(axis, 0), (axis, 1)]) {
            if !planes.has(axis, side) {
                continue;
            }
            let axis = axis.index();
            let name = Sides::NAMES[2 * axis + side];
            let on_plane = |x: DVec3| (x[axis] - [0.0, size[axis]][side]).abs() <= slack;
            for (number, (body, solid)) in self.bodies.iter().zip(&scene.solids).enumerate() {
                let nodes: Vec<usize> = body.nodes.clone().filter(|&node| on_plane(self.rest[node])).collect();
                let refused = |key: &str, problem: String| {
                    let cure = format!("let the nodes on the side {name} stay there, or move the solid away from it");
                    Err(Error::input(scene.at(&format!("solid[{number}].{key}")), problem, cure))
                };
                if let Some(key) = solid.initial.moves_along(axis).filter(|_| !nodes.is_empty()) {
                    return refused(key, format!("moves nodes off the plane of symmetry {name}"));
                }
                let leaves = |script: &Script| {
                    let on_plane = nodes.iter().any(|&node| script.nodes.binary_search(&(node as u32)).is_ok());
                    on_plane && script.components[axis] && script.keyframes.iter().any(|frame| frame.moves_along(axis))
                };
                if self.scripts.iter().any(leaves) {
                    return refused("script", format!("moves nodes off the plane of symmetry {name}"));
                }
                for node in nodes {
                    self.prescribed[node][axis] = true;
                }
            }
        }
        Ok(())
    }

    /// Constrains the nodes of a pin. `owners`: the pin of each constrained component of the body's nodes.
    fn pin(
        &mut self,
        body: &Body,
        pin: &Pin,
        number: usize,
        at: &dyn Fn(&str) -> String,
        owners: &mut [[Option<usize>; 3]],
        pins: &[Pin],
    ) -> Result<(), Error> {
        let name = at(&key(pins, number));
        let nodes = self.nodes_in(body, &pin.region, &name)?;
        for &node in &nodes {
            for axis in (0..3).filter(|&axis| pin.components[axis]) {
                let owner = &mut owners[node as usize - body.nodes.start][axis];
                let still = |pin: &Pin| pin.keyframes.is_empty();
                if let Some(other) = *owner
                    && !(still(pin) && still(&pins[other]))
                {
                    let component = ["x", "y", "z"][axis];
                    let problem = format!(
                        "constrains {component} of the node at {}, and so does {}",
                        self.rest[node as usize],
                        key(pins, other)
                    );
                    let cure = "separate the regions or the components of scripts from those of other scripts and pins";
                    return Err(Error::input(name, problem, cure));
                }
                *owner = Some(number);
                self.prescribed[node as usize][axis] = true;
            }
        }
        if pin.keyframes.is_empty() {
            return Ok(());
        }
        let rotates = |frame: &Keyframe| frame.angle != 0.0;
        let centre = match pin.pivot.or(pin.region.centre()) {
            Some(centre) => centre,
            None if !pin.keyframes.iter().any(rotates) => DVec3::ZERO,
            None => {
                return Err(Error::input(
                    name,
                    "rotates its nodes about the centre of its region, which has none",
                    "use a box, sphere or cylinder, or remove the rotation",
                ));
            }
        };
        self.scripts.push(Script { nodes, components: pin.components, centre, keyframes: pin.keyframes.clone() });
        Ok(())
    }

    /// Adds a load to the forces on the nodes.
    fn load(&mut self, body: &Body, load: &Load, name: &str) -> Result<(), Error> {
        let nodes = self.nodes_in(body, &load.region, name)?;
        let mut weights: Vec<(u32, f64)> = Vec::new();
        let (value, divisor) = match load.kind {
            LoadKind::Force(force) => {
                weights.extend(nodes.iter().map(|&node| (node, 1.0)));
                (force, nodes.len() as f64)
            }
            LoadKind::Traction(traction) => {
                let in_region = |node: &u32| nodes.binary_search(node).is_ok();
                let mut any = false;
                for triangle in &self.triangles[body.triangles.clone()] {
                    if !triangle.iter().all(in_region) {
                        continue;
                    }
                    any = true;
                    let [a, b, c] = triangle.map(|node| self.rest[node as usize]);
                    let area = 0.5 * (b - a).cross(c - a).length();
                    // Each node has a third of the area, the integral of its shape function.
                    weights.extend(triangle.map(|node| (node, area / 3.0)));
                }
                if !any {
                    return Err(Error::input(
                        name,
                        "no surface triangle has all three nodes in the region",
                        "enlarge the region to contain the loaded part of the surface",
                    ));
                }
                (traction, 1.0)
            }
        };
        if load.keyframes.is_empty() {
            for (node, weight) in weights {
                self.constant_load[node as usize] += weight * value / divisor;
            }
        } else {
            self.timed_loads.push(TimedLoad { weights, divisor, keyframes: load.keyframes.clone() });
        }
        Ok(())
    }

    /// Nodes of a body that rest inside a shape or on it, ascending. An empty list is an error.
    pub(super) fn nodes_in(&self, body: &Body, shape: &Shape, name: &str) -> Result<Vec<u32>, Error> {
        let rest = &self.rest[body.nodes.clone()];
        let inside = inside(shape, rest)?;
        let nodes = body.nodes.clone().zip(inside);
        let nodes: Vec<u32> = nodes.filter(|(_, inside)| *inside).map(|(node, _)| node as u32).collect();
        if nodes.is_empty() {
            let [low, high] = bounds(rest.iter().copied());
            let [low, high] = [low, high].map(|x| DVec3::from(x.to_array().map(rounded)));
            let problem = format!("no node of \"{}\" rests in the region", body.name);
            let cure = format!("the nodes lie between {low} and {high} m: move or enlarge the region");
            return Err(Error::input(name, problem, cure));
        }
        Ok(nodes)
    }

    /// Initial displacement (m) and velocity (m/s) of all nodes.
    ///
    /// The body is stretched about the centroid of its rest shape, with the given velocity, spin and gradient. Constrained components
    /// have no velocity. Scripted components have the position and velocity of their script.
    pub fn initial_state(&self, scene: &Scene) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
        let n = self.rest.len();
        let (mut displacement, mut velocity) = (vec![[0.0; 3]; n], vec![[0.0; 3]; n]);
        for (body, solid) in self.bodies.iter().zip(&scene.solids) {
            let initial = &solid.initial;
            let centroid = self.centroid(body);
            for node in body.nodes.clone() {
                let arm = self.rest[node] - centroid;
                let u = (initial.scale - DVec3::ONE) * arm;
                let strained = initial.velocity_gradient.map(|row| row.dot(arm + u));
                let v = initial.velocity + initial.spin.cross(arm + u) + DVec3::from(strained);
                displacement[node] = u.to_array();
                velocity[node] = std::array::from_fn(|axis| match self.prescribed[node][axis] {
                    true => 0.0,
                    false => v[axis],
                });
            }
        }
        for script in &self.scripts {
            for &node in &script.nodes {
                let node = node as usize;
                let u = script.displacement(self.rest[node], 0.0);
                let v = script.velocity(self.rest[node], 0.0);
                for axis in (0..3).filter(|&axis| script.components[axis]) {
                    displacement[node][axis] = u[axis];
                    velocity[node][axis] = v[axis];
                }
            }
        }
        (displacement, velocity)
    }

    /// Centroid of a body at rest, m.
    pub fn centroid(&self, body: &Body) -> DVec3 {
        let nodes = || body.nodes.clone();
        let mass: f64 = nodes().map(|node| self.mass[node]).sum();
        let moment: DVec3 = nodes().map(|node| self.mass[node] * self.rest[node]).sum();
        moment / mass
    }

    /// Velocities (m/s) of scripted components from their displacements at a time (s) to those of their scripts dt (s)
    /// later; 0 elsewhere, empty without scripts.
    ///
    /// A step computes them after moving its nodes, and the next step moves with them. Nodes are exactly on their scripts
    /// for equal step lengths, else they lag by acceleration times the change of length. The first step uses
    /// [`Solids::start_scripts`].
    pub fn prescribed_velocity(&self, displacement: &[[f64; 3]], time: f64, dt: f64) -> Vec<[f64; 3]> {
        if self.scripts.is_empty() {
            return Vec::new();
        }
        let mut velocity = vec![[0.0; 3]; self.rest.len()];
        for script in &self.scripts {
            for &node in &script.nodes {
                let node = node as usize;
                let u = script.displacement(self.rest[node], time + dt);
                for axis in (0..3).filter(|&axis| script.components[axis]) {
                    velocity[node][axis] = (u[axis] - displacement[node][axis]) / dt;
                }
            }
        }
        velocity
    }

    /// Sets the velocities (m/s) of scripted components for the first step of dt (s), so that it ends on the scripts.
    /// Initial velocities are tangents, which overshoot keyframes within the step.
    pub fn start_scripts(&self, displacement: &[[f64; 3]], velocity: &mut [[f64; 3]], dt: f64) {
        let start = self.prescribed_velocity(displacement, 0.0, dt);
        for script in &self.scripts {
            for &node in &script.nodes {
                for axis in (0..3).filter(|&axis| script.components[axis]) {
                    velocity[node as usize][axis] = start[node as usize][axis];
                }
            }
        }
    }

    /// The deformed mesh for displacements of all nodes, m.
    pub fn moved(&self, displacement: &[[f64; 3]]) -> MovedMesh<'_> {
        let nodes = self.rest.iter().zip(displacement);
        MovedMesh {
            nodes: nodes.map(|(rest, u)| rest + DVec3::from(*u)).collect(),
            elements: &self.elements,
            triangles: &self.triangles,
            bodies: self.bodies.iter().map(|body| body.elements.clone()).collect(),
        }
    }

    /// Corotational bodies that are free, on rollers along one axis, or constrained in a point or along a line.
    pub fn rotating_bodies(&self) -> impl Iterator<Item = RotatingBody> {
        let corotational = |body: &&Body| body.model == ElasticModel::Corotational;
        let turning = |body: &Body| {
            let pivot = match self.constrained_nodes(body).as_slice() {
                [] => Pivot::Centroid,
                constrained => match self.rollers(constrained) {
                    Some(axis) => Pivot::Axis(axis),
                    None => Pivot::Hinge(self.hinge(constrained)?),
                },
            };
            let nodes = body.nodes.clone();
            Some(RotatingBody { nodes, pivot })
        };
        self.bodies.iter().filter(corotational).filter_map(turning)
    }

    /// Numbers and nodes of the bodies without constraints and loads.
    pub fn free_bodies(&self) -> impl Iterator<Item = (usize, Range<usize>)> {
        let free = |(_, body): &(usize, &Body)| {
            let mut timed = self.timed_loads.iter().flat_map(|load| &load.weights);
            let loaded = |node: usize| self.load[node] != DVec3::ZERO;
            self.constrained_nodes(body).is_empty()
                && !body.nodes.clone().any(loaded)
                && !timed.any(|&(node, _)| body.nodes.contains(&(node as usize)))
        };
        let bodies = self.bodies.iter().enumerate().filter(free);
        bodies.map(|(number, body)| (number, body.nodes.clone()))
    }

    /// Nodes of a body with constrained components.
    fn constrained_nodes(&self, body: &Body) -> Vec<usize> {
        let constrained = |node: &usize| self.prescribed[*node] != [false; 3];
        body.nodes.clone().filter(constrained).collect()
    }

    /// The component that all of these nodes have constrained, and no other.
    fn rollers(&self, constrained: &[usize]) -> Option<usize> {
        let only = |axis: usize| {
            let rolls = [0, 1, 2].map(|other| other == axis);
            let mut nodes = constrained.iter();
            nodes.all(|&node| self.prescribed[node] == rolls)
        };
        (0..3).find(|&axis| only(axis))
    }

    /// The two ends of a hinge: all nodes are fully constrained, not scripted, and lie on a line or in a point.
    fn hinge(&self, constrained: &[usize]) -> Option<[usize; 2]> {
        let scripted = |node: &usize| {
            let mut scripts = self.scripts.iter();
            scripts.any(|script| script.nodes.binary_search(&(*node as u32)).is_ok())
        };
        let fully = |node: &usize| self.prescribed[*node] == [true; 3];
        if !constrained.iter().all(fully) || constrained.iter().any(scripted) {
            return None;
        }
        let farthest = |from: usize| {
            let away = |node: usize| self.rest[node].distance_squared(self.rest[from]);
            let farther = |a: &&usize, b: &&usize| away(**a).total_cmp(&away(**b));
            constrained.iter().max_by(farther).copied()
        };
        let first = farthest(constrained[0])?;
        let last = farthest(first)?;
        let line = self.rest[last] - self.rest[first];
        let aside = |node: &usize| (self.rest[*node] - self.rest[first]).cross(line).length();
        let straight = |node: &usize| aside(node) <= STRAIGHT * line.length_squared();
        constrained.iter().all(straight).then_some([first, last])
    }

    /// Whether two bodies touch each other where they meet, or one itself.
    pub fn may_touch(&self, one: usize, other: usize) -> bool {
        let [a, b] = [one, other].map(|number| &self.bodies[number]);
        if one == other {
            return a.self_contact;
        }
        let excluded = a.no_contact_with.contains(&other) || b.no_contact_with.contains(&one);
        a.contact && b.contact && !excluded
    }

    /// The body of an element.
    pub fn body_of_element(&self, element: usize) -> &Body {
        &self.bodies[self.bodies.partition_point(|body| body.elements.end <= element)]
    }

    /// The body of a node.
    pub fn body_of_node(&self, node: usize) -> &Body {
        &self.bodies[self.bodies.partition_point(|body| body.nodes.end <= node)]
    }

    /// Deformation of an element for displacements of all nodes, m.
    pub fn deformation(&self, element: usize, displacement: &[[f64; 3]]) -> Deformation {
        let u = self.elements[element].map(|node| DVec3::from(displacement[node as usize]));
        let model = self.body_of_element(element).model;
        Deformation::new(&self.gradients[element], u, model)
    }

    /// Deformations of all elements. `displacement`: of all nodes, m.
    pub fn deformations(&self, displacement: &[[f64; 3]]) -> Vec<Deformation> {
        (0..self.elements.len()).into_par_iter().map(|element| self.deformation(element, displacement)).collect()
    }

    /// Von Mises stress (Pa) and det F of an element.
    ///
    /// The stress is P of the constitutive law, which for small strains is the Cauchy stress rotated by R^T, with the same
    /// von Mises stress. Unlike R P F^T / det F it is finite in flat elements.
    pub fn stress_and_determinant(&self, element: usize, displacement: &[[f64; 3]]) -> [f64; 2] {
        let body = self.body_of_element(element);
        let deformation = self.deformation(element, displacement);
        let stress = stress(deformation.strain, body.lambda, body.mu);
        [von_mises(stress), deformation.determinant()]
    }

    /// Refuses bodies with a free node beyond a wall or more than a cell deep in an obstacle, which would accelerate it
    /// outwards. `displacement` (m) is the initial one of all nodes, `solid_distance` (m) is per cell.
    pub fn ensure_clearance(
        &self,
        scene: &Scene,
        solid_distance: &[f64],
        displacement: &[[f64; 3]],
    ) -> Result<(), Error> {
        let grid = scene.grid();
        let size = grid.size();
        let slack = WALL_TOLERANCE * size.max_element();
        for (number, body) in self.bodies.iter().enumerate() {
            let what = scene.at(&format!("solid[{number}]"));
            let nodes = body.nodes.clone();
            let free = nodes.filter(|&node| self.prescribed[node] != [true; 3]);
            let (mut deepest, mut place) = (0.0, DVec3::ZERO);
            for node in free {
                let x = self.rest[node] + DVec3::from(displacement[node]);
                if (x - x.clamp(DVec3::ZERO, size)).abs().max_element() > slack {
                    return Err(Error::input(
                        what,
                        format!("starts outside the domain: it has a node at {x} m, and the domain ends at {size} m"),
                        "move it with placement.at, the position of its centre, or shrink it: units = \"mm\" beside the file of a mesh in mm",
                    ));
                }
                if !scene.obstacles.is_empty() {
                    let distance = grid.sample_cells(solid_distance, x);
                    if distance < deepest {
                        (deepest, place) = (distance, x);
                    }
                }
            }
            if deepest < -grid.dx {
                let obstacle = match deepest_obstacle(scene, &grid, place)? {
                    Some(number) => format!("obstacle[{number}]"),
                    None => "an obstacle".to_owned(),
                };
                let [x, y, z] = place.to_array().map(rounded);
                return Err(Error::input(
                    what,
                    format!("starts {} m deep in {obstacle}, with its node at [{x}, {y}, {z}] m", rounded(-deepest)),
                    "move the solid or the obstacle, or constrain the nodes in it with a [[solid.pin]]",
                ));
            }
        }
        Ok(())
    }
}

/// Rounding of a node's distance beyond a wall, relative to the domain's longest side.
const WALL_TOLERANCE: f64 = 1e-6;

/// Key of a pin in the scene file: pins with keyframes are scripts, counted separately.
fn key(pins: &[Pin], number: usize) -> String {
    let still = pins[number].keyframes.is_empty();
    let before = pins[..number].iter();
    let count = before.filter(|pin| pin.keyframes.is_empty() == still).count();
    format!("{}[{count}]", if still { "pin" } else { "script" })
}

impl Body {
    /// 1/dt + tau_M, 1/s, for a step of dt (s).
    pub fn zeta_mass(&self, dt: f64) -> f64 {
        1.0 / dt + self.mass_damping
    }

    /// dt + tau_K, s, for a step of dt (s).
    pub fn zeta_stiffness(&self, dt: f64) -> f64 {
        dt + self.stiffness_damping
    }
}
