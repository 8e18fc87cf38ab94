//! `solve`, for liquid and solids together: one function per formulation of design section 2. All are judged on the residual of the
//! indefinite system, and repeated on what it leaves until both its parts pass.

use super::active_cells::closed_components;
use super::coupled_system::{Blocks, CoupledSystem, TwoField};
use super::multigrid::Multigrid;
use super::pressure_system::PressureSystem;
use super::refine::{Correction, Judged, refine_parts};
use super::solid_contacts::{ContactSearch, Contacts, MOST_SOLVES};
use super::solid_system::SolidSystem;
use super::solve::{DIRECT_UNKNOWNS, broken_down, solve};
use super::solve_solid::{Chebyshev, SolidSolver};
use super::stress_variables::StressVariables;
use crate::Error;
use crate::elastic::{Body, Solids};
use crate::geometry::Coupling;
use crate::linalg::{
    CgEnd, CgReport, Cholesky, Csr, Incomplete, LinearOperator, SymbolicCholesky,
    conjugate_gradient, minimal_residual, norm, stabilised_biconjugate_gradient,
};
use crate::scene::Solver;
use crate::state::{ContactReport, SolveReport, SolveStatus};

/// Share of the mass in Z1. Between exact inverses, 0.5 makes the fewest iterations.
pub const SIGMA: f64 = 0.5;

/// Other iterative solves of transformed systems go at least this far in a round: their residual is not the one that is judged.
const TRANSFORMED_TOLERANCE: f64 = 1e-8;

/// The factored two-field solve takes rounds, each to this, or to this share of what is left: more of the transformed residual says little
/// of the one that is judged.
const ROUND_TOLERANCE: f64 = 1e-4;
const ROUND_SHARE: f64 = 0.3;

/// Relative residual of the solves with S inside an iteration, where S has no factor.
const INNER_TOLERANCE: f64 = 1e-13;
/// Their iterations.
const INNER_ITERATIONS: usize = 10_000;

/// What a coupled solve found.
#[derive(Clone, Debug)]
pub struct CoupledSolution {
    /// Per cell, Pa; 0 in inactive ones.
    pub pressure: Vec<f64>,
    /// Of all nodes, m/s.
    pub velocity: Vec<[f64; 3]>,
    /// Of E u* - B p - J v and of w - (J^T p - S v).
    pub reports: [SolveReport; 2],
}

/// Operator, preconditioner, b, x, tolerance, iterations at most.
type Iterate =
    fn(&dyn LinearOperator, &dyn LinearOperator, &[f64], &mut [f64], f64, usize) -> CgReport;

/// A formulation of the coupled system.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Formulation<'a> {
    /// \[B J; J^T -S\] (thesis 5.17) by sparse L D L^T.
    Indefinite,
    /// The same by stabilised biconjugate gradients with an incomplete LU factor.
    IndefiniteIterative,
    /// The same by minimal residuals with incomplete factors of B and of S, as the thesis tried.
    IndefiniteMinimalResidual,
    /// A of thesis (5.25), assembled, by sparse Cholesky; the share sigma of the mass in Z1.
    TwoField(f64),
    /// The same by conjugate gradients with an incomplete Cholesky factor, as the thesis does.
    TwoFieldIncomplete(f64),
    /// A in factored form by conjugate gradients with multigrid on B and a polynomial in S.
    TwoFieldIterative(f64),
    /// Pressures and stresses (thesis 5.3) by sparse Cholesky.
    Stress(&'a StressVariables),
    /// The same by conjugate gradients with an incomplete Cholesky factor.
    StressIncomplete(&'a StressVariables),
    /// (B + J S^-1 J^T) p = E u* + J S^-1 w by conjugate gradients with multigrid on B.
    Condensed,
}

impl Formulation<'_> {
    /// Its name, and how it is solved.
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

    /// The one for a system of its size.
    pub fn of(system: &CoupledSystem) -> Formulation<'static> {
        if system.n_unknowns() <= DIRECT_UNKNOWNS {
            Formulation::Indefinite
        } else {
            Formulation::Condensed
        }
    }
}

