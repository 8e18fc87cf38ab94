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
use super::dot;

/// Relative increase of the diagonal of W: redundant rows share their force.
const COMPLIANCE: f64 = 1e-11;
/// Violation of a row, and pull in terms of the velocity that it alone causes, relative to the largest velocity.
const TOLERANCE: f64 = 1e-6;
/// Solutions without fewer wrong rows that end a search.
const PATIENCE: u32 = 8;
/// Part of the diagonal of W that a row must keep beside others to be independent of them.
const INDEPENDENT: f64 = 1e-8;
/// Least and largest response of the velocities to a force that a search believes, over that without the dependence.
const LEAST_RESPONSE: f64 = 1e-3;
const MOST_RESPONSE: f64 = 1.01;
/// Largest number of passes with the friction of the pass before.
const MOST_PASSES: u32 = 20;
/// Relative increases of the diagonal with which pivoting is tried: with redundant rows it may not end.
const GROWTHS: [f64; 3] = [0.0, 1e-8, 1e-6];
/// Sweeps of the relaxation that replaces a pivoting that does not end.
const SWEEPS: u32 = 200;
/// Change of the bounds of friction in a pass, relative to the largest, that ends the passes.
const SAME_BOUNDS: f64 = 1e-8;
/// The same from a solve of a search to the next, relative to the bound itself.
const LAG: f64 = 5e-3;
/// Solves with the factor of W_FF: its rounding and the increase of its diagonal are multiplied by its condition number, up to 1e8.
const REFINEMENTS: usize = 3;
/// Differences between solves that a search for forces learns from, at most.
const MOST_FORCES: usize = 40;
/// Solves without gain that end the search for forces: the rest is rounding. A gain is a violation smaller by this factor.
const FORCE_PATIENCE: u32 = 6;
const GAIN: f64 = 0.99;
/// Part of a change between two solves that must be new to improve the next.
const NEW: f64 = 1e-8;

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

    /// Number of rows, tangential ones too.
    pub fn n(&self) -> usize {
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
        let slacks = self.slacks(v);
        let found = self.solve_rubbing(&self.matrix, &slacks);
        match found.wrong {
            0 => found,
            _ => self.relaxed(&slacks, found),
        }
    }

    /// lambda of a matrix in place of W, for slacks without lambda.
    fn solve_rubbing(&self, matrix: &[f64], slacks: &[f64]) -> Complementarity {
        let n = self.n();
        let mut pivots = 0;
        let mut tried = GROWTHS.into_iter().map(|growth| {
            let grown = |i: usize, j: usize| matrix[n * i + j] * if i == j { 1.0 + growth } else { 1.0 };
            let found = self.pivot_rubbing(grown, slacks);
            pivots += found.pivots;
            Complementarity { pivots, ..found }
        });
        let first = tried.next().expect("the matrix itself");
        match first.wrong {
            0 => first,
            _ => tried.find(|found| found.wrong == 0).unwrap_or(first),
        }
    }

    /// lambda by pivoting.
    fn pivot_rubbing(&self, matrix: impl Fn(usize, usize) -> f64 + Copy, slacks: &[f64]) -> Complementarity {
        let n = self.n();
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
        found
    }

    /// lambda by a relaxation from 0, which lowers the energy in each sweep: after a pivoting that did not end, dependent rows may have any force.
    fn relaxed(&self, slacks: &[f64], pivoted: Complementarity) -> Complementarity {
        let n = self.n();
        let (mut z, mut places, mut bounds) = (vec![0.0; n], Vec::new(), vec![PUSHING; n]);
        for _ in 0..SWEEPS {
            let most = self.friction_bounds(&z, |_| false);
            for (tangent, _) in self.tangential() {
                bounds[tangent] = [-most[tangent], most[tangent]];
            }
            places = relax(&|i, j| self.matrix[n * i + j], slacks, &bounds, &mut z);
        }
        Complementarity { z, places, ..pivoted }
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
        products(&self.matrix, lambda)
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
        self.add_forces(lambda, &mut forces);
        forces
    }

    /// Adds G^T lambda.
    fn add_forces(&self, lambda: &[f64], forces: &mut [f64]) {
        for (row, lambda) in self.rows.iter().zip(lambda) {
            for &(at, n) in &row.entries {
                forces[at] += lambda * n;
            }
        }
    }

    /// Adds X lambda.
    pub fn add_velocity(&self, lambda: &[f64], v: &mut [f64]) {
        for (lambda, column) in lambda.iter().zip(&self.columns).filter(|(lambda, _)| **lambda != 0.0) {
            v.iter_mut().zip(column).for_each(|(v, x)| *v += lambda * x);
        }
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
        self.refined(
            v,
            |v| self.rows.iter().map(|&row| -self.system.rows[row].slack(v)).collect(),
            |lambda, v| self.add_velocity(lambda, v),
        )
    }

    /// lambda that cancels what forces change in the rows: -W_FF^-1 X_F^T f.
    pub fn cancelling(&self, forces: &[f64]) -> Vec<f64> {
        self.refined(
            forces,
            |f| self.rows.iter().map(|&row| -dot(&self.system.columns[row], f)).collect(),
            |lambda, f| self.system.add_forces(lambda, f),
        )
    }

    /// Iterative refinement of lambda, since rows of a stiff solid are nearly dependent. `changes`: change of G_F v that lambda must cause, for x;
    /// `add`: adds the effect of lambda to x.
    fn refined(&self, x: &[f64], changes: impl Fn(&[f64]) -> Vec<f64>, add: impl Fn(&[f64], &mut [f64])) -> Vec<f64> {
        let (mut sum, mut x) = (vec![0.0; self.system.n()], x.to_vec());
        for _ in 0..REFINEMENTS {
            let lambda = self.lambda(changes(&x));
            add(&lambda, &mut x);
            sum.iter_mut().zip(&lambda).for_each(|(sum, lambda)| *sum += lambda);
        }
        sum
    }

    /// Adds X lambda.
    pub fn add_velocity(&self, lambda: &[f64], v: &mut [f64]) {
        self.system.add_velocity(lambda, v);
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

/// The search for the forces of held rows where f depends on v in a way that only solves show.
///
/// The next forces are the combination of all before with the least residual, and those that would meet the rest without the dependence. That is
/// GMRES preconditioned with W_FF, in the norm of W, as Anderson mixing: H. F. Walker, P. Ni, SIAM Journal on Numerical Analysis 49, 2011.
#[derive(Debug)]
pub struct ForceSearch<'a> {
    rows: HeldRows<'a>,
    lambda: Vec<f64>,
    /// lambda of the last solve, and the lambda that it lacked without the dependence.
    last: Option<[Vec<f64>; 2]>,
    /// Differences of these between solves, the second orthonormal.
    differences: Vec<[Vec<f64>; 2]>,
    /// Least violation of a row so far, m/s.
    least: f64,
    patience: u32,
}

