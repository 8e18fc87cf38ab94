//! Random drops of convex and concave bodies onto each other: nothing passes, and nothing gains energy.

use std::fmt::Write;
use std::fs;
use std::ops::Range;
use std::path::Path;

use cutwater::elastic::Solids;
use cutwater::geometry::TetMesh;
use cutwater::output::write_mesh;
use cutwater::scene::Scene;
use cutwater::sim::{Backend, Simulation};
use glam::DVec3;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::{TriMesh, TriMeshFlags};
use rayon::prelude::*;

use crate::common::Random;
use crate::solid_scene::block;

/// End of a drop, s.
const END: f64 = 0.5;
/// Overlap that few drops exceed, m: a hundredth of an element.
pub(crate) const SMALL_OVERLAP: f64 = 5e-4;
/// Overlap that none exceeds, m: a quarter of an element.
pub(crate) const QUARTER: f64 = 0.0125;
/// Energy that no drop exceeds, over its energy after the first sub-step. Near another body the positions of a falling one are half a sub-step
/// behind its velocities. This adds up to 5 %.
pub(crate) const MOST_ENERGY: f64 = 1.05;
/// Bodies at this distance have met, m.
const NEAR: f64 = 1e-3;
/// Way between measurements of the overlap, m: a fifth of an element.
const STRIDE: f64 = 0.01;

/// Writes the bricks of a box of 0.2 m, four along each axis, whose centres about the middle of the box `stay`.
fn carve(path: &Path, stay: impl Fn(DVec3) -> bool) {
    let TetMesh { mut nodes, elements } = TetMesh::new(&block([0.2; 3], [4; 3]), "whole").unwrap();
    nodes.iter_mut().for_each(|node| *node -= 0.1);
    // Tetrahedra of a brick share its diagonal, and so its middle.
    let brick = |corners: &[u32; 4]| {
        let middle = corners.map(|node| nodes[node as usize]).iter().sum::<DVec3>() / 4.0;
        ((middle / 0.05).floor() + 0.5) * 0.05
    };
    let left: Vec<[u32; 4]> = elements.into_iter().filter(|corners| stay(brick(corners))).collect();
    let mut used = left.as_flattened().to_vec();
    used.sort_unstable();
    used.dedup();
    let local = |node: u32| used.partition_point(|other| *other < node) as u32;
    let elements = left.iter().map(|corners| corners.map(local)).collect();
    let nodes = used.iter().map(|&node| nodes[node as usize]).collect();
    write_mesh(path, &TetMesh { nodes, elements }).unwrap();
}

/// A drop.
#[derive(Clone, Debug)]
pub(crate) struct Drop {
    /// Of the seed.
    #[expect(dead_code, reason = "printed with a failure")]
    number: u64,
    /// The bodies met.
    pub(crate) met: bool,
    /// An element was turned inside out, which ended the drop: a body that folds has no inside.
    pub(crate) crushed: bool,
    /// Largest depth of a point of one surface in the other body, m.
    pub(crate) overlap: f64,
    /// Largest speed of a node, m/s.
    pub(crate) fastest: f64,
    /// Largest energy over the energy after the first sub-step.
    pub(crate) energy: f64,
    pub(crate) sub_steps: u32,
    /// Sub-steps with unsettled contacts.
    pub(crate) unsettled: u32,
}

/// The scene of a drop: two bodies of any shape, attitude, spin, stiffness and density, one above the other.
fn scene(folder: &Path, number: u64) -> Scene {
    let mut random = Random(number);
    let meshes = [
        "sphere = { radius = 0.1, cell_size = 0.05 }",
        "box = { size = [0.16, 0.16, 0.16], cells = [3, 3, 3] }",
        "box = { size = [0.3, 0.08, 0.08], cells = [6, 2, 2] }",
        "file = \"bowl.vtu\"",
        "file = \"cross.vtu\"",
        "file = \"horseshoe.vtu\"",
    ];
    let mut pick = |n: usize| (random.bits() % n as u64) as usize;
    let (friction, frames_per_second) = ([0.0, 0.5][pick(2)], [24, 60, 240][pick(3)]);
    let shapes = [pick(6), pick(6)];
    let mut text = format!(
        "[domain]\nsize = [0.8, 0.8, 0.8]\ncells = [32, 32, 32]\n[time]\nduration = {END}\nframes_per_second = {frames_per_second}\n\
         [solver]\nsolid_contact = true\n"
    );
    for (name, shape, height, down) in [("lower", shapes[0], 0.18, 0.0), ("upper", shapes[1], 0.54, 4.0)] {
        let mut any = |size: f64| [(); 3].map(|()| random.uniform(-size, size));
        let (axis, [x, _, z], spin, [u, v, w]) = (any(1.0), any(0.05), any(4.0), any(0.3));
        let speed = v - down * random.uniform(0.0, 1.0);
        let young = 10_f64.powf(random.uniform(4.0, 9.0));
        let density = 10_f64.powf(random.uniform(2.5, 3.5));
        let degrees = random.uniform(0.0, 180.0);
        let mesh = meshes[shape];
        let (x, z) = (0.4 + x, 0.4 + z);
        write!(
            text,
            "[[solid]]\nname = \"{name}\"\nmesh = {{ {mesh} }}\ndensity = {density}\nyoung = {young}\npoisson = 0.3\nfriction = {friction}\n\
             placement = {{ translate = [{x}, {height}, {z}], rotate = {{ axis = {axis:?}, degrees = {degrees} }} }}\n\
             initial = {{ velocity = [{u}, {speed}, {w}], spin = {spin:?} }}\n"
        )
        .unwrap();
    }
    let path = folder.join(format!("drop_{number}.toml"));
    fs::write(&path, text).unwrap();
    Scene::load(&path, &[], 1.0).unwrap()
}

