//! The pressure solver on the device: against direct f64 solves, symmetric and positive, iteration counts, verdicts, repeatable.

use std::cell::OnceCell;

use cutwater::gpu::{Buffer, Gpu, RealBuffer, Recorder};
use cutwater::grid::{Axis, Grid, Padded};
use cutwater::reference::base_block::{BaseBlock, DENSITY, DT, THETA_FLOOR};
use cutwater::reference::{ActiveCells, RightHandSide, active_cells};
use cutwater::scene::{Precision, Preconditioner, Solver};
use cutwater::solver::{
    Components, Outcome, PressureSolver, PressureSystem, SolverBuffers, Status,
};

use crate::common::{Random, gpu};

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
                .map(|cell| {
                    if liquid(grid.cell_at(cell)) {
                        -0.05
                    } else {
                        0.05
                    }
                })
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
        self.rhs
            .iter_mut()
            .for_each(|b| *b = random.uniform(-1.0, 1.0));
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
        let scale = cutwater::linalg::norm(&values);
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
    open: Buffer<f32>,
    velocity: Buffer<f32>,
    distance: Buffer<f32>,
    pub(crate) buffers: SolverBuffers,
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
        Device {
            system: PressureSystem::new(gpu, &buffers, &open, &distance, THETA_FLOOR).unwrap(),
            components: Components::new(gpu, &buffers).unwrap(),
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
            let Device {
                gpu,
                buffers,
                velocity,
                open,
                solver,
                ..
            } = self;
            PressureSolver::new(gpu, buffers, velocity, open, solver).unwrap()
        })
    }

    /// Everything up to the solve.
    pub(crate) fn prepare(&self) -> Recorder<'a> {
        let Device { buffers, .. } = self;
        buffers.rhs.upload(self.gpu, &self.rhs);
        let mut recorder = Recorder::timed(self.gpu);
        PressureSystem::clear(&mut recorder, buffers);
        recorder.stage("active_cells", |pass| self.system.record(pass));
        recorder.stage(Components::NAME, |pass| {
            self.components.label(pass, buffers);
            self.components.remove_means(pass);
        });
        recorder
    }

    /// The solve, with the potential's means over closed components taken out.
    pub(crate) fn solve(&self) -> Solved {
        let (outcome, _) = self
            .pressure()
            .solve(self.gpu, self.prepare(), &self.buffers, true)
            .unwrap();
        let mut recorder = Recorder::new(self.gpu);
        recorder.stage(Components::NAME, |pass| {
            self.components.centre_potential(pass)
        });
        recorder.submit();
        let potential = self.cells(&self.buffers.potential);
        Solved { outcome, potential }
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

fn solve_block(gpu: &Gpu, n: usize, solver: &Solver) -> (Solved, BaseBlock) {
    let block = BaseBlock::new(n);
    let rhs = block.pressure_system().rhs;
    let case = Case {
        grid: block.grid,
        open: block.open.clone(),
        liquid_distance: block.liquid_distance.clone(),
        velocity: block.velocity.clone(),
        rhs: rhs
            .iter()
            .map(|value| value / block.grid.dx.powi(2))
            .collect(),
    };
    (Device::holding(gpu, &case, solver).solve(), block)
}

pub(crate) fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values
        .into_iter()
        .fold(0.0, |max, value| value.abs().max(max))
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
            let tolerance = if precision == Precision::F32 {
                1e-4
            } else {
                1e-8
            };
            let solver = Solver {
                precision,
                preconditioner,
                tolerance,
                max_iterations: 1000,
                ..Solver::default()
            };
            let (solved, block) = solve_block(gpu, 20, &solver);
            let case = format!("{precision:?} {preconditioner:?}");
            assert_eq!(solved.outcome.status, Status::Converged, "{case}");
            assert!(
                solved.outcome.verified && solved.outcome.residual <= tolerance,
                "{case}: {:?}",
                solved.outcome
            );
            let system = block.pressure_system();
            assert_eq!(
                solved.outcome.unknowns as usize,
                system.n_unknowns(),
                "{case}: unknowns"
            );
            let exact = Solver {
                tolerance: 1e-12,
                ..Solver::default()
            };
            let (direct, _) = cutwater::reference::solve_direct(&system, &exact).unwrap();
            let to_potential = DT / (DENSITY * block.grid.dx);
            let scale = largest(direct.iter().map(|p| p * to_potential));
            let difference = largest(
                direct
                    .iter()
                    .zip(&solved.potential)
                    .map(|(p, x)| p * to_potential - x),
            );
            assert!(
                difference <= bound * scale,
                "{case}: {difference:e} of {scale:e}"
            );
        }
    }
}

#[test]
fn iterations_hardly_grow_with_the_grid() {
    let Some(gpu) = gpu() else { return };
    let iterations = [20, 40, 60, 80, 100].map(|n| {
        let (solved, _) = solve_block(gpu, n, &Solver::default());
        assert_eq!(solved.outcome.status, Status::Converged, "{n}^3");
        assert!(
            solved.outcome.residual <= 1e-8,
            "{n}^3: {:?}",
            solved.outcome
        );
        solved.outcome.iterations
    });
    let (least, most) = (
        iterations.iter().min().unwrap(),
        iterations.iter().max().unwrap(),
    );
    assert!(*most <= 20, "{iterations:?}");
    assert!(
        f64::from(*most) <= 1.6 * f64::from(*least),
        "{iterations:?}"
    );
}
