//! `advect_velocity` against its twin.

use cutwater::gpu::{Gpu, Recorder};
use cutwater::grid::Axis;
use cutwater::measure::bounds::{advection_error, maccormack_error, open_to_advection};
use cutwater::reference::{self, Ballistic};
use cutwater::stages::advect_velocity;

use crate::common::gpu;
use crate::level_case::{level_buffers, level_cases};
use crate::liquid_case::{Case, assert_close, cases};
use crate::twin_advect_level::{assert_limited, nearby, settled};

#[test]
fn faces_carry_what_they_carry_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let falling = cases().into_iter().map(Case::with_ballistic);
    for case in cases().into_iter().chain(falling) {
        assert_carried(gpu, case, 0.0);
    }
}

#[test]
fn faces_are_corrected_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let falling = level_cases().into_iter().map(Case::with_ballistic);
    let cases = level_cases().into_iter().chain(falling);
    // Relaxed limits, strict ones, and between.
    let courants = [1.5, 4.0, 2.0].into_iter().cycle();
    let counts = cases.zip(courants).map(|(case, courant)| assert_carried(gpu, case, courant));
    let [corrected, n] = counts.fold([0, 0], |sums, more| [0, 1].map(|n| sums[n] + more[n]));
    assert!(4 * corrected > n, "{corrected} of {n}");
}

