//! `exchange` against its twin: what sinks remove and sources make, and what sources do to faces.

use cutwater::fields::{LiquidBuffers, LiquidPlan, Report, Sinks, SourceStep, Sources};
use cutwater::geometry::{CutCells, MARKERS_PER_CELL, Running, SourcesAndSinks, obstacle_cut};
use cutwater::gpu::{Dispatches, Gpu, Kernel, Real, Recorder};
use cutwater::grid::{Axis, Grid, Sides};
use cutwater::reference;
use cutwater::scene::{Scene, VectorKeyframe};
use glam::DVec3;

use crate::common::{Random, far_below, gpu, surface};
use crate::liquid_case::{Case, EPS, GRAVITY, assert_close, single};

/// Sources and sinks that overlap each other, an obstacle and walls, in a grid whose rows have one spare cell.
pub(crate) fn scene() -> Scene {
    let text = "[domain]\nsize = [1.5, 1.0, 1.1]\ncells = [15, 10, 11]\n[time]\nduration = 1.0\n[liquid]\nsurface = \"markers\"\n\
                [[obstacle]]\nsphere = { centre = [0.5, 0.5, 0.5], radius = 0.25 }\n\
                [[source]]\nbox = { min = [0.3, 0.4, 0.3], max = [0.9, 0.7, 0.6] }\nvelocity = [1.0, -0.5, 0.0]\n\
                [[source]]\nsphere = { centre = [0.9, 0.6, 0.5], radius = 0.21 }\nvelocity = [-2.0, 0.0, 0.25]\nstart = 0.5\n\
                [[source]]\nbox = { min = [1.4, 0.0, 0.9], max = [1.5, 0.1, 1.1] }\nvelocity = [0.0, 1.0, 0.0]\n\
                [[sink]]\nbox = { min = [0.8, 0.5, 0.4], max = [1.3, 0.8, 0.8] }\n\
                [[sink]]\ncylinder = { base = [0.1, 0.0, 0.1], axis = [0, 1, 0], radius = 0.12, height = 1.0 }\n";
    Scene::parse(std::path::Path::new("taps.toml"), text, &[], 1.0).unwrap()
}

/// Grid and cut cells of a scene with cells of 0.1 m as stored on the device, with its sources and sinks.
pub(crate) fn stored(scene: &Scene) -> (Grid, CutCells, SourcesAndSinks) {
    let grid = Grid { dx: f64::from(0.1_f32), ..scene.grid() };
    let mut cut = obstacle_cut(scene, &scene.grid()).unwrap().cut;
    for values in cut.open.iter_mut().chain([&mut cut.solid_distance]) {
        values.iter_mut().for_each(|value| *value = single(*value));
    }
    let taps = SourcesAndSinks::new(scene, &scene.grid(), &cut).unwrap();
    (grid, cut, taps)
}

struct Run {
    case: Case,
    taps: SourcesAndSinks,
    buffers: LiquidBuffers,
}

impl Run {
    /// Cells with between none and twelve markers; those that a body covers in two of the sources lack some.
    fn new(gpu: &Gpu) -> Run {
        let scene = scene();
        let (grid, mut cut, taps) = stored(&scene);
        // A ball that came in later, a centre on a surface, and one that is as little inside as can be.
        let centre = DVec3::new(0.9, 0.6, 0.5);
        for (cell, distance) in cut.solid_distance.iter_mut().enumerate() {
            let ball = grid.cell_centre(grid.cell_at(cell)).distance(centre) - 0.12;
            *distance = single(distance.min(ball));
        }
        let at_surface = [0.0, -f64::from(f32::MIN_POSITIVE)];
        for (&(cell, _), distance) in taps.source_cells.iter().zip(at_surface) {
            cut.solid_distance[cell] = distance;
        }
        let effects = cutwater::effects::Effects::of(&scene);
        let filled = |[i, _, _]: [usize; 3], random: &mut Random| {
            let most = if i < 8 { 13 } else { MARKERS_PER_CELL as u64 };
            (random.bits() % most) as usize
        };
        let case = Case::around("taps", (grid, effects, cut), 3.0, filled);
        let buffers = LiquidBuffers::new(
            gpu,
            LiquidPlan {
                grid,
                effects,
                n_markers: case.state.markers.len() + MARKERS_PER_CELL * taps.source_cells.len(),
                cfl: case.cfl,
                real: Real::F32,
            },
        )
        .unwrap();
        Run { case, taps, buffers }
    }

