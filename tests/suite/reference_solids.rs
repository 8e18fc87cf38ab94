//! Twins of the solids' stages, one by one, against their equations written once more.

use std::sync::Arc;

use cutwater::elastic::{Bounds, Solids, rest_shape, stiffness_block};
use cutwater::linalg::{LinearOperator, dot, norm};
use cutwater::reference::{
    BlockPattern, Chebyshev, Freedom, SolidMatrices, SolidSolver, SolidSystem, diagnose_solid, move_solid, node_forces,
    solid_matrices, solid_right_hand_side,
};
use cutwater::scene::{ElasticModel, Pin, Scene, Shape, Solid, Solver};
use cutwater::state::SolveStatus;
use glam::{DMat3, DVec3};

use crate::common::Random;
use crate::elastic::random_rotation;
use crate::solid_scene::{alone, block, displaced, noise, scene_of, solids_of};

fn matrices(solids: &Solids, displacement: &[[f64; 3]]) -> SolidMatrices {
    solid_matrices(solids, &Arc::new(BlockPattern::new(solids)), displacement)
}

/// The system of a step from displacements (m) and v* (m/s).
fn system(solids: &Solids, displacement: &[[f64; 3]], velocity: &[[f64; 3]], dt: f64) -> SolidSystem {
    let matrices = matrices(solids, displacement);
    let rhs = solid_right_hand_side(solids, &matrices, velocity, dt);
    let freedom = Freedom::all(solids);
    SolidSystem::new(solids, matrices.stiffness.clone(), &rhs, velocity, freedom, dt)
}

fn half(min: [f64; 3], max: [f64; 3], components: [bool; 3]) -> Pin {
    let region = Shape::Box { min: min.into(), max: max.into() };
    Pin { region, components, keyframes: Vec::new(), pivot: None }
}

/// Three bodies: rubber held at one end and by rollers, stiff and damped, linear and nearly incompressible.
fn stack() -> Scene {
    let mut held = block([1.0, 0.2, 0.3], [5, 2, 2]);
    held.pins =
        vec![half([0.0; 3], [0.0, 1.0, 1.0], [true; 3]), half([0.5, 0.0, 0.0], [1.0, 0.0, 1.0], [false, true, false])];
    let mut stiff = block([0.4, 0.4, 0.4], [2, 3, 2]);
    stiff.placement.translate = DVec3::splat(2.0);
    stiff.placement.rotate = DMat3::from_rotation_x(0.4);
    (stiff.young, stiff.density) = (2e11, 7800.0);
    (stiff.mass_damping, stiff.stiffness_damping) = (2.0, 1e-3);
    let mut linear = block([0.5, 0.2, 0.2], [3, 1, 2]);
    linear.placement.translate = DVec3::new(1.0, 3.0, 1.0);
    (linear.poisson, linear.model) = (0.49, ElasticModel::Linear);
    scene_of(vec![held, stiff, linear])
}

#[test]
fn nodes_stop_at_walls_and_lose_the_velocity_into_them() {
    let mut solid = block([1.0; 3], [1, 1, 1]);
    solid.pins = vec![half([0.0; 3], [1.0, 1.0, 0.0], [true, false, false])];
    // A corotational body on rollers would move on circles.
    solid.model = ElasticModel::Linear;
    let scene = scene_of(vec![solid]);
    let solids = solids_of(&scene);
    let grid = scene.grid();
    let (mut u, mut v) = (vec![[0.0; 3]; 8], vec![[0.0; 3]; 8]);
    let node = |x: [f64; 3]| {
        let mut nodes = solids.rest.iter();
        nodes.position(|rest| *rest == DVec3::from(x)).unwrap()
    };
    let (low, high, held) = (node([0.0, 0.0, 1.0]), node([1.0; 3]), node([0.0; 3]));
    v[low] = [-1.0, 2.0, -0.5];
    v[high] = [8.0, -1.0, 1.0];
    v[held] = [-1.0, -1.0, 1.0];
    move_solid(&solids, &grid, 0.5, (DVec3::ZERO, &[]), &mut u, &mut v);
    assert_eq!((u[low], v[low]), ([0.0, 1.0, -0.25], [0.0, 2.0, -0.5]));
    assert_eq!((u[high], v[high]), ([3.0, -0.5, 0.5], [0.0, -1.0, 1.0]));
    // The prescribed component goes where it is told.
    assert_eq!((u[held], v[held]), ([-0.5, 0.0, 0.5], [-1.0, 0.0, 1.0]));
}

