//! Elements of solids in f64, and the solids of a scene, against closed forms and tables of other programs.

use cutwater::elastic::{
    Deformation, Solids, energy_density, forces, lame_parameters, rest_shape, rotation, stiffness_block, stress,
    von_mises,
};
use cutwater::geometry::TetMesh;
use cutwater::scene::{ElasticModel, Keyframe, Load, LoadKind, Pin, Placement, Shape, SolidMesh};
use glam::{DMat3, DVec3};

use crate::common::Random;
use crate::solid_scene::{alone, block, displaced, noise, rows, scene_of, solids_of};

/// A matrix from its rows.
fn by_rows(numbers: &[f64]) -> DMat3 {
    DMat3::from_cols_slice(numbers).transpose()
}

/// Largest magnitude of an entry.
fn largest(m: DMat3) -> f64 {
    m.to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max)
}

fn frobenius(m: DMat3) -> f64 {
    m.to_cols_array().into_iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn random_matrix(random: &mut Random, size: f64) -> DMat3 {
    DMat3::from_cols_array(&std::array::from_fn(|_| random.uniform(-size, size)))
}

/// A random rotation, uniform enough.
pub(crate) fn random_rotation(random: &mut Random) -> DMat3 {
    let mut direction = || DVec3::from_array(std::array::from_fn(|_| random.uniform(-1.0, 1.0))).normalize();
    let (a, b) = (direction(), direction());
    let angle = random.uniform(-3.1, 3.1);
    DMat3::from_axis_angle(a, angle) * DMat3::from_axis_angle(b, 0.7 * angle)
}

/// R^T R = I and det R = 1.
fn assert_proper(r: DMat3, what: &str) {
    let defect = largest(r.transpose() * r - DMat3::IDENTITY);
    assert!(defect < 1e-14, "{what}: {r} is not orthogonal by {defect:e}");
    let determinant = r.determinant();
    assert!((determinant - 1.0).abs() < 1e-14, "{what}: det R = {determinant}");
}

/// S12.
#[test]
fn rotations_agree_with_forty_digits() {
    let mut cases = 0;
    for row in rows(include_str!("../data/polar_decomposition.csv")) {
        let numbers: Vec<f64> = row[1..].iter().map(|x| x.parse().unwrap()).collect();
        let (f, exact) = (by_rows(&numbers[..9]), by_rows(&numbers[9..18]));
        let r = rotation(f);
        assert_proper(r, row[0]);
        let (distance, least) = (frobenius(f - r), frobenius(f - exact));
        assert!(distance <= least * (1.0 + 1e-6) + 1e-14, "{}: {distance} from F, where {least} is possible", row[0]);
        // Reflections have no single nearest rotation: the three smallest singular values are equal.
        let unique = row[0] != "inverted_mirror";
        let error = largest(r - exact);
        assert!(error <= 1e-12 || !unique, "{}: off by {error:e}", row[0]);
        cases += 1;
    }
    assert_eq!(cases, 9);
}

/// Products of known factors: R = U V^T is known too. The error allowed is that of F itself, magnified by the largest singular value over the
/// sum of the smallest two (the difference where det F < 0).
#[test]
fn rotations_of_made_up_gradients_are_those_of_their_factors() {
    let mut random = Random(3);
    let stretches = [
        [1.0, 1.0, 1.0],
        [2.0, 0.5, 0.25],
        [1.3, 1.1, -0.2],
        [10.0, 0.3, 0.3],
        [1.0, 1e-3, 1e-4],
        [1.0, 1.0, 1e-8],
        [1.0, 1.0, 0.0],
        [1.0, 0.5, -0.4],
        [1e-30, 2e-30, 3e-30],
        [1e200, 2e200, -1e199],
        [1.0, 1e-5, 0.0],
    ];
    for stretch in stretches {
        for _ in 0..200 {
            let (u, v) = (random_rotation(&mut random), random_rotation(&mut random));
            let f = u * DMat3::from_diagonal(stretch.into()) * v.transpose();
            let r = rotation(f);
            assert_proper(r, &format!("{stretch:?}"));
            let mut sizes = stretch.map(f64::abs);
            sizes.sort_by(f64::total_cmp);
            let sign = stretch.iter().product::<f64>().signum();
            let gap = sizes[1] + if sign < 0.0 { -sizes[0] } else { sizes[0] };
            let bound = 1e-14 * (1.0 + sizes[2] / gap);
            let error = largest(r - u * v.transpose());
            assert!(error <= bound, "{stretch:?}: off by {error:e}, allowed {bound:e}");
        }
    }
}

/// No rotation is nearer than the returned one: none of many others, and none of its own neighbours.
#[test]
fn no_rotation_is_nearer_to_an_ugly_gradient() {
    let mut random = Random(17);
    let mut column = || DVec3::from_array(std::array::from_fn(|_| random.uniform(-1.0, 1.0)));
    let mut gradients = vec![
        DMat3::ZERO,
        DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)),
        -DMat3::IDENTITY,
        DMat3::from_diagonal(DVec3::new(0.0, 3.0, 0.0)),
        DMat3::from_diagonal(DVec3::new(-2.0, 0.0, 0.0)),
        DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.0)),
        DMat3::from_diagonal(DVec3::new(1e-200, -1.0, 1e-200)),
        DMat3::from_cols(DVec3::X, DVec3::X, DVec3::X),
    ];
    for _ in 0..40 {
        let (a, b) = (column(), column());
        // Rank one, rank two, and whatever comes.
        gradients.push(DMat3::from_cols(a * b.x, a * b.y, a * b.z));
        gradients.push(DMat3::from_cols(a, b, a - 2.0 * b));
        gradients.push(DMat3::from_cols(a, b, column()));
    }
    for f in gradients {
        let r = rotation(f);
        assert_proper(r, &format!("{f}"));
        assert_eq!(r, rotation(f), "{f}");
        let distance = frobenius(f - r);
        for number in 0..200 {
            let turn = random_rotation(&mut random);
            let small = DMat3::from_axis_angle(DVec3::AXES[number % 3], 1e-3);
            for other in [turn, small * r, small.transpose() * r] {
                let nearest = frobenius(f - other) * (1.0 + 1e-12);
                assert!(distance <= nearest, "{f}: {r} is at {distance}, {other} at {nearest}");
            }
        }
    }
}

