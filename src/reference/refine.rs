//! The outer loop of every solve: corrections are added until the true residual passes (design section 5).

use crate::linalg::{CgEnd, norm};
use crate::scene::Solver;
use crate::state::{SolveReport, SolveStatus};

/// A residual below this part of the scale of the right-hand side is rounding of the right-hand side itself and passes.
pub const EPSILON: f64 = 1e-14;
/// A round asks the recurrence for this part of the reduction that is left, because its residual drifts from the true one.
const MARGIN: f64 = 0.9;
/// The recurrence of one round is not asked for more than this; the next round starts from the true residual.
const ROUND_TOLERANCE: f64 = 1e-10;
/// A round that does not reduce the true residual by at least this factor is the last.
const STAGNATION: f64 = 0.5;

/// A system A x = b that is judged on its true residual.
pub(super) trait Judged {
    /// b.
    fn rhs(&self) -> &[f64];

    /// What rounding of b is a part of.
    fn rhs_scale(&self) -> f64;

    fn n_unknowns(&self) -> usize;

    /// b - A x.
    fn residual(&self, x: &[f64]) -> Vec<f64>;

    /// Takes out of x what A does not see.
    fn project(&self, _x: &mut [f64]) {}
}

/// An answer to A x = r.
pub(super) struct Correction {
    pub(super) x: Vec<f64>,
    pub(super) iterations: u32,
    pub(super) end: CgEnd,
}

/// Adds corrections until the true residual passes; the iterate with the least is kept. `correct` solves A x = r to a relative tolerance
/// within a number of iterations.
pub(super) fn refine(
    system: &impl Judged,
    settings: &Solver,
    mut correct: impl FnMut(&[f64], f64, u32) -> Correction,
) -> (Vec<f64>, SolveReport) {
    let mut x = vec![0.0; system.rhs().len()];
    let rhs_norm = norm(system.rhs());
    let mut report = SolveReport {
        unknowns: system.n_unknowns(),
        iterations: 0,
        residual: 0.0,
        status: SolveStatus::Converged,
    };
    if !rhs_norm.is_finite() {
        report.residual = f64::NAN;
        report.status = SolveStatus::NonFinite;
        return (x, report);
    }
    let target = (settings.tolerance * rhs_norm).max(EPSILON * system.rhs_scale());
    let mut residual = system.rhs().to_vec();
    let mut residual_norm = rhs_norm;
    while residual_norm > target {
        let tolerance = (MARGIN * target / residual_norm).max(ROUND_TOLERANCE);
        let iterations_left = settings.max_iterations - report.iterations;
        let correction = correct(&residual, tolerance, iterations_left);
        report.iterations += correction.iterations;
        let sums = x.iter().zip(&correction.x);
        let mut improved: Vec<f64> = sums.map(|(x, d)| x + d).collect();
        system.project(&mut improved);
        let improved_residual = system.residual(&improved);
        let improved_norm = norm(&improved_residual);
        let before = residual_norm;
        if improved_norm < residual_norm {
            (x, residual, residual_norm) = (improved, improved_residual, improved_norm);
        }
        if residual_norm <= target {
            break;
        }
        report.status = match correction.end {
            _ if !improved_norm.is_finite() => SolveStatus::NonFinite,
            CgEnd::Breakdown => SolveStatus::Breakdown,
            _ if report.iterations >= settings.max_iterations => SolveStatus::IterationLimit,
            _ if improved_norm > STAGNATION * before => SolveStatus::Stagnated,
            _ => continue,
        };
        break;
    }
    if rhs_norm > 0.0 {
        report.residual = residual_norm / rhs_norm;
    }
    (x, report)
}
