//! The two-field solver on the device, on the base scene, against the f64 path.

use cutwater::elastic::Bounds;
use cutwater::gpu::{Buffer, Gpu, Recorder};
use cutwater::grid::{Axis, Grid};
use cutwater::linalg::dot;
use cutwater::reference::base_block::{DENSITY, THETA_FLOOR};
use cutwater::reference::base_scene::{BaseBeam, BaseScene};
use cutwater::reference::{
    CoupledSolution, CoupledSystem, Formulation, SolidSolver as TwinSolver, solve_coupled,
};
use cutwater::scene::{Precision, Solver};
use cutwater::solver::{
    CoupledFields, CoupledOutcome, CouplingBuffers, CouplingSize, Everywhere, Pair, Polynomial,
    PressureSystem, SolidRows, SolidSystem, SolidSystemBuffers, SolverBuffers, TwoFieldSolver,
    variant,
};
use cutwater::stages::{ElementRotations, SolidBuffers, SolidPlan};
use cutwater::state::{SolveStatus, State};

use crate::common::{Random, gpu};

/// The base scene on the device.
struct Device<'a> {
    gpu: &'a Gpu,
    grid: Grid,
    dt: f64,
    liquid: SolverBuffers,
    everywhere: Everywhere,
    pressure: PressureSystem,
    rhs: Vec<f64>,
    open: Buffer<f32>,
    velocity: Buffer<f32>,
    _distance: Buffer<f32>,
    fields: SolidBuffers,
    solids: SolidSystemBuffers,
    rotations: ElementRotations,
    system: SolidSystem,
    coupling: CouplingBuffers,
    polynomial: Polynomial,
    state: State,
    solver: TwoFieldSolver,
}

impl<'a> Device<'a> {
    fn holding(
        gpu: &'a Gpu,
        scene: &BaseScene,
        system: &CoupledSystem,
        solver: &Solver,
    ) -> Device<'a> {
        let grid = scene.block.grid;
        let padded = grid.padded();
        let field = |label: &str, n: usize| gpu.buffer::<f32>(label, n * padded.len()).unwrap();
        let (open, velocity) = (field("test.open", 3), field("test.velocity", 3));
        let distance = field("test.liquid_distance", 1);
        let clip = scene.clip();
        for (buffer, fields) in [
            (&open, &clip.cut_cells().open),
            (&velocity, &scene.block.velocity),
        ] {
            let values: Vec<f32> = Axis::ALL
                .iter()
                .flat_map(|&axis| {
                    let n = grid.faces(axis);
                    padded.pad(n, &fields[axis.index()], |value| value as f32)
                })
                .collect();
            gpu.upload(buffer, &values);
        }
        let phi = padded.pad(grid.cells, &scene.block.liquid_distance, |x| x as f32);
        gpu.upload(&distance, &phi);
        let liquid = SolverBuffers::new(gpu, &grid, solver.precision).unwrap();
        let everywhere = Everywhere::new(gpu, &grid).unwrap();
        let within = everywhere.within();
        let pressure = PressureSystem::new(gpu, &liquid, &open, &distance, within, THETA_FLOOR);
        let real = variant(gpu.has_f64(), solver.precision).real;
        let plan = SolidPlan {
            grid,
            n_nodes: scene.solids.rest.len(),
            n_elements: scene.solids.elements.len(),
            scripts: false,
            obstacles: false,
            real,
        };
        let fields = SolidBuffers::new(gpu, plan, &scene.solids).unwrap();
        let rows = SolidRows::new(&scene.solids).unwrap();
        let solids = SolidSystemBuffers::new(gpu, &rows, solver).unwrap();
        // The base scene's v* contains gravity already.
        let step = fields.step_of(glam::DVec3::ZERO, scene.dt);
        gpu.upload(&fields.step, &[step]);
        let area = grid.dx * grid.dx;
        let all = system.coupling.pairs().iter();
        let pairs: Vec<Pair> = all
            .map(|pair| Pair {
                cell: padded.index(grid.cell_at(pair.cell)),
                node: pair.node,
                value: (pair.value / area).as_vec3().to_array(),
            })
            .collect();
        let size = CouplingSize {
            quads: pairs.len(),
            pairs: pairs.len(),
        };
        let mut coupling = CouplingBuffers::new(gpu, &liquid, &solids, size).unwrap();
        let mass = DENSITY * grid.dx.powi(3) / scene.dt;
        coupling.write(gpu, &pairs, mass).unwrap();
        let bounds = Bounds::new(&scene.solids);
        let degree = bounds.chebyshev_degree(&scene.solids, scene.dt);
        let two_field = TwoFieldSolver::new(
            gpu,
            CoupledFields {
                liquid: &liquid,
                solids: &solids,
                fields: fields.fields(),
                coupling: &coupling,
                velocity: &velocity,
                open: &open,
            },
            solver,
        );
        let rhs: Vec<f64> = system.pressure.rhs.iter().map(|b| b / area).collect();
        Device {
            solver: two_field.unwrap(),
            pressure: pressure.unwrap(),
            rotations: ElementRotations::new(gpu, &fields).unwrap(),
            system: SolidSystem::new(gpu, &solids, fields.fields(), None).unwrap(),
            rhs: padded.pad(grid.cells, &rhs, |b| b),
            polynomial: Polynomial::new(degree, bounds.block_jacobi),
            state: State {
                displacement: scene.displacement.clone(),
                node_velocity: scene.node_velocity.clone(),
                ..State::at_rest(&grid)
            },
            dt: scene.dt,
            _distance: distance,
            gpu,
            grid,
            liquid,
            everywhere,
            open,
            velocity,
            fields,
            solids,
            coupling,
        }
    }

    fn at(&self) -> CoupledFields<'_> {
        CoupledFields {
            liquid: &self.liquid,
            solids: &self.solids,
            fields: self.fields.fields(),
            coupling: &self.coupling,
            velocity: &self.velocity,
            open: &self.open,
        }
    }

    /// Both systems.
    fn prepare(&self) -> Recorder<'a> {
        let Device { gpu, liquid, .. } = self;
        self.fields.write_state(gpu, &self.state);
        liquid.rhs.upload(gpu, &self.rhs);
        let mut recorder = Recorder::timed(gpu);
        recorder.stage("active_cells", |pass| {
            self.pressure.record(pass, liquid, self.everywhere.within())
        });
        recorder.stage("solid_matrices", |pass| {
            self.rotations.dispatch(pass);
            self.system.record_matrices(pass);
            self.system.record_right_hand_side(pass);
        });
        recorder
    }

    /// The verdict, pressures (Pa) and velocities (m/s).
    fn solve(&self) -> (CoupledOutcome, Vec<f64>, Vec<[f64; 3]>) {
        let Device {
            gpu, liquid, grid, ..
        } = self;
        let (outcome, _) = self
            .solver
            .solve(gpu, self.prepare(), self.at(), &self.polynomial)
            .unwrap();
        let potential = liquid.potential.download(gpu).unwrap();
        let to_pressure = DENSITY * grid.dx / self.dt;
        let pressure = grid
            .padded()
            .unpad(grid.cells, &potential, |phi| to_pressure * phi);
        let mut state = self.state.clone();
        self.fields.read_state(gpu, &mut state).unwrap();
        (outcome, pressure, state.node_velocity)
    }
}

