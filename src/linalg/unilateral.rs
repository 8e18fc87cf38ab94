//! Unilateral rows G v >= r of a system S v = f + G^T lambda, S symmetric positive definite, 0 <= lambda complementary to G v - r.
//!
//! With X = S^-1 G^T, the matrix W = G X is dense and small. Given f, lambda solves a complementarity problem of W. Where f depends on v, as
//! the force of a liquid does, rows are held as equations instead, and S^-1 becomes
//!
//! ```text
//! S^-1 f + X_F lambda_F,   W_FF lambda_F = r_F - G_F S^-1 f    (F: held rows)
//! ```
//!
//! A search exchanges rows that pull and rows that are violated until there are none ([`RowSearch`]).

use rayon::prelude::*;

use super::complementarity::{Complementarity, DenseCholesky, complementarity};

/// Relative increase of the diagonal of W: redundant rows share their force.
const COMPLIANCE: f64 = 1e-11;
/// Violation of a row, and pull in terms of the velocity that it alone causes, relative to the largest velocity.
const TOLERANCE: f64 = 1e-6;
/// Exchanges without fewer wrong rows, after which rows are held and no more let go.
const PATIENCE: u32 = 4;

/// A row: sum of the entries times v >= least.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Components and factors.
    pub entries: Vec<(usize, f64)>,
    /// r
    pub least: f64,
}

impl Row {
    /// The row times v, less r.
    pub fn slack(&self, v: &[f64]) -> f64 {
        self.product(v) - self.least
    }

    fn product(&self, v: &[f64]) -> f64 {
        self.entries.iter().map(|&(at, n)| n * v[at]).sum()
    }
}

/// Rows, X and W.
#[derive(Debug)]
pub struct UnilateralRows {
    rows: Vec<Row>,
    columns: Vec<Vec<f64>>,
    matrix: Vec<f64>,
}

impl UnilateralRows {
    /// Computes X and W. `solve`: S^-1 of n components, 0 where they are prescribed; rows of prescribed components alone cannot be met and are
    /// dropped.
    pub fn new(rows: Vec<Row>, n: usize, solve: impl Fn(Vec<f64>) -> Vec<f64> + Sync) -> UnilateralRows {
        let column = |row: &Row| {
            let mut force = vec![0.0; n];
            row.entries.iter().for_each(|&(at, n)| force[at] += n);
            solve(force)
        };
        let columns: Vec<Vec<f64>> = rows.par_iter().map(column).collect();
        let pairs = rows.into_iter().zip(columns);
        let (rows, columns): (Vec<Row>, Vec<Vec<f64>>) =
            pairs.filter(|(row, column)| row.product(column) > 0.0).unzip();
        let n = rows.len();
        let mut matrix = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let entry = 0.5 * (rows[i].product(&columns[j]) + rows[j].product(&columns[i]));
                (matrix[n * i + j], matrix[n * j + i]) = (entry, entry);
            }
            matrix[n * i + i] *= 1.0 + COMPLIANCE;
        }
        UnilateralRows { rows, columns, matrix }
    }

    fn n(&self) -> usize {
        self.rows.len()
    }

    /// G v - r.
    pub fn slacks(&self, v: &[f64]) -> Vec<f64> {
        self.rows.iter().map(|row| row.slack(v)).collect()
    }

    /// lambda for the velocities without it.
    pub fn solve(&self, v: &[f64]) -> Complementarity {
        let n = self.n();
        complementarity(|i, j| self.matrix[n * i + j], &self.slacks(v))
    }

    /// G^T lambda.
    pub fn forces(&self, lambda: &[f64]) -> Vec<f64> {
        let size = self.columns.first().map_or(0, Vec::len);
        let mut forces = vec![0.0; size];
        for (row, lambda) in self.rows.iter().zip(lambda) {
            for &(at, n) in &row.entries {
                forces[at] += lambda * n;
            }
        }
        forces
    }

    /// The rows as equations where `held`; `None` where they are dependent to rounding.
    pub fn hold(&self, held: &[bool]) -> Option<HeldRows<'_>> {
        let n = self.n();
        let rows: Vec<usize> = (0..n).filter(|&i| held[i]).collect();
        let entry = |i: usize, j: usize| self.matrix[n * rows[i] + rows[j]];
        let factor = DenseCholesky::new(rows.len(), entry)?;
        Some(HeldRows { system: self, rows, factor })
    }
}

/// Rows held as equations.
#[derive(Debug)]
pub struct HeldRows<'a> {
    system: &'a UnilateralRows,
    /// F, ascending.
    rows: Vec<usize>,
    /// Of W_FF.
    factor: DenseCholesky,
}

