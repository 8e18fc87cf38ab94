//! The stages that shape a level against their twins: `occupancy`, `bound_level`, `redistance`, `filter_level` and
//! `liquid_distance`, one by one and in a row.
//!
//! Every stage runs on all quads and on the band around the markers. Outside it, where kernels must not look, the arrays hold
//! nonsense.

use cutwater::effects::Effects;
use cutwater::fields::{LevelBuffers, LiquidBuffers};
use cutwater::geometry::obstacle_cut;
use cutwater::gpu::{Buffer, Dispatches, Gpu, Recorder};
use cutwater::grid::{Axis, Grid};
use cutwater::reference::{self, LevelCells};
use cutwater::scene::Scene;
use cutwater::stages;
use glam::DVec3;

use crate::common::{Random, gpu};
use crate::level_case::{level_buffers, level_cases, level_of};
use crate::liquid_case::{Case, EPS, single};

/// Bound of the level where no liquid leaves a wall, on the device.
const NO_BOUND: f64 = -1e30;

/// Level of air, cells.
const AIR: f64 = 5.0;
/// Occupancy that is unknown.
const UNKNOWN: f64 = -1.0;
/// Every seventh marker is deleted.
const DELETED: usize = 7;

/// Buffers of a case.
struct Run<'a> {
    gpu: &'a Gpu,
    case: &'a Case,
    name: String,
    liquid: LiquidBuffers,
    level: LevelBuffers,
    /// Per cell.
    in_band: Vec<bool>,
    /// Cells within six of one outside the band.
    at_edge: Vec<bool>,
}

/// All cases, on all quads and on the band.
fn runs<'a>(gpu: &'a Gpu, cases: &'a [Case]) -> impl Iterator<Item = Run<'a>> {
    let both = cases.iter().flat_map(|case| [false, true].map(|narrow| (case, narrow)));
    both.map(move |(case, narrow)| Run::new(gpu, case, narrow))
}

