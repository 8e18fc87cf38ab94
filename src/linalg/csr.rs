//! Sparse matrices in compressed rows.

use faer::Par;
use faer::sparse::linalg::matmul::sparse_sparse_matmul;
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use rayon::prelude::*;

use super::LinearOperator;
use crate::Error;

/// A sparse matrix in compressed rows, columns ascending, each entry stored once.
#[derive(Clone, Debug, PartialEq)]
pub struct Csr {
    n_columns: usize,
    /// Start of each row in `columns` and `values`; one more than there are rows.
    row_start: Vec<usize>,
    columns: Vec<usize>,
    values: Vec<f64>,
}

impl Csr {
    /// Builds a matrix from (row, column, value). Repeated entries are added in the given order; entries outside are an
    /// error.
    pub fn from_triplets(
        n_rows: usize,
        n_columns: usize,
        triplets: impl IntoIterator<Item = (usize, usize, f64)>,
    ) -> Result<Csr, Error> {
        let mut sorted: Vec<_> = triplets.into_iter().collect();
        if let Some((row, column, _)) = sorted.iter().find(|(row, column, _)| *row >= n_rows || *column >= n_columns) {
            return Err(Error::input(
                format!("matrix entry ({row}, {column})"),
                format!("lies outside the {n_rows} x {n_columns} matrix"),
                "give rows and columns from 0 to one less than the size",
            ));
        }
        // Stable, so that sums are bitwise reproducible.
        sorted.sort_by_key(|&(row, column, _)| (row, column));
        let mut matrix = Csr { n_columns, row_start: vec![0], columns: Vec::new(), values: Vec::new() };
        let mut entries = sorted.into_iter().peekable();
        for row in 0..n_rows {
            let start = matrix.columns.len();
            while let Some((_, column, value)) = entries.next_if(|entry| entry.0 == row) {
                if matrix.columns.len() > start && matrix.columns.last() == Some(&column) {
                    *matrix.values.last_mut().expect("there is one value per column") += value;
                } else {
                    matrix.columns.push(column);
                    matrix.values.push(value);
                }
            }
            matrix.row_start.push(matrix.columns.len());
        }
        Ok(matrix)
    }

    /// Builds a matrix by rows; `fill` pushes the entries of a row with ascending columns.
    pub fn from_rows(n_rows: usize, n_columns: usize, mut fill: impl FnMut(usize, &mut Vec<(usize, f64)>)) -> Csr {
        let mut matrix = Csr { n_columns, row_start: vec![0], columns: Vec::new(), values: Vec::new() };
        let mut entries = Vec::new();
        for row in 0..n_rows {
            entries.clear();
            fill(row, &mut entries);
            assert!(
                entries.windows(2).all(|pair| pair[0].0 < pair[1].0) && entries.last().is_none_or(|e| e.0 < n_columns),
                "columns of row {row} ascend and lie inside the matrix"
            );
            matrix.columns.extend(entries.iter().map(|e| e.0));
            matrix.values.extend(entries.iter().map(|e| e.1));
            matrix.row_start.push(matrix.columns.len());
        }
        matrix
    }

    /// Number of rows.
    pub fn n_rows(&self) -> usize {
        self.row_start.len() - 1
    }

    /// Number of columns.
    pub fn n_columns(&self) -> usize {
        self.n_columns
    }

    /// Number of stored entries.
    pub fn n_entries(&self) -> usize {
        self.values.len()
    }

    /// The (column, value) pairs of a row, columns ascending.
    pub fn row(&self, row: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.row_start[row]..self.row_start[row + 1];
        self.columns[range.clone()].iter().copied().zip(self.values[range].iter().copied())
    }

