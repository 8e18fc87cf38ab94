//! The stages of a level's markers against their twins: `advect_markers`, `band`, `marker_band`, `spray`.

use cutwater::fields::{LevelBuffers, LiquidBuffers, LiquidPlan, Report, Tiles};
use cutwater::gpu::{Gpu, Real, Recorder};
use cutwater::grid::Axis;
use cutwater::measure::bounds::MarkerError;
use cutwater::reference::{self, Levels, Lost, Markers, Surface};
use cutwater::stages;
use cutwater::state::State;
use glam::DVec3;

use crate::common::{Random, far_below, gpu};
use crate::level_case::{level_cases, level_of};
use crate::liquid_case::{Case, EPS, GRAVITY, assert_close, single};

/// Words of `marker_counts`.
const FLYING: usize = 0;
const LOST_SPRAY: usize = 1;

/// Seed and number of the sub-step in all tests.
const NUMBERS: [u32; 2] = [0x1234_5678, 41];

/// The device's arrays with room for `more` markers, in the state of the case.
fn upload(gpu: &Gpu, case: &Case, more: usize) -> (LiquidBuffers, LevelBuffers) {
    let plan = LiquidPlan {
        grid: case.grid,
        effects: case.effects,
        n_markers: case.state.markers.len() + more,
        cfl: case.cfl,
        real: if gpu.has_f64() { Real::F64 } else { Real::F32 },
    };
    let liquid = LiquidBuffers::new(gpu, plan).unwrap();
    let level = LevelBuffers::new(gpu, plan).unwrap().unwrap();
    write(gpu, case, &liquid, &level);
    (liquid, level)
}

fn write(gpu: &Gpu, case: &Case, liquid: &LiquidBuffers, level: &LevelBuffers) {
    case.write(gpu, liquid);
    level.write_markers(gpu, &case.state);
    level.write_step(gpu, NUMBERS, 1.0, 0.0);
}

fn record(gpu: &Gpu, stage: &cutwater::gpu::Dispatches) {
    let mut recorder = Recorder::new(gpu);
    stage.record(&mut recorder);
    recorder.submit();
}

fn bits(words: &[[f32; 4]]) -> Vec<[u32; 4]> {
    words.iter().map(|word| word.map(f32::to_bits)).collect()
}

fn xyz(word: [f32; 4]) -> [f64; 3] {
    [word[0], word[1], word[2]].map(f64::from)
}

/// Positions and velocities on the device, each with its fourth component.
fn markers_of(gpu: &Gpu, liquid: &LiquidBuffers, level: &LevelBuffers) -> (Vec<[f32; 4]>, Vec<[f32; 4]>) {
    let markers = gpu.download(liquid.markers.as_ref().unwrap()).unwrap();
    (markers, gpu.download(&level.marker_velocity).unwrap())
}

/// Where the twin takes one marker, with its velocity; otherwise how it is lost.
fn moved(case: &Case, position: [f64; 3], velocity: [f64; 3], spray: bool) -> Result<([f64; 3], [f64; 3]), Lost> {
    let mut one = Markers { position: vec![position], velocity: vec![velocity], spray: vec![spray] };
    let (lost, lost_spray) = reference::advect_level_markers(
        &case.grid,
        case.sides,
        &case.state.velocity,
        &case.cut.solid_distance,
        (GRAVITY.into(), &case.ballistic()),
        case.dt,
        &mut one,
    );
    match one.position.pop() {
        Some(end) => Ok((end, one.velocity[0])),
        None => {
            assert_eq!(lost_spray.left + lost_spray.dropped, u64::from(spray));
            Err(lost)
        }
    }
}

