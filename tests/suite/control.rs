//! Changes of a simulation between two sub-steps: what follows them, and what is refused.

use std::path::Path;

use cutwater::Error;
use cutwater::scene::{Keyframe, Scene};
use cutwater::sim::{Backend, Simulation};
use glam::DVec3;

use crate::common::{adapter, gpu};

const GATE: &str = "
domain = { size = [1, 0.5, 0.25], cells = [16, 8, 4] }
time = { duration = 0.5, fixed_step = 0.010416666666666666 }
liquid = { region = [{ box = { min = [0, 0, 0], max = [0.4, 0.3, 0.25] } }] }
obstacle = [{ box = { min = [0.4, 0, 0], max = [0.55, 0.5, 0.25] }, keyframes = [{ t = 0 }] }]
";

const LIFTED: &str = "obstacle[0].keyframes=[{ t = 0 }, { t = 0.5, translate = [0, 0.2, 0] }]";

/// A block on a platform, without liquid.
const LIFT: &str = "
domain = { size = [1, 0.5, 0.25], cells = [16, 8, 4] }
time = { duration = 0.5, fixed_step = 0.010416666666666666 }
obstacle = [{ box = { min = [0.2, 0, 0], max = [0.8, 0.1, 0.25] }, keyframes = [{ t = 0 }] }]
[[solid]]
name = \"block\"
mesh = { box = { size = [0.2, 0.1, 0.1], cells = [2, 1, 1] } }
placement = { translate = [0.5, 0.15, 0.125] }
density = 1000
young = 1e6
poisson = 0.3
";

fn simulation_of(text: &str, overrides: &[&str], backend: &Backend) -> Simulation {
    let overrides: Vec<String> = overrides.iter().map(|&text| text.to_owned()).collect();
    let scene = Scene::parse(Path::new("control.toml"), text, &overrides, 1.0).unwrap();
    Simulation::new(&scene, backend).unwrap()
}

fn simulation(overrides: &[&str]) -> Simulation {
    simulation_of(GATE, overrides, &Backend::Cpu)
}

fn keyframe(time: f64, y: f64) -> Keyframe {
    Keyframe { time, translate: DVec3::new(0.0, y, 0.0), axis: DVec3::Y, angle: 0.0 }
}

/// Keyframes that are set before the first sub-step are those of the scene: the same bits.
#[test]
fn a_motion_that_is_set_is_that_of_the_scene() {
    let mut backends = vec![Backend::Cpu];
    if gpu().is_some() {
        backends.push(Backend::Gpu(adapter()));
    }
    for backend in &backends {
        for text in [GATE, LIFT] {
            let mut scripted = simulation_of(text, &[LIFTED], backend);
            let mut set = simulation_of(text, &[], backend);
            let mut at_rest = simulation_of(text, &[], backend);
            let keyframes = vec![keyframe(0.0, 0.0), keyframe(0.5, 0.2)];
            set.set_motion(0, keyframes).unwrap();
            for _ in 0..6 {
                scripted.step().unwrap();
                set.step().unwrap();
                at_rest.step().unwrap();
            }
            assert_eq!(set.state().unwrap(), scripted.state().unwrap(), "{text}");
            assert_ne!(set.state().unwrap(), at_rest.state().unwrap(), "{text}");
        }
    }
}

/// So is gravity.
#[test]
fn gravity_that_is_set_is_that_of_the_scene() {
    let mut from_scene = simulation(&["domain.gravity=[1, -2, 0]"]);
    let mut set = simulation(&[]);
    set.set_gravity(DVec3::new(1.0, -2.0, 0.0)).unwrap();
    for _ in 0..3 {
        from_scene.step().unwrap();
        set.step().unwrap();
    }
    assert_eq!(set.state().unwrap(), from_scene.state().unwrap());
}

#[test]
fn velocities_that_are_set_are_those_of_the_state() {
    let mut simulation = simulation(&[]);
    simulation.step().unwrap();
    let mut faces = simulation.state().unwrap().velocity;
    faces[0].iter_mut().for_each(|u| *u += 0.25);
    simulation.set_velocity(Some(faces.clone()), None).unwrap();
    assert_eq!(simulation.state().unwrap().velocity, faces);
}

#[test]
fn what_cannot_change_is_refused() {
    let mut simulation = simulation(&[LIFTED]);
    simulation.step().unwrap();
    let refused = |result: Result<(), Error>, part: &str| {
        let error = result.expect_err(part).to_string();
        assert!(error.contains(part) && error.contains("cure: "), "{error}");
    };
    let time = simulation.clock().time;
    refused(simulation.set_motion(1, vec![keyframe(0.0, 0.0)]), "no such obstacle");
    refused(simulation.set_motion(0, Vec::new()), "keyframes are none");
    refused(simulation.set_motion(0, vec![keyframe(time, 0.1)]), "away from the old one");
    let unordered = vec![keyframe(1.0, 0.0), keyframe(time, 0.4 * time)];
    refused(simulation.set_motion(0, unordered), "do not ascend");
    refused(simulation.set_script(0, 0, vec![keyframe(0.0, 0.0)]), "no such script");
    refused(simulation.set_gravity(DVec3::NAN), "gravity");
    refused(simulation.set_velocity(Some(Default::default()), None), "there are 0");
    simulation.set_motion(0, vec![keyframe(time, 0.4 * time)]).unwrap();
}
