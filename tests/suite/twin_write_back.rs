//! `write_back` against its twin.

use cutwater::gpu::{Real, Recorder};
use cutwater::grid::Axis;
use cutwater::reference::{self, PressureSystem, liquid_distance, right_hand_side};
use cutwater::stages::{FreeSurface, write_back};

use crate::common::{Random, gpu};
use crate::liquid_case::{ActiveBuffers, DENSITY, EPS, RADIUS, assert_close, cases, single, single_floor};

#[test]
fn the_projected_velocity_is_the_twins() {
    let Some(gpu) = gpu() else { return };
    let reals = if gpu.has_f64() { &[Real::F32, Real::F64][..] } else { &[Real::F32] };
    for case in cases() {
        let grid = &case.grid;
        let (radius, markers) = (RADIUS * grid.dx, &case.state.markers);
        let phi: Vec<f64> = liquid_distance(grid, &case.cut, markers, radius).into_iter().map(single).collect();
        let active = ActiveBuffers::new(&case, &phi);
        let mut random = Random(3);
        // Also in inactive cells, where it must not count.
        let potential: Vec<f64> = (0..grid.n_cells()).map(|_| single(random.uniform(-0.2, 0.2))).collect();
        let (open, u) = (&case.cut.open, &case.state.velocity);
        let rhs = right_hand_side(grid, open, u, &active.cells, None);
        let system = PressureSystem::new(active.cells.clone(), rhs, case.dt, DENSITY);
        // The twin expects zeros there.
        let pressure: Vec<f64> = (0..grid.n_cells())
            .map(|cell| {
                let counts = f64::from(u8::from(active.cells.stencil.active(cell)));
                counts * potential[cell] * DENSITY * grid.dx / case.dt
            })
            .collect();
        let mut twin = u.clone();
        let floor = single_floor();
        let free_surface = FreeSurface { theta_floor: floor, open_sides: case.sides.any() };
        let valid = reference::write_back(&system, &pressure, open, &phi, floor, &mut twin);
        for &real in reals {
            let buffers = case.upload(gpu);
            let solver = active.solver(gpu, real);
            let stage = write_back(gpu, &buffers, &solver, free_surface).unwrap();
            let run = || {
                case.write(gpu, &buffers);
                case.band(gpu, &buffers);
                gpu.upload(&buffers.velocity_next, &buffers.pad_faces(u));
                let distance = buffers.padded.pad(grid.cells, &phi, |phi| phi as f32);
                gpu.upload(&buffers.liquid_distance, &distance);
                solver.potential.upload(gpu, &buffers.padded.pad(grid.cells, &potential, |phi| phi));
                let mut recorder = Recorder::new(gpu);
                stage.record(&mut recorder);
                recorder.submit();
                let words = gpu.download(&buffers.valid).unwrap();
                (buffers.read_faces(gpu, &buffers.velocity).unwrap(), words)
            };
            let (faces, words) = run();
            assert_eq!((faces.clone(), words.clone()), run(), "{}: again", case.name);
            for axis in Axis::ALL {
                let a = axis.index();
                let checked = (0..grid.n_faces(axis)).map(|face| {
                    let ijk = grid.face_at(axis, face);
                    let index = grid.padded().index(ijk);
                    let bit = words[index / 4] >> (4 * a + index % 4) & 1;
                    assert_eq!(bit == 1, valid[a][face], "{}: valid {axis:?} {ijk:?}", case.name);
                    let twin = if valid[a][face] { twin[a][face] } else { 0.0 };
                    // theta is off by 3 roundings, its quotient and the two differences by one each.
                    let bound = EPS * (5.0 * (twin - u[a][face]).abs() + 2.0 * twin.abs() + 1.0);
                    (faces[a][face], twin, bound, ijk)
                });
                assert_close(case.name, checked);
            }
        }
    }
}
