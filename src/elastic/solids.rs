//! The solids of a scene put together from their meshes: masses, prescribed nodes, loads, the state at the start.

use glam::DVec3;

use super::{
    Body, Deformation, Script, Solids, Turning, lame_parameters, rest_shape, stress, von_mises,
};
use crate::error::{Error, rounded};
use crate::geometry::{MovedMesh, TetMesh, deepest_obstacle, inside};
use crate::scene::{ElasticModel, Keyframe, Load, LoadKind, Pin, Scene, Shape, Solid};

/// Of its length, how far aside of a line nodes may lie that make a hinge.
const STRAIGHT: f64 = 1e-6;

impl Solids {
    /// The solids of a scene on their meshes (one each, as placed).
    ///
    /// # Errors
    /// [`Error::Input`] that names the scene file and the key: pins and loads that hold nothing, pins of the same component of a
    /// node that move differently, turns about the centre of a shape that has none, meshes of pins that cannot be read.
    pub fn new(scene: &Scene, meshes: &[TetMesh]) -> Result<Solids, Error> {
        Solids::of(&scene.solids, meshes, &|key| scene.at(key))
    }

    /// The same for solids of no scene; `at` says for errors where a key was written.
    ///
    /// # Errors
    /// As those of [`Solids::new`].
    pub fn of(
        solids: &[Solid],
        meshes: &[TetMesh],
        at: &dyn Fn(&str) -> String,
    ) -> Result<Solids, Error> {
        let mut all = Solids::default();
        for (number, (solid, mesh)) in solids.iter().zip(meshes).enumerate() {
            all.push(solid, mesh, &|key| at(&format!("solid[{number}].{key}")))?;
        }
        Ok(all)
    }

