//! Tetrahedral meshes: shapes, placement, surfaces, the shape of elements, files and fills.

use std::collections::HashMap;
use std::f64::consts::PI;

use cutwater::geometry::{Surface, TetMesh};
use cutwater::scene::{ElasticModel, Initial, Placement, Solid, SolidMesh};
use glam::DVec3;

use crate::common::Random;

fn solid(mesh: SolidMesh) -> Solid {
    Solid {
        name: "body".to_owned(),
        mesh,
        placement: Placement::default(),
        initial: Initial::default(),
        density: 1000.0,
        young: 1e6,
        poisson: 0.3,
        model: ElasticModel::Corotational,
        mass_damping: 0.0,
        stiffness_damping: 0.0,
        pins: Vec::new(),
        loads: Vec::new(),
    }
}

fn mesh(mesh: SolidMesh) -> TetMesh {
    TetMesh::new(&solid(mesh), "test").unwrap()
}

fn cuboid(size: [f64; 3], cells: [usize; 3]) -> SolidMesh {
    SolidMesh::Box {
        size: DVec3::from_array(size),
        cells,
    }
}

/// Nodes less edges plus triangles of the surface: 2 for each closed surface without a hole.
fn euler_characteristic(triangles: &[[u32; 3]]) -> i64 {
    let mut nodes: Vec<u32> = triangles.iter().flatten().copied().collect();
    nodes.sort_unstable();
    nodes.dedup();
    nodes.len() as i64 + triangles.len() as i64 - 3 * triangles.len() as i64 / 2
}

/// What holds for the mesh of every solid: positive elements, all nodes used, a closed outward surface that encloses them.
fn assert_sound(mesh: &TetMesh, name: &str) {
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
        for edge in [[a, b], [b, c], [c, a]] {
            assert_eq!(edges.insert(edge, ()), None, "{name}: {edge:?} twice");
        }
    }
    for &[a, b] in edges.keys() {
        assert!(edges.contains_key(&[b, a]), "{name}: open at {a}, {b}");
    }
    let surface = Surface {
        vertices: mesh.nodes.clone(),
        triangles,
    };
    let difference = surface.volume() - mesh.volume();
    assert!(
        difference.abs() < 1e-12 * mesh.volume(),
        "{name}: {difference:e}"
    );
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
        assert!(
            (*x + DVec3::new(0.5, 0.05, 0.05) - reference).length() < 1e-15,
            "{number}"
        );
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
        assert!(
            (sphere.volume() / ball(radius) - 1.0).abs() < 1e-12,
            "{name}"
        );
        let (mean_ratio, dihedral) = worst(&sphere);
        assert!(
            mean_ratio > 0.6 && dihedral > 30.0,
            "{name}: {mean_ratio} {dihedral}"
        );

        // Thick ones, and some of less than a cell.
        let thickness = radius * random.uniform(0.02, 0.8);
        let name = format!("shell {radius} {thickness} {cell_size}");
        let shell = mesh(SolidMesh::Shell {
            radius,
            thickness,
            cell_size,
        });
        assert_sound(&shell, &name);
        assert_eq!(euler_characteristic(&shell.surface()), 4, "{name}");
        assert_eq!(shell.components(), 1, "{name}");
        let exact = ball(radius) - ball(radius - thickness);
        assert!((shell.volume() / exact - 1.0).abs() < 1e-11, "{name}");
        // Thinner than half a cell, elements are as flat as the shell.
        let (mean_ratio, dihedral) = worst(&shell);
        if thickness > 0.5 * cell_size {
            assert!(
                mean_ratio > 0.5 && dihedral > 20.0,
                "{name}: {mean_ratio} {dihedral}"
            );
        }
    }
}

/// The thesis' hollow ball (section 6.1.5) has 992 nodes and 2948 elements.
#[test]
fn a_shell_of_one_layer_is_close_to_the_hollow_ball_of_the_thesis() {
    let shell = mesh(SolidMesh::Shell {
        radius: 1.0,
        thickness: 0.05,
        cell_size: 0.172,
    });
    assert_eq!((shell.nodes.len(), shell.elements.len()), (984, 2940));
}
