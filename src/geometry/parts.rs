//! Connected parts of a closed surface: whether they bound one solid together.
//!
//! The sign of a distance is that of the nearest triangle. Where one part lies in another, or their surfaces cross, the nearest
//! triangle may belong to the inner one, and what is deep inside counts as outside. A hole, with normals into it, is a part too.

use glam::DVec3;
use parry3d_f64::query::{PointQuery, Ray, RayCast};
use parry3d_f64::shape::{TriMesh, TriMeshFlags};

use super::surface::{Fault, Surface, edges};

/// A part: its triangles as a surface, and the same for queries.
struct Part {
    surface: Surface,
    mesh: TriMesh,
    bounds: [DVec3; 2],
    /// Whether its normals point into it: a hole.
    hole: bool,
}

impl Part {
    fn new(surface: &Surface, triangles: &[[u32; 3]]) -> Part {
        let corners = triangles.iter().flatten();
        let part = Surface {
            vertices: corners
                .map(|&vertex| surface.vertices[vertex as usize])
                .collect(),
            triangles: (0..triangles.len() as u32)
                .map(|number| [0, 1, 2].map(|corner| 3 * number + corner))
                .collect(),
        }
        .welded();
        let mesh = TriMesh::with_flags(
            part.vertices.clone(),
            part.triangles.clone(),
            TriMeshFlags::ORIENTED,
        )
        .expect("a part has triangles");
        Part {
            mesh,
            bounds: part.bounds(),
            hole: part.volume() < 0.0,
            surface: part,
        }
    }

    fn may_touch(&self, [low, high]: [DVec3; 2]) -> bool {
        self.bounds[0].cmple(high).all() && low.cmple(self.bounds[1]).all()
    }

    /// Whether a point lies within the surface, whichever way its normals point.
    fn encloses(&self, x: DVec3) -> bool {
        self.may_touch([x, x]) && self.mesh.contains_local_point(x) != self.hole
    }

    /// The ends of an edge that meets another part's surface, if there is one.
    fn crossing(&self, other: &Part) -> Option<[DVec3; 2]> {
        let directed = self.surface.triangles.iter().flat_map(edges);
        let ends = directed
            .filter(|[from, to]| from < to)
            .map(|edge| edge.map(|vertex| self.surface.vertices[vertex as usize]));
        let mut near = ends.filter(|&[a, b]| other.may_touch([a.min(b), a.max(b)]));
        near.find(|&[a, b]| {
            let ray = Ray::new(a, b - a);
            other.mesh.cast_local_ray(&ray, 1.0, false).is_some()
        })
    }
}

/// The first reason why the parts of a closed surface do not bound a solid together, if there is one.
pub(super) fn fault(surface: &Surface) -> Option<Fault> {
    let groups = groups(surface);
    if groups.len() < 2 {
        return None;
    }
    let parts: Vec<Part> = groups
        .iter()
        .map(|triangles| Part::new(surface, triangles))
        .collect();
    for (number, part) in parts.iter().enumerate() {
        let others = parts.iter().enumerate();
        let near = others.filter(|(other_number, other)| {
            *other_number != number && other.may_touch(part.bounds)
        });
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
            if other.encloses(part.surface.vertices[0]) {
                around += if other.hole { -1 } else { 1 };
            }
        }
        let wanted = if part.hole { 1 } else { 0 };
        if around != wanted {
            let at = part.surface.vertices[0];
            return Some(if part.hole {
                Fault {
                    problem: format!(
                        "inverted: the normals of the part at {at} point inwards, and it is no hole in another part"
                    ),
                    cure: "flip the normals of that part in a mesh tool",
                }
            } else {
                Fault {
                    problem: format!(
                        "two of its parts overlap: the one at {at} lies inside another"
                    ),
                    cure: "remove the inner part in a mesh tool; if it is meant to be a hole, flip its normals",
                }
            });
        }
    }
    None
}

/// The triangles of each connected part, in the order of the surface.
fn groups(surface: &Surface) -> Vec<Vec<[u32; 3]>> {
    // A forest over vertices whose roots stand for the parts.
    let mut above: Vec<u32> = (0..surface.vertices.len() as u32).collect();
    let root = |above: &mut [u32], mut vertex: u32| {
        while above[vertex as usize] != vertex {
            let next = above[above[vertex as usize] as usize];
            above[vertex as usize] = next;
            vertex = next;
        }
        vertex
    };
    for &[a, b, c] in &surface.triangles {
        let a = root(&mut above, a);
        for other in [b, c] {
            let other = root(&mut above, other);
            above[other as usize] = a;
        }
    }
    let mut numbers = vec![None; surface.vertices.len()];
    let mut groups: Vec<Vec<[u32; 3]>> = Vec::new();
    for triangle in &surface.triangles {
        let number = numbers[root(&mut above, triangle[0]) as usize].get_or_insert_with(|| {
            groups.push(Vec::new());
            groups.len() - 1
        });
        groups[*number].push(*triangle);
    }
    groups
}
