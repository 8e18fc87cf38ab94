//! Subdivided icosahedra, for spheres and balls with almost equal edges.

use std::collections::HashMap;

use glam::DVec3;

use super::Surface;

/// Number of segments of an icosahedron's edge times the edge length over the sphere's radius. The equilateral triangle of that
/// edge has the mean area of the sphere's triangles: sqrt(16 pi / (20 sqrt 3)).
pub(super) const EDGE: f64 = 1.204_591_005_855_254_7;

/// Lattice points of the icosahedron's twenty tetrahedra, each between its centre and a face.
///
/// Plane `k` lies at k times the face's distance and has k + 1 points along an edge. Faces share the points of their edges.
#[derive(Debug)]
pub(super) struct Lattice {
    corners: [DVec3; 12],
    numbers: HashMap<Vec<(usize, usize)>, u32>,
    /// Points in the order of first use. The corners of plane 1 have length 1.
    pub(super) points: Vec<DVec3>,
    /// Plane of each point.
    pub(super) planes: Vec<usize>,
}

impl Lattice {
    pub(super) fn new() -> Lattice {
        Lattice { corners: corners(), numbers: HashMap::new(), points: Vec::new(), planes: Vec::new() }
    }

    /// Number of the point with these integer weights of the corners of a face; their sum is its plane.
    pub(super) fn number(&mut self, face: [usize; 3], weights: [usize; 3]) -> u32 {
        let mut key: Vec<_> = face.into_iter().zip(weights).filter(|&(_, weight)| weight > 0).collect();
        key.sort_unstable();
        let Lattice { corners, numbers, points, planes } = self;
        *numbers.entry(key).or_insert_with_key(|key| {
            points.push(key.iter().map(|&(v, w)| corners[v] * w as f64).sum());
            planes.push(weights.iter().sum());
            (points.len() - 1) as u32
        })
    }
}

/// The unit sphere as an icosahedron with `n` segments along an edge: 20 n^2 triangles, 10 n^2 + 2 vertices of length 1.
pub(super) fn unit_sphere(n: usize) -> Surface {
    let mut lattice = Lattice::new();
    let mut triangles = Vec::new();
    for face in FACES {
        let mut vertex = |i: usize, j: usize| lattice.number(face, [n - i - j, i, j]);
        for i in 0..n {
            for j in 0..n - i {
                triangles.push([vertex(i, j), vertex(i + 1, j), vertex(i, j + 1)]);
                if i + j + 1 < n {
                    triangles.push([vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)]);
                }
            }
        }
    }
    Surface { vertices: lattice.points.into_iter().map(DVec3::normalize).collect(), triangles }
}

/// Vertex radius of a [`unit_sphere`] with the volume of the unit ball.
pub(super) fn equal_volume(unit_sphere: &Surface) -> f64 {
    let ball = 4.0 / 3.0 * std::f64::consts::PI;
    (ball / unit_sphere.volume()).cbrt()
}

/// Corners, of unit length.
fn corners() -> [DVec3; 12] {
    let golden = (1.0 + 5.0_f64.sqrt()) / 2.0;
    [
        [-1.0, golden, 0.0],
        [1.0, golden, 0.0],
        [-1.0, -golden, 0.0],
        [1.0, -golden, 0.0],
        [0.0, -1.0, golden],
        [0.0, 1.0, golden],
        [0.0, -1.0, -golden],
        [0.0, 1.0, -golden],
        [golden, 0.0, -1.0],
        [golden, 0.0, 1.0],
        [-golden, 0.0, -1.0],
        [-golden, 0.0, 1.0],
    ]
    .map(|corner| DVec3::from_array(corner).normalize())
}

/// Corner numbers of the faces, counter-clockwise seen from outside.
pub(super) const FACES: [[usize; 3]; 20] = [
    [0, 11, 5],
    [0, 5, 1],
    [0, 1, 7],
    [0, 7, 10],
    [0, 10, 11],
    [1, 5, 9],
    [5, 11, 4],
    [11, 10, 2],
    [10, 7, 6],
    [7, 1, 8],
    [3, 9, 4],
    [3, 4, 2],
    [3, 2, 6],
    [3, 6, 8],
    [3, 8, 9],
    [4, 9, 5],
    [2, 4, 11],
    [6, 2, 10],
    [8, 6, 7],
    [9, 8, 1],
];
