//! `solve`: the pressure of one step, judged on its true residual (design section 5).
//!
//! Sparse Cholesky up to [`DIRECT_UNKNOWNS`] unknowns, above them conjugate gradients preconditioned with [`Multigrid`].
//! Either is repeated on what its true residual leaves until that passes.

use super::multigrid::Multigrid;
use super::pressure_system::PressureSystem;
use crate::Error;
use crate::linalg::{CgEnd, SymbolicCholesky, conjugate_gradient, norm};
use crate::scene::Solver;
use crate::state::{SolveReport, SolveStatus};

/// Largest system that is factorised: beyond it the factor of a three-dimensional system outgrows memory and time.
pub const DIRECT_UNKNOWNS: usize = 60_000;
/// A residual below this part of s_p is rounding of the right-hand side itself and passes.
pub const EPSILON: f64 = 1e-14;
/// A round asks the recurrence for this part of the reduction that is left, because its residual drifts from the true one.
const MARGIN: f64 = 0.9;
/// The recurrence of one round is not asked for more than this; the next round starts from the true residual.
const ROUND_TOLERANCE: f64 = 1e-10;
/// A round that does not reduce the true residual by at least this factor is the last.
const STAGNATION: f64 = 0.5;

/// Solves B p = rhs: pressure per cell (Pa, 0 in inactive cells, mean zero over every closed component) and the report.
pub fn solve(system: &PressureSystem, settings: &Solver) -> Result<(Vec<f64>, SolveReport), Error> {
    if system.n_unknowns() <= DIRECT_UNKNOWNS {
        solve_direct(system, settings)
    } else {
        Ok(solve_iterative(system, settings))
    }
}

/// By sparse Cholesky, whatever the size.
pub fn solve_direct(
    system: &PressureSystem,
    settings: &Solver,
) -> Result<(Vec<f64>, SolveReport), Error> {
    let cells = system.stencil.active_cells();
    if cells.is_empty() {
        return Ok((
            vec![0.0; system.rhs.len()],
            report(system, 0, 0.0, SolveStatus::Converged),
        ));
    }
    // A closed component fixes its pressure up to a constant. Its right-hand side has no mean, so holding one cell
    // by a doubled diagonal gives that cell exactly 0 and changes no difference.
    let pinned: Vec<usize> = system.closed.iter().map(|component| component[0]).collect();
    let matrix = system.numbered(1.0, &pinned);
    let symbolic = SymbolicCholesky::new(&matrix)?;
    let factor = symbolic.factorise(&matrix)?;
    Ok(refine(system, settings, |rhs, _, _| {
        let mut x: Vec<f64> = cells.iter().map(|&cell| rhs[cell]).collect();
        factor.solve(&mut x);
        let mut correction = vec![0.0; rhs.len()];
        cells
            .iter()
            .zip(x)
            .for_each(|(&cell, value)| correction[cell] = value);
        (correction, 0, CgEnd::Converged)
    }))
}

/// By conjugate gradients with one V-cycle as the preconditioner, whatever the size.
pub fn solve_iterative(system: &PressureSystem, settings: &Solver) -> (Vec<f64>, SolveReport) {
    let multigrid = Multigrid::new(&system.stencil);
    refine(system, settings, |rhs, tolerance, iterations_left| {
        let mut x = vec![0.0; rhs.len()];
        let cg = conjugate_gradient(
            &system.stencil,
            &multigrid,
            rhs,
            &mut x,
            tolerance,
            iterations_left as usize,
        );
        (x, cg.iterations as u32, cg.end)
    })
}

/// Adds corrections until the true residual passes. `correct` solves A x = r to a relative tolerance within a number of
/// iterations, and gives x, the iterations used and how they ended.
fn refine(
    system: &PressureSystem,
    settings: &Solver,
    mut correct: impl FnMut(&[f64], f64, u32) -> (Vec<f64>, u32, CgEnd),
) -> (Vec<f64>, SolveReport) {
    let mut pressure = vec![0.0; system.rhs.len()];
    let rhs_norm = norm(&system.rhs);
    if !rhs_norm.is_finite() {
        return (
            pressure,
            report(system, 0, f64::NAN, SolveStatus::NonFinite),
        );
    }
    let target = (settings.tolerance * rhs_norm).max(EPSILON * system.rhs_scale);
    let mut residual = system.rhs.clone();
    let mut residual_norm = rhs_norm;
    let mut iterations = 0;
    let mut status = SolveStatus::Converged;
    while residual_norm > target {
        let scaled: Vec<f64> = residual.iter().map(|r| r / system.scale).collect();
        let tolerance = (MARGIN * target / residual_norm).max(ROUND_TOLERANCE);
        let (correction, used, end) =
            correct(&scaled, tolerance, settings.max_iterations - iterations);
        iterations += used;
        let mut improved: Vec<f64> = pressure
            .iter()
            .zip(&correction)
            .map(|(p, d)| p + d)
            .collect();
        system.remove_closed_means(&mut improved);
        let improved_residual = system.residual(&improved);
        let improved_norm = norm(&improved_residual);
        let before = residual_norm;
        if improved_norm < residual_norm {
            (pressure, residual, residual_norm) = (improved, improved_residual, improved_norm);
        }
        if residual_norm <= target {
            break;
        }
        status = match end {
            _ if !improved_norm.is_finite() => SolveStatus::NonFinite,
            CgEnd::Breakdown => SolveStatus::Breakdown,
            _ if iterations >= settings.max_iterations => SolveStatus::IterationLimit,
            _ if improved_norm > STAGNATION * before => SolveStatus::Stagnated,
            _ => continue,
        };
        break;
    }
    let relative = if rhs_norm > 0.0 {
        residual_norm / rhs_norm
    } else {
        0.0
    };
    (pressure, report(system, iterations, relative, status))
}

fn report(
    system: &PressureSystem,
    iterations: u32,
    residual: f64,
    status: SolveStatus,
) -> SolveReport {
    SolveReport {
        unknowns: system.n_unknowns(),
        iterations,
        residual,
        status,
    }
}
