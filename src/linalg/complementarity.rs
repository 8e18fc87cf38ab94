//! Linear complementarity problems with a symmetric positive definite dense matrix: 0 <= z, 0 <= W z + q, z . (W z + q) = 0.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::{factor, solve};
use faer::{Mat, Par};

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
    let n = rows.len();
    let mut z = vec![0.0; q.len()];
    let mut w = Mat::from_fn(n, n, |i, j| matrix(rows[i], rows[j]));
    let mut x = Mat::from_fn(n, 1, |i, _| -q[rows[i]]);
    // One thread: results must not depend on their number.
    let scratch = factor::cholesky_in_place_scratch::<f64>(n, Par::Seq, Default::default());
    let mut memory = MemBuffer::new(scratch);
    let stack = MemStack::new(&mut memory);
    let factor = factor::cholesky_in_place(
        w.as_mut(),
        Default::default(),
        Par::Seq,
        stack,
        Default::default(),
    );
    // Without a factor the rows are dependent to rounding; the caller's diagonal prevents that.
    if factor.is_ok() {
        solve::solve_in_place(w.as_ref(), x.as_mut(), Par::Seq, stack);
        for (i, &row) in rows.iter().enumerate() {
            z[row] = x[(i, 0)];
        }
    }
    z
}
