//! `solve`, for liquid and solids together: one function per formulation. The stopping criterion uses the residual of
//! the indefinite system. Iterative refinement continues until both parts pass.

use super::active_cells::closed_components;
use super::coupled_system::{Blocks, CoupledSystem, TwoField};
use super::multigrid::Multigrid;
use super::pressure_system::PressureSystem;
use super::refine::{Correction, LinearSystem, Part, refine_parts};
use super::separation::{Round, Separation};
use super::solid_contacts::{ContactSearch, Contacts, MAX_SOLVES};
use super::solid_system::SolidSystem;
use super::solve::{DIRECT_UNKNOWNS, broken_down, solve};
use super::solve_solid::{Chebyshev, SolidSolver};
use super::stress_variables::StressVariables;
use crate::Error;
use crate::elastic::{Body, Solids};
use crate::geometry::Coupling;
use crate::linalg::{
    CgEnd, CgReport, Cholesky, Csr, HeldRows, Incomplete, LinearOperator, SymbolicCholesky, conjugate_gradient,
    minimal_residual, norm, stabilised_biconjugate_gradient,
};
use crate::scene::Solver;
use crate::state::{ContactReport, SolveReport, SolveStatus};

/// Fraction of the mass in Z1. With exact inverses 0.5 minimises the iterations.
pub const SIGMA: f64 = 0.5;

/// Largest inner tolerance of other iterative solves of transformed systems, whose residual differs from the tested
/// one.
const TRANSFORMED_TOLERANCE: f64 = 1e-8;

/// Inner tolerance of the factored two-field solve per refinement step, relative to the reduction still required: a
/// smaller transformed residual says little about the tested one.
const ROUND_TOLERANCE: f64 = 1e-4;
const ROUND_SHARE: f64 = 0.3;

/// Relative tolerance of inner solves with S if S has no factor.
const INNER_TOLERANCE: f64 = 1e-13;
/// Largest number of their iterations.
const INNER_ITERATIONS: usize = 10_000;

/// Solution of a coupled system.
#[derive(Clone, Debug)]
pub struct CoupledSolution {
    /// Pressure per cell, Pa; 0 in inactive ones.
    pub pressure: Vec<f64>,
    /// Velocity of all nodes, m/s.
    pub velocity: Vec<[f64; 3]>,
    /// Reports of E u* - B p - J v and of w - (J^T p - S v).
    pub reports: [SolveReport; 2],
}

/// Operator, preconditioner, b, x, tolerance, largest number of iterations.
type Iterate = fn(&dyn LinearOperator, &dyn LinearOperator, &[f64], &mut [f64], f64, usize) -> CgReport;

/// A formulation of the coupled system.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Formulation<'a> {
    /// \[B J; J^T -S\] (thesis 5.17) by sparse L D L^T.
    Indefinite,
    /// As `Indefinite`, by BiCGSTAB with an incomplete LU factor.
    IndefiniteIterative,
    /// As `Indefinite`, by MINRES with incomplete factors of B and of S, as tried in the thesis.
    IndefiniteMinimalResidual,
    /// A of thesis (5.25), assembled, by sparse Cholesky; `sigma` is the fraction of the mass in Z1.
    TwoField(f64),
    /// A by conjugate gradients with an incomplete Cholesky factor, as in the thesis.
    TwoFieldIncomplete(f64),
    /// A in factored form by conjugate gradients with multigrid on B and a Chebyshev polynomial in S.
    TwoFieldIterative(f64),
    /// Pressures and stresses (thesis 5.3) by sparse Cholesky.
    Stress(&'a StressVariables),
    /// As `Stress`, by conjugate gradients with an incomplete Cholesky factor.
    StressIncomplete(&'a StressVariables),
    /// Schur-complement form (B + J S^-1 J^T) p = E u* + J S^-1 w by conjugate gradients with multigrid on B.
    Condensed,
}

impl Formulation<'_> {
    /// Name and solver.
    pub fn name(&self) -> &'static str {
        match self {
            Formulation::Indefinite => "indefinite, LDL^T",
            Formulation::IndefiniteIterative => "indefinite, BiCGSTAB-ILU(0)",
            Formulation::IndefiniteMinimalResidual => "indefinite, MINRES-IC(0)",
            Formulation::TwoField(_) => "two-field, Cholesky",
            Formulation::TwoFieldIncomplete(_) => "two-field, IC(0)-CG",
            Formulation::TwoFieldIterative(_) => "two-field, factored, CG",
            Formulation::Stress(_) => "stress, Cholesky",
            Formulation::StressIncomplete(_) => "stress, IC(0)-CG",
            Formulation::Condensed => "condensed, CG",
        }
    }

    /// The formulation for a system of this size. A component of liquid that only bodies give room makes B singular, and
    /// the indefinite matrix is then not quasi-definite.
    pub fn of(system: &CoupledSystem) -> Formulation<'static> {
        let definite = system.room_of_bodies().next().is_none();
        if definite && system.n_unknowns() <= DIRECT_UNKNOWNS {
            Formulation::Indefinite
        } else {
            Formulation::Condensed
        }
    }
}