    /// `at`: where a key of the solid was written.
    fn push(
        &mut self,
        solid: &Solid,
        mesh: &TetMesh,
        at: &dyn Fn(&str) -> String,
    ) -> Result<(), Error> {
        let first_node = self.rest.len();
        let (first_element, first_triangle) = (self.elements.len(), self.triangles.len());
        let n_nodes = first_node + mesh.nodes.len();
        let shifted = |node: u32| node + first_node as u32;
        self.rest.extend(&mesh.nodes);
        self.mass.resize(n_nodes, 0.0);
        self.prescribed.resize(n_nodes, [false; 3]);
        self.load.resize(n_nodes, DVec3::ZERO);
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
        self.triangles
            .extend(surface.map(|triangle| triangle.map(shifted)));
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
        };
        let mut held_by = vec![[None; 3]; mesh.nodes.len()];
        for (number, pin) in solid.pins.iter().enumerate() {
            self.pin(&body, pin, number, at, &mut held_by, &solid.pins)?;
        }
        for (number, load) in solid.loads.iter().enumerate() {
            self.load(&body, load, &at(&format!("load[{number}]")))?;
        }
        self.bodies.push(body);
        Ok(())
    }

    /// Prescribes what a pin holds. `held_by`: the pin that holds each component of the body's nodes so far.
    fn pin(
        &mut self,
        body: &Body,
        pin: &Pin,
        number: usize,
        at: &dyn Fn(&str) -> String,
        held_by: &mut [[Option<usize>; 3]],
        pins: &[Pin],
    ) -> Result<(), Error> {
        let name = at(&key(pins, number));
        let nodes = self.nodes_in(body, &pin.region, &name)?;
        for &node in &nodes {
            for axis in (0..3).filter(|&axis| pin.components[axis]) {
                let holder = &mut held_by[node as usize - body.nodes.start][axis];
                let still = |pin: &Pin| pin.keyframes.is_empty();
                if let Some(other) = *holder
                    && !(still(pin) && still(&pins[other]))
                {
                    let component = ["x", "y", "z"][axis];
                    let problem = format!(
                        "prescribes {component} of the node at {}, and so does {}",
                        self.rest[node as usize],
                        key(pins, other)
                    );
                    let cure = "let the regions or the components of scripts not overlap those of other scripts and pins";
                    return Err(Error::input(name, problem, cure));
                }
                *holder = Some(number);
                self.prescribed[node as usize][axis] = true;
            }
        }
        if pin.keyframes.is_empty() {
            return Ok(());
        }
        let turns = |frame: &Keyframe| frame.angle != 0.0;
        let centre = match pin.region.centre() {
            Some(centre) => centre,
            None if !pin.keyframes.iter().any(turns) => DVec3::ZERO,
            None => {
                return Err(Error::input(
                    name,
                    "turns its nodes about the centre of its region, which has none",
                    "use a box, sphere or cylinder, or leave the turn out",
                ));
            }
        };
        self.scripts.push(Script {
            nodes,
            components: pin.components,
            centre,
            keyframes: pin.keyframes.clone(),
        });
        Ok(())
    }

    /// Adds a load to the forces on the nodes.
    fn load(&mut self, body: &Body, load: &Load, name: &str) -> Result<(), Error> {
        let nodes = self.nodes_in(body, &load.region, name)?;
        match load.kind {
            LoadKind::Force(force) => {
                for &node in &nodes {
                    self.load[node as usize] += force / nodes.len() as f64;
                }
            }
            LoadKind::Traction(traction) => {
                let held = |node: &u32| nodes.binary_search(node).is_ok();
                let mut any = false;
                for triangle in &self.triangles[body.triangles.clone()] {
                    if !triangle.iter().all(held) {
                        continue;
                    }
                    any = true;
                    let [a, b, c] = triangle.map(|node| self.rest[node as usize]);
                    let area = 0.5 * (b - a).cross(c - a).length();
                    // The integral of a linear shape function over its triangle is a third of the area.
                    for node in triangle {
                        self.load[*node as usize] += area / 3.0 * traction;
                    }
                }
                if !any {
                    return Err(Error::input(
                        name,
                        "no surface triangle has all three nodes in the region",
                        "enlarge the region until it holds the part of the surface that the traction acts on",
                    ));
                }
            }
        }
        Ok(())
    }

    /// The nodes of a body that rest inside a shape or on it, ascending; none is an error.
    fn nodes_in(&self, body: &Body, shape: &Shape, name: &str) -> Result<Vec<u32>, Error> {
        let rest = &self.rest[body.nodes.clone()];
        let held = inside(shape, rest)?;
        let nodes = body.nodes.clone().zip(held);
        let nodes: Vec<u32> = nodes
            .filter(|(_, held)| *held)
            .map(|(node, _)| node as u32)
            .collect();
        if nodes.is_empty() {
            let none = [DVec3::INFINITY, DVec3::NEG_INFINITY];
            let [low, high] = rest
                .iter()
                .fold(none, |[low, high], &x| [low.min(x), high.max(x)]);
            let [low, high] = [low, high].map(|x| DVec3::from(x.to_array().map(rounded)));
            let problem = format!("no node of \"{}\" rests in the region", body.name);
            let cure =
                format!("the nodes lie between {low} and {high} m: move or enlarge the region");
            return Err(Error::input(name, problem, cure));
        }
        Ok(nodes)
    }

    /// Displacement (m) and velocity (m/s) of all nodes at the start: stretched about the centroid of the rest shape, moving and
    /// spinning with what is so stretched. Prescribed components stay where that puts them; those of scripts are where
    /// their scripts put them, and move with them.
    pub fn initial_state(&self, scene: &Scene) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
        let n = self.rest.len();
        let (mut displacement, mut velocity) = (vec![[0.0; 3]; n], vec![[0.0; 3]; n]);
        for (body, solid) in self.bodies.iter().zip(&scene.solids) {
            let initial = &solid.initial;
            let centroid = self.centroid(body);
            for node in body.nodes.clone() {
                let arm = self.rest[node] - centroid;
                let u = (initial.scale - DVec3::ONE) * arm;
                let v = initial.velocity + initial.spin.cross(arm + u);
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

    /// Velocities (m/s) that take scripted components from where they are at a time (s) to where their scripts want them dt (s)
    /// later; 0 in all others. Nothing without scripts.
    ///
    /// A step asks for them after its nodes have moved, and the next step moves on with them: nodes land on their scripts exactly
    /// where both steps are of one length, and lag behind by what a change of length makes of an acceleration otherwise. The first step
    /// moves with those of [`Solids::start_scripts`].
    pub fn prescribed_velocity(
        &self,
        displacement: &[[f64; 3]],
        time: f64,
        dt: f64,
    ) -> Vec<[f64; 3]> {
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

    /// Before the first step, of dt (s), of a scene: lets the velocities (m/s) of scripted components, which are along the tangents of
    /// their scripts, take them to where the scripts want them at its end. A tangent leads past keyframes that come sooner.
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

    /// The mesh under displacements (m, of all nodes).
    pub fn moved(&self, displacement: &[[f64; 3]]) -> MovedMesh<'_> {
        let nodes = self.rest.iter().zip(displacement);
        MovedMesh {
            nodes: nodes.map(|(rest, u)| rest + DVec3::from(*u)).collect(),
            elements: &self.elements,
            triangles: &self.triangles,
            bodies: self
                .bodies
                .iter()
                .map(|body| body.elements.clone())
                .collect(),
        }
    }

    /// The bodies that move on circles where they turn: corotational ones that nothing holds, or that are held still in a point or along a
    /// line.
    pub fn turning(&self) -> impl Iterator<Item = Turning> {
        let corotational = |body: &&Body| body.model == ElasticModel::Corotational;
        let turning = |body: &Body| {
            let nodes = body.nodes.clone();
            match self.held(body).as_slice() {
                [] => Some(Turning { nodes, about: None }),
                held => self.hinge(held).map(|hinge| Turning {
                    nodes,
                    about: Some(hinge),
                }),
            }
        };
        self.bodies.iter().filter(corotational).filter_map(turning)
    }

    /// The nodes of a body of which some component is prescribed.
    fn held(&self, body: &Body) -> Vec<usize> {
        let held = |node: &usize| self.prescribed[*node] != [false; 3];
        body.nodes.clone().filter(held).collect()
    }

    /// Two of the nodes, as far apart as any, or twice the same, where they are held still in all components and lie on a line.
    fn hinge(&self, held: &[usize]) -> Option<[usize; 2]> {
        let scripted = |node: &usize| {
            let mut scripts = self.scripts.iter();
            scripts.any(|script| script.nodes.binary_search(&(*node as u32)).is_ok())
        };
        let all_of = |node: &usize| self.prescribed[*node] == [true; 3];
        if !held.iter().all(all_of) || held.iter().any(scripted) {
            return None;
        }
        let farthest = |from: usize| {
            let away = |node: usize| self.rest[node].distance_squared(self.rest[from]);
            let farther = |a: &&usize, b: &&usize| away(**a).total_cmp(&away(**b));
            held.iter().max_by(farther).copied()
        };
        let first = farthest(held[0])?;
        let last = farthest(first)?;
        let way = self.rest[last] - self.rest[first];
        let aside = |node: &usize| (self.rest[*node] - self.rest[first]).cross(way).length();
        let straight = |node: &usize| aside(node) <= STRAIGHT * way.length_squared();
        held.iter().all(straight).then_some([first, last])
    }

    /// The body of an element.
    pub fn body_of_element(&self, element: usize) -> &Body {
        &self.bodies[self
            .bodies
            .partition_point(|body| body.elements.end <= element)]
    }

    /// The body of a node.
    pub fn body_of_node(&self, node: usize) -> &Body {
        &self.bodies[self.bodies.partition_point(|body| body.nodes.end <= node)]
    }

    /// What displacements (m, of all nodes) make of an element.
    pub fn deformation(&self, element: usize, displacement: &[[f64; 3]]) -> Deformation {
        let u = self.elements[element].map(|node| DVec3::from(displacement[node as usize]));
        let model = self.body_of_element(element).model;
        Deformation::new(&self.gradients[element], u, model)
    }

    /// Von Mises stress (Pa) and det F of an element. The stress is P, the law's own, which turned by R is the Cauchy stress for
    /// small strains; turning does not change its von Mises stress. Unlike the Cauchy stress R P F^T / det F it is finite in
    /// flat elements too.
    pub fn stress_and_determinant(&self, element: usize, displacement: &[[f64; 3]]) -> [f64; 2] {
        let body = self.body_of_element(element);
        let deformation = self.deformation(element, displacement);
        let stress = stress(deformation.strain, body.lambda, body.mu);
        [von_mises(stress), deformation.determinant()]
    }

    /// Refuses bodies of which a free node starts beyond a wall or more than a cell deep in an obstacle: both would push it out with
    /// force. `displacement` (m): of all nodes at the start; `solid_distance`: per cell, m.
    ///
    /// # Errors
    /// [`Error::Input`] naming the solid.
    pub fn ensure_room(
        &self,
        scene: &Scene,
        solid_distance: &[f64],
        displacement: &[[f64; 3]],
    ) -> Result<(), Error> {
        let grid = scene.grid();
        let size = grid.size();
        let slack = STICKS_OUT * size.max_element();
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
                        format!(
                            "starts outside of the domain: it has a node at {x} m, and the domain ends at {size} m"
                        ),
                        "move it with placement.at, the place of its middle, or make it smaller: units = \"mm\" beside the file of a mesh in mm",
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
                    format!(
                        "starts {} m deep in {obstacle}, with its node at [{x}, {y}, {z}] m",
                        rounded(-deepest)
                    ),
                    "move the solid or the obstacle, or hold the nodes in it with a [[solid.pin]]",
                ));
            }
        }
        Ok(())
    }
}

/// Part of the domain's longest side that rounding may put a node beyond a wall.
const STICKS_OUT: f64 = 1e-6;

/// What the scene file calls a pin: those with keyframes are scripts, and each kind is counted by itself.
fn key(pins: &[Pin], number: usize) -> String {
    let still = pins[number].keyframes.is_empty();
    let before = pins[..number].iter();
    let count = before
        .filter(|pin| pin.keyframes.is_empty() == still)
        .count();
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