impl<'a> Run<'a> {
    fn new(gpu: &'a Gpu, case: &'a Case, narrow: bool) -> Run<'a> {
        let (grid, state) = (&case.grid, &case.state);
        let liquid = case.upload(gpu);
        let level = level_buffers(gpu, case, &liquid);
        let alive = |n: usize| if n % DELETED == 3 { 0.0 } else { 1.0 };
        let at = |n: usize| {
            let [x, y, z] = state.markers[n].map(|x| x as f32);
            [x, y, z, alive(n)]
        };
        if !state.markers.is_empty() {
            let positions: Vec<_> = (0..state.markers.len()).map(at).collect();
            gpu.upload(liquid.markers.as_ref().unwrap(), &positions);
        }
        level.write_markers(gpu, state);
        if narrow {
            case.band(gpu, &liquid);
        }
        let in_band = case.in_band(gpu, &liquid);
        let cells = 0..grid.n_cells();
        let in_band: Vec<bool> = cells.map(|cell| in_band(grid.cell_at(cell))).collect();
        let mut at_edge: Vec<bool> = in_band.iter().map(|inside| !inside).collect();
        for axis in Axis::ALL.map(Axis::index) {
            let near = |cell: usize| {
                let mut ijk = grid.cell_at(cell);
                let range = ijk[axis].saturating_sub(6)..(ijk[axis] + 7).min(grid.cells[axis]);
                range.into_iter().any(|at| {
                    ijk[axis] = at;
                    at_edge[grid.cell(ijk)]
                })
            };
            at_edge = (0..at_edge.len()).map(near).collect();
        }
        let name = format!("{}{}", case.name, if narrow { ", band" } else { "" });
        Run { gpu, case, name, liquid, level, in_band, at_edge }
    }

    /// Positions and spray of the markers that are not deleted.
    fn markers(&self) -> (Vec<[f64; 3]>, Vec<bool>) {
        let state = &self.case.state;
        let pairs = state.markers.iter().zip(&state.spray).enumerate();
        pairs.filter(|(n, _)| n % DELETED != 3).map(|(_, (x, spray))| (*x, *spray)).unzip()
    }

    /// Writes a field on the band and nonsense elsewhere. Returns it as f32 has it, with a value outside the band.
    fn put(&self, to: &Buffer<f32>, values: &[f64], outside: f64, nonsense: f32) -> Vec<f64> {
        let grid = &self.case.grid;
        let mut device = vec![nonsense; self.liquid.padded.len()];
        for (cell, &value) in values.iter().enumerate() {
            if self.in_band[cell] {
                device[self.liquid.padded.index(grid.cell_at(cell))] = value as f32;
            }
        }
        self.gpu.upload(to, &device);
        let seen = values.iter().zip(&self.in_band);
        seen.map(|(&value, &inside)| if inside { single(value) } else { outside }).collect()
    }

    fn put_level(&self, to: &Buffer<f32>, values: &[f64]) -> Vec<f64> {
        self.put(to, values, AIR, -2.3)
    }

    fn get(&self, from: &Buffer<f32>) -> Vec<f64> {
        let device = self.gpu.download(from).unwrap();
        let cells = self.case.grid.cells;
        self.liquid.padded.unpad(cells, &device, f64::from)
    }

    fn bits(&self, from: &Buffer<f32>) -> Vec<u32> {
        let device = self.gpu.download(from).unwrap();
        device.into_iter().map(f32::to_bits).collect()
    }

    fn record(&self, stages: &[Dispatches]) {
        let mut recorder = Recorder::new(self.gpu);
        stages.iter().for_each(|stage| stage.record(&mut recorder));
        recorder.submit();
    }

    fn cells(&self) -> LevelCells<'_> {
        LevelCells { grid: &self.case.grid, cut: &self.case.cut }
    }

    /// The case's level, its slope times a factor, air at the edge of the band.
    fn level_values(&self, factor: f64) -> Vec<f64> {
        let level = level_of(self.case).into_iter().zip(&self.at_edge);
        level.map(|(phi, &edge)| if edge { AIR } else { (factor * phi).clamp(-AIR, AIR) }).collect()
    }

    fn in_body(&self, cell: usize) -> bool {
        self.case.cut.solid_distance[cell] < 0.0
    }

    /// Whether one of the six cells around a cell, or itself, has its centre in a body.
    fn beside_body(&self, cell: usize) -> bool {
        let grid = &self.case.grid;
        let sides = Axis::ALL.into_iter().flat_map(|axis| {
            [0, 1].map(|side| {
                let mut face = grid.cell_at(cell);
                face[axis.index()] += side;
                grid.face_sides(axis, face)[side]
            })
        });
        self.in_body(cell) || sides.flatten().any(|other| self.in_body(other))
    }

    /// Compares the cells of the band that `keep` keeps. A few may differ by more than their bound: a threshold lies between both paths'
    /// values.
    fn compare(
        &self,
        what: &str,
        [device, twin]: [&[f64]; 2],
        bound: impl Fn(usize) -> f64,
        keep: impl Fn(usize) -> bool,
    ) {
        let grid = &self.case.grid;
        let cells: Vec<usize> = (0..device.len()).filter(|&cell| self.in_band[cell] && keep(cell)).collect();
        let off = |&&cell: &&usize| {
            let difference = (device[cell] - twin[cell]).abs();
            difference > bound(cell) || difference.is_nan()
        };
        let flipped: Vec<usize> = cells.iter().filter(off).copied().collect();
        let show = |&cell: &usize| {
            let (gpu, twin) = (device[cell], twin[cell]);
            format!(
                "{:?}: {gpu:e} for {twin:e}, bound {:e}, body {}\n",
                grid.cell_at(cell),
                bound(cell),
                self.in_body(cell)
            )
        };
        assert!(
            flipped.len() as f64 <= 1e-4 * cells.len() as f64 + 2.0
                && flipped.iter().all(|&cell| device[cell].is_finite()),
            "{}, {what}: {} of {} cells differ\n{}",
            self.name,
            flipped.len(),
            cells.len(),
            flipped.iter().take(12).map(show).collect::<String>()
        );
    }
}

/// Every case, and with separation.
fn with_and_without_separation() -> Vec<Case> {
    let with = |case: Case| Case { effects: Effects { separation: true, ..case.effects }, ..case };
    level_cases().into_iter().chain(level_cases().into_iter().map(with)).collect()
}