/// Solves a coupled system; `solver` and `solids` belong to its solids. In the forms of [`Formulation::of`] a matrix
/// without a factor in f64 is a breakdown.
///
/// # Errors
/// When a factor does not fit into memory, or the matrix of another form has none in f64.
pub fn solve_coupled(
    system: &CoupledSystem,
    formulation: Formulation,
    solver: &SolidSolver,
    solids: &Solids,
    settings: &Solver,
) -> Result<CoupledSolution, Error> {
    let corrected = |correct: &mut dyn FnMut(&[f64], f64, u32) -> Correction| {
        let (x, reports) = refine_parts(system, settings, correct);
        let (pressure, velocity) = system.split(x);
        Ok(CoupledSolution { pressure, velocity, reports: [reports[0], reports[1]] })
    };
    match formulation {
        Formulation::Indefinite => {
            let blocks = system.blocks();
            let matrix = blocks.indefinite();
            let symbolic = SymbolicCholesky::new(&matrix)?;
            let Ok(factor) = symbolic.factorise_quasi_definite(&matrix) else {
                return corrected(&mut broken_down);
            };
            corrected(&mut |residual, _, _| {
                let mut x = blocks.indefinite_rhs(residual);
                factor.solve(&mut x);
                direct(blocks.scatter(&x))
            })
        }
        Formulation::IndefiniteIterative | Formulation::IndefiniteMinimalResidual => {
            let blocks = system.blocks();
            let matrix = blocks.indefinite();
            let minimal = formulation == Formulation::IndefiniteMinimalResidual;
            let (preconditioner, iterate): (Box<dyn LinearOperator>, Iterate) = if minimal {
                let both = Both { liquid: incomplete(&blocks.b)?, solids: incomplete(&blocks.s)? };
                (Box::new(both), minimal_residual)
            } else {
                let whole = incomplete(&matrix)?;
                (Box::new(whole), stabilised_biconjugate_gradient)
            };
            corrected(&mut |residual, tolerance, left| {
                let rhs = blocks.indefinite_rhs(residual);
                let mut x = vec![0.0; rhs.len()];
                let tolerance = tolerance.min(TRANSFORMED_TOLERANCE);
                let left = left as usize;
                let report = iterate(&matrix, &*preconditioner, &rhs, &mut x, tolerance, left);
                iterated(blocks.scatter(&x), report)
            })
        }
        Formulation::TwoField(sigma) => {
            let blocks = system.blocks();
            let two_field = TwoField::new(system, sigma);
            let matrix = blocks.two_field(sigma)?;
            let symbolic = SymbolicCholesky::new(&matrix)?;
            let factor = symbolic.factorise(&matrix)?;
            corrected(&mut |residual, _, _| {
                let mut x = blocks.gather(&two_field.rhs(residual));
                factor.solve(&mut x);
                direct(blocks.scatter(&x))
            })
        }
        Formulation::TwoFieldIncomplete(sigma) => {
            let blocks = system.blocks();
            let two_field = TwoField::new(system, sigma);
            let matrix = blocks.two_field(sigma)?;
            let incomplete = incomplete(&matrix)?;
            corrected(&mut |residual, tolerance, left| {
                let rhs = blocks.gather(&two_field.rhs(residual));
                let mut x = vec![0.0; rhs.len()];
                let report = conjugate_gradient(
                    &matrix,
                    &incomplete,
                    &rhs,
                    &mut x,
                    tolerance.min(TRANSFORMED_TOLERANCE),
                    left as usize,
                );
                iterated(blocks.scatter(&x), report)
            })
        }
        Formulation::TwoFieldIterative(sigma) => {
            let two_field = TwoField::new(system, sigma);
            let preconditioner = Factored {
                system,
                two_field: &two_field,
                multigrid: Multigrid::new(&system.pressure.stencil),
                polynomial: solver.polynomial(solids, &system.solid),
            };
            corrected(&mut |residual, tolerance, left| {
                let rhs = two_field.rhs(residual);
                let mut x = vec![0.0; rhs.len()];
                let report = conjugate_gradient(
                    &two_field,
                    &preconditioner,
                    &rhs,
                    &mut x,
                    (ROUND_SHARE * tolerance).max(ROUND_TOLERANCE),
                    left as usize,
                );
                iterated(x, report)
            })
        }
        Formulation::Stress(stress) => {
            let blocks = system.blocks();
            let (factored, matrix) = stress.system(&blocks)?;
            let symbolic = SymbolicCholesky::new(&matrix)?;
            let factor = symbolic.factorise(&matrix)?;
            corrected(&mut |residual, _, _| {
                let reduced = blocks.gather(residual);
                let mut x = factored.rhs(&reduced);
                factor.solve(&mut x);
                direct(blocks.scatter(&factored.unknowns(&x, &reduced)))
            })
        }
        Formulation::StressIncomplete(stress) => {
            let blocks = system.blocks();
            let (factored, matrix) = stress.system(&blocks)?;
            let incomplete = incomplete(&matrix)?;
            corrected(&mut |residual, tolerance, left| {
                let reduced = blocks.gather(residual);
                let rhs = factored.rhs(&reduced);
                let mut x = vec![0.0; rhs.len()];
                let report = conjugate_gradient(
                    &matrix,
                    &incomplete,
                    &rhs,
                    &mut x,
                    tolerance.min(TRANSFORMED_TOLERANCE),
                    left as usize,
                );
                let unknowns = factored.unknowns(&x, &reduced);
                iterated(blocks.scatter(&unknowns), report)
            })
        }
        Formulation::Condensed => match Inverse::new(system, solver, solids)? {
            None => corrected(&mut broken_down),
            Some(inverse) => corrected(&mut condensed(system, &|y| inverse.apply(y))),
        },
    }
}

