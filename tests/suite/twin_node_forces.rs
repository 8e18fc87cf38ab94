//! `forces` of the nodes against its twin.

use cutwater::gpu::Recorder;
use cutwater::reference;
use cutwater::stages::node_forces;
use glam::DVec3;

use crate::common::gpu;
use crate::liquid_case::{GRAVITY, assert_close};
use crate::solid_case::{SolidCase, cases, eps};

#[test]
fn free_nodes_fall_and_prescribed_ones_obey() {
    let Some(gpu) = gpu() else { return };
    for case in cases() {
        for real in SolidCase::reals(gpu) {
            let buffers = case.upload(gpu, real);
            let stage = node_forces(gpu, &buffers).unwrap();
            let mut recorder = Recorder::new(gpu);
            stage.record(&mut recorder);
            recorder.submit();
            let mut state = case.state();
            buffers.read_state(gpu, &mut state).unwrap();
            assert_eq!(state.displacement, case.displacement, "{}", case.name);
            let (solids, gravity) = (&case.solids, DVec3::from(GRAVITY));
            let mut twin = case.velocity.clone();
            reference::node_forces(solids, &case.scripted, gravity, case.dt, &mut twin);
            // One product and one sum.
            let bound = eps(real) * (2.0 * case.dt * 9.75 + case.speed());
            let places = (0..twin.len()).flat_map(|node| [0, 1, 2].map(|axis| [node, axis]));
            assert_close(
                case.name,
                places.map(|[node, axis]| {
                    let free = !solids.prescribed[node][axis];
                    let found = state.node_velocity[node][axis];
                    let bound = if free { bound } else { 0.0 };
                    (found, twin[node][axis], bound, [node, axis, usize::from(free)])
                }),
            );
        }
    }
}
