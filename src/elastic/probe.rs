//! Probes of solids, for both backends.

use std::ops::Range;

use glam::{DMat3, DVec3};

use super::{Body, Deformation, Solids, forces};
use crate::Error;
use crate::geometry::outer;
use crate::scene::{ProbeKind, ProbedNodes, Scene};

/// Input of the probes of solids after a sub-step. Arrays of all nodes; those that no probe needs may be empty.
#[derive(Clone, Debug, Default)]
pub struct NodeReadback {
    /// Displacements, m.
    pub displacement: Vec<[f64; 3]>,
    /// Velocities, m/s.
    pub velocity: Vec<[f64; 3]>,
    /// Forces of the liquid, N; empty without liquid.
    pub forces: Vec<[f64; 3]>,
    /// Time, s.
    pub time: f64,
    /// Length of the sub-step, s.
    pub dt: f64,
}

/// Nodes and elements of a probe of a solid.
#[derive(Clone, Debug, Default)]
pub struct ProbedPart {
    /// Nodes, ascending.
    nodes: Vec<u32>,
    /// Elements with such a node, of a reaction only.
    elements: Vec<usize>,
}

impl Solids {
    /// Finds the nodes of a scene's probes.
    ///
    /// # Errors
    /// [`Error::Input`] for a region without nodes, and for a reaction without constrained nodes.
    pub(super) fn find_probed(&mut self, scene: &Scene) -> Result<(), Error> {
        for (number, probe) in scene.probes.iter().enumerate() {
            let at = |key: &str| scene.at(&format!("probe[{number}].{key}"));
            let part = match &probe.kind {
                ProbeKind::Node { solid, nodes, velocity } => ProbedPart {
                    nodes: match nodes {
                        ProbedNodes::Nearest(point) => {
                            vec![self.nearest_node(*solid, *point) as u32]
                        }
                        ProbedNodes::Within(region) => {
                            let key = if *velocity { "node_velocity" } else { "node" };
                            self.nodes_in(&self.bodies[*solid], region, &at(key))?
                        }
                    },
                    elements: Vec::new(),
                },
                ProbeKind::Reaction { solid, region } => {
                    let body = &self.bodies[*solid];
                    let mut nodes = match region {
                        Some(region) => self.nodes_in(body, region, &at("reaction"))?,
                        None => body.nodes.clone().map(|node| node as u32).collect(),
                    };
                    nodes.retain(|&node| self.prescribed[node as usize] != [false; 3]);
                    if nodes.is_empty() {
                        let place = if region.is_some() { " in the region" } else { "" };
                        return Err(Error::input(
                            at("reaction"),
                            format!("\"{}\" has no pinned or scripted node{place}", body.name),
                            "add a [[solid.pin]] or a [[solid.script]], or enlarge the region",
                        ));
                    }
                    let touches = |element: &usize| {
                        let mut corners = self.elements[*element].iter();
                        corners.any(|corner| nodes.binary_search(corner).is_ok())
                    };
                    ProbedPart { elements: body.elements.clone().filter(touches).collect(), nodes }
                }
                _ => ProbedPart::default(),
            };
            self.probed.push(part);
        }
        Ok(())
    }

    /// Columns of a scene's probe of a solid; empty for probes of liquid.
    ///
    /// - Node: mean displacement of the nodes, m, or velocity, m/s.
    /// - Solid: centre of mass, m; sum of V det F over sum of V, negative for inverted elements.
    /// - Solid velocity: velocity of the centre of mass, m/s.
    /// - Force: sum over the nodes, N.
    /// - Reaction: force of pins and scripts, N, from the equation of motion of the nodes.
    pub fn probe(&self, scene: &Scene, number: usize, nodes: &NodeReadback) -> Vec<f64> {
        let NodeReadback { displacement, velocity, forces, .. } = nodes;
        match scene.probes[number].kind {
            ProbeKind::Node { velocity: of_v, .. } => {
                let values = if of_v { velocity } else { displacement };
                let nodes = &self.probed[number].nodes;
                let sum: DVec3 = nodes.iter().map(|&node| DVec3::from(values[node as usize])).sum();
                (sum / nodes.len() as f64).to_array().to_vec()
            }
            ProbeKind::Solid { solid } => {
                let position = |node: usize| self.rest[node] + DVec3::from_array(displacement[node]);
                let body = &self.bodies[solid];
                let centre = self.mean(body, position);
                let rest_volume: f64 = self.volume[body.elements.clone()].iter().sum();
                let volume: f64 = self.elements[body.elements.clone()]
                    .iter()
                    .map(|corners| {
                        let [a, b, c, d] = corners.map(|node| position(node as usize));
                        (b - a).cross(c - a).dot(d - a) / 6.0
                    })
                    .sum();
                vec![centre.x, centre.y, centre.z, volume / rest_volume]
            }
            ProbeKind::SolidVelocity { solid } => {
                let mean = self.mean(&self.bodies[solid], |node| DVec3::from(velocity[node]));
                mean.to_array().to_vec()
            }
            ProbeKind::Force { solid } => {
                let sum = sum(forces, self.bodies[solid].nodes.clone());
                sum.to_array().to_vec()
            }
            ProbeKind::Reaction { .. } => {
                let reaction = self.reaction(scene, &self.probed[number], nodes);
                reaction.to_array().to_vec()
            }
            _ => Vec::new(),
        }
    }