/// Corrections in the Schur-complement form; `inverse` is S^-1.
fn condensed<'a>(
    system: &'a CoupledSystem,
    inverse: &'a (dyn Fn(&[f64]) -> Vec<f64> + Sync),
) -> impl FnMut(&[f64], f64, u32) -> Correction + 'a {
    let operator = CondensedOperator { system, inverse };
    let multigrid = Multigrid::new(&system.pressure.stencil);
    move |residual, tolerance, left| {
        let (pressure_rows, velocity_rows) = residual.split_at(system.n_cells());
        // r_p + J S^-1 r_v over the scale of B; the residual of S v - J^T p = -w is -r_v.
        let free = inverse(velocity_rows);
        let pairs = pressure_rows.iter().zip(system.flux(&free));
        let rhs: Vec<f64> = pairs.map(|(r, flux)| (r - flux) / system.pressure.scale).collect();
        let mut x = vec![0.0; rhs.len()];
        let most = left as usize;
        let report = conjugate_gradient(&operator, &multigrid, &rhs, &mut x, tolerance, most);
        let mut force = system.force(&x);
        for (force, r) in force.iter_mut().zip(velocity_rows) {
            *force += r;
        }
        x.extend(inverse(&force));
        iterated(x, report)
    }
}

/// A coupled system whose rows in F are equations G_F v = r_F. With v = c + x and c = X_F W_FF^-1 (r_F - G_F v_0), v_0 the prescribed velocities,
/// x meets G_F x = 0. Residuals of the nodes are without the multiples of the rows, which the contact forces cancel.
struct HeldSystem<'a> {
    system: &'a CoupledSystem,
    held: &'a HeldRows<'a>,
    /// J c.
    flux: Vec<f64>,
    rhs: Vec<f64>,
}

