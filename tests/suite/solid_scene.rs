//! Scenes of solids, for the suite and for the validation.

use std::fs;

use cutwater::elastic::Solids;
use cutwater::geometry::TetMesh;
use cutwater::scene::{ElasticModel, Initial, Placement, Scene, Solid, SolidMesh};
use glam::DVec3;

use crate::common::Random;

/// What the file of a scene says of everything but the solids.
const EMPTY: &str = "[domain]
size = [4.0, 4.0, 4.0]
cells = [8, 8, 8]
gravity = [0.0, 0.0, 0.0]
[time]
duration = 1.0
frames_per_second = 24
[[solid]]
name = \"block\"
mesh = { box = { size = [1.0, 1.0, 1.0], cells = [1, 1, 1] } }
placement = { translate = [1.0, 1.0, 1.0] }
density = 1000.0
young = 1e6
poisson = 0.3
";

/// A body of a mesh: E = 1 MPa, nu = 0.3, 1000 kg/m^3, nothing held.
pub(crate) fn body(mesh: SolidMesh) -> Solid {
    Solid {
        name: "body".to_owned(),
        mesh,
        placement: Placement::default(),
        stretch: DVec3::ONE,
        initial: Initial::default(),
        density: 1000.0,
        young: 1e6,
        poisson: 0.3,
        model: ElasticModel::Corotational,
        mass_damping: 0.0,
        stiffness_damping: 0.0,
        friction: 0.0,
        contact: true,
        no_contact_with: Vec::new(),
        self_contact: false,
        pins: Vec::new(),
        loads: Vec::new(),
    }
}

/// A block of bricks with its low corner at the origin; E = 1 MPa, nu = 0.3, 1000 kg/m^3, nothing held.
pub(crate) fn block(size: [f64; 3], cells: [usize; 3]) -> Solid {
    let size = DVec3::from(size);
    Solid {
        name: "block".into(),
        placement: Placement { translate: 0.5 * size, ..Placement::default() },
        ..body(SolidMesh::Box { size, cells })
    }
}

/// These solids in a domain of 4 x 4 x 4 m, without gravity and liquid.
pub(crate) fn scene_of(solids: Vec<Solid>) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test.toml");
    fs::write(&path, EMPTY).unwrap();
    Scene { solids, ..Scene::load(&path, &[], 1.0).unwrap() }
}

/// The solids of a scene.
pub(crate) fn solids_of(scene: &Scene) -> Solids {
    let mesh = |solid| TetMesh::new(solid, "test").unwrap();
    let meshes: Vec<TetMesh> = scene.solids.iter().map(mesh).collect();
    Solids::new(scene, &meshes).unwrap()
}

/// One solid by itself.
pub(crate) fn alone(solid: Solid) -> Solids {
    solids_of(&scene_of(vec![solid]))
}

/// Displacements that take every node to where `x` says.
pub(crate) fn displaced(solids: &Solids, x: impl Fn(DVec3) -> DVec3) -> Vec<[f64; 3]> {
    let nodes = solids.rest.iter();
    nodes.map(|&rest| (x(rest) - rest).to_array()).collect()
}

/// Numbers of a vector field, uniform in [-size, size).
pub(crate) fn noise(random: &mut Random, n: usize, size: f64) -> Vec<[f64; 3]> {
    let mut number = || random.uniform(-size, size);
    (0..n).map(|_| std::array::from_fn(|_| number())).collect()
}

/// The rows of a table below `tests/data`, without comments and the line of names.
pub(crate) fn rows(table: &str) -> impl Iterator<Item = Vec<&str>> {
    let rows = table.lines().filter(|line| !line.starts_with('#')).skip(1);
    rows.map(|line| line.split(',').collect())
}
