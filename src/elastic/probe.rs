//! Probes of solids, for both backends.

use glam::DVec3;

use super::Solids;
use crate::scene::ProbeKind;

impl Solids {
    /// Columns of a probe of a solid, from the displacements (m) and the liquid's forces (N) of all nodes; empty for probes
    /// of liquid.
    ///
    /// - Node: displacement of the node nearest to the rest point, m.
    /// - Solid: centre of mass, m; sum of V det F over sum of V, negative for inverted elements.
    /// - Force: sum over the nodes, N.
    pub fn probe(
        &self,
        displacement: &[[f64; 3]],
        forces: &[[f64; 3]],
        kind: &ProbeKind,
    ) -> Vec<f64> {
        match *kind {
            ProbeKind::Node { solid, rest_point } => {
                displacement[self.nearest_node(solid, rest_point)].to_vec()
            }
            ProbeKind::Solid { solid } => {
                let position =
                    |node: usize| self.rest[node] + DVec3::from_array(displacement[node]);
                let body = &self.bodies[solid];
                let mass: f64 = self.mass[body.nodes.clone()].iter().sum();
                let moment: DVec3 = body
                    .nodes
                    .clone()
                    .map(|node| self.mass[node] * position(node))
                    .sum();
                let rest_volume: f64 = self.volume[body.elements.clone()].iter().sum();
                let volume: f64 = self.elements[body.elements.clone()]
                    .iter()
                    .map(|corners| {
                        let [a, b, c, d] = corners.map(|node| position(node as usize));
                        (b - a).cross(c - a).dot(d - a) / 6.0
                    })
                    .sum();
                let centre = moment / mass;
                vec![centre.x, centre.y, centre.z, volume / rest_volume]
            }
            ProbeKind::Force { solid } => {
                let nodes = forces[self.bodies[solid].nodes.clone()].iter();
                let sum: DVec3 = nodes.map(|&force| DVec3::from(force)).sum();
                sum.to_array().to_vec()
            }
            _ => Vec::new(),
        }
    }

    /// The solid's node nearest to a rest point (m), the first of equals.
    pub fn nearest_node(&self, solid: usize, rest_point: DVec3) -> usize {
        let nodes = self.bodies[solid].nodes.clone();
        let distance = |node: &usize| self.rest[*node].distance_squared(rest_point);
        nodes
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .expect("a solid has nodes")
    }
}
