//! Closed triangle surfaces of shapes and mesh files.

use std::collections::HashMap;

use glam::DVec3;

use super::{crossing, icosahedron, parts};
use crate::scene::Placement;

/// A closed triangle surface with normals out of the solid that it bounds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// Positions, m.
    pub vertices: Vec<DVec3>,
    /// Vertex numbers of each triangle, counter-clockwise seen from outside the solid.
    pub triangles: Vec<[u32; 3]>,
}

/// Reason why a surface bounds no solid.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// Problem, with the triangle or the edge.
    pub problem: String,
    /// Cure.
    pub cure: &'static str,
}

/// Largest distance between a sphere or cylinder and its tessellation, cells: the size of the area clamp, so that apertures are
/// unaffected.
const CHORD_ERROR: f64 = 1e-3;

/// Most segments along an edge of the icosahedron (20 n^2 triangles), reached at radii above 86 cells, from which on the chord
/// error grows.
const MAX_SPHERE_SEGMENTS: usize = 128;

/// Most sides of a cylinder; reached at radii above 1275 cells.
const MAX_CYLINDER_SIDES: usize = 2048;

impl Surface {
    /// The 12 triangles of an axis-aligned box.
    pub fn cuboid(min: DVec3, max: DVec3) -> Surface {
        let vertices = (0..8)
            .map(|corner| {
                DVec3::new(
                    if corner & 1 == 0 { min.x } else { max.x },
                    if corner & 2 == 0 { min.y } else { max.y },
                    if corner & 4 == 0 { min.z } else { max.z },
                )
            })
            .collect();
        let quads: [[u32; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        Surface { vertices, triangles }
    }

    /// A sphere as a subdivided icosahedron of the same volume, within 1e-3 dx of the sphere.
    pub fn sphere(centre: DVec3, radius: f64, dx: f64) -> Surface {
        // Centres of triangles lie below vertices by up to 0.29 radius / n^2. Equal volumes lift the vertices above the
        // sphere by the mean depth, at most 0.19 radius / n^2.
        let depth = 0.19 * radius / (CHORD_ERROR * dx);
        let n = (depth.sqrt().ceil() as usize).clamp(4, MAX_SPHERE_SEGMENTS);
        let unit = icosahedron::unit_sphere(n);
        let scale = radius * icosahedron::equal_volume(&unit);
        unit.map(|x| centre + scale * x)
    }

    /// A right circular cylinder (unit `axis`, centre of its `base`) as a prism of the same volume, within 1e-3 dx of it.
    pub fn cylinder(base: DVec3, axis: DVec3, radius: f64, height: f64, dx: f64) -> Surface {
        // The centre of one of n chords lies about radius pi^2 / (2 n^2) below the circle. Equal areas lift its ends by
        // two thirds of that.
        let n = std::f64::consts::PI * (radius / (3.0 * CHORD_ERROR * dx)).sqrt();
        let n = (n.ceil() as usize).clamp(16, MAX_CYLINDER_SIDES);
        let angle = std::f64::consts::TAU / n as f64;
        let radius = radius * (angle / angle.sin()).sqrt();
        let (u, v) = axis.any_orthonormal_pair();
        let mut vertices = vec![base, base + axis * height];
        let mut triangles = Vec::new();
        for i in 0..n {
            let (sin, cos) = (angle * i as f64).sin_cos();
            let rim = base + radius * (cos * u + sin * v);
            vertices.extend([rim, rim + axis * height]);
            let (low, next) = (2 + 2 * i as u32, 2 + 2 * ((i + 1) % n) as u32);
            triangles.extend([[0, next, low], [1, low + 1, next + 1], [low, next, next + 1], [low, next + 1, low + 1]]);
        }
        Surface { vertices, triangles }
    }

    /// The surface with every vertex moved by `map`.
    pub fn map(mut self, map: impl Fn(DVec3) -> DVec3) -> Surface {
        for x in &mut self.vertices {
            *x = map(*x);
        }
        self
    }

    /// The placed surface, with `centre` the centre of rotation and scaling.
    pub fn placed(self, placement: &Placement, centre: DVec3) -> Surface {
        self.map(|x| placement.put(x, centre))
    }

    /// The boundary of the outside: the same triangles with opposite orientation.
    pub fn inside_out(mut self) -> Surface {
        for triangle in &mut self.triangles {
            triangle.swap(1, 2);
        }
        self
    }

    /// Corners of a triangle, m.
    pub fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|vertex| self.vertices[vertex as usize])
    }

    /// Area times unit normal of a triangle, m^2, out of the solid.
    pub fn area_vector(&self, triangle: usize) -> DVec3 {
        let [a, b, c] = self.corners(triangle);
        0.5 * (b - a).cross(c - a)
    }

    /// Enclosed volume, m^3; negative when the normals point inwards.
    pub fn volume(&self) -> f64 {
        // Relative to a point of the surface, so that a distant body loses no digits.
        let Some(&origin) = self.vertices.first() else {
            return 0.0;
        };
        let six_volumes = self.triangles.iter().map(|triangle| {
            let [a, b, c] = triangle.map(|vertex| self.vertices[vertex as usize] - origin);
            a.dot(b.cross(c))
        });
        six_volumes.sum::<f64>() / 6.0
    }

    /// Area, m^2.
    pub fn area(&self) -> f64 {
        let areas = (0..self.triangles.len()).map(|triangle| self.area_vector(triangle).length());
        areas.sum()
    }

