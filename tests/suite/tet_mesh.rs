//! Tetrahedral meshes: shapes, placement, surfaces, the shape of elements, files and fills.

use std::collections::HashMap;
use std::f64::consts::PI;

use cutwater::geometry::{Surface, TetMesh};
use cutwater::scene::SolidMesh;
use glam::DVec3;

use crate::common::Random;
use crate::solid_scene::body;

fn mesh(mesh: SolidMesh) -> TetMesh {
    TetMesh::new(&body(mesh), "test").unwrap()
}

fn cuboid(size: [f64; 3], cells: [usize; 3]) -> SolidMesh {
    SolidMesh::Box { size: DVec3::from_array(size), cells }
}

/// Nodes less edges plus triangles of the surface: 2 for each closed surface without a hole.
pub(crate) fn euler_characteristic(triangles: &[[u32; 3]]) -> i64 {
    let mut nodes: Vec<u32> = triangles.iter().flatten().copied().collect();
    nodes.sort_unstable();
    nodes.dedup();
    nodes.len() as i64 + triangles.len() as i64 - 3 * triangles.len() as i64 / 2
}

/// What holds for the mesh of every solid: positive elements, all nodes used, a closed outward surface that encloses them. That it
/// nowhere touches itself holds for all meshes of these tests.
pub(crate) fn assert_sound(mesh: &TetMesh, name: &str) {
    assert_eq!(mesh.fault(), None, "{name}");
    let mut used = vec![false; mesh.nodes.len()];
    for &element in &mesh.elements {
        assert!(mesh.determinant(element) > 0.0, "{name}");
        for node in element {
            used[node as usize] = true;
        }
    }
    assert!(used.iter().all(|&used| used), "{name}");
    let triangles = mesh.surface();
    let mut edges = HashMap::new();
    for &[a, b, c] in &triangles {
        for [from, to] in [[a, b], [b, c], [c, a]] {
            let twice = edges.insert([from, to], ());
            assert_eq!(twice, None, "{name}: from {from} to {to} twice");
        }
    }
    for &[from, to] in edges.keys() {
        assert!(edges.contains_key(&[to, from]), "{name}: open at {from}, {to}");
    }
    assert_eq!(mesh.pinched_edges(), 0, "{name}");
    let surface = Surface { vertices: mesh.nodes.clone(), triangles };
    let difference = surface.volume() - mesh.volume();
    assert!(difference.abs() < 1e-12 * mesh.volume(), "{name}: {difference:e}");
}

fn worst(mesh: &TetMesh) -> (f64, f64) {
    let shape = mesh.worst_element().unwrap().1;
    (shape.mean_ratio, shape.min_dihedral)
}

#[test]
fn boxes_are_kuhns() {
    let mut random = Random(1);
    for _ in 0..20 {
        let size = [0; 3].map(|_| random.uniform(0.01, 3.0));
        let cells = [0; 3].map(|_| random.uniform(1.0, 6.0) as usize);
        let mesh = mesh(cuboid(size, cells));
        let name = format!("{size:?} {cells:?}");
        assert_sound(&mesh, &name);
        let [nx, ny, nz] = cells;
        assert_eq!(mesh.nodes.len(), (nx + 1) * (ny + 1) * (nz + 1));
        assert_eq!(mesh.elements.len(), 6 * nx * ny * nz);
        let [x, y, z] = size;
        assert!((mesh.volume() / (x * y * z) - 1.0).abs() < 1e-13, "{name}");
        let triangles = mesh.surface();
        assert_eq!(triangles.len(), 4 * (nx * ny + ny * nz + nz * nx), "{name}");
        assert_eq!(euler_characteristic(&triangles), 2, "{name}");
        let [low, high] = mesh.bounds();
        assert_eq!(low, -high, "{name}");
        assert_eq!(high, 0.5 * DVec3::from_array(size), "{name}");
        assert_eq!(mesh.components(), 1, "{name}");
        // Every element has an edge along the diagonal of its brick.
        let brick = DVec3::from_array(size) / DVec3::from_array(cells.map(|n| n as f64));
        for element in &mesh.elements {
            let longest = mesh.nodes[element[3] as usize] - mesh.nodes[element[0] as usize];
            assert!((longest - brick).length() < 1e-12, "{name}: {longest}");
        }
    }
}

#[test]
fn the_cantilever_has_the_nodes_of_the_reference() {
    let mesh = mesh(cuboid([1.0, 0.1, 0.1], [10, 2, 2]));
    assert_eq!((mesh.nodes.len(), mesh.elements.len()), (99, 240));
    for (number, x) in mesh.nodes.iter().enumerate() {
        let reference = [number / 9, number / 3 % 3, number % 3].map(|at| at as f64);
        let reference = DVec3::from_array(reference) * DVec3::new(0.1, 0.05, 0.05);
        assert!((*x + DVec3::new(0.5, 0.05, 0.05) - reference).length() < 1e-15, "{number}");
    }
}

