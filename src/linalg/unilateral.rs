//! Unilateral rows G v >= r of a system S v = f + G^T lambda, S symmetric positive definite, 0 <= lambda complementary to G v - r.
//!
//! With X = S^-1 G^T, the matrix W = G X is dense and small. Given f, lambda solves a complementarity problem of W. Where f depends on v, as
//! the force of a liquid does, rows are held as equations instead, and S^-1 becomes
//!
//! ```text
//! S^-1 f + X_F lambda_F,   W_FF lambda_F = r_F - G_F S^-1 f    (F: held rows)
//! ```
//!
//! A search changes the held rows until none pulls and no other is violated ([`RowSearch`]).
//!
//! A row with friction has two tangential rows, T v = t, with forces that Coulomb's law bounds: |tau| <= mu lambda, opposite to the slip T v - t
//! where it is not 0. The first tangent is the direction of the slip without friction. Friction is lagged: the forces lambda of one pass bound tau
//! in the next, by mu lambda along the first tangent and by what the disc leaves along the second. For given bounds a pass minimises
//! v S v / 2 - f v + sum of bound |T v - t|, so friction dissipates after any number of passes.

use rayon::prelude::*;

use super::complementarity::{Complementarity, DenseCholesky, PUSHING, Place, complementarity, relax};

/// Relative increase of the diagonal of W: redundant rows share their force.
const COMPLIANCE: f64 = 1e-11;
/// Violation of a row, and pull in terms of the velocity that it alone causes, relative to the largest velocity.
const TOLERANCE: f64 = 1e-6;
/// Solutions without fewer wrong rows that end a search.
const PATIENCE: u32 = 4;
/// Part of the diagonal of W that a row must keep beside others to be independent of them.
const INDEPENDENT: f64 = 1e-8;
/// Least response of the velocities that a search assumes.
const LEAST_RESPONSE: f64 = 1e-3;
/// Largest number of passes with the friction of the pass before.
const MOST_PASSES: u32 = 20;
/// Sweeps of the relaxation that replaces a pivoting that does not end.
const SWEEPS: u32 = 200;
/// Change of the bounds of friction in a pass, relative to the largest, that ends the passes.
const SAME_BOUNDS: f64 = 1e-8;
/// The same from a solve of a search to the next, relative to the bound itself.
const LAG: f64 = 5e-3;

/// A row: sum of the entries times v >= least.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Components and factors.
    pub entries: Vec<(usize, f64)>,
    /// r
    pub least: f64,
    /// Coulomb friction across the row; `None` without.
    pub friction: Option<Friction>,
}

/// Coulomb friction of a row.
#[derive(Clone, Debug, PartialEq)]
pub struct Friction {
    /// mu
    pub coefficient: f64,
    /// Two orthogonal tangents, each with its entries and t.
    pub tangents: [(Vec<(usize, f64)>, f64); 2],
}

impl Row {
    /// The row times v, less r.
    pub fn slack(&self, v: &[f64]) -> f64 {
        self.product(v) - self.least
    }

    fn product(&self, v: &[f64]) -> f64 {
        self.entries.iter().map(|&(at, n)| n * v[at]).sum()
    }

    /// The components of all entries, tangential ones too.
    pub fn components(&mut self) -> impl Iterator<Item = &mut usize> {
        let tangents = self.friction.iter_mut().flat_map(|friction| &mut friction.tangents);
        let entries = self.entries.iter_mut().chain(tangents.flat_map(|(entries, _)| entries));
        entries.map(|(at, _)| at)
    }
}

/// The normal row of a tangential one.
#[derive(Clone, Copy, Debug)]
struct Rubbing {
    normal: usize,
    coefficient: f64,
    /// The first tangent of the same row, where this is the second.
    first: Option<usize>,
}

/// Rows, X and W. Tangential rows follow all others.
#[derive(Debug)]
pub struct UnilateralRows {
    rows: Vec<Row>,
    /// Of the tangential rows.
    rubbing: Vec<Rubbing>,
    columns: Vec<Vec<f64>>,
    matrix: Vec<f64>,
    /// Components of v.
    size: usize,
}

