//! `advect_velocity` against its twin.

use cutwater::gpu::Recorder;
use cutwater::grid::Axis;
use cutwater::measure::bounds::{advection_error, open_to_advection};
use cutwater::reference::{self, Ballistic};
use cutwater::stages::advect_velocity;

use glam::DVec3;

use crate::common::gpu;
use crate::liquid_case::{Case, assert_close, cases};

#[test]
fn faces_carry_what_they_carry_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let falling = cases().into_iter().map(Case::with_ballistic);
    for mut case in cases().into_iter().chain(falling) {
        // Slivers are fast.
        let faces = case.state.velocity.iter_mut().zip(&case.cut.open);
        for (value, &open) in faces.flat_map(|(values, open)| values.iter_mut().zip(open)) {
            if reference::is_sliver(open) {
                *value *= 4.0;
            }
        }
        let buffers = case.upload(gpu);
        let solver = case.solved(gpu);
        let stage = advect_velocity(gpu, &buffers, &solver).unwrap();
        let run = || {
            // Slivers put on what they show.
            case.write(gpu, &buffers);
            case.band(gpu, &buffers);
            let mut recorder = Recorder::new(gpu);
            stage.record(&mut recorder);
            recorder.submit();
            let in_band = case.in_band(gpu, &buffers);
            (
                buffers.read_faces(gpu, &buffers.velocity_next).unwrap(),
                in_band,
            )
        };
        let (faces, in_band) = run();
        let (grid, velocity) = (&case.grid, &case.state.velocity);
        let known = |axis: Axis, face: usize| in_band(grid.face_at(axis, face));
        let open = &open_to_advection(&case.cut.open, known);
        let ballistic = case.ballistic();
        let carried =
            |of: &Ballistic| reference::advect_velocity(&case.grid, open, velocity, of, case.dt);
        let twin = carried(&ballistic);
        let bound = advection_error(&case.grid, open, velocity, case.dt);
        // Departure points, off by up to 1e-4 cells, may be on either side of a border of what is ballistic.
        let corners = (0..8)
            .map(|corner| DVec3::from([0, 1, 2].map(|axis| f64::from(corner >> axis & 1) - 0.5)));
        let others: Vec<_> = match ballistic.is_none() {
            true => Vec::new(),
            false => corners
                .map(|offset| carried(&ballistic.off_by(2e-4 * offset)))
                .collect(),
        };
        let (mut n, mut n_unsteady) = (0, 0);
        for axis in Axis::ALL {
            let pairs = faces[axis.index()].iter().zip(&twin[axis.index()]);
            let places = pairs.enumerate().map(|(face, (&gpu, &twin))| {
                let others = others.iter().map(|other| other[axis.index()][face] - twin);
                let unsteady = others.fold(0.0, |most, off| f64::max(most, off.abs()));
                n += 1;
                n_unsteady += u64::from(unsteady > bound);
                (gpu, twin, bound + unsteady, case.grid.face_at(axis, face))
            });
            assert_close(case.name, places.filter(|&(_, _, _, ijk)| in_band(ijk)));
        }
        assert!(
            50 * n_unsteady <= n,
            "{}: {n_unsteady} of {n} faces hang on a rounding",
            case.name
        );
        assert_eq!(faces, run().0, "{}: again", case.name);
    }
}

#[test]
fn still_air_keeps_its_bits() {
    let Some(gpu) = gpu() else { return };
    let mut case = cases().remove(0);
    for values in &mut case.state.velocity {
        values.fill(0.0);
    }
    let buffers = case.upload(gpu);
    case.band(gpu, &buffers);
    gpu.upload(&buffers.velocity_next, &vec![1.0; 3 * buffers.padded.len()]);
    let solver = case.solved(gpu);
    let stage = advect_velocity(gpu, &buffers, &solver).unwrap();
    let mut recorder = Recorder::new(gpu);
    stage.record(&mut recorder);
    recorder.submit();
    let flags = gpu.download(&buffers.band_flags).unwrap();
    let faces = gpu.download(&buffers.velocity_next).unwrap();
    for (index, &value) in faces.iter().enumerate() {
        let in_band = flags[index / 4 % buffers.padded.quads] != 0;
        assert_eq!(value, f32::from(!in_band), "word {index}");
    }
}