#[test]
fn gradients_that_are_not_finite_end_the_iteration() {
    for bad in [f64::NAN, f64::INFINITY] {
        assert_eq!(rotation(DMat3::from_diagonal(DVec3::new(1.0, bad, 1.0))), DMat3::IDENTITY);
    }
}

const UNIT: [DVec3; 4] = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
const SKEW: [DVec3; 4] =
    [DVec3::new(0.1, 0.2, 0.3), DVec3::new(1.2, 0.1, 0.0), DVec3::new(0.3, 1.1, 0.2), DVec3::new(0.2, 0.4, 1.3)];

/// The 12x12 stiffness of an element at rest.
fn stiffness(corners: [DVec3; 4], lambda: f64, mu: f64) -> [[f64; 12]; 12] {
    let (gradients, volume) = rest_shape(corners);
    std::array::from_fn(|row| {
        std::array::from_fn(|column| {
            let block = stiffness_block(gradients[row / 3], gradients[column / 3], lambda, mu);
            volume * block.col(column % 3)[row % 3]
        })
    })
}

/// S1: ten digits of the table, and all digits of V B^T C B.
#[test]
fn element_stiffness_is_that_of_scikit_fem() {
    let [lambda, mu] = lame_parameters(1000.0, 0.3);
    for row in rows(include_str!("../data/tet4_stiffness.csv")) {
        let corners = if row[0] == "unit" { UNIT } else { SKEW };
        let k = stiffness(corners, lambda, mu);
        let number: usize = row[1].parse().unwrap();
        for (column, value) in row[2..].iter().enumerate() {
            let (ours, table) = (k[number][column], value.parse::<f64>().unwrap());
            assert!((ours - table).abs() <= 1e-9 * 400.0, "{} {number} {column}: {ours}, table {table}", row[0]);
        }
    }
    for corners in [UNIT, SKEW] {
        let k = stiffness(corners, lambda, mu);
        let (gradients, volume) = rest_shape(corners);
        // Strain of each unknown, with doubled shear: xx, yy, zz, yz, zx, xy.
        let strain: [[f64; 6]; 12] = std::array::from_fn(|unknown| {
            let (g, axis) = (gradients[unknown / 3], unknown % 3);
            std::array::from_fn(|k| {
                let on = |i: usize, x: f64| if axis == i { x } else { 0.0 };
                match k {
                    0..3 => on(k, g[k]),
                    _ => {
                        let (i, j) = ((k - 2) % 3, (k - 1) % 3);
                        on(i, g[j]) + on(j, g[i])
                    }
                }
            })
        });
        for row in 0..12 {
            for column in 0..12 {
                let (a, b) = (strain[row], strain[column]);
                let traces = [a, b].map(|strain| strain[..3].iter().sum::<f64>());
                let same: f64 = (0..6).map(|k| a[k] * b[k] * if k < 3 { 2.0 * mu } else { mu }).sum();
                let exact = volume * (same + lambda * traces[0] * traces[1]);
                let error = (k[row][column] - exact).abs();
                assert!(error <= 1e-13 * 400.0, "{row} {column}: off by {error:e}");
            }
        }
    }
}

