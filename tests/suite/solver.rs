//! The pressure solver on the device: against direct f64 solves, symmetric and positive, iteration counts, verdicts, repeatable.

use std::cell::OnceCell;

use cutwater::fields::SolverBuffers;
use cutwater::gpu::{Buffer, Gpu, Real, RealBuffer, Recorder};
use cutwater::grid::{Axis, Grid, Padded};
use cutwater::linalg::{LinearOperator, conjugate_gradient, dot, norm};
use cutwater::reference::base_block::{BaseBlock, DENSITY, DT, THETA_FLOOR};
use cutwater::reference::{ActiveCells, Multigrid, RightHandSide, Stencil, active_cells, solve_direct};
use cutwater::scene::{Precision, Preconditioner, Solver};
use cutwater::solver::{Outcome, PressureSolver};
use cutwater::stages::{Components, Everywhere, PressureSystem, Seal};
use cutwater::state::SolveStatus;
use cutwater::step::Stage;

use crate::common::{Random, digest, gpu, same_with_any_number_of_threads};
use crate::components::wall_around;

/// What a system is made of, host layout.
pub(crate) struct Case {
    pub(crate) grid: Grid,
    pub(crate) open: [Vec<f64>; 3],
    /// m
    pub(crate) liquid_distance: Vec<f64>,
    /// u* on the faces, m/s.
    pub(crate) velocity: [Vec<f64>; 3],
    /// b, m/s.
    pub(crate) rhs: Vec<f64>,
}

impl Case {
    /// Open faces, 1 everywhere but at the walls, no velocity, no right-hand side; `liquid` decides which cells are.
    pub(crate) fn new(cells: [usize; 3], liquid: impl Fn([usize; 3]) -> bool) -> Case {
        let grid = Grid { cells, dx: 0.1 };
        let open = Axis::ALL.map(|axis| {
            (0..grid.n_faces(axis))
                .map(|face| {
                    let sides = grid.face_sides(axis, grid.face_at(axis, face));
                    f64::from(u8::from(sides.iter().all(Option::is_some)))
                })
                .collect()
        });
        Case {
            grid,
            open,
            liquid_distance: (0..grid.n_cells())
                .map(|cell| if liquid(grid.cell_at(cell)) { -0.05 } else { 0.05 })
                .collect(),
            velocity: Axis::ALL.map(|axis| vec![0.0; grid.n_faces(axis)]),
            rhs: vec![0.0; grid.n_cells()],
        }
    }

    /// Multiplies the open fraction of every face, given its position and a random number generator.
    pub(crate) fn narrow(mut self, factor: impl Fn(Axis, [usize; 3]) -> f64) -> Case {
        for axis in Axis::ALL {
            for (face, open) in self.open[axis.index()].iter_mut().enumerate() {
                *open = f64::from((*open * factor(axis, self.grid.face_at(axis, face))) as f32);
            }
        }
        self
    }

    /// A random right-hand side.
    pub(crate) fn random_rhs(mut self, seed: u64) -> Case {
        let mut random = Random(seed);
        self.rhs.iter_mut().for_each(|b| *b = random.uniform(-1.0, 1.0));
        self
    }

    /// The unknowns as the f64 path finds them.
    pub(crate) fn twin(&self) -> ActiveCells {
        active_cells(&self.grid, &self.open, &self.liquid_distance, THETA_FLOOR)
    }

    /// The system of the f64 path, for dt dx / rho = 1: its pressure is the potential.
    pub(crate) fn twin_system(&self) -> cutwater::reference::PressureSystem {
        let active = self.twin();
        let mut values = self.rhs.clone();
        for (cell, value) in values.iter_mut().enumerate() {
            if !active.stencil.active(cell) {
                *value = 0.0;
            }
        }
        let scale = norm(&values);
        let rhs = RightHandSide { values, scale };
        let mut system = cutwater::reference::PressureSystem::new(active, rhs, 1.0, self.grid.dx);
        let mut rhs = std::mem::take(&mut system.rhs);
        system.remove_closed_means(&mut rhs);
        system.rhs = rhs;
        system
    }
}

/// The solver on the device, holding one case at a time.
pub(crate) struct Device<'a> {
    pub(crate) gpu: &'a Gpu,
    cells: [usize; 3],
    padded: Padded,
    pub(crate) open: Buffer<f32>,
    velocity: Buffer<f32>,
    distance: Buffer<f32>,
    pub(crate) buffers: SolverBuffers,
    everywhere: Everywhere,
    system: PressureSystem,
    components: Components,
    solver: Solver,
    /// Made when first needed: it has most of the kernels.
    pressure: OnceCell<PressureSolver>,
    rhs: Vec<f64>,
}

