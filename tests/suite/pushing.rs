//! Moving obstacles that push solids: on the f64 path against what is known, and the device against the f64 path.

use cutwater::measure::compare::compare;
use cutwater::scene::Scene;
use cutwater::sim::{Backend, Simulation};
use cutwater::state::{State, StepReport};
use glam::{DQuat, DVec3};

use crate::common::{adapter, gpu};
use crate::solid_scene::solids_of;

/// A domain of 1 m with cells of 1/20 m.
fn scene(gravity: f64, rest: &str) -> Scene {
    let text = format!(
        "[domain]\nsize = [1, 1, 1]\ncells = [20, 20, 20]\ngravity = [0, {gravity}, 0]\n[time]\nduration = 2\nframes_per_second = 60\n{rest}"
    );
    Scene::parse("pushing.toml".as_ref(), &text, &[], 1.0).unwrap()
}

/// A block of 0.2 m and 8 kg.
fn block(centre: [f64; 3], young: f64) -> String {
    format!(
        "[[solid]]\nname = \"block\"\nmesh = {{ box = {{ size = [0.2, 0.2, 0.2], cells = [3, 3, 3] }} }}\n\
         placement = {{ translate = {centre:?} }}\ndensity = 1000\nyoung = {young}\npoisson = 0.3\n"
    )
}

/// A platform that rises at 0.3 m/s from 0.1 s on, with a block on it.
fn lift(young: f64) -> Scene {
    let platform = "[[obstacle]]\nbox = { min = [0.2, 0.1, 0.2], max = [0.8, 0.2, 0.8] }\n\
                    keyframes = [{ t = 0.1 }, { t = 1.1, translate = [0, 0.3, 0] }]\n";
    scene(-9.81, &format!("{platform}{}", block([0.5, 0.3, 0.5], young)))
}

/// Runs to a time, s; `after` is called with each sub-step's report and state.
fn run(scene: &Scene, end: f64, mut after: impl FnMut(&StepReport, &State)) {
    let mut simulation = Simulation::new(scene, &Backend::Cpu).unwrap();
    while simulation.clock().time < end - 1e-9 {
        let report = simulation.step().unwrap();
        after(&report, &simulation.state().unwrap());
    }
}

/// Positions of all nodes, m.
fn positions(scene: &Scene, state: &State) -> Vec<DVec3> {
    let solids = solids_of(scene);
    let nodes = solids.rest.iter().zip(&state.displacement);
    nodes.map(|(rest, u)| rest + DVec3::from(*u)).collect()
}

/// The block stays on the platform, moves with it and is as high as it stands on a fixed one.
#[test]
fn a_platform_lifts_a_block() {
    for young in [1e5, 1e9] {
        let scene = lift(young);
        let dx = scene.grid().dx;
        let (mut lowest, mut height, mut speed) = (f64::INFINITY, 0.0, 0.0);
        run(&scene, 1.0, |report, state| {
            let top = 0.2 + 0.3 * (state.time - 0.1).max(0.0);
            let positions = positions(&scene, state);
            let below = positions.iter().map(|x| x.y - top);
            lowest = below.clone().fold(lowest, f64::min);
            let n = positions.len() as f64;
            height = below.sum::<f64>() / n;
            speed = state.node_velocity.iter().map(|v| v[1]).sum::<f64>() / n;
            assert_eq!(report.solid.unwrap().contact.unsettled, 0, "{young}");
        });
        // The search leaves 1e-4 dx; a body under its weight shrinks by rho g h^2 / (2 E) = 2 mm at 1e5 Pa, in its middle half of that
        // and more where it still swings.
        assert!(lowest >= -2e-4 * dx, "{young}: {lowest} m below");
        let sag = 1000.0 * 9.81 * 0.04 / (2.0 * young);
        assert!((height - 0.1).abs() <= 2.0 * sag + 2e-4 * dx, "{young}: {height} m");
        assert!((speed - 0.3).abs() <= 0.02, "{young}: {speed} m/s");
    }
}