impl Run<'_> {
    /// Writes bounds of the level where liquid leaves walls: in a fifth of the cells, up to a cell above or below the level; infinite ones
    /// for the twin elsewhere. Empty without separation.
    fn put_bounds(&self, level: &[f64]) -> Vec<f64> {
        if !self.case.effects.separation {
            return Vec::new();
        }
        let mut random = Random(11);
        let values = level.iter().map(|phi| {
            let bound = phi + random.uniform(-1.0, 1.0);
            if random.uniform(0.0, 1.0) < 0.2 { bound } else { NO_BOUND }
        });
        let values: Vec<f64> = values.collect();
        let grid = &self.case.grid;
        let mut device = vec![[0.3_f32; 2]; self.level.density_next.len()];
        let words = device.as_flattened_mut();
        for cell in (0..values.len()).filter(|&cell| self.in_band[cell]) {
            words[self.liquid.padded.index(grid.cell_at(cell))] = values[cell] as f32;
        }
        self.gpu.upload(&self.level.density_next, &device);
        let seen = values.iter().zip(&self.in_band);
        seen.map(|(&value, &inside)| {
            let bounds = inside && value > 0.9 * NO_BOUND;
            if bounds { single(value) } else { f64::NEG_INFINITY }
        })
        .collect()
    }
}

/// Rounding of a level (up to 8 cells with the overshoot) in bodies, cells: a pass takes differences of values with coefficients
/// whose magnitudes add up to less than 3 and adds 110 roundings (`twin_liquid_distance`).
fn extended(off: f64) -> f64 {
    let pass = |off: f64| 3.0 * off + 110.0 * 8.0 * EPS;
    pass(pass(pass(off)))
}

#[test]
fn markers_fill_the_surroundings_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let mut seen = [0; 3];
    for run in runs(gpu, &level_cases()) {
        let (grid, distance) = (&run.case.grid, &run.case.cut.solid_distance);
        let level = run.put_level(&run.level.carried_level, &level_of(run.case));
        let stage = [stages::occupancy(gpu, &run.liquid, &run.level).unwrap()];
        run.record(&stage);
        let first = run.bits(&run.level.occupancy);
        run.record(&stage);
        assert!(first == run.bits(&run.level.occupancy), "{}", run.name);
        let device = run.get(&run.level.occupancy);
        let (markers, spray) = run.markers();
        let twin = reference::occupancy(grid, distance, &level, &markers, &spray);
        // Positions in cells are off by three roundings per axis, products by a few; each integer is rounded on both paths.
        let mut near = vec![0.0; grid.n_cells()];
        for x in &markers {
            let at = x.map(|x| (x / grid.dx).floor() as i64);
            for n in 0..27 {
                let cell = [at[0] + n % 3 - 1, at[1] + n / 3 % 3 - 1, at[2] + n / 9 - 1];
                let clamped: [usize; 3] = std::array::from_fn(|a| cell[a].clamp(0, grid.cells[a] as i64 - 1) as usize);
                near[grid.cell(clamped)] += 1.0;
            }
        }
        let weight = (9.0 * run.case.extent() + 24.0) * EPS;
        // Distances of up to 3 dx are mixed three times and divided by dx / 2: 80 roundings of T, and 20 of its sum.
        let bound = |cell: usize| {
            let (open, off) = match distance[cell] < 2.1 * grid.dx {
                true => (0.2, 100.0 * EPS),
                false => (1.0, 0.0),
            };
            near[cell] * weight / (8.0 * open) + twin[cell].abs() * (off / open + 4.0 * EPS)
        };
        run.compare("occupancy", [&device, &twin], bound, |_| true);
        seen[0] += twin.iter().filter(|&&f| f == UNKNOWN).count();
        seen[1] += twin.iter().filter(|&&f| f > 0.05 && f < 0.95).count();
        seen[2] += twin.iter().filter(|&&f| f >= 1.0).count();
    }
    assert!(seen.iter().all(|&n| n > 500), "{seen:?}");
}