#[test]
fn free_nodes_fall_and_prescribed_ones_obey() {
    let scene = stack();
    let solids = solids_of(&scene);
    let mut random = Random(4);
    let n = solids.rest.len();
    let (before, told) = (noise(&mut random, n, 1.0), noise(&mut random, n, 1.0));
    let gravity = DVec3::new(0.0, -9.81, 1.0);
    for prescribed in [&told[..], &[]] {
        let mut v = before.clone();
        node_forces(&solids, prescribed, gravity, 0.25, &mut v);
        for node in 0..n {
            for axis in 0..3 {
                let exact = match solids.prescribed[node][axis] {
                    true => prescribed.get(node).map_or(0.0, |told| told[axis]),
                    false => before[node][axis] + 0.25 * gravity[axis],
                };
                assert_eq!(v[node][axis], exact);
            }
        }
    }
}

/// The assembled matrix against the sum of the elements' own, entry by entry, in a deformed state; rows of a body sum to 0.
#[test]
fn the_stiffness_matrix_is_the_sum_of_the_elements() {
    let solids = solids_of(&stack());
    let n = solids.rest.len();
    let mut random = Random(8);
    let u = noise(&mut random, n, 0.1);
    let matrices = matrices(&solids, &u);
    let k = matrices.stiffness.to_csr();
    let mut dense = vec![0.0; 9 * n * n];
    for (element, corners) in solids.elements.iter().enumerate() {
        let body = solids.body_of_element(element);
        let (gradients, volume) = rest_shape(corners.map(|corner| solids.rest[corner as usize]));
        let rotation = matrices.deformations[element].rotation;
        for a in 0..4 {
            for b in 0..4 {
                let unturned = stiffness_block(gradients[a], gradients[b], body.lambda, body.mu);
                let block = volume * rotation * unturned * rotation.transpose();
                for i in 0..3 {
                    for j in 0..3 {
                        let (row, column) = (3 * corners[a] as usize + i, 3 * corners[b] as usize + j);
                        dense[3 * n * row + column] += block.col(j)[i];
                    }
                }
            }
        }
    }
    for row in 0..3 * n {
        let size = k.get(row, row);
        for column in 0..3 * n {
            let error = (k.get(row, column) - dense[3 * n * row + column]).abs();
            assert!(error <= 1e-12 * size, "({row}, {column}) is off by {error:e}");
        }
        for axis in 0..3 {
            let sum: f64 = k.row(row).filter(|(column, _)| column % 3 == axis).map(|(_, x)| x).sum();
            assert!(sum.abs() <= 1e-12 * size, "row {row} sums to {sum:e}");
        }
    }
    assert!(k.asymmetry() <= 1e-12 * k.infinity_norm());
    // From differences: a translation gives nothing at all.
    let translation: Vec<f64> = (0..n).flat_map(|_| [0.3, -0.7, 1.9]).collect();
    assert!((0..n).all(|node| matrices.stiffness.product(node, &translation) == DVec3::ZERO));
}

/// Elastic forces balance: they sum to 0, and in the corotational model so do their moments about the deformed places (S13).
#[test]
fn elastic_forces_have_no_resultant_and_no_moment() {
    let mut solid = block([1.0, 0.5, 0.5], [4, 2, 2]);
    solid.poisson = 0.4;
    let solids = alone(solid);
    let mut random = Random(6);
    for size in [1e-3, 0.1, 1.0] {
        let turn = random_rotation(&mut random);
        let mut u = displaced(&solids, |x| turn * x);
        for (u, noise) in u.iter_mut().zip(noise(&mut random, solids.rest.len(), size)) {
            *u = (DVec3::from(*u) + DVec3::from(noise)).to_array();
        }
        let still = vec![[0.0; 3]; solids.rest.len()];
        let rhs = solid_right_hand_side(&solids, &matrices(&solids, &u), &still, 1.0);
        let force = |node: usize| DVec3::from(rhs.values[node]);
        let nodes = 0..solids.rest.len();
        let sum: DVec3 = nodes.clone().map(force).sum();
        let moment: DVec3 =
            nodes.clone().map(|node| (solids.rest[node] + DVec3::from(u[node])).cross(force(node))).sum();
        let scale: f64 = nodes.map(|node| force(node).length()).sum();
        assert!(sum.length() <= 1e-13 * scale, "{sum} of {scale} N");
        assert!(moment.length() <= 1e-13 * scale * 2.0, "{moment} of {scale} N m");
    }
}