    /// Starts again; the number of markers.
    fn write(&self, gpu: &Gpu) -> usize {
        self.case.write(gpu, &self.buffers);
        let n = self.case.state.markers.len();
        let slots = MARKERS_PER_CELL * self.taps.source_cells.len();
        let step = cutwater::fields::Step { n_markers: (n + slots) as u32, ..self.case.step() };
        gpu.upload(&self.buffers.step, &[step]);
        n
    }
}

pub(crate) fn runs() -> [Running; 4] {
    [(0b101, 0b001), (0b111, 0b010), (0b000, 0), (0b010, 0b010)].map(|(running, starting)| Running {
        running,
        starting,
        seed: 17,
        step: 1 << 31 | running,
    })
}

#[test]
fn markers_come_and_go_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let run = Run::new(gpu);
    let grid = &run.case.grid;
    for running in runs() {
        let sources = Sources::new(gpu, &run.buffers, &run.taps).unwrap().unwrap();
        let [seeding, ..] = sources.stages(gpu, &run.buffers).unwrap();
        let sinks = Sinks::new(gpu, &run.buffers, &run.taps).unwrap().unwrap();
        let exchange = sinks.exchange(gpu, &run.buffers, None).unwrap();
        let go = || {
            let n = run.write(gpu);
            sources.write_step(gpu, SourceStep::new(running, n), &[]);
            let mut recorder = Recorder::new(gpu);
            exchange.record(&mut recorder);
            seeding.record(&mut recorder);
            recorder.submit();
            let positions = run.buffers.markers.as_ref().unwrap();
            (gpu.download(positions).unwrap(), gpu.download(&run.buffers.report).unwrap())
        };
        let (markers, report) = go();
        assert!((markers.clone(), report.clone()) == go(), "again");
        let (mut twin, sunk) = reference::sink_markers(grid, &run.taps, run.case.state.markers.clone());
        let n_kept = twin.len();
        let seeded = reference::seed_markers(grid, &run.taps, running, &run.case.cut.solid_distance, &mut twin);
        let of_step = Report::from_words(&report);
        assert!(sunk > 0);
        assert_eq!(u64::from(report[18]), sunk, "sinking");
        assert_eq!([of_step.emitted, of_step.filled].map(u64::from), [seeded.emitted, seeded.filled]);
        assert_eq!(seeded.emitted > 0, running.running != 0);
        let alive: Vec<_> = markers.iter().filter(|marker| marker[3] != 0.0).collect();
        assert_eq!(alive.len(), twin.len());
        let bound = EPS * grid.dx * 8.0 * run.case.extent();
        assert_close(
            "positions",
            alive.iter().zip(&twin).enumerate().flat_map(|(index, (gpu, twin))| {
                let bound = if index < n_kept { 0.0 } else { bound };
                (0..3).map(move |a| (f64::from(gpu[a]), twin[a], bound, [index, a, 0]))
            }),
        );
        // The eighths to keep full have one or more, unless the centre of the cell is in a body, and each new one is in such an eighth.
        let covered = |cell: usize| run.case.cut.solid_distance[cell] < 0.0;
        let mut counts = vec![0; run.taps.source_cells.len()];
        for (index, x) in twin.iter().enumerate() {
            let at = grid.cell(std::array::from_fn(|a| (x[a] / grid.dx) as usize));
            assert!(!covered(at) || index < n_kept, "{x:?} is in a body");
            let found = run.taps.source_cells.binary_search_by_key(&at, |&(cell, _)| cell);
            assert!(found.is_ok() || index < n_kept, "{x:?} is in no source");
            if let Ok(found) = found {
                let low = grid.cell_at(at);
                let upper = |a: usize| usize::from(x[a] / grid.dx - low[a] as f64 >= 0.5);
                let eighth = upper(0) | upper(1) << 1 | upper(2) << 2;
                let full = run.taps.eighths[found] >> eighth & 1 == 1;
                assert!(full || index < n_kept, "{x:?} is beside its source");
                counts[found] += u32::from(full);
            }
        }
        let mut lack = 0;
        let eighths = run.taps.eighths.iter().map(|eighths| eighths.count_ones());
        for ((&(cell, source), full), &count) in run.taps.source_cells.iter().zip(eighths).zip(&counts) {
            let runs = running.running >> source & 1 == 1;
            assert!(count >= full || !runs || covered(cell));
            lack += usize::from(count < full && runs);
        }
        assert_eq!(lack > 0, running.running != 0, "the ball is in both");
    }
}