impl<'a> Device<'a> {
    pub(crate) fn new(gpu: &'a Gpu, cells: [usize; 3], solver: &Solver) -> Device<'a> {
        let grid = Grid { cells, dx: 0.1 };
        let padded = grid.padded();
        let field = |label: &str, n: usize| gpu.buffer(label, n * padded.len()).unwrap();
        let open = field("test.open", 3);
        let distance = field("test.liquid_distance", 1);
        let buffers = SolverBuffers::new(gpu, &grid, solver.precision).unwrap();
        let everywhere = Everywhere::new(gpu, &grid).unwrap();
        let within = everywhere.within();
        let system = PressureSystem::new(gpu, &buffers, &open, &distance, within, THETA_FLOOR);
        Device {
            system: system.unwrap(),
            everywhere,
            components: Components::new(gpu, &buffers, false).unwrap(),
            velocity: field("test.velocity", 3),
            open,
            distance,
            solver: *solver,
            pressure: OnceCell::new(),
            rhs: Vec::new(),
            gpu,
            padded,
            cells,
            buffers,
        }
    }

    pub(crate) fn holding(gpu: &'a Gpu, case: &Case, solver: &Solver) -> Device<'a> {
        let mut device = Device::new(gpu, case.grid.cells, solver);
        device.load(case);
        device
    }

    /// Takes another case of the same cells.
    pub(crate) fn load(&mut self, case: &Case) {
        let Device { gpu, padded, .. } = self;
        assert_eq!(case.grid.cells, self.cells, "the cells of the case");
        for (buffer, fields) in [(&self.open, &case.open), (&self.velocity, &case.velocity)] {
            let values: Vec<f32> = Axis::ALL
                .iter()
                .flat_map(|&axis| {
                    let n = case.grid.faces(axis);
                    padded.pad(n, &fields[axis.index()], |value| value as f32)
                })
                .collect();
            gpu.upload(buffer, &values);
        }
        let distance = padded.pad(self.cells, &case.liquid_distance, |value| value as f32);
        gpu.upload(&self.distance, &distance);
        self.rhs = padded.pad(self.cells, &case.rhs, |value| value);
    }

    fn pressure(&self) -> &PressureSolver {
        self.pressure.get_or_init(|| {
            let Device { gpu, buffers, velocity, open, solver, .. } = self;
            PressureSolver::new(gpu, buffers, velocity, open, solver).unwrap()
        })
    }

    /// Everything up to the solve.
    pub(crate) fn prepare(&self) -> Recorder {
        self.prepare_sealed(None)
    }

    /// The same with solids, which seal components.
    pub(crate) fn prepare_sealed(&self, seal: Option<&Seal>) -> Recorder {
        let Device { buffers, .. } = self;
        buffers.rhs.upload(self.gpu, &self.rhs);
        let mut recorder = Recorder::timed(self.gpu);
        let within = self.everywhere.within();
        recorder.stage(Stage::ActiveCells.name(), |pass| self.system.record(pass, buffers, within));
        recorder.stage(Stage::ClosedComponents.name(), |pass| {
            self.components.label(pass, buffers, seal);
            self.components.remove_means(pass);
        });
        recorder
    }

    /// The solve, with the potential's means over closed components taken out.
    pub(crate) fn solve(&self) -> Solved {
        let (outcome, _) = self.pressure().solve(self.gpu, self.prepare(), &self.buffers).unwrap();
        let mut recorder = Recorder::new(self.gpu);
        recorder.stage(Stage::ClosedComponents.name(), |pass| self.components.shift_potential(pass));
        recorder.submit();
        let potential = self.cells(&self.buffers.potential);
        Solved { outcome, potential }
    }

    /// B x for x and answer in host layout, inactive cells 0.
    fn apply(&self, twin: &Stencil, x: &[f64]) -> Vec<f64> {
        let padded = self.padded.pad(self.cells, x, |value| value);
        let answer = self.pressure().apply(self.gpu, &self.buffers, &padded);
        self.active_part(twin, &answer.unwrap())
    }

    /// H r, likewise.
    fn precondition(&self, twin: &Stencil, r: &[f64]) -> Vec<f64> {
        let padded = self.padded.pad(self.cells, r, |value| value);
        let answer = self.pressure().precondition(self.gpu, &self.buffers, &padded);
        self.active_part(twin, &answer.unwrap())
    }

    fn active_part(&self, twin: &Stencil, device: &[f64]) -> Vec<f64> {
        let mut host = self.padded.unpad(self.cells, device, |value| value);
        for (cell, value) in host.iter_mut().enumerate() {
            if !twin.active(cell) {
                *value = 0.0;
            }
        }
        host
    }

    /// A field in host layout.
    pub(crate) fn cells(&self, field: &RealBuffer) -> Vec<f64> {
        let values = field.download(self.gpu).unwrap();
        self.padded.unpad(self.cells, &values, |value| value)
    }
}

/// A system on the device, solved.
pub(crate) struct Solved {
    pub(crate) outcome: Outcome,
    /// Host layout, m/s.
    pub(crate) potential: Vec<f64>,
}

/// The base block at n^3 cells.
fn block_case(n: usize) -> Case {
    let block = BaseBlock::new(n);
    let rhs = block.pressure_system().rhs;
    Case {
        rhs: rhs.iter().map(|value| value / block.grid.dx.powi(2)).collect(),
        grid: block.grid,
        open: block.open,
        liquid_distance: block.liquid_distance,
        velocity: block.velocity,
    }
}

pub(crate) fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |max, value| value.abs().max(max))
}

