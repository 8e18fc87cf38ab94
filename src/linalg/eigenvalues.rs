//! Extreme eigenvalues of symmetric matrices, and lower bounds of 1-norms of inverses.
//!
//! The largest magnitude is by restarted Lanczos iteration (faer), the smallest by inverse iteration.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::matrix_free::eigen::{self, PartialEigenParams};
use faer::{ColRef, Mat, Par, Side};

use super::conjugate_gradient::Wrapped;
use super::{Csr, dot, norm};
use crate::Error;

/// Most rows for the dense solver: faer's subspace must be smaller than the matrix.
const DENSE: usize = 128;
/// Relative tolerance of an eigenvalue.
const TOLERANCE: f64 = 1e-4;
const MAX_RESTARTS: usize = 100;
const MAX_SOLVES: usize = 200;
/// Most iterations of the 1-norm estimate.
const MAX_CLIMBS: usize = 5;
/// Seed of the start vectors.
const SEED: u64 = 62;

/// Solves A x = b: returns x for b.
pub type Solve<'a> = &'a mut dyn FnMut(&[f64]) -> Result<Vec<f64>, Error>;

/// All eigenvalues of a symmetric matrix, ascending, by a dense solver.
pub fn eigenvalues(matrix: &Csr) -> Result<Vec<f64>, Error> {
    let n = matrix.n_rows();
    let mut dense = Mat::zeros(n, n);
    for (row, column, value) in matrix.triplets() {
        dense[(row, column)] = value;
    }
    let result = dense.self_adjoint_eigenvalues(Side::Lower);
    result.map_err(|problem| failed(matrix, format!("{problem:?}")))
}

/// Largest magnitude of the eigenvalues of a symmetric matrix, to about 1e-4 of it.
pub fn largest_magnitude(matrix: &Csr) -> Result<f64, Error> {
    let n = matrix.n_rows();
    if n <= DENSE {
        let all = eigenvalues(matrix)?.into_iter();
        return Ok(all.fold(0.0, |most, value| f64::max(most, value.abs())));
    }
    // faer's tolerance is absolute; this norm bounds all eigenvalues.
    let scale = matrix.infinity_norm();
    let scaled = matrix.clone().scaled(&vec![1.0 / scale; n], &vec![1.0; n]);
    let params = PartialEigenParams { max_restarts: MAX_RESTARTS, ..PartialEigenParams::default() };
    let operator = Wrapped(&scaled);
    let scratch = eigen::partial_self_adjoint_eigen_scratch(&operator, 1, Par::Seq, params);
    let mut vector = Mat::zeros(n, 1);
    let mut value = [0.0];
    let result = eigen::partial_self_adjoint_eigen(
        vector.as_mut(),
        &mut value,
        &operator,
        ColRef::from_slice(&start(n)),
        TOLERANCE,
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(scratch)),
        params,
    );
    match result.n_converged_eigen {
        0 => Err(failed(matrix, format!("{MAX_RESTARTS} restarts"))),
        _ => Ok(scale * value[0].abs()),
    }
}

/// Smallest magnitude of the eigenvalues of a symmetric matrix of n rows, by inverse iteration with `solve`.
///
/// Iterates until 1 / |A^-1 x|, an upper bound, changes by at most a relative 1e-4.
pub fn smallest_magnitude(n: usize, solve: Solve) -> Result<f64, Error> {
    let mut x = start(n);
    let size = norm(&x);
    x.iter_mut().for_each(|x| *x /= size);
    let mut before = 0.0;
    for _ in 0..MAX_SOLVES {
        x = solve(&x)?;
        let size = norm(&x);
        x.iter_mut().for_each(|x| *x /= size);
        if !size.is_finite() {
            break;
        }
        if (size - before).abs() <= TOLERANCE * size {
            return Ok(1.0 / size);
        }
        before = size;
    }
    let problem = format!("inverse iteration took {MAX_SOLVES} solves or broke down");
    Err(not_found(n, problem))
}

/// Lower bound of the 1-norm of the inverse of a symmetric matrix of n rows, mostly the norm itself (Hager 1984, Higham 1988;
/// MATLAB's `condest` with one vector).
pub fn inverse_one_norm(n: usize, solve: Solve) -> Result<f64, Error> {
    let size = |x: &[f64]| x.iter().map(|x| x.abs()).sum::<f64>();
    let mut x = vec![1.0 / n as f64; n];
    let mut bound: f64 = 0.0;
    for _ in 0..MAX_CLIMBS {
        let y = solve(&x)?;
        if size(&y) <= bound {
            break;
        }
        bound = size(&y);
        let signs: Vec<f64> = y.iter().map(|y| y.signum()).collect();
        let slope = solve(&signs)?;
        let steepest = (0..n).max_by(|&a, &b| slope[a].abs().total_cmp(&slope[b].abs()));
        let steepest = steepest.expect("the matrix has rows");
        if slope[steepest].abs() <= dot(&slope, &x) {
            break;
        }
        x.fill(0.0);
        x[steepest] = 1.0;
    }
    // A second estimate for matrices on which the climb fails.
    let alternating = (0..n).map(|row| {
        let sign = if row % 2 == 0 { 1.0 } else { -1.0 };
        sign * (1.0 + row as f64 / (n - 1).max(1) as f64)
    });
    let other = solve(&alternating.collect::<Vec<f64>>())?;
    Ok(bound.max(2.0 * size(&other) / (3 * n) as f64))
}

fn start(n: usize) -> Vec<f64> {
    let mut random = fastrand::Rng::with_seed(SEED);
    (0..n).map(|_| random.f64() - 0.5).collect()
}

fn failed(matrix: &Csr, problem: String) -> Error {
    not_found(matrix.n_rows(), problem)
}

fn not_found(n: usize, problem: String) -> Error {
    Error::input(
        format!("eigenvalues of a {n} x {n} matrix"),
        format!("did not converge: {problem}"),
        "the matrix must be symmetric and finite",
    )
}