    /// Mean over the mass of a body.
    fn mean(&self, body: &Body, value: impl Fn(usize) -> DVec3) -> DVec3 {
        let mass: f64 = self.mass[body.nodes.clone()].iter().sum();
        let nodes = body.nodes.clone();
        let moment: DVec3 = nodes.map(|node| self.mass[node] * value(node)).sum();
        moment / mass
    }

    /// Force of pins and scripts on nodes, N: what the equation of motion of their prescribed components lacks,
    ///
    /// ```text
    /// m (v - v_old) / dt + tau_M m v + (K x* - b) + (dt + tau_K) K v - load - m g - F
    /// ```
    ///
    /// with the forces F of the liquid. v_old is the velocity of the scripts in a sub-step before, of the same length.
    fn reaction(&self, scene: &Scene, part: &ProbedPart, readback: &NodeReadback) -> DVec3 {
        let NodeReadback { displacement, velocity, forces: liquid, time, dt } = readback;
        let mut sums = vec![DVec3::ZERO; part.nodes.len()];
        for &element in &part.elements {
            let body = self.body_of_element(element);
            let (gradients, volume) = (&self.gradients[element], self.volume[element]);
            let deformation = self.deformation(element, displacement);
            let corners = self.elements[element];
            let [v0, rest @ ..] = corners.map(|node| DVec3::from(velocity[node as usize]));
            let rate = rest.into_iter().zip(&gradients[1..]);
            let rate = rate.fold(DMat3::ZERO, |sum, (v, g)| sum + outer(v - v0, *g));
            let turned = deformation.rotation.transpose() * rate;
            let rate = Deformation { strain: 0.5 * (turned + turned.transpose()), ..deformation };
            let [elastic, viscous] =
                [deformation, rate].map(|deformation| forces(gradients, volume, &deformation, body.lambda, body.mu));
            for (corner, node) in corners.iter().enumerate() {
                if let Ok(place) = part.nodes.binary_search(node) {
                    sums[place] += elastic[corner] + body.zeta_stiffness(*dt) * viscous[corner];
                }
            }
        }
        let mut total = DVec3::ZERO;
        for (&node, elastic) in part.nodes.iter().zip(sums) {
            let index = node as usize;
            let (mass, v) = (self.mass[index], DVec3::from(velocity[index]));
            let drag = self.body_of_node(index).mass_damping * mass * v;
            let inertia = mass / dt * (v - self.earlier_velocity(node, *time, *dt));
            let outside = self.load[index] + mass * scene.domain.gravity;
            let liquid = liquid.get(index).copied().map_or(DVec3::ZERO, DVec3::from);
            let lacking = inertia + drag + elastic - outside - liquid;
            for axis in (0..3).filter(|&axis| self.prescribed[index][axis]) {
                total[axis] += lacking[axis];
            }
        }
        total
    }

    /// Velocity of the prescribed components of a node during dt (s) before a time (s), m/s.
    fn earlier_velocity(&self, node: u32, time: f64, dt: f64) -> DVec3 {
        let rest = self.rest[node as usize];
        let mut velocity = DVec3::ZERO;
        for script in &self.scripts {
            if script.nodes.binary_search(&node).is_err() {
                continue;
            }
            let [before, now] = [time - dt, time].map(|time| script.displacement(rest, time));
            for axis in (0..3).filter(|&axis| script.components[axis]) {
                velocity[axis] = (now[axis] - before[axis]) / dt;
            }
        }
        velocity
    }

    /// The solid's node nearest to a rest point (m), the first of equals.
    pub fn nearest_node(&self, solid: usize, rest_point: DVec3) -> usize {
        let nodes = self.bodies[solid].nodes.clone();
        let distance = |node: &usize| self.rest[*node].distance_squared(rest_point);
        nodes.min_by(|a, b| distance(a).total_cmp(&distance(b))).expect("a solid has nodes")
    }
}

fn sum(values: &[[f64; 3]], nodes: Range<usize>) -> DVec3 {
    values[nodes].iter().map(|&value| DVec3::from(value)).sum()
}