impl LinearSystem for HeldSystem<'_> {
    fn rhs(&self) -> &[f64] {
        &self.rhs
    }

    fn rhs_scale(&self) -> f64 {
        self.system.rhs_scale()
    }

    fn n_unknowns(&self) -> usize {
        self.system.n_unknowns()
    }

    fn residual(&self, x: &[f64]) -> Vec<f64> {
        let mut residual = self.system.residual(x);
        let (cells, nodes) = residual.split_at_mut(self.system.n_cells());
        let fluxes = cells.iter_mut().zip(&self.flux);
        fluxes.for_each(|(r, flux)| *r -= flux);
        let forces = self.held.forces(&self.held.cancelling(nodes));
        let forces = self.system.solid.free_part(forces.as_chunks().0);
        let sums = nodes.iter_mut().zip(forces);
        sums.for_each(|(r, force)| *r += force);
        residual
    }

    fn project(&self, x: &mut [f64]) {
        self.system.project(x);
    }

    fn parts(&self, x: &[f64]) -> Vec<Part> {
        self.system.parts(x)
    }
}

/// Solves a coupled system with rows held as equations, in the Schur-complement form.
///
/// # Errors
/// As [`solve_coupled`].
fn solve_held(
    system: &CoupledSystem,
    held: &HeldRows,
    solver: &SolidSolver,
    solids: &Solids,
    settings: &Solver,
) -> Result<CoupledSolution, Error> {
    let n_cells = system.n_cells();
    let prescribed = system.solid.velocity(&vec![0.0; system.solid.rhs.len()]);
    let mut shift = vec![0.0; system.solid.rhs.len()];
    held.add_velocity(&held.meeting(prescribed.as_flattened()), &mut shift);
    let mut held_system = HeldSystem { system, held, flux: system.flux(&shift), rhs: system.rhs().to_vec() };
    let rhs = held_system.rhs[..n_cells].iter_mut();
    rhs.zip(&held_system.flux).for_each(|(rhs, flux)| *rhs -= flux);
    let (mut x, reports) = match Inverse::new(system, solver, solids)? {
        None => refine_parts(&held_system, settings, broken_down),
        Some(inverse) => {
            let inverse = |y: &[f64]| {
                let mut x = inverse.apply(y);
                held.add_velocity(&held.cancelling(y), &mut x);
                x
            };
            refine_parts(&held_system, settings, condensed(system, &inverse))
        }
    };
    let velocities = x[n_cells..].iter_mut();
    velocities.zip(&shift).for_each(|(x, shift)| *x += shift);
    let (pressure, velocity) = system.split(x);
    Ok(CoupledSolution { pressure, velocity, reports: [reports[0], reports[1]] })
}

/// The coupled solves of a sub-step.
#[derive(Debug)]
pub(super) struct Together<'a> {
    /// All cells as unknowns, and those that may separate.
    pub(super) pressure: &'a PressureSystem,
    pub(super) separation: Option<&'a mut Separation>,
    pub(super) coupling: &'a Coupling,
    pub(super) solver: &'a SolidSolver,
    pub(super) solids: &'a Solids,
    pub(super) settings: &'a Solver,
    /// Of all solves.
    pub(super) iterations: u32,
}

impl Together<'_> {
    /// Repeats a solve until the set of separated cells is unchanged, in the formulation of [`Formulation::of`] or with rows held. Iterations of
    /// the reports are those of all solves so far.
    ///
    /// # Errors
    /// As [`solve_coupled`].
    pub(super) fn solve(
        &mut self,
        solid: &SolidSystem,
        held: Option<&HeldRows>,
    ) -> Result<(CoupledSystem, CoupledSolution), Error> {
        let Together { pressure, separation, coupling, solver, solids, settings, iterations } = self;
        let mut solved = |pressure: PressureSystem, relief: Option<Vec<f64>>| -> Result<_, Error> {
            let mut solid = solid.clone();
            if let Some(relief) = relief {
                solid.push(&relief);
            }
            let system = CoupledSystem::new(pressure, solid, coupling);
            let mut solution = match held {
                None => {
                    let formulation = Formulation::of(&system);
                    solve_coupled(&system, formulation, solver, solids, settings)?
                }
                Some(held) => solve_held(&system, held, solver, solids, settings)?,
            };
            *iterations += solution.reports[0].iterations;
            for report in &mut solution.reports {
                report.iterations = *iterations;
            }
            Ok((system, solution))
        };
        let Some(separation) = separation else {
            return solved((*pressure).clone(), None);
        };
        let last = separation.search(pressure, settings.tolerance, |masked, relief| {
            let (system, solution) = solved(masked.clone(), relief)?;
            let mut flux = vec![0.0; masked.rhs.len()];
            coupling.add_product(solution.velocity.as_flattened(), &mut flux);
            Ok(Round { pressure: solution.pressure.clone(), flux, solution: (system, solution) })
        })?;
        Ok(last.solution)
    }
}