#[test]
fn faces_of_sources_carry_what_they_do_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let run = Run::new(gpu);
    let (grid, cut) = (&run.case.grid, &run.case.cut);
    let sources = Sources::new(gpu, &run.buffers, &run.taps).unwrap().unwrap();
    let [_, forces, write_back] = sources.stages(gpu, &run.buffers).unwrap();
    for running in runs() {
        let n = run.write(gpu);
        sources.write_step(gpu, SourceStep::new(running, n), &[]);
        let u = &run.case.state.velocity;
        gpu.upload(&run.buffers.velocity_next, &run.buffers.pad_faces(u));
        let mut recorder = Recorder::new(gpu);
        forces.record(&mut recorder);
        recorder.submit();
        let mut twin = u.clone();
        reference::hold_faces(&run.taps, &cut.open, running.running, &mut twin);
        assert_eq!(run.buffers.read_faces(gpu, &run.buffers.velocity_next).unwrap(), twin);
        rewinds_as_in_the_twin(gpu, &run, &sources, running);
        let flux_open = run.taps.flux_apertures(&cut.open, running.running);
        let solve_open = run.buffers.read_faces(gpu, run.buffers.solve_open()).unwrap();
        let fractions = |of: fn(f64) -> f64| {
            let axis = |faces: &Vec<f64>| faces.iter().map(|&open| of(open)).collect();
            solve_open.each_ref().map(axis)
        };
        let fluxes: [Vec<f64>; 3] = fractions(f64::abs);
        assert_eq!(fluxes, flux_open);
        let partly = |(held, open): (&f64, &f64)| *held < *open && *held > 0.0;
        let x = flux_open[0].iter().zip(&cut.open[0]).any(partly);
        assert_eq!(x, running.running & 0b10 != 0, "a ball covers faces in part");
        let held = run.taps.pressure_apertures(&cut.open, running.running);
        let closed: [Vec<f64>; 3] = fractions(|open| open.max(0.0));
        assert_eq!(closed, held);
        let bit = |words: &[u32], axis: Axis, face: usize, first: usize| {
            let index = grid.padded().index(grid.face_at(axis, face));
            words[index / 4] >> (first + 4 * axis.index() + index % 4) & 1 == 1
        };
        let mut recorder = Recorder::new(gpu);
        write_back.record(&mut recorder);
        recorder.submit();
        let words = gpu.download(&run.buffers.valid).unwrap();
        let mut valid = Axis::ALL.map(|axis| vec![false; grid.n_faces(axis)]);
        reference::carry_faces(&run.taps, &cut.open, running.running, &mut twin, &mut valid);
        let velocity = run.buffers.read_faces(gpu, &run.buffers.velocity).unwrap();
        for axis in Axis::ALL {
            let a = axis.index();
            for (face, &open) in cut.open[a].iter().enumerate() {
                assert_eq!(bit(&words, axis, face, 16), open > 0.0, "{axis:?} {face}");
                assert_eq!(bit(&words, axis, face, 0), valid[a][face], "{axis:?} {face}");
                assert!(!valid[a][face] || velocity[a][face] == twin[a][face]);
            }
        }
    }
}

