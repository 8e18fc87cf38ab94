//! `diagnose` against its twin.

use cutwater::fields::Report;
use cutwater::gpu::{Real, Recorder};
use cutwater::grid::Axis;
use cutwater::reference::{self, liquid_distance};
use cutwater::stages;
use glam::DVec3;

use crate::common::{Random, gpu};
use crate::coupled_case::{self, quads};
use crate::liquid_case::{ActiveBuffers, DENSITY, EPS, GRAVITY, RADIUS, assert_close, cases, single};

#[test]
fn the_liquid_amounts_to_the_twins() {
    let Some(gpu) = gpu() else { return };
    for mut case in cases() {
        let grid = case.grid;
        let (radius, markers) = (RADIUS * grid.dx, &case.state.markers);
        let phi: Vec<f64> = liquid_distance(&grid, &case.cut, markers, radius).into_iter().map(single).collect();
        case.state.liquid_distance.clone_from(&phi);
        let active = ActiveBuffers::new(&case, &phi);
        let buffers = case.upload(gpu);
        case.band(gpu, &buffers);
        // Outside the band there is nothing.
        let in_band = case.in_band(gpu, &buffers);
        let mut u = case.state.velocity.clone();
        for axis in Axis::ALL {
            for (face, value) in u[axis.index()].iter_mut().enumerate() {
                *value *= f64::from(u8::from(in_band(grid.face_at(axis, face))));
            }
        }
        gpu.upload(&buffers.velocity, &buffers.pad_faces(&u));
        let volume = stages::measure_volume(gpu, &buffers).unwrap();
        let diagnose = stages::diagnose(gpu, (&buffers, None), &active.solver(gpu, Real::F32), None).unwrap();
        let run = || {
            let mut recorder = Recorder::new(gpu);
            volume.record(&mut recorder);
            diagnose.record(&mut recorder);
            recorder.submit();
            gpu.download(&buffers.report).unwrap()
        };
        let words = run();
        assert_eq!(words, run(), "{}: again", case.name);
        let found = Report::from_words(&words).diagnosis;
        let left = reference::divergence(&case.cut.open, &u, &active.cells.stencil, None);
        let twin = reference::diagnose(&grid, &case.cut, &phi, &u, left, DENSITY, DVec3::from(GRAVITY));
        let deep = if buffers.partials.real == Real::F32 { 64.0 } else { 0.0 };
        // Five powers of dx, which is an f32; with sums in f32 a rounding per term of a share and level of the tree.
        let rounding = EPS * (8.0 + deep);
        let mass = DENSITY * grid.size().element_product();
        let speed = case.speed();
        let height = 12.0 * grid.size().max_element();
        let pairs = [
            (found.volume, twin.volume, rounding * mass / DENSITY),
            (found.momentum[0], twin.momentum[0], rounding * mass * speed),
            (found.momentum[1], twin.momentum[1], rounding * mass * speed),
            (found.momentum[2], twin.momentum[2], rounding * mass * speed),
            (found.kinetic_energy, twin.kinetic_energy, rounding * mass * 3.0 * speed * speed),
            (found.potential_energy, twin.potential_energy, rounding * mass * height),
            (found.max_speed, twin.max_speed, 0.0),
            (found.divergence, twin.divergence, 4.0 * rounding * 6.0 * speed / grid.dx),
        ];
        let places = pairs.into_iter().enumerate();
        assert_close(case.name, places.map(|(index, (gpu, twin, bound))| (gpu, twin, bound, [index, 0, 0])));
    }
}

#[test]
fn not_a_number_is_seen() {
    let Some(gpu) = gpu() else { return };
    let mut case = cases().remove(0);
    case.state.velocity[1][40] = f64::NAN;
    let buffers = case.upload(gpu);
    case.band(gpu, &buffers);
    let active = ActiveBuffers::new(&case, &case.state.liquid_distance);
    let diagnose = stages::diagnose(gpu, (&buffers, None), &active.solver(gpu, Real::F32), None).unwrap();
    let mut recorder = Recorder::new(gpu);
    diagnose.record(&mut recorder);
    recorder.submit();
    let report = Report::from_words(&gpu.download(&buffers.report).unwrap());
    assert!(report.diagnosis.max_speed.is_nan(), "{:?}", report.diagnosis);
}

