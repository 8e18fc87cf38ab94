//! `solve`, for solids: the velocities of the nodes of one sub-step, with a stopping criterion on the true residual.
//!
//! Up to [`DIRECT_UNKNOWNS`](super::DIRECT_UNKNOWNS) unknowns a sparse Cholesky factor solves, above them conjugate
//! gradients. Their preconditioner is a Chebyshev polynomial in D^-1 S, where D is the 3x3 block diagonal of S.
//! Iterative refinement repeats either until the true residual passes.

use std::sync::{Arc, OnceLock};

use super::refine::{Correction, LinearSystem, refine};
use super::solid_contacts::{ContactSearch, Contacts, MAX_SOLVES};
use super::solid_system::SolidSystem;
use super::solve::DIRECT_UNKNOWNS;
use crate::Error;
use crate::elastic::{Bounds, Solids};
use crate::linalg::{CgEnd, Cholesky, Csr, LinearOperator, SymbolicCholesky, conjugate_gradient};
use crate::scene::Solver;
use crate::state::{ContactReport, SolveReport};
use glam::{DMat3, DVec3};

/// The polynomial acts on eigenvalues above the largest one over (this times the squared degree).
const REACH: f64 = 0.7;

/// Data shared by the solves of all steps of some solids.
#[derive(Clone, Debug)]
pub struct SolidSolver {
    bounds: Bounds,
    symbolic: Arc<OnceLock<SymbolicCholesky>>,
}

impl SolidSolver {
    /// The solver of all steps of these solids.
    pub fn new(solids: &Solids) -> SolidSolver {
        SolidSolver { bounds: Bounds::new(solids), symbolic: Arc::default() }
    }

    /// Solves S v = rhs: velocities of all nodes (m/s) and the report.
    ///
    /// # Errors
    /// When the factor does not fit into memory.
    pub fn solve(
        &self,
        solids: &Solids,
        system: &SolidSystem,
        settings: &Solver,
    ) -> Result<(Vec<[f64; 3]>, SolveReport), Error> {
        if system.components().len() <= DIRECT_UNKNOWNS {
            self.solve_direct(system, settings)
        } else {
            Ok(self.solve_iterative(solids, system, settings))
        }
    }

    /// Repeats the solve until the active set of contacts is unchanged. If the search does not converge, the system
    /// finally constrains all nodes.
    ///
    /// # Errors
    /// When the factor does not fit into memory.
    pub fn solve_in_contact(
        &self,
        solids: &Solids,
        system: &mut SolidSystem,
        contacts: &mut Contacts,
        settings: &Solver,
    ) -> Result<(Vec<[f64; 3]>, SolveReport, ContactReport), Error> {
        let mut iterations = 0;
        let mut search = ContactSearch::new(contacts, MAX_SOLVES);
        loop {
            let (found, mut report) = self.solve(solids, system, settings)?;
            iterations += report.iterations;
            report.iterations = iterations;
            let last = !report.status.is_best_attainable();
            let mut iterate = search.after(system, found, last);
            if iterate.ended {
                if iterate.report.unsettled > 0 {
                    system.hold_all(&iterate.velocity);
                }
                return Ok((iterate.velocity, report, iterate.report));
            }
            system.free(search.hold(&mut iterate.velocity), &iterate.velocity);
        }
    }

    /// Solves by sparse Cholesky, independent of the size.
    ///
    /// # Errors
    /// When the factor does not fit into memory.
    pub fn solve_direct(&self, system: &SolidSystem, settings: &Solver) -> Result<(Vec<[f64; 3]>, SolveReport), Error> {
        let components = system.components();
        // A matrix that is not positive definite in f64 is a breakdown of the solve.
        let factor = if system.rhs.iter().any(|&b| b != 0.0) { self.factorise(system)? } else { None };
        let (x, report) = refine(system, settings, |rhs, _, _| {
            let mut x = vec![0.0; rhs.len()];
            let end = match &factor {
                None => CgEnd::Breakdown,
                Some(factor) => {
                    let mut free: Vec<f64> = components.iter().map(|&at| rhs[at]).collect();
                    factor.solve(&mut free);
                    for (&at, value) in components.iter().zip(free) {
                        x[at] = value;
                    }
                    CgEnd::Converged
                }
            };
            Correction { x, iterations: 0, end }
        });
        Ok((system.velocity(&x), report))
    }

