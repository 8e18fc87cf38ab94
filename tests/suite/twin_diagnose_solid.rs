//! `diagnose` of the solids against its twin.

use cutwater::fields::{SolidBuffers, SolidReport};
use cutwater::gpu::{Gpu, Real, Recorder};
use cutwater::reference;
use cutwater::stages::{diagnose_solid, element_rotations};
use cutwater::state::SolidDiagnosis;
use glam::DVec3;

use crate::common::gpu;
use crate::liquid_case::{GRAVITY, assert_close};
use crate::solid_case::{SolidCase, cases, eps};

fn words(gpu: &Gpu, buffers: &SolidBuffers) -> Vec<u32> {
    let rotations = element_rotations(gpu, buffers).unwrap();
    let diagnose = diagnose_solid(gpu, buffers).unwrap();
    let mut recorder = Recorder::new(gpu);
    rotations.record(&mut recorder);
    diagnose.record(&mut recorder);
    recorder.submit();
    gpu.download(&buffers.report).unwrap()
}

/// The twin.
fn twin(case: &SolidCase) -> SolidDiagnosis {
    let (solids, u) = (&case.solids, &case.displacement);
    reference::diagnose_solid(solids, &solids.deformations(u), u, &case.velocity, GRAVITY.into())
}

/// Sums of the magnitudes of the terms: of a component of the momentum, of the angular momentum, of the potential energy, and of the
/// energies that elements would have at a strain of one.
fn sizes(case: &SolidCase) -> [f64; 4] {
    let solids = &case.solids;
    let mut sizes = [0.0; 4];
    for (node, mass) in solids.mass.iter().enumerate() {
        let x = (solids.rest[node] + DVec3::from(case.displacement[node])).length();
        let v = DVec3::from(case.velocity[node]).length();
        let gravity = DVec3::from(GRAVITY).length();
        for (size, term) in sizes.iter_mut().zip([v, x * v, gravity * x]) {
            *size += mass * term;
        }
    }
    for body in &solids.bodies {
        let volume: f64 = solids.volume[body.elements.clone()].iter().sum();
        sizes[3] += volume * (body.lambda + body.mu);
    }
    sizes
}

#[test]
fn the_solids_amount_to_the_twins() {
    let Some(gpu) = gpu() else { return };
    for case in cases() {
        for real in SolidCase::reals(gpu) {
            let buffers = case.upload(gpu, real);
            let found = words(gpu, &buffers);
            assert_eq!(found, words(gpu, &buffers), "{}: again", case.name);
            let found = SolidReport::from_words(&found).diagnosis;
            let (twin, sizes) = (twin(&case), sizes(&case));
            // A rounding per term of a share and level of the tree; the report keeps 48 digits.
            let n = (case.solids.rest.len() + case.solids.elements.len()) as f64;
            let rounding = eps(real) * (16.0 + n / buffers.plan.n_summing() as f64) + 2f64.powi(-46);
            let mut pairs = vec![
                (found.kinetic_energy, twin.kinetic_energy, 4.0 * rounding * twin.kinetic_energy),
                (found.potential_energy, twin.potential_energy, 4.0 * rounding * sizes[2]),
            ];
            for axis in 0..3 {
                pairs.push((found.momentum[axis], twin.momentum[axis], rounding * sizes[0]));
                let bound = 4.0 * rounding * sizes[1];
                pairs.push((found.angular_momentum[axis], twin.angular_momentum[axis], bound));
            }
            let places = pairs.into_iter().enumerate();
            // The report's words are f32, and the least of them may be taken for zero.
            let underflow = f64::from(f32::MIN_POSITIVE);
            assert_close(
                case.name,
                places.map(|(index, (gpu, twin, bound))| (gpu, twin, bound + underflow, [index, 0, 0])),
            );
            // What the elements found is judged by their own test.
            let n = buffers.plan.n_elements;
            let forces = buffers.element_forces.download(gpu).unwrap();
            let energies = (0..n).map(|element| forces[4 * element + 3]);
            let energy: f64 = energies.sum();
            let rotated = buffers.rotated.download(gpu).unwrap();
            let determinants: Vec<f64> = (0..n).map(|element| rotated[4 * (2 * n + element) + 3]).collect();
            let least = determinants.iter().copied().fold(f64::INFINITY, f64::min);
            let inverted = determinants.iter().filter(|&&determinant| determinant <= 0.0).count();
            assert!((found.elastic_energy - energy).abs() <= rounding * energy + underflow, "{}", case.name);
            assert_eq!(found.min_det, f64::from(least as f32), "{}", case.name);
            assert_eq!(found.inverted, inverted, "{}", case.name);
            // WGSL permits devices to take denormals for zero.
            let flushed = twin.max_speed < underflow && found.max_speed == 0.0;
            assert!(flushed || found.max_speed == twin.max_speed, "{}: {}", case.name, found.max_speed);
            // In all they are the twin's too.
            let slack = if real == Real::F32 { 1e-4 } else { 1e-10 };
            let off = (found.elastic_energy - twin.elastic_energy).abs();
            let bound = slack * (twin.elastic_energy + eps(real) * sizes[3]);
            assert!(off <= bound, "{}: {off} J of {}", case.name, twin.elastic_energy);
            assert!(
                (found.min_det - twin.min_det).abs() <= 1e-5 * (1.0 + twin.min_det.abs()),
                "{}: {} and {}",
                case.name,
                found.min_det,
                twin.min_det
            );
        }
    }
}

#[test]
fn not_a_number_is_seen() {
    let Some(gpu) = gpu() else { return };
    for real in SolidCase::reals(gpu) {
        for bad in [f64::NAN, -f64::NAN, f64::INFINITY] {
            let mut case = cases().swap_remove(1);
            case.velocity[17][1] = bad;
            let found = SolidReport::from_words(&words(gpu, &case.upload(gpu, real))).diagnosis;
            assert!(!found.max_speed.is_finite(), "{found:?}");
            assert!(!found.kinetic_energy.is_finite(), "{found:?}");
            assert!(found.min_det.is_finite(), "{found:?}");
            let mut case = cases().swap_remove(1);
            case.displacement[17][2] = bad;
            let found = SolidReport::from_words(&words(gpu, &case.upload(gpu, real))).diagnosis;
            assert!(!found.min_det.is_finite(), "{found:?}");
            assert!(!found.elastic_energy.is_finite(), "{found:?}");
            assert!(found.max_speed.is_finite(), "{found:?}");
        }
    }
}