/// Repeats the coupled solve until the active set of contacts is unchanged, and in each the set of separated cells, in the
/// formulation of [`Formulation::of`]. Returns the last system and its solution. If the search for contacts does not converge,
/// the last system constrains every touched surface.
///
/// # Errors
/// As [`solve_coupled`].
pub fn solve_coupled_in_contact(
    (pressure, separation): (&PressureSystem, Option<&mut Separation>),
    solid: &mut SolidSystem,
    coupling: &Coupling,
    contacts: &mut Contacts,
    solver: &SolidSolver,
    solids: &Solids,
    settings: &Solver,
) -> Result<(CoupledSystem, CoupledSolution, ContactReport), Error> {
    let mut together = Together { pressure, separation, coupling, solver, solids, settings, iterations: 0 };
    let mut search = ContactSearch::new(contacts, MAX_SOLVES - 1);
    loop {
        let (system, solution) = together.solve(solid, None)?;
        // Liquid forces press nodes to walls too.
        let mut pushed = system.solid.clone();
        let mut force = vec![0.0; pushed.rhs.len()];
        system.coupling.add_transposed(&solution.pressure, &mut force);
        pushed.push(&force);
        let mut iterate = search.after(&pushed, solution.velocity.clone(), false);
        let found_all = solution.reports[0].status.is_best_attainable();
        if !found_all || iterate.report.unsettled == 0 {
            return Ok((system, solution, iterate.report));
        }
        if iterate.ended {
            // The final velocities do not match the pressure. Solve once more with all touched surfaces constrained.
            search.hold_all_touching(&iterate.velocity);
        }
        solid.free(search.hold(&mut iterate.velocity), &iterate.velocity);
        if iterate.ended {
            let (system, solution) = together.solve(solid, None)?;
            iterate.report.solves += 1;
            return Ok((system, solution, iterate.report));
        }
    }
}

/// A correction without iterations.
fn direct(x: Vec<f64>) -> Correction {
    Correction { x, iterations: 0, end: CgEnd::Converged }
}

fn iterated(x: Vec<f64>, report: CgReport) -> Correction {
    Correction { x, iterations: report.iterations as u32, end: report.end }
}

fn incomplete(matrix: &Csr) -> Result<Incomplete, Error> {
    Incomplete::new(matrix).ok_or_else(|| {
        let n = matrix.n_rows();
        Error::input(
            format!("incomplete factor of a {n} x {n} matrix"),
            "breaks down even with twice the diagonal",
            "use another formulation",
        )
    })
}

/// Preconditioner of B and of S.
struct Both {
    liquid: Incomplete,
    solids: Incomplete,
}

impl LinearOperator for Both {
    fn size(&self) -> usize {
        self.liquid.size() + self.solids.size()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        let (pressure_rows, velocity_rows) = x.split_at(self.liquid.size());
        let (p, v) = y.split_at_mut(self.liquid.size());
        self.liquid.apply(pressure_rows, p);
        self.solids.apply(velocity_rows, v);
    }
}

impl Blocks {
    /// \[B J; J^T -S\].
    pub fn indefinite(&self) -> Csr {
        Csr::bordered(&self.b, &self.j, -1.0, &self.s)
    }

    /// Right-hand side from a residual, whose second part has the opposite sign.
    fn indefinite_rhs(&self, residual: &[f64]) -> Vec<f64> {
        let mut rhs = self.gather(residual);
        rhs[self.cells.len()..].iter_mut().for_each(|r| *r = -*r);
        rhs
    }

    /// Z1 = sigma zeta_M M in free components, kg/s.
    pub fn z1(&self, sigma: f64) -> Vec<f64> {
        self.mass.iter().map(|mass| sigma * mass).collect()
    }

    /// Z2 = S - Z1, kg/s.
    pub fn z2(&self, sigma: f64) -> Csr {
        self.s.plus(-1.0, &Csr::diagonal_of(&self.z1(sigma)))
    }