#[test]
fn a_levels_markers_move_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let (mut n_spray, mut n_lost_spray, mut n_stopped) = (0, 0, 0);
    let falling = level_cases().into_iter().map(Case::with_ballistic);
    for case in level_cases().into_iter().chain(falling) {
        let (liquid, level) = upload(gpu, &case, 0);
        let solver = case.solved(gpu);
        let stage = stages::advect_markers(gpu, &liquid, &solver, Some(&level)).unwrap();
        record(gpu, &stage);
        let (markers, velocity) = markers_of(gpu, &liquid, &level);
        let report = gpu.download(&liquid.report).unwrap();
        let counts = gpu.download(&level.marker_counts).unwrap();
        // The midpoint rule without a surface above: as far below it as it matters.
        let (grid, dt) = (&case.grid, case.dt);
        let below = far_below(grid);
        let surface = Surface { distance: &below, radius: 0.2 * grid.dx };
        let error = MarkerError::new(grid, &case.state.velocity, surface, dt);
        let bodies = f64::from(u8::from(case.effects.obstacles));
        // Push-out moves by the distance's error and turns by the normal's: as in twin_advect_markers.
        let push = EPS * 3.0 * 64.0 * grid.dx * bodies;
        let gravity = DVec3::from(GRAVITY);
        let (mut pairs, mut speeds, mut lost) = (Vec::new(), Vec::new(), Lost::default());
        let (mut n_unsteady, mut n_unsteady_lost) = (0, 0);
        for (index, &start) in case.state.markers.iter().enumerate() {
            let (v, spray) = (case.state.marker_velocity[index], case.state.spray[index]);
            let way = dt * (DVec3::from(v).length() + dt * gravity.length());
            // A position has its size and its way rounded: a product, a sum of three, the factor dt^2 / 2 dx g has four more.
            let flight = EPS * (2.0 * case.extent() * grid.dx + 8.0 * way);
            let bound = if spray { flight } else { error.at(start.into()) } + push;
            let end = moved(&case, start, v, spray);
            // A velocity has two roundings. Without a part it also has the normal's error: a difference of distances up to three cells with
            // 12 roundings, and the change of a gradient with the position.
            let speed = DVec3::from(v).length() + dt * gravity.length();
            let normal = 36.0 * EPS + 12.0 * flight / grid.dx;
            let of_speed = speed * (4.0 * EPS + 4.0 * bodies * normal);
            // Where the gradient of the distance jumps, or a sign decides, a rounding decides: such markers show in the twin.
            let steady = [1.0, -1.0].iter().all(|side| {
                let other = moved(&case, start.map(|x| x + side * bound), v, spray);
                match (other, &end) {
                    (Ok(a), Ok(b)) => (0..3).all(|c| {
                        (a.0[c] - b.0[c]).abs() < 100.0 * bound && (a.1[c] - b.1[c]).abs() <= 100.0 * of_speed
                    }),
                    (a, b) => a.is_err() && a == *b,
                }
            });
            let alive = markers[index][3] == 1.0;
            n_spray += usize::from(spray);
            if !steady {
                n_unsteady += 1;
                n_unsteady_lost += u64::from(!alive);
                continue;
            }
            assert_eq!(alive, end.is_ok(), "{}: alive", case.name);
            match end {
                Ok((end, after)) => {
                    let place = [index, 0, usize::from(spray)];
                    let found = xyz(markers[index]);
                    pairs.extend((0..3).map(|a| (found[a], end[a], bound, place)));
                    if spray {
                        let found = xyz(velocity[index]);
                        speeds.extend((0..3).map(|a| (found[a], after[a], of_speed, place)));
                        let free = DVec3::from(v) + dt * gravity;
                        n_stopped += usize::from(free.distance(after.into()) > 1e-3);
                    }
                }
                Err(how) => {
                    lost.dropped += how.dropped;
                    lost.left += how.left;
                }
            }
        }
        assert_close(case.name, pairs);
        assert_close(case.name, speeds);
        assert!(50 * n_unsteady <= markers.len(), "{}: {n_unsteady}", case.name);
        let counted = [Report::DROPPED, Report::LEAVING].map(|word| u64::from(report[word]));
        let more = [counted[0] - lost.dropped, counted[1] - lost.left];
        assert_eq!(more.iter().sum::<u64>(), n_unsteady_lost, "{}", case.name);
        // The spray of the state that is alive, and that is not.
        let dead = |index: usize| markers[index][3] == 0.0;
        let spray = (0..case.state.markers.len()).filter(|&index| case.state.spray[index]);
        let [gone, flying]: [Vec<usize>; 2] =
            [true, false].map(|gone| spray.clone().filter(|&index| dead(index) == gone).collect());
        assert_eq!(counts[FLYING] as usize, flying.len(), "{}", case.name);
        assert_eq!(counts[LOST_SPRAY] as usize, gone.len(), "{}", case.name);
        assert!(flying.iter().all(|&index| velocity[index][3] == 1.0));
        assert!(gone.iter().all(|&index| velocity[index][3] == 0.0));
        n_lost_spray += gone.len();
        // What is dead stays dead and counts once.
        record(gpu, &stage);
        let (again, _) = markers_of(gpu, &liquid, &level);
        assert!((0..again.len()).all(|index| !dead(index) || again[index][3] == 0.0));
        assert_eq!(
            bits(&markers),
            {
                write(gpu, &case, &liquid, &level);
                record(gpu, &stage);
                bits(&markers_of(gpu, &liquid, &level).0)
            },
            "{}: again",
            case.name
        );
    }
    assert!(n_spray > 500 && n_lost_spray > 20 && n_stopped > 20);
}