fn direct(scene: &BaseScene, system: &CoupledSystem) -> CoupledSolution {
    let exact = Solver {
        tolerance: 1e-12,
        ..Solver::default()
    };
    let solver = TwinSolver::new(&scene.solids);
    solve_coupled(
        system,
        Formulation::Indefinite,
        &solver,
        &scene.solids,
        &exact,
    )
    .unwrap()
}

/// A random vector of unknowns: quads, then nodes; 0 in what is none.
fn noise(device: &Device, system: &CoupledSystem, seed: u64) -> Vec<f64> {
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
fn dot_active(device: &Device, system: &CoupledSystem, x: &[f64], y: &[f64]) -> f64 {
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
    for young in [1e4, 1e6, 1e9] {
        let beam = BaseBeam {
            young,
            ..BaseBeam::default()
        };
        let scene = BaseScene::new(16, &beam).unwrap();
        let system = scene.coupled_system();
        for precision in [Precision::F32, Precision::Mixed] {
            let solver = Solver {
                precision,
                ..Solver::default()
            };
            let device = Device::holding(gpu, &scene, &system, &solver);
            device.prepare().submit();
            let [x, y] = [1, 2].map(|seed| noise(&device, &system, seed));
            let apply = |x: &[f64]| device.solver.apply(gpu, device.at(), x).unwrap();
            let precondition = |g: &[f64]| {
                let z = device
                    .solver
                    .precondition(gpu, device.at(), &device.polynomial, g);
                z.unwrap()
            };
            let inner = |a: &[f64], b: &[f64]| dot_active(&device, &system, a, b);
            let what = format!("E {young:e} {precision:?}");
            let eps = f64::from(f32::EPSILON);
            for (name, [ax, ay]) in [
                ("operator", [apply(&x), apply(&y)]),
                ("preconditioner", [precondition(&x), precondition(&y)]),
            ] {
                let [xax, yay] = [inner(&x, &ax), inner(&y, &ay)];
                assert!(xax > 0.0 && yay > 0.0, "{what} {name}: {xax} and {yay}");
                let off = (inner(&x, &ay) - inner(&y, &ax)).abs();
                let bound = 256.0 * eps * (xax * yay).sqrt();
                assert!(
                    off <= bound,
                    "{what} {name}: asymmetric by {off:e} of {bound:e}"
                );
            }
        }
    }
}

/// Largest difference over the largest value.
fn off(found: &[f64], wanted: &[f64]) -> f64 {
    let largest = wanted.iter().fold(0.0, |m, x| f64::max(m, x.abs()));
    let pairs = found.iter().zip(wanted);
    pairs.fold(0.0, |m, (a, b)| f64::max(m, (a - b).abs())) / largest
}

#[test]
fn the_base_scene_agrees_with_the_direct_solve() {
    let Some(gpu) = gpu() else { return };
    let mut precisions = vec![(Precision::F32, 1e-5)];
    if gpu.has_f64() {
        precisions.extend([(Precision::Mixed, 1e-10), (Precision::F64, 1e-10)]);
    }
    let scene = BaseScene::new(20, &BaseBeam::default()).unwrap();
    let system = scene.coupled_system();
    let exact = direct(&scene, &system);
    let unknowns = system.pressure.n_unknowns() + system.solid.n_unknowns();
    for (precision, tolerance) in precisions {
        let solver = Solver {
            precision,
            tolerance,
            ..Solver::default()
        };
        let device = Device::holding(gpu, &scene, &system, &solver);
        let (outcome, mut pressure, velocity) = device.solve();
        for (cell, pressure) in pressure.iter_mut().enumerate() {
            if !system.pressure.stencil.active(cell) {
                *pressure = 0.0;
            }
        }
        let of_p = off(&pressure, &exact.pressure);
        let of_v = off(velocity.as_flattened(), exact.velocity.as_flattened());
        let what = format!("{precision:?}: {outcome:?}, p {of_p:e}, v {of_v:e}");
        assert_eq!(outcome.status, SolveStatus::Converged, "{what}");
        assert_eq!(outcome.unknowns as usize, unknowns, "{what}");
        let [of_liquid, of_solid] = outcome.residuals;
        assert!(of_liquid <= tolerance && of_solid <= tolerance, "{what}");
        // The matrix, J and the moduli are f32: about 1e-7 of p and v, and what the tolerance leaves.
        let rounded = if precision == Precision::F32 {
            10.0
        } else {
            1.0
        };
        assert!(of_p <= 1e-7 * rounded && of_v <= 1e-6 * rounded, "{what}");
    }
}

/// Iterations in f32 until both residuals of the indefinite system are below 1e-8, and that they hardly grow with the cells.
#[test]
fn iterations_stay_few() {
    let Some(gpu) = gpu().filter(|gpu| gpu.has_f64()) else {
        return;
    };
    let mut counts = Vec::new();
    for n in [16, 32] {
        let scene = BaseScene::new(n, &BaseBeam::default()).unwrap();
        let system = scene.coupled_system();
        let device = Device::holding(gpu, &scene, &system, &Solver::default());
        let (outcome, ..) = device.solve();
        assert_eq!(outcome.status, SolveStatus::Converged, "{outcome:?}");
        assert!(outcome.verified && outcome.iterations <= 30, "{outcome:?}");
        counts.push(f64::from(outcome.iterations));
    }
    assert!(counts[1] <= 1.25 * counts[0] + 1.0, "{counts:?}");
}

/// Soft, stiff and light beams, as far as the polynomial's largest degree is from enough.
#[test]
fn extreme_beams_converge() {
    let Some(gpu) = gpu().filter(|gpu| gpu.has_f64()) else {
        return;
    };
    for (young, density) in [(1e4, 1100.0), (1e7, 500.0), (1e6, 50.0), (1e9, 1100.0)] {
        let beam = BaseBeam {
            young,
            density,
            ..BaseBeam::default()
        };
        let scene = BaseScene::new(12, &beam).unwrap();
        let system = scene.coupled_system();
        let solver = Solver {
            max_iterations: 400,
            ..Solver::default()
        };
        let device = Device::holding(gpu, &scene, &system, &solver);
        let (outcome, _, velocity) = device.solve();
        let what = format!("E {young:e}, {density} kg/m^3: {outcome:?}");
        assert_eq!(outcome.status, SolveStatus::Converged, "{what}");
        let passes = outcome.residuals.iter().all(|r| *r <= solver.tolerance);
        assert!(passes && outcome.verified, "{what}");
        let finite = velocity.as_flattened().iter().all(|v| v.is_finite());
        assert!(finite, "{what}");
    }
}
