//! `forces` against its twin.

use cutwater::gpu::Recorder;
use cutwater::grid::Axis;
use cutwater::reference;
use cutwater::stages::forces;
use glam::DVec3;

use crate::common::gpu;
use crate::liquid_case::{EPS, GRAVITY, assert_close, cases};

#[test]
fn gravity_is_added_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    for case in cases() {
        let buffers = case.upload(gpu);
        case.band(gpu, &buffers);
        gpu.upload(&buffers.velocity_next, &buffers.pad_faces(&case.state.velocity));
        let stage = forces(gpu, &buffers).unwrap();
        let mut recorder = Recorder::new(gpu);
        stage.record(&mut recorder);
        recorder.submit();
        let in_band = case.in_band(gpu, &buffers);
        let faces = buffers.read_faces(gpu, &buffers.velocity_next).unwrap();
        let mut twin = case.state.velocity.clone();
        reference::forces(&mut twin, DVec3::from(GRAVITY), case.dt);
        // One product and one sum.
        let bound = EPS * (2.0 * case.dt * 9.75 + case.speed());
        for axis in Axis::ALL {
            let a = axis.index();
            assert_close(
                case.name,
                faces[a].iter().enumerate().map(|(face, &gpu)| {
                    let ijk = case.grid.face_at(axis, face);
                    let twin = if in_band(ijk) { twin[a][face] } else { case.state.velocity[a][face] };
                    (gpu, twin, bound, ijk)
                }),
            );
        }
        // Nothing but faces: spare lanes stay 0, or samples beyond the walls would see them.
        let padded = gpu.download(&buffers.velocity_next).unwrap();
        assert_eq!(padded, buffers.pad_faces(&faces), "{}: spare lanes", case.name);
    }
}