    /// Low and high corner of the bounding box, m.
    pub fn bounds(&self) -> [DVec3; 2] {
        bounds(self.vertices.iter().copied())
    }

    /// Centre of the bounding box, m.
    pub(super) fn centre(&self) -> DVec3 {
        let [low, high] = self.bounds();
        0.5 * (low + high)
    }

    /// Merges vertices at equal positions and drops unused ones. Vertices are numbered by first use.
    pub fn welded(&self) -> Surface {
        let mut surface = Surface::default();
        let mut numbers = HashMap::new();
        for triangle in &self.triangles {
            surface.triangles.push(triangle.map(|vertex| {
                let x = self.vertices[vertex as usize];
                // Adding zero unites the two zeros.
                *numbers.entry(x.to_array().map(|c| (c + 0.0).to_bits())).or_insert_with(|| {
                    surface.vertices.push(x);
                    (surface.vertices.len() - 1) as u32
                })
            }));
        }
        surface
    }

    /// The first reason why the surface bounds no solid.
    ///
    /// The surface must be finite, without degenerate triangles, and closed, with each edge used once in each direction.
    /// Its normals must point outwards, it must neither fold over nor cross itself, and its parts must not overlap.
    pub fn fault(&self) -> Option<Fault> {
        let fault = |problem, cure| Some(Fault { problem, cure });
        if self.triangles.is_empty() {
            return fault("no triangles".to_owned(), "give a closed surface of triangles or polygons");
        }
        for number in 0..self.triangles.len() {
            if let Some(fault) = self.triangle_fault(number) {
                return Some(fault);
            }
        }
        let users = match self.edge_users() {
            Ok(users) => users,
            Err(fault) => return Some(fault),
        };
        let volume = self.volume();
        if volume <= 0.0 {
            return fault(
                format!(
                    "inverted: the normals point inwards (volume {volume:e} m^3), so at the edge from {} to {} of \
                     triangle 1",
                    self.corners(0)[0],
                    self.corners(0)[1]
                ),
                "flip the normals in a mesh tool; for a container set inside_out = true and keep normals outwards",
            );
        }
        crossing::fold(self, &users).or_else(|| parts::fault(self, &users)).or_else(|| crossing::crossing(self))
    }

    /// Refuses a nonfinite or degenerate triangle.
    fn triangle_fault(&self, number: usize) -> Option<Fault> {
        let fault = |problem, cure| Some(Fault { problem, cure });
        let corners = self.corners(number);
        if let Some(bad) = corners.iter().find(|&&x| !is_near(x)) {
            return fault(
                format!("triangle {} has the corner {bad}", number + 1),
                "coordinates must be finite numbers, of at most 1e60 m",
            );
        }
        // Twice the area is the longest edge times the height, which below this limit is rounding.
        let [a, b, c] = corners;
        let longest = [b - a, c - b, a - c].map(|edge| edge.length_squared()).into_iter().fold(0.0, f64::max);
        if self.area_vector(number).length() <= 1e-14 * longest {
            return fault(
                format!("triangle {} with the corners {a}, {b}, {c} has no area", number + 1),
                "remove degenerate triangles and merge vertices by distance in a mesh tool",
            );
        }
        None
    }

    /// The triangle of each directed edge. Each edge must occur once in each direction.
    fn edge_users(&self) -> Result<HashMap<[u32; 2], usize>, Fault> {
        let fault = |problem, cure| Err(Fault { problem, cure });
        let at = |vertex: u32| self.vertices[vertex as usize];
        let mut users = HashMap::new();
        for (number, triangle) in self.triangles.iter().enumerate() {
            for [from, to] in edges(triangle) {
                let Some(first) = users.insert([from, to], number) else {
                    continue;
                };
                let numbers = format!("triangles {} and {}", first + 1, number + 1);
                let sorted = |mut triangle: [u32; 3]| {
                    triangle.sort_unstable();
                    triangle
                };
                if sorted(self.triangles[first]) == sorted(*triangle) {
                    let [a, b, c] = self.corners(number);
                    return fault(
                        format!("{numbers} lie in one place, with the corners {a}, {b}, {c}"),
                        "remove doubled faces and parts in a mesh tool",
                    );
                }
                return fault(
                    format!("{numbers} use the edge from {} to {} in the same direction", at(from), at(to)),
                    "make the normals consistent, and separate parts that share an edge, in a mesh tool",
                );
            }
        }
        for (number, triangle) in self.triangles.iter().enumerate() {
            for [from, to] in edges(triangle) {
                if !users.contains_key(&[to, from]) {
                    return fault(
                        format!(
                            "not closed: the edge from {} to {} belongs to triangle {} alone",
                            at(from),
                            at(to),
                            number + 1
                        ),
                        "fill the holes and merge vertices by distance in a mesh tool",
                    );
                }
            }
        }
        Ok(users)
    }
}

/// Low and high corner of the bounding box of points.
pub(crate) fn bounds(points: impl Iterator<Item = DVec3>) -> [DVec3; 2] {
    let empty = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    points.fold(empty, |[low, high], x| [low.min(x), high.max(x)])
}

/// The three directed edges of a triangle.
pub(super) fn edges(&[a, b, c]: &[u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

/// Whether the cube of the coordinates is finite.
pub(super) fn is_near(x: DVec3) -> bool {
    x.is_finite() && x.abs().max_element() <= 1e60
}