#[test]
fn base_block_agrees_with_the_direct_solve() {
    let Some(gpu) = gpu() else { return };
    let mut precisions = vec![(Precision::Mixed, 1e-6), (Precision::F32, 1e-4)];
    if gpu.has_f64() {
        precisions.push((Precision::F64, 1e-6));
    }
    for (precision, bound) in precisions {
        for preconditioner in [Preconditioner::Multigrid, Preconditioner::Jacobi] {
            let tolerance = if precision == Precision::F32 { 1e-4 } else { 1e-8 };
            let solver = Solver { precision, preconditioner, tolerance, max_iterations: 1000, ..Solver::default() };
            let block = BaseBlock::new(20);
            let solved = Device::holding(gpu, &block_case(20), &solver).solve();
            let case = format!("{precision:?} {preconditioner:?}");
            assert_eq!(solved.outcome.status, SolveStatus::Converged, "{case}");
            assert!(solved.outcome.verified && solved.outcome.residual <= tolerance, "{case}: {:?}", solved.outcome);
            let system = block.pressure_system();
            assert_eq!(solved.outcome.unknowns as usize, system.n_unknowns(), "{case}: unknowns");
            let exact = Solver { tolerance: 1e-12, ..Solver::default() };
            let (direct, _) = solve_direct(&system, &exact).unwrap();
            let to_potential = DT / (DENSITY * block.grid.dx);
            let scale = largest(direct.iter().map(|p| p * to_potential));
            let difference = largest(direct.iter().zip(&solved.potential).map(|(p, x)| p * to_potential - x));
            assert!(difference <= bound * scale, "{case}: {difference:e} of {scale:e}");
        }
    }
}

#[test]
fn iterations_hardly_grow_with_the_grid() {
    let Some(gpu) = gpu() else { return };
    let iterations = [20, 40, 60, 80, 100].map(|n| {
        let solved = Device::holding(gpu, &block_case(n), &Solver::default()).solve();
        assert_eq!(solved.outcome.status, SolveStatus::Converged, "{n}^3");
        assert!(solved.outcome.residual <= 1e-8, "{n}^3: {:?}", solved.outcome);
        solved.outcome.iterations
    });
    let (least, most) = (iterations.iter().min().unwrap(), iterations.iter().max().unwrap());
    assert!(*most <= 20, "{iterations:?}");
    assert!(f64::from(*most) <= 1.6 * f64::from(*least), "{iterations:?}");
}

/// In f32 the rounding of the unknowns leaves more than a tolerance asks for; that passes, as the smallest residual there is.
#[test]
fn single_precision_ends_at_its_own_rounding() {
    let Some(gpu) = gpu() else { return };
    for preconditioner in [Preconditioner::Multigrid, Preconditioner::Jacobi] {
        for n in [20, 40, 60] {
            let block = BaseBlock::new(n);
            let system = block.pressure_system();
            let diagonal = &system.stencil.diagonal;
            for tolerance in [Precision::F32.default_tolerance(), 1e-12] {
                let solver = Solver {
                    precision: Precision::F32,
                    preconditioner,
                    tolerance,
                    max_iterations: 2000,
                    ..Solver::default()
                };
                let case = block_case(n);
                let Solved { outcome, potential, .. } = Device::holding(gpu, &case, &solver).solve();
                let what = format!("{preconditioner:?} {n}^3 {tolerance:e}: {outcome:?}");
                assert_eq!(outcome.status, SolveStatus::Converged, "{what}");
                assert!(outcome.verified, "{what}");
                // Potential and right-hand side of the device are in m/s.
                let values = diagonal.iter().zip(&potential).map(|(d, x)| d * x);
                let values: Vec<f64> = values.collect();
                let of_x = f64::from(f32::EPSILON) * norm(&values) / norm(&case.rhs);
                assert!(outcome.residual <= of_x.max(tolerance), "{what}: {of_x:e}");
                assert!(of_x < 1e-4, "{what}: {of_x:e}");
            }
        }
    }
}

