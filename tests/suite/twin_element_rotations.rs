//! `solid_matrices`, what the elements make of the displacements, against the twin.

use std::sync::Arc;

use cutwater::elastic::{self, Deformation};
use cutwater::fields::SolidBuffers;
use cutwater::gpu::{Gpu, Real, Recorder};
use cutwater::reference::{self, BlockPattern};
use cutwater::scene::ElasticModel;
use cutwater::stages::element_rotations;
use glam::{DMat3, DVec3, DVec4};

use crate::common::{Random, gpu, root};
use crate::liquid_case::{assert_close, single};
use crate::solid_case::{Material, RUBBER, SolidCase, bent_beam, cases, eps, pair, solids};

/// What the stage finds for an element.
struct Found {
    /// Rotated gradients of corners 1, 2, 3, 1/m.
    rotated: DMat3,
    /// zeta_K V lambda, zeta_K V mu, det F.
    fourth: [f64; 3],
    /// K x* - b at corners 1, 2, 3, N.
    forces: DMat3,
    /// J
    energy: f64,
}

fn elements(gpu: &Gpu, buffers: &SolidBuffers) -> Vec<Found> {
    let stage = element_rotations(gpu, buffers).unwrap();
    let mut recorder = Recorder::new(gpu);
    stage.record(&mut recorder);
    recorder.submit();
    let rotated = buffers.rotated.download(gpu).unwrap();
    let forces = buffers.element_forces.download(gpu).unwrap();
    let n = buffers.plan.n_elements;
    let sections = |values: &[f64], element: usize| {
        [0, 1, 2].map(|section| DVec4::from_slice(&values[4 * (section * n + element)..]))
    };
    let columns = |sections: [DVec4; 3]| {
        let [a, b, c] = sections.map(DVec4::truncate);
        DMat3::from_cols(a, b, c)
    };
    (0..n)
        .map(|element| {
            let (rotated, forces) = (sections(&rotated, element), sections(&forces, element));
            assert_eq!([forces[1].w, forces[2].w], [0.0; 2], "spare words");
            Found {
                rotated: columns(rotated),
                fourth: rotated.map(|section| section.w),
                forces: columns(forces),
                energy: forces[0].w,
            }
        })
        .collect()
}

/// Displacements of the corners of an element, m.
fn corners(case: &SolidCase, element: usize) -> [DVec3; 4] {
    case.solids.elements[element].map(|node| DVec3::from(case.displacement[node as usize]))
}

/// The rotation in rotated gradients: R = (R G) G^-1.
fn rotation_in(gradients: &[DVec3; 4], rotated: DMat3) -> DMat3 {
    rotated * DMat3::from_cols(gradients[1], gradients[2], gradients[3]).inverse()
}

