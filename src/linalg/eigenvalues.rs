//! Extreme eigenvalues of symmetric matrices: the largest magnitude by Lanczos's method with restarts, by faer, the smallest by inverse
//! iteration. And what 1-norms of inverses are at least.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::matrix_free::eigen::{self, PartialEigenParams};
use faer::{ColRef, Mat, Par, Side};

use super::conjugate_gradient::Wrapped;
use super::{Csr, dot, norm};
use crate::Error;

/// Up to so many rows all eigenvalues are computed, since faer's subspace has to be smaller than the matrix.
const DENSE: usize = 128;
/// Of the eigenvalue.
const TOLERANCE: f64 = 1e-4;
const MOST_RESTARTS: usize = 100;
const MOST_SOLVES: usize = 200;
/// Of the estimate of a 1-norm.
const MOST_CLIMBS: usize = 5;
/// Of the vectors that both methods start from.
const SEED: u64 = 62;

/// x = A^-1 b from b.
pub type Solve<'a> = &'a mut dyn FnMut(&[f64]) -> Result<Vec<f64>, Error>;

/// All eigenvalues of a symmetric matrix, ascending, without making use of its zeros.
///
/// # Errors
/// When the iteration does not converge.
pub fn eigenvalues(matrix: &Csr) -> Result<Vec<f64>, Error> {
    let n = matrix.n_rows();
    let mut dense = Mat::zeros(n, n);
    for (row, column, value) in matrix.triplets() {
        dense[(row, column)] = value;
    }
    let found = dense.self_adjoint_eigenvalues(Side::Lower);
    found.map_err(|problem| failed(matrix, format!("{problem:?}")))
}

/// The largest magnitude of the eigenvalues of a symmetric matrix, to some 1e-4 of it.
///
/// # Errors
/// When the iteration does not converge.
pub fn largest_magnitude(matrix: &Csr) -> Result<f64, Error> {
    let n = matrix.n_rows();
    if n <= DENSE {
        let all = eigenvalues(matrix)?.into_iter();
        return Ok(all.fold(0.0, |most, value| f64::max(most, value.abs())));
    }
    // faer's tolerance is of the residual itself: no eigenvalue is larger than this norm.
    let scale = matrix.infinity_norm();
    let scaled = matrix.clone().scaled(&vec![1.0 / scale; n], &vec![1.0; n]);
    let params = PartialEigenParams {
        max_restarts: MOST_RESTARTS,
        ..PartialEigenParams::default()
    };
    let operator = Wrapped(&scaled);
    let scratch = eigen::partial_self_adjoint_eigen_scratch(&operator, 1, Par::Seq, params);
    let mut vector = Mat::zeros(n, 1);
    let mut value = [0.0];
    let found = eigen::partial_self_adjoint_eigen(
        vector.as_mut(),
        &mut value,
        &operator,
        ColRef::from_slice(&start(n)),
        TOLERANCE,
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(scratch)),
        params,
    );
    match found.n_converged_eigen {
        0 => Err(failed(matrix, format!("{MOST_RESTARTS} restarts"))),
        _ => Ok(scale * value[0].abs()),
    }
}

/// The smallest magnitude of the eigenvalues of a symmetric matrix of n rows, from `solve`, which solves with it: 1 / |A^-1 x| for the x
/// that inverse iteration comes to, which is from above, until it changes by no more than 1e-4 of itself from one solve to the next.
///
/// # Errors
/// As `solve`, and when the iteration does not converge.
pub fn smallest_magnitude(n: usize, solve: Solve) -> Result<f64, Error> {
    let mut x = start(n);
    let size = norm(&x);
    x.iter_mut().for_each(|x| *x /= size);
    let mut before = 0.0;
    for _ in 0..MOST_SOLVES {
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
    let problem = format!("inverse iteration took {MOST_SOLVES} solves or broke down");
    Err(not_found(n, problem))
}

/// A lower bound of the 1-norm of the inverse of a symmetric matrix of n rows, mostly the norm itself, from `solve`, which solves with it
/// (Hager 1984, Higham 1988: what MATLAB's `condest` does for one vector).
///
/// # Errors
/// As `solve`.
pub fn inverse_one_norm(n: usize, solve: Solve) -> Result<f64, Error> {
    let size = |x: &[f64]| x.iter().map(|x| x.abs()).sum::<f64>();
    let mut x = vec![1.0 / n as f64; n];
    let mut found: f64 = 0.0;
    for _ in 0..MOST_CLIMBS {
        let y = solve(&x)?;
        if size(&y) <= found {
            break;
        }
        found = size(&y);
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
    // What the climb may miss.
    let alternating = (0..n).map(|row| {
        let sign = if row % 2 == 0 { 1.0 } else { -1.0 };
        sign * (1.0 + row as f64 / (n - 1).max(1) as f64)
    });
    let other = solve(&alternating.collect::<Vec<f64>>())?;
    Ok(found.max(2.0 * size(&other) / (3 * n) as f64))
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
