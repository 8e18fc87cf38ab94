//! Sparse Cholesky factorisations A = L L^T and A = L D L^T with approximate minimum degree ordering, by faer.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::ldlt::factor::LdltRegularization;
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::SparseColMatRef;
use faer::sparse::linalg::cholesky::{self, LdltRef, LltRef, SymmetricOrdering};
use faer::{Conj, MatMut, Par, Side};

use super::Csr;
use crate::Error;

/// One thread by default, so that factors do not depend on the number of threads.
const PAR: Par = Par::Seq;

/// Ordering and sparsity pattern of a factor, reusable for matrices with the same pattern.
#[derive(Debug)]
pub struct SymbolicCholesky {
    factor: cholesky::SymbolicCholesky<usize>,
    n_entries: usize,
}

impl SymbolicCholesky {
    /// Orders a symmetric matrix and computes the pattern of its factor. Only the pattern of the matrix matters.
    pub fn new(matrix: &Csr) -> Result<SymbolicCholesky, Error> {
        // By symmetry rows are columns, and the lower triangle by rows is the upper one by columns.
        let factor = cholesky::factorize_symbolic_cholesky(
            view(matrix).symbolic(),
            Side::Upper,
            SymmetricOrdering::Amd,
            Default::default(),
        )
        .map_err(|problem| failed(matrix, format!("cannot be ordered: {problem:?}")))?;
        Ok(SymbolicCholesky { factor, n_entries: matrix.n_entries() })
    }

    /// Number of stored entries of the factor; 8 bytes each.
    pub fn n_factor_entries(&self) -> usize {
        self.factor.len_val()
    }

    /// Factorises a symmetric positive definite matrix with the pattern given to [`SymbolicCholesky::new`].
    pub fn factorise(&self, matrix: &Csr) -> Result<Cholesky<'_>, Error> {
        self.factorise_on(matrix, PAR)
    }

    /// Factorises on all cores; the last bits depend on their number.
    pub fn factorise_in_parallel(&self, matrix: &Csr) -> Result<Cholesky<'_>, Error> {
        self.factorise_on(matrix, Par::rayon(0))
    }

    /// Factorises a quasi-definite matrix [A B; B^T -C], A and C positive definite, as L D L^T, which exists without
    /// pivoting for every ordering (Vanderbei 1995).
    pub fn factorise_quasi_definite(&self, matrix: &Csr) -> Result<QuasiDefinite<'_>, Error> {
        self.ensure_pattern(matrix);
        let mut values = vec![0.0; self.factor.len_val()];
        let scratch = self.factor.factorize_numeric_ldlt_scratch::<f64>(PAR, Default::default());
        self.factor
            .factorize_numeric_ldlt(
                &mut values,
                view(matrix),
                Side::Upper,
                LdltRegularization::default(),
                PAR,
                MemStack::new(&mut MemBuffer::new(scratch)),
                Default::default(),
            )
            .map_err(|problem| failed(matrix, format!("is singular: {problem:?}")))?;
        Ok(QuasiDefinite { symbolic: self, values })
    }

    fn ensure_pattern(&self, matrix: &Csr) {
        assert_eq!(matrix.n_entries(), self.n_entries, "the matrix has the pattern that was ordered");
    }

    fn factorise_on(&self, matrix: &Csr, par: Par) -> Result<Cholesky<'_>, Error> {
        self.ensure_pattern(matrix);
        let mut values = vec![0.0; self.factor.len_val()];
        let scratch = self.factor.factorize_numeric_llt_scratch::<f64>(par, Default::default());
        self.factor
            .factorize_numeric_llt(
                &mut values,
                view(matrix),
                Side::Upper,
                LltRegularization::default(),
                par,
                MemStack::new(&mut MemBuffer::new(scratch)),
                Default::default(),
            )
            .map_err(|problem| failed(matrix, format!("is not positive definite: {problem:?}")))?;
        Ok(Cholesky { symbolic: self, values })
    }
}

/// A numeric factor L.
#[derive(Debug)]
pub struct Cholesky<'a> {
    symbolic: &'a SymbolicCholesky,
    values: Vec<f64>,
}

impl Cholesky<'_> {
    /// Solves A x = b in place.
    pub fn solve(&self, x: &mut [f64]) {
        self.solve_columns(x, 1);
    }

    /// Solves for several right-hand sides, stored by columns.
    pub fn solve_columns(&self, x: &mut [f64], n_columns: usize) {
        let factor = &self.symbolic.factor;
        let scratch = factor.solve_in_place_scratch::<f64>(n_columns, PAR);
        let n = x.len() / n_columns;
        LltRef::new(factor, &self.values).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(x, n, n_columns),
            PAR,
            MemStack::new(&mut MemBuffer::new(scratch)),
        );
    }
}

/// A numeric factor of a quasi-definite matrix.
#[derive(Debug)]
pub struct QuasiDefinite<'a> {
    symbolic: &'a SymbolicCholesky,
    values: Vec<f64>,
}

impl QuasiDefinite<'_> {
    /// Solves A x = b in place.
    pub fn solve(&self, x: &mut [f64]) {
        let factor = &self.symbolic.factor;
        let scratch = factor.solve_in_place_scratch::<f64>(1, PAR);
        let n = x.len();
        LdltRef::new(factor, &self.values).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(x, n, 1),
            PAR,
            MemStack::new(&mut MemBuffer::new(scratch)),
        );
    }
}

fn view(matrix: &Csr) -> SparseColMatRef<'_, usize, f64> {
    assert_eq!(matrix.n_rows(), matrix.n_columns(), "a Cholesky factorisation needs a square matrix");
    matrix.transposed_view()
}

fn failed(matrix: &Csr, problem: String) -> Error {
    Error::input(
        format!("sparse Cholesky of a {0} x {0} matrix", matrix.n_rows()),
        problem,
        "the matrix must be symmetric positive definite and its factor must fit into memory",
    )
}
