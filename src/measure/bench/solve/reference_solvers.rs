//! Reference solvers on the CPU in f64, for the systems of the f64 path, to the tolerance of the device.

use crate::Error;
use crate::elastic::Solids;
use crate::linalg::{CgEnd, Csr, Incomplete, LinearOperator, SymbolicCholesky, conjugate_gradient_with_test};
use crate::reference::{
    Blocks, Correction, CoupledSystem, Formulation, LinearSystem, PressureSystem, SIGMA, SolidSolver, TwoField,
    part_left, refine_parts, solve_coupled, solve_iterative,
};
use crate::scene::{Solver, names};
use crate::state::SolveReport;

/// Residual reduction of (5.25) before the residuals of (5.17) are evaluated: pressures contribute little to its own.
const FIRST_JUDGEMENT: f64 = 1e-6;
/// Inner tolerance of later refinement steps, as a share of the remaining reduction, for the same reason.
const LATER_ROUNDS: f64 = 0.01;
/// Largest ratio of two consecutive evaluations. Above it the recurrence has lost the true residual, and the next refinement step begins.
const STAGNATION: f64 = 0.5;

/// A solver on the CPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReferenceSolver {
    /// Conjugate gradients with an incomplete Cholesky factor without fill, natural order.
    IncompleteCholesky,
    /// A sparse Cholesky factor in approximate minimum degree order, by faer on all cores.
    Cholesky,
    /// Solver of the f64 path: conjugate gradients with a V-cycle for pressures, the Schur-complement form with solids.
    Multigrid,
}

names! { ReferenceSolver: "ic0_cg" => IncompleteCholesky, "cholesky" => Cholesky, "multigrid_cg" => Multigrid; }

/// An assembled system: B, and with solids S and J. The time of a solver includes its factors and hierarchies.
#[derive(Clone, Copy)]
pub enum Assembled<'a> {
    /// Pressure alone.
    Pressure(&'a PressureSystem),
    /// Liquid and solids.
    Both(&'a CoupledSystem, &'a Solids),
}

impl<'a> Assembled<'a> {
    /// Numbers of pressure unknowns and of nodes of the solids.
    pub(super) fn sizes(self) -> [usize; 2] {
        match self {
            Assembled::Pressure(system) => [system.n_unknowns(), 0],
            Assembled::Both(system, solids) => [system.pressure.n_unknowns(), solids.rest.len()],
        }
    }

    pub(super) fn definite(self) -> Definite<'a> {
        match self {
            Assembled::Pressure(system) => Definite::Pressure { system, cells: system.stencil.active_cells() },
            Assembled::Both(system, _) => {
                Definite::Both { system, blocks: Box::new(system.blocks()), two_field: TwoField::new(system, SIGMA) }
            }
        }
    }

    /// Solves the system. Reports of the rows of pressures and, with solids, of velocities; `None` without an incomplete factor.
    ///
    /// # Errors
    /// When a factor does not fit into memory, or does not exist in f64.
    pub fn solve(self, solver: ReferenceSolver, settings: &Solver) -> Result<Option<Vec<SolveReport>>, Error> {
        if solver == ReferenceSolver::Multigrid {
            return Ok(Some(match self {
                Assembled::Pressure(system) => vec![solve_iterative(system, settings).1],
                Assembled::Both(system, solids) => {
                    let solver = SolidSolver::new(solids);
                    solve_coupled(system, Formulation::Condensed, &solver, solids, settings)?.reports.to_vec()
                }
            }));
        }
        let definite = self.definite();
        let matrix = definite.matrix()?;
        if solver == ReferenceSolver::IncompleteCholesky {
            return Ok(Incomplete::new(&matrix).map(|factor| definite.iterate(&matrix, &factor, settings)));
        }
        let symbolic = SymbolicCholesky::new(&matrix)?;
        let factor = symbolic.factorise_in_parallel(&matrix)?;
        Ok(Some(definite.refined(settings, |x, _, _| {
            factor.solve(x);
            (0, CgEnd::Converged)
        })))
    }
}

/// Positive definite system of the solve: B, or thesis (5.25) in place of (5.17), whose residuals count.
pub(super) enum Definite<'a> {
    Pressure { system: &'a PressureSystem, cells: Vec<usize> },
    Both { system: &'a CoupledSystem, blocks: Box<Blocks>, two_field: TwoField<'a> },
}

impl Definite<'_> {
    pub(super) fn matrix(&self) -> Result<Csr, Error> {
        match self {
            Definite::Pressure { system, .. } => Ok(system.to_csr()),
            Definite::Both { blocks, .. } => blocks.two_field(SIGMA),
        }
    }

    /// Conjugate gradients; the first refinement step iterates until the true residuals pass.
    fn iterate(&self, matrix: &Csr, preconditioner: &dyn LinearOperator, settings: &Solver) -> Vec<SolveReport> {
        let mut first = true;
        self.refined(settings, |x, tolerance, most| {
            let rhs = x.clone();
            let is_first = std::mem::replace(&mut first, false);
            let inner = match (self, is_first) {
                (Definite::Pressure { .. }, _) => tolerance,
                (Definite::Both { .. }, true) => tolerance.min(FIRST_JUDGEMENT),
                (Definite::Both { .. }, false) => LATER_ROUNDS * tolerance,
            };
            let mut before = 0.0;
            let evaluate = |x: &[f64]| {
                if !is_first {
                    return None;
                }
                let left = part_left(self.system(), settings.tolerance, self.scatter(x))?;
                let gains = std::mem::replace(&mut before, left) <= STAGNATION * left;
                gains.then_some(left)
            };
            let most = most as usize;
            let report = conjugate_gradient_with_test(matrix, preconditioner, &rhs, x, inner, most, evaluate);
            (report.iterations as u32, report.end)
        })
    }

    /// The system whose residuals count.
    fn system(&self) -> &dyn LinearSystem {
        match self {
            Definite::Pressure { system, .. } => *system,
            Definite::Both { system, .. } => *system,
        }
    }

    /// Iterative refinement until the true residuals pass. `solve` replaces a right-hand side by its solution, to a relative tolerance within a
    /// number of iterations.
    fn refined(
        &self,
        settings: &Solver,
        mut solve: impl FnMut(&mut Vec<f64>, f64, u32) -> (u32, CgEnd),
    ) -> Vec<SolveReport> {
        let correct = |residual: &[f64], tolerance: f64, left: u32| {
            let mut x = self.rhs(residual);
            let (iterations, end) = solve(&mut x, tolerance, left);
            Correction { x: self.scatter(&x), iterations, end }
        };
        refine_parts(self.system(), settings, correct).1
    }

    /// Right-hand side for a residual.
    fn rhs(&self, residual: &[f64]) -> Vec<f64> {
        match self {
            Definite::Pressure { cells, .. } => cells.iter().map(|&cell| residual[cell]).collect(),
            Definite::Both { blocks, two_field, .. } => blocks.gather(&two_field.rhs(residual)),
        }
    }

    /// Vector of the system whose residuals count.
    fn scatter(&self, unknowns: &[f64]) -> Vec<f64> {
        match self {
            Definite::Pressure { system, cells } => {
                let mut x = vec![0.0; system.rhs.len()];
                for (&cell, &value) in cells.iter().zip(unknowns) {
                    x[cell] = value;
                }
                x
            }
            Definite::Both { blocks, .. } => blocks.scatter(unknowns),
        }
    }
}
