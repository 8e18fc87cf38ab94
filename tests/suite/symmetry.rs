//! Planes of symmetry: solids are cut there and roll along them.

use std::path::Path;

use cutwater::Error;
use cutwater::geometry::{TetMesh, solid_meshes};
use cutwater::measure::compare::compare;
use cutwater::scene::Scene;
use cutwater::sim::{Backend, Simulation};
use glam::DVec3;

use crate::common::{adapter, gpu};

fn parse(text: &str, overrides: &[&str]) -> Result<Scene, Error> {
    let overrides: Vec<String> = overrides.iter().map(|&setting| setting.to_owned()).collect();
    Scene::parse(Path::new("half.toml"), text, &overrides, 1.0)
}

/// A beam that is held at both ends and bends under its weight.
const BEAM: &str = r#"[domain]
size = [1.2, 0.4, 0.4]
cells = [12, 4, 4]
[time]
duration = 0.5
[[solid]]
name = "beam"
mesh = { box = { size = [1.0, 0.1, 0.1], cells = [21, 3, 3] } }
placement = { at = [0.6, 0.2, 0.2] }
density = 1000
young = 1e6
poisson = 0.3
damping = { mass = 4, stiffness = 0.01 }
[[solid.pin]]
region = { box = { min = [0.099, 0, 0], max = [0.101, 1, 1] } }
[[solid.pin]]
region = { box = { min = [1.099, 0, 0], max = [1.101, 1, 1] } }
"#;

/// Its left half: the plane cuts the middle of 21 bricks.
const HALF: [&str; 4] =
    ["domain.size=[0.6, 0.4, 0.4]", "domain.cells=[6, 4, 4]", "domain.symmetry=[\"+x\"]", "without solid[0].pin[1]"];

/// Beside the plane the elements of the half are half as long, so not quite as stiff.
#[test]
fn half_a_beam_deflects_as_the_whole() {
    let deflections = |overrides: &[&str]| {
        let mut simulation = Simulation::new(&parse(BEAM, overrides).unwrap(), &Backend::Cpu).unwrap();
        let rest = simulation.solids().rest.clone();
        let place = DVec3::new(0.1 + 9.0 / 21.0, 0.15, 0.15);
        let near = |a: &usize, b: &usize| rest[*a].distance(place).total_cmp(&rest[*b].distance(place));
        let node = (0..rest.len()).min_by(near).unwrap();
        assert!(rest[node].distance(place) < 1e-9);
        let mut deflections = Vec::new();
        while simulation.clock().frame < 12 {
            simulation.step().unwrap();
            deflections.push((simulation.clock().time, simulation.state().unwrap().displacement[node][1]));
        }
        let displacement = simulation.state().unwrap().displacement;
        let on_plane = (0..rest.len()).filter(|&node| (rest[node].x - 0.6).abs() < 1e-9);
        let on_plane: Vec<_> = on_plane.map(|node| displacement[node]).collect();
        (deflections, on_plane)
    };
    let (whole, _) = deflections(&[]);
    let (half, on_plane) = deflections(&HALF);
    let largest = |of: &[(f64, f64)]| of.iter().map(|(_, u)| u.abs()).fold(0.0, f64::max);
    let (ratio, last) = (largest(&half) / largest(&whole), half.last().unwrap().1 / whole.last().unwrap().1);
    println!("largest deflection {} m, half over whole {ratio}, at the end {last}", largest(&whole));
    assert!((ratio - 1.0).abs() < 0.02 && (last - 1.0).abs() < 0.02, "{ratio} {last}");
    assert!(on_plane.len() >= 16 && on_plane.iter().all(|u| u[0] == 0.0 && u[1] < -0.01), "{on_plane:?}");
}

fn mesh(text: &str, overrides: &[&str]) -> TetMesh {
    solid_meshes(&parse(text, overrides).unwrap()).unwrap().remove(0)
}