/// The force is the gradient of the energy (corotational and linear, inverted elements too), and K that of the force where the
/// rotation is held still.
#[test]
fn force_is_the_gradient_of_energy_and_stiffness_that_of_force() {
    let [lambda, mu] = lame_parameters(1000.0, 0.4);
    let (gradients, volume) = rest_shape(SKEW);
    let mut random = Random(11);
    let mut inverted = 0;
    for model in [ElasticModel::Corotational, ElasticModel::Linear] {
        for size in [0.01, 0.3, 2.0] {
            for _ in 0..20 {
                let f = random_rotation(&mut random) + random_matrix(&mut random, size);
                let u = SKEW.map(|x| f * x - x);
                let at = |u: [DVec3; 4]| Deformation::new(&gradients, u, model);
                let here = at(u);
                inverted += usize::from(here.determinant() < 0.0);
                let pull = forces(&gradients, volume, &here, lambda, mu);
                let sum: DVec3 = pull.iter().sum();
                let scale = pull.map(DVec3::length).into_iter().fold(0.0, f64::max);
                assert!(sum.length() <= 1e-14 * scale, "forces sum to {sum}");
                let h = 1e-5;
                for corner in 0..4 {
                    for axis in DVec3::AXES {
                        let moved = |step: f64| {
                            let mut u = u;
                            u[corner] += step * axis;
                            u
                        };
                        let energy = |step| volume * energy_density(at(moved(step)).strain, lambda, mu);
                        let slope = (energy(h) - energy(-h)) / (2.0 * h);
                        let error = (slope - pull[corner].dot(axis)).abs();
                        // Truncation: third derivatives, which grow where singular values of inverted elements come close.
                        assert!(error <= 1e-4 * (scale + mu), "{model:?} size {size}: {error:e} of {scale:e} N");
                        let frozen = Deformation { rotation: here.rotation, ..at(moved(1.0)) };
                        let turned = here.rotation.transpose() * (frozen.gradient + DMat3::IDENTITY - here.rotation);
                        let strain = 0.5 * (turned + turned.transpose());
                        let frozen = Deformation { strain, ..frozen };
                        let change = forces(&gradients, volume, &frozen, lambda, mu);
                        for a in 0..4 {
                            let turn = |b: usize| here.rotation * gradients[b];
                            let block = stiffness_block(turn(a), turn(corner), lambda, mu);
                            let error = (change[a] - pull[a] - volume * (block * axis)).length();
                            let scale = scale + change[a].length();
                            assert!(error <= 1e-12 * scale, "K is off by {error:e} of {scale:e}");
                        }
                    }
                }
            }
        }
    }
    assert!(inverted >= 10, "only {inverted} inverted elements");
}