impl<'a> ForceSearch<'a> {
    /// Begins with the forces that meet the rows without the dependence, for the velocities without lambda.
    pub fn new(rows: HeldRows<'a>, v: &[f64]) -> ForceSearch<'a> {
        ForceSearch {
            lambda: rows.meeting(v),
            rows,
            last: None,
            differences: Vec::new(),
            least: f64::INFINITY,
            patience: FORCE_PATIENCE,
        }
    }

    /// lambda of all rows for the next solve, or of the last one.
    pub fn lambda(&self) -> &[f64] {
        &self.lambda
    }

    /// G^T lambda.
    pub fn forces(&self) -> Vec<f64> {
        self.rows.forces(&self.lambda)
    }

    /// Changes the forces after a solve to a relative `tolerance`; `false` where its velocities meet the rows, or the search ends without.
    pub fn advance(&mut self, v: &[f64], tolerance: f64) -> bool {
        let violation = self.violation(v);
        match violation < GAIN * self.least {
            true => self.patience = FORCE_PATIENCE,
            false => self.patience = self.patience.saturating_sub(1),
        }
        self.least = self.least.min(violation);
        // As many solves as rows know all of the dependence.
        let known = self.differences.len() > self.rows.rows.len().min(MOST_FORCES);
        let met = violation <= f64::max(TOLERANCE, tolerance) * largest(v);
        if met || known || self.patience == 0 {
            return false;
        }
        let system = self.rows.system;
        let lacking = self.rows.meeting(v);
        let add = |to: &mut [f64], factor: f64, x: &[f64]| to.iter_mut().zip(x).for_each(|(to, x)| *to += factor * x);
        if let Some(last) = &self.last {
            let mut new = [self.lambda.clone(), lacking.clone()];
            new.iter_mut().zip(last).for_each(|(new, last)| add(new, -1.0, last));
            let norm = |lacking: &[f64]| dot(lacking, &system.products(lacking)).sqrt();
            let before = norm(&new[1]);
            for old in &self.differences {
                let part = dot(&old[1], &system.products(&new[1]));
                new.iter_mut().zip(old).for_each(|(new, old)| add(new, -part, old));
            }
            let after = norm(&new[1]);
            let is_new = after > NEW * before;
            if !is_new {
                return false;
            }
            new.iter_mut().flatten().for_each(|value| *value /= after);
            self.differences.push(new);
        }
        self.last = Some([self.lambda.clone(), lacking.clone()]);
        let mut rest = lacking;
        for [forces, lack] in &self.differences {
            let part = dot(lack, &system.products(&rest));
            add(&mut rest, -part, lack);
            add(&mut self.lambda, -part, forces);
        }
        add(&mut self.lambda, 1.0, &rest);
        true
    }

    /// Rows that velocities do not meet.
    pub fn violated(&self, v: &[f64], tolerance: f64) -> usize {
        let most = f64::max(TOLERANCE, tolerance) * largest(v);
        let met = |violation: &f64| *violation <= most;
        self.violations(v).filter(|violation| !met(violation)).count()
    }

    fn violations(&self, v: &[f64]) -> impl Iterator<Item = f64> {
        self.rows.rows.iter().map(|&row| self.rows.system.rows[row].slack(v).abs())
    }

    fn violation(&self, v: &[f64]) -> f64 {
        self.violations(v).fold(0.0, f64::max)
    }
}

/// The search for the rows to hold where f depends on v. It alternates with solves that hold rows as equations.
///
/// The rows to hold next push in the complementarity problem of the response of v to lambda, which the search learns from its solutions. So dependent
/// rows are not held together.
///
/// Tangential rows that stick are held too. Those that slip have the force of their bound.
#[derive(Clone, Debug)]
pub struct RowSearch {
    held: Vec<bool>,
    /// lambda of the rows that slip, 0 of others; empty where none slips.
    slipping: Vec<f64>,
    /// lambda and G v - r of the last solution with the same f, at first that without lambda.
    last: Option<[Vec<f64>; 2]>,
    /// The matrix in place of W: change of G v by lambda, learned from the solutions; empty before the first with lambda.
    response: Vec<f64>,
    fewest: usize,
    patience: u32,
    /// Best set since the start or the last change of f; none where a solution met all rows.
    best: Option<BestSet>,
    /// Whether the last solution is that of the best set.
    best_is_last: bool,
}

/// Held rows whose solution missed the rows least.
#[derive(Clone, Debug)]
struct BestSet {
    held: Vec<bool>,
    slipping: Vec<f64>,
    /// Rows that are wrong.
    wrong: usize,
    /// Largest velocity by which one is: a violation, or what a pull or a friction beyond its bound causes alone.
    velocity: f64,
}

impl RowSearch {
    /// Begins with the rows that push, for the velocities without lambda and with the forces at hand.
    pub fn new(system: &UnilateralRows, v: &[f64]) -> RowSearch {
        let first = system.solve(v);
        RowSearch {
            held: system.basis(&first),
            slipping: slipping(&first),
            last: Some([vec![0.0; system.n()], system.slacks(v)]),
            response: Vec::new(),
            fewest: usize::MAX,
            patience: PATIENCE,
            best: None,
            best_is_last: false,
        }
    }

