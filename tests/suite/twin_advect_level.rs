//! `advect_level` against its twin, on the band.

use cutwater::gpu::Recorder;
use cutwater::measure::bounds::level_error;
use cutwater::reference::{self, Ballistic, LevelCells};
use cutwater::stages::advect_level;
use glam::DVec3;

use crate::common::{Random, gpu};
use crate::level_case::{level_buffers, level_cases};
use crate::liquid_case::{Case, EPS, GRAVITY, assert_close};

#[test]
fn the_level_goes_where_it_goes_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let falling = level_cases().into_iter().map(Case::with_ballistic);
    let (mut n_corrected, mut n_compared) = (0, 0);
    for case in level_cases().into_iter().chain(falling) {
        let grid = &case.grid;
        let buffers = case.upload(gpu);
        let level = level_buffers(gpu, &case, &buffers);
        let solver = case.solved(gpu);
        let stage = advect_level(gpu, &buffers, &solver, &level).unwrap();
        // What earlier sub-steps left outside the band must not matter.
        let run = |stale: f32| {
            case.write(gpu, &buffers);
            case.band(gpu, &buffers);
            for array in [&level.next_level, &level.carried_level] {
                gpu.upload(array, &vec![stale; array.len()]);
            }
            let mut recorder = Recorder::new(gpu);
            stage.record(&mut recorder);
            recorder.submit();
            [&level.next_level, &level.carried_level].map(|array| {
                let padded = gpu.download(array).unwrap();
                buffers.padded.unpad(grid.cells, &padded, f64::from)
            })
        };
        let [first, corrected] = run(f32::NAN);
        let again = run(-3.0);
        let in_band = case.in_band(gpu, &buffers);
        let distance = gpu.download(&buffers.liquid_distance).unwrap();
        let before = buffers.padded.unpad(grid.cells, &distance, |phi| f64::from(phi) / grid.dx);
        let (sides, velocity, dt) = (case.sides, &case.state.velocity, case.dt);
        let twins = |of: &Ballistic| {
            [
                reference::carry_level(grid, sides, velocity, of, &before, dt),
                reference::advect_level(grid, sides, velocity, of, &before, dt),
            ]
        };
        let ballistic = case.ballistic();
        let [twin_first, twin] = twins(&ballistic);
        let bounds = level_error(grid, velocity, &before, &twin_first, dt);
        let others: Vec<_> = nearby(&ballistic).iter().map(twins).collect();
        let settled = settled(&case, &in_band);
        let mut places = [Vec::new(), Vec::new()];
        let mut n_unsteady = 0;
        for cell in 0..grid.n_cells() {
            let ijk = grid.cell_at(cell);
            if !in_band(ijk) {
                continue;
            }
            assert_eq!(
                [first[cell], corrected[cell]].map(f64::to_bits),
                [again[0][cell], again[1][cell]].map(f64::to_bits),
                "{}: again at {ijk:?}",
                case.name
            );
            let unsteady = [0, 1].map(|which| {
                let twin = [&twin_first, &twin][which][cell];
                let others = others.iter().map(|other| (other[which][cell] - twin).abs());
                others.sum::<f64>()
            });
            n_unsteady += usize::from(unsteady[1] > bounds[1]);
            let bounds = [0, 1].map(|which| bounds[which] + unsteady[which]);
            places[0].push((first[cell], twin_first[cell], bounds[0], ijk));
            if settled(ijk) {
                n_corrected += usize::from(twin[cell] != twin_first[cell]);
                places[1].push((corrected[cell], twin[cell], bounds[1], ijk));
            }
        }
        let n = places[0].len();
        n_compared += places[1].len();
        let [of_first, of_corrected] = places;
        assert_close(case.name, of_first);
        let place = |&(gpu, twin, bound, ijk): &(f64, f64, f64, [usize; 3])| {
            (gpu, [twin, twin_first[grid.cell(ijk)]], bound, ijk)
        };
        assert_limited(case.name, of_corrected.iter().map(place));
        assert!(50 * n_unsteady <= n, "{}: {n_unsteady} of {n} cells hang on a rounding", case.name);
    }
    assert!(2 * n_corrected > n_compared, "{n_corrected} of {n_compared}");
}