/// With a drop near the corner as its liquid, which just may reach the second tile along x, with markers within three cells of it, and spray
/// anywhere.
fn with_a_drop(mut case: Case) -> Case {
    let grid = case.grid;
    let moves = case.cfl.ceil() + 1.0;
    let centre = grid.dx * DVec3::new(7.0 - moves, 1.5, 1.5);
    let distance = |x: DVec3| x.distance(centre) / grid.dx - 1.8;
    let cells = (0..grid.n_cells()).map(|cell| grid.cell_centre(grid.cell_at(cell)));
    let level = cells.map(|x| single(grid.dx * distance(x).min(5.0)));
    case.state.liquid_distance = level.collect();
    let spray = case.state.markers.iter();
    case.state.spray = spray.map(|&x| distance(x.into()) > 3.0).collect();
    case
}

/// Tiles that liquid and its markers mark, by the definition.
fn marked(case: &Case, tiles: &Tiles) -> Vec<[usize; 3]> {
    let n = case.grid.cells;
    let live = case.state.markers.iter().zip(&case.state.spray);
    let mut marks: Vec<[usize; 3]> = live
        .filter(|(_, spray)| !**spray)
        .map(|(x, _)| std::array::from_fn(|a| ((x[a] / case.grid.dx) as usize).min(n[a] - 1) / 8))
        .collect();
    for cell in liquid_cells(case) {
        let ends: [[usize; 2]; 3] = std::array::from_fn(|a| {
            let low = cell[a].saturating_sub(tiles.moves as usize) / 8;
            [low, (cell[a] + tiles.moves as usize).min(n[a] - 1) / 8]
        });
        for i in ends[0][0]..=ends[0][1] {
            for j in ends[1][0]..=ends[1][1] {
                marks.extend((ends[2][0]..=ends[2][1]).map(|k| [i, j, k]));
            }
        }
    }
    marks.sort_unstable();
    marks.dedup();
    marks
}

fn liquid_cells(case: &Case) -> impl Iterator<Item = [usize; 3]> {
    let cells = case.state.liquid_distance.iter().enumerate();
    let liquid = cells.filter(|(_, phi)| **phi < 0.0);
    liquid.map(|(cell, _)| case.grid.cell_at(cell))
}

#[test]
fn the_band_of_a_level_is_where_liquid_may_be() {
    let Some(gpu) = gpu() else { return };
    let mut n_without = 0;
    let dry = level_cases().into_iter().map(with_a_drop);
    for case in level_cases().into_iter().chain(dry) {
        let (liquid, level) = upload(gpu, &case, 0);
        let band = stages::band(gpu, &liquid, Some(&level)).unwrap();
        let tiles = liquid.plan.tiles();
        let marks = marked(&case, &tiles);
        let near = |tile: [usize; 3]| {
            let reach = tiles.reach as usize;
            let mut marks = marks.iter();
            marks.any(|mark| (0..3).all(|a| mark[a].abs_diff(tile[a]) <= reach))
        };
        // Twice, the second time after a band that is not the whole domain.
        for _ in 0..2 {
            record(gpu, &band);
            let in_band = case.in_band(gpu, &liquid);
            for cell in 0..case.grid.n_cells() {
                let ijk = case.grid.cell_at(cell);
                let expected = near(ijk.map(|at| at / 8));
                assert_eq!(in_band(ijk), expected, "{}: {ijk:?}", case.name);
                n_without += usize::from(!expected);
            }
        }
        // The air around liquid that moves, which a level reaches.
        let far = case.cfl.ceil() as usize + 1 + 5;
        let in_band = case.in_band(gpu, &liquid);
        for at in liquid_cells(&case) {
            for corner in 0..8 {
                let ijk: [usize; 3] = std::array::from_fn(|a| match corner >> a & 1 {
                    0 => at[a].saturating_sub(far),
                    _ => (at[a] + far).min(case.grid.cells[a] - 1),
                });
                assert!(in_band(ijk), "{}: {ijk:?} near {at:?}", case.name);
            }
        }
    }
    assert!(n_without > 1000);
}