/// The faces of running sources have their velocity half a sub-step of gravity earlier, and others keep theirs.
fn rewinds_as_in_the_twin(gpu: &Gpu, run: &Run, sources: &Sources, running: Running) {
    let before = &run.case.state.velocity;
    gpu.upload(&run.buffers.velocity, &run.buffers.pad_faces(before));
    let kernel = Kernel::new(gpu, &cutwater::wgsl!("rewind_sources"), Real::F32).unwrap();
    let mut recorder = Recorder::new(gpu);
    let rewind = kernel.bind(gpu, &[], &[sources, &run.buffers]).unwrap().threads(run.taps.faces.len());
    Dispatches::new("rewind", [rewind]).record(&mut recorder);
    recorder.submit();
    let device = run.buffers.read_faces(gpu, &run.buffers.velocity).unwrap();
    let mut twin = before.clone();
    let fall = DVec3::from(GRAVITY) * 0.5 * run.case.dt;
    reference::rewind_sources(&run.taps, &run.case.cut.open, running.running, fall, &mut twin);
    let changed = |a: usize| twin[a].iter().zip(&before[a]).any(|(after, before)| after != before);
    assert_eq!((0..3).any(changed), running.running != 0);
    // The products of a step and half of gravity, and a difference.
    let bound = EPS * (2.0 * fall.abs().max_element() + 2.0);
    for (device, (twin, before)) in device.iter().zip(twin.iter().zip(before)) {
        for (device, (twin, before)) in device.iter().zip(twin.iter().zip(before)) {
            assert!(f64::abs(device - twin) <= if twin == before { 0.0 } else { bound }, "{device}, {twin}");
        }
    }
}

/// Into a source nothing flows: what comes out is its velocity times the area that it shows.
#[test]
fn a_source_emits_its_velocity_times_its_area() {
    let text = "[domain]\nsize = [1.0, 1.0, 1.0]\ncells = [10, 10, 10]\n[time]\nduration = 1.0\n[liquid]\n\
                [[source]]\nbox = { min = [0.3, 0.4, 0.2], max = [0.6, 0.6, 0.7] }\nvelocity = [2.0, 0.0, -1.0]\n\
                [[source]]\nbox = { min = [0.0, 0.0, 0.0], max = [0.2, 0.1, 0.1] }\nvelocity = [0.0, -3.0, 0.0]\nend = 0.5\n";
    let scene = Scene::parse(std::path::Path::new("flux.toml"), text, &[], 1.0).unwrap();
    let grid = scene.grid();
    let cut = obstacle_cut(&scene, &grid).unwrap().cut;
    let taps = SourcesAndSinks::new(&scene, &grid, &cut).unwrap();
    assert_eq!(taps.source_cells.len(), 3 * 2 * 5 + 2);
    assert!((taps.flux(1) - (2.0 * 0.2 * 0.5 + 1.0 * 0.3 * 0.2)).abs() < 1e-12);
    // The floor closes the only face that the second could emit through.
    assert_eq!(taps.flux(2), 0.0);
    let held = |axis: Axis, at: [usize; 3]| {
        let face = grid.face(axis, at);
        let found = taps.faces.iter().find(|of| of.axis == axis && of.face == face);
        found.unwrap().prescribed(1).map(|held| held.velocity)
    };
    assert_eq!(held(Axis::X, [3, 5, 4]), Some(0.0), "behind it is a wall");
    assert_eq!(held(Axis::X, [4, 5, 4]), Some(2.0));
    assert_eq!(held(Axis::X, [6, 5, 4]), Some(2.0));
    assert_eq!(held(Axis::Z, [4, 5, 2]), Some(-1.0));
    assert_eq!(held(Axis::Z, [4, 5, 7]), Some(0.0));
    assert_eq!(held(Axis::Y, [4, 4, 4]), Some(0.0));
    // Three cells thick along x: with cfl 3 as fast as it is, with 6 sub-steps are shorter.
    let speed = |time, cfl| taps.speed(time, [0.0, 0.04], cfl);
    assert!((speed(0.6, 3.0) - 2.0).abs() < 1e-12);
    assert!((speed(0.6, 6.0) - 4.0).abs() < 1e-12);
    assert!((speed(0.1, 6.0) - 18.0).abs() < 1e-12, "{}", speed(0.1, 6.0));
}