/// Solves a coupled system; `solver` and `solids`: of its solids. In the forms of [`Formulation::of`] a matrix without a factor in f64 is a
/// breakdown.
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
        Ok(CoupledSolution {
            pressure,
            velocity,
            reports: [reports[0], reports[1]],
        })
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
                let both = Both {
                    liquid: incomplete(&blocks.b)?,
                    solids: incomplete(&blocks.s)?,
                };
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
                let of_unknowns = blocks.gather(residual);
                let mut x = factored.rhs(&of_unknowns);
                factor.solve(&mut x);
                direct(blocks.scatter(&factored.unknowns(&x, &of_unknowns)))
            })
        }
        Formulation::StressIncomplete(stress) => {
            let blocks = system.blocks();
            let (factored, matrix) = stress.system(&blocks)?;
            let incomplete = incomplete(&matrix)?;
            corrected(&mut |residual, tolerance, left| {
                let of_unknowns = blocks.gather(residual);
                let rhs = factored.rhs(&of_unknowns);
                let mut x = vec![0.0; rhs.len()];
                let report = conjugate_gradient(
                    &matrix,
                    &incomplete,
                    &rhs,
                    &mut x,
                    tolerance.min(TRANSFORMED_TOLERANCE),
                    left as usize,
                );
                let unknowns = factored.unknowns(&x, &of_unknowns);
                iterated(blocks.scatter(&unknowns), report)
            })
        }
        Formulation::Condensed => {
            let Some(inverse) = Inverse::new(system, solver, solids)? else {
                return corrected(&mut broken_down);
            };
            let condensed = CondensedOperator {
                system,
                inverse: &inverse,
            };
            let multigrid = Multigrid::new(&system.pressure.stencil);
            corrected(&mut |residual, tolerance, left| {
                let (of_p, of_v) = residual.split_at(system.n_cells());
                // r_p + J S^-1 r_v, over the scale of B; what is left of S v - J^T p = -w is -r_v.
                let free = inverse.apply(of_v);
                let pairs = of_p.iter().zip(system.flux(&free));
                let rhs: Vec<f64> = pairs
                    .map(|(r, flux)| (r - flux) / system.pressure.scale)
                    .collect();
                let mut x = vec![0.0; rhs.len()];
                let most = left as usize;
                let report =
                    conjugate_gradient(&condensed, &multigrid, &rhs, &mut x, tolerance, most);
                let mut force = system.force(&x);
                for (force, r) in force.iter_mut().zip(of_v) {
                    *force += r;
                }
                x.extend(inverse.apply(&force));
                iterated(x, report)
            })
        }
    }
}

/// Solves for liquid and solids again while contacts change, which hold what the system of the solids holds; the last system and its
/// solution. Where the search for them does not settle, that is one which holds every node that is on a surface. In the formulation that [`Formulation::of`] says.
///
/// # Errors
/// As those of [`solve_coupled`].
pub fn solve_coupled_in_contact(
    pressure: &PressureSystem,
    solid: &mut SolidSystem,
    coupling: &Coupling,
    contacts: &mut Contacts,
    solver: &SolidSolver,
    solids: &Solids,
    settings: &Solver,
) -> Result<(CoupledSystem, CoupledSolution, ContactReport), Error> {
    let mut iterations = 0;
    let mut solved = |solid: &SolidSystem| -> Result<_, Error> {
        let system = CoupledSystem::new(pressure.clone(), solid.clone(), coupling);
        let formulation = Formulation::of(&system);
        let mut solution = solve_coupled(&system, formulation, solver, solids, settings)?;
        iterations += solution.reports[0].iterations;
        for report in &mut solution.reports {
            report.iterations = iterations;
        }
        Ok((system, solution))
    };
    let mut search = ContactSearch::new(contacts, MOST_SOLVES - 1);
    loop {
        let (system, solution) = solved(solid)?;
        // The liquid pushes nodes to walls too.
        let mut pushed = solid.clone();
        let mut force = vec![0.0; pushed.rhs.len()];
        system
            .coupling
            .add_transposed(&solution.pressure, &mut force);
        pushed.push(&force);
        let mut searched = search.after(&pushed, solution.velocity.clone(), false);
        let found_all = solution.reports[0].status.found_all_it_can();
        if !found_all || searched.report.unsettled == 0 {
            return Ok((system, solution, searched.report));
        }
        if searched.ended {
            // They do not go with the pressure found: what does, and holds all that they touch.
            search.hold_all_touching(&searched.velocity);
        }
        solid.free(search.hold(&mut searched.velocity), &searched.velocity);
        if searched.ended {
            let (system, solution) = solved(solid)?;
            searched.report.solves += 1;
            return Ok((system, solution, searched.report));
        }
    }
}

/// A correction without iterations.
fn direct(x: Vec<f64>) -> Correction {
    Correction {
        x,
        iterations: 0,
        end: CgEnd::Converged,
    }
}

