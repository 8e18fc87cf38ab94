//! Points embedded in a tetrahedral mesh: each is a fixed affine combination of the corners of one tetrahedron.
//!
//! A point x of a tetrahedron with corners x_i is sum w_i x_i, with barycentric coordinates w_i. A point outside the mesh uses the tetrahedron of the
//! nearest point of the boundary, with coordinates of either sign. So it moves with the deformation gradient there.

use std::collections::HashMap;

use glam::{DMat3, DVec3};
use parry3d_f64::query::PointQueryWithLocation;
use parry3d_f64::shape::TriMesh;
use rayon::prelude::*;

use super::TetMesh;

/// Rounding of barycentric coordinates.
const ROUNDING: f64 = 1e-9;

/// Affine combinations of nodes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Embedding {
    /// Corners of the tetrahedron of each point.
    pub corners: Vec<[u32; 4]>,
    /// Barycentric coordinates of each point; their sum is 1.
    pub weights: Vec<[f64; 4]>,
    /// Largest distance of a point outside the mesh, m.
    pub farthest: f64,
}

impl Embedding {
    /// Embeds points (m) in a mesh with elements, at the positions of its nodes. Of several tetrahedra that contain a point the first is used.
    pub fn new(mesh: &TetMesh, points: &[DVec3]) -> Embedding {
        let bins = Bins::new(mesh);
        let boundary = Boundary::new(mesh);
        let places: Vec<(usize, DVec3, f64)> = points
            .par_iter()
            .map(|&x| match bins.containing(mesh, x) {
                Some((element, weights)) => (element, weights, 0.0),
                None => {
                    let (element, distance) = boundary.nearest(x);
                    (element, inverse(mesh, element) * (x - corner(mesh, element)), distance)
                }
            })
            .collect();
        Embedding {
            corners: places.iter().map(|place| mesh.elements[place.0]).collect(),
            weights: places
                .iter()
                .map(|&(_, weights, _)| {
                    let [b, c, d] = weights.to_array();
                    [1.0 - b - c - d, b, c, d]
                })
                .collect(),
            farthest: places.iter().map(|place| place.2).fold(0.0, f64::max),
        }
    }

    /// The combinations of values at the nodes.
    pub fn at(&self, nodes: &[DVec3]) -> Vec<DVec3> {
        let points = self.corners.par_iter().zip(&self.weights);
        points
            .map(|(corners, weights)| {
                let parts = corners.iter().zip(weights);
                parts.map(|(&node, &weight)| weight * nodes[node as usize]).sum()
            })
            .collect()
    }
}

/// First corner of an element.
fn corner(mesh: &TetMesh, element: usize) -> DVec3 {
    mesh.nodes[mesh.elements[element][0] as usize]
}

/// Maps a vector from the first corner to the barycentric coordinates of the other corners.
fn inverse(mesh: &TetMesh, element: usize) -> DMat3 {
    let [a, b, c, d] = mesh.elements[element].map(|node| mesh.nodes[node as usize]);
    DMat3::from_cols(b - a, c - a, d - a).inverse()
}

/// Elements by the cubes that their bounding boxes meet.
struct Bins {
    low: DVec3,
    /// m
    size: f64,
    n: [usize; 3],
    elements: Vec<Vec<u32>>,
}

impl Bins {
    /// About one cube per element.
    fn new(mesh: &TetMesh) -> Bins {
        let [low, high] = mesh.bounds();
        let extent = (high - low).max(DVec3::splat(1e-9 * (high - low).max_element()));
        let size = (extent.element_product() / mesh.elements.len() as f64).cbrt();
        // Thin meshes have few cubes across, so that there are not many more cubes than elements.
        let n = extent.to_array().map(|side| (side / size).ceil().clamp(1.0, 1024.0) as usize);
        let mut bins = Bins {
            low,
            size: size.max(extent.max_element() / 1024.0),
            n,
            elements: vec![Vec::new(); n.iter().product()],
        };
        for (number, element) in (0..).zip(&mesh.elements) {
            let x = element.map(|node| mesh.nodes[node as usize]);
            let [from, to] = super::bounds(x.into_iter()).map(|x| bins.cube(x));
            for k in from[2]..=to[2] {
                for j in from[1]..=to[1] {
                    for i in from[0]..=to[0] {
                        let bin = bins.index([i, j, k]);
                        bins.elements[bin].push(number);
                    }
                }
            }
        }
        bins
    }

    fn cube(&self, x: DVec3) -> [usize; 3] {
        let place = (x - self.low) / self.size;
        [0, 1, 2].map(|axis| (place[axis].max(0.0) as usize).min(self.n[axis] - 1))
    }

    fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.n[0] * (j + self.n[1] * k)
    }

    /// The first element that contains a point, and the coordinates of its last three corners.
    fn containing(&self, mesh: &TetMesh, x: DVec3) -> Option<(usize, DVec3)> {
        let elements = self.elements[self.index(self.cube(x))].iter();
        elements.map(|&element| element as usize).find_map(|element| {
            let weights = inverse(mesh, element) * (x - corner(mesh, element));
            let least = weights.min_element().min(1.0 - weights.element_sum());
            (least >= -ROUNDING).then_some((element, weights))
        })
    }
}

/// Boundary triangles with the elements behind them.
struct Boundary {
    triangles: TriMesh,
    behind: Vec<u32>,
}

impl Boundary {
    fn new(mesh: &TetMesh) -> Boundary {
        let mut owners: HashMap<[u32; 3], u32> = HashMap::new();
        for (number, &[a, b, c, d]) in (0..).zip(&mesh.elements) {
            for side in [[a, b, c], [a, b, d], [a, c, d], [b, c, d]] {
                owners.insert(sorted(side), number);
            }
        }
        let surface = mesh.surface();
        let behind = surface.iter().map(|&side| owners[&sorted(side)]);
        Boundary {
            behind: behind.collect(),
            triangles: TriMesh::new(mesh.nodes.clone(), surface).expect("a mesh with elements has a boundary"),
        }
    }

    /// The element behind the nearest point of the boundary, and its distance.
    fn nearest(&self, x: DVec3) -> (usize, f64) {
        let (nearest, (triangle, _)) = self.triangles.project_local_point_and_get_location(x, false);
        (self.behind[triangle as usize] as usize, nearest.point.distance(x))
    }
}

fn sorted(mut side: [u32; 3]) -> [u32; 3] {
    side.sort_unstable();
    side
}