impl UnilateralRows {
    /// Computes X and W. `solve`: S^-1 of n components, 0 where they are prescribed; rows of prescribed components alone cannot be met and are
    /// dropped.
    pub fn new(rows: Vec<Row>, size: usize, solve: impl Fn(Vec<f64>) -> Vec<f64> + Sync) -> UnilateralRows {
        let column = |row: &Row| {
            let mut force = vec![0.0; size];
            row.entries.iter().for_each(|&(at, n)| force[at] += n);
            solve(force)
        };
        let columns: Vec<Vec<f64>> = rows.par_iter().map(column).collect();
        let pairs = rows.into_iter().zip(columns);
        let (mut rows, mut columns): (Vec<Row>, Vec<Vec<f64>>) =
            pairs.filter(|(row, column)| row.product(column) > 0.0).unzip();
        let frictions = rows.iter_mut().enumerate().filter_map(|(normal, row)| Some((normal, row.friction.take()?)));
        let tangents = frictions.flat_map(|(normal, Friction { coefficient, tangents })| {
            tangents.map(|(entries, least)| (normal, coefficient, Row { entries, least, friction: None }))
        });
        let tangents: Vec<(usize, f64, Row)> = tangents.collect();
        let tangent_columns: Vec<Vec<f64>> = tangents.par_iter().map(|(.., row)| column(row)).collect();
        let mut rubbing: Vec<Rubbing> = Vec::new();
        for ((normal, coefficient, row), column) in tangents.into_iter().zip(tangent_columns) {
            if row.product(&column) > 0.0 {
                let first = rubbing.last().filter(|last| last.normal == normal).map(|_| rows.len() - 1);
                rubbing.push(Rubbing { normal, coefficient, first });
                rows.push(row);
                columns.push(column);
            }
        }
        let n = rows.len();
        let mut matrix = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let entry = 0.5 * (rows[i].product(&columns[j]) + rows[j].product(&columns[i]));
                (matrix[n * i + j], matrix[n * j + i]) = (entry, entry);
            }
            matrix[n * i + i] *= 1.0 + COMPLIANCE;
        }
        UnilateralRows { rows, rubbing, columns, matrix, size }
    }

    fn n(&self) -> usize {
        self.rows.len()
    }

    /// G v - r.
    pub fn slacks(&self, v: &[f64]) -> Vec<f64> {
        self.rows.iter().map(|row| row.slack(v)).collect()
    }

    /// Number of rows that are not tangential.
    fn n_normal(&self) -> usize {
        self.rows.len() - self.rubbing.len()
    }

    /// The tangential rows with their normal ones.
    fn tangential(&self) -> impl Iterator<Item = (usize, &Rubbing)> {
        (self.n_normal()..).zip(&self.rubbing)
    }

    /// lambda for the velocities without it.
    pub fn solve(&self, v: &[f64]) -> Complementarity {
        self.solve_rubbing(1.0, &self.slacks(v))
    }

    /// lambda of the matrix theta W for slacks without lambda.
    fn solve_rubbing(&self, theta: f64, slacks: &[f64]) -> Complementarity {
        let n = self.n();
        let matrix = |i: usize, j: usize| theta * self.matrix[n * i + j];
        let mut bounds = vec![PUSHING; n];
        bounds[self.n_normal()..].fill([0.0; 2]);
        let mut found = complementarity(matrix, slacks, &bounds, None);
        let mut before = vec![0.0; n];
        for pass in 0..MOST_PASSES {
            let most = self
                .friction_bounds(&found.z, |tangent| found.places[tangent] != Place::Between && before[tangent] > 0.0);
            let changes = most.iter().zip(&before).map(|(now, before)| (now - before).abs());
            let [change, largest] = [changes.fold(0.0, f64::max), most.iter().copied().fold(0.0, f64::max)];
            if change <= SAME_BOUNDS * largest {
                break;
            }
            for (tangent, _) in self.tangential() {
                bounds[tangent] = [-most[tangent], most[tangent]];
            }
            let start = (pass > 0).then_some(found.places);
            let next = complementarity(matrix, slacks, &bounds, start);
            found = Complementarity { pivots: found.pivots + next.pivots, ..next };
            before = most;
        }
        if found.wrong > 0 {
            // Dependent rows in a wrong set may have any force. A relaxation from 0 lowers the energy in each sweep.
            found.z.fill(0.0);
            for _ in 0..SWEEPS {
                let most = self.friction_bounds(&found.z, |_| false);
                for (tangent, _) in self.tangential() {
                    bounds[tangent] = [-most[tangent], most[tangent]];
                }
                found.places = relax(&matrix, slacks, &bounds, &mut found.z);
            }
        }
        found
    }

    /// Bounds of the tangential forces for forces of a pass; 0 for rows that are not tangential. `slips`: whether the force of a tangent is at
    /// its bound.
    fn friction_bounds(&self, lambda: &[f64], slips: impl Fn(usize) -> bool) -> Vec<f64> {
        let mut most = vec![0.0; self.n()];
        for (tangent, rubbing) in self.tangential() {
            let disc = rubbing.coefficient * lambda[rubbing.normal].max(0.0);
            most[tangent] = match rubbing.first {
                Some(first) if slips(first) => 0.0,
                Some(first) => (disc * disc - lambda[first] * lambda[first]).max(0.0).sqrt(),
                None => disc,
            };
        }
        most
    }

    /// W lambda.
    fn products(&self, lambda: &[f64]) -> Vec<f64> {
        let rows = self.matrix.chunks_exact(self.n().max(1));
        rows.map(|row| row.iter().zip(lambda).map(|(w, l)| w * l).sum()).collect()
    }

    /// Independent rows among those with a force between its bounds: those that cause the largest velocities first.
    fn basis(&self, Complementarity { z, places, .. }: &Complementarity) -> Vec<bool> {
        let n = self.n();
        let velocity = |i: usize| z[i].abs() * self.matrix[n * i + i];
        let mut rows: Vec<usize> = (0..n).filter(|&i| z[i] != 0.0 && places[i] == Place::Between).collect();
        rows.sort_by(|&a, &b| velocity(b).total_cmp(&velocity(a)));
        let mut held = vec![false; n];
        // Rows of the Cholesky factor of what is held.
        let mut factor: Vec<(usize, Vec<f64>)> = Vec::new();
        for row in rows {
            let mut parts: Vec<f64> = Vec::new();
            for (other, of_other) in &factor {
                let known = of_other.iter().zip(&parts).map(|(a, b)| a * b).sum::<f64>();
                parts.push((self.matrix[n * row + other] - known) / of_other[parts.len()]);
            }
            let own = self.matrix[n * row + row];
            let left = own - parts.iter().map(|part| part * part).sum::<f64>();
            if left > INDEPENDENT * own {
                parts.push(left.sqrt());
                factor.push((row, parts));
                held[row] = true;
            }
        }
        held
    }

    /// G^T lambda.
    pub fn forces(&self, lambda: &[f64]) -> Vec<f64> {
        let mut forces = vec![0.0; self.size];
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

/// The search for the rows to hold where f depends on v. It alternates with solves that hold rows as equations.
///
/// The rows to hold next are those that push in the complementarity problem of theta W at the last solution: theta is the response of v to lambda
/// over that without the dependence, from the last solution and that without lambda. So dependent rows are not held together.
///
/// Tangential rows that stick are held too. Those that slip have the force of their bound.
#[derive(Clone, Debug)]
pub struct RowSearch {
    held: Vec<bool>,
    /// lambda of the rows that slip, 0 of others; empty where none slips.
    slipping: Vec<f64>,
    /// G v - r without lambda.
    free: Vec<f64>,
    fewest: usize,
    patience: u32,
}

impl RowSearch {
    /// Begins with the rows that push, for the velocities without lambda and with the forces at hand.
    pub fn new(system: &UnilateralRows, v: &[f64]) -> RowSearch {
        let first = system.solve(v);
        RowSearch {
            held: system.basis(&first),
            slipping: slipping(&first),
            free: system.slacks(v),
            fewest: usize::MAX,
            patience: PATIENCE,
        }
    }

    /// Rows that are held.
    pub fn held(&self) -> &[bool] {
        &self.held
    }

    /// G^T lambda of the rows that slip, part of f in the next solve; `None` where none slips.
    pub fn slipping_forces(&self, system: &UnilateralRows) -> Option<Vec<f64>> {
        (!self.slipping.is_empty()).then(|| system.forces(&self.slipping))
    }

    /// Changes the rows to hold after a solution with forces `lambda` of the held rows, and returns how many were wrong, and whether another solve
    /// is worth it. Rows that pull are wrong where no lambda >= 0 of the held rows has the same effect. After four solutions without fewer wrong
    /// rows the search ends.
    pub fn exchange(&mut self, system: &UnilateralRows, lambda: &[f64], v: &[f64]) -> (usize, bool) {
        let n = system.n();
        let mut lambda = lambda.to_vec();
        lambda.iter_mut().zip(&self.slipping).for_each(|(lambda, slipping)| *lambda += slipping);
        let lambda = &lambda[..];
        let tolerance = TOLERANCE * v.iter().fold(0.0, |most, v| f64::max(most, v.abs()));
        let slacks = system.slacks(v);
        let pulls = |i: usize| lambda[i] * system.matrix[n * i + i] < -tolerance;
        let n_normal = system.n_normal();
        let let_go = match (0..n_normal).any(|i| self.held[i] && pulls(i)) {
            true => self.not_pushing(system, lambda, tolerance),
            false => vec![false; n],
        };
        let wrong = |&i: &usize| match self.held[i] {
            true => let_go[i] && pulls(i),
            false => slacks[i] < -tolerance,
        };
        let most = system.friction_bounds(lambda, |tangent| !self.held[tangent]);
        let rubs_wrong = |&i: &usize| {
            let velocity = |force: f64| force * system.matrix[n * i + i];
            let beyond = lambda[i].abs() - most[i];
            let slips_on = slacks[i].abs() > tolerance;
            let allowed = f64::max(velocity(LAG * most[i]), tolerance);
            match self.held[i] {
                true => velocity(beyond) > allowed,
                false => slips_on && (velocity(beyond).abs() > allowed || lambda[i] * slacks[i] > 0.0),
            }
        };
        let wrong = (0..n_normal).filter(wrong).count() + (n_normal..n).filter(rubs_wrong).count();
        if wrong == 0 {
            return (0, false);
        }
        if wrong < self.fewest {
            self.fewest = wrong;
        } else {
            self.patience -= 1;
        }
        let dry = system.products(lambda);
        let changes = slacks.iter().zip(&self.free).map(|(now, free)| now - free);
        let work: f64 = lambda.iter().zip(changes).map(|(l, change)| l * change).sum();
        let all: f64 = lambda.iter().zip(&dry).map(|(l, w)| l * w).sum();
        let theta = (work / all).clamp(LEAST_RESPONSE, 1.0);
        let q = slacks.iter().zip(&dry).map(|(slack, w)| slack - theta * w);
        let q: Vec<f64> = q.collect();
        let found = system.solve_rubbing(theta, &q);
        let next = (system.basis(&found), slipping(&found));
        let changed = next.0 != self.held || next.1 != self.slipping;
        (self.held, self.slipping) = next;
        (wrong, changed && self.patience > 0)
    }

    /// Held rows without force in the lambda >= 0 of the held rows whose velocities are nearest to those of `lambda`; none where they are the same
    /// to a tolerance.
    fn not_pushing(&self, system: &UnilateralRows, lambda: &[f64], tolerance: f64) -> Vec<bool> {
        let n = system.n();
        let rows: Vec<usize> = (0..n).filter(|&i| self.held[i]).collect();
        let entry = |i: usize, j: usize| system.matrix[n * rows[i] + rows[j]];
        let wanted = system.products(lambda);
        let q: Vec<f64> = rows.iter().map(|&row| -wanted[row]).collect();
        let mut pushing = vec![0.0; n];
        let both_ways = [f64::NEG_INFINITY, f64::INFINITY];
        let bounds = rows.iter().map(|&row| if row < system.n_normal() { PUSHING } else { both_ways });
        let found = complementarity(entry, &q, &bounds.collect::<Vec<_>>(), None);
        rows.iter().zip(found.z).for_each(|(&row, z)| pushing[row] = z);
        let reached = system.products(&pushing);
        let off = rows.iter().map(|&row| (wanted[row] - reached[row]).abs());
        match off.fold(0.0, f64::max) > tolerance {
            true => pushing.iter().map(|z| *z == 0.0).collect(),
            false => vec![false; n],
        }
    }
}

/// Forces of the rows at bounds other than 0; empty where there are none.
fn slipping(found: &Complementarity) -> Vec<f64> {
    let forces = found.z.iter().zip(&found.places);
    let forces: Vec<f64> = forces.map(|(z, place)| if *place == Place::Between { 0.0 } else { *z }).collect();
    match forces.iter().any(|force| *force != 0.0) {
        true => forces,
        false => Vec::new(),
    }
}
