//! Sparse linear algebra in f64 on the CPU: matrices, Cholesky, incomplete factors, conjugate gradients,
//! minimal residuals, extreme eigenvalues, Matrix Market. faer lives here only.

mod cholesky;
mod conjugate_gradient;
mod csr;
mod eigenvalues;
mod incomplete;
mod matrix_market;
mod minimal_residual;

pub use cholesky::{Cholesky, QuasiDefinite, SymbolicCholesky};
pub use conjugate_gradient::{
    CgEnd, CgReport, LinearOperator, conjugate_gradient, judged_conjugate_gradient,
    stabilised_biconjugate_gradient,
};
pub use csr::Csr;
pub use eigenvalues::{
    Solve, eigenvalues, inverse_one_norm, largest_magnitude, smallest_magnitude,
};
pub use incomplete::Incomplete;
pub use matrix_market::{Symmetry, matrix_text, read_matrix, read_vector, vector_text};
pub use minimal_residual::minimal_residual;

/// Euclidean norm, summed in order, so that it does not depend on the number of threads.
pub fn norm(x: &[f64]) -> f64 {
    x.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Sum of products, in order.
pub fn dot(x: &[f64], y: &[f64]) -> f64 {
    assert_eq!(
        x.len(),
        y.len(),
        "both vectors of a dot product have one length"
    );
    x.iter().zip(y).map(|(a, b)| a * b).sum()
}