/// S8: a turned element carries no force and no stress; the linear model has 2 (mu + lambda) (cos th - 1) across its axis.
#[test]
fn turned_elements_carry_no_force() {
    let [lambda, mu] = lame_parameters(210e9, 0.3);
    let (gradients, volume) = rest_shape(SKEW);
    let mut random = Random(23);
    for number in 0..200 {
        let turn = match number {
            0..180 => DMat3::from_axis_angle(DVec3::Z, 2.0 * f64::from(number).to_radians()),
            _ => random_rotation(&mut random),
        };
        let u = SKEW.map(|x| turn * x - x);
        let still = Deformation::new(&gradients, u, ElasticModel::Corotational);
        let force = forces(&gradients, volume, &still, lambda, mu);
        let largest_force = force.map(DVec3::length).into_iter().fold(0.0, f64::max);
        // E times an area of about 1 m^2.
        assert!(largest_force <= 1e-12 * 210e9 * 1.0, "{largest_force} N, turned by {turn}");
        assert!(von_mises(stress(still.strain, lambda, mu)) <= 1e-12 * 210e9);
        assert!((still.determinant() - 1.0).abs() < 1e-14);
        if number < 180 {
            let strained = Deformation::new(&gradients, u, ElasticModel::Linear);
            let sigma = stress(strained.strain, lambda, mu);
            let exact = 2.0 * (mu + lambda) * (turn.x_axis.x - 1.0);
            assert!((sigma.x_axis.x - exact).abs() < 1e-13 * (mu + lambda));
            assert!((sigma.y_axis.y - exact).abs() < 1e-13 * (mu + lambda));
        }
    }
}

#[test]
fn uniaxial_stress_is_its_von_mises_stress() {
    let [lambda, mu] = lame_parameters(200.0, 0.25);
    let strain = DMat3::from_diagonal(DVec3::new(-0.25e-2, 1e-2, -0.25e-2));
    let sigma = stress(strain, lambda, mu);
    assert!((sigma.y_axis.y - 2.0).abs() < 1e-14 && sigma.x_axis.x.abs() < 1e-14);
    assert!((von_mises(sigma) - 2.0).abs() < 1e-14);
    assert_eq!(energy_density(strain, lambda, mu), 0.5 * 2.0 * 1e-2);
    assert!(von_mises(DMat3::from_diagonal(DVec3::splat(-7.0))) < 1e-14);
}

fn cuboid(min: [f64; 3], max: [f64; 3]) -> Shape {
    Shape::Box { min: min.into(), max: max.into() }
}

fn pin(region: Shape, components: [bool; 3], keyframes: Vec<Keyframe>) -> Pin {
    Pin { region, components, keyframes, pivot: None }
}