/// Random values in the active cells that an f32 holds exactly.
fn random_unknowns(twin: &Stencil, seed: u64) -> Vec<f64> {
    let mut random = Random(seed);
    (0..twin.grid.n_cells())
        .map(|cell| {
            let value = f64::from(random.uniform(-1.0, 1.0) as f32);
            if twin.active(cell) { value } else { 0.0 }
        })
        .collect()
}

/// Distances over eight decades on either side of the surface, half of them negative: theta from its floor to 1.
fn random_distances(mut case: Case, seed: u64) -> Case {
    let mut random = Random(seed);
    for distance in &mut case.liquid_distance {
        let size = 0.1 * 10_f64.powf(random.uniform(-8.0, 0.0));
        *distance = f64::from(distance.signum() as f32 * size as f32);
    }
    case
}

/// Closed faces, slivers down to the area clamp, and whole ones.
fn slivers(case: Case, seed: u64) -> Case {
    case.narrow(move |axis, [i, j, k]| {
        let mut random = Random(seed + (axis.index() + 3 * (i + 100 * (j + 100 * k))) as u64);
        random.bits();
        match random.uniform(0.0, 4.0) {
            share if share < 1.0 => 0.0,
            share if share < 2.0 => 10_f64.powf(random.uniform(-3.0, 0.0)),
            _ => 1.0,
        }
    })
}

/// Cells of which about `share` are liquid, each for itself.
fn scattered(cells: [usize; 3], share: f64, seed: u64) -> Case {
    Case::new(cells, move |[i, j, k]| {
        let mut random = Random(seed + (i + 100 * (j + 100 * k)) as u64);
        random.bits();
        random.uniform(0.0, 1.0) < share
    })
}

/// Systems that strain a solver, with random right-hand sides, and the most iterations each may take.
fn hard_cases() -> Vec<(&'static str, Case, u32)> {
    let pool = |cells: [usize; 3]| Case::new(cells, move |[_, j, _]| 2 * j < cells[1] + 1);
    let cases = vec![
        ("one cell", Case::new([9, 8, 7], |at| at == [5, 4, 3]), 4),
        ("droplets", scattered([15, 14, 13], 0.2, 1), 16),
        ("sponge", scattered([15, 14, 13], 0.7, 2), 16),
        ("pool", pool([21, 18, 13]), 16),
        ("tiny and large theta", random_distances(pool([16, 15, 14]), 3), 20),
        ("scattered, tiny and large theta", random_distances(scattered([12, 13, 14], 0.5, 4), 4), 16),
        ("slivers", slivers(pool([14, 15, 16]), 5), 28),
        ("slivers of slivers", random_distances(slivers(scattered([13, 13, 13], 0.6, 6), 6), 6), 18),
        ("channel along x", Case::new([70, 1, 1], |[i, _, _]| i < 65), 25),
        ("channel along y", Case::new([1, 70, 1], |[_, j, _]| j < 65), 25),
        ("channel along z", Case::new([1, 1, 70], |[_, _, k]| k < 65), 25),
        ("slab along x and z", Case::new([30, 1, 29], |[i, _, k]| i + k < 50), 20),
        ("slab along x and y", Case::new([30, 29, 1], |[i, j, _]| i + j < 50), 20),
        ("slab along y and z", Case::new([1, 30, 29], |[_, j, k]| j + k < 50), 20),
        ("narrow and high", pool([3, 50, 7]), 16),
        ("full but for one cell", Case::new([17, 9, 12], |at| at != [16, 8, 0]), 18),
    ];
    cases.into_iter().map(|(name, case, most)| (name, case.random_rhs(11), most)).collect()
}

/// The precisions that the adapter has.
fn precisions(gpu: &Gpu) -> Vec<Precision> {
    let mut precisions = vec![Precision::F32, Precision::Mixed];
    if gpu.has_f64() {
        precisions.push(Precision::F64);
    }
    precisions
}

fn settings(precision: Precision) -> Solver {
    Solver { precision, tolerance: if precision == Precision::F32 { 1e-4 } else { 1e-8 }, ..Solver::default() }
}