#[test]
fn what_leaves_the_band_of_a_level_is_air() {
    let Some(gpu) = gpu() else { return };
    let mut case = level_cases().into_iter().find(|case| case.name == "far corner").unwrap();
    // A drop in the corner with the marker, and liquid beyond its band in quads that no longer count.
    let grid = case.grid;
    let drop = |cell: usize| {
        let distance = (DVec3::from(grid.cell_at(cell).map(|n| n as f64)) - 1.0).length() - 2.0;
        single(grid.dx * distance.min(5.0))
    };
    case.state.liquid_distance = (0..grid.n_cells()).map(drop).collect();
    case.state.spray = vec![false];
    let (liquid, level) = upload(gpu, &case, 0);
    let band = stages::band(gpu, &liquid, Some(&level)).unwrap();
    record(gpu, &band);
    let in_band = case.in_band(gpu, &liquid);
    gpu.upload(&liquid.liquid_distance, &vec![0.5; liquid.padded.len()]);
    // The marker is spray now: nothing is liquid, and the band is empty.
    case.state.spray = vec![true];
    level.write_markers(gpu, &case.state);
    record(gpu, &band);
    let now = case.in_band(gpu, &liquid);
    let phi = gpu.download(&liquid.liquid_distance).unwrap();
    let mut n_left = 0;
    for cell in 0..grid.n_cells() {
        let ijk = grid.cell_at(cell);
        assert!(!now(ijk), "{ijk:?}");
        let expected = if in_band(ijk) { 5.0 * grid.dx as f32 } else { 0.5 };
        assert_eq!(phi[liquid.padded.index(ijk)], expected, "{ijk:?}");
        n_left += usize::from(in_band(ijk));
    }
    assert!(n_left > 0 && n_left < grid.n_cells());
}

/// Input of `marker_band` beside the state: the carried level, cells, and the excess.
struct Entering {
    carried: Vec<f64>,
    excess: Vec<f64>,
}

impl Entering {
    /// The carried level is deeper than the level by half a cell, with noise: cells enter and leave the band.
    fn of(case: &Case) -> Entering {
        let mut random = Random(29);
        let mut deeper = |phi: f64| single((phi - 0.5 + random.uniform(-0.3, 0.3)).clamp(-5.0, 5.0));
        let carried = level_of(case).into_iter().map(&mut deeper).collect();
        let mut random = Random(31);
        let excess = (0..case.grid.n_cells()).map(|_| single(random.uniform(-0.4, 0.4)));
        Entering { excess: excess.collect(), carried }
    }

    fn write(&self, gpu: &Gpu, case: &Case, liquid: &LiquidBuffers, level: &LevelBuffers) {
        let pad = |values: &[f64]| liquid.padded.pad(case.grid.cells, values, |v| v as f32);
        gpu.upload(&level.carried_level, &pad(&self.carried));
        gpu.upload(&level.excess, &pad(&self.excess));
        // New slots contain anything.
        let n = case.state.markers.len();
        let mut velocity = gpu.download(&level.marker_velocity).unwrap();
        velocity.iter_mut().skip(n).for_each(|word| *word = [7.0; 4]);
        gpu.upload(&level.marker_velocity, &velocity);
        gpu.upload(&level.marker_counts, &[3, 2, 0]);
    }

    /// The twin with everything that decides moved by `off` (cells): a positive one keeps more markers, and seeds more.
    fn twin(&self, case: &Case, off: f64) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
        let mut markers = Markers {
            position: case.state.markers.clone(),
            velocity: case.state.marker_velocity.clone(),
            spray: case.state.spray.clone(),
        };
        let carried: Vec<f64> = self.carried.iter().map(|phi| phi - off).collect();
        let level: Vec<f64> = level_of(case).iter().map(|phi| phi + off).collect();
        let distance = case.cut.solid_distance.iter();
        let distance: Vec<f64> = distance.map(|d| d + off * case.grid.dx).collect();
        let levels = Levels { carried: &carried, level: &level };
        let [deleted, seeded] = reference::marker_band(
            &case.grid,
            &distance,
            levels,
            &self.excess,
            NUMBERS,
            &case.state.velocity,
            &mut markers,
        );
        let kept = markers.position.len() - seeded;
        assert_eq!(kept + deleted, case.state.markers.len());
        let seeds = markers.position.split_off(kept);
        (markers.position, seeds)
    }
}

/// Largest difference between neighbouring cells.
fn steepest(case: &Case, values: &[f64]) -> f64 {
    let n = case.grid.cells;
    let mut steepest: f64 = 0.0;
    for (cell, value) in values.iter().enumerate() {
        let ijk = case.grid.cell_at(cell);
        for a in (0..3).filter(|&a| ijk[a] + 1 < n[a]) {
            let mut next = ijk;
            next[a] += 1;
            steepest = steepest.max((values[case.grid.cell(next)] - value).abs());
        }
    }
    steepest
}

/// Whether a list contains another in its order.
fn contains(list: &[[f64; 3]], other: &[[f64; 3]], equal: impl Fn(&[f64; 3], &[f64; 3]) -> bool) -> bool {
    let mut rest = list.iter();
    other.iter().all(|one| rest.any(|next| equal(next, one)))
}

