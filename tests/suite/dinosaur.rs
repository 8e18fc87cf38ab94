//! The toy dinosaur of `examples/dinosaur.rs`: the file in the repository is what its command writes, and stands on its feet.

use std::fs;
use std::path::Path;

use cutwater::geometry::read_tets;
use cutwater::output::write_mesh;
use glam::DVec3;

use crate::tet_mesh::{assert_sound, euler_characteristic};

#[expect(dead_code, reason = "the command's own main, which the test runs without")]
#[path = "../../examples/dinosaur.rs"]
mod example;

#[test]
fn the_dinosaur_is_what_its_command_writes_and_stands() {
    let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/meshes/dinosaur.vtu");
    let folder = tempfile::tempdir().unwrap();
    let again = folder.path().join("dinosaur.vtu");
    write_mesh(&again, &example::dinosaur()).unwrap();
    assert!(
        fs::read(&again).unwrap() == fs::read(&kept).unwrap(),
        "make scenes/meshes/dinosaur.vtu again: cargo run --release --example dinosaur -- scenes/meshes/dinosaur.vtu"
    );

    let read = read_tets(&kept).unwrap();
    assert!(read.notes.is_empty(), "{:?}", read.notes);
    let mesh = read.mesh;
    assert_sound(&mesh, "dinosaur");
    assert_eq!((mesh.nodes.len(), mesh.elements.len()), (1428, 5515));
    assert_eq!(mesh.components(), 1);
    assert_eq!(euler_characteristic(&mesh.surface()), 2);
    let shape = mesh.worst_element().unwrap().1;
    assert!(shape.mean_ratio > 0.3, "{shape:?}");

    // Four soles in the plane y = 0, and the centre of mass above the rectangle that they span.
    let soles = mesh.nodes.iter().filter(|x| x.y == 0.0);
    let mut corners = [0; 4];
    let [mut low, mut high] = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    for &x in soles {
        corners[usize::from(x.x > 0.0) + 2 * usize::from(x.z > 0.0)] += 1;
        (low, high) = (low.min(x), high.max(x));
    }
    assert!(corners.iter().all(|&n| n >= 5), "{corners:?}");
    let moment: DVec3 = mesh
        .elements
        .iter()
        .map(|&element| {
            let sum: DVec3 = element.iter().map(|&node| mesh.nodes[node as usize]).sum();
            mesh.shape(element).volume * sum / 4.0
        })
        .sum();
    let centre = moment / mesh.volume();
    assert!(
        centre.x > low.x + 0.05 && centre.x < high.x - 0.05 && centre.z.abs() < 0.01,
        "{centre} over {low} to {high}"
    );
    assert!(mesh.bounds()[0].y == 0.0);
}