#[test]
fn markers_bound_the_level_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let (mut changed, mut raised) = ([0; 2], 0);
    for run in runs(gpu, &with_and_without_separation()) {
        let (grid, distance) = (&run.case.grid, &run.case.cut.solid_distance);
        let level = run.put_level(&run.level.carried_level, &level_of(run.case));
        let (markers, spray) = run.markers();
        let fraction = reference::occupancy(grid, distance, &level, &markers, &spray);
        let fraction = run.put(&run.level.occupancy, &fraction, 0.0, 0.7);
        let bounds = run.put_bounds(&level);
        let stage = [stages::bound_level(gpu, &run.liquid, &run.level).unwrap()];
        run.record(&stage);
        let first = run.bits(&run.level.new_level);
        run.record(&stage);
        assert!(first == run.bits(&run.level.new_level), "{}", run.name);
        let device = run.get(&run.level.new_level);
        let thin = reference::thin_liquid(grid, &level);
        let marks = gpu.download(&run.level.thin).unwrap();
        for cell in (0..thin.len()).filter(|&cell| run.in_band[cell]) {
            let index = run.liquid.padded.index(grid.cell_at(cell));
            let mark = marks[index / 4] >> (index % 4) & 1 == 1;
            assert_eq!(mark, thin[cell], "{}: thin {cell}", run.name);
        }
        let mut twin = reference::bound_level(run.cells(), &fraction, &thin, &level);
        let by_markers = twin.clone();
        reference::raise_separated(&bounds, &mut twin);
        raised += twin.iter().zip(&by_markers).filter(|(raised, before)| raised != before).count();
        // Sums of 27 values in three nested passes and a quotient: 28 roundings of G, 1.6 times that. In thin liquid q is off by 4
        // roundings, its root by those over twice the root, and at most by the root of the same; the curvature, a sixth of which
        // counts, is a sum of six differences of up to 7 cells, in order: 6 and 6 + .. + 1 roundings of partial sums below 42.
        let bound = |cell: usize| match thin[cell] {
            true => {
                let q = (2.0 * (fraction[cell] - 0.47)).clamp(-1.0, 1.0);
                let root = (1.0 - q.abs()).sqrt();
                (4.0 * EPS / root).min((4.0 * EPS).sqrt()) + (6.0 + 12.0 * 42.0 / 6.0) * EPS
            }
            false => 48.0 * EPS,
        };
        run.compare("bounded level", [&device, &twin], bound, |_| true);
        for cell in (0..thin.len()).filter(|&cell| run.in_band[cell]) {
            changed[usize::from(thin[cell])] += usize::from(by_markers[cell] != level[cell]);
        }
    }
    assert!(changed.iter().all(|&n| n > 500) && raised > 500, "{changed:?}, {raised}");
}

#[test]
fn the_level_is_redistanced_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let mut changed = [0; 2];
    let cases = with_and_without_separation();
    let factors = [0.6, 2.2];
    let both = runs(gpu, &cases).flat_map(|run| {
        let run = std::rc::Rc::new(run);
        factors.map(|factor| (run.clone(), factor))
    });
    for (run, factor) in both {
        let values = run.level_values(factor);
        let mut level = run.put_level(&run.level.new_level, &values);
        let bounds = run.put_bounds(&level);
        let stage = [stages::redistance(gpu, &run.liquid, &run.level).unwrap()];
        run.record(&stage);
        let first = run.bits(&run.level.new_level);
        run.put_level(&run.level.new_level, &values);
        run.record(&stage);
        assert!(first == run.bits(&run.level.new_level), "{}", run.name);
        let device = run.get(&run.level.new_level);
        reference::extend_level(&run.case.grid, &run.case.cut, &mut level);
        let twin = reference::redistance(run.cells(), &bounds, &level);
        // The solution of a pass is off by no more than its neighbours, and by 64 roundings: sums up to 15, a root, a quotient. The
        // relaxation takes differences along three axes, 8 times that at most. Beside bodies they have extended values.
        let passes = 9.0 * 64.0 * EPS;
        let bound = |cell: usize| match (run.in_body(cell), run.beside_body(cell)) {
            (true, _) => extended(0.0),
            (_, true) => 6.0 * extended(0.0) + 8.0 * passes,
            _ => 8.0 * passes,
        };
        // At the edge of the band all is air, but for bodies: the extension on the device stops there.
        let whole = |cell: usize| !run.at_edge[cell] || !run.beside_body(cell);
        run.compare("redistanced level", [&device, &twin], bound, whole);
        for cell in (0..level.len()).filter(|&cell| run.in_band[cell] && twin[cell] != level[cell]) {
            changed[usize::from(level[cell].abs() < 0.5)] += 1;
        }
    }
    assert!(changed.iter().all(|&n| n > 500), "{changed:?}");
}