/// With a level a jet has the same markers for all lengths of the sub-steps, and the density of liquid.
#[test]
fn the_markers_of_a_jet_do_not_depend_on_the_sub_steps() {
    let text = "[domain]\nsize = [1.0, 1.0, 1.0]\ncells = [10, 10, 10]\n[time]\nduration = 1.0\n[liquid]\nsurface = \"level\"\n\
                [[source]]\nbox = { min = [0.1, 0.3, 0.3], max = [0.3, 0.7, 0.65] }\nvelocity = [1.5, 0.0, 0.0]\n";
    let scene = Scene::parse(std::path::Path::new("jet.toml"), text, &[], 1.0).unwrap();
    let grid = scene.grid();
    let cut = obstacle_cut(&scene, &grid).unwrap().cut;
    let taps = SourcesAndSinks::new(&scene, &grid, &cut).unwrap();
    let duration = 0.4;
    let jet = |n_steps: usize| {
        let dt = duration / n_steps as f64;
        let mut markers: Vec<[f64; 3]> = Vec::new();
        for step in 0..n_steps {
            let running = Running { running: 1, starting: u32::from(step == 0), seed: 17, step: step as u32 };
            markers.iter_mut().for_each(|x| x[0] += 1.5 * dt);
            let lattices = taps.lattices(&grid, step as f64 * dt, dt);
            reference::emit_markers(&grid, &taps, running, &lattices, &cut.solid_distance, &mut markers);
        }
        // Those that passed the outlet after the first sub-step.
        let end = 0.3 + 1.5 * (duration - dt);
        markers.retain(|x| x[0] < end);
        markers.sort_by(|a, b| a[0].total_cmp(&b[0]));
        (markers, end)
    };
    let (long, end) = jet(4);
    for n_steps in [8, 32, 256] {
        let (short, _) = jet(n_steps);
        let short: Vec<_> = short.into_iter().filter(|x| x[0] < end).collect();
        assert_eq!(short.len(), long.len(), "{n_steps}");
        for (a, b) in short.iter().zip(&long) {
            // A place is rounded to half a unit of an octant of 0.05 m, at its emission.
            let off = (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f64::max);
            assert!(off <= 0.05 / 65536.0, "{n_steps}: {off}");
        }
    }
    // Across the jet octants are cells of the lattice, 8 by 7. Along it up to a layer at the ends is there or not.
    let layers = (end - 0.1) / 0.05;
    let off = long.len() as f64 / (8.0 * 7.0) - layers;
    assert!(off.abs() <= 1.0, "{off} layers");
}