/// Markers in the first slots that are alive, and those from slot n on.
fn kept_and_seeded(markers: &[[f32; 4]], n: usize, used: usize) -> [Vec<[f64; 3]>; 2] {
    let live = |markers: &[[f32; 4]]| {
        let live = markers.iter().filter(|marker| marker[3] == 1.0);
        live.map(|&marker| xyz(marker)).collect()
    };
    [live(&markers[..n]), live(&markers[n..used])]
}

#[test]
fn the_band_of_markers_is_that_of_the_twin() {
    let Some(gpu) = gpu() else { return };
    let (mut n_deleted, mut n_seeded, mut n_doubtful, mut n_decided) = (0, 0, 0, 0);
    for case in level_cases() {
        let entering = Entering::of(&case);
        let n = case.state.markers.len();
        let (liquid, level) = upload(gpu, &case, 8 * case.grid.n_cells());
        entering.write(gpu, &case, &liquid, &level);
        let band = stages::band(gpu, &liquid, Some(&level)).unwrap();
        let stage = stages::marker_band(gpu, &liquid, &level).unwrap();
        record(gpu, &band);
        record(gpu, &stage);
        let (markers, velocity) = markers_of(gpu, &liquid, &level);
        let words = gpu.download(&liquid.report).unwrap();
        let report = Report::from_words(&words);
        let args = gpu.download(&level.marker_args).unwrap();
        let used = n + report.seeded as usize;
        assert_eq!(args[3] as usize, used, "{}", case.name);
        assert_eq!(args[0] as usize, used.div_ceil(64), "{}", case.name);
        assert_eq!([report.flying, report.spray_lost, report.missing], [3, 2, 0]);
        let [kept, seeds] = kept_and_seeded(&markers, n, used);
        assert_eq!(seeds.len(), report.seeded as usize, "{}", case.name);
        assert_eq!(n - kept.len(), report.deleted as usize, "{}", case.name);
        assert!(velocity[n..used].iter().all(|word| *word == [0.0; 4]));
        // A level up to 5 cells is a product with 1/dx, which is rounded itself, and has 10 roundings as a sample. Between cells it changes by the
        // largest difference per axis times the error of the position: four roundings. The same holds of the distance to bodies, in cells.
        let distance = case.cut.solid_distance.iter();
        let distance: Vec<f64> = distance.map(|d| (d / case.grid.dx).min(5.0)).collect();
        let fields = [&entering.carried, &level_of(&case), &distance];
        let steepest = fields.map(|field| steepest(&case, field));
        let steepest = steepest.into_iter().fold(0.0, f64::max);
        let doubt = EPS * (5.0 * 12.0 + 3.0 * steepest * 4.0 * (case.extent() + 1.0));
        let (fewest, most) = (entering.twin(&case, -doubt), entering.twin(&case, doubt));
        // A site has five roundings of numbers up to 1, one of its cell, one of dx and one of the product.
        let apart = EPS * case.grid.dx * (5.0 + 3.0 * case.extent());
        let equal = |a: &[f64; 3], b: &[f64; 3]| (0..3).all(|c| (a[c] - b[c]).abs() <= apart);
        let same = |a: &[f64; 3], b: &[f64; 3]| a == b;
        assert!(contains(&kept, &fewest.0, same), "{}: deleted", case.name);
        assert!(contains(&most.0, &kept, same), "{}: kept", case.name);
        assert!(contains(&seeds, &fewest.1, equal), "{}: not seeded", case.name);
        assert!(contains(&most.1, &seeds, equal), "{}: seeded", case.name);
        n_doubtful += most.0.len() - fewest.0.len() + most.1.len() - fewest.1.len();
        n_decided += n + 8 * case.grid.n_cells();
        n_deleted += report.deleted;
        n_seeded += report.seeded;
        // The same bits again.
        write(gpu, &case, &liquid, &level);
        entering.write(gpu, &case, &liquid, &level);
        record(gpu, &band);
        record(gpu, &stage);
        let (again, _) = markers_of(gpu, &liquid, &level);
        assert_eq!(bits(&markers), bits(&again), "{}: again", case.name);
        assert_eq!(words, gpu.download(&liquid.report).unwrap());
        check_capacity(gpu, &case, &entering, &seeds, &markers[n..used]);
    }
    assert!(n_deleted > 300 && n_seeded > 300, "{n_deleted} {n_seeded}");
    assert!(n_doubtful <= 2 + n_decided / 10_000, "{n_doubtful} of {n_decided} hang on a rounding");
}

