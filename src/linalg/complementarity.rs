//! Linear complementarity problems in a box, with a symmetric positive definite dense matrix: lower <= z <= upper, W z + q >= 0 where z = lower,
//! <= 0 where z = upper, and 0 between.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::{factor, solve};
use faer::{Mat, MatMut, Par};

/// Full exchanges without fewer wrong unknowns before single ones.
const PATIENCE: u32 = 5;
/// Largest number of exchanges.
const MOST_PIVOTS: u32 = 500;
/// Rounding error of an unknown, relative to the largest.
const ROUNDING: f64 = 1e-12;
/// Bounds of an unknown that pushes and does not pull.
pub const PUSHING: [f64; 2] = [0.0, f64::INFINITY];

/// Place of an unknown in its box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// At the lower bound.
    Lower,
    /// Between the bounds: W z + q = 0.
    Between,
    /// At the upper bound.
    Upper,
}

/// Solution of a complementarity problem.
#[derive(Clone, Debug, PartialEq)]
pub struct Complementarity {
    /// z
    pub z: Vec<f64>,
    /// Places of z.
    pub places: Vec<Place>,
    /// Exchanges, each with a factorisation.
    pub pivots: u32,
    /// Unknowns outside their bounds or with a wrong sign of W z + q; 0 if solved.
    pub wrong: u32,
}

/// Solves the problem by block principal pivoting (Judice and Pires 1994): all wrong unknowns are exchanged at once, and the
/// last wrong one alone after five times without fewer of them, which ends. `matrix`: W(i, j); `start`: first places, else from the signs of q.
pub fn complementarity(
    matrix: impl Fn(usize, usize) -> f64,
    q: &[f64],
    bounds: &[[f64; 2]],
    start: Option<Vec<Place>>,
) -> Complementarity {
    let n = q.len();
    let scale: Vec<f64> = (0..n).map(|i| matrix(i, i).sqrt()).collect();
    let largest = (0..n).fold(0.0, |most, i| f64::max(most, q[i].abs() / scale[i]));
    let mut places =
        start.unwrap_or_else(|| q.iter().zip(bounds).map(|(q, bounds)| first_place(*q, *bounds)).collect());
    let (mut fewest, mut patience) = (n + 1, PATIENCE);
    for pivots in 1.. {
        let z = solution(&matrix, q, bounds, &places);
        let most = z.iter().fold(0.0, |most, z| f64::max(most, z.abs()));
        let right_place = |i: usize| {
            let [lower, upper] = bounds[i];
            if lower == upper {
                return Place::Lower;
            }
            let product = || (0..n).map(|j| matrix(i, j) * z[j]).sum::<f64>() + q[i];
            match places[i] {
                Place::Between if z[i] < lower - ROUNDING * most => Place::Lower,
                Place::Between if z[i] > upper + ROUNDING * most => Place::Upper,
                Place::Lower if product() < -ROUNDING * largest * scale[i] => Place::Between,
                Place::Upper if product() > ROUNDING * largest * scale[i] => Place::Between,
                place => place,
            }
        };
        let wrong: Vec<(usize, Place)> =
            (0..n).map(|i| (i, right_place(i))).filter(|&(i, place)| place != places[i]).collect();
        if wrong.is_empty() || pivots == MOST_PIVOTS {
            let z = z.into_iter().zip(bounds).map(|(z, [lower, upper])| z.max(*lower).min(*upper));
            return Complementarity { z: z.collect(), places, pivots, wrong: wrong.len() as u32 };
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
        for &(i, place) in &wrong[exchanged..] {
            places[i] = place;
        }
    }
    unreachable!("the last exchange returns")
}

/// A sweep of projected Gauss-Seidel, which never increases z W z / 2 + q z. Returns the places of z.
pub(super) fn relax(
    matrix: &impl Fn(usize, usize) -> f64,
    q: &[f64],
    bounds: &[[f64; 2]],
    z: &mut [f64],
) -> Vec<Place> {
    let rows = bounds.iter().enumerate().map(|(i, [lower, upper])| {
        let product: f64 = z.iter().enumerate().map(|(j, z)| matrix(i, j) * z).sum();
        z[i] = (z[i] - (product + q[i]) / matrix(i, i)).max(*lower).min(*upper);
        match (z[i] <= *lower, z[i] >= *upper) {
            (true, _) => Place::Lower,
            (_, true) => Place::Upper,
            _ => Place::Between,
        }
    });
    rows.collect()
}

/// The place of an unknown for z = 0.
fn first_place(q: f64, [lower, upper]: [f64; 2]) -> Place {
    match upper > 0.0 && (q < 0.0 || lower < 0.0) {
        true => Place::Between,
        false => Place::Lower,
    }
}

/// z with W z + q = 0 between the bounds.
fn solution(matrix: &impl Fn(usize, usize) -> f64, q: &[f64], bounds: &[[f64; 2]], places: &[Place]) -> Vec<f64> {
    let rows: Vec<usize> = (0..q.len()).filter(|&i| places[i] == Place::Between).collect();
    let fixed = places.iter().zip(bounds).map(|(place, [lower, upper])| match place {
        Place::Lower => *lower,
        Place::Between => 0.0,
        Place::Upper => *upper,
    });
    let mut z: Vec<f64> = fixed.collect();
    // Without a factor the rows are dependent to rounding; the caller's diagonal prevents that.
    if let Some(factor) = DenseCholesky::new(rows.len(), |i, j| matrix(rows[i], rows[j])) {
        let at_bounds: Vec<usize> = (0..q.len()).filter(|&j| z[j] != 0.0).collect();
        let rest = |&row: &usize| -q[row] - at_bounds.iter().map(|&j| matrix(row, j) * z[j]).sum::<f64>();
        let mut x: Vec<f64> = rows.iter().map(rest).collect();
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
