//! What else solves the same system in the same run: on the CPU, in double precision.

use std::time::Instant;

use serde::Serialize;

use crate::Error;
use crate::linalg::{Csr, Incomplete, SymbolicCholesky, conjugate_gradient, norm};

use super::super::statistics::Spread;
use super::Row;

/// Repeats end once they have taken so long, s.
const LONG_ENOUGH: f64 = 20.0;

/// Another solver, on the CPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rival {
    /// Conjugate gradients with an incomplete Cholesky factor without fill, natural order.
    IncompleteCholesky,
    /// A sparse Cholesky factor, in the order of approximate minimum degree, by faer on all cores.
    Cholesky,
}

impl Rival {
    pub(super) fn name(self) -> &'static str {
        match self {
            Rival::IncompleteCholesky => "ic0_cg",
            Rival::Cholesky => "cholesky",
        }
    }
}

/// A row of solve_against.csv. The system is that of the row of solve.csv; of the two-field and condensed ones, the positive definite one of
/// the thesis, (5.25). What was left out for its size is empty.
#[derive(Clone, Debug, Serialize)]
pub struct Against {
    /// As in [`Row`].
    pub scene: &'static str,
    /// As in [`Row`].
    pub grid: usize,
    /// As in [`Row`].
    pub active_cells: u32,
    /// As in [`Row`].
    pub solid_nodes: u32,
    /// As in [`Row`].
    pub bricks: Option<usize>,
    /// As in [`Row`].
    pub formulation: &'static str,
    /// As in [`Row`].
    pub preconditioner: &'static str,
    /// As in [`Row`].
    pub precision: &'static str,
    /// As in [`Row`], on the device.
    pub device_seconds: f64,
    /// `ic0_cg` or `cholesky`.
    pub rival: &'static str,
    /// Of the matrix.
    pub rows: usize,
    /// Of the matrix.
    pub entries: usize,
    /// Of the factor, bytes.
    pub factor_bytes: f64,
    /// Of conjugate gradients.
    pub iterations: Option<usize>,
    /// Factor and solution, the order found included; the matrix is there.
    pub seconds_median: Option<f64>,
    /// Least.
    pub seconds_min: Option<f64>,
    /// Largest.
    pub seconds_max: Option<f64>,
    /// True relative residual of the rival's own system.
    pub residual: Option<f64>,
    /// Median seconds over those on the device.
    pub ratio: Option<f64>,
}

/// A rival at work on a system.
pub(super) struct Contest<'a> {
    rival: Rival,
    matrix: &'a Csr,
    rhs: &'a [f64],
    tolerance: f64,
    factor_bytes: f64,
    /// Whether the factor is larger than what is allowed.
    left_out: bool,
    seconds: Vec<f64>,
    iterations: Option<usize>,
    residual: f64,
}

impl<'a> Contest<'a> {
    /// `largest`: bytes of a factor.
    pub(super) fn new(
        rival: Rival,
        (matrix, rhs): (&'a Csr, &'a [f64]),
        tolerance: f64,
        largest: f64,
    ) -> Result<Contest<'a>, Error> {
        let entries = match rival {
            Rival::IncompleteCholesky => matrix.n_entries(),
            Rival::Cholesky => SymbolicCholesky::new(matrix)?.n_factor_entries(),
        };
        let factor_bytes = 8.0 * entries as f64;
        Ok(Contest {
            rival,
            matrix,
            rhs,
            tolerance,
            factor_bytes,
            left_out: factor_bytes > largest,
            seconds: Vec::new(),
            iterations: None,
            residual: 0.0,
        })
    }

    /// Solves once, unless it has taken long enough.
    pub(super) fn turn(&mut self) -> Result<(), Error> {
        if self.left_out || self.seconds.iter().sum::<f64>() > LONG_ENOUGH {
            return Ok(());
        }
        let mut x = self.rhs.to_vec();
        let clock = Instant::now();
        match self.rival {
            Rival::IncompleteCholesky => {
                let Some(factor) = Incomplete::new(self.matrix) else {
                    self.left_out = true;
                    return Ok(());
                };
                let most = 10 * self.matrix.n_rows();
                let (b, tolerance) = (self.rhs, self.tolerance);
                let report = conjugate_gradient(self.matrix, &factor, b, &mut x, tolerance, most);
                self.iterations = Some(report.iterations);
            }
            Rival::Cholesky => {
                let symbolic = SymbolicCholesky::new(self.matrix)?;
                symbolic.factorise_in_parallel(self.matrix)?.solve(&mut x);
            }
        }
        self.seconds.push(clock.elapsed().as_secs_f64());
        let mut residual = vec![0.0; x.len()];
        self.matrix.multiply(&x, &mut residual);
        for (r, b) in residual.iter_mut().zip(self.rhs) {
            *r = b - *r;
        }
        self.residual = norm(&residual) / norm(self.rhs);
        Ok(())
    }

    /// Beside the row of the device.
    pub(super) fn row(self, device: &Row) -> Against {
        let found = !self.seconds.is_empty();
        let seconds = found.then(|| Spread::of(self.seconds));
        let median = seconds.map(|seconds| seconds.median);
        Against {
            scene: device.scene,
            grid: device.grid,
            active_cells: device.active_cells,
            solid_nodes: device.solid_nodes,
            bricks: device.bricks,
            formulation: device.formulation,
            preconditioner: device.preconditioner,
            precision: device.precision,
            device_seconds: device.seconds_median,
            rival: self.rival.name(),
            rows: self.matrix.n_rows(),
            entries: self.matrix.n_entries(),
            factor_bytes: self.factor_bytes,
            iterations: self.iterations,
            seconds_median: median,
            seconds_min: seconds.map(|seconds| seconds.min),
            seconds_max: seconds.map(|seconds| seconds.max),
            residual: found.then_some(self.residual),
            ratio: median.map(|median| median / device.seconds_median),
        }
    }
}