/// With room for half of the seeds, the first half is seeded, and the rest is reported.
fn check_capacity(gpu: &Gpu, case: &Case, entering: &Entering, seeds: &[[f64; 3]], expected: &[[f32; 4]]) {
    let (n, room) = (case.state.markers.len(), seeds.len() / 2);
    let (liquid, level) = upload(gpu, case, room);
    entering.write(gpu, case, &liquid, &level);
    record(gpu, &stages::band(gpu, &liquid, Some(&level)).unwrap());
    record(gpu, &stages::marker_band(gpu, &liquid, &level).unwrap());
    let (markers, _) = markers_of(gpu, &liquid, &level);
    let report = Report::from_words(&gpu.download(&liquid.report).unwrap());
    assert_eq!(report.seeded as usize, room, "{}", case.name);
    assert_eq!(report.missing as usize, seeds.len() - room, "{}", case.name);
    assert_eq!(bits(&markers[n..n + room]), bits(&expected[..room]));
    assert_eq!(gpu.download(&level.marker_args).unwrap()[3] as usize, n + room);
    // Without the dead markers there is room for the rest, in their order.
    let kept: Vec<_> = markers.into_iter().filter(|marker| marker[3] == 1.0).collect();
    if kept.len() + seeds.len() - room > n + room {
        return;
    }
    let alive = liquid.compact(gpu, n + room).unwrap();
    level.compact(gpu, &alive).unwrap();
    level.write_freed(gpu, NUMBERS, n + room - kept.len());
    record(gpu, &stages::seed_rest(gpu, &liquid, &level).unwrap());
    let (markers, _) = markers_of(gpu, &liquid, &level);
    let all: Vec<_> = kept.iter().chain(&expected[room..]).copied().collect();
    assert_eq!(bits(&markers[..all.len()]), bits(&all), "{}", case.name);
    let free = &markers[all.len()..];
    assert!(free.iter().all(|marker| *marker == [0.0; 4]));
}