/// Operator and V-cycle against the f64 path, their symmetry and positivity.
fn assert_operators(what: &str, case: &Case, device: &Device, precision: Precision) {
    let twin = case.twin().stencil;
    let (single, inner) = match precision {
        Precision::F64 => (f64::from(f32::EPSILON), f64::EPSILON),
        // Mixed computes its corrections as f32 does.
        Precision::F32 | Precision::Mixed => (f64::from(f32::EPSILON), f64::from(f32::EPSILON)),
    };
    device.prepare().submit();
    let (x, y) = (random_unknowns(&twin, 31), random_unknowns(&twin, 32));
    let mut expected = vec![0.0; x.len()];

    let (bx, by) = (device.apply(&twin, &x), device.apply(&twin, &y));
    twin.apply(&x, &mut expected);
    for cell in twin.active_cells() {
        let fluxes = twin
            .neighbours(cell)
            .iter()
            .map(|(neighbour, weight)| weight * (x[cell] - x[*neighbour]).abs())
            .sum::<f64>();
        let surface = twin.dirichlet[cell] * x[cell].abs();
        // Theta is the one coefficient with roundings, which are in f32 in every precision.
        let bound = 8.0 * inner * (fluxes + surface) + 4.0 * single * surface;
        assert!(
            (bx[cell] - expected[cell]).abs() <= bound,
            "{what}: B x in cell {cell}: {:e}, not {:e}",
            bx[cell],
            expected[cell]
        );
    }
    let (hx, hy) = (device.precondition(&twin, &x), device.precondition(&twin, &y));
    Multigrid::new(&twin).apply(&x, &mut expected);
    let difference = largest(hx.iter().zip(&expected).map(|(a, b)| a - b));
    let scale = largest(expected.iter().copied());
    assert!(difference <= 100.0 * single * scale, "{what}: H x: {difference:e} of {scale:e}");
    for (name, ax, ay) in [("B", bx, by), ("H", hx, hy)] {
        let (left, right) = (dot(&ax, &y), dot(&x, &ay));
        assert!(
            (left - right).abs() <= 30.0 * inner * norm(&ax) * norm(&y),
            "{what}: y.{name}x = {left:e}, x.{name}y = {right:e}"
        );
        for product in [dot(&ax, &x), dot(&ay, &y)] {
            assert!(product > 0.0, "{what}: x.{name}x = {product:e}");
        }
    }
}

#[test]
fn hard_systems_have_the_twins_operators_and_solutions() {
    let Some(gpu) = gpu() else { return };
    for (name, case, most) in hard_cases() {
        let system = case.twin_system();
        let exact = Solver { tolerance: 1e-12, ..Solver::default() };
        let (direct, _) = solve_direct(&system, &exact).unwrap();
        for precision in precisions(gpu) {
            let solver = settings(precision);
            let device = Device::holding(gpu, &case, &solver);
            assert_operators(&format!("{name} {precision:?}"), &case, &device, precision);
            let solved = device.solve();
            let outcome = solved.outcome;
            let what = format!("{name} {precision:?}: {outcome:?}");
            assert_eq!(outcome.status, SolveStatus::Converged, "{what}");
            assert!(outcome.verified && outcome.residual <= solver.tolerance, "{what}");
            assert!(outcome.iterations <= most, "{what}");
            assert_eq!(outcome.unknowns as usize, system.n_unknowns(), "{what}");
            // In the norm that conjugate gradients minimise.
            let energy = |x: &[f64]| {
                let mut product = vec![0.0; x.len()];
                system.stencil.apply(x, &mut product);
                dot(x, &product).sqrt()
            };
            let pairs = direct.iter().zip(&solved.potential);
            let error = energy(&pairs.map(|(p, x)| p - x).collect::<Vec<f64>>());
            let scale = energy(&direct);
            let mut bound = 100.0 * solver.tolerance * scale;
            if device.buffers.potential.real == Real::F32 {
                // The potential's own rounding; e.Be <= 2 e.De with the diagonal D.
                let diagonal = system.stencil.diagonal.iter().zip(&direct);
                let rounding = diagonal.map(|(d, p)| d * p * p).sum::<f64>().sqrt();
                bound += f64::from(f32::EPSILON) * rounding;
            }
            assert!(error <= bound, "{what}: {error:e} of {scale:e}");
            let repeated = device.solve();
            assert_eq!(repeated.potential, solved.potential, "{what}: bit for bit");
        }
    }
}