#[test]
fn masses_loads_and_pins_are_those_of_the_scene() {
    let mut solid = block([1.0, 0.5, 0.25], [4, 3, 2]);
    let top = cuboid([-1.0, 0.5, -1.0], [2.0, 0.5, 2.0]);
    let end = cuboid([1.0, -1.0, -1.0], [1.0, 2.0, 2.0]);
    let (force, traction) = (DVec3::new(1.0, -2.0, 3.0), DVec3::new(5.0, -7.0, 11.0));
    solid.loads = vec![
        Load { region: end, kind: LoadKind::Force(force), keyframes: Vec::new() },
        Load { region: top.clone(), kind: LoadKind::Traction(traction), keyframes: Vec::new() },
    ];
    let edge = cuboid([0.0; 3], [0.0, 0.0, 1.0]);
    solid.pins = vec![pin(edge, [true, false, true], Vec::new()), pin(top, [false, true, false], Vec::new())];
    let mut other = block([0.1; 3], [1, 1, 1]);
    other.name = "other".into();
    other.placement.translate = DVec3::splat(2.0);
    let scene = scene_of(vec![solid, other]);
    let solids = solids_of(&scene);
    let [body, second] = &solids.bodies[..] else { panic!("two bodies") };
    assert_eq!((body.nodes.clone(), second.nodes.clone()), (0..60, 60..68));
    assert_eq!((body.elements.clone(), second.elements.clone()), (0..144, 144..150));
    assert_eq!(solids.body_of_element(143).name, "block");
    assert_eq!(solids.body_of_element(144).name, "other");
    assert_eq!(solids.body_of_node(60).name, "other");
    let mass: f64 = solids.mass[body.nodes.clone()].iter().sum();
    assert!((mass - 125.0).abs() < 1e-11, "{mass} kg");
    assert!(solids.centroid(body).distance(DVec3::new(0.5, 0.25, 0.125)) < 1e-14);
    // Both loads as a whole, and the first in equal parts.
    let load: DVec3 = solids.load.iter().sum();
    assert!(load.distance(force + 0.25 * traction) < 1e-12, "{load} N");
    let at_end = |node: &usize| solids.rest[*node].x == 1.0 && solids.rest[*node].y < 0.4;
    let lower_end: Vec<usize> = (0..60).filter(at_end).collect();
    assert_eq!(lower_end.len(), 9);
    for node in lower_end {
        assert!(solids.load[node].distance(force / 12.0) < 1e-14);
    }
    // Moments of the traction: that of its resultant at the middle of the face.
    let far = |node: &usize| solids.rest[*node].x < 1.0;
    let moment: DVec3 =
        (0..60).map(|node| (solids.rest[node] - DVec3::new(0.5, 0.5, 0.125)).cross(solids.load[node])).sum();
    let by_force = DVec3::new(0.5, -0.25, 0.0).cross(force);
    assert!(moment.distance(by_force) < 1e-12, "{moment} N m");
    let unloaded = (0..60).filter(far).filter(|&node| solids.rest[node].y < 0.5);
    assert!(unloaded.into_iter().all(|node| solids.load[node] == DVec3::ZERO));
    for node in 0..60 {
        let x = solids.rest[node];
        let corner = x.x == 0.0 && x.y == 0.0;
        assert_eq!(solids.prescribed[node], [corner, x.y == 0.5, corner], "{x}");
    }
    assert!(solids.scripts.is_empty());
    assert!(solids.prescribed_velocity(&[], 0.0, 1.0).is_empty());
    // The surface encloses the volume.
    let enclosed: f64 = solids.triangles[body.triangles.clone()]
        .iter()
        .map(|triangle| {
            let [a, b, c] = triangle.map(|node| solids.rest[node as usize]);
            a.dot(b.cross(c)) / 6.0
        })
        .sum();
    assert!((enclosed - 0.125).abs() < 1e-14, "{enclosed} m^3");
}

fn refused(solid: cutwater::scene::Solid) -> String {
    let scene = scene_of(vec![solid]);
    let mesh = TetMesh::new(&scene.solids[0], "test").unwrap();
    let error = Solids::new(&scene, &[mesh]).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    error.to_string()
}

#[test]
fn pins_and_loads_that_cannot_be_are_refused() {
    let nowhere = || cuboid([5.0; 3], [6.0; 3]);
    let mut solid = block([1.0; 3], [1, 1, 1]);
    solid.pins = vec![pin(nowhere(), [true; 3], Vec::new())];
    let text = refused(solid);
    assert!(text.contains("test.toml:") && text.contains(": solid[0].pin[0]: no node of \"block\""), "{text}");

    let mut solid = block([1.0; 3], [1, 1, 1]);
    let kind = LoadKind::Force(DVec3::X);
    solid.loads = vec![Load { region: nowhere(), kind, keyframes: Vec::new() }];
    assert!(refused(solid).contains("solid[0].load[0]: no node"));

    let mut solid = block([1.0; 3], [1, 1, 1]);
    let corner = cuboid([0.0; 3], [0.5; 3]);
    let kind = LoadKind::Traction(DVec3::X);
    solid.loads = vec![Load { region: corner, kind, keyframes: Vec::new() }];
    assert!(refused(solid).contains("no surface triangle"));

    let keyframe = |angle| Keyframe { time: 0.0, translate: DVec3::X, axis: DVec3::Y, angle };
    let half = Shape::HalfSpace { point: DVec3::ZERO, normal: DVec3::Y };
    let mut solid = block([1.0; 3], [1, 1, 1]);
    solid.pins = vec![pin(half.clone(), [true; 3], vec![keyframe(0.5)])];
    assert!(refused(solid).contains("about the centre of its region"));

    let mut solid = block([1.0; 3], [1, 1, 1]);
    let all = cuboid([0.0; 3], [1.0; 3]);
    solid.pins = vec![pin(half, [true; 3], vec![keyframe(0.0)]), pin(all, [true, false, false], Vec::new())];
    let text = refused(solid);
    assert!(text.contains("pin[0]: constrains x of the node at") && text.contains("so does script[0]"), "{text}");
}

