//! Solids that touch themselves (`solid.self_contact`).

use cutwater::elastic::{Solids, energy_density};
use cutwater::geometry::contact_pairs;
use cutwater::scene::{Scene, SolidMesh};
use cutwater::sim::{Backend, Simulation};
use glam::DVec3;

use crate::common::{adapter, gpu, project_scene, scene_from};
use crate::coupled_gpu::off;
use crate::solid_scene::{alone, block, body};

/// Corners of faces and ends of edges of a tetrahedron.
const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];
const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// Depth of the overlap of two tetrahedra, m, by separating axes.
fn tet_overlap(a: &[DVec3; 4], b: &[DVec3; 4]) -> f64 {
    let normals = [a, b].into_iter().flat_map(|x| FACES.map(|[i, j, k]| (x[j] - x[i]).cross(x[k] - x[i])));
    let [ours, theirs] = [a, b].map(|x| EDGES.map(|[i, j]| x[j] - x[i]));
    let crosses = ours.iter().flat_map(|u| theirs.iter().map(move |v| u.cross(*v)));
    let axes = normals.chain(crosses).filter(|axis| axis.length() > 1e-9).map(DVec3::normalize);
    let depth = axes.map(|axis| {
        let [[low_a, high_a], [low_b, high_b]] = [a, b].map(|x| {
            let along = x.map(|x| x.dot(axis));
            [along.into_iter().fold(f64::INFINITY, f64::min), along.into_iter().fold(f64::NEG_INFINITY, f64::max)]
        });
        f64::min(high_a - low_b, high_b - low_a)
    });
    depth.fold(f64::INFINITY, f64::min).max(0.0)
}

