//! What touches nothing falls by g t^2 / 2, at any frame rate, on both backends.

use cutwater::scene::Scene;
use cutwater::sim::{Backend, Simulation, reference_path};
use cutwater::state::{State, StepReport};
use glam::DVec3;

use crate::common::{adapter, gpu, scene_from};

const TIME: f64 = 0.25;
const GRAVITY: DVec3 = DVec3::new(0.5, -9.75, 0.25);

/// A drop and a block over nothing, in a cube of 1 m.
fn scene(frames_per_second: f64, rest: &str) -> Scene {
    let text = format!(
        "[domain]\nsize = [1, 1, 1]\ncells = [16, 16, 16]\ngravity = {:?}\n\
         [time]\nduration = {TIME}\nframes_per_second = {frames_per_second}\n{rest}",
        GRAVITY.to_array()
    );
    scene_from(&text, &[])
}

/// Volume control moves a drop's surface, not its centre.
const DROP: &str =
    "[liquid]\nvolume_control = false\n[[liquid.region]]\nsphere = { centre = [0.3, 0.75, 0.3], radius = 0.15 }\n";
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
    let device = gpu().map(|_| Backend::Gpu(adapter()));
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
    fall("a block above an obstacle", &scene(8.0, &format!("{BLOCK}{above}")));
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

/// Gravity that turns, and then vanishes: speeds are its integral, and ways follow to second order in the sub-step.
#[test]
fn gravity_over_time_is_integrated() {
    let keyframes = "gravity_keyframes = [{ t = 0.05, gravity = [0, -12, 0] }, { t = 0.15, gravity = [6, 0, 3] }, { t = 0.2, gravity = [0, 0, 0] }]";
    let text = format!(
        "[domain]\nsize = [1, 1, 1]\ncells = [16, 16, 16]\n{keyframes}\n\
         [time]\nduration = {TIME}\nframes_per_second = 48\n{DROP}{BLOCK}"
    );
    let scene = Scene::parse("test.toml".as_ref(), &text, &[], 1.0).unwrap();
    // Constant, two ramps, nothing: m/s.
    let speed = DVec3::new(0.3, -0.6, 0.15) + DVec3::new(0.0, -0.6, 0.0) + DVec3::new(0.15, 0.0, 0.075);
    let mean = scene.domain.mean_gravity([0.0, TIME]);
    assert!((mean - speed / TIME).length() < 1e-12, "{mean}");
    assert!((scene.domain.mean_gravity([0.0, 0.05]) - DVec3::new(0.0, -12.0, 0.0)).length() < 1e-12);
    assert_eq!(scene.domain.mean_gravity([0.2, 0.3]), DVec3::ZERO);
    assert_eq!(scene.domain.gravity, DVec3::new(0.0, -12.0, 0.0));
    let strongest = scene.domain.strongest_gravity([0.175, 0.3]);
    assert!((strongest - 0.5 * 45.0_f64.sqrt()).abs() < 1e-12, "{strongest}");
    assert_eq!(scene.domain.strongest_gravity([0.14, 0.18]), 45.0_f64.sqrt());
    assert_eq!(scene.domain.largest_gravity(), DVec3::new(6.0, 12.0, 3.0));
    // The way by quadrature.
    let n = 100_000;
    let dt = TIME / f64::from(n);
    let (mut v, mut way) = (DVec3::ZERO, DVec3::ZERO);
    for step in 0..n {
        let t = f64::from(step) * dt;
        let gain = dt * scene.domain.mean_gravity([t, t + dt]);
        way += dt * (v + 0.5 * gain);
        v += gain;
    }
    // The mean of a linear gravity is dt^3 |g'| / 12 off in a sub-step; g' is at most |(6, 12, 3)| / 0.1 s and |(6, 0, 3)| / 0.05 s.
    let rates = 180.0_f64.max(10.0 * 189.0_f64.sqrt());
    let longest = 1.0 / 48.0_f64;
    let bound = TIME * longest * longest * rates / 12.0 + 1e-6;
    let device = gpu().map(|_| Backend::Gpu(adapter()));
    for backend in device.iter().chain(&[Backend::Cpu]) {
        let mut simulation = Simulation::new(&scene, backend).unwrap();
        let start = simulation.state().unwrap();
        let mut halfway = None;
        while simulation.clock().frame < scene.n_frames() {
            simulation.step().unwrap();
            if simulation.clock().frame == 6 && halfway.is_none() {
                halfway = Some((simulation.state().unwrap(), simulation.carried().unwrap()));
            }
        }
        let end = simulation.state().unwrap();
        let name = backend.name();
        for node in 0..end.displacement.len() {
            let [u, u_0, v] =
                [&end.displacement, &start.displacement, &end.node_velocity].map(|values| DVec3::from(values[node]));
            let off = (v - speed).length();
            assert!(off < 1e-5, "{name}: a node is {off} m/s off");
            let off = (u - u_0 - way).length();
            assert!(off < bound, "{name}: a node is {off} m off, of {bound}");
        }
        let off = (centre(&end) - centre(&start) - way).length();
        assert!(off < 0.1 / 16.0, "{name}: the drop is {off} m off");
        // The gravity of a resumed run is that of its time.
        let (state, carried) = halfway.unwrap();
        let mut again = Simulation::new(&scene, backend).unwrap();
        again.resume(&state, &carried).unwrap();
        while again.clock().frame < scene.n_frames() {
            again.step().unwrap();
        }
        assert_eq!(again.state().unwrap(), end, "{name}");
        // Gravity that is set replaces the keyframes.
        simulation.set_gravity(DVec3::X).unwrap();
        simulation.step().unwrap();
        let after = simulation.state().unwrap();
        let gain = DVec3::from(after.node_velocity[0]) - DVec3::from(end.node_velocity[0]);
        let off = (gain - (after.time - end.time) * DVec3::X).length();
        assert!(off < 1e-5, "{name}: {gain}");
    }
}

/// A load that grows and vanishes, on a block that nothing else moves: its momentum is the integral of the force.
#[test]
fn loads_over_time_are_integrated() {
    let load = "[[solid.load]]\nregion = { box = { min = [0, 0, 0], max = [1, 1, 1] } }\n\
                force_keyframes = [{ t = 0.05, force = [0, 0, 0] }, { t = 0.15, force = [0, 40, 20] }, { t = 0.16, force = [0, 0, 0] }]\n";
    let text = format!(
        "[domain]\nsize = [1, 1, 1]\ncells = [16, 16, 16]\ngravity = [0, 0, 0]\n\
         [time]\nduration = {TIME}\nframes_per_second = 48\n{BLOCK}{load}"
    );
    let scene = Scene::parse("test.toml".as_ref(), &text, &[], 1.0).unwrap();
    // Half of the peak over 0.11 s, N s.
    let impulse = DVec3::new(0.0, 2.2, 1.1);
    let device = gpu().map(|_| Backend::Gpu(adapter()));
    for backend in device.iter().chain(&[Backend::Cpu]) {
        let mut simulation = Simulation::new(&scene, backend).unwrap();
        assert_eq!(simulation.solids().free_bodies().count(), 0, "it has a load");
        while simulation.clock().frame < scene.n_frames() {
            simulation.step().unwrap();
        }
        let velocity = simulation.state().unwrap().node_velocity;
        let masses = velocity.iter().zip(&simulation.solids().mass);
        let momentum: DVec3 = masses.map(|(&v, &mass)| mass * DVec3::from(v)).sum();
        let off = (momentum - impulse).length() / impulse.length();
        assert!(off < 1e-5, "{}: {momentum}", backend.name());
    }
}
