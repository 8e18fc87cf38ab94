//! The f64 path: known answers stage by stage, and physics that is known exactly.

use cutwater::linalg::{LinearOperator, dot, norm};
use cutwater::reference::base_block::BaseBlock;
use cutwater::reference::{Multigrid, solve_direct, solve_iterative};
use cutwater::scene::Solver;
use cutwater::state::SolveStatus;

use crate::common::Random;

fn settings(tolerance: f64) -> Solver {
    Solver { tolerance, ..Solver::default() }
}

/// Measured: 11, 12, 13 and 13 at 20^3, 40^3, 60^3 and 80^3.
#[test]
fn iterations_on_the_base_block_do_not_grow_with_the_grid() {
    for n in [20, 40] {
        let (_, report) = solve_iterative(&BaseBlock::new(n).pressure_system(), &settings(1e-8));
        assert_eq!(report.status, SolveStatus::Converged);
        assert!(report.residual <= 1e-8 && report.iterations <= 14, "{n}^3: {report:?}");
    }
}

#[test]
fn v_cycle_and_operator_are_symmetric_and_positive() {
    let system = BaseBlock::new(13).pressure_system();
    let multigrid = Multigrid::new(&system.stencil);
    for operator in [&system.stencil as &dyn LinearOperator, &multigrid] {
        for seed in 0..4 {
            let n = operator.size();
            let mut random = Random(seed);
            let mut masked = || -> Vec<f64> {
                let value = |cell| {
                    if system.stencil.active(cell) { random.uniform(-1.0, 1.0) } else { 0.0 }
                };
                (0..n).map(value).collect()
            };
            let (x, y) = (masked(), masked());
            let (mut ax, mut ay) = (vec![0.0; n], vec![0.0; n]);
            operator.apply(&x, &mut ax);
            operator.apply(&y, &mut ay);
            let scale = norm(&ax) * norm(&y);
            assert!((dot(&ax, &y) - dot(&x, &ay)).abs() < 1e-13 * scale, "{} {}", dot(&ax, &y), dot(&x, &ay));
            assert!(dot(&ax, &x) > 0.0);
        }
    }
}

#[test]
fn direct_and_iterative_solves_agree_on_the_base_block() {
    let system = BaseBlock::new(20).pressure_system();
    let (direct, direct_report) = solve_direct(&system, &settings(1e-8)).unwrap();
    let (iterative, report) = solve_iterative(&system, &settings(1e-12));
    assert_eq!((direct_report.status, report.status), (SolveStatus::Converged, SolveStatus::Converged));
    assert!(direct_report.residual < 1e-13, "direct residual {}", direct_report.residual);
    let largest = direct.iter().fold(0.0_f64, |m, p| m.max(p.abs()));
    let difference = direct.iter().zip(&iterative).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs()));
    assert!(difference < 1e-9 * largest, "pressures differ by {difference} of {largest} Pa");
}