#[test]
fn bodies_start_as_their_scene_says() {
    let mut solid = block([1.0; 3], [2, 2, 2]);
    solid.initial.scale = DVec3::new(0.5, -1.0, 1.0);
    solid.initial.velocity = DVec3::new(1.0, 2.0, 3.0);
    solid.initial.spin = DVec3::new(0.0, 0.0, 2.0);
    // A shear and a stretch.
    solid.initial.velocity_gradient[0].y = 0.75;
    solid.initial.velocity_gradient[2].z = -4.0;
    solid.pins = vec![pin(cuboid([0.0; 3], [0.0, 1.0, 1.0]), [true, false, false], Vec::new())];
    let scene = scene_of(vec![solid]);
    let solids = solids_of(&scene);
    let (u, v) = solids.initial_state(&scene);
    for (node, &rest) in solids.rest.iter().enumerate() {
        let middle = DVec3::splat(0.5);
        let x = middle + DVec3::new(0.5, -1.0, 1.0) * (rest - middle);
        assert!((rest + DVec3::from(u[node])).distance(x) < 1e-15);
        let spin = DVec3::new(-2.0 * (x.y - 0.5), 2.0 * (x.x - 0.5), 0.0);
        let strained = DVec3::new(0.75 * (x.y - 0.5), 0.0, -4.0 * (x.z - 0.5));
        let mut exact = DVec3::new(1.0, 2.0, 3.0) + spin + strained;
        if rest.x == 0.0 {
            exact.x = 0.0;
        }
        assert!(DVec3::from(v[node]).distance(exact) < 1e-14);
    }
}

#[test]
fn scripted_nodes_turn_about_their_pivot() {
    let frame = |time, angle| Keyframe { time, translate: DVec3::ZERO, axis: DVec3::Z, angle };
    let quarter = 0.5 * std::f64::consts::PI;
    let pivot = DVec3::new(2.0, -1.0, 0.0);
    let mut solid = block([1.0; 3], [1, 1, 1]);
    let keyframes = vec![frame(0.0, 0.0), frame(1.0, quarter)];
    solid.pins = vec![Pin { pivot: Some(pivot), ..pin(cuboid([0.0; 3], [1.0; 3]), [true; 3], keyframes) }];
    let solids = solids_of(&scene_of(vec![solid]));
    for &rest in &solids.rest {
        let arm = rest - pivot;
        let turned = pivot + DVec3::new(-arm.y, arm.x, arm.z);
        let found = rest + solids.scripts[0].displacement(rest, 1.0);
        assert!(found.distance(turned) < 1e-14, "{found} of {turned}");
    }
}