#[test]
fn spray_flies_and_lands_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let (mut n_taken_off, mut n_landed, mut n_flights, mut n_faces) = (0, 0, 0, 0);
    for case in level_cases() {
        let (grid, n) = (&case.grid, case.state.markers.len());
        let (liquid, level) = upload(gpu, &case, 0);
        // Components in blocks, some without a label.
        let block = |cell: usize| {
            let [i, j, k] = grid.cell_at(cell).map(|at| at / 3);
            ((i + 3 * j + 5 * k) % 7) as u32
        };
        let label: Vec<u32> = (0..grid.n_cells()).map(block).collect();
        let padded = liquid.padded.pad(grid.cells, &label, |label| label);
        gpu.upload(&level.component, &padded);
        let dead = |index: usize| index % 7 == 3;
        let write_dead = || {
            let buffer = liquid.markers.as_ref().unwrap();
            let mut markers = gpu.download(buffer).unwrap();
            let markers_now = markers.iter_mut().enumerate();
            let dying = markers_now.filter(|(index, _)| dead(*index));
            dying.for_each(|(_, marker)| marker[3] = 0.0);
            gpu.upload(buffer, &markers);
        };
        write_dead();
        let before = markers_of(gpu, &liquid, &level);
        let u_next: [Vec<f64>; 3] = Axis::ALL.map(|axis| {
            let faces = case.state.velocity[axis.index()].iter();
            faces.map(|u| single(0.4 - 0.5 * u)).collect()
        });
        let landing = stages::landing(gpu, &liquid, &level).unwrap();
        let stage = stages::spray(gpu, &liquid, &level).unwrap();
        // As `marker_band` writes them.
        let args = [&level.marker_args, &liquid.band_args].map(|args| gpu.download(args).unwrap());
        gpu.upload(&level.landing_args, &args.map(|args| args[..4].to_vec()).concat());
        // `landing` uses the velocity, which the solve then writes.
        let run = || {
            gpu.upload(&liquid.velocity_next, &liquid.pad_faces(&u_next));
            record(gpu, &landing);
            gpu.upload(&liquid.velocity, &liquid.pad_faces(&case.state.velocity));
            record(gpu, &stage);
            gpu.upload(&level.marker_counts, &[0; 6]);
        };
        run();
        let (markers, velocity) = markers_of(gpu, &liquid, &level);
        assert_eq!(bits(&markers), bits(&before.0), "{}", case.name);
        let flights = gpu.download(&level.component_flights).unwrap();

        let live: Vec<usize> = (0..n).filter(|&index| !dead(index)).collect();
        let state = &case.state;
        let mut twin = Markers {
            position: live.iter().map(|&index| state.markers[index]).collect(),
            velocity: live.iter().map(|&index| state.marker_velocity[index]).collect(),
            spray: live.iter().map(|&index| state.spray[index]).collect(),
        };
        let landed = reference::land(grid, &state.liquid_distance, &mut twin);
        let taken = gpu.download(&liquid.velocity_next).unwrap();
        n_faces += check_landing(&case, (&liquid, &taken), &u_next, (&twin, &landed));
        let started = reference::spray(grid, &state.liquid_distance, &state.velocity, &mut twin);
        n_taken_off += started.len();
        n_landed += landed.len();
        let mut expected = [0i32; 7];
        let landed = landed.iter().map(|marker| (marker, 1));
        for (&marker, flight) in landed.chain(started.iter().map(|marker| (marker, -1))) {
            let near = reference::label_at(grid, &label, twin.position[marker].into());
            if near > 0 {
                expected[near as usize] += flight;
            }
        }
        n_flights += expected.iter().filter(|count| **count != 0).count();
        // All labels are below 7. The stage settles the flights of the band alone, where no cell has such an index.
        assert_eq!(flights[..7], expected, "{}: flights", case.name);
        assert!(flights[7..].iter().all(|count| *count == 0));
        // A position in cells has four roundings, a sample ten and the slope of the velocity along three axes.
        let speed = case.speed();
        let bound = EPS * (10.0 * speed + 3.0 * 2.0 * speed * 4.0 * (case.extent() + 1.0));
        let mut pairs = Vec::new();
        for (&index, (v, &spray)) in live.iter().zip(twin.velocity.iter().zip(&twin.spray)) {
            assert_eq!(velocity[index][3] == 1.0, spray, "{}: {index}", case.name);
            let found = xyz(velocity[index]);
            if state.spray[index] && spray {
                assert_eq!(found, *v, "{}: spray keeps its velocity", case.name);
            }
            pairs.extend((0..3).map(|a| (found[a], v[a], bound, [index, a, 0])));
        }
        assert_close(case.name, pairs);
        let untouched = (0..n).filter(|&index| dead(index));
        for index in untouched {
            assert_eq!(velocity[index], before.1[index], "{}: dead", case.name);
        }
        write(gpu, &case, &liquid, &level);
        write_dead();
        run();
        let (_, again) = markers_of(gpu, &liquid, &level);
        assert_eq!(bits(&velocity), bits(&again), "{}: again", case.name);
        let words = |faces: &[f32]| faces.iter().map(|u| u.to_bits()).collect::<Vec<_>>();
        let again = gpu.download(&liquid.velocity_next).unwrap();
        assert!(words(&taken) == words(&again), "{}: again", case.name);
        let twice: Vec<i32> = expected.iter().map(|count| 2 * count).collect();
        assert_eq!(gpu.download(&level.component_flights).unwrap()[..7], twice);
    }
    assert!(n_taken_off > 100 && n_landed > 100 && n_flights > 20);
    assert!(n_faces > 100, "{n_faces}");
}

/// Asserts the velocities of the faces after markers land; how many faces took some.
fn check_landing(
    case: &Case,
    (liquid, taken): (&LiquidBuffers, &[f32]),
    u_next: &[Vec<f64>; 3],
    (markers, landed): (&Markers, &[usize]),
) -> usize {
    let (grid, phi) = (&case.grid, &case.state.liquid_distance);
    let open_volumes = reference::open_volumes(grid, &case.cut.solid_distance);
    let level = level_of(case);
    let volume =
        |cell: usize| open_volumes[cell] / grid.cell_volume() * reference::interpolant_part(grid, &level, cell);
    let volumes: Vec<f64> = (0..grid.n_cells()).map(volume).collect();
    let mut twin = u_next.clone();
    let open = &case.cut.open;
    reference::take_landing(grid, open, (phi, &volumes), (markers, landed), case.dt, &mut twin);
    let quad = liquid.padded.len();
    let speed = grid.dx / case.dt;
    let mut pairs = Vec::new();
    let mut n_faces = 0;
    for axis in Axis::ALL {
        let a = axis.index();
        let mut near = vec![[0.0; 2]; grid.n_faces(axis)];
        for &marker in landed {
            let x = DVec3::from(markers.position[marker]);
            for (face, weight) in reference::landing_faces(grid, &open[a], phi, axis, x) {
                near[face][0] += 1.0;
                near[face][1] += weight / 8.0;
            }
        }
        let padded = liquid.padded;
        let device = padded.unpad(grid.faces(axis), &taken[a * quad..][..quad], f64::from);
        for (face, &[n, weight]) in near.iter().enumerate() {
            // Both paths round to 2^-16; a weight has three factors with three roundings of a position in cells, over a sum that may be
            // 1/256. A filled part: as in `twin_liquid_components`.
            let of_weight = 2.0 * (-16.0_f64).exp2() + 256.0 * 9.0 * 4.0 * EPS * (case.extent() + 1.0);
            let speeds = 3.0 * case.speed() + 2.0 * 3.0;
            let mass = reference::face_mass(grid, &volumes, axis, face);
            let off = n / 8.0 * of_weight * (speeds + speed) + 400.0 * EPS * speeds * n.min(1.0);
            let bound = off / (mass + weight).max(1e-3);
            pairs.push((device[face], twin[a][face], bound, [a, face, 0]));
            n_faces += usize::from(n > 0.0);
        }
    }
    assert_close(case.name, pairs);
    n_faces
}