impl HeldRows<'_> {
    /// lambda of all rows that adds `changes` to G_F v.
    fn lambda(&self, mut changes: Vec<f64>) -> Vec<f64> {
        self.factor.solve(&mut changes);
        let mut lambda = vec![0.0; self.system.n()];
        let pairs = self.rows.iter().zip(changes);
        pairs.for_each(|(&row, value)| lambda[row] = value);
        lambda
    }

    /// lambda that meets the rows, for the velocities without it.
    pub fn meeting(&self, v: &[f64]) -> Vec<f64> {
        let rows = self.rows.iter();
        self.lambda(rows.map(|&row| -self.system.rows[row].slack(v)).collect())
    }

    /// lambda that cancels what forces change in the rows: -W_FF^-1 X_F^T f.
    pub fn cancelling(&self, forces: &[f64]) -> Vec<f64> {
        let dot = |column: &Vec<f64>| column.iter().zip(forces).map(|(x, f)| x * f).sum::<f64>();
        let rows = self.rows.iter();
        self.lambda(rows.map(|&row| -dot(&self.system.columns[row])).collect())
    }

    /// Adds X lambda.
    pub fn add_velocity(&self, lambda: &[f64], v: &mut [f64]) {
        for &row in &self.rows {
            let column = self.system.columns[row].iter();
            v.iter_mut().zip(column).for_each(|(v, x)| *v += lambda[row] * x);
        }
    }

    /// G^T lambda.
    pub fn forces(&self, lambda: &[f64]) -> Vec<f64> {
        self.system.forces(lambda)
    }

    /// X_F W_FF^-1 X_F^T among some components, times a factor, as a product of two matrices with a row per component and a column per held row.
    pub fn correction(&self, components: &[usize], factor: f64) -> [Vec<f64>; 2] {
        let n = self.rows.len();
        let columns = &self.system.columns;
        let left: Vec<f64> =
            (components.iter()).flat_map(|&at| self.rows.iter().map(move |&row| columns[row][at])).collect();
        let mut right = left.clone();
        for row in right.chunks_exact_mut(n.max(1)) {
            self.factor.solve(row);
            row.iter_mut().for_each(|value| *value *= factor);
        }
        [left, right]
    }
}

/// The search for the rows to hold.
#[derive(Clone, Debug)]
pub struct RowSearch {
    held: Vec<bool>,
    fewest: usize,
    patience: u32,
}

impl RowSearch {
    /// Begins with the rows that push, for the velocities without lambda and with the forces at hand.
    pub fn new(system: &UnilateralRows, v: &[f64]) -> RowSearch {
        let start = system.solve(v);
        RowSearch { held: start.z.iter().map(|&lambda| lambda > 0.0).collect(), fewest: usize::MAX, patience: PATIENCE }
    }

    /// Rows that are held.
    pub fn held(&self) -> &[bool] {
        &self.held
    }

    /// Exchanges the wrong rows of a solution and returns how many there were, and whether any was exchanged. Rows that pull are wrong where no
    /// lambda >= 0 of the held rows has the same force: dependent rows share it in any way. After four times without fewer wrong rows none is
    /// let go any more: then one may pull.
    pub fn exchange(&mut self, system: &UnilateralRows, lambda: &[f64], v: &[f64]) -> (usize, bool) {
        let n = system.n();
        let largest = v.iter().fold(0.0, |most, v| f64::max(most, v.abs()));
        let slacks = system.slacks(v);
        let pulls = |i: usize| lambda[i] * system.matrix[n * i + i] < -TOLERANCE * largest;
        let let_go = match (0..n).any(|i| self.held[i] && pulls(i)) {
            true => self.not_pushing(system, lambda, TOLERANCE * largest),
            false => vec![false; n],
        };
        let wrong = |&i: &usize| match self.held[i] {
            true => let_go[i] && pulls(i),
            false => slacks[i] < -TOLERANCE * largest,
        };
        let wrong: Vec<usize> = (0..n).filter(wrong).collect();
        if wrong.len() < self.fewest {
            self.fewest = wrong.len();
        } else {
            self.patience = self.patience.saturating_sub(1);
        }
        let mut exchanged = false;
        for &row in &wrong {
            if !self.held[row] || self.patience > 0 {
                self.held[row] = !self.held[row];
                exchanged = true;
            }
        }
        (wrong.len(), exchanged)
    }

    /// Held rows without force in the lambda >= 0 of the held rows whose velocities are nearest to those of `lambda`; none where they are the same
    /// to a tolerance.
    fn not_pushing(&self, system: &UnilateralRows, lambda: &[f64], tolerance: f64) -> Vec<bool> {
        let n = system.n();
        let rows: Vec<usize> = (0..n).filter(|&i| self.held[i]).collect();
        let entry = |i: usize, j: usize| system.matrix[n * rows[i] + rows[j]];
        let products = |of: &dyn Fn(usize) -> f64| -> Vec<f64> {
            let sum = |i: usize| (0..rows.len()).map(|j| entry(i, j) * of(j)).sum();
            (0..rows.len()).map(sum).collect()
        };
        let wanted = products(&|j| lambda[rows[j]]);
        let q: Vec<f64> = wanted.iter().map(|w| -w).collect();
        let pushing = complementarity(entry, &q).z;
        let reached = products(&|j| pushing[j]);
        let off = wanted.iter().zip(reached).map(|(a, b)| (a - b).abs());
        let mut without = vec![false; n];
        if off.fold(0.0, f64::max) > tolerance {
            let pairs = rows.iter().zip(pushing);
            pairs.for_each(|(&row, z)| without[row] = z == 0.0);
        }
        without
    }
}