    /// The factor of S in free components; `None` if S is not positive definite in f64.
    ///
    /// # Errors
    /// When the factor does not fit into memory.
    pub(super) fn factorise(&self, system: &SolidSystem) -> Result<Option<Cholesky<'_>>, Error> {
        let matrix = system.free_to_csr();
        Ok(self.symbolic(&matrix)?.factorise(&matrix).ok())
    }

    /// The Chebyshev preconditioner of S.
    pub(super) fn polynomial<'a>(&self, solids: &Solids, system: &'a SolidSystem) -> Chebyshev<'a> {
        let degree = self.bounds.chebyshev_degree(solids, system.dt());
        Chebyshev::new(system, self.bounds.block_jacobi, degree)
    }

    /// The elimination order, computed in the first solve.
    fn symbolic(&self, matrix: &Csr) -> Result<&SymbolicCholesky, Error> {
        if let Some(symbolic) = self.symbolic.get() {
            return Ok(symbolic);
        }
        let symbolic = SymbolicCholesky::new(matrix)?;
        Ok(self.symbolic.get_or_init(|| symbolic))
    }

    /// Solves by conjugate gradients with a Chebyshev preconditioner, independent of the size.
    pub fn solve_iterative(
        &self,
        solids: &Solids,
        system: &SolidSystem,
        settings: &Solver,
    ) -> (Vec<[f64; 3]>, SolveReport) {
        let polynomial = self.polynomial(solids, system);
        let (x, report) = refine(system, settings, |rhs, tolerance, iterations_left| {
            let mut x = vec![0.0; rhs.len()];
            let most = iterations_left as usize;
            let cg = conjugate_gradient(system, &polynomial, rhs, &mut x, tolerance, most);
            Correction { x, iterations: cg.iterations as u32, end: cg.end }
        });
        (system.velocity(&x), report)
    }
}

impl LinearSystem for SolidSystem {
    fn rhs(&self) -> &[f64] {
        &self.rhs
    }

    fn rhs_scale(&self) -> f64 {
        self.rhs_scale
    }

    fn n_unknowns(&self) -> usize {
        SolidSystem::n_unknowns(self)
    }

    fn residual(&self, x: &[f64]) -> Vec<f64> {
        SolidSystem::residual(self, x)
    }
}

/// Chebyshev preconditioner z = p(D^-1 S) D^-1 r. 1 - t p(t) is the Chebyshev polynomial of an interval up to the
/// largest eigenvalue of D^-1 S, scaled to 1 at 0. Symmetric, and positive definite if the bound of that eigenvalue
/// holds.
pub struct Chebyshev<'a> {
    system: &'a SolidSystem,
    inverse_diagonal: Vec<DMat3>,
    degree: usize,
    middle: f64,
    half_width: f64,
}

impl<'a> Chebyshev<'a> {
    /// A polynomial with `degree` products by S, for eigenvalues of D^-1 S from lmax/(0.7 degree^2) to `lmax`.
    pub fn new(system: &'a SolidSystem, lmax: f64, degree: usize) -> Chebyshev<'a> {
        let lmin = lmax / (REACH * (degree * degree) as f64);
        let nodes = 0..system.size() / 3;
        Chebyshev {
            system,
            inverse_diagonal: nodes.map(|node| system.diagonal(node).inverse()).collect(),
            degree,
            middle: 0.5 * (lmax + lmin),
            half_width: 0.5 * (lmax - lmin),
        }
    }

    /// D^-1 r.
    fn scaled(&self, r: &[f64]) -> Vec<f64> {
        let nodes = self.inverse_diagonal.iter().zip(r.chunks_exact(3));
        nodes.flat_map(|(inverse, r)| (inverse * DVec3::from_slice(r)).to_array()).collect()
    }
}

impl LinearOperator for Chebyshev<'_> {
    fn size(&self) -> usize {
        self.system.size()
    }

    /// The Chebyshev iteration for S z = r from zero (Saad, Iterative Methods for Sparse Linear Systems, algorithm
    /// 12.1).
    fn apply(&self, r: &[f64], z: &mut [f64]) {
        let ratio = self.middle / self.half_width;
        let mut rho = 1.0 / ratio;
        let mut step = self.scaled(r);
        step.iter_mut().for_each(|step| *step /= self.middle);
        z.copy_from_slice(&step);
        let mut defect = vec![0.0; r.len()];
        for _ in 0..self.degree {
            self.system.apply(z, &mut defect);
            for (defect, r) in defect.iter_mut().zip(r) {
                *defect = r - *defect;
            }
            let next = 1.0 / (2.0 * ratio - rho);
            let (step_factor, residual_factor) = (next * rho, 2.0 * next / self.half_width);
            rho = next;
            for ((step, scaled), z) in step.iter_mut().zip(self.scaled(&defect)).zip(z.iter_mut()) {
                *step = step_factor * *step + residual_factor * scaled;
                *z += *step;
            }
        }
    }
}