/// S8: a turned body at rest carries no force, whatever the angle.
#[test]
fn turned_bodies_carry_no_force() {
    let mut solid = block([1.0, 0.1, 0.1], [10, 2, 2]);
    solid.young = 210e9;
    let solids = alone(solid);
    for degrees in (0..360).step_by(15) {
        let axis = DVec3::new(1.0, 2.0, -0.5).normalize();
        let turn = DMat3::from_axis_angle(axis, f64::from(degrees).to_radians());
        let u = displaced(&solids, |x| turn * x + DVec3::splat(0.3));
        let still = vec![[0.0; 3]; u.len()];
        let rhs = solid_right_hand_side(&solids, &matrices(&solids, &u), &still, 1.0);
        let largest = rhs.values.iter().flatten().fold(0.0, |m, f| f64::max(m, f.abs()));
        // E times the area of a node's share.
        let bound = 1e-12 * 210e9 * 0.05 * 0.05 * 24.0;
        assert!(largest <= bound, "{degrees} degrees: {largest} N, allowed {bound}");
    }
}

/// S7: an affine displacement of the boundary of an irregular block is the solution inside.
#[test]
fn affine_displacements_pass_through_an_irregular_block() {
    let mut solid = block([1.0; 3], [4, 4, 4]);
    solid.poisson = 0.45;
    for model in [ElasticModel::Corotational, ElasticModel::Linear] {
        let scene = scene_of(vec![Solid { model, ..solid.clone() }]);
        let mut mesh = cutwater::geometry::TetMesh::new(&scene.solids[0], "test").unwrap();
        let mut random = Random(31);
        for x in &mut mesh.nodes {
            if x.min_element() > 0.0 && x.max_element() < 1.0 {
                *x += DVec3::from_array(std::array::from_fn(|_| random.uniform(-0.05, 0.05)));
            }
        }
        let solids = Solids::new(&scene, &[mesh]).unwrap();
        // Small in the linear model; the corotational one turns as well.
        let turn = match model {
            ElasticModel::Corotational => DMat3::from_rotation_z(1.2),
            ElasticModel::Linear => DMat3::IDENTITY,
        };
        let stretch = DMat3::from_cols_array(&[1.02, 0.01, 0.0, 0.01, 0.97, 0.02, 0.0, 0.02, 1.05]);
        let u = displaced(&solids, |x| turn * (stretch * x));
        let still = vec![[0.0; 3]; u.len()];
        let rhs = solid_right_hand_side(&solids, &matrices(&solids, &u), &still, 1.0);
        let scale = rhs.values.iter().flatten().fold(0.0, |m, f| f64::max(m, f.abs()));
        let mut inside = 0;
        for (x, f) in solids.rest.iter().zip(&rhs.values) {
            if x.min_element() > 0.0 && x.max_element() < 1.0 {
                let force = DVec3::from(*f).length();
                assert!(force <= 1e-12 * scale, "{model:?}: {force} of {scale} N at {x}");
                inside += 1;
            }
        }
        assert_eq!(inside, 27);
    }
}

