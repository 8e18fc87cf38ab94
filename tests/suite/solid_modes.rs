//! Static solutions, modes and steps of solids by the stages of the f64 path, for the suite and the validation to compare with theory.

use std::sync::Arc;

use cutwater::elastic::Solids;
use cutwater::linalg::{SymbolicCholesky, dot};
use cutwater::reference::{BlockPattern, Freedom, SolidSolver, SolidSystem, solid_matrices, solid_right_hand_side};
use cutwater::scene::Solver;
use cutwater::state::SolveStatus;

use crate::common::Random;

/// Solids with what their steps share.
pub(crate) struct Dynamics<'a> {
    pub(crate) solids: &'a Solids,
    pattern: Arc<BlockPattern>,
    solver: SolidSolver,
    settings: Solver,
    /// Whether conjugate gradients solve the steps.
    pub(crate) iterative: bool,
}

impl<'a> Dynamics<'a> {
    pub(crate) fn new(solids: &'a Solids) -> Dynamics<'a> {
        Dynamics {
            solids,
            pattern: Arc::new(BlockPattern::new(solids)),
            solver: SolidSolver::new(solids),
            settings: Solver { tolerance: 1e-11, max_iterations: 2000, ..Solver::default() },
            iterative: false,
        }
    }

    fn system(&self, u: &[[f64; 3]], v: &[[f64; 3]], dt: f64) -> SolidSystem {
        let matrices = solid_matrices(self.solids, &self.pattern, u);
        let rhs = solid_right_hand_side(self.solids, &matrices, v, dt);
        let freedom = Freedom::all(self.solids);
        SolidSystem::new(self.solids, matrices.stiffness.clone(), &rhs, v, freedom, dt)
    }

    /// One step of dt (s) without gravity and contact: moves, then solves.
    pub(crate) fn step(&self, u: &mut [[f64; 3]], v: &mut Vec<[f64; 3]>, dt: f64) {
        for (u, v) in u.as_flattened_mut().iter_mut().zip(v.as_flattened()) {
            *u += dt * v;
        }
        let system = self.system(u, v, dt);
        let (next, report) = if self.iterative {
            self.solver.solve_iterative(self.solids, &system, &self.settings)
        } else {
            self.solver.solve_direct(&system, &self.settings).unwrap()
        };
        assert_eq!(report.status, SolveStatus::Converged, "{report:?}");
        *v = next;
    }

    /// Displacement under the loads: steps so long that inertia counts for nothing, each from rest.
    pub(crate) fn static_displacement(&self) -> Vec<[f64; 3]> {
        let still = vec![[0.0; 3]; self.solids.rest.len()];
        let (mut u, dt) = (still.clone(), 1e4);
        for _ in 0..20 {
            let (v, report) = self.solver.solve_direct(&self.system(&u, &still, dt), &self.settings).unwrap();
            assert_eq!(report.status, SolveStatus::Converged, "{report:?}");
            let largest = |x: &[[f64; 3]]| x.as_flattened().iter().fold(0.0, |m, x| f64::max(m, x.abs()));
            for (u, v) in u.as_flattened_mut().iter_mut().zip(v.as_flattened()) {
                *u += dt * v;
            }
            if dt * largest(&v) <= 1e-12 * largest(&u) {
                return u;
            }
        }
        panic!("the load is not carried after 20 steps");
    }

    /// The lowest modes around rest: shapes of unit modal mass, and squares of angular frequencies (1/s^2), ascending; by
    /// simultaneous inverse iteration. Nothing may move without strain.
    pub(crate) fn modes(&self, count: usize, iterations: usize) -> Vec<(Vec<f64>, f64)> {
        let n = self.solids.rest.len();
        let still = vec![[0.0; 3]; n];
        // S dt = K dt^2 + M, where M counts for nothing.
        let dt = 1e5;
        let system = self.system(&still, &still, dt);
        let unknowns = system.components();
        let matrix = system.free_to_csr();
        let symbolic = SymbolicCholesky::new(&matrix).unwrap();
        let factor = symbolic.factorise(&matrix).unwrap();
        let mass: Vec<f64> = unknowns.iter().map(|at| self.solids.mass[at / 3]).collect();
        let weighted = |x: &[f64]| -> Vec<f64> { x.iter().zip(&mass).map(|(x, m)| x * m).collect() };
        let mut random = Random(5);
        let mut shapes: Vec<Vec<f64>> =
            (0..count).map(|_| mass.iter().map(|_| random.uniform(-1.0, 1.0)).collect()).collect();
        let mut squares = vec![0.0; count];
        for _ in 0..iterations {
            for shape in &mut shapes {
                *shape = weighted(shape);
                factor.solve(shape);
            }
            for (i, square) in squares.iter_mut().enumerate() {
                let (before, rest) = shapes.split_at_mut(i);
                for other in before {
                    let share = dot(&rest[0], &weighted(other));
                    rest[0].iter_mut().zip(&*other).for_each(|(x, y)| *x -= share * y);
                }
                let size = dot(&rest[0], &weighted(&rest[0])).sqrt();
                rest[0].iter_mut().for_each(|x| *x /= size);
                // M^-1 K shrank it to 1/(w^2 dt).
                *square = 1.0 / (size * dt);
            }
        }
        let full = |shape: Vec<f64>| {
            let mut all = vec![0.0; 3 * n];
            for (&at, x) in unknowns.iter().zip(shape) {
                all[at] = x;
            }
            all
        };
        shapes.into_iter().map(full).zip(squares).collect()
    }

    /// Amplitudes of a shape in the displacements of a motion that starts from it, at rest: one per step of dt (s).
    pub(crate) fn ring(&self, shape: &[f64], size: f64, dt: f64, steps: usize) -> Vec<f64> {
        let weights = weights(self.solids, shape);
        let mut u = sized(shape, size);
        let mut v = vec![[0.0; 3]; u.len()];
        (0..steps)
            .map(|_| {
                self.step(&mut u, &mut v, dt);
                dot(&weights, u.as_flattened())
            })
            .collect()
    }
}

/// What gives the amplitude of a shape of unit modal mass in displacements: M times the shape.
pub(crate) fn weights(solids: &Solids, shape: &[f64]) -> Vec<f64> {
    let masses = solids.mass.iter().flat_map(|&mass| [mass; 3]);
    shape.iter().zip(masses).map(|(x, m)| x * m).collect()
}

/// A shape times a size, as displacements.
pub(crate) fn sized(shape: &[f64], size: f64) -> Vec<[f64; 3]> {
    let (nodes, _) = shape.as_chunks::<3>();
    nodes.iter().map(|x| x.map(|x| size * x)).collect()
}

/// Decay per step and angle per step (rad) of an oscillation: the modulus and argument of the z in q_n = Re(c z^n) that fits
/// q_(n+2) = 2 Re(z) q_(n+1) - |z|^2 q_n best.
pub(crate) fn ringing(q: &[f64]) -> [f64; 2] {
    let [mut aa, mut ab, mut bb, mut ac, mut bc] = [0.0; 5];
    for window in q.windows(3) {
        let (a, b, c) = (window[1], -window[0], window[2]);
        aa += a * a;
        ab += a * b;
        bb += b * b;
        ac += a * c;
        bc += b * c;
    }
    let determinant = aa * bb - ab * ab;
    let (sum, product) = ((ac * bb - bc * ab) / determinant, (bc * aa - ac * ab) / determinant);
    let decay = product.sqrt();
    [decay, (0.5 * sum / decay).acos()]
}
