//! Incomplete factorisations without fill, preconditioners with the memory of the matrix (Meijerink and van der Vorst 1977;
//! Saad, Iterative Methods for Sparse Linear Systems, algorithm 10.4).

use super::{Csr, LinearOperator};

/// First diagonal shift after a breakdown, doubled until the factorisation succeeds.
const FIRST_SHIFT: f64 = 1e-3;

/// Least pivot relative to its diagonal entry.
const LEAST_PIVOT: f64 = 1e-3;

/// Number of shifts; the last is about the diagonal itself.
const SHIFTS: i32 = 11;

/// A ~ L U with the pattern of A. For symmetric A, U = D L^T: this is IC(0) too.
#[derive(Clone, Debug)]
pub struct Incomplete {
    /// L below its unit diagonal; U on and above it.
    factor: Csr,
    inverse: Vec<f64>,
    /// Relative diagonal shift of A with which all pivots have the sign of their entry.
    pub shift: f64,
}

impl Incomplete {
    /// Factorises a square matrix with a fully stored diagonal.
    ///
    /// Every pivot must have the sign of its diagonal entry and a thousandth of its magnitude; else the diagonal is
    /// shifted. `None` if even a shift by the diagonal itself fails, or for a zero on the diagonal.
    pub fn new(matrix: &Csr) -> Option<Incomplete> {
        let raised = (0..SHIFTS).map(|n| FIRST_SHIFT * 2.0_f64.powi(n));
        let mut shifts = std::iter::once(0.0).chain(raised);
        shifts.find_map(|shift| Incomplete::shifted(matrix, shift))
    }

    fn shifted(matrix: &Csr, shift: f64) -> Option<Incomplete> {
        let n = matrix.n_rows();
        let mut rows: Vec<Vec<(usize, f64)>> = Vec::with_capacity(n);
        let mut inverse = Vec::with_capacity(n);
        // Index of each column's entry in the current row, plus one.
        let mut place = vec![0; n];
        for at in 0..n {
            let mut row: Vec<(usize, f64)> = matrix.row(at).collect();
            let diagonal = row.iter().position(|entry| entry.0 == at)?;
            let before = row[diagonal].1;
            row[diagonal].1 *= 1.0 + shift;
            for (number, entry) in row.iter().enumerate() {
                place[entry.0] = number + 1;
            }
            for lower in 0..diagonal {
                let column = row[lower].0;
                let multiplier = row[lower].1 * inverse[column];
                row[lower].1 = multiplier;
                let above: &Vec<(usize, f64)> = &rows[column];
                for &(other, value) in above.iter().filter(|entry| entry.0 > column) {
                    if let Some(number) = place[other].checked_sub(1_usize) {
                        row[number].1 -= multiplier * value;
                    }
                }
            }
            for entry in &row {
                place[entry.0] = 0;
            }
            let pivot: f64 = row[diagonal].1;
            if pivot * before.signum() <= LEAST_PIVOT * before.abs() || !pivot.is_finite() {
                return None;
            }
            inverse.push(1.0 / pivot);
            rows.push(row);
        }
        Some(Incomplete { factor: Csr::from_rows(n, n, |row, entries| entries.append(&mut rows[row])), inverse, shift })
    }
}

/// x = U^-1 L^-1 b.
impl LinearOperator for Incomplete {
    fn size(&self) -> usize {
        self.inverse.len()
    }

    fn apply(&self, b: &[f64], x: &mut [f64]) {
        for row in 0..b.len() {
            let lower = self.factor.row(row).take_while(|entry| entry.0 < row);
            x[row] = b[row] - lower.map(|(column, value)| value * x[column]).sum::<f64>();
        }
        for row in (0..b.len()).rev() {
            let upper = self.factor.row(row).filter(|entry| entry.0 > row);
            let sum: f64 = upper.map(|(column, value)| value * x[column]).sum();
            x[row] = (x[row] - sum) * self.inverse[row];
        }
    }
}