/// Only what the lists of the last system name is cleared, so systems with nothing, little and everything in common follow each
/// other on the same buffers.
#[test]
fn an_earlier_system_leaves_nothing_behind() {
    let Some(gpu) = gpu() else { return };
    let cells = [21, 18, 13];
    let pool = |height: usize| Case::new(cells, move |[_, j, _]| j < height).random_rhs(4);
    let air = Case::new(cells, |_| false);
    let column = Case::new(cells, |[i, _, k]| i > 15 && k > 7).random_rhs(6);
    for precision in precisions(gpu) {
        let mut used = Device::new(gpu, cells, &settings(precision));
        for case in [&pool(17), &column, &pool(3), &air, &scattered(cells, 0.3, 9).random_rhs(7), &pool(18), &column] {
            used.load(case);
            let fresh = Device::holding(gpu, case, &settings(precision));
            let [(used, device), (new, _)] = [(used.solve(), &used), (fresh.solve(), &fresh)];
            let twin = case.twin().stencil;
            let liquid = |solved: &Solved| -> Vec<f64> {
                let cells = twin.active_cells().into_iter();
                cells.map(|cell| solved.potential[cell]).collect()
            };
            assert_eq!(liquid(&used), liquid(&new), "{precision:?}: potential");
            let words = |device: &Device| {
                let SolverBuffers { flags, matrix, .. } = &device.buffers;
                [flags, &matrix.words].map(|words| gpu.download(words).unwrap())
            };
            assert!(words(device) == words(&fresh), "{precision:?}: flags, matrix");
        }
    }
}

#[test]
fn nothing_to_solve_is_solved_by_zero() {
    let Some(gpu) = gpu() else { return };
    let cells = [10, 9, 8];
    let pool = || Case::new(cells, |[_, j, _]| j < 5);
    let empty = Case::new(cells, |_| false).random_rhs(1);
    let lone = Case::new([1, 1, 1], |_| true).random_rhs(1);
    let mut dead_air = pool();
    // A right-hand side where there is no liquid is none.
    for (cell, b) in dead_air.rhs.iter_mut().enumerate() {
        *b = if dead_air.liquid_distance[cell] < 0.0 { 0.0 } else { 1.0 };
    }
    let mut rounding = pool().random_rhs(2);
    rounding.rhs.iter_mut().for_each(|b| *b *= 1e-15);
    rounding.velocity.iter_mut().flatten().for_each(|u| *u = 10.0);
    for precision in precisions(gpu) {
        for (name, case, unknowns) in [
            ("zero", &pool(), 10 * 5 * 8),
            ("no liquid", &empty, 0),
            ("one cell without an open face", &lone, 0),
            ("right-hand side in air", &dead_air, 400),
            ("below the rounding of the fluxes", &rounding, 400),
        ] {
            let solved = Device::holding(gpu, case, &settings(precision)).solve();
            let outcome = solved.outcome;
            assert_eq!(
                (outcome.status, outcome.iterations, outcome.unknowns),
                (SolveStatus::Converged, 0, unknowns),
                "{name} {precision:?}: {outcome:?}"
            );
            assert!(outcome.residual <= 1.0, "{name} {precision:?}: {outcome:?}");
            assert_eq!(largest(solved.potential), 0.0, "{name} {precision:?}");
        }
    }
}

#[test]
fn a_solution_is_recognised_and_a_limit_is_told() {
    let Some(gpu) = gpu() else { return };
    let case = Case::new([24, 20, 16], |[_, j, _]| j < 15).random_rhs(3);
    for precision in precisions(gpu) {
        let full = Device::holding(gpu, &case, &settings(precision)).solve().outcome;
        let mut last = 1.0;
        for limit in [1, 2, full.iterations / 2] {
            let solver = Solver { max_iterations: limit, ..settings(precision) };
            let solved = Device::holding(gpu, &case, &solver).solve();
            let outcome = solved.outcome;
            assert_eq!(
                (outcome.status, outcome.iterations),
                (SolveStatus::IterationLimit, limit),
                "{precision:?}: {outcome:?}"
            );
            assert!(
                outcome.verified && outcome.residual > solver.tolerance && outcome.residual < last,
                "{precision:?}: {outcome:?} after {last:e}"
            );
            assert!(largest(solved.potential) > 0.0, "the best iterate is kept");
            last = outcome.residual;
        }
        let enough = Solver { max_iterations: full.iterations, ..settings(precision) };
        let outcome = Device::holding(gpu, &case, &enough).solve().outcome;
        assert_eq!(outcome.status, SolveStatus::Converged, "{precision:?}: {outcome:?}");
        // So few iterations of Jacobi make it worse: what is kept is the start, and the limit is what ended the solve.
        for limit in [1, 2, 3] {
            let solver =
                Solver { max_iterations: limit, preconditioner: Preconditioner::Jacobi, ..settings(precision) };
            let solved = Device::holding(gpu, &case, &solver).solve();
            let outcome = solved.outcome;
            assert_eq!(outcome.status, SolveStatus::IterationLimit, "{precision:?}: {outcome:?}");
            assert!(outcome.residual <= 1.0, "{precision:?}: {outcome:?}");
        }
    }
}

