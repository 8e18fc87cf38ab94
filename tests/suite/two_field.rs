//! The solve for liquid and solids on the device, on the base scene, in both its forms, against the f64 path.

use cutwater::gpu::Gpu;
use cutwater::linalg::dot;
use cutwater::measure::base_scene::DeviceScene;
use cutwater::reference::base_block::DENSITY;
use cutwater::reference::base_scene::{BaseBeam, BaseScene};
use cutwater::reference::{self, CoupledSolution, CoupledSystem, SIGMA, SolidSolver as TwinSolver, solve_coupled};
use cutwater::scene::{Formulation, Precision, Preconditioner, Solver};
use cutwater::state::SolveStatus;
use glam::{DMat3, DVec3};

use crate::common::{Random, gpu};

fn holding<'a>(gpu: &'a Gpu, scene: &BaseScene, system: &CoupledSystem, solver: &Solver) -> DeviceScene<'a> {
    let device = DeviceScene::new(gpu, scene, system, solver).unwrap();
    device.reset();
    device
}

fn direct(scene: &BaseScene, system: &CoupledSystem) -> CoupledSolution {
    let exact = Solver { tolerance: 1e-12, ..Solver::default() };
    let solver = TwinSolver::new(&scene.solids);
    solve_coupled(system, reference::Formulation::Indefinite, &solver, &scene.solids, &exact).unwrap()
}

/// A random vector of unknowns: quads, then nodes; 0 in what is none.
fn noise(device: &DeviceScene, system: &CoupledSystem, seed: u64) -> Vec<f64> {
    let mut random = Random(seed);
    let grid = &device.grid;
    let cells: Vec<f64> = (0..grid.n_cells())
        .map(|cell| match system.pressure.stencil.active(cell) {
            true => f64::from(random.uniform(-1.0, 1.0) as f32),
            false => 0.0,
        })
        .collect();
    let mut all = grid.padded().pad(grid.cells, &cells, |x| x);
    for freedom in system.solid.freedom() {
        all.extend(freedom.free.map(|free| match free {
            true => f64::from(random.uniform(-1.0, 1.0) as f32),
            false => 0.0,
        }));
        all.push(0.0);
    }
    all
}

/// x . y over the unknowns.
fn dot_active(device: &DeviceScene, system: &CoupledSystem, x: &[f64], y: &[f64]) -> f64 {
    let grid = &device.grid;
    let padded = grid.padded();
    let cells = (0..grid.n_cells()).filter(|&cell| system.pressure.stencil.active(cell));
    let at = cells.map(|cell| padded.index(grid.cell_at(cell)));
    let of_p: f64 = at.map(|at| x[at] * y[at]).sum();
    of_p + dot(&x[padded.len()..], &y[padded.len()..])
}

/// x . A y = y . A x and x . A x > 0, and so for the preconditioner, up to the rounding of the corrections' vectors.
#[test]
fn operator_and_preconditioner_are_symmetric_and_positive() {
    let Some(gpu) = gpu() else { return };
    let kinds = [
        (1e4, Preconditioner::Multigrid),
        (1e6, Preconditioner::Multigrid),
        (1e9, Preconditioner::Multigrid),
        (1e6, Preconditioner::Jacobi),
        (1e9, Preconditioner::BlockJacobi),
    ];
    for (young, preconditioner) in kinds {
        let beam = BaseBeam { young, ..BaseBeam::default() };
        let scene = BaseScene::new(16, &beam).unwrap();
        let system = scene.coupled_system();
        let precisions = [Precision::F32, Precision::Mixed].into_iter();
        for precision in precisions.filter(|p| gpu.has_f64() || *p == Precision::F32) {
            let solver = Solver { precision, formulation: Formulation::TwoField, preconditioner, ..Solver::default() };
            let device = holding(gpu, &scene, &system, &solver);
            device.record_systems().submit();
            let [x, y] = [1, 2].map(|seed| noise(&device, &system, seed));
            let apply = |x: &[f64]| device.solver.apply(gpu, device.fields(), x).unwrap();
            let precondition = |g: &[f64]| {
                let z = device.solver.precondition(gpu, device.fields(), &device.polynomial, g);
                z.unwrap()
            };
            let inner = |a: &[f64], b: &[f64]| dot_active(&device, &system, a, b);
            let what = format!("E {young:e} {precision:?} {preconditioner:?}");
            let eps = f64::from(f32::EPSILON);
            for (name, [ax, ay]) in
                [("operator", [apply(&x), apply(&y)]), ("preconditioner", [precondition(&x), precondition(&y)])]
            {
                let [xax, yay] = [inner(&x, &ax), inner(&y, &ay)];
                assert!(xax > 0.0 && yay > 0.0, "{what} {name}: {xax} and {yay}");
                let off = (inner(&x, &ay) - inner(&y, &ax)).abs();
                let bound = 256.0 * eps * (xax * yay).sqrt();
                assert!(off <= bound, "{what} {name}: asymmetric by {off:e} of {bound:e}");
            }
        }
    }
}