/// With a velocity over time too: lattice and liquid move alike but for the changes of the displacement from one sub-step to the next. Sites
/// in these are there or not at random.
#[test]
fn the_markers_of_a_jet_over_time_have_the_density_of_liquid() {
    let text = "[domain]\nsize = [1.0, 1.0, 1.0]\ncells = [10, 10, 10]\n[time]\nduration = 1.0\n[liquid]\nsurface = \"level\"\n\
                [[source]]\nbox = { min = [0.1, 0.3, 0.3], max = [0.3, 0.7, 0.65] }\n\
                velocity_keyframes = [{ t = 0, velocity = [0.5, 0, 0] }, { t = 0.1, velocity = [2, 0, 0] }, { t = 0.4, velocity = [0.1, 0, 0] }]\n";
    let scene = Scene::parse(std::path::Path::new("jet.toml"), text, &[], 1.0).unwrap();
    let grid = scene.grid();
    let cut = obstacle_cut(&scene, &grid).unwrap().cut;
    let mut taps = SourcesAndSinks::new(&scene, &grid, &cut).unwrap();
    let speed = |times| VectorKeyframe::mean(&scene.sources[0].keyframes, times).x;
    for n_steps in [4, 8, 32, 256] {
        let dt = 0.4 / n_steps as f64;
        let mut markers: Vec<[f64; 3]> = Vec::new();
        let (mut moved, mut changes) = (0.0, 0.0);
        for step in 0..n_steps {
            let time = step as f64 * dt;
            let dt_last = if step == 0 { 0.0 } else { dt };
            taps.set_velocities(time, [dt_last, dt]);
            let running = Running { running: 1, starting: u32::from(step == 0), seed: 17, step: step as u32 };
            let lattices = taps.lattices(&grid, time, dt);
            reference::emit_markers(&grid, &taps, running, &lattices, &cut.solid_distance, &mut markers);
            if step > 0 {
                let before = dt * speed([time - dt, time]);
                moved += before;
                changes += (before - dt * speed([time, time + dt])).abs();
            }
        }
        let (layers, changes) = ((0.2 + moved) / 0.05, changes / 0.05);
        let off = markers.len() as f64 / (8.0 * 7.0) - layers;
        // A layer at the ends, and three standard deviations of 56 sites.
        assert!(off.abs() <= 1.0 + 3.0 * (changes / 56.0).sqrt(), "{n_steps}: {off} layers of {layers}");
    }
}

/// A body that has come into a source: cells with their centre in it get nothing. In the others what it puts out stays beside it, so they
/// are full soon.
#[test]
fn no_cell_of_a_source_is_filled_for_ever() {
    let text = "[domain]\nsize = [1.0, 1.0, 1.0]\ncells = [10, 10, 10]\n[time]\nduration = 1.0\n[liquid]\n\
                [[source]]\nbox = { min = [0.3, 0.3, 0.3], max = [0.7, 0.7, 0.7] }\nvelocity = [0.0, -1.0, 0.0]\n";
    let scene = Scene::parse(std::path::Path::new("covered.toml"), text, &[], 1.0).unwrap();
    let grid = scene.grid();
    let cut = obstacle_cut(&scene, &grid).unwrap().cut;
    let taps = SourcesAndSinks::new(&scene, &grid, &cut).unwrap();
    let at_rest = Axis::ALL.map(|axis| vec![0.0; grid.n_faces(axis)]);
    let far = far_below(&grid);
    let normals = [DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::new(0.5, -1.0, 0.75)];
    for normal in normals.map(DVec3::normalize) {
        for level in [-0.13, -0.01, 0.0, 0.03] {
            let height = |cell| normal.dot(grid.cell_centre(grid.cell_at(cell)) - 0.5) - level;
            let solid_distance: Vec<f64> = (0..grid.n_cells()).map(height).collect();
            let cells = taps.source_cells.iter();
            let free = cells.filter(|(cell, _)| solid_distance[*cell] >= 0.0);
            let n_free = free.count() as u64;
            let mut markers: Vec<[f64; 3]> = Vec::new();
            let mut emitted: Vec<u64> = Vec::new();
            for step in 0..32 {
                let running = Running { running: 1, starting: 0, seed: 17, step };
                (markers, _) = reference::advect_markers(
                    &grid,
                    Sides::default(),
                    &at_rest,
                    &solid_distance,
                    &surface(&grid, &far),
                    &reference::Ballistic::NONE,
                    &markers,
                    0.01,
                );
                let seeded = reference::seed_markers(&grid, &taps, running, &solid_distance, &mut markers);
                emitted.push(seeded.emitted);
            }
            let what = format!("{normal}, {level}: {emitted:?}");
            assert!((1..64).contains(&n_free), "{what}");
            assert_eq!(emitted[0], 8 * n_free, "{what}");
            assert!(emitted.iter().sum::<u64>() <= 9 * n_free, "{what}");
            assert!(emitted[16..].iter().all(|&n| n == 0), "{what}");
        }
    }
}
