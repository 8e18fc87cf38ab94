//! `extrapolate` against its twin, over the whole domain: nothing that it reaches lies outside the band.

use cutwater::fields::LiquidBuffers;
use cutwater::geometry::CutCells;
use cutwater::gpu::{Dispatches, Gpu, Recorder};
use cutwater::grid::{Axis, Grid};
use cutwater::reference::{MovingWalls, extrapolate_with_slope, liquid_distance, n_layers};
use cutwater::stages;
use glam::DVec3;

use crate::common::gpu;
use crate::coupled_case;
use crate::level_case::level_cases;
use crate::liquid_case::{Case, EPS, RADIUS, assert_close, cases};

#[test]
fn the_layers_are_the_twins() {
    let Some(gpu) = gpu() else { return };
    let mut n_sloping = 0;
    for case in cases().into_iter().chain(level_cases()) {
        let buffers = case.upload(gpu);
        let stage = stages::extrapolate(gpu, &buffers, None).unwrap();
        n_sloping += assert_layers(gpu, &case, &buffers, &stage, None)[1];
    }
    assert!(n_sloping > 1000, "{n_sloping}");
}

/// Free slip along obstacles, and along solids as they move, also where they lie in each other or in walls.
#[test]
fn slip_along_solids_is_the_twins() {
    let Some(gpu) = gpu() else { return };
    let with_slope = coupled_case::cases().into_iter().map(|mut case| {
        case.liquid.effects.maccormack = true;
        case
    });
    for case in coupled_case::cases().into_iter().chain(with_slope) {
        let (buffers, clip, velocity) = case.upload(gpu);
        let stage = stages::extrapolate(gpu, &buffers, Some((&clip, Some(&velocity)))).unwrap();
        let cut = stages::clip(gpu, &buffers, &clip).unwrap();
        let mut recorder = Recorder::new(gpu);
        cut.record(&mut recorder);
        recorder.submit();
        let walls = MovingWalls { clip: &case.clip, triangles: &case.solids.triangles, velocity: &case.velocity };
        let [n_slipping, _] = assert_layers(gpu, &case.liquid, &buffers, &stage, Some(walls));
        let near = case.clip.coupling().pairs().len();
        assert!(n_slipping > 0 && (near > 0 || case.liquid.name == "far away"));
    }
}

/// Runs the stage and its twin. How many faces the twin has slip, and on how many the slope of the liquid shows.
fn assert_layers(
    gpu: &Gpu,
    case: &Case,
    buffers: &LiquidBuffers,
    stage: &Dispatches,
    walls: Option<MovingWalls>,
) -> [usize; 2] {
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
    let run = || {
        case.write(gpu, buffers);
        case.band(gpu, buffers);
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
        stage.record(&mut recorder);
        recorder.submit();
        buffers.read_faces(gpu, &buffers.velocity).unwrap()
    };
    let faces = run();
    assert_eq!(faces, run(), "{}: again", case.name);
    let layers = n_layers(case.cfl);
    let largest = match case.effects.maccormack {
        true => 0.5 * grid.dx / case.dt,
        false => 0.0,
    };
    let extended = |cut: &CutCells, walls: Option<MovingWalls>, largest: f64| {
        let (mut faces, valid) = (projected.clone(), valid.clone());
        extrapolate_with_slope(grid, cut, walls, valid, (layers, largest), &mut faces);
        faces
    };
    let twin = extended(&case.cut, walls, largest);
    let flat = extended(&case.cut, walls, 0.0);
    // The same where nothing is near enough to slip.
    let mut far = case.cut.clone();
    far.solid_distance.fill(3.0 * grid.dx);
    let unslipped = extended(&far, None, largest);
    let of_walls = walls.map_or(0.0, |walls| {
        let components = walls.velocity.as_flattened().iter();
        components.fold(0.0, |fastest, v| f64::max(fastest, v.abs()))
    });
    // A slope adds a difference of two values up to the speed.
    let steps = largest.min(2.0 * case.speed());
    let fastest = case.speed() + steps;
    let (mut n_slipping, mut n_sloping) = (0, 0);
    for axis in Axis::ALL {
        let a = axis.index();
        let pairs = (0..grid.n_faces(axis)).map(|face| {
            let ijk = grid.face_at(axis, face);
            // What slivers show is a quotient of two sums of up to 26 products, and a part of it: 64 roundings in all. A mean of up to
            // twelve per layer. Along bodies the velocity of a wall is a mean of two sums of three, and the direction
            // is off by the roundings of distances up to 3 dx over the length of their gradient.
            // A slope has the roundings of two values and of their difference, the largest one four; it has a mean of its own.
            let mut bound = EPS * (64.0 * case.speed() + 13.0 * layers as f64 * fastest);
            if largest > 0.0 {
                bound += EPS * (2.0 * 64.0 * case.speed() + 14.0 * fastest + 4.0 * steps);
                n_sloping += usize::from(twin[a][face] != flat[a][face]);
            }
            if twin[a][face] != unslipped[a][face] {
                n_slipping += 1;
                let steepness = steepness(grid, &case.cut, grid.face_centre(axis, ijk));
                bound += EPS * (fastest + of_walls) * (16.0 + 4.0 * 3.0 / steepness);
            }
            (faces[a][face], twin[a][face], bound, ijk)
        });
        assert_close(case.name, pairs.collect::<Vec<_>>());
    }
    [n_slipping, n_sloping]
}

/// Length of the gradient of the distance by central differences.
fn steepness(grid: &Grid, cut: &CutCells, x: DVec3) -> f64 {
    let slope = |b: usize| {
        let half = DVec3::AXES[b] * (0.5 * grid.dx);
        let [plus, minus] = [x + half, x - half].map(|x| grid.sample_cells(&cut.solid_distance, x));
        (plus - minus) / grid.dx
    };
    DVec3::from([0, 1, 2].map(slope)).length()
}