/// The inverse of the diagonal of the matrix that the f64 path assembles, or of its 3x3 blocks, times random residuals.
#[test]
fn diagonals_are_those_of_the_matrix() {
    let Some(gpu) = gpu() else { return };
    for (young, stiffness_damping) in [(1e4, 0.0), (1e6, 0.01), (1e9, 0.0)] {
        let beam = BaseBeam { young, stiffness_damping, ..BaseBeam::default() };
        let scene = BaseScene::new(12, &beam).unwrap();
        let system = scene.coupled_system();
        let blocks = system.blocks();
        let matrix = blocks.two_field(SIGMA).unwrap();
        let n_cells = blocks.cells.len();
        for preconditioner in [Preconditioner::Jacobi, Preconditioner::BlockJacobi] {
            let solver = Solver {
                precision: match gpu.has_f64() {
                    true => Precision::Mixed,
                    false => Precision::F32,
                },
                formulation: Formulation::TwoField,
                preconditioner,
                ..Solver::default()
            };
            let device = holding(gpu, &scene, &system, &solver);
            device.record_systems().submit();
            let g = noise(&device, &system, 5);
            let z = device.solver.precondition(gpu, device.fields(), &device.polynomial, &g).unwrap();
            let (grid, padded) = (&device.grid, device.grid.padded());
            let of_liquid = grid.dx * scene.dt / DENSITY;
            let of_solids = DENSITY * grid.dx.powi(3) / scene.dt;
            let what = format!("E {young:e} {preconditioner:?}");
            // Coefficients are f32: areas, theta, moduli and masses; of rows that sum squares of blocks, their condition counts.
            for (row, &cell) in blocks.cells.iter().enumerate() {
                let at = padded.index(grid.cell_at(cell));
                let twin = g[at] * of_liquid / matrix.get(row, row);
                let off = (z[at] - twin).abs();
                assert!(off <= 1e-5 * twin.abs(), "{what}, cell {cell}: {} and {twin}", z[at]);
            }
            let mut first = 0;
            while first < blocks.components.len() {
                let node = blocks.components[first] / 3;
                let rows: Vec<usize> =
                    (first..blocks.components.len()).take_while(|&row| blocks.components[row] / 3 == node).collect();
                let at = |row: usize| padded.len() + 4 * node + blocks.components[row] % 3;
                let mut block = DMat3::IDENTITY;
                let mut right = DVec3::ZERO;
                for (i, &row) in rows.iter().enumerate() {
                    right[i] = of_solids * g[at(row)];
                    for (j, &column) in rows.iter().enumerate() {
                        let kept = preconditioner == Preconditioner::BlockJacobi || i == j;
                        let value = matrix.get(n_cells + row, n_cells + column);
                        block.col_mut(j)[i] = if kept { value } else { 0.0 };
                    }
                }
                let twin = block.inverse() * right;
                for (i, &row) in rows.iter().enumerate() {
                    let off = (z[at(row)] - twin[i]).abs();
                    let found = z[at(row)];
                    assert!(off <= 1e-4 * twin.length(), "{what}, node {node}: {found} and {twin}");
                }
                first += rows.len();
            }
        }
    }
}