#[test]
fn scripted_nodes_follow_their_keyframes() {
    let frame =
        |time, translate: [f64; 3], angle| Keyframe { time, translate: translate.into(), axis: DVec3::Z, angle };
    let half_turn = std::f64::consts::PI;
    let keyframes = vec![
        frame(0.0, [0.0, 0.0, 0.5], 0.0),
        frame(1.0, [1.0, 0.0, 0.5], half_turn),
        frame(2.0, [1.0, 2.0, 0.5], half_turn),
    ];
    let mut solid = block([1.0; 3], [2, 2, 2]);
    let region = cuboid([0.0; 3], [1.0, 1.0, 0.1]);
    solid.pins = vec![pin(region, [true; 3], keyframes)];
    let scene = scene_of(vec![solid]);
    let solids = solids_of(&scene);
    let (mut u, mut v) = solids.initial_state(&scene);
    let place = |time: f64, rest: DVec3| {
        let angle = half_turn * time.clamp(0.0, 1.0);
        let arm = rest - DVec3::new(0.5, 0.5, 0.05);
        let moved = DVec3::new(time.clamp(0.0, 1.0), 2.0 * (time - 1.0).clamp(0.0, 1.0), 0.5);
        moved + DMat3::from_axis_angle(DVec3::Z, angle) * arm - arm
    };
    let held = |node: &usize| solids.rest[*node].z == 0.0;
    let nodes: Vec<usize> = (0..solids.rest.len()).filter(held).collect();
    assert_eq!(nodes.len(), 9);
    for &node in &nodes {
        let arm = solids.rest[node] - DVec3::new(0.5, 0.5, 0.0);
        let exact = DVec3::new(1.0 - half_turn * arm.y, half_turn * arm.x, 0.0);
        assert!(DVec3::from(v[node]).distance(exact) < 1e-4, "{:?} {exact}", v[node]);
    }
    let dt = 0.125;
    for step in 0..20 {
        let time = f64::from(step) * dt;
        for &node in &nodes {
            let exact = place(time, solids.rest[node]);
            let error = DVec3::from(u[node]).distance(exact);
            assert!(error < 1e-14, "step {step}: off by {error:e} m");
        }
        match step {
            0 => solids.start_scripts(&u, &mut v, dt),
            _ => v = solids.prescribed_velocity(&u, time, dt),
        }
        for &node in &nodes {
            for axis in 0..3 {
                u[node][axis] += dt * v[node][axis];
            }
        }
    }
    assert!((0..solids.rest.len()).filter(|node| !held(node)).all(|node| v[node] == [0.0; 3]));
}

/// The mean of the von Mises stress and the determinants are those of an affine stretch, in a placed and turned body too.
#[test]
fn elements_report_their_stress_and_determinant() {
    let mut solid = block([1.0; 3], [2, 2, 2]);
    solid.poisson = 0.0;
    solid.placement =
        Placement { translate: DVec3::splat(1.0), rotate: DMat3::from_rotation_y(0.3), scale: 0.5, at: None };
    let solids = alone(solid);
    assert!((solids.volume.iter().sum::<f64>() - 0.125).abs() < 1e-15);
    let turn = DMat3::from_rotation_x(2.0);
    let stretch = DMat3::from_diagonal(DVec3::new(1.0, 1.0, 1.02));
    let u = displaced(&solids, |x| turn * (stretch * x));
    for element in 0..solids.elements.len() {
        let [stress, determinant] = solids.stress_and_determinant(element, &u);
        assert!((stress - 2e4).abs() < 1e-8, "{stress} Pa");
        assert!((determinant - 1.02).abs() < 1e-14);
    }
    let mut random = Random(2);
    let u = noise(&mut random, solids.rest.len(), 0.3);
    let negative = (0..48).filter(|&e| solids.stress_and_determinant(e, &u)[1] < 0.0);
    assert!(negative.count() > 5);
}

#[test]
fn points_on_a_shape_are_inside() {
    let sphere = Shape::Sphere { centre: DVec3::splat(0.5), radius: 0.75_f64.sqrt() };
    let mut solid = block([1.0; 3], [1, 1, 1]);
    solid.mesh = SolidMesh::Box { size: DVec3::ONE, cells: [2, 2, 2] };
    solid.pins = vec![pin(sphere, [true; 3], Vec::new())];
    let solids = alone(solid);
    assert!(solids.prescribed.iter().all(|held| *held == [true; 3]));
}