fn area(mesh: &TetMesh, triangle: [u32; 3]) -> f64 {
    let [a, b, c] = triangle.map(|node| mesh.nodes[node as usize]);
    0.5 * (b - a).cross(c - a).length()
}

/// A box across the plane, turned about its normal: volume and area are exact, so elements fill the part and none overlap.
#[test]
fn a_cut_box_has_the_volume_and_the_area_of_its_part() {
    for shift in [0.0, 1e-9, 0.003, 0.01, 0.0237, 0.024, 0.03] {
        let at = format!(
            "solid[0].placement={{ at = [{}, 0.2, 0.2], rotate = {{ axis = [1, 0, 0], degrees = 30 }} }}",
            0.6 - shift
        );
        let cut = mesh(BEAM, &[&HALF[..], &[&at]].concat());
        let length = 0.5 + shift;
        assert!((cut.volume() / (0.01 * length) - 1.0).abs() < 1e-7, "{shift}: {}", cut.volume());
        let surface: f64 = cut.surface().into_iter().map(|triangle| area(&cut, triangle)).sum();
        assert!((surface / (0.4 * length + 0.02) - 1.0).abs() < 1e-7, "{shift}: {surface}");
        assert!(cut.nodes.iter().all(|x| x.x <= 0.6), "{shift}");
        println!("{shift}: {:?}", cut.worst_element().unwrap().1);
    }
    // On the inner side of the plane nothing is cut.
    let away = "solid[0].placement={ at = [0.6, 0.2, 0.2] }";
    let sides = ["domain.symmetry=[\"+x\", \"-z\"]", away];
    assert_eq!(mesh(BEAM, &sides), mesh(BEAM, &[]));
}

/// A ball in a corner of three planes: an eighth, whose surface is on the ball or on a plane.
#[test]
fn a_cut_ball_is_closed() {
    let ball = |at: f64| {
        format!(
            "[domain]\nsize = [1.0, 1.0, 1.0]\ncells = [8, 8, 8]\ngravity = [0, 0, 0]\nsymmetry = [\"-x\", \"-y\", \"-z\"]\n[time]\nduration = 1.0\n\
             [[solid]]\nname = \"ball\"\nmesh = {{ sphere = {{ radius = 0.4, cell_size = 0.1 }} }}\nplacement = {{ at = [{at}, {at}, {at}] }}\n\
             density = 1000\nyoung = 1e6\npoisson = 0.3\n"
        )
    };
    for at in [0.0, 0.005, 0.01, 0.02, 0.033, 0.05, 0.07, 0.1, -0.01, -0.04, -0.1] {
        let cut = mesh(&ball(at), &[]);
        let (mut open, mut flat) = (DVec3::ZERO, 0.0);
        for triangle in cut.surface() {
            let x = triangle.map(|node| cut.nodes[node as usize]);
            open += (x[1] - x[0]).cross(x[2] - x[0]);
            let on_plane = (0..3).any(|axis| x.iter().all(|x| x[axis] == 0.0));
            // Chords of the ball, and a fifth of an element by which nodes move.
            let on_ball = x.iter().all(|x| (0.36..0.42).contains(&x.distance(DVec3::splat(at))));
            assert!(on_plane || on_ball, "{at}: {x:?}");
            flat += if on_plane { area(&cut, triangle) } else { 0.0 };
        }
        assert!(open.length() < 1e-12, "{at}");
        println!("{at}: volume {}, flat {flat}, {:?}", cut.volume(), cut.worst_element().unwrap().1);
        if at == 0.0 {
            let eighth = std::f64::consts::PI / 6.0 * 0.4_f64.powi(3);
            assert!((cut.volume() / eighth - 1.0).abs() < 0.05, "{}", cut.volume());
        }
    }
}

