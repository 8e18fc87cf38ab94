//! What touches nothing falls by g t^2 / 2, at any frame rate, on both backends.

use std::fs;

use cutwater::gpu::AdapterChoice;
use cutwater::scene::Scene;
use cutwater::sim::{Backend, Simulation, reference_path};
use cutwater::state::{State, StepReport};
use glam::DVec3;

use crate::common::gpu;

const TIME: f64 = 0.25;
const GRAVITY: DVec3 = DVec3::new(0.5, -9.75, 0.25);

/// A drop and a block over nothing, in a cube of 1 m.
fn scene(frames_per_second: f64, rest: &str) -> Scene {
    let text = format!(
        "[domain]\nsize = [1, 1, 1]\ncells = [16, 16, 16]\ngravity = {:?}\n\
         [time]\nduration = {TIME}\nframes_per_second = {frames_per_second}\n{rest}",
        GRAVITY.to_array()
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test.toml");
    fs::write(&path, text).unwrap();
    Scene::load(&path, &[], 1.0).unwrap()
}

/// Volume control moves a drop's surface, not its centre.
const DROP: &str = "[liquid]\nvolume_control = false\n[[liquid.region]]\nsphere = { centre = [0.3, 0.75, 0.3], radius = 0.15 }\n";
const BLOCK: &str = "[[solid]]\nname = \"block\"\nmesh = { box = { size = [0.2, 0.2, 0.2], cells = [2, 2, 2] } }\n\
                     placement = { translate = [0.7, 0.75, 0.7] }\ndensity = 500\nyoung = 1e6\npoisson = 0.3\n";

/// Where the markers are in the mean, m.
fn centre(state: &State) -> DVec3 {
    let sum: DVec3 = state.markers.iter().map(|&x| DVec3::from(x)).sum();
    sum / state.markers.len() as f64
}

/// What has fallen for the duration from a state to another.
fn assert_falls(what: &str, start: &State, end: &State, last: &StepReport) {
    let time = end.time;
    assert!((time - TIME).abs() < 1e-9, "{what}");
    let way = 0.5 * time * time * GRAVITY;
    for (u, rest) in end.displacement.iter().zip(&start.displacement) {
        let off = (DVec3::from(*u) - DVec3::from(*rest) - way).length();
        assert!(off <= 1e-6, "{what}: a node is {off} m off");
    }
    if let Some(liquid) = &last.liquid {
        let off = (centre(end) - centre(start) - way).length();
        assert!(off < 0.1 / 16.0, "{what}: the drop is {off} m off");
        let mass = 1000.0 * liquid.diagnosis.volume;
        let speed = DVec3::from(liquid.diagnosis.momentum) / mass;
        let off = (speed - time * GRAVITY).length() / (time * GRAVITY.length());
        assert!(off < 1e-5, "{what}: the drop's speed is {off} off");
    }
}

fn fall(what: &str, scene: &Scene) {
    let device = gpu().map(|_| Backend::Gpu(AdapterChoice::Best));
    for backend in device.iter().chain(&[Backend::Cpu]) {
        let mut simulation = Simulation::new(scene, backend).unwrap();
        let start = simulation.state().unwrap();
        let mut last = None;
        while simulation.clock().frame < scene.n_frames() {
            last = Some(simulation.step().unwrap());
        }
        let end = simulation.state().unwrap();
        let what = format!("{what}, {}", backend.name());
        assert_falls(&what, &start, &end, &last.unwrap());
    }
}

#[test]
fn a_drop_and_a_block_fall_alike_at_any_frame_rate() {
    for frames_per_second in [4.0, 48.0] {
        let scene = scene(frames_per_second, &format!("{DROP}{BLOCK}"));
        fall(&format!("at {frames_per_second} frames/s"), &scene);
    }
}

#[test]
fn each_falls_alone() {
    fall("a drop", &scene(8.0, DROP));
    fall("a block", &scene(8.0, BLOCK));
    let above = "[[obstacle]]\nbox = { min = [0, 0, 0], max = [1, 0.1, 1] }\n";
    fall(
        "a block above an obstacle",
        &scene(8.0, &format!("{BLOCK}{above}")),
    );
}

/// Water at rest in a box, and a block at rest on the floor, do not fall.
#[test]
fn what_stands_does_not_fall() {
    let pool = "[[liquid.region]]\nbox = { min = [0, 0, 0], max = [1, 0.4, 1] }\n";
    let scene = scene(8.0, pool);
    let mut reference = reference_path(&scene).unwrap();
    assert!(!reference.state().ballistic.contains(&true));
    for _ in 0..4 {
        reference.step(reference.next_time_step()).unwrap();
        assert!(!reference.state().ballistic.contains(&true));
    }
}
