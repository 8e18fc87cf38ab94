//! `forces` of the nodes against its equation.

use cutwater::gpu::Recorder;
use cutwater::stages::NodeForces;

use crate::common::gpu;
use crate::liquid_case::{GRAVITY, assert_close};
use crate::solid_case::{SolidCase, cases, eps};

#[test]
fn free_nodes_fall_and_prescribed_ones_obey() {
    let Some(gpu) = gpu() else { return };
    for case in cases() {
        for real in SolidCase::reals(gpu) {
            let buffers = case.upload(gpu, real);
            let stage = NodeForces::new(gpu, &buffers).unwrap();
            let mut recorder = Recorder::new(gpu);
            stage.record(&mut recorder);
            recorder.submit();
            let mut state = case.state();
            buffers.read_state(gpu, &mut state).unwrap();
            assert_eq!(state.displacement, case.displacement, "{}", case.name);
            // One product and one sum.
            let bound = eps(real) * (2.0 * case.dt * 9.75 + case.speed());
            let places = (0..state.node_velocity.len()).flat_map(|n| [0, 1, 2].map(|a| [n, a, 0]));
            assert_close(
                case.name,
                places.map(|place @ [node, axis, _]| {
                    let (twin, bound) = if !case.solids.prescribed[node][axis] {
                        (case.velocity[node][axis] + case.dt * GRAVITY[axis], bound)
                    } else {
                        (case.scripted.get(node).map_or(0.0, |v| v[axis]), 0.0)
                    };
                    (state.node_velocity[node][axis], twin, bound, place)
                }),
            );
        }
    }
}
