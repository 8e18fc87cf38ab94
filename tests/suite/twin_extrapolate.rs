//! `extrapolate` against its twin, over the whole domain: nothing that it reaches lies outside the band.

use cutwater::gpu::Recorder;
use cutwater::grid::Axis;
use cutwater::reference::{self, liquid_distance, n_layers};
use cutwater::stages::Extrapolate;

use crate::common::gpu;
use crate::liquid_case::{EPS, RADIUS, assert_close, cases};

#[test]
fn the_layers_are_the_twins() {
    let Some(gpu) = gpu() else { return };
    for case in cases() {
        let grid = &case.grid;
        let (radius, markers) = (RADIUS * grid.dx, &case.state.markers);
        let phi = liquid_distance(grid, &case.cut, markers, radius);
        // As after a projection: open faces with liquid on one side.
        let valid = Axis::ALL.map(|axis| -> Vec<bool> {
            let open = &case.cut.open[axis.index()];
            (0..grid.n_faces(axis))
                .map(|face| {
                    let sides = grid.face_sides(axis, grid.face_at(axis, face));
                    open[face] > 0.0 && sides.into_iter().flatten().any(|cell| phi[cell] < 0.0)
                })
                .collect()
        });
        let mut projected = case.state.velocity.clone();
        for (values, valid) in projected.iter_mut().zip(&valid) {
            for (value, _) in values.iter_mut().zip(valid).filter(|(_, valid)| !**valid) {
                *value = 0.0;
            }
        }
        let buffers = case.upload(gpu);
        let stage = Extrapolate::new(gpu, &buffers, None).unwrap();
        let run = || {
            case.write(gpu, &buffers);
            case.band(gpu, &buffers);
            gpu.upload(&buffers.velocity, &buffers.pad_faces(&projected));
            let mut words = gpu.download(&buffers.valid).unwrap();
            for axis in Axis::ALL {
                let a = axis.index();
                for face in (0..grid.n_faces(axis)).filter(|&face| valid[a][face]) {
                    let index = buffers.padded.index(grid.face_at(axis, face));
                    words[index / 4] |= 1 << (4 * a + index % 4);
                }
            }
            gpu.upload(&buffers.valid, &words);
            let mut recorder = Recorder::new(gpu);
            stage.record(&mut recorder, &buffers);
            recorder.submit();
            buffers.read_faces(gpu, &buffers.velocity).unwrap()
        };
        let faces = run();
        assert_eq!(faces, run(), "{}: again", case.name);
        let mut twin = projected.clone();
        let layers = n_layers(case.cfl);
        reference::extrapolate(grid, &case.cut, None, valid, layers, &mut twin);
        // A mean of up to twelve per layer. Along obstacles the direction is off by the roundings of distances up to 3 dx over
        // the length of the gradient, which is at least 0.05 where it is not 0.
        let slip = if case.effects.obstacles {
            4.0 * 3.0 / 0.05
        } else {
            0.0
        };
        let bound = EPS * case.speed() * (13.0 * layers as f64 + slip);
        for axis in Axis::ALL {
            let a = axis.index();
            assert_close(
                case.name,
                (0..grid.n_faces(axis)).map(|face| {
                    (
                        faces[a][face],
                        twin[a][face],
                        bound,
                        grid.face_at(axis, face),
                    )
                }),
            );
        }
    }
}