/// Largest eigenvalue of D^-1 A from below: the Rayleigh quotient that 300 power iterations come to. D has these blocks.
fn largest_eigenvalue(blocks: &[DMat3], apply: impl Fn(&[f64]) -> Vec<f64>) -> f64 {
    let each = |blocks: &[DMat3], x: &[f64]| -> Vec<f64> {
        let nodes = blocks.iter().zip(x.chunks_exact(3));
        let products = nodes.map(|(block, x)| block * DVec3::from_slice(x));
        products.flat_map(|product| product.to_array()).collect()
    };
    let inverse: Vec<DMat3> = blocks.iter().map(DMat3::inverse).collect();
    let mut random = Random(1);
    let mut x = apply(&noise(&mut random, blocks.len(), 1.0).into_flattened());
    for _ in 0..300 {
        let next = each(&inverse, &apply(&x));
        let size = norm(&next);
        x = next.into_iter().map(|next| next / size).collect();
    }
    dot(&x, &apply(&x)) / dot(&x, &each(blocks, &x))
}

/// The bounds hold for random meshes, rotations, materials and pins, and are not far off.
#[test]
fn element_bounds_hold_for_assembled_matrices() {
    let mut random = Random(77);
    for number in 0..6 {
        let mut scene = stack();
        for solid in &mut scene.solids {
            solid.poisson = [0.0, 0.3, 0.45, 0.49, -0.5, 0.4][number];
            solid.young = 10_f64.powf(random.uniform(3.0, 9.0));
        }
        let meshes: Vec<_> = scene
            .solids
            .iter()
            .map(|solid| {
                let mut mesh = cutwater::geometry::TetMesh::new(solid, "test").unwrap();
                for x in &mut mesh.nodes {
                    // Below half of the smallest height; pinned nodes keep their places.
                    if x.x > 0.0 && x.y > 0.0 {
                        *x += DVec3::from_array(std::array::from_fn(|_| random.uniform(-0.02, 0.02)));
                    }
                }
                mesh
            })
            .collect();
        let solids = Solids::new(&scene, &meshes).unwrap();
        let bounds = Bounds::new(&solids);
        let n = solids.rest.len();
        let u = noise(&mut random, n, 0.5);
        let still = vec![[0.0; 3]; n];
        for dt in [1e-6, 1e-3, 10.0] {
            let system = system(&solids, &u, &still, dt);
            let matrix = system.to_csr();
            let block = |node: usize| {
                DMat3::from_cols_array(&std::array::from_fn(|k| {
                    let (row, column) = (3 * node + k % 3, 3 * node + k / 3);
                    let prescribed = |c: usize| solids.prescribed[node][c % 3];
                    match prescribed(row) || prescribed(column) {
                        true => f64::from(u8::from(row == column)),
                        false => matrix.get(row, column),
                    }
                }))
            };
            let blocks: Vec<DMat3> = (0..n).map(block).collect();
            let prescribed = solids.prescribed.as_flattened();
            let largest = largest_eigenvalue(&blocks, |x| {
                let components = x.iter().zip(prescribed);
                let free: Vec<f64> = components.map(|(x, &p)| if p { 0.0 } else { *x }).collect();
                let mut y = vec![0.0; 3 * n];
                system.apply(&free, &mut y);
                y
            });
            assert!(largest <= bounds.block_jacobi, "{largest} above {}", bounds.block_jacobi);
            assert!(bounds.block_jacobi <= 4.0 && bounds.block_jacobi >= 1.0);
            if dt > 1.0 {
                assert!(largest > 0.3 * bounds.block_jacobi, "{largest} far below {}", bounds.block_jacobi);
            }
        }
        let stiffness = matrices(&solids, &u).stiffness;
        for (body, bound) in solids.bodies.iter().zip(&bounds.frequency_squared) {
            let masses = solids.mass.iter();
            let masses: Vec<DMat3> = masses.map(|&mass| DMat3::from_diagonal(DVec3::splat(mass))).collect();
            let largest = largest_eigenvalue(&masses, |x| {
                let product = |node: usize| match body.nodes.contains(&node) {
                    true => stiffness.product(node, x).to_array(),
                    false => [0.0; 3],
                };
                (0..n).flat_map(product).collect()
            });
            assert!(largest <= *bound && largest > 0.2 * bound, "{largest} and {bound}");
        }
    }
}