/// Largest overlap of tetrahedra of some solids, m, where `counts` says so for two of them. `displacement` in m.
fn overlap(solids: &Solids, displacement: &[[f64; 3]], counts: impl Fn(usize, usize) -> bool) -> f64 {
    let x = |node: u32| solids.rest[node as usize] + DVec3::from(displacement[node as usize]);
    let tets: Vec<[DVec3; 4]> = solids.elements.iter().map(|corners| corners.map(x)).collect();
    let bounds = |tet: &[DVec3; 4]| {
        let [low, high] = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        tet.iter().fold([low, high], |[low, high], x| [low.min(*x), high.max(*x)])
    };
    let boxes: Vec<[DVec3; 2]> = tets.iter().map(bounds).collect();
    let near = |&(a, b): &(usize, usize)| boxes[a][0].cmple(boxes[b][1]).all() && boxes[b][0].cmple(boxes[a][1]).all();
    let pairs = (0..tets.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
    let pairs = pairs.filter(|&(a, b)| counts(a, b)).filter(near);
    pairs.map(|(a, b)| tet_overlap(&tets[a], &tets[b])).fold(0.0, f64::max)
}

/// Whether two elements have no node in common.
fn far(solids: &Solids) -> impl Fn(usize, usize) -> bool {
    |a, b| !solids.elements[a].iter().any(|node| solids.elements[b].contains(node))
}

/// Kinetic, elastic and potential energy, J.
fn energy(solids: &Solids, gravity: DVec3, displacement: &[[f64; 3]], velocity: &[[f64; 3]]) -> f64 {
    let nodes = (0..solids.rest.len()).map(|node| {
        let [u, v] = [displacement, velocity].map(|of| DVec3::from(of[node]));
        solids.mass[node] * (0.5 * v.length_squared() - gravity.dot(solids.rest[node] + u))
    });
    let elements = (0..solids.elements.len()).map(|element| {
        let of = solids.body_of_element(element);
        let strain = solids.deformation(element, displacement).strain;
        solids.volume[element] * energy_density(strain, of.lambda, of.mu)
    });
    nodes.sum::<f64>() + elements.sum::<f64>()
}

fn ring(overrides: &[&str]) -> Scene {
    project_scene("ring_on_itself", 1.0, overrides)
}

/// The ring of the scene lies down on itself: sub-steps are halved where it would pass, nothing passes, no solve adds energy, and without contact it
/// passes through itself.
#[test]
fn a_ring_lies_on_itself() {
    let deepest = |itself: bool| {
        let scene = ring(&[&format!("solid[0].self_contact={itself}"), "solver.solid_contact=true"]);
        let mut simulation = Simulation::new(&scene, &Backend::Cpu).unwrap();
        let solids = simulation.solids().clone();
        let gravity = scene.domain.gravity;
        let whole = solids.mass.iter().sum::<f64>() * gravity.length() * 0.26;
        let (mut deepest, mut rise, mut halved) = (0.0_f64, f64::NEG_INFINITY, false);
        let mut before = simulation.state().unwrap();
        let mut step = 0;
        while before.time < 0.35 {
            let report = simulation.step().unwrap();
            let dt = report.dt;
            halved |= report.solid.unwrap().contact.next_halvings > Some(0);
            let after = simulation.state().unwrap();
            // Backward Euler ends where the next move goes.
            let moved = after.displacement.iter().zip(&after.node_velocity);
            let next: Vec<[f64; 3]> = moved.map(|(u, v)| std::array::from_fn(|axis| u[axis] + dt * v[axis])).collect();
            let [start, end] = [(&after.displacement, &before.node_velocity), (&next, &after.node_velocity)]
                .map(|(u, v)| energy(&solids, gravity, u, v));
            rise = rise.max((end - start) / whole);
            if step % 5 == 0 {
                deepest = deepest.max(overlap(&solids, &after.displacement, far(&solids)));
            }
            step += 1;
            before = after;
        }
        println!("{itself}: {deepest} m deep, {step} sub-steps, energy rises by {rise:e}");
        assert!(rise <= 1e-9, "{itself}: {rise}");
        assert_eq!(halved, itself);
        deepest
    };
    let [with, without] = [true, false].map(deepest);
    assert!(with <= 5e-4, "{with} m of 20 mm");
    assert!(without >= 0.005, "{without} m");
}

/// Bodies that never fold are the same to the bit.
#[test]
fn bodies_that_never_fold_are_unchanged() {
    for mesh in ["sphere = { radius = 0.1, cell_size = 0.05 }", "box = { size = [0.3, 0.1, 0.1], cells = [6, 2, 2] }"] {
        let states = [false, true].map(|itself| {
            let text = format!(
                "[domain]\nsize = [1, 1, 1]\ncells = [20, 20, 20]\n[time]\nduration = 1\nframes_per_second = 60\n[[solid]]\nname = \"it\"\n\
                 mesh = {{ {mesh} }}\nplacement = {{ translate = [0.5, 0.2, 0.5], rotate = {{ axis = [1, 2, 3], degrees = 20 }} }}\n\
                 initial.velocity = [0.3, -2, 0]\ndensity = 1000\nyoung = 1e5\npoisson = 0.3\nself_contact = {itself}\n[solver]\nsolid_contact = true\n"
            );
            let mut simulation = Simulation::new(&scene_from(&text, &[]), &Backend::Cpu).unwrap();
            let mut met = false;
            for _ in 0..40 {
                met |= simulation.step().unwrap().solid.unwrap().contact.solves > 1;
            }
            assert!(met, "it falls on the floor");
            simulation.state().unwrap()
        });
        assert_eq!(states[0].node_velocity, states[1].node_velocity, "{mesh}");
        assert_eq!(states[0].displacement, states[1].displacement, "{mesh}");
    }
}

/// Convex bodies have no pairs with themselves, whatever the reach, nor has a ring within its hole.
#[test]
fn neighbours_are_no_pairs() {
    let ball = alone(body(SolidMesh::Sphere { radius: 0.1, cell_size: 0.04 }));
    let bar = alone(block([0.3, 0.1, 0.02], [6, 2, 1]));
    let bent = |x: DVec3| DVec3::new(x.x + 0.1 * x.y, x.y + 0.3 * x.x * x.x, 0.8 * x.z);
    for solids in [ball, bar] {
        let whole = 0..solids.triangles.len();
        for positions in [solids.rest.clone(), solids.rest.iter().map(|&x| bent(x)).collect()] {
            let pairs = contact_pairs(&positions, &solids.triangles, std::slice::from_ref(&whole), &|_, _| Some(0.05));
            assert_eq!(pairs, []);
        }
    }
    let scene = ring(&[]);
    let solids = Simulation::new(&scene, &Backend::Cpu).unwrap().solids().clone();
    let whole = 0..solids.triangles.len();
    let pairs =
        |reach: f64| contact_pairs(&solids.rest, &solids.triangles, std::slice::from_ref(&whole), &|_, _| Some(reach));
    // Across the hole, whose diameter is 0.22 m.
    assert_eq!(pairs(0.1), []);
    assert!(pairs(0.25).iter().any(|pair| (pair.gap - 0.22).abs() < 0.01));
}

/// From the state in which the ring presses on itself, the device computes the velocities of the f64 path.
#[test]
fn self_contact_on_the_device_is_that_of_the_twin() {
    if gpu().is_none() {
        return;
    }
    let scene = ring(&[]);
    let mut twin = Simulation::new(&scene, &Backend::Cpu).unwrap();
    let solids = twin.solids().clone();
    let whole = 0..solids.triangles.len();
    let mut before = twin.state().unwrap();
    let pressed = loop {
        let report = twin.step().unwrap().solid.unwrap();
        let x = solids.rest.iter().zip(&before.displacement).map(|(rest, u)| rest + DVec3::from(*u));
        let x: Vec<DVec3> = x.collect();
        if report.contact.solves > 1
            && !contact_pairs(&x, &solids.triangles, std::slice::from_ref(&whole), &|_, _| Some(1e-3)).is_empty()
        {
            break report.contact;
        }
        assert!(before.time < 0.5, "it touches itself");
        before = twin.state().unwrap();
    };
    let mut simulation = Simulation::new(&scene, &Backend::Gpu(adapter())).unwrap();
    simulation.reset(&before).unwrap();
    let report = simulation.step().unwrap().solid.unwrap();
    assert!(report.contact.solves > 1, "{report:?} for {pressed:?}");
    let [ours, theirs] = [&simulation, &twin].map(|it| it.state().unwrap().node_velocity);
    let off = off(ours.as_flattened(), theirs.as_flattened());
    println!("{off} m/s");
    // Positions in f32 pairs: gaps over dt.
    assert!(off <= 1e-4, "{off} m/s");
}
