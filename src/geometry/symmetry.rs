//! Tetrahedra cut by planes of symmetry.
//!
//! An element across a plane leaves a convex part. Its faces are clipped polygons, which neighbours share. Each polygon is divided
//! from its smallest node, and the part from its smallest node too: so neighbours divide their common face alike, whatever the
//! order of the elements.
//!
//! Nodes near the plane are moved onto it first, so that no element is thin: by at most a fifth of the smallest height of an
//! element there.

use std::collections::HashMap;

use glam::DVec3;

use super::tet_mesh::{FACES, TetMesh};
use crate::grid::{Axis, Sides};

/// Distance of a node from the plane at which it is on it, relative to the longest side of the domain.
const ON_PLANE: f64 = 1e-6;
/// Distance from which a node is moved onto the plane, relative to the smallest height of its elements.
const SNAP: f64 = 0.2;

/// Part of a mesh on the inner side of the planes of a domain of this size (m); without elements where nothing is left of it.
pub(super) fn cut_by_symmetry(mut mesh: TetMesh, planes: Sides, size: DVec3) -> TetMesh {
    for axis in Axis::ALL {
        for side in (0..2).filter(|&side| planes.has(axis, side)) {
            let at = [0.0, size[axis.index()]][side];
            Plane { axis: axis.index(), at, inwards: [1.0, -1.0][side] }.cut(&mut mesh, ON_PLANE * size.max_element());
        }
    }
    mesh
}

/// A plane across an axis.
struct Plane {
    axis: usize,
    /// Coordinate, m.
    at: f64,
    /// Sign of the direction into the domain.
    inwards: f64,
}

impl Plane {
    /// Distance into the domain, m.
    fn height(&self, x: DVec3) -> f64 {
        self.inwards * (x[self.axis] - self.at)
    }

    /// Removes the part beyond the plane, if any node is more than `slack` (m) beyond it.
    fn cut(&self, mesh: &mut TetMesh, slack: f64) {
        let mut height: Vec<f64> = mesh.nodes.iter().map(|&x| self.height(x)).collect();
        if height.iter().all(|&height| height >= -slack) {
            return;
        }
        let reach = smallest_heights(mesh).into_iter().map(|smallest| slack.max(SNAP * smallest));
        for ((x, height), reach) in mesh.nodes.iter_mut().zip(&mut height).zip(reach) {
            if height.abs() <= reach {
                (x[self.axis], *height) = (self.at, 0.0);
            }
        }
        let mut cuts = Cuts { plane: self, height, nodes: HashMap::new() };
        for element in std::mem::take(&mut mesh.elements) {
            let heights = element.map(|node| cuts.height[node as usize]);
            let [some_in, some_out] = [1.0, -1.0].map(|sign| heights.iter().any(|height| sign * height > 0.0));
            match (some_in, some_out) {
                (true, false) => mesh.elements.push(element),
                (true, true) => cuts.divide(element, mesh),
                (false, _) => {}
            }
        }
        mesh.drop_unused_nodes();
    }
}

/// Smallest height of the elements at each node, m.
fn smallest_heights(mesh: &TetMesh) -> Vec<f64> {
    let mut smallest = vec![f64::INFINITY; mesh.nodes.len()];
    for &element in &mesh.elements {
        let x = element.map(|node| mesh.nodes[node as usize]);
        let doubled_area = |[a, b, c]: [usize; 3]| (x[b] - x[a]).cross(x[c] - x[a]).length();
        let base = FACES.map(doubled_area).into_iter().fold(0.0, f64::max);
        let height = mesh.determinant(element) / base;
        for node in element {
            smallest[node as usize] = smallest[node as usize].min(height);
        }
    }
    smallest
}

/// Nodes on the edges that a plane cuts.
struct Cuts<'a> {
    plane: &'a Plane,
    /// Of all nodes above the plane, m.
    height: Vec<f64>,
    /// By the ends of the edge, ascending.
    nodes: HashMap<[u32; 2], u32>,
}

impl Cuts<'_> {
    /// Adds the elements of the inner part of one that the plane divides.
    fn divide(&mut self, element: [u32; 4], mesh: &mut TetMesh) {
        let mut polygons = FACES.map(|face| self.clip(face.map(|corner| element[corner]), mesh)).to_vec();
        let mut cap: Vec<u32> = polygons.concat();
        cap.retain(|&node| self.height[node as usize] == 0.0);
        cap.sort_unstable();
        cap.dedup();
        self.order(&mut cap, mesh);
        polygons.push(cap);
        let Some(&apex) = polygons.iter().flatten().min() else {
            return;
        };
        for polygon in polygons.iter().filter(|polygon| polygon.len() > 2 && !polygon.contains(&apex)) {
            let n = polygon.len();
            let first = (0..n).min_by_key(|&corner| polygon[corner]).unwrap_or(0);
            for corner in first + 1..first + n - 1 {
                let mut part = [apex, polygon[first], polygon[corner % n], polygon[(corner + 1) % n]];
                if mesh.determinant(part) < 0.0 {
                    part.swap(2, 3);
                }
                mesh.elements.push(part);
            }
        }
    }

    /// Inner part of a triangle.
    fn clip(&mut self, triangle: [u32; 3], mesh: &mut TetMesh) -> Vec<u32> {
        let mut polygon = Vec::new();
        for (corner, &node) in triangle.iter().enumerate() {
            let next = triangle[(corner + 1) % 3];
            let [here, there] = [node, next].map(|node| self.height[node as usize]);
            if here >= 0.0 {
                polygon.push(node);
            }
            if here * there < 0.0 {
                polygon.push(self.node(mesh, [node.min(next), node.max(next)]));
            }
        }
        polygon
    }

    /// The node where an edge meets the plane.
    fn node(&mut self, mesh: &mut TetMesh, edge: [u32; 2]) -> u32 {
        *self.nodes.entry(edge).or_insert_with(|| {
            let [a, b] = edge.map(|node| node as usize);
            let part = self.height[a] / (self.height[a] - self.height[b]);
            let mut x = mesh.nodes[a].lerp(mesh.nodes[b], part);
            x[self.plane.axis] = self.plane.at;
            mesh.nodes.push(x);
            self.height.push(0.0);
            (mesh.nodes.len() - 1) as u32
        })
    }

    /// Orders the corners of a convex polygon in the plane around its centre.
    fn order(&self, polygon: &mut [u32], mesh: &TetMesh) {
        let [b, c] = [(self.plane.axis + 1) % 3, (self.plane.axis + 2) % 3];
        let x = |node: u32| mesh.nodes[node as usize];
        let centre = polygon.iter().map(|&node| x(node)).sum::<DVec3>() / polygon.len().max(1) as f64;
        let angle = |node: u32| {
            let arm = x(node) - centre;
            arm[c].atan2(arm[b])
        };
        polygon.sort_by(|&one, &other| angle(one).total_cmp(&angle(other)));
    }
}