#[test]
fn what_is_not_symmetric_is_refused() {
    let pool = "\n[liquid]\n[[liquid.region]]\nbox = { min = [0, 0, 0], max = [0.1, 0.1, 0.1] }\n";
    let script = "solid[0].script=[{ region = { box = { min = [0.5, 0, 0], max = [0.7, 1, 1] } }, keyframes = [{ t = 0 }, { t = 1, translate = [0.1, 0, 0] }] }]";
    for (overrides, expected) in [
        (vec!["domain.symmetry=[\"x\"]"], "domain.symmetry[0]"),
        (vec!["domain.symmetry=[\"+x\", \"+x\"]"], "second time"),
        (vec!["domain.symmetry=[\"-y\"]"], "domain.symmetry: gravity points across a plane of symmetry"),
        (vec!["domain.symmetry=[\"+x\"]", "domain.open=[\"+x\"]"], "names an open side"),
        (vec!["domain.symmetry=[\"+z\"]", "domain.slab=z", "domain.cells=[12, 4, 1]"], "a plane of symmetry already"),
        // On the other side of the domain nothing is cut.
        (vec!["domain.symmetry=[\"+x\"]", "solid[0].placement={ at = [0.4, 0.2, 0.2] }"], "sticks out of the domain"),
        (
            [&HALF[..], &["solid[0].placement={ at = [1.2, 0.2, 0.2] }"]].concat(),
            "lies beyond a plane of symmetry (+x)",
        ),
        ([&HALF[..], &["solid[0].initial.velocity=[1, 0, 0]"]].concat(), "moves nodes off the plane of symmetry +x"),
        ([&HALF[..], &["solid[0].initial.spin=[0, 0, 1]"]].concat(), "moves nodes off the plane of symmetry +x"),
        ([&HALF[..], &[script]].concat(), "solid[0].script"),
    ] {
        let refused = parse(&format!("{BEAM}{pool}"), &overrides);
        let refused = refused.and_then(|scene| Simulation::new(&scene, &Backend::Cpu)).err();
        let message = refused.unwrap_or_else(|| panic!("{overrides:?}")).to_string();
        assert!(message.contains(expected) && message.contains("cure: "), "{overrides:?}: {message}");
    }
    // Along the plane everything may move.
    let along = "solid[0].initial={ velocity = [0, 1, 0], spin = [1, 0, 0] }";
    let scene = parse(BEAM, &[&HALF[..], &[along]].concat()).unwrap();
    Simulation::new(&scene, &Backend::Cpu).unwrap();
}

/// A ball half in water.
const FLOATS: &str = r#"[domain]
size = [0.5, 0.5, 0.5]
cells = [16, 16, 16]
[time]
duration = 1.0
[[liquid.region]]
half_space = { point = [0, 0.2, 0], normal = [0, 1, 0] }
[[solid]]
name = "ball"
mesh = { sphere = { radius = 0.1, cell_size = 0.04 } }
placement = { at = [0.25, 0.2, 0.25] }
density = 500
young = 1e6
poisson = 0.3
"#;

/// The liquid pushes half a ball with half the force. The halves of its mesh are not the same: 2 %.
#[test]
fn half_a_ball_floats_as_the_whole() {
    let half = ["domain.size=[0.5, 0.5, 0.25]", "domain.cells=[16, 16, 8]", "domain.symmetry=[\"+z\"]"];
    let force = |overrides: &[&str]| {
        let mut simulation = Simulation::new(&parse(FLOATS, overrides).unwrap(), &Backend::Cpu).unwrap();
        let coupling = simulation.step().unwrap().coupling.unwrap();
        DVec3::from(coupling.force) + DVec3::from(coupling.correction)
    };
    let [whole, part] = [force(&[]), force(&half)];
    println!("{whole} N, {part} N");
    assert!((2.0 * part.y / whole.y - 1.0).abs() < 0.02, "{whole} N, {part} N");
    let Some(_) = gpu() else { return };
    let comparison = compare(&parse(FLOATS, &half).unwrap(), 1, &adapter(), &mut |_, _| {}).unwrap();
    let breached: Vec<_> =
        comparison.rows.iter().filter(|row| row.breached()).map(|row| (row.stage, row.quantity)).collect();
    assert!(comparison.verdict().is_ok(), "{breached:?}");
}