/// With the diagonal for a preconditioner, the same answer; with multigrid, in as few iterations as of the stiffer beam in
/// [`iterations_stay_few`].
#[test]
fn every_preconditioner_has_the_same_answer() {
    let Some(gpu) = gpu().filter(|gpu| gpu.has_f64()) else {
        return;
    };
    // Soft: with diagonals, iterations grow with the square root of its stiffness.
    let beam = BaseBeam { young: 1e5, ..BaseBeam::default() };
    let scene = BaseScene::new(12, &beam).unwrap();
    let system = scene.coupled_system();
    let exact = direct(&scene, &system);
    for preconditioner in [Preconditioner::Multigrid, Preconditioner::BlockJacobi, Preconditioner::Jacobi] {
        let solver =
            Solver { formulation: Formulation::TwoField, preconditioner, max_iterations: 20_000, ..Solver::default() };
        let device = holding(gpu, &scene, &system, &solver);
        let outcome = device.solve().unwrap();
        let (_, velocity) = device.answer().unwrap();
        let of_v = off(velocity.as_flattened(), exact.velocity.as_flattened());
        println!("{preconditioner:?}: {outcome:?}, v {of_v:e}");
        assert_eq!(outcome.parts[0].status, SolveStatus::Converged, "{outcome:?}");
        assert!(of_v <= 1e-5, "{preconditioner:?}: {of_v:e}");
        let ours = preconditioner == Preconditioner::Multigrid;
        assert!(!ours || outcome.parts[0].iterations <= 30, "{outcome:?}");
    }
}

/// Largest difference over the largest value.
fn off(found: &[f64], wanted: &[f64]) -> f64 {
    let largest = wanted.iter().fold(0.0, |m, x| f64::max(m, x.abs()));
    let pairs = found.iter().zip(wanted);
    pairs.fold(0.0, |m, (a, b)| f64::max(m, (a - b).abs())) / largest
}

/// The precisions and forms that the device has, with tolerances.
fn ways(gpu: &Gpu) -> Vec<Solver> {
    let two_field = Formulation::TwoField;
    let mut ways = vec![(Precision::F32, 1e-5, two_field)];
    for precision in [Precision::Mixed, Precision::F64] {
        // Without f64 on the device the outer loop of mixed is the host's.
        if gpu.has_f64() || precision == Precision::Mixed {
            ways.push((precision, 1e-10, two_field));
            ways.push((precision, 1e-10, Formulation::Condensed));
        }
    }
    let ways = ways.into_iter();
    ways.map(|(precision, tolerance, formulation)| Solver { precision, tolerance, formulation, ..Solver::default() })
        .collect()
}

/// Solves on the device in all ways, to the answer of the direct solve; `most_in_f32`: residual over the tolerance.
fn agrees_with_the_direct_solve(gpu: &Gpu, scene: &BaseScene, most_in_f32: f64) {
    let system = scene.coupled_system();
    let exact = direct(scene, &system);
    let unknowns = system.pressure.n_unknowns() + system.solid.n_unknowns();
    for solver in ways(gpu) {
        let device = holding(gpu, scene, &system, &solver);
        let outcome = device.solve().unwrap();
        let (mut pressure, velocity) = device.answer().unwrap();
        for (cell, pressure) in pressure.iter_mut().enumerate() {
            if !system.pressure.stencil.active(cell) {
                *pressure = 0.0;
            }
        }
        let of_p = off(&pressure, &exact.pressure);
        let of_v = off(velocity.as_flattened(), exact.velocity.as_flattened());
        let Solver { precision, tolerance, formulation, .. } = solver;
        let what = format!("{formulation:?} {precision:?}: {outcome:?}, p {of_p:e}, v {of_v:e}");
        let parts = outcome.parts;
        assert_eq!(parts[0].status, SolveStatus::Converged, "{what}");
        assert_eq!(outcome.condensed, formulation == Formulation::Condensed, "{what}");
        let found: u32 = parts.iter().map(|part| part.unknowns).sum();
        assert_eq!(found as usize, unknowns, "{what}");
        let [of_liquid, of_solid] = parts.map(|part| part.residual);
        let most = match precision {
            Precision::F32 => most_in_f32 * tolerance,
            Precision::Mixed | Precision::F64 => tolerance,
        };
        assert!(of_liquid <= most && of_solid <= most, "{what}");
        assert!(parts.iter().all(|part| part.verified), "{what}");
        // The matrix, J and the moduli are f32: about 1e-7 of p and v, and what the tolerance leaves. Without f64 the right-hand sides are, too.
        let rounded = match gpu.has_f64() && precision != Precision::F32 {
            true => 1.0,
            false => 10.0,
        };
        assert!(of_p <= 1e-7 * rounded && of_v <= 1e-6 * rounded, "{what}");
    }
}

#[test]
fn the_base_scene_agrees_with_the_direct_solve() {
    let Some(gpu) = gpu() else { return };
    let scene = BaseScene::new(20, &BaseBeam::default()).unwrap();
    agrees_with_the_direct_solve(gpu, &scene, 1.0);
}

