//! Linear algebra in f64 on the CPU: sparse matrices, Cholesky, incomplete factors, Krylov methods, extreme eigenvalues,
//! complementarity problems, unilateral rows, Matrix Market. The only room that uses faer.

mod cholesky;
mod complementarity;
mod conjugate_gradient;
mod csr;
mod eigenvalues;
mod incomplete;
mod matrix_market;
mod minimal_residual;
mod unilateral;

pub use cholesky::{Cholesky, QuasiDefinite, SymbolicCholesky};
pub use complementarity::{Complementarity, DenseCholesky, PUSHING, Place, complementarity};
pub use conjugate_gradient::{
    CgEnd, CgReport, LinearOperator, conjugate_gradient, conjugate_gradient_with_test, stabilised_biconjugate_gradient,
};
pub use csr::Csr;
pub use eigenvalues::{Solve, eigenvalues, inverse_one_norm, largest_magnitude, smallest_magnitude};
pub use incomplete::Incomplete;
pub use matrix_market::{Symmetry, matrix_text, read_matrix, read_vector, vector_text};
pub use minimal_residual::minimal_residual;
pub use unilateral::{ForceSearch, Friction, HeldRows, Row, RowSearch, UnilateralRows};

/// Euclidean norm, summed in order, independent of the number of threads.
pub fn norm(x: &[f64]) -> f64 {
    x.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Scalar product, summed in order.
pub fn dot(x: &[f64], y: &[f64]) -> f64 {
    assert_eq!(x.len(), y.len(), "both vectors of a dot product have one length");
    x.iter().zip(y).map(|(a, b)| a * b).sum()
}