/// Runs the stage and its twin. How many faces are corrected, and how many are compared.
fn assert_carried(gpu: &Gpu, mut case: Case, courant: f64) -> [usize; 2] {
    // Slivers are fast.
    let faces = case.state.velocity.iter_mut().zip(&case.cut.open);
    for (value, &open) in faces.flat_map(|(values, open)| values.iter_mut().zip(open)) {
        if reference::is_sliver(open) {
            *value *= 4.0;
        }
    }
    let buffers = case.upload(gpu);
    let solver = case.solved(gpu);
    let level = case.effects.level.then(|| level_buffers(gpu, &case, &buffers));
    let stage = advect_velocity(gpu, &buffers, &solver, level.as_ref(), None).unwrap();
    let read = |faces| buffers.read_faces(gpu, faces).unwrap();
    // What earlier sub-steps left in scratch memory must not matter.
    let run = |stale: f32| {
        // Slivers put on what they show.
        case.write(gpu, &buffers);
        case.band(gpu, &buffers);
        if let Some(level) = &level {
            let scratch = [&level.carried_velocity].into_iter().chain(&level.sliver_velocity);
            for array in scratch {
                gpu.upload(array, &vec![stale; array.len()]);
            }
            level.write_step(gpu, [0; 2], courant, 0.0);
        }
        let mut recorder = Recorder::new(gpu);
        stage.record(&mut recorder);
        recorder.submit();
        let in_band = case.in_band(gpu, &buffers);
        (read(&buffers.velocity_next), in_band)
    };
    let (faces, in_band) = run(f32::NAN);
    let (grid, velocity) = (&case.grid, &case.state.velocity);
    let known = |axis: Axis, face: usize| in_band(grid.face_at(axis, face));
    let open = &open_to_advection(&case.cut.open, known);
    let ballistic = case.ballistic();
    let limited =
        |of: &Ballistic, courant| reference::advect_velocity_maccormack(grid, open, velocity, of, [case.dt, courant]);
    let carried = |of: &Ballistic| match level {
        Some(_) => limited(of, courant),
        None => reference::advect_velocity(grid, open, velocity, of, case.dt),
    };
    let shown = reference::shown_to_whole(grid, open, velocity);
    // Full apertures: all faces carry blended velocities.
    let full = Axis::ALL.map(|axis| vec![1.0; grid.n_faces(axis)]);
    let first = |of: &Ballistic| reference::advect_velocity(grid, &full, &shown, of, case.dt);
    let (twin, twin_first) = (carried(&ballistic), first(&ballistic));
    let (relaxed, relaxation) = (limited(&ballistic, 0.0), (2.0 - courant / 1.5).clamp(0.0, 1.0));
    let first_bound = advection_error(grid, open, (velocity, 0.0), case.dt);
    let bound = match level {
        Some(_) => maccormack_error(grid, open, (velocity, 0.0), &twin_first, case.dt),
        None => first_bound,
    };
    // Departure points, off by up to 1e-4 cells, may be on either side of a border of what is ballistic.
    let nearby = nearby(&ballistic);
    let others: Vec<_> = nearby.iter().map(carried).collect();
    let others_first: Vec<_> = nearby.iter().map(first).collect();
    let settled = settled(&case, &in_band);
    let on_device = level.as_ref().map(|level| read(&level.carried_velocity));
    let (mut n, mut n_unsteady, mut n_compared, mut n_corrected) = (0, 0, 0, 0);
    for axis in Axis::ALL {
        let a = axis.index();
        let unsteady = |others: &[[Vec<f64>; 3]], twin: &[Vec<f64>; 3], face: usize| {
            let others = others.iter().map(|other| other[a][face] - twin[a][face]);
            match level {
                // A correction reads several faces that may each be off otherwise.
                Some(_) => others.fold(0.0, |sum, off| sum + off.abs()),
                None => others.fold(0.0, |most, off| f64::max(most, off.abs())),
            }
        };
        let mut places = Vec::new();
        for face in 0..grid.n_faces(axis) {
            let ijk = grid.face_at(axis, face);
            let off = unsteady(&others, &twin, face);
            n += 1;
            n_unsteady += u64::from(off > bound);
            if !in_band(ijk) {
                continue;
            }
            assert!(faces[a][face].is_finite(), "{}: {ijk:?}", case.name);
            if level.is_none() || settled(ijk) {
                let twin = twin[a][face];
                // What the limit would leave if it decided otherwise.
                let (first, relaxed) = (twin_first[a][face], relaxed[a][face]);
                let blend = (1.0 - relaxation) * first + relaxation * relaxed;
                let other = if twin == relaxed { blend } else { relaxed };
                n_compared += 1;
                n_corrected += usize::from(twin != first);
                places.push((faces[a][face], [twin, other], bound + off, ijk));
            }
        }
        match &on_device {
            Some(first) => {
                if relaxation == 1.0 {
                    assert_close(case.name, places.iter().map(|&(gpu, [twin, _], bound, ijk)| (gpu, twin, bound, ijk)));
                } else {
                    assert_limited(case.name, places);
                }
                let carried = (0..grid.n_faces(axis)).map(|face| {
                    let off = unsteady(&others_first, &twin_first, face);
                    let ijk = grid.face_at(axis, face);
                    (first[a][face], twin_first[a][face], first_bound + off, ijk)
                });
                assert_close(case.name, carried.filter(|&(_, _, _, ijk)| in_band(ijk)));
            }
            None => assert_close(case.name, places.iter().map(|&(gpu, [twin, _], bound, ijk)| (gpu, twin, bound, ijk))),
        }
    }
    assert!(50 * n_unsteady <= n, "{}: {n_unsteady} of {n} faces hang on a rounding", case.name);
    let left = read(&buffers.velocity);
    let blended = Axis::ALL.into_iter().flat_map(|axis| {
        let values = left[axis.index()].iter().zip(&shown[axis.index()]);
        values.enumerate().map(move |(face, (&gpu, &twin))| (gpu, twin, first_bound, grid.face_at(axis, face)))
    });
    assert_close(case.name, blended);
    let (again, _) = run(-3.0);
    for axis in Axis::ALL {
        for (face, values) in faces[axis.index()].iter().zip(&again[axis.index()]).enumerate() {
            let ijk = grid.face_at(axis, face);
            assert!(values.0 == values.1 || !in_band(ijk), "{}: again at {ijk:?}", case.name);
        }
    }
    [n_corrected, n_compared]
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
    let stage = advect_velocity(gpu, &buffers, &solver, None, None).unwrap();
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