/// Cells at walls and bodies separate, and some others, which must not matter. So does air whose path back enters a body.
#[test]
fn liquid_leaves_walls_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    // Cells of liquid with a bound, away from bodies and beside them, and of air; and how many have one by a rounding.
    let (mut bounded, mut n_unsteady) = ([0; 3], 0);
    for mut case in level_cases() {
        case.effects.separation = true;
        let (grid, dt) = (case.grid, case.dt);
        let mut random = Random(17);
        case.state.separated = (0..grid.n_cells()).map(|_| random.uniform(0.0, 1.0) < 0.6).collect();
        let buffers = case.upload(gpu);
        let level = level_buffers(gpu, &case, &buffers);
        let solver = case.solved(gpu);
        let stage = advect_level(gpu, &buffers, &solver, &level).unwrap();
        let run = |stale: f32| {
            case.write(gpu, &buffers);
            buffers.write_separated(gpu, &case.state);
            case.band(gpu, &buffers);
            gpu.upload(&level.density_next, &vec![[stale; 2]; level.density_next.len()]);
            let mut recorder = Recorder::new(gpu);
            stage.record(&mut recorder);
            recorder.submit();
            let bounds = level.read_separation_bounds(gpu).unwrap().unwrap();
            buffers.padded.unpad(grid.cells, &bounds, f64::from)
        };
        let device = run(f32::NAN);
        let again = run(0.5);
        let in_band = case.in_band(gpu, &buffers);
        let distance = gpu.download(&buffers.liquid_distance).unwrap();
        let before = buffers.padded.unpad(grid.cells, &distance, |phi| f64::from(phi) / grid.dx);
        let cells = LevelCells { grid: &grid, cut: &case.cut };
        let twin = |faces: &_, level: &[f64]| {
            let bodies = (dt, case.effects.leaves_still_bodies());
            reference::separation_bounds(cells, faces, &case.state.separated, level, bodies)
        };
        let by = 16.0 * EPS * case.speed();
        let mut moved = || {
            let faces = case.state.velocity.each_ref().map(|faces| moved_by(&mut random, by, faces));
            twin(&faces, &moved_by(&mut random, 8.0 * EPS, &before))
        };
        let others: Vec<Vec<f64>> = (0..8).map(|_| moved()).collect();
        let twin = twin(&case.state.velocity, &before);
        // The motion is a mean of two velocities times two factors, 6 roundings. Normals are differences of distances, off by two roundings
        // of up to 3 cells over at least a tenth of a cell. The level is sampled along them: a slope of up to 10 cells per cell, and 20
        // roundings of up to 5 cells. Twice that and a product make the gap of up to 6 cells. The end of a path in air is off by the roundings of
        // two samples of up to 3 cells, over a difference of at least a tenth of a cell where the path is not along the body.
        let motion = case.speed() * dt / grid.dx;
        let normal = 60.0 * EPS;
        let bound = (12.0 * EPS + normal) * motion + 12.0 * (100.0 * EPS + 10.0 * normal);
        let mut places = Vec::new();
        for cell in 0..grid.n_cells() {
            let ijk = grid.cell_at(cell);
            if !in_band(ijk) {
                continue;
            }
            assert_eq!(device[cell].to_bits(), again[cell].to_bits(), "{}: again at {ijk:?}", case.name);
            let none = device[cell] < -1e29;
            if none != (twin[cell] == f64::NEG_INFINITY) {
                let unsteady = others.iter().any(|other| none == (other[cell] == f64::NEG_INFINITY));
                assert!(unsteady, "{}: bound at {ijk:?}", case.name);
                n_unsteady += 1;
            } else if !none {
                places.push((device[cell], twin[cell], bound, ijk));
                let of_liquid = usize::from(case.cut.solid_distance[cell] < grid.dx);
                bounded[if before[cell] < 0.0 { of_liquid } else { 2 }] += 1;
            }
        }
        assert_close(case.name, places);
    }
    assert!(bounded.iter().all(|&n| n > 100) && n_unsteady <= 5, "{bounded:?}, {n_unsteady}");
}

fn moved_by(random: &mut Random, by: f64, values: &[f64]) -> Vec<f64> {
    values.iter().map(|value| value + random.uniform(-by, by)).collect()
}

/// What is ballistic for positions that are off by up to 1e-4 cells: they may be on either side of a border.
pub(crate) fn nearby<'a>(ballistic: &Ballistic<'a>) -> Vec<Ballistic<'a>> {
    if ballistic.is_none() {
        return Vec::new();
    }
    let corners = (0..8).map(|corner| DVec3::from([0, 1, 2].map(|axis| f64::from(corner >> axis & 1) - 0.5)));
    corners.map(|offset| ballistic.off_by(2e-4 * offset)).collect()
}

/// Whether a sub-step from or to a cell, or a face with its index, stays in the band. Outside it the first order of a transport is that of air on
/// the device alone.
pub(crate) fn settled(case: &Case, in_band: &dyn Fn([usize; 3]) -> bool) -> impl Fn([usize; 3]) -> bool + use<> {
    let grid = &case.grid;
    let cells = (0..grid.n_cells()).map(|cell| grid.cell_at(cell));
    let outside: Vec<[usize; 3]> = cells.filter(|&ijk| !in_band(ijk)).collect();
    let fall = 0.5 * case.dt * case.dt * DVec3::from(GRAVITY).abs().max_element();
    let reach = ((case.speed() * case.dt + fall) / grid.dx).ceil() as usize + 2;
    move |ijk| {
        let far = |at: &[usize; 3]| (0..3).any(|b| at[b].abs_diff(ijk[b]) > reach);
        outside.iter().all(far)
    }
}

/// [`assert_close`] for limited corrections: (gpu, [twin, twin of first order], bound, place). In few places rounding may decide that one of both
/// stays of first order.
pub(crate) fn assert_limited(what: &str, places: impl IntoIterator<Item = (f64, [f64; 2], f64, [usize; 3])>) {
    let (mut n, mut n_flipped) = (0, 0);
    let mut alike = Vec::new();
    for (gpu, [twin, first], bound, place) in places {
        n += 1;
        let close = |a: f64, b: f64| (a - b).abs() <= bound;
        if !close(gpu, twin) && (close(gpu, first) || close(twin, first)) {
            n_flipped += 1;
        } else {
            alike.push((gpu, twin, bound, place));
        }
    }
    assert_close(what, alike);
    assert!(n_flipped <= 2 + n / 10_000, "{what}: {n_flipped} of {n} decide otherwise");
}