    /// Resumes after a change of f that lambda did not cause: earlier solutions no longer count.
    pub fn resume(&mut self) {
        (self.last, self.best) = (None, None);
        (self.fewest, self.patience) = (usize::MAX, PATIENCE);
    }

    /// Ends a search: returns to the best set, and returns how many rows its solution missed; `None` where it was the last.
    pub fn return_to_best(&mut self) -> Option<usize> {
        let best = self.best.take_if(|_| !self.best_is_last)?;
        (self.held, self.slipping) = (best.held, best.slipping);
        Some(best.wrong)
    }

    /// Rows that are held.
    pub fn held(&self) -> &[bool] {
        &self.held
    }

    /// lambda of the rows that slip; empty where none slips.
    pub fn slipping(&self) -> &[f64] {
        &self.slipping
    }

    /// G^T lambda of the rows that slip, part of f in the next solve; `None` where none slips.
    pub fn slipping_forces(&self, system: &UnilateralRows) -> Option<Vec<f64>> {
        (!self.slipping.is_empty()).then(|| system.forces(&self.slipping))
    }

    /// Changes the rows to hold after a solution with forces `lambda` of the held rows, and returns how many were wrong, and whether another solve
    /// is worth it. `sound`: whether the solve converged and met the held rows. Rows that pull are wrong where no lambda >= 0 of the held rows has the same effect. After eight solutions in a row without
    /// fewer wrong rows the search ends.
    pub fn exchange(&mut self, system: &UnilateralRows, lambda: &[f64], v: &[f64], sound: bool) -> (usize, bool) {
        let n = system.n();
        let mut lambda = lambda.to_vec();
        lambda.iter_mut().zip(&self.slipping).for_each(|(lambda, slipping)| *lambda += slipping);
        let lambda = &lambda[..];
        let tolerance = TOLERANCE * largest(v);
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
        let [normal, rubbing] = [(0..n_normal).filter(wrong).count(), (n_normal..n).filter(rubs_wrong).count()];
        let velocity = |i: usize| match self.held[i] {
            true if i < n_normal => -lambda[i] * system.matrix[n * i + i],
            false if i < n_normal => -slacks[i],
            // Friction along the slip, which it drives.
            false if lambda[i] * slacks[i] > 0.0 => {
                slacks[i].abs().min((lambda[i].abs() + most[i]) * system.matrix[n * i + i])
            }
            _ => (lambda[i].abs() - most[i]).abs() * system.matrix[n * i + i],
        };
        let missing = (0..n_normal).filter(wrong).chain((n_normal..n).filter(rubs_wrong));
        let velocity = missing.map(velocity).fold(0.0, f64::max);
        let wrong = normal + rubbing;
        if wrong == 0 {
            self.best_is_last = true;
            return (0, false);
        }
        self.best_is_last = sound && self.best.as_ref().is_none_or(|best| velocity < best.velocity);
        if self.best_is_last {
            let (held, slipping) = (self.held.clone(), self.slipping.clone());
            self.best = Some(BestSet { held, slipping, wrong, velocity });
        }
        match wrong < self.fewest {
            true => (self.fewest, self.patience) = (wrong, PATIENCE),
            false => self.patience = self.patience.saturating_sub(1),
        }
        self.learn(system, lambda, &slacks);
        let known = products(&self.response, lambda);
        let q: Vec<f64> = slacks.iter().zip(known).map(|(slack, known)| slack - known).collect();
        let found = system.solve_rubbing(&self.response, &q);
        // Where rows are dependent, other forces within their bounds may have the same effect.
        let others: Vec<f64> = found.z.iter().zip(lambda).map(|(z, lambda)| z - lambda).collect();
        let effect = system.products(&others).into_iter().map(f64::abs).fold(0.0, f64::max);
        let lag = match normal {
            0 => (n_normal..n).map(|i| LAG * most[i] * system.matrix[n * i + i]).fold(0.0, f64::max),
            _ => 0.0,
        };
        let violated = (0..n_normal).any(|i| !self.held[i] && slacks[i] < -tolerance);
        if found.wrong == 0 && !violated && effect <= f64::max(tolerance, lag) {
            self.best_is_last = true;
            return (0, false);
        }
        if found.wrong > 0 {
            return (wrong, false);
        }
        let next = (system.basis(&found), slipping(&found));
        let changed = next.0 != self.held || next.1 != self.slipping;
        (self.held, self.slipping) = next;
        (wrong, changed && self.patience > 0)
    }