#[test]
fn seeds_of_the_sub_step_get_a_velocity() {
    let Some(gpu) = gpu() else { return };
    let mut n_seeded = 0;
    for case in level_cases() {
        let entering = Entering::of(&case);
        let n = case.state.markers.len();
        let (liquid, level) = upload(gpu, &case, 8 * case.grid.n_cells());
        entering.write(gpu, &case, &liquid, &level);
        record(gpu, &stages::band(gpu, &liquid, Some(&level)).unwrap());
        record(gpu, &stages::marker_band(gpu, &liquid, &level).unwrap());
        record(gpu, &stages::spray(gpu, &liquid, &level).unwrap());
        let used = gpu.download(&level.marker_args).unwrap()[3] as usize;
        let (markers, velocity) = markers_of(gpu, &liquid, &level);
        let speed = case.speed();
        let bound = EPS * (10.0 * speed + 3.0 * 2.0 * speed * 4.0 * (case.extent() + 1.0));
        let seeds = (n..used).flat_map(|index| {
            let x = DVec3::from(xyz(markers[index]));
            let v = case.grid.velocity_at(&case.state.velocity, x);
            let found = xyz(velocity[index]);
            (0..3).map(move |a| (found[a], v[a], bound, [index, a, 0]))
        });
        assert_close(case.name, seeds);
        assert!(velocity[n..used].iter().all(|word| word[3] == 0.0));
        n_seeded += used - n;
    }
    assert!(n_seeded > 300);
}

#[test]
fn dead_markers_lose_their_slots_and_the_others_keep_their_order() {
    let Some(gpu) = gpu() else { return };
    let case = level_cases().into_iter().find(|case| case.name == "block").unwrap();
    let n = case.state.markers.len();
    let (liquid, level) = upload(gpu, &case, 100);
    let buffer = liquid.markers.as_ref().unwrap();
    let mut markers = gpu.download(buffer).unwrap();
    let dead = |index: usize| index % 3 == 1 || (50..200).contains(&index);
    for (index, marker) in markers[..n].iter_mut().enumerate() {
        marker[3] = f32::from(u8::from(!dead(index)));
    }
    gpu.upload(buffer, &markers);
    let mut before = State::at_rest(&case.grid);
    let alive = liquid.read_state(gpu, n, &mut before).unwrap();
    level.read_markers(gpu, &alive, &mut before).unwrap();
    let live: Vec<usize> = (0..n).filter(|&index| !dead(index)).collect();
    let positions: Vec<[f64; 3]> = live.iter().map(|&i| case.state.markers[i]).collect();
    let velocity: Vec<[f64; 3]> = live.iter().map(|&i| case.state.marker_velocity[i]).collect();
    let spray: Vec<bool> = live.iter().map(|&i| case.state.spray[i]).collect();
    assert_eq!(before.markers, positions);
    assert_eq!(before.marker_velocity, velocity);
    assert_eq!(before.spray, spray);
    let alive = liquid.compact(gpu, n).unwrap();
    level.compact(gpu, &alive).unwrap();
    assert_eq!(alive.iter().filter(|alive| **alive).count(), live.len());
    let args = gpu.download(&level.marker_args).unwrap();
    assert_eq!(args, [live.len().div_ceil(64) as u32, 1, 1, live.len() as u32]);
    let mut after = State::at_rest(&case.grid);
    let alive = liquid.read_state(gpu, live.len(), &mut after).unwrap();
    level.read_markers(gpu, &alive, &mut after).unwrap();
    assert!(alive.iter().all(|alive| *alive));
    assert_eq!(after.markers, before.markers);
    assert_eq!(after.marker_velocity, before.marker_velocity);
    assert_eq!(after.spray, before.spray);
    let markers = gpu.download(buffer).unwrap();
    assert!(markers[live.len()..].iter().all(|marker| *marker == [0.0; 4]));
}