/// Random right-hand sides on the stack, whose condition spans what scenes ask for.
#[test]
fn direct_and_iterative_solves_agree() {
    let scene = stack();
    let solids = solids_of(&scene);
    let n = solids.rest.len();
    let mut random = Random(12);
    let settings = Solver { tolerance: 1e-11, max_iterations: 2000, ..Solver::default() };
    let solver = SolidSolver::new(&solids);
    for dt in [1e-4, 1.0 / 24.0] {
        let (u, v) = (noise(&mut random, n, 0.01), noise(&mut random, n, 1.0));
        let system = system(&solids, &u, &v, dt);
        let (direct, report) = solver.solve_direct(&system, &settings).unwrap();
        assert_eq!(report.status, SolveStatus::Converged, "{report:?}");
        assert_eq!(report.unknowns, system.n_unknowns());
        let (iterative, iterations) = solver.solve_iterative(&solids, &system, &settings);
        assert_eq!(iterations.status, SolveStatus::Converged, "{iterations:?}");
        let largest = direct.as_flattened().iter().fold(0.0, |m, v| f64::max(m, v.abs()));
        for (a, b) in direct.as_flattened().iter().zip(iterative.as_flattened()) {
            assert!((a - b).abs() <= 1e-7 * largest, "dt {dt}: {a} and {b}");
        }
        // Prescribed components hold what v* says.
        for node in 0..n {
            for axis in (0..3).filter(|&axis| solids.prescribed[node][axis]) {
                assert_eq!(direct[node][axis], v[node][axis]);
                assert_eq!(iterative[node][axis], v[node][axis]);
            }
        }
        // The true residual, from the matrix as exported: rhs of all components less S v.
        let matrices = matrices(&solids, &u);
        let rhs = solid_right_hand_side(&solids, &matrices, &v, dt);
        let mut product = vec![0.0; 3 * n];
        system.to_csr().multiply(direct.as_flattened(), &mut product);
        let residual: Vec<f64> =
            system.components().into_iter().map(|at| rhs.values.as_flattened()[at] - product[at]).collect();
        let relative = norm(&residual) / norm(&system.rhs);
        assert!(relative <= 1e-9, "{relative:e}");
    }
}

#[test]
fn the_polynomial_is_symmetric_and_positive() {
    let scene = stack();
    let solids = solids_of(&scene);
    let n = solids.rest.len();
    let mut random = Random(9);
    let (u, v) = (noise(&mut random, n, 0.1), noise(&mut random, n, 1.0));
    let lmax = Bounds::new(&solids).block_jacobi;
    for dt in [1e-4, 1.0] {
        let system = system(&solids, &u, &v, dt);
        for degree in [8, 64] {
            let polynomial = Chebyshev::new(&system, lmax, degree);
            let masked = |random: &mut Random| -> Vec<f64> {
                let mut x = noise(random, n, 1.0).into_flattened();
                let prescribed = solids.prescribed.as_flattened();
                x.iter_mut().zip(prescribed).for_each(|(x, &p)| *x = if p { 0.0 } else { *x });
                x
            };
            for _ in 0..4 {
                let (x, y) = (masked(&mut random), masked(&mut random));
                let (mut px, mut py) = (vec![0.0; 3 * n], vec![0.0; 3 * n]);
                polynomial.apply(&x, &mut px);
                polynomial.apply(&y, &mut py);
                let scale = norm(&px) * norm(&y) + norm(&py) * norm(&x);
                assert!((dot(&px, &y) - dot(&x, &py)).abs() <= 1e-11 * scale);
                assert!(dot(&px, &x) > 0.0);
            }
        }
    }
}