fn iterated(x: Vec<f64>, report: CgReport) -> Correction {
    Correction {
        x,
        iterations: report.iterations as u32,
        end: report.end,
    }
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

/// B^-1 and S^-1, each roughly.
struct Both {
    liquid: Incomplete,
    solids: Incomplete,
}

impl LinearOperator for Both {
    fn size(&self) -> usize {
        self.liquid.size() + self.solids.size()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        let (of_p, of_v) = x.split_at(self.liquid.size());
        let (p, v) = y.split_at_mut(self.liquid.size());
        self.liquid.apply(of_p, p);
        self.solids.apply(of_v, v);
    }
}

impl Blocks {
    /// \[B J; J^T -S\].
    pub fn indefinite(&self) -> Csr {
        Csr::bordered(&self.b, &self.j, -1.0, &self.s)
    }

    /// Its right-hand side from a residual, whose second part has the other sign.
    fn indefinite_rhs(&self, residual: &[f64]) -> Vec<f64> {
        let mut rhs = self.gather(residual);
        rhs[self.cells.len()..].iter_mut().for_each(|r| *r = -*r);
        rhs
    }

    /// Z1 = sigma zeta_M M on the free components, kg/s.
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
        let j_over_z1 = self
            .j
            .clone()
            .scaled(&vec![1.0; self.cells.len()], &inverse);
        let z2_over_z1 = z2.clone().scaled(&vec![1.0; inverse.len()], &inverse);
        let a11 = self.b.plus(1.0, &j_over_z1.product(&self.j.transpose())?);
        let a12 = j_over_z1.product(&z2)?;
        let a22 = z2.plus(1.0, &z2_over_z1.product(&z2)?);
        let minus = vec![-1.0; self.cells.len()];
        let a12 = a12.scaled(&minus, &vec![1.0; inverse.len()]);
        Ok(Csr::bordered(&a11, &a12, 1.0, &a22))
    }

    /// Its right-hand side from E u* and w of the unknowns.
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

/// S^-1 on the free components.
enum Inverse<'a> {
    /// All of them are prescribed.
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
    /// `None` where S has no factor in f64.
    ///
    /// # Errors
    /// When the factor does not fit into memory.
    fn new(
        system: &'a CoupledSystem,
        solver: &'a SolidSolver,
        solids: &Solids,
    ) -> Result<Option<Inverse<'a>>, Error> {
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

/// (B + J S^-1 J^T) / scale of B, as [`Multigrid`] stands for the inverse of B / scale.
struct CondensedOperator<'a> {
    system: &'a CoupledSystem,
    inverse: &'a Inverse<'a>,
}

impl LinearOperator for CondensedOperator<'_> {
    fn size(&self) -> usize {
        self.system.n_cells()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.system.pressure.stencil.apply(x, y);
        let free = self.inverse.apply(&self.system.force(x));
        for (y, flux) in y.iter_mut().zip(self.system.flux(&free)) {
            *y += flux / self.system.pressure.scale;
        }
    }
}

/// What stands for A^-1: t = Sh g_v, z_p = H (g_p + J t), z_v = Sh (J^T z_p + Z1 t), with H ~ B^-1 a V-cycle and Sh ~ S^-1 a
/// polynomial. Symmetric and positive definite because both are.
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
        let (of_p, of_v) = g.split_at(self.system.n_cells());
        let (z_p, z_v) = z.split_at_mut(self.system.n_cells());
        let mut t = vec![0.0; of_v.len()];
        self.polynomial.apply(of_v, &mut t);
        let pairs = of_p.iter().zip(self.system.flux(&t));
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

/// Weak coupling: B p = E u* - J v of the velocities `before` the step (m/s), without what forces add to them; then S v = -w + J^T p,
/// which `solve_solid` solves. Both systems become those solved.
///
/// # Errors
/// As those of both solves.
pub fn solve_weak(
    pressure: &mut PressureSystem,
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
    // The solids give way too late to fix the level.
    let level_free = closed_components(&pressure.stencil);
    pressure.closed = level_free;
    let mut rhs = std::mem::take(&mut pressure.rhs);
    pressure.remove_closed_means(&mut rhs);
    pressure.rhs = rhs;
    pressure.rhs_scale += norm(&flux);
    let (found, of_pressure) = solve(pressure, settings)?;
    let mut force = vec![0.0; solid.rhs.len()];
    coupling.add_transposed(&found, &mut force);
    solid.push(&force);
    let (velocity, of_solid) = solve_solid(solid)?;
    Ok(CoupledSolution {
        pressure: found,
        velocity,
        reports: [of_pressure, of_solid],
    })
}

/// Damping-only coupling: (M/dt + dt K) v' = -w of the solids by themselves, then the coupled system with M/dt + D in place of S
/// and w = -M v'/dt. As [`solve_coupled_in_contact`] otherwise; the iterations are those of the second solve, the solves in search of contacts those of both.
///
/// # Errors
/// As those of both solves.
pub fn solve_damping_only(
    pressure: &PressureSystem,
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
    let (mut velocity, report, before) =
        solver.solve_in_contact(solids, &mut elastic, contacts, settings)?;
    let damping = |body: &Body| [1.0 / dt + body.mass_damping, body.stiffness_damping];
    *solid = solid.changed(solids, damping, &solid.inertia(&velocity));
    solid.free(contacts.hold(&mut velocity), &velocity);
    let (system, mut solution, mut contact) = solve_coupled_in_contact(
        pressure, solid, coupling, contacts, solver, solids, settings,
    )?;
    if report.status != SolveStatus::Converged {
        solution.reports[1].status = report.status;
    }
    contact.solves += before.solves;
    contact.unsettled += before.unsettled;
    Ok((system, solution, contact))
}