    /// All entries as (row, column, value), by rows.
    pub fn triplets(&self) -> impl Iterator<Item = (usize, usize, f64)> + '_ {
        (0..self.n_rows()).flat_map(|row| self.row(row).map(move |(column, value)| (row, column, value)))
    }

    /// The entry at a position; 0 if it is not stored.
    pub fn get(&self, row: usize, column: usize) -> f64 {
        let start = self.row_start[row];
        match self.columns[start..self.row_start[row + 1]].binary_search(&column) {
            Ok(at) => self.values[start + at],
            Err(_) => 0.0,
        }
    }

    /// y = A x.
    pub fn multiply(&self, x: &[f64], y: &mut [f64]) {
        assert_eq!(x.len(), self.n_columns, "x has one entry per column");
        assert_eq!(y.len(), self.n_rows(), "y has one entry per row");
        y.par_iter_mut().with_min_len(4096).enumerate().for_each(|(row, out)| {
            *out = self.row(row).map(|(column, value)| value * x[column]).sum();
        });
    }

    /// The diagonal.
    pub fn diagonal(&self) -> Vec<f64> {
        (0..self.n_rows()).map(|row| self.get(row, row)).collect()
    }

    /// The transpose.
    pub fn transpose(&self) -> Csr {
        let entries = self.triplets().map(|(row, column, value)| (column, row, value));
        Csr::from_triplets(self.n_columns, self.n_rows(), entries).expect("places of a matrix lie inside its transpose")
    }

    /// The product A B; an error if it does not fit into memory.
    pub fn product(&self, other: &Csr) -> Result<Csr, Error> {
        // By columns each array is the transpose, and (A B)^T = B^T A^T.
        let (left, right) = (other.transposed_view(), self.transposed_view());
        let product = sparse_sparse_matmul(left, right, 1.0, Par::Seq).map_err(|problem| {
            let what = format!("the product of sparse matrices with {} rows", self.n_rows());
            Error::input(what, format!("{problem:?}"), "use a smaller system")
        })?;
        Ok(Csr {
            n_columns: other.n_columns,
            row_start: product.col_ptr().to_vec(),
            columns: product.row_idx().to_vec(),
            values: product.val().to_vec(),
        })
    }

    /// A + factor B.
    pub fn plus(&self, factor: f64, other: &Csr) -> Csr {
        assert_eq!(
            [self.n_rows(), self.n_columns],
            [other.n_rows(), other.n_columns],
            "both matrices of a sum have one size"
        );
        Csr::from_rows(self.n_rows(), self.n_columns, |row, entries| {
            entries.extend(self.row(row));
            entries.extend(other.row(row).map(|(column, value)| (column, factor * value)));
            entries.sort_by_key(|entry| entry.0);
            entries.dedup_by(|next, kept| {
                let same = next.0 == kept.0;
                kept.1 += if same { next.1 } else { 0.0 };
                same
            });
        })
    }

    /// diag(left) A diag(right).
    pub fn scaled(mut self, left: &[f64], right: &[f64]) -> Csr {
        assert_eq!(left.len(), self.n_rows(), "there is a factor per row");
        assert_eq!(right.len(), self.n_columns, "there is a factor per column");
        for (row, left) in left.iter().enumerate() {
            for at in self.row_start[row]..self.row_start[row + 1] {
                self.values[at] *= left * right[self.columns[at]];
            }
        }
        self
    }

    /// [A B; B^T D] from A, B and D; `sign` multiplies D.
    pub fn bordered(a: &Csr, b: &Csr, sign: f64, d: &Csr) -> Csr {
        let (n, m) = (a.n_rows(), d.n_rows());
        assert_eq!([n, m], [b.n_rows(), b.n_columns], "the blocks fit");
        let transposed = b.transpose();
        Csr::from_rows(n + m, n + m, |row, entries| match row.checked_sub(n) {
            None => {
                entries.extend(a.row(row));
                entries.extend(b.row(row).map(|(column, value)| (n + column, value)));
            }
            Some(below) => {
                entries.extend(transposed.row(below));
                entries.extend(d.row(below).map(|(column, value)| (n + column, sign * value)));
            }
        })
    }

    /// A diagonal matrix.
    pub fn diagonal_of(values: &[f64]) -> Csr {
        Csr::from_rows(values.len(), values.len(), |row, entries| entries.push((row, values[row])))
    }

    /// Square root of the sum of squared entries.
    pub fn frobenius_norm(&self) -> f64 {
        super::norm(&self.values)
    }

    /// Largest sum of absolute values of a row.
    pub fn infinity_norm(&self) -> f64 {
        (0..self.n_rows()).map(|row| self.row(row).map(|(_, value)| value.abs()).sum()).fold(0.0, f64::max)
    }

    /// Largest |a_ij - a_ji|; 0 for a symmetric matrix.
    pub fn asymmetry(&self) -> f64 {
        assert_eq!(self.n_rows(), self.n_columns, "only a square matrix can be symmetric");
        self.triplets().map(|(row, column, value)| (value - self.get(column, row)).abs()).fold(0.0, f64::max)
    }

    /// The transpose by columns, for faer: the same arrays.
    pub(super) fn transposed_view(&self) -> SparseColMatRef<'_, usize, f64> {
        let (n_rows, n_columns) = (self.n_columns, self.n_rows());
        SparseColMatRef::new(
            SymbolicSparseColMatRef::new_checked(n_rows, n_columns, &self.row_start, None, &self.columns),
            &self.values,
        )
    }
}

impl LinearOperator for Csr {
    fn size(&self) -> usize {
        self.n_rows()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.multiply(x, y);
    }
}
