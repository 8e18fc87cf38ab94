//! Extreme eigenvalues of symmetric matrices: the largest magnitude by Lanczos's method with restarts, by faer, the smallest by inverse
//! iteration.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::matrix_free::eigen::{self, PartialEigenParams};
use faer::{ColRef, Mat, Par, Side};

use super::conjugate_gradient::Wrapped;
use super::{Csr, norm};
use crate::Error;

/// Up to so many rows all eigenvalues are computed, since faer's subspace has to be smaller than the matrix.
const DENSE: usize = 128;
/// Of the eigenvalue.
const TOLERANCE: f64 = 1e-4;
const MOST_RESTARTS: usize = 100;
const MOST_SOLVES: usize = 200;
/// Of the vectors that both methods start from.
const SEED: u64 = 62;

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
pub fn smallest_magnitude(
    n: usize,
    solve: &mut dyn FnMut(&[f64]) -> Result<Vec<f64>, Error>,
) -> Result<f64, Error> {
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