/// A paddle strikes a ball that floats free: no node gets behind its face, and the ball leaves it no faster than from an elastic impact, at
/// twice the paddle's speed, and no slower than it pushes.
#[test]
fn a_paddle_strikes_a_ball() {
    let paddle = "[[obstacle]]\nbox = { min = [0.1, 0, 0], max = [0.2, 1, 1] }\n\
                  keyframes = [{ t = 0.05 }, { t = 0.45, translate = [0.4, 0, 0] }]\n";
    for young in [2e4, 1e6, 1e9] {
        let ball = format!(
            "[[solid]]\nname = \"ball\"\nmesh = {{ sphere = {{ radius = 0.1, cell_size = 0.05 }} }}\n\
             placement = {{ translate = [0.35, 0.5, 0.5] }}\ndensity = 500\nyoung = {young}\npoisson = 0.3\n"
        );
        let scene = scene(0.0, &format!("{paddle}{ball}"));
        let mass: f64 = solids_of(&scene).mass.iter().sum();
        let (mut behind, mut leaves, mut energy) = (f64::INFINITY, 0.0, 0.0_f64);
        run(&scene, 0.45, |report, state| {
            let face = 0.2 + (state.time - 0.05).clamp(0.0, 0.4);
            let gaps = positions(&scene, state).into_iter().map(|x| x.x - face);
            behind = gaps.fold(behind, f64::min);
            let it = report.solid.unwrap().diagnosis;
            leaves = it.momentum[0] / mass;
            energy = energy.max(it.kinetic_energy + it.elastic_energy);
        });
        // A sub-step longer than the one before, or a node that moves on a circle, takes nodes beyond a face by a part of a sub-step's way.
        let dx = scene.grid().dx;
        assert!(behind >= -0.02 * dx, "{young}: {behind} m behind the face");
        assert!((0.98..=2.02).contains(&leaves), "{young}: {leaves} m/s");
        assert!(energy <= 0.5 * mass * 4.0 * 1.02, "{young}: {energy} J");
    }
}

/// A bar turns about one end and sweeps a block along: in its frame no node is behind its face.
#[test]
fn a_turning_bar_sweeps_a_block() {
    let bar = "[[obstacle]]\nbox = { min = [0.2, 0, 0.45], max = [0.8, 1, 0.55] }\npivot = [0.2, 0.5, 0.5]\n\
               keyframes = [{ t = 0.05 }, { t = 1.05, rotate = { axis = [0, -1, 0], degrees = 60 } }]\n";
    let scene = scene(0.0, &format!("{bar}{}", block([0.6, 0.5, 0.66], 1e6)));
    let (mut deepest, mut touched) = (0.0_f64, false);
    run(&scene, 1.0, |report, state| {
        let angle = -60f64.to_radians() * (state.time - 0.05).max(0.0);
        let back = DQuat::from_rotation_y(-angle);
        for x in positions(&scene, state) {
            let x = back * (x - DVec3::new(0.2, 0.5, 0.5));
            let inside = x.x < 0.55 && x.z > -0.05;
            if inside {
                deepest = deepest.max(0.05 - x.z);
            }
        }
        touched |= report.solid.unwrap().diagnosis.momentum[2] > 1.0;
    });
    // Rate and normal are those at the start of a sub-step, in which the bar turns by 0.017 rad: at an arm of 0.6 m that is 0.1 mm. Behind the
    // edge of the bar, where no distance is linear, nodes are not asked about.
    let dx = scene.grid().dx;
    assert!(touched && deepest <= 0.02 * dx, "{deepest} m");
}

/// The same sub-steps on the device, stage by stage.
#[test]
fn pushed_solids_are_the_twins() {
    let Some(_) = gpu() else { return };
    let comparison = compare(&lift(1e6), 10, &adapter(), &mut |_, _| {}).unwrap();
    let breached: Vec<_> = comparison.rows.iter().filter(|row| row.breached()).collect();
    assert!(breached.is_empty(), "{breached:?}");
    assert!(comparison.verdict().is_ok());
}