#[test]
fn the_level_is_filtered_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let mut changed = 0;
    for run in runs(gpu, &level_cases()) {
        let grid = &run.case.grid;
        let level = run.put_level(&run.level.new_level, &level_of(run.case));
        let thin = reference::thin_liquid(grid, &level);
        let mut marks = vec![0; run.liquid.padded.quads];
        for (cell, _) in thin.iter().enumerate().filter(|(_, thin)| **thin) {
            let index = run.liquid.padded.index(grid.cell_at(cell));
            marks[index / 4] |= 1 << (index % 4);
        }
        gpu.upload(&run.level.thin, &marks);
        let motion = 0.75;
        run.level.write_step(gpu, [0; 2], motion, 0.0);
        let stage = [stages::filter_level(gpu, &run.liquid, &run.level).unwrap()];
        run.record(&stage);
        let first = run.bits(&run.level.new_level);
        let device = run.get(&run.level.new_level);
        run.put_level(&run.level.new_level, &level_of(run.case));
        run.record(&stage);
        assert!(first == run.bits(&run.level.new_level), "{}", run.name);
        let twin = reference::filter_level(run.cells(), &thin, motion, &level);
        // Fourth differences up to 56 cells take 6 roundings, their weights 12, over 64 along each of three axes; one of the result.
        run.compare("filtered level", [&device, &twin], |_| 64.0 * EPS, |_| true);
        let pairs = twin.iter().zip(&level).zip(&run.in_band);
        changed += pairs.filter(|((a, b), inside)| **inside && a != b).count();
    }
    assert!(changed > 500, "{changed}");
}

#[test]
fn the_liquid_distance_is_the_level_extended_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let (mut bodies, mut liquid) = (0, 0);
    for run in runs(gpu, &level_cases()) {
        let (grid, cut) = (&run.case.grid, &run.case.cut);
        let values = run.level_values(1.0);
        let mut level = run.put_level(&run.level.new_level, &values);
        let stage = [stages::liquid_distance(gpu, &run.liquid, Some(&run.level), None).unwrap()];
        run.record(&stage);
        let first = run.bits(&run.liquid.liquid_distance);
        run.put_level(&run.level.new_level, &values);
        run.record(&stage);
        assert!(first == run.bits(&run.liquid.liquid_distance), "{}", run.name);
        let device = run.get(&run.liquid.liquid_distance);
        reference::extend_level(grid, cut, &mut level);
        let twin: Vec<f64> = level.iter().map(|phi| grid.dx * phi).collect();
        let bound = |cell: usize| {
            let off = if run.in_body(cell) { extended(0.0) } else { 0.0 };
            grid.dx * (off + 2.0 * 8.0 * EPS)
        };
        let whole = |cell: usize| !run.at_edge[cell] || !run.in_body(cell);
        run.compare("liquid distance", [&device, &twin], bound, whole);
        let padded = gpu.download(&run.liquid.liquid_distance).unwrap();
        let [all, within] =
            [padded.iter().filter(|&&phi| phi < 0.0).count(), device.iter().filter(|&&phi| phi < 0.0).count()];
        assert_eq!(all, within, "{}: liquid in spare cells", run.name);
        bodies += (0..level.len()).filter(|&cell| run.in_body(cell) && level[cell] != 1.0).count();
        liquid += within;
    }
    assert!(bodies > 100 && liquid > 500, "{bodies} {liquid}");
}

/// A ball above a pool around a solid ball. Markers lie up to 1.3 cells above the level, which they bound; nine a cell make up
/// for the deleted ones. dx is a power of two and the markers are at multiples of 2^-8 cells, so that their weights are exact
/// on both paths.
fn ball_above_pool() -> Case {
    let text = "[domain]\nsize = [1.5, 1.25, 1.375]\ncells = [24, 20, 22]\n[time]\nduration = 1.0\n[liquid]\n\
                [[liquid.region]]\nbox = { min = [0, 0, 0], max = [1.5, 0.5, 1.375] }\n\
                [[obstacle]]\nsphere = { centre = [0.78, 0.45, 0.7], radius = 0.26 }\n";
    let scene = Scene::parse(std::path::Path::new("ball.toml"), text, &[], 1.0).unwrap();
    let grid: Grid = scene.grid();
    let mut cut = obstacle_cut(&scene, &grid).unwrap().cut;
    for values in cut.open.iter_mut().chain([&mut cut.solid_distance]) {
        values.iter_mut().for_each(|value| *value = single(*value));
    }
    let effects = Effects {
        level: true,
        maccormack: true,
        volume_shift: true,
        volume_control: false,
        separation: false,
        ..Effects::of(&scene)
    };
    let surface = |x: DVec3, above: f64| {
        let ball = x.distance(DVec3::new(8.1, 15.4, 11.2)) - 2.3;
        (x.y - 8.3).min(ball) - above
    };
    let mut case = Case::around("ball above a pool", (grid, effects, cut), 3.0, |_, _| 0);
    let mut random = Random(3);
    for cell in 0..grid.n_cells() {
        let corner = DVec3::from(grid.cell_at(cell).map(|n| n as f64));
        for eighth in 0..9 {
            let mut jitter = || 0.5 * (random.bits() % 128) as f64 / 128.0;
            let within = [0, 1, 2].map(|a| 0.5 * f64::from(eighth >> a & 1) + jitter());
            let x = corner + DVec3::from(within);
            let body = grid.dx * x - DVec3::new(0.78, 0.45, 0.7);
            if surface(x, 1.3) < 0.0 && body.length() > 0.26 {
                case.state.markers.push((grid.dx * x).into());
            }
        }
    }
    let n = case.state.markers.len();
    case.state.marker_velocity = vec![[0.0; 3]; n];
    case.state.spray = vec![false; n];
    let level = (0..grid.n_cells()).map(|cell| {
        let x = grid.cell_centre(grid.cell_at(cell)) / grid.dx;
        let ripple = 0.12 * (2.1 * x.x).sin() * (1.7 * x.z).cos();
        single((1.7 * surface(x, 0.0) + ripple).clamp(-AIR, AIR)) * grid.dx
    });
    case.state.liquid_distance = level.collect();
    case
}

