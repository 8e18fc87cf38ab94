//! Linear complementarity problems with a symmetric positive definite dense matrix: 0 <= z, 0 <= W z + q, z . (W z + q) = 0.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::{factor, solve};
use faer::{Mat, MatMut, Par};

/// Full exchanges without fewer wrong unknowns before single ones.
const PATIENCE: u32 = 5;
/// Largest number of exchanges.
const MOST_PIVOTS: u32 = 500;
/// Rounding error of an unknown, relative to the largest.
const ROUNDING: f64 = 1e-12;

/// Solution of a complementarity problem.
#[derive(Clone, Debug, PartialEq)]
pub struct Complementarity {
    /// z
    pub z: Vec<f64>,
    /// Exchanges, each with a factorisation.
    pub pivots: u32,
    /// Unknowns with a wrong sign of z or of W z + q; 0 if solved.
    pub wrong: u32,
}

/// Solves the problem by block principal pivoting (Judice and Pires 1994): all wrong unknowns are exchanged at once, and the
/// last wrong one alone after five times without fewer of them, which ends. `matrix`: W(i, j).
pub fn complementarity(matrix: impl Fn(usize, usize) -> f64, q: &[f64]) -> Complementarity {
    let n = q.len();
    let scale: Vec<f64> = (0..n).map(|i| matrix(i, i).sqrt()).collect();
    let largest = (0..n).fold(0.0, |most, i| f64::max(most, q[i].abs() / scale[i]));
    let mut held: Vec<bool> = q.iter().map(|&q| q < 0.0).collect();
    let (mut fewest, mut patience) = (n + 1, PATIENCE);
    for pivots in 1.. {
        let z = held_solution(&matrix, q, &held);
        let most = z.iter().fold(0.0, |most, z| f64::max(most, z.abs()));
        let wrong = |i: usize| match held[i] {
            true => z[i] < -ROUNDING * most,
            false => {
                let sum: f64 = (0..n).map(|j| matrix(i, j) * z[j]).sum();
                sum + q[i] < -ROUNDING * largest * scale[i]
            }
        };
        let wrong: Vec<usize> = (0..n).filter(|&i| wrong(i)).collect();
        if wrong.is_empty() || pivots == MOST_PIVOTS {
            return Complementarity {
                z: z.into_iter().map(|z| z.max(0.0)).collect(),
                pivots,
                wrong: wrong.len() as u32,
            };
        }
        let all = match wrong.len() < fewest {
            true => {
                (fewest, patience) = (wrong.len(), PATIENCE);
                true
            }
            false => {
                let all = patience > 0;
                patience = patience.saturating_sub(1);
                all
            }
        };
        let exchanged = if all { 0 } else { wrong.len() - 1 };
        for &i in &wrong[exchanged..] {
            held[i] = !held[i];
        }
    }
    unreachable!("the last exchange returns")
}

/// z with W z + q = 0 where `held`, else 0.
fn held_solution(matrix: &impl Fn(usize, usize) -> f64, q: &[f64], held: &[bool]) -> Vec<f64> {
    let rows: Vec<usize> = (0..q.len()).filter(|&i| held[i]).collect();
    let mut z = vec![0.0; q.len()];
    // Without a factor the rows are dependent to rounding; the caller's diagonal prevents that.
    if let Some(factor) = DenseCholesky::new(rows.len(), |i, j| matrix(rows[i], rows[j])) {
        let mut x: Vec<f64> = rows.iter().map(|&row| -q[row]).collect();
        factor.solve(&mut x);
        rows.iter().zip(x).for_each(|(&row, x)| z[row] = x);
    }
    z
}

/// Relative increases of the diagonal, from small to large, of a matrix that rounding leaves without a factor.
const SHIFTS: [f64; 6] = [0.0, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7];

/// Factor of a small dense matrix. One thread: results must not depend on their number.
#[derive(Clone, Debug)]
pub struct DenseCholesky(Mat<f64>);

impl DenseCholesky {
    /// Factorises an n x n matrix, which rounding may have made singular; `None` where it is far from positive definite.
    pub fn new(n: usize, entry: impl Fn(usize, usize) -> f64) -> Option<DenseCholesky> {
        let mut shifts = SHIFTS.into_iter();
        shifts.find_map(|shift| DenseCholesky::shifted(n, shift, &entry))
    }

    fn shifted(n: usize, shift: f64, entry: impl Fn(usize, usize) -> f64) -> Option<DenseCholesky> {
        let grown = |i: usize, j: usize| entry(i, j) * if i == j { 1.0 + shift } else { 1.0 };
        let mut matrix = Mat::from_fn(n, n, grown);
        let scratch = factor::cholesky_in_place_scratch::<f64>(n, Par::Seq, Default::default());
        let factor = factor::cholesky_in_place(
            matrix.as_mut(),
            Default::default(),
            Par::Seq,
            MemStack::new(&mut MemBuffer::new(scratch)),
            Default::default(),
        );
        factor.ok().map(|_| DenseCholesky(matrix))
    }

    /// Solves A x = b in place.
    pub fn solve(&self, x: &mut [f64]) {
        let n = x.len();
        let scratch = solve::solve_in_place_scratch::<f64>(n, 1, Par::Seq);
        solve::solve_in_place(
            self.0.as_ref(),
            MatMut::from_column_major_slice_mut(x, n, 1),
            Par::Seq,
            MemStack::new(&mut MemBuffer::new(scratch)),
        );
    }
}