/// Where solids are, and that quads with patches count once, with what the solids take up. Each run has its largest divergence somewhere
/// else: in the cells of a node that alone moves, and beside a face that does.
#[test]
fn divergence_beside_solids_is_the_twins() {
    let Some(gpu) = gpu() else { return };
    for case in coupled_case::cases() {
        let name = case.liquid.name;
        let grid = case.liquid.grid;
        let (radius, markers) = (RADIUS * grid.dx, &case.liquid.state.markers);
        let phi = liquid_distance(&grid, &case.liquid.cut, markers, radius);
        let active = ActiveBuffers::new(&case.liquid, &phi);
        let (buffers, clip, velocity) = case.upload(gpu);
        let cut = stages::clip(gpu, &buffers, &clip).unwrap();
        let joint = case.joint(gpu);
        let solids = Some((&clip, &joint, &velocity));
        let diagnose = stages::diagnose(gpu, (&buffers, None), &active.solver(gpu, Real::F32), solids).unwrap();
        let mut recorder = Recorder::new(gpu);
        cut.record(&mut recorder);
        recorder.submit();
        case.liquid.band(gpu, &buffers);
        let coupling = case.clip.coupling();
        let stencil = &active.cells.stencil;
        let compare = |what: &str, u: &[Vec<f64>; 3], v: &[[f64; 3]]| {
            gpu.upload(&buffers.velocity, &buffers.pad_faces(u));
            velocity.upload(gpu, &quads(v));
            let mut recorder = Recorder::new(gpu);
            diagnose.record(&mut recorder);
            recorder.submit();
            let words = gpu.download(&buffers.report).unwrap();
            let found = Report::from_words(&words).diagnosis.divergence;
            let (mut flux, mut gross) = (vec![0.0; grid.n_cells()], 0.0);
            for (cell, pairs) in coupling.cells() {
                let sum = pairs.iter().map(|pair| pair.value.dot(v[pair.node].into()));
                flux[cell] = sum.sum();
                let sizes = pairs.iter().map(|pair| pair.value.abs().dot(DVec3::from(v[pair.node]).abs()));
                gross = f64::max(gross, (pairs.len() as f64 + 4.0) * sizes.sum::<f64>());
            }
            let twin = reference::divergence(&case.liquid.cut.open, u, stencil, Some(&flux));
            // Six products and sums of open areas and velocities, a rounding per pair, and two of the result.
            let speed = reference::max_speed(u);
            let bound = EPS * (16.0 * speed / grid.dx + gross / grid.cell_volume() + 2.0 * twin);
            assert_close(&format!("{name}, {what}"), [(found, twin, bound, [0; 3])]);
            twin
        };
        let u = &case.liquid.state.velocity;
        let still = Axis::ALL.map(|axis| vec![0.0; grid.n_faces(axis)]);
        let at_rest = vec![[0.0; 3]; case.velocity.len()];
        compare("both", u, &case.velocity);
        compare("liquid", u, &at_rest);
        compare("solids", &still, &case.velocity);
        let mut random = Random(41);
        let mut n_seen = 0;
        for _ in 0..12 {
            let pairs = coupling.pairs();
            if !pairs.is_empty() {
                let mut one = at_rest.clone();
                let node = pairs[random.uniform(0.0, pairs.len() as f64) as usize].node;
                one[node] = [0, 1, 2].map(|_| single(random.uniform(-1.0, 1.0)));
                n_seen += usize::from(compare("a node", &still, &one) > 0.0);
            }
            let axis = random.uniform(0.0, 3.0) as usize;
            let mut one = still.clone();
            let face = random.uniform(0.0, one[axis].len() as f64) as usize;
            one[axis][face] = single(random.uniform(-1.0, 1.0));
            compare("a face", &one, &at_rest);
        }
        let touch = coupling.cells().any(|(cell, _)| stencil.active(cell));
        assert_eq!(touch, n_seen > 0, "{name}");
    }
}
