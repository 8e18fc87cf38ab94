//! Cavities of solids: volumes enclosed by a closed part of a solid's surface.

use std::collections::BTreeMap;

use glam::DVec3;

use super::Solids;
use crate::geometry::DisjointSets;
use crate::scene::{CouplingScheme, Scene};

/// Least volume of a cavity with a source, cells: the grid does not resolve smaller ones.
const LEAST_CELLS: f64 = 8.0;

/// The cavities of all solids, in the order of their first nodes.
#[derive(Clone, Debug, Default)]
pub struct Cavities {
    /// Triangles of each, corners clockwise as seen from the cavity.
    triangles: Vec<Vec<[u32; 3]>>,
    /// Cavity that each node bounds, from 1; 0 for none.
    of_node: Vec<u32>,
}

impl Cavities {
    /// Finds the parts of the surfaces at rest that enclose a volume. Parts that share a node are one.
    pub fn new(solids: &Solids) -> Cavities {
        Cavities::larger(solids, 0.0)
    }

    /// The same of more than a least volume, m^3.
    fn larger(solids: &Solids, least: f64) -> Cavities {
        let mut parts: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
        let mut joined = DisjointSets::new(solids.rest.len());
        for &[a, b, c] in &solids.triangles {
            joined.merge(a, b);
            joined.merge(a, c);
        }
        let (part_of_node, _) = joined.labels();
        for &triangle in &solids.triangles {
            parts.entry(part_of_node[triangle[0] as usize]).or_default().push(triangle);
        }
        let encloses = |part: &Vec<[u32; 3]>| enclosed_volume(part, |node| solids.rest[node as usize]) > least;
        let triangles: Vec<Vec<[u32; 3]>> = parts.into_values().filter(encloses).collect();
        let mut of_node = vec![0; solids.rest.len()];
        for (number, part) in (1..).zip(&triangles) {
            part.iter().flatten().for_each(|&node| of_node[node as usize] = number);
        }
        Cavities { triangles, of_node }
    }

    /// The cavities that keep the volume of liquid which fills them: in strong coupling, where no liquid enters or leaves through sources and sinks,
    /// and of at least 8 cells.
    pub fn in_liquid(scene: &Scene, solids: &Solids) -> Cavities {
        let exchanges = !scene.sources.is_empty() || !scene.sinks.is_empty();
        if scene.liquid.is_none() || scene.solver.coupling != CouplingScheme::Strong || exchanges {
            return Cavities::default();
        }
        Cavities::larger(solids, LEAST_CELLS * scene.grid().cell_volume())
    }

    /// Number of cavities.
    pub fn len(&self) -> usize {
        self.triangles.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Cavity that each node bounds, from 1; 0 for none.
    pub fn of_node(&self) -> &[u32] {
        &self.of_node
    }

    /// Volumes, m^3, from the displacement of all nodes, m. That of a cavity inside out is negative.
    pub fn volumes(&self, solids: &Solids, displacement: &[[f64; 3]]) -> Vec<f64> {
        let position = |node: u32| solids.rest[node as usize] + DVec3::from(displacement[node as usize]);
        self.triangles.iter().map(|part| enclosed_volume(part, position)).collect()
    }
}

/// Volume that closed triangles enclose on their outer side (divergence theorem), from one of their corners for fewer digits lost.
fn enclosed_volume(triangles: &[[u32; 3]], position: impl Fn(u32) -> DVec3) -> f64 {
    let origin = position(triangles[0][0]);
    let of_triangle = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|corner| position(corner) - origin);
        a.dot(b.cross(c))
    };
    -triangles.iter().map(of_triangle).sum::<f64>() / 6.0
}
