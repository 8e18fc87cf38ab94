//! Probes of solids: reactions of pins and scripts against the balance of momentum, velocities, and means over nodes.

use cutwater::scene::Scene;
use cutwater::sim::{Backend, Simulation};
use glam::DVec3;

use crate::common::{adapter, gpu, scene_from};

const GRAVITY: DVec3 = DVec3::new(0.0, -9.81, 0.5);

/// A beam whose two ends are pinned and moved, with a load between them, and no walls near; in liquid or not.
fn scene(liquid: bool) -> Scene {
    let liquid = match liquid {
        true => "[[liquid.region]]\nbox = { min = [0, 0, 0], max = [1, 0.5, 0.5] }\n",
        false => "",
    };
    let text = format!(
        "[domain]
size = [1, 1, 0.5]
cells = [16, 16, 8]
gravity = [0, -9.81, 0.5]
[time]
duration = 1
fixed_step = 0.005
frames_per_second = 50
{liquid}[solver]
tolerance = 1e-10
[[solid]]
name = \"beam\"
mesh = {{ box = {{ size = [0.6, 0.1, 0.1], cells = [6, 1, 1] }} }}
placement = {{ translate = [0.5, 0.45, 0.25] }}
density = 1100
young = 1e6
poisson = 0.3
damping = {{ mass = 0.7, stiffness = 0.003 }}
[[solid.pin]]
region = {{ box = {{ min = [0, 0, 0], max = [0.21, 1, 1] }} }}
[[solid.script]]
region = {{ box = {{ min = [0.79, 0, 0], max = [1, 1, 1] }} }}
components = \"xy\"
keyframes = [{{ t = 0 }}, {{ t = 1, translate = [0, 0.2, 0], rotate = {{ axis = [0, 0, 1], degrees = 60 }} }}]
[[solid.load]]
region = {{ box = {{ min = [0.4, 0, 0], max = [1, 1, 1] }} }}
force = [1, -2, 3]
[[probe]]
name = \"all\"
reaction = {{ solid = \"beam\" }}
[[probe]]
name = \"pin\"
reaction = {{ solid = \"beam\", region = {{ box = {{ min = [0, 0, 0], max = [0.3, 1, 1] }} }} }}
[[probe]]
name = \"script\"
reaction = {{ solid = \"beam\", region = {{ box = {{ min = [0.7, 0, 0], max = [1, 1, 1] }} }} }}
[[probe]]
name = \"centre\"
solid_velocity = {{ name = \"beam\" }}
[[probe]]
name = \"mean\"
node = {{ solid = \"beam\", region = {{ box = {{ min = [0.7, 0, 0], max = [1, 1, 1] }} }} }}
[[probe]]
name = \"mean_velocity\"
node_velocity = {{ solid = \"beam\", region = {{ box = {{ min = [0.7, 0, 0], max = [1, 1, 1] }} }} }}
[[probe]]
name = \"corner\"
node_velocity = {{ solid = \"beam\", rest_point = [0.5, 0.5, 0.3] }}
"
    );
    scene_from(&text, &[])
}

/// The forces of pins and scripts close the balance of momentum of a beam in each sub-step, on both paths, in air and in liquid, and those of
/// the two ends add up to them.
#[test]
fn reactions_close_the_balance_of_momentum() {
    for liquid in [false, true] {
        let scene = scene(liquid);
        let mut ends = Vec::new();
        for backend in [Backend::Cpu, Backend::Gpu(adapter())] {
            if matches!(backend, Backend::Gpu(_)) && gpu().is_none() {
                continue;
            }
            let mut simulation = Simulation::new(&scene, &backend).unwrap();
            let mass: f64 = simulation.solids().mass.iter().sum();
            let load: DVec3 = simulation.solids().load.iter().sum();
            let start = simulation.state().unwrap();
            let nodes = simulation.solids().mass.iter().zip(&start.node_velocity);
            let mut before: DVec3 = nodes.map(|(mass, v)| *mass * DVec3::from(*v)).sum();
            for step in 0..12 {
                let report = simulation.step().unwrap();
                let solid = report.solid.unwrap();
                let momentum = DVec3::from(solid.diagnosis.momentum);
                let force = report
                    .coupling
                    .map_or(DVec3::ZERO, |coupling| DVec3::from(coupling.force) + DVec3::from(coupling.correction));
                let values = simulation.probes().unwrap();
                let [all, pin, script, centre, mean, mean_velocity, corner] =
                    std::array::from_fn(|probe| DVec3::from_slice(&values[3 * probe..]));
                let scale = all.length() + pin.length() + script.length() + mass * 9.81;
                assert!((pin + script).distance(all) <= 1e-12 * scale, "step {step}");
                // The scripted nodes have their first velocity before the first sub-step.
                if step > 0 {
                    let balance = (momentum - before) / report.dt + 0.7 * momentum - mass * GRAVITY - load - force;
                    // The residual of the solve is 1e-10 of forces like m v / dt, which are up to 1e3 of these; single precision of
                    // velocities and of the report is 1e-7 of the same.
                    let off = all.distance(balance);
                    assert!(off <= 1e-3 * scale, "liquid {liquid}, {backend:?}, step {step}: {all} of {balance} N");
                }
                before = momentum;
                let off = (mass * centre).distance(momentum);
                assert!(off <= 1e-5 * momentum.length(), "{centre} m/s, {momentum} kg m/s");
                let state = simulation.state().unwrap();
                let rest = &simulation.solids().rest;
                let inside: Vec<usize> = (0..rest.len()).filter(|&node| rest[node].x >= 0.7).collect();
                let of = |values: &[[f64; 3]]| {
                    let sum: DVec3 = inside.iter().map(|&node| DVec3::from(values[node])).sum();
                    sum / inside.len() as f64
                };
                assert!(mean.distance(of(&state.displacement)) < 1e-12);
                assert!(mean_velocity.distance(of(&state.node_velocity)) < 1e-12);
                let middle = simulation.solids().nearest_node(0, DVec3::new(0.5, 0.5, 0.3));
                assert_eq!(corner.to_array(), state.node_velocity[middle]);
                ends.push(all);
            }
        }
        if ends.len() == 24 {
            let (host, device) = ends.split_at(12);
            for (host, device) in host.iter().zip(device) {
                let off = host.distance(*device);
                assert!(off <= 1e-3 * host.length(), "{host} and {device} N");
            }
        }
    }
}

#[test]
fn reactions_need_constrained_nodes() {
    let mut free = scene(false);
    free.solids[0].pins.clear();
    let error = Simulation::new(&free, &Backend::Cpu).unwrap_err().to_string();
    for part in ["probe[0].reaction", "no pinned or scripted node", "[[solid.pin]]"] {
        assert!(error.contains(part), "{error}");
    }
}
