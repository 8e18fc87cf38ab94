//! The pressure solver on the device: against direct f64 solves, symmetric and positive, iteration counts, verdicts, repeatable.

use cutwater::gpu::{Buffer, Gpu, Recorder};
use cutwater::grid::{Axis, Grid};
use cutwater::reference::base_block::{BaseBlock, DENSITY, DT, THETA_FLOOR};
use cutwater::scene::{Precision, Preconditioner, Solver};
use cutwater::solver::{Outcome, PressureSolver, PressureSystem, SolverBuffers, Status};

use crate::common::gpu;

/// A system on the device, solved.
struct Solved {
    outcome: Outcome,
    /// Host layout, m/s.
    potential: Vec<f64>,
}

fn faces(gpu: &Gpu, grid: &Grid, label: &str, fields: &[Vec<f64>; 3]) -> Buffer<f32> {
    let padded = grid.padded();
    let values: Vec<f32> = Axis::ALL
        .iter()
        .flat_map(|&axis| {
            padded.pad(grid.faces(axis), &fields[axis.index()], |value| {
                value as f32
            })
        })
        .collect();
    gpu.buffer_with(label, &values).unwrap()
}

/// Solves with open fractions, liquid distance and velocities given, and b = - sum of s_f open_f u_f plus `extra`.
fn solve(
    gpu: &Gpu,
    grid: &Grid,
    open: &[Vec<f64>; 3],
    liquid_distance: &[f64],
    velocity: &[Vec<f64>; 3],
    rhs: &[f64],
    solver: &Solver,
) -> Solved {
    let padded = grid.padded();
    let open = faces(gpu, grid, "test.open", open);
    let velocity = faces(gpu, grid, "test.velocity", velocity);
    let distance = padded.pad(grid.cells, liquid_distance, |value| value as f32);
    let distance = gpu.buffer_with("test.liquid_distance", &distance).unwrap();
    let buffers = SolverBuffers::new(gpu, grid, solver.precision).unwrap();
    let system = PressureSystem::new(gpu, &buffers, &open, &distance, THETA_FLOOR).unwrap();
    let pressure = PressureSolver::new(gpu, &buffers, &velocity, &open, solver).unwrap();
    buffers
        .rhs
        .upload(gpu, &padded.pad(grid.cells, rhs, |value| value));
    let mut recorder = Recorder::timed(gpu);
    PressureSystem::clear(&mut recorder, &buffers);
    recorder.stage("active_cells", |pass| system.record(pass));
    let (outcome, _) = pressure.solve(gpu, recorder, &buffers, true).unwrap();
    let potential = padded.unpad(
        grid.cells,
        &buffers.potential.download(gpu).unwrap(),
        |value| value,
    );
    Solved { outcome, potential }
}

fn solve_block(gpu: &Gpu, n: usize, solver: &Solver) -> (Solved, BaseBlock) {
    let block = BaseBlock::new(n);
    let rhs: Vec<f64> = block
        .pressure_system()
        .rhs
        .iter()
        .map(|value| value / block.grid.dx.powi(2))
        .collect();
    let solved = solve(
        gpu,
        &block.grid,
        &block.open,
        &block.liquid_distance,
        &block.velocity,
        &rhs,
        solver,
    );
    (solved, block)
}

fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
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