    /// A of thesis (5.25).
    ///
    /// # Errors
    /// When it does not fit into memory.
    pub fn two_field(&self, sigma: f64) -> Result<Csr, Error> {
        let inverse: Vec<f64> = self.z1(sigma).iter().map(|z1| 1.0 / z1).collect();
        let z2 = self.z2(sigma);
        let j_over_z1 = self.j.clone().scaled(&vec![1.0; self.cells.len()], &inverse);
        let z2_over_z1 = z2.clone().scaled(&vec![1.0; inverse.len()], &inverse);
        let a11 = self.b.plus(1.0, &j_over_z1.product(&self.j.transpose())?);
        let a12 = j_over_z1.product(&z2)?;
        let a22 = z2.plus(1.0, &z2_over_z1.product(&z2)?);
        let minus = vec![-1.0; self.cells.len()];
        let a12 = a12.scaled(&minus, &vec![1.0; inverse.len()]);
        Ok(Csr::bordered(&a11, &a12, 1.0, &a22))
    }

    /// Right-hand side of A from E u* and w of the unknowns.
    pub fn two_field_rhs(&self, sigma: f64, e: &[f64], w: &[f64]) -> Vec<f64> {
        let over: Vec<f64> = w.iter().zip(self.z1(sigma)).map(|(w, z1)| w / z1).collect();
        let mut rhs = vec![0.0; e.len()];
        self.j.multiply(&over, &mut rhs);
        rhs.iter_mut().zip(e).for_each(|(rhs, e)| *rhs += e);
        let mut below = vec![0.0; w.len()];
        self.z2(sigma).multiply(&over, &mut below);
        rhs.extend(below.iter().map(|below| -below));
        rhs
    }
}

/// S^-1 in free components.
enum Inverse<'a> {
    /// All components are prescribed.
    Nothing,
    Factor {
        factor: Cholesky<'a>,
        components: Vec<usize>,
    },
    Iterative {
        system: &'a SolidSystem,
        polynomial: Chebyshev<'a>,
    },
}

impl<'a> Inverse<'a> {
    /// Factorises S. `None` if S has no factor in f64.
    ///
    /// # Errors
    /// When the factor does not fit into memory.
    fn new(system: &'a CoupledSystem, solver: &'a SolidSolver, solids: &Solids) -> Result<Option<Inverse<'a>>, Error> {
        let (solid, components) = (&system.solid, system.solid.components());
        if components.is_empty() {
            Ok(Some(Inverse::Nothing))
        } else if components.len() <= DIRECT_UNKNOWNS {
            let factor = solver.factorise(solid)?;
            Ok(factor.map(|factor| Inverse::Factor { factor, components }))
        } else {
            let polynomial = solver.polynomial(solids, solid);
            let system = solid;
            Ok(Some(Inverse::Iterative { system, polynomial }))
        }
    }

    fn apply(&self, y: &[f64]) -> Vec<f64> {
        let mut x = vec![0.0; y.len()];
        match self {
            Inverse::Nothing => {}
            Inverse::Factor { factor, components } => {
                let mut free: Vec<f64> = components.iter().map(|&at| y[at]).collect();
                factor.solve(&mut free);
                for (&at, value) in components.iter().zip(free) {
                    x[at] = value;
                }
            }
            Inverse::Iterative { system, polynomial } => {
                let most = INNER_ITERATIONS;
                conjugate_gradient(*system, polynomial, y, &mut x, INNER_TOLERANCE, most);
            }
        }
        x
    }
}

/// (B + J S^-1 J^T) / scale of B, matching [`Multigrid`] as the inverse of B / scale.
struct CondensedOperator<'a> {
    system: &'a CoupledSystem,
    inverse: &'a (dyn Fn(&[f64]) -> Vec<f64> + Sync),
}

impl LinearOperator for CondensedOperator<'_> {
    fn size(&self) -> usize {
        self.system.n_cells()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.system.pressure.stencil.apply(x, y);
        let free = (self.inverse)(&self.system.force(x));
        for (y, flux) in y.iter_mut().zip(self.system.flux(&free)) {
            *y += flux / self.system.pressure.scale;
        }
    }
}

/// Preconditioner of A: t = Sh g_v, z_p = H (g_p + J t), z_v = Sh (J^T z_p + Z1 t). H ~ B^-1 is a V-cycle and Sh ~
/// S^-1 a polynomial. Symmetric positive definite because both are.
struct Factored<'a> {
    system: &'a CoupledSystem,
    two_field: &'a TwoField<'a>,
    multigrid: Multigrid,
    polynomial: Chebyshev<'a>,
}

