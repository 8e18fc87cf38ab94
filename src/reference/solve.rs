//! `solve`: the pressure of one sub-step, with a stopping criterion on the true residual.
//!
//! Sparse Cholesky up to [`DIRECT_UNKNOWNS`] unknowns, above them conjugate gradients with [`Multigrid`]. Iterative
//! refinement repeats either until the true residual passes.

use super::multigrid::Multigrid;
use super::pressure_system::PressureSystem;
use super::refine::{Correction, LinearSystem, refine};
use crate::Error;
use crate::linalg::{CgEnd, SymbolicCholesky, conjugate_gradient};
use crate::scene::Solver;
use crate::state::{SolveReport, SolveStatus};

/// Largest system that is factorised; larger factors of three-dimensional systems exceed memory and time.
pub const DIRECT_UNKNOWNS: usize = 60_000;

/// Solves B p = rhs. Returns the pressure per cell (Pa; 0 in inactive cells, mean zero over every enclosed component)
/// and the report.
///
/// # Errors
/// When the factor does not fit into memory.
pub fn solve(system: &PressureSystem, settings: &Solver) -> Result<(Vec<f64>, SolveReport), Error> {
    if system.n_unknowns() <= DIRECT_UNKNOWNS {
        solve_direct(system, settings)
    } else {
        Ok(solve_iterative(system, settings))
    }
}

/// Solves by sparse Cholesky, independent of the size.
///
/// # Errors
/// When the factor does not fit into memory.
pub fn solve_direct(system: &PressureSystem, settings: &Solver) -> Result<(Vec<f64>, SolveReport), Error> {
    let cells = system.stencil.active_cells();
    if cells.is_empty() {
        let nothing = SolveReport { unknowns: 0, iterations: 0, residual: 0.0, status: SolveStatus::Converged };
        return Ok((vec![0.0; system.rhs.len()], nothing));
    }
    // The pressure of an enclosed component is determined up to a constant. Its right-hand side has mean zero, so a
    // doubled diagonal sets the pressure of one cell to exactly 0 and changes no difference.
    let pinned: Vec<usize> = system.closed.iter().map(|component| component[0]).collect();
    let matrix = system.numbered(1.0, &pinned);
    let symbolic = SymbolicCholesky::new(&matrix)?;
    let Ok(factor) = symbolic.factorise(&matrix) else {
        return Ok(refine(system, settings, broken_down));
    };
    Ok(refine(system, settings, |rhs, _, _| {
        let mut active: Vec<f64> = cells.iter().map(|&cell| rhs[cell] / system.scale).collect();
        factor.solve(&mut active);
        let mut x = vec![0.0; rhs.len()];
        for (&cell, value) in cells.iter().zip(active) {
            x[cell] = value;
        }
        Correction { x, iterations: 0, end: CgEnd::Converged }
    }))
}

/// The correction of a matrix without a factor in f64: a breakdown of the solve.
pub(super) fn broken_down(residual: &[f64], _: f64, _: u32) -> Correction {
    Correction { x: vec![0.0; residual.len()], iterations: 0, end: CgEnd::Breakdown }
}

/// Solves by conjugate gradients with one V-cycle as the preconditioner, independent of the size.
pub fn solve_iterative(system: &PressureSystem, settings: &Solver) -> (Vec<f64>, SolveReport) {
    let multigrid = Multigrid::new(&system.stencil);
    refine(system, settings, |rhs, tolerance, iterations_left| {
        let scaled: Vec<f64> = rhs.iter().map(|r| r / system.scale).collect();
        let mut x = vec![0.0; rhs.len()];
        let cg = conjugate_gradient(&system.stencil, &multigrid, &scaled, &mut x, tolerance, iterations_left as usize);
        Correction { x, iterations: cg.iterations as u32, end: cg.end }
    })
}

impl LinearSystem for PressureSystem {
    fn rhs(&self) -> &[f64] {
        &self.rhs
    }

    fn rhs_scale(&self) -> f64 {
        self.rhs_scale
    }

    fn n_unknowns(&self) -> usize {
        PressureSystem::n_unknowns(self)
    }

    fn residual(&self, x: &[f64]) -> Vec<f64> {
        PressureSystem::residual(self, x)
    }

    fn project(&self, x: &mut [f64]) {
        self.remove_closed_means(x);
    }
}
