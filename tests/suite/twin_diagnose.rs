//! `diagnose` against its twin.

use cutwater::gpu::{Real, Recorder};
use cutwater::grid::Axis;
use cutwater::reference::{self, liquid_distance};
use cutwater::stages::{Diagnose, Report, Volume};
use glam::DVec3;

use crate::common::gpu;
use crate::liquid_case::{
    ActiveBuffers, DENSITY, EPS, GRAVITY, RADIUS, assert_close, cases, single,
};

#[test]
fn the_liquid_amounts_to_the_twins() {
    let Some(gpu) = gpu() else { return };
    for mut case in cases() {
        let grid = case.grid;
        let (radius, markers) = (RADIUS * grid.dx, &case.state.markers);
        let phi: Vec<f64> = liquid_distance(&grid, &case.cut, markers, radius)
            .into_iter()
            .map(single)
            .collect();
        case.state.liquid_distance.clone_from(&phi);
        let active = ActiveBuffers::new(gpu, &case, &phi);
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
        let volume = Volume::new(gpu, &buffers).unwrap();
        let diagnose = Diagnose::new(gpu, &buffers, &active.active(), None).unwrap();
        let run = || {
            let mut recorder = Recorder::new(gpu);
            volume.record(&mut recorder);
            diagnose.record(&mut recorder, &buffers, &active.active());
            recorder.submit();
            gpu.download(&buffers.report).unwrap()
        };
        let words = run();
        assert_eq!(words, run(), "{}: again", case.name);
        let found = Report::from_words(&words).diagnosis;
        let twin = reference::diagnose(
            &case.cut,
            &phi,
            &u,
            &active.cells.stencil,
            None,
            DENSITY,
            DVec3::from(GRAVITY),
        );
        let deep = if buffers.partials.real == Real::F32 {
            64.0
        } else {
            0.0
        };
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
            (
                found.kinetic_energy,
                twin.kinetic_energy,
                rounding * mass * 3.0 * speed * speed,
            ),
            (
                found.potential_energy,
                twin.potential_energy,
                rounding * mass * height,
            ),
            (found.max_speed, twin.max_speed, 0.0),
            (
                found.divergence,
                twin.divergence,
                4.0 * rounding * 6.0 * speed / grid.dx,
            ),
        ];
        let places = pairs.into_iter().enumerate();
        assert_close(
            case.name,
            places.map(|(index, (gpu, twin, bound))| (gpu, twin, bound, [index, 0, 0])),
        );
    }
}

#[test]
fn not_a_number_is_seen() {
    let Some(gpu) = gpu() else { return };
    let mut case = cases().remove(0);
    case.state.velocity[1][40] = f64::NAN;
    let buffers = case.upload(gpu);
    case.band(gpu, &buffers);
    let active = ActiveBuffers::new(gpu, &case, &case.state.liquid_distance);
    let diagnose = Diagnose::new(gpu, &buffers, &active.active(), None).unwrap();
    let mut recorder = Recorder::new(gpu);
    diagnose.record(&mut recorder, &buffers, &active.active());
    recorder.submit();
    let report = Report::from_words(&gpu.download(&buffers.report).unwrap());
    assert!(
        report.diagnosis.max_speed.is_nan(),
        "{:?}",
        report.diagnosis
    );
}