    /// Learns from a solution how v responds to lambda: the update of Broyden, Fletcher, Goldfarb and Shanno, begun with a multiple of W.
    fn learn(&mut self, system: &UnilateralRows, lambda: &[f64], slacks: &[f64]) {
        let difference = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<f64>>();
        let Some(last) = self.last.replace([lambda.to_vec(), slacks.to_vec()]) else {
            if self.response.is_empty() {
                self.response.clone_from(&system.matrix);
            }
            return;
        };
        let change = difference(lambda, &last[0]);
        let response = difference(slacks, &last[1]);
        let work = dot(&change, &response);
        let alone = dot(&change, &system.products(&change));
        if self.response.is_empty() {
            let theta = if alone > 0.0 { (work / alone).clamp(LEAST_RESPONSE, 1.0) } else { 1.0 };
            self.response = system.matrix.iter().map(|w| theta * w).collect();
        }
        let known = products(&self.response, &change);
        let all = dot(&change, &known);
        // Else the change is one of redundant rows, and its effect rounding.
        let sound = all > 0.0 && work > LEAST_RESPONSE * all && work <= MOST_RESPONSE * alone;
        if !sound {
            return;
        }
        for (i, row) in self.response.chunks_exact_mut(change.len()).enumerate() {
            for (j, entry) in row.iter_mut().enumerate() {
                *entry += response[i] * response[j] / work - known[i] * known[j] / all;
            }
        }
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

/// The largest magnitude.
fn largest(v: &[f64]) -> f64 {
    v.iter().fold(0.0, |most, v| f64::max(most, v.abs()))
}

/// A square matrix times a vector.
fn products(matrix: &[f64], x: &[f64]) -> Vec<f64> {
    matrix.chunks_exact(x.len().max(1)).map(|row| dot(row, x)).collect()
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