/// The diagonal's inverse.
struct Diagonal(Vec<f64>);

impl LinearOperator for Diagonal {
    fn size(&self) -> usize {
        self.0.len()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        for (y, (x, diagonal)) in y.iter_mut().zip(x.iter().zip(&self.0)) {
            *y = if *diagonal > 0.0 { x / diagonal } else { 0.0 };
        }
    }
}

/// A round of N iterations, wherever in a block of dispatches it ends, is N iterations of conjugate gradients.
#[test]
fn a_limit_of_iterations_leaves_the_iterate_of_the_twin() {
    let Some(gpu) = gpu() else { return };
    let case = Case::new([24, 20, 16], |[_, j, _]| j < 15).random_rhs(3);
    let system = case.twin_system();
    let multigrid = Multigrid::new(&system.stencil);
    let diagonal = Diagonal(system.stencil.diagonal.clone());
    for precision in precisions(gpu) {
        // Iterations that end within the first round, which f32 ends early, and whose rounding they must not feel.
        let (most, bound, tolerance) = match precision {
            // The weights of the sweeps are f32 on the device.
            Precision::F64 => ([12, 70], 1e-6, 1e-13),
            Precision::F32 | Precision::Mixed => ([6, 24], 1e-4, 1e-6),
        };
        let [multigrid, diagonal]: [&dyn LinearOperator; 2] = [&multigrid, &diagonal];
        let cases = [(Preconditioner::Multigrid, multigrid, most[0]), (Preconditioner::Jacobi, diagonal, most[1])];
        for (preconditioner, twin, most) in cases {
            for limit in 1..=most {
                let solver =
                    Solver { precision, preconditioner, tolerance, max_iterations: limit, ..Solver::default() };
                let solved = Device::holding(gpu, &case, &solver).solve();
                let what = format!("{precision:?} {preconditioner:?} {limit}");
                assert_eq!(solved.outcome.iterations, limit, "{what}: iterations");
                assert_eq!(solved.outcome.refinements, 1, "{what}: rounds");
                let mut x = vec![0.0; case.rhs.len()];
                conjugate_gradient(&system.stencil, twin, &system.rhs, &mut x, 0.0, limit as usize);
                let difference: Vec<f64> = x.iter().zip(&solved.potential).map(|(a, b)| a - b).collect();
                assert!(norm(&difference) <= bound * norm(&x), "{what}: {:e}", norm(&difference) / norm(&x));
            }
        }
    }
}

/// A round of which the first direction has negative energy, since the matrix has the other sign, or is none, since the V-cycle has too:
/// that is told, and the unknowns stay as they were.
#[test]
fn a_breakdown_is_told() {
    let Some(gpu) = gpu() else { return };
    // No quad takes its weights from its level.
    let case = Case::new([10, 9, 8], |[_, j, _]| j < 5).narrow(|_, _| 0.5).random_rhs(5);
    for precision in precisions(gpu) {
        for (preconditioner, iterations) in [(Preconditioner::Multigrid, 0), (Preconditioner::Jacobi, 1)] {
            let solver = Solver { preconditioner, ..settings(precision) };
            let device = Device::holding(gpu, &case, &solver);
            device.prepare().submit();
            let matrix = &device.buffers.matrix;
            let mut values = matrix.download(gpu).unwrap();
            // Of five sections the last is the inverse of the diagonal.
            let turned = match preconditioner {
                Preconditioner::Jacobi => values.len() / 5 * 4,
                _ => values.len(),
            };
            values[..turned].iter_mut().for_each(|value| *value *= -1.0);
            matrix.upload(gpu, &values);
            let recorder = Recorder::new(gpu);
            let solve = device.pressure().solve(gpu, recorder, &device.buffers);
            let (outcome, _) = solve.unwrap();
            assert_eq!(
                (outcome.status, outcome.iterations, outcome.refinements),
                (SolveStatus::Breakdown, iterations, 1),
                "{precision:?} {preconditioner:?}: {outcome:?}"
            );
            assert!((outcome.residual - 1.0).abs() <= 1e-5, "{outcome:?}");
            let potential = device.cells(&device.buffers.potential);
            assert_eq!(largest(potential), 0.0, "{precision:?} {preconditioner:?}");
        }
    }
}