/// Least distance of nodes, and of points of edges, of each of two surfaces from the other body, m, negative inside; infinite where their boxes are
/// apart. `x`: positions of all nodes, m.
fn distance(solids: &Solids, x: &[DVec3]) -> f64 {
    let faces = |body: usize| &solids.triangles[solids.bodies[body].triangles.clone()];
    let bounds = [0, 1].map(|body| {
        let corners = faces(body).as_flattened().iter().map(|&node| x[node as usize]);
        corners.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
    });
    let [low, high] = [bounds[0][0].max(bounds[1][0]) - NEAR, bounds[0][1].min(bounds[1][1]) + NEAR];
    if low.cmpgt(high).any() {
        return f64::INFINITY;
    }
    let least = |(of, from): (usize, usize)| {
        let from = TriMesh::with_flags(x.to_vec(), faces(from).to_vec(), TriMeshFlags::ORIENTED).unwrap();
        let sides = faces(of).iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).filter(|[a, b]| a < b);
        let points = sides.flat_map(|side| {
            let [a, b] = side.map(|node| x[node as usize]);
            (0..=8).map(move |part| a.lerp(b, f64::from(part) / 8.0))
        });
        let near = points.filter(|point| point.cmpge(low).all() && point.cmple(high).all());
        let distances = near.map(|point| {
            let surface = from.project_local_point(point, false);
            point.distance(surface.point) * if surface.is_inside { -1.0 } else { 1.0 }
        });
        distances.fold(f64::INFINITY, f64::min)
    };
    f64::min(least((0, 1)), least((1, 0)))
}

fn drop(folder: &Path, number: u64) -> Drop {
    let scene = scene(folder, number);
    let mut simulation = Simulation::new(&scene, &Backend::Cpu).unwrap();
    let solids = simulation.solids().clone();
    let mut drop = Drop {
        number,
        met: false,
        crushed: false,
        overlap: 0.0,
        fastest: 0.0,
        energy: 1.0,
        sub_steps: 0,
        unsettled: 0,
    };
    let mut first_energy = None;
    let mut before = solids.moved(&simulation.state().unwrap().displacement).nodes;
    assert!(distance(&solids, &before) > 0.0, "{drop:?} starts apart");
    while !drop.crushed && simulation.clock().time < END - 1e-9 {
        let report = simulation.step().unwrap().solid.unwrap();
        drop.sub_steps += 1;
        drop.unsettled += u32::from(report.contact.unsettled > 0);
        let solid = report.diagnosis;
        let energy = solid.kinetic_energy + solid.elastic_energy + solid.potential_energy;
        drop.energy = f64::max(drop.energy, energy / *first_energy.get_or_insert(energy));
        let state = simulation.state().unwrap();
        let x = solids.moved(&state.displacement).nodes;
        let volume = |corners: &[u32; 4]| {
            let [a, b, c, d] = corners.map(|node| x[node as usize]);
            (b - a).cross(c - a).dot(d - a)
        };
        drop.crushed = solids.elements.iter().any(|corners| volume(corners) <= 0.0);
        if !drop.crushed {
            // Nodes move along straight lines: what passes in a sub-step overlaps on the way.
            let way = before.iter().zip(&x).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
            let parts = (way / STRIDE).ceil().max(1.0);
            for part in 1..=parts as u32 {
                let between = before.iter().zip(&x).map(|(a, b)| a.lerp(*b, f64::from(part) / parts));
                let distance = distance(&solids, &between.collect::<Vec<_>>());
                drop.overlap = drop.overlap.max(-distance);
                drop.met |= distance < NEAR;
            }
        }
        let speeds = state.node_velocity.iter().map(|v| DVec3::from(*v).length());
        drop.fastest = speeds.fold(drop.fastest, f64::max);
        before = x;
    }
    drop
}

/// Drops of these numbers.
pub(crate) fn drops(numbers: Range<u64>) -> Vec<Drop> {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    carve(&folder.join("bowl.vtu"), |x| x.y < 0.0 || x.x.abs() > 0.05 || x.z.abs() > 0.05);
    carve(&folder.join("cross.vtu"), |x| x.z.abs() < 0.05 && (x.x.abs() < 0.05 || x.y.abs() < 0.05));
    carve(&folder.join("horseshoe.vtu"), |x| x.z.abs() < 0.05 && (x.y < -0.05 || x.x.abs() > 0.05));
    numbers.into_par_iter().map(|number| drop(folder, number)).collect()
}

/// Bodies of 1e4 to 1e9 Pa and 300 to 3,000 kg/m^3 that fall on each other at up to 5 m/s.
#[test]
fn nothing_passes() {
    let drops = drops(0..200);
    for drop in &drops {
        println!("{drop:?}");
    }
    let whole: Vec<&Drop> = drops.iter().filter(|drop| !drop.crushed).collect();
    let deep = whole.iter().filter(|drop| drop.overlap > SMALL_OVERLAP).count();
    let deepest = whole.iter().map(|drop| drop.overlap).fold(0.0, f64::max);
    let met = drops.iter().filter(|drop| drop.met).count();
    println!("{met} met, {} whole, {deep} of them deeper than {SMALL_OVERLAP} m, at most {deepest} m", whole.len());
    for drop in &drops {
        assert!(drop.energy <= MOST_ENERGY, "{drop:?}");
        assert!(drop.crushed || drop.overlap <= QUARTER, "{drop:?}");
    }
    // Nine of ten.
    assert!(met >= 180 && 10 * deep <= whole.len(), "{met} met, {deep} deep");
    assert!(whole.len() >= 160, "{} whole", whole.len());
}