#[test]
fn balls_and_shells_have_their_volume_and_good_elements() {
    let mut random = Random(2);
    let ball = |radius: f64| 4.0 / 3.0 * PI * radius.powi(3);
    for _ in 0..12 {
        let radius = random.uniform(0.01, 3.0);
        let cell_size = radius / random.uniform(1.0, 7.0);
        let name = format!("ball {radius} {cell_size}");
        let sphere = mesh(SolidMesh::Sphere { radius, cell_size });
        assert_sound(&sphere, &name);
        assert_eq!(euler_characteristic(&sphere.surface()), 2, "{name}");
        assert!((sphere.volume() / ball(radius) - 1.0).abs() < 1e-12, "{name}");
        let (mean_ratio, dihedral) = worst(&sphere);
        assert!(mean_ratio > 0.6 && dihedral > 30.0, "{name}: {mean_ratio} {dihedral}");

        // Thick ones, and some of less than a cell.
        let thickness = radius * random.uniform(0.02, 0.8);
        let name = format!("shell {radius} {thickness} {cell_size}");
        let shell = mesh(SolidMesh::Shell { radius, thickness, cell_size });
        assert_sound(&shell, &name);
        assert_eq!(euler_characteristic(&shell.surface()), 4, "{name}");
        assert_eq!(shell.components(), 1, "{name}");
        let exact = ball(radius) - ball(radius - thickness);
        assert!((shell.volume() / exact - 1.0).abs() < 1e-11, "{name}");
        // Thinner than half a cell, elements are as flat as the shell.
        let (mean_ratio, dihedral) = worst(&shell);
        if thickness > 0.5 * cell_size {
            assert!(mean_ratio > 0.5 && dihedral > 20.0, "{name}: {mean_ratio} {dihedral}");
        }
    }
}

/// The thesis' hollow ball (section 6.1.5) has 992 nodes and 2948 elements.
#[test]
fn a_shell_of_one_layer_is_close_to_the_hollow_ball_of_the_thesis() {
    let shell = mesh(SolidMesh::Shell { radius: 1.0, thickness: 0.05, cell_size: 0.172 });
    assert_eq!((shell.nodes.len(), shell.elements.len()), (984, 2940));
}

/// Elements as they are, with the nodes of a cube of length 1 and one beside it.
fn by_hand(elements: &[[u32; 4]]) -> TetMesh {
    let corner = |bits: u32| DVec3::new((bits & 1) as f64, (bits >> 1 & 1) as f64, (bits >> 2) as f64);
    TetMesh { nodes: (0..9).map(corner).collect(), elements: elements.to_vec() }
}

#[test]
fn parts_and_pinches_are_counted() {
    let element = [0, 1, 2, 4];
    // With a common face, edge, node, and none.
    for (other, parts, pinches, triangles) in
        [([1, 2, 4, 7], 1, 0, 6), ([1, 2, 3, 7], 1, 1, 8), ([1, 3, 5, 6], 1, 0, 8), ([3, 5, 6, 7], 2, 0, 8)]
    {
        let mut mesh = by_hand(&[element, other]);
        if mesh.determinant(other) < 0.0 {
            mesh.elements[1].swap(0, 1);
        }
        assert_eq!(mesh.fault(), None, "{other:?}");
        assert_eq!(mesh.surface().len(), triangles, "{other:?}");
        assert_eq!(mesh.pinched_edges(), pinches, "{other:?}");
        // Nodes that no element uses count as parts of their own here.
        let unused = 9 - [&element[..], &other[..]].concat().iter().collect::<std::collections::HashSet<_>>().len();
        assert_eq!(mesh.components(), parts + unused, "{other:?}");
    }
}

#[test]
fn shapes_of_elements_are_known_ones() {
    let close = |a: f64, b: f64| (a - b).abs() < 1e-12 * b.abs();
    // Every second corner of a cube.
    let regular = by_hand(&[[0, 3, 5, 6]]);
    let shape = regular.shape([0, 3, 5, 6]);
    let angle = f64::acos(1.0 / 3.0).to_degrees();
    assert!(close(shape.volume, -1.0 / 3.0), "{shape:?}");
    assert!(close(shape.mean_ratio, -1.0), "{shape:?}");
    let shape = regular.shape([0, 5, 3, 6]);
    assert!(close(shape.volume, 1.0 / 3.0) && close(shape.mean_ratio, 1.0), "{shape:?}");
    assert!(close(shape.min_dihedral, angle) && close(shape.max_dihedral, angle), "{shape:?}");
    assert!(close(shape.aspect, 1.0), "{shape:?}");
    // A corner of the cube: three right angles, three with the cosine 1 / sqrt 3; the height on the slanted face is 1 / sqrt 3.
    let shape = regular.shape([0, 1, 2, 4]);
    assert!(close(shape.volume, 1.0 / 6.0), "{shape:?}");
    assert!(close(shape.mean_ratio, 12.0 * 0.25_f64.powf(1.0 / 3.0) / 9.0), "{shape:?}");
    assert!(close(shape.min_dihedral, f64::acos(1.0 / 3.0_f64.sqrt()).to_degrees()), "{shape:?}");
    assert!(close(shape.max_dihedral, 90.0), "{shape:?}");
    assert!(close(shape.aspect, (2.0_f64 / 3.0).sqrt() * 6.0_f64.sqrt()), "{shape:?}");
}
