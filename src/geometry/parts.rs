//! Checks that the connected parts of a closed surface bound one solid together.
//!
//! The sign of a distance is that of the nearest triangle. With nested or crossing parts that triangle may belong to an inner
//! part, and points deep inside would count as outside. A hole, with normals into it, is a part too.

use std::collections::{HashMap, HashSet};

use glam::DVec3;
use parry3d_f64::query::{PointQuery, Ray, RayCast};
use parry3d_f64::shape::{TriMesh, TriMeshFlags};

use super::disjoint_sets::DisjointSets;
use super::surface::{Fault, Surface, edges};

/// Distance by which rays end before a shared corner, relative to their length: far above rounding.
const SHARED: f64 = 1e-6;

/// Triangles connected by edges.
struct Part<'a> {
    surface: &'a Surface,
    /// Vertex numbers of the surface.
    triangles: Vec<[u32; 3]>,
    vertices: HashSet<u32>,
    mesh: TriMesh,
    bounds: [DVec3; 2],
    hole: bool,
}

impl Part<'_> {
    fn new(surface: &Surface, triangles: Vec<[u32; 3]>) -> Part<'_> {
        let corners = triangles.iter().flatten();
        let part = Surface {
            vertices: corners.clone().map(|&vertex| surface.vertices[vertex as usize]).collect(),
            triangles: (0..triangles.len() as u32).map(|number| [0, 1, 2].map(|corner| 3 * number + corner)).collect(),
        }
        .welded();
        let vertices = corners.copied().collect();
        let (bounds, hole) = (part.bounds(), part.volume() < 0.0);
        let mesh =
            TriMesh::with_flags(part.vertices, part.triangles, TriMeshFlags::ORIENTED).expect("a part has triangles");
        Part { surface, triangles, vertices, mesh, bounds, hole }
    }

    fn may_touch(&self, [low, high]: [DVec3; 2]) -> bool {
        self.bounds[0].cmple(high).all() && low.cmple(self.bounds[1]).all()
    }

    /// A point of the surface that no other part shares, m.
    fn point(&self) -> DVec3 {
        let corners = self.triangles[0].map(|vertex| self.surface.vertices[vertex as usize]);
        corners.iter().sum::<DVec3>() / 3.0
    }

    /// Whether a point lies within the surface, for either direction of the normals.
    fn encloses(&self, x: DVec3) -> bool {
        self.may_touch([x, x]) && self.mesh.contains_local_point(x) != self.hole
    }

    /// The first edge that meets another part's surface elsewhere than at a shared corner.
    fn crossing(&self, other: &Part) -> Option<[DVec3; 2]> {
        let at = |vertex: u32| self.surface.vertices[vertex as usize];
        let hits = |from: DVec3, to: DVec3, length: f64| {
            let ray = Ray::new(from, to - from);
            other.mesh.cast_local_ray(&ray, length, false).is_some()
        };
        let mut edges = self
            .triangles
            .iter()
            .flat_map(edges)
            .filter(|&[from, to]| from < to && other.may_touch([at(from).min(at(to)), at(from).max(at(to))]));
        let crossing = edges.find(|&[from, to]| {
            let shared = [from, to].map(|vertex| other.vertices.contains(&vertex));
            let [from, to] = [from, to].map(at);
            match shared {
                [false, false] => hits(from, to, 1.0),
                [false, true] => hits(from, to, 1.0 - SHARED),
                [true, false] => hits(to, from, 1.0 - SHARED),
                [true, true] => {
                    let middle = 0.5 * (from + to);
                    hits(middle, from, 1.0 - SHARED) || hits(middle, to, 1.0 - SHARED)
                }
            }
        });
        crossing.map(|edge| edge.map(at))
    }
}

/// The first reason why the parts do not bound one solid. `users` are the triangles of each directed edge.
pub(super) fn fault(surface: &Surface, users: &HashMap<[u32; 2], usize>) -> Option<Fault> {
    let groups = groups(surface, users);
    if groups.len() < 2 {
        return None;
    }
    let parts: Vec<Part> = groups.into_iter().map(|triangles| Part::new(surface, triangles)).collect();
    for (number, part) in parts.iter().enumerate() {
        let others = parts.iter().enumerate();
        let near = others.filter(|(other_number, other)| *other_number != number && other.may_touch(part.bounds));
        let mut around = 0;
        for (_, other) in near {
            if let Some([a, b]) = part.crossing(other) {
                return Some(Fault {
                    problem: format!(
                        "two of its parts overlap or touch: the edge from {a} to {b} of one meets the surface of the other"
                    ),
                    cure: "unite the parts in a mesh tool (boolean union), or give each a file of its own",
                });
            }
            // Parts that do not cross are wholly inside or outside.
            if other.encloses(part.point()) {
                around += if other.hole { -1 } else { 1 };
            }
        }
        let expected = if part.hole { 1 } else { 0 };
        if around != expected {
            let at = part.point();
            return Some(if part.hole {
                Fault {
                    problem: format!(
                        "inverted: the normals of the part at {at} point inwards, and it is no hole in another part"
                    ),
                    cure: "flip the normals of that part in a mesh tool",
                }
            } else {
                Fault {
                    problem: format!("two of its parts overlap: the one at {at} lies inside another"),
                    cure: "remove the inner part in a mesh tool; if it is meant to be a hole, flip its normals",
                }
            });
        }
    }
    None
}

/// Triangles of each part, in the order of the surface. Parts with common corners but no common edge are separate.
fn groups(surface: &Surface, users: &HashMap<[u32; 2], usize>) -> Vec<Vec<[u32; 3]>> {
    let mut parts = DisjointSets::new(surface.triangles.len());
    for (number, triangle) in (0..).zip(&surface.triangles) {
        for [from, to] in edges(triangle) {
            parts.merge(number, users[&[to, from]] as u32);
        }
    }
    let (labels, n) = parts.labels();
    let mut groups = vec![Vec::new(); n];
    for (triangle, label) in surface.triangles.iter().zip(labels) {
        groups[label as usize].push(*triangle);
    }
    groups
}