impl LinearOperator for Factored<'_> {
    fn size(&self) -> usize {
        self.two_field.size()
    }

    fn apply(&self, g: &[f64], z: &mut [f64]) {
        let (pressure_rows, velocity_rows) = g.split_at(self.system.n_cells());
        let (z_p, z_v) = z.split_at_mut(self.system.n_cells());
        let mut t = vec![0.0; velocity_rows.len()];
        self.polynomial.apply(velocity_rows, &mut t);
        let pairs = pressure_rows.iter().zip(self.system.flux(&t));
        let scale = self.system.pressure.scale;
        let rhs: Vec<f64> = pairs.map(|(g, flux)| (g + flux) / scale).collect();
        self.multigrid.apply(&rhs, z_p);
        let mut force = self.system.force(z_p);
        for ((force, t), z1) in force.iter_mut().zip(&t).zip(self.two_field.z1()) {
            *force += z1 * t;
        }
        self.polynomial.apply(&force, z_v);
    }
}

/// Weak coupling: B p = E u* - J v with the velocities `before` the step (m/s), without the forces' increment; then S
/// v = -w + J^T p by `solve_solid`. Both systems are updated to the solved ones.
///
/// # Errors
/// As both solves.
pub fn solve_weak(
    (pressure, separation): (&mut PressureSystem, Option<&mut Separation>),
    solid: &mut SolidSystem,
    coupling: &Coupling,
    before: &[[f64; 3]],
    settings: &Solver,
    solve_solid: impl FnOnce(&mut SolidSystem) -> Result<(Vec<[f64; 3]>, SolveReport), Error>,
) -> Result<CoupledSolution, Error> {
    let coupling = coupling.restricted(|cell| pressure.stencil.active(cell));
    let mut flux = vec![0.0; pressure.rhs.len()];
    coupling.add_product(before.as_flattened(), &mut flux);
    for (rhs, flux) in pressure.rhs.iter_mut().zip(&flux) {
        *rhs -= flux;
    }
    // The solids move too late to determine the pressure level.
    let level_free = closed_components(&pressure.stencil);
    pressure.closed = level_free;
    let mut rhs = std::mem::take(&mut pressure.rhs);
    pressure.remove_closed_means(&mut rhs);
    pressure.rhs = rhs;
    pressure.rhs_scale += norm(&flux);
    let (field, pressure_report) = match separation {
        Some(separation) => {
            let solved = separation.solve(pressure, settings)?;
            if let Some(relief) = separation.relief() {
                solid.push(&relief);
            }
            solved
        }
        None => solve(pressure, settings)?,
    };
    let mut force = vec![0.0; solid.rhs.len()];
    coupling.add_transposed(&field, &mut force);
    solid.push(&force);
    let (velocity, solid_report) = solve_solid(solid)?;
    Ok(CoupledSolution { pressure: field, velocity, reports: [pressure_report, solid_report] })
}

/// Damping-only coupling: first (M/dt + dt K) v' = -w for the solids alone. Then the coupled system with S replaced
/// by M/dt + D, and w = -M v'/dt. Otherwise as [`solve_coupled_in_contact`]. Iterations are those of the second
/// solve, active-set iterations those of both.
///
/// # Errors
/// As both solves.
pub fn solve_damping_only(
    liquid: (&PressureSystem, Option<&mut Separation>),
    solid: &mut SolidSystem,
    coupling: &Coupling,
    contacts: &mut Contacts,
    solver: &SolidSolver,
    solids: &Solids,
    settings: &Solver,
) -> Result<(CoupledSystem, CoupledSolution, ContactReport), Error> {
    let dt = solid.dt();
    let undamped = |_: &Body| [1.0 / dt, dt];
    let mut elastic = solid.changed(solids, undamped, &solid.right_hand_side());
    let (mut velocity, report, before) = solver.solve_in_contact(solids, &mut elastic, contacts, settings)?;
    let damping = |body: &Body| [1.0 / dt + body.mass_damping, body.stiffness_damping];
    *solid = solid.changed(solids, damping, &solid.inertia(&velocity));
    solid.free(contacts.hold(&mut velocity), &velocity);
    let (system, mut solution, mut contact) =
        solve_coupled_in_contact(liquid, solid, coupling, contacts, solver, solids, settings)?;
    if report.status != SolveStatus::Converged {
        solution.reports[1].status = report.status;
    }
    contact.solves += before.solves;
    contact.unsettled += before.unsettled;
    Ok((system, solution, contact))
}