/// The beam moves in liquid at rest, the liquid around a beam at rest: one part has no right-hand side of its own, and nothing of its residual
/// to begin with that a correction could make smaller.
#[test]
fn one_part_moves_the_other() {
    let Some(gpu) = gpu() else { return };
    let mut still_liquid = BaseScene::new(16, &BaseBeam::default()).unwrap();
    let mut still_beam = BaseScene::new(16, &BaseBeam::default()).unwrap();
    for velocity in &mut still_liquid.block.velocity {
        velocity.fill(0.0);
    }
    still_beam.displacement.fill([0.0; 3]);
    still_beam.node_velocity.fill([0.0; 3]);
    let norm = |x: &[f64]| dot(x, x).sqrt();
    let system = still_liquid.coupled_system();
    assert!(norm(&system.pressure.rhs) == 0.0 && norm(&system.solid.rhs) > 0.0);
    let system = still_beam.coupled_system();
    assert!(norm(&system.pressure.rhs) > 0.0 && norm(&system.solid.rhs) == 0.0);
    // The tolerance of a hundredth of what acts is 1e-7 of it. In f32 what rounding the unknowns leaves passes, too: of the beam's velocities it is
    // as much more as the beam is stiffer than what pushes it.
    agrees_with_the_direct_solve(gpu, &still_liquid, 5.0);
    agrees_with_the_direct_solve(gpu, &still_beam, 100.0);
}

/// Iterations in f32 until both residuals of the indefinite system are below 1e-8, and that they hardly grow with the cells.
#[test]
fn iterations_stay_few() {
    let Some(gpu) = gpu() else { return };
    for (formulation, most) in [(Formulation::TwoField, 30), (Formulation::Condensed, 20)] {
        let mut counts = Vec::new();
        for n in [16, 32] {
            let scene = BaseScene::new(n, &BaseBeam::default()).unwrap();
            let system = scene.coupled_system();
            let solver = Solver { formulation, ..Solver::default() };
            let device = holding(gpu, &scene, &system, &solver);
            let outcome = device.solve().unwrap();
            let part = outcome.parts[0];
            assert_eq!(part.status, SolveStatus::Converged, "{outcome:?}");
            assert!(part.verified && part.iterations <= most, "{outcome:?}");
            counts.push(f64::from(part.iterations));
        }
        assert!(counts[1] <= 1.25 * counts[0] + 1.0, "{counts:?}");
    }
}

/// Soft, stiff and light beams: of the two-field form as far as the polynomial's largest degree is from enough. The condensed form takes
/// at most 26 iterations where one of stiffness and density is extreme, and at most 50 where both are.
#[test]
fn extreme_beams_converge() {
    let Some(gpu) = gpu() else { return };
    for (young, density, most) in
        [(1e4, 1100.0, 26), (1e6, 20.0, 26), (1e9, 1100.0, 26), (1e7, 500.0, 26), (1e4, 20.0, 50), (1e9, 22_000.0, 50)]
    {
        let beam = BaseBeam { young, density, ..BaseBeam::default() };
        let scene = BaseScene::new(12, &beam).unwrap();
        let system = scene.coupled_system();
        for formulation in [Formulation::TwoField, Formulation::Condensed] {
            let solver = Solver { max_iterations: 400, formulation, ..Solver::default() };
            // A body that light is beyond the two-field form's polynomial, and one that stiff beyond vectors in f32.
            let narrow = !gpu.has_f64() && young > 1e7;
            if formulation == Formulation::TwoField && (density < 50.0 || narrow) {
                continue;
            }
            let device = holding(gpu, &scene, &system, &solver);
            let outcome = device.solve().unwrap();
            let (_, velocity) = device.answer().unwrap();
            let what = format!("{formulation:?}, E {young:e}, {density} kg/m^3: {outcome:?}");
            assert_eq!(outcome.parts[0].status, SolveStatus::Converged, "{what}");
            let passes = outcome.parts.iter().all(|part| part.verified && part.residual <= solver.tolerance);
            assert!(passes, "{what}");
            let finite = velocity.as_flattened().iter().all(|v| v.is_finite());
            assert!(finite, "{what}");
            assert!(!outcome.condensed || outcome.parts[0].iterations <= most, "{what}");
        }
    }
}