#[test]
fn a_matrix_without_a_factor_is_a_breakdown() {
    let case = Case::new([6, 5, 4], |[_, j, _]| j < 3).random_rhs(1);
    let mut system = case.twin_system();
    // Far below the weights of its faces.
    let cell = system.stencil.active_cells()[0];
    system.stencil.diagonal[cell] = 1e-3;
    let (pressure, report) = solve_direct(&system, &Solver::default()).unwrap();
    assert_eq!(report.status, SolveStatus::Breakdown, "{report:?}");
    assert_eq!((report.residual, largest(pressure)), (1.0, 0.0));
}

#[test]
fn numbers_that_are_not_finite_are_told() {
    let Some(gpu) = gpu() else { return };
    for poison in [f64::NAN, f64::INFINITY] {
        for precision in precisions(gpu) {
            let mut case = Case::new([8, 8, 8], |[_, j, _]| j < 5).random_rhs(3);
            case.rhs[100] = poison;
            let outcome = Device::holding(gpu, &case, &settings(precision)).solve().outcome;
            assert_eq!(outcome.status, SolveStatus::NonFinite, "{poison} {precision:?}: {outcome:?}");
        }
    }
}

/// Sums over more than 16,384 quads take two kernels. The same droplets in a corner of a domain that has so many, and
/// in one that has not, and a pool that fills as many partial sums.
#[test]
fn long_sums_are_the_short_ones() {
    let Some(gpu) = gpu() else { return };
    let droplets = |cells: [usize; 3]| {
        let mut case = Case::new(cells, |[i, j, k]| i < 12 && j < 10 && k < 8 && (i * j + k) % 5 < 3);
        for cell in 0..case.rhs.len() {
            let [i, j, k] = case.grid.cell_at(cell);
            case.rhs[cell] = (i as f64).sin() + (j as f64 * 0.7).cos() - (k as f64 * 0.3).sin();
        }
        case
    };
    let (small, large) = ([16, 12, 10], [72, 60, 20]);
    assert!(Grid { cells: small, dx: 0.1 }.padded().quads < 16_384, "short sums");
    assert!(Grid { cells: large, dx: 0.1 }.padded().quads > 16_384, "long sums");
    for precision in precisions(gpu) {
        let [short, long] = [small, large].map(|cells| {
            let case = droplets(cells);
            let solved = Device::holding(gpu, &case, &settings(precision)).solve();
            assert_eq!(solved.outcome.status, SolveStatus::Converged, "{precision:?}: {:?}", solved.outcome);
            let at = |[i, j, k]: [usize; 3]| solved.potential[case.grid.cell([i, j, k])];
            let block = (0..12 * 10 * 8).map(|c| at([c % 12, c / 12 % 10, c / 120])).collect::<Vec<f64>>();
            (block, solved.outcome)
        });
        assert_eq!(short.1.unknowns, long.1.unknowns, "{precision:?}");
        let difference = largest(short.0.iter().zip(&long.0).map(|(a, b)| a - b));
        let bound = 100.0 * settings(precision).tolerance * largest(short.0.iter().copied());
        assert!(difference <= bound, "{precision:?}: {difference:e}, bound {bound:e}");
    }
    let case = Case::new(large, |[_, j, _]| j < 55).random_rhs(5);
    let outcome = Device::holding(gpu, &case, &Solver::default()).solve().outcome;
    assert_eq!(outcome.status, SolveStatus::Converged, "{outcome:?}");
    assert_eq!(outcome.unknowns, 72 * 55 * 20, "unknowns");
    assert!(outcome.verified && outcome.residual <= 1e-8, "{outcome:?}");
}

/// Prints all bits of a solve with closed components, for [`results_do_not_depend_on_the_number_of_threads`].
#[test]
fn digest_of_a_solve() {
    let Some(gpu) = gpu() else { return };
    let pool = Case::new([40, 40, 21], |[i, j, k]| i < 13 || (i + j + k) % 17 != 0);
    let case = slivers(pool, 9).narrow(wall_around([3, 4, 5], [13, 12, 9])).random_rhs(9);
    for precision in precisions(gpu) {
        let solver = Solver { max_iterations: 1000, ..settings(precision) };
        let solved = Device::holding(gpu, &case, &solver).solve();
        assert_eq!(solved.outcome.status, SolveStatus::Converged, "{:?}", solved.outcome);
        assert!(solved.outcome.closed_components > 0, "{:?}", solved.outcome);
        println!(
            "digest of {precision:?}: {} iterations, {:016x}",
            solved.outcome.iterations,
            digest(solved.potential)
        );
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let Some(gpu) = gpu() else { return };
    same_with_any_number_of_threads("solver::digest_of_a_solve", precisions(gpu).len());
}