#[test]
fn the_stages_of_the_shape_in_a_row_do_what_the_twins_do() {
    let Some(gpu) = gpu() else { return };
    let case = ball_above_pool();
    let run = Run::new(gpu, &case, true);
    let (grid, cut) = (&case.grid, &case.cut);
    let carried = run.put_level(&run.level.carried_level, &level_of(&case));
    let (liquid, level) = (&run.liquid, &run.level);
    let motion = 0.75;
    level.write_step(gpu, [0; 2], motion, 0.0);
    let stages = [
        stages::occupancy(gpu, liquid, level).unwrap(),
        stages::bound_level(gpu, liquid, level).unwrap(),
        stages::redistance(gpu, liquid, level).unwrap(),
        stages::filter_level(gpu, liquid, level).unwrap(),
        stages::liquid_distance(gpu, liquid, Some(level), None).unwrap(),
    ];
    run.record(&stages);
    let first = run.bits(&liquid.liquid_distance);
    run.record(&stages);
    assert!(first == run.bits(&liquid.liquid_distance));
    let device = run.get(&liquid.liquid_distance);
    let (markers, spray) = run.markers();
    let fraction = reference::occupancy(grid, &cut.solid_distance, &carried, &markers, &spray);
    let thin = reference::thin_liquid(grid, &carried);
    let bounded = reference::bound_level(run.cells(), &fraction, &thin, &carried);
    let mut twin = bounded.clone();
    reference::extend_level(grid, cut, &mut twin);
    let redistanced = reference::redistance(run.cells(), &[], &twin);
    let filtered = reference::filter_level(run.cells(), &thin, motion, &redistanced);
    twin.clone_from(&filtered);
    reference::extend_level(grid, cut, &mut twin);
    let twin: Vec<f64> = twin.iter().map(|phi| grid.dx * phi).collect();
    // Away from bodies weights are exact: a bound is off by 48 roundings, in thin liquid by half as many as in `bound_level` above.
    // Distances add 9 times 64, relaxation and filter multiply by 8 and 2. Within five cells of a body the open surroundings are
    // off by 500 roundings, and the extension multiplies by 27.
    let passes = 9.0 * 64.0 * EPS;
    let bounds = 2.0 * (8.0 * (passes + 64.0 * EPS) + 64.0 * EPS);
    let beside = extended(2.0 * (8.0 * (passes + 800.0 * EPS) + 64.0 * EPS));
    let far = |cell: usize| cut.solid_distance[cell] > 2.9 * grid.dx;
    let bound = |cell: usize| grid.dx * if far(cell) { bounds } else { beside };
    run.compare("all stages", [&device, &twin], bound, |_| true);
    // Every stage had something to do.
    let change = |a: &[f64], b: &[f64]| a.iter().zip(b).filter(|(a, b)| a != b).count();
    let changes = [change(&carried, &bounded), change(&bounded, &redistanced), change(&redistanced, &filtered)];
    assert!(changes[0] > 50 && changes[1] > 500 && changes[2] > 100, "{changes:?}");
    // Worst cases add up; most cells are far better.
    let rough = (0..twin.len()).filter(|&cell| (device[cell] - twin[cell]).abs() > 1e-4 * grid.dx);
    assert!(rough.count() <= twin.len() / 1000);
    let outside = (0..twin.len()).filter(|&cell| !run.in_band[cell]);
    for cell in outside {
        assert!(twin[cell] > 0.0, "liquid outside the band");
    }
}