fn norm(m: DMat3) -> f64 {
    m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Largest singular value of F, and the sum of the two least, that of the last with the sign of det F: what turns errors of F
/// into errors of its rotation.
fn stretches(f: DMat3) -> (f64, f64) {
    let s = elastic::rotation(f).transpose() * f;
    // Power iteration: F F^T is positive, and its largest eigenvalue is enough.
    let mut v = DVec3::new(0.6, 0.5, 0.7);
    for _ in 0..200 {
        v = (f.transpose() * (f * v)).normalize_or_zero();
    }
    let first = (f * v).length();
    (first, (s.x_axis.x + s.y_axis.y + s.z_axis.z - first).max(0.0))
}

/// Whether a rotation is proper to rounding, and as near to F as the twin's.
fn assert_nearest(what: &str, f: DMat3, rotation: DMat3, rounding: f64) {
    let off = norm(rotation.transpose() * rotation - DMat3::IDENTITY);
    assert!(off <= 8.0 * rounding, "{what}: {off:e} from orthogonal");
    let determinant = rotation.determinant();
    assert!(determinant > 0.5, "{what}: determinant {determinant}");
    let (distance, twin) = (norm(f - rotation), norm(f - elastic::rotation(f)));
    assert!(distance <= twin + 8.0 * rounding * (1.0 + norm(f)), "{what}: {distance} from F, the twin {twin}");
}

#[test]
fn elements_are_those_of_the_twin() {
    let Some(gpu) = gpu() else { return };
    for case in cases() {
        let pattern = Arc::new(BlockPattern::new(&case.solids));
        let twin = reference::solid_matrices(&case.solids, &pattern, &case.displacement);
        for real in SolidCase::reals(gpu) {
            let buffers = case.upload(gpu, real);
            for (element, found) in elements(gpu, &buffers).iter().enumerate() {
                let what = format!("{} {real:?}, element {element}", case.name);
                assert_element(&what, &case, element, found, twin.deformations[element], real);
            }
        }
    }
}

fn assert_element(what: &str, case: &SolidCase, element: usize, found: &Found, mut twin: Deformation, real: Real) {
    let eps = eps(real);
    let solids = &case.solids;
    let body = solids.body_of_element(element);
    let (lambda, mu) = (body.lambda, body.mu);
    let (gradients, volume) = (&solids.gradients[element], solids.volume[element]);
    let u = corners(case, element);
    let f = DMat3::IDENTITY + twin.gradient;
    // A difference, a product with a rounded gradient, and sums of three terms and one.
    let terms: f64 = (1..4).map(|a| (u[a] - u[0]).length() * gradients[a].length()).sum();
    let error_f = 6.0 * eps * (1.0 + terms);
    let size = norm(f);
    let longest = gradients.iter().map(|g| g.length()).fold(0.0, f64::max);

    let zeta_k = case.dt + body.stiffness_damping;
    let scale = norm(f).powi(2) * 3.0;
    assert_close(
        what,
        [
            (found.fourth[0], zeta_k * volume * lambda, 6.0 * eps * zeta_k * volume * lambda),
            (found.fourth[1], zeta_k * volume * mu, 6.0 * eps * zeta_k * volume * mu),
            (found.fourth[2], twin.determinant(), scale * error_f + 6.0 * eps * scale * size),
        ]
        .into_iter()
        .enumerate()
        .map(|(index, (gpu, twin, bound))| (gpu, twin, bound, [element, index, 0])),
    );

    // The rotation. Where it is not determined to 10 %, one that is as near; what follows from it is then judged with it.
    let rotation = rotation_in(gradients, found.rotated);
    let amplified = norm(DMat3::from_cols(gradients[1], gradients[2], gradients[3]).inverse()) * longest;
    if body.model == ElasticModel::Corotational {
        assert_nearest(what, f, rotation, error_f + 4.0 * eps * amplified);
    }
    let (_, gap) = stretches(f);
    let mut error_r = if body.model == ElasticModel::Linear { eps } else { 4.0 * eps + 4.0 * error_f / gap };
    if error_r > 0.1 {
        error_r = 4.0 * (eps * amplified + error_f);
        twin.rotation = rotation;
        let turned_back = rotation.transpose() * f;
        twin.strain = 0.5 * (turned_back + turned_back.transpose()) - DMat3::IDENTITY;
    }
    let stress = elastic::stress(twin.strain, lambda, mu);
    let [_, f1, f2, f3] = elastic::forces(gradients, volume, &twin, lambda, mu);
    let forces = DMat3::from_cols(f1, f2, f3);
    // An error of the rotation turns the strain's frame, too.
    let error_strain = 3.0 * (error_f + size * error_r + eps * size);
    let stiffness = 2.0 * mu + 3.0 * lambda;
    let error_stress = stiffness * error_strain;
    let error_force = volume * longest * (error_stress + norm(stress) * (error_r + 8.0 * eps));
    let pairs = (0..9).flat_map(|c| {
        let (row, column) = (c % 3, c / 3);
        let gradient = gradients[column + 1];
        let rotated = (twin.rotation * gradient)[row];
        [
            (found.rotated.col(column)[row], rotated, gradient.length() * (error_r + 8.0 * eps)),
            (found.forces.col(column)[row], forces.col(column)[row], error_force),
        ]
        .map(|(gpu, twin, bound)| (gpu, twin, bound, [element, row, column]))
    });
    assert_close(what, pairs);
    let energy = volume * elastic::energy_density(twin.strain, lambda, mu);
    let error_energy = volume * (norm(stress) * error_strain + stiffness * error_strain.powi(2)) + 8.0 * eps * energy;
    assert_close(what, [(found.energy, energy, error_energy, [element, 0, 0])]);
}

/// Tetrahedra with nodes 0, e1, e2, e3 in their own corners of space, one for each deformation gradient: H is what the nodes are
/// displaced by.
fn with_gradients(gradients: &[DMat3]) -> SolidCase {
    let unit = cutwater::geometry::TetMesh {
        nodes: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        elements: vec![[0, 1, 2, 3]],
    };
    let parts: Vec<_> = gradients.iter().map(|_| (unit.clone(), RUBBER)).collect();
    let mut case = SolidCase::new("gradients", solids(&parts));
    for (element, f) in gradients.iter().enumerate() {
        for (axis, column) in (*f - DMat3::IDENTITY).to_cols_array_2d().into_iter().enumerate() {
            case.displacement[4 * element + axis + 1] = pair(column.into());
        }
    }
    case
}

/// F of such an element as the device has it: 1 + H in the scalar type, H from displacements.
fn rounded(case: &SolidCase, element: usize, real: Real) -> DMat3 {
    let [_, a, b, c] = corners(case, element);
    let h = DMat3::from_cols(a, b, c);
    let round = |m: DMat3| DMat3::from_cols_array(&m.to_cols_array().map(single));
    match real {
        Real::F32 => round(DMat3::IDENTITY + round(h)),
        Real::F64 => DMat3::IDENTITY + h,
    }
}

fn largest(m: DMat3) -> f64 {
    m.to_cols_array().into_iter().fold(0.0, |largest, x| f64::max(largest, x.abs()))
}

/// Reference rotations from a singular value decomposition with 40 digits (mpmath).
#[test]
fn rotations_are_the_nearest_proper_ones() {
    let Some(gpu) = gpu() else { return };
    let file = root().join("tests/data/polar_decomposition.csv");
    let text = std::fs::read_to_string(file).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#')).skip(1);
    let mut names = Vec::new();
    let (mut gradients, mut rotations) = (Vec::new(), Vec::new());
    for line in lines {
        let fields: Vec<&str> = line.split(',').collect();
        let numbers: Vec<f64> = fields[1..19].iter().map(|x| x.parse().unwrap()).collect();
        let rows = |first: usize| DMat3::from_cols_slice(&numbers[first..first + 9]).transpose();
        names.push(fields[0].to_owned());
        gradients.push(rows(0));
        rotations.push(rows(9));
    }
    assert!(names.len() >= 9, "{names:?}");
    for real in SolidCase::reals(gpu) {
        let case = with_gradients(&gradients);
        let found = elements(gpu, &case.upload(gpu, real));
        for (number, name) in names.iter().enumerate() {
            let f = rounded(&case, number, real);
            let rotation = found[number].rotated;
            assert_nearest(name, f, rotation, 2.0 * eps(real));
            // The reflection has no nearest rotation.
            if name != "inverted_mirror" {
                let error = largest(rotation - rotations[number]);
                let of_rounded = largest(rotation - elastic::rotation(f));
                println!("{real:?} {name:20} {error:.1e}, without rounding of F {of_rounded:.1e}");
                let bound = if real == Real::F32 { 1e-6 } else { 1e-13 };
                assert!(error <= bound, "{name} {real:?}: {error:e}");
                assert!(of_rounded <= bound, "{name} {real:?}: {of_rounded:e}, F as rounded");
            }
        }
    }
}

/// A random rotation.
fn turn(random: &mut Random) -> DMat3 {
    let q = DVec4::from(std::array::from_fn(|_| random.uniform(-1.0, 1.0)));
    DMat3::from_quat(glam::DQuat::from_vec4(q.normalize()))
}

#[test]
fn rotations_of_ugly_gradients_are_proper_and_as_near_as_rounding_allows() {
    let Some(gpu) = gpu() else { return };
    let mut random = Random(11);
    let kinds = [
        [1.0, 1.0, 1.0],
        [1.5, 1.0, 0.5],
        [10.0, 0.3, 0.3],
        [10.0, 0.5, -0.3],
        [1.0, 1.0, 1e-4],
        [1.0, 0.9, -1e-4],
        [1.0, 0.8, -0.5],
        [3.0, 1.0, -0.99],
        [1.0, 1e-3, 1e-3],
        [100.0, 1.0, 0.01],
        [1.0, 1.0, -1.0],
        [2.0, 1.0, -1.0],
        [1.0, 0.5, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1e-9, -1e-12],
        [1e-12, 1e-12, -1e-12],
        [0.0, 0.0, 0.0],
        [1e6, 1e6, -1e3],
    ];
    let gradients: Vec<(DMat3, [f64; 3])> = kinds
        .iter()
        .flat_map(|kind| std::iter::repeat_n(kind, 200))
        .map(|&kind| {
            let (u, v) = (turn(&mut random), turn(&mut random));
            (u * DMat3::from_diagonal(kind.into()) * v, kind)
        })
        .collect();
    let matrices: Vec<DMat3> = gradients.iter().map(|(f, _)| *f).collect();
    for real in SolidCase::reals(gpu) {
        let case = with_gradients(&matrices);
        let found = elements(gpu, &case.upload(gpu, real));
        for (element, (found, (_, kind))) in found.iter().zip(&gradients).enumerate() {
            let what = format!("{real:?} {kind:?}");
            let f = rounded(&case, element, real);
            assert_nearest(&what, f, found.rotated, 2.0 * eps(real));
            let error = 4.0 * eps(real) * (1.0 + kind[0] / (kind[1] + kind[2]));
            if error < 0.1 {
                let off = largest(found.rotated - elastic::rotation(f));
                assert!(off <= error, "{what}: {off:e} off, bound {error:e}");
            }
        }
    }
}

/// Largest error of a nodal acceleration of the bent beam, m/s^2, by elastic forces of this material.
fn acceleration_error(gpu: &Gpu, real: Real, with_low_parts: bool, material: Material) -> f64 {
    let mut case = bent_beam();
    let mesh = cutwater::geometry::TetMesh { nodes: case.solids.rest.clone(), elements: case.solids.elements.clone() };
    case.solids = solids(&[(mesh, material)]);
    let buffers = case.upload(gpu, real);
    if !with_low_parts {
        let mut parts = gpu.download(&buffers.displacement).unwrap();
        let n = case.solids.rest.len();
        parts[n..].fill([0.0; 4]);
        gpu.upload(&buffers.displacement, &parts);
    }
    let found = elements(gpu, &buffers);
    let solids = &case.solids;
    let body = &solids.bodies[0];
    let mut error = vec![DVec3::ZERO; solids.rest.len()];
    for (element, nodes) in solids.elements.iter().enumerate() {
        let gradients = &solids.gradients[element];
        let deformation = Deformation::new(gradients, corners(&case, element), body.model);
        let volume = solids.volume[element];
        let twin = elastic::forces(gradients, volume, &deformation, body.lambda, body.mu);
        for a in 1..4 {
            let off = found[element].forces.col(a - 1) - twin[a];
            error[nodes[a] as usize] += off;
            error[nodes[0] as usize] -= off;
        }
    }
    let nodes = error.iter().zip(&solids.mass);
    nodes.map(|(off, mass)| off.length() / mass).fold(0.0, f64::max)
}

/// numerics.md, section 3: what rounding leaves of the accelerations, which reach 8e3 (1.8e5) m/s^2. With the larger parts of the
/// displacements alone 0.04 (0.87), with both 0.013 (0.27) in f32; f64 arithmetic of f32 differences would leave 0.002 (0.05).
#[test]
fn forces_of_the_bent_beam_are_free_of_noise() {
    let Some(gpu) = gpu() else { return };
    let light = Material { young: 1e7, density: 500.0, ..RUBBER };
    for (material, bounds) in [(RUBBER, [0.045, 0.013, 2e-6]), (light, [1.0, 0.27, 4e-5])] {
        let error = |real, both| acceleration_error(gpu, real, both, material);
        let high = error(Real::F32, false);
        let both = error(Real::F32, true);
        println!("E {:e}: {high:.2e} {both:.2e} m/s^2", material.young);
        assert!(high <= bounds[0], "larger parts alone: {high} m/s^2");
        assert!(both <= bounds[1], "both parts in f32: {both} m/s^2");
        // Or the smaller parts do nothing.
        assert!(both <= 0.5 * high, "{both} with both parts, {high} with one");
        if gpu.has_f64() {
            let error = error(Real::F64, true);
            println!("f64: {error:.2e} m/s^2");
            assert!(error <= bounds[2], "in f64: {error} m/s^2");
        }
    }
}

/// Validation S8: a turned body carries no stress, whatever the angle.
#[test]
fn free_rotation_gives_no_force() {
    let Some(gpu) = gpu() else { return };
    let axis = DVec3::new(1.0, -2.0, 0.5).normalize();
    for degrees in [0.01, 1.0, 30.0, 90.0, 179.0, 180.0, 270.0] {
        let turn = DMat3::from_axis_angle(axis, f64::to_radians(degrees));
        let case = bent_beam().deformed(|x| DVec3::splat(0.5) + turn * (x - DVec3::splat(0.5)));
        for real in SolidCase::reals(gpu) {
            let found = elements(gpu, &case.upload(gpu, real));
            let largest = found.iter().map(|found| largest(found.forces)).fold(0.0, f64::max);
            // E times the area of a face of an element, m^2.
            let scale = RUBBER.young * 0.5 * 0.04 * 0.04;
            let bound = if real == Real::F32 { 1e-6 } else { 1e-13 };
            assert!(largest <= bound * scale, "{degrees} {real:?}: {largest} N of {scale}");
        }
    }
}