#[test]
fn solves_end_where_there_is_nothing_to_solve_or_nothing_can_be() {
    let scene = stack();
    let solids = solids_of(&scene);
    let n = solids.rest.len();
    let zero = vec![[0.0; 3]; n];
    let solver = SolidSolver::new(&solids);
    let settings = Solver::default();
    let system_of = |u: &[[f64; 3]], v: &[[f64; 3]]| system(&solids, u, v, 0.01);
    let (v, report) = solver.solve(&solids, &system_of(&zero, &zero), &settings).unwrap();
    assert_eq!((v, report.residual, report.status), (zero.clone(), 0.0, SolveStatus::Converged));

    let mut bad = zero.clone();
    bad[n - 1][1] = f64::NAN;
    for (u, v) in [(&bad, &zero), (&zero, &bad)] {
        let (_, report) = solver.solve(&solids, &system_of(u, v), &settings).unwrap();
        assert_eq!(report.status, SolveStatus::NonFinite);
    }

    let mut all = block([1.0; 3], [2, 2, 2]);
    all.pins = vec![half([0.0; 3], [1.0; 3], [true; 3])];
    let held = alone(all);
    let moving = vec![[1.0, 2.0, 3.0]; held.rest.len()];
    let u = vec![[0.0; 3]; held.rest.len()];
    let solver = SolidSolver::new(&held);
    let (v, report) = solver.solve(&held, &system(&held, &u, &moving, 0.01), &settings).unwrap();
    assert_eq!((v, report.unknowns, report.status), (moving, 0, SolveStatus::Converged));

    // Too few iterations are told.
    let few = Solver { max_iterations: 1, ..settings };
    let mut random = Random(2);
    let v = noise(&mut random, n, 1.0);
    let solver = SolidSolver::new(&solids);
    let (_, report) = solver.solve_iterative(&solids, &system_of(&zero, &v), &few);
    assert_eq!((report.status, report.iterations), (SolveStatus::IterationLimit, 1));
}

/// A turned, stretched and spinning block: sums in closed form.
#[test]
fn diagnosis_of_a_spinning_block_is_that_of_a_rigid_body() {
    let solids = alone(block([1.0, 0.5, 0.25], [4, 3, 2]));
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, -1.0, 0.5).normalize(), 2.0);
    let centre = DVec3::new(2.0, 1.5, 1.0);
    let middle = solids.centroid(&solids.bodies[0]);
    let spin = DVec3::new(0.3, -2.0, 1.0);
    let drift = DVec3::new(0.1, 0.2, -3.0);
    let stretch = 1.1;
    let arm = |x: DVec3| stretch * (turn * (x - middle));
    let u = displaced(&solids, |x| centre + arm(x));
    let velocity = |x: DVec3| drift + spin.cross(arm(x));
    let v: Vec<[f64; 3]> = solids.rest.iter().map(|&x| velocity(x).to_array()).collect();
    let gravity = DVec3::new(0.0, -10.0, 0.0);
    let deformations = matrices(&solids, &u).deformations;
    let found = diagnose_solid(&solids, &deformations, &u, &v, gravity);
    let mass = 125.0;
    // The lumped nodes' own moments of inertia.
    let own: DVec3 = solids.rest.iter().zip(&solids.mass).map(|(&x, &m)| m * arm(x).cross(spin.cross(arm(x)))).sum();
    let close = |a: [f64; 3], b: DVec3| DVec3::from(a).distance(b) <= 1e-11 * (1.0 + b.length());
    assert!(close(found.momentum, mass * drift));
    assert!(close(found.angular_momentum, own + mass * centre.cross(drift)));
    let kinetic = 0.5 * mass * drift.length_squared() + 0.5 * spin.dot(own);
    assert!((found.kinetic_energy - kinetic).abs() < 1e-10 * kinetic);
    assert!((found.potential_energy - mass * 10.0 * centre.y).abs() < 1e-9);
    // eps = 0.1 I: 3 mu / 100 + 9 lambda / 200 per volume.
    let [lambda, mu] = cutwater::elastic::lame_parameters(1e6, 0.3);
    let elastic = 0.125 * (0.03 * mu + 0.045 * lambda);
    assert!((found.elastic_energy - elastic).abs() < 1e-11 * elastic);
    assert!((found.min_det - 1.331).abs() < 1e-13 && found.inverted == 0);
    let fastest = v.iter().flatten().fold(0.0, |m, v| f64::max(m, v.abs()));
    assert_eq!(found.max_speed, fastest);
    let mirrored = displaced(&solids, |x| DVec3::new(-x.x, x.y, x.z));
    let deformations = matrices(&solids, &mirrored).deformations;
    let found = diagnose_solid(&solids, &deformations, &mirrored, &v, gravity);
    assert_eq!(found.inverted, 144);
    assert!((found.min_det + 1.0).abs() < 1e-13);
}
