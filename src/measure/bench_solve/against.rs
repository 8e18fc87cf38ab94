//! What else solves the same system in the same run: on the CPU, in double precision.

use std::time::Instant;

use serde::Serialize;

use crate::Error;
use crate::linalg::{CgEnd, CgReport, Csr, Incomplete, SymbolicCholesky, conjugate_gradient, norm};

use super::super::statistics::Spread;
use super::Row;

/// No more runs of a solver are begun once they have taken so long, s.
pub(super) const LONG_ENOUGH: f64 = 20.0;

/// Bytes.
pub const GIB: f64 = (1_u64 << 30) as f64;

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
/// the thesis, (5.25). What was left out for its size, or did not converge, is empty.
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
    pub device_seconds_median: f64,
    /// Least.
    pub device_seconds_min: f64,
    /// Largest.
    pub device_seconds_max: f64,
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
    /// How often it was solved, each time after the device.
    pub turns: usize,
    /// Factor and solution, the order found included; the matrix is there.
    pub seconds_median: Option<f64>,
    /// Least.
    pub seconds_min: Option<f64>,
    /// Largest.
    pub seconds_max: Option<f64>,
    /// True relative residual of the rival's own system.
    pub residual: Option<f64>,
    /// Seconds over those on the device in the same turn, median of the turns; empty where the device did not converge.
    pub ratio_median: Option<f64>,
    /// Least.
    pub ratio_min: Option<f64>,
    /// Largest.
    pub ratio_max: Option<f64>,
    /// Why there is no ratio; else empty.
    pub note: String,
}

/// A rival at work on a system.
pub(super) struct Contest<'a> {
    rival: Rival,
    matrix: &'a Csr,
    rhs: &'a [f64],
    tolerance: f64,
    factor_bytes: f64,
    /// Why it has no turns.
    left_out: Option<String>,
    /// Seconds of the device and of the rival.
    turns: Vec<[f64; 2]>,
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
            left_out: (factor_bytes > largest)
                .then(|| format!("factor of {:.1} GiB left out", factor_bytes / GIB)),
            turns: Vec::new(),
            iterations: None,
            residual: 0.0,
        })
    }

    /// Solves once, unless it has taken long enough. `device`: seconds that the device took just before.
    pub(super) fn turn(&mut self, device: f64) -> Result<(), Error> {
        let taken: f64 = self.turns.iter().map(|[_, rival]| rival).sum();
        if self.left_out.is_some() || taken > LONG_ENOUGH {
            return Ok(());
        }
        let mut x = self.rhs.to_vec();
        let clock = Instant::now();
        match self.rival {
            Rival::IncompleteCholesky => {
                let Some(factor) = Incomplete::new(self.matrix) else {
                    self.left_out = Some("no incomplete factor without fill".to_owned());
                    return Ok(());
                };
                let most = 10 * self.matrix.n_rows();
                let (b, tolerance) = (self.rhs, self.tolerance);
                let report = conjugate_gradient(self.matrix, &factor, b, &mut x, tolerance, most);
                self.left_out = unsolved(report);
                if self.left_out.is_some() {
                    return Ok(());
                }
                self.iterations = Some(report.iterations);
            }
            Rival::Cholesky => {
                let symbolic = SymbolicCholesky::new(self.matrix)?;
                symbolic.factorise_in_parallel(self.matrix)?.solve(&mut x);
            }
        }
        self.turns.push([device, clock.elapsed().as_secs_f64()]);
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
        let seconds = spread(&self.turns, |[_, rival]| rival);
        let ratio = spread(&self.turns, ratio).filter(|_| device.converged());
        let note = match self.left_out {
            Some(note) => note,
            None if device.converged() => String::new(),
            None => format!("no ratio: on the device {}", device.status),
        };
        Against {
            scene: device.scene,
            grid: device.grid,
            active_cells: device.active_cells,
            solid_nodes: device.solid_nodes,
            bricks: device.bricks,
            formulation: device.formulation,
            preconditioner: device.preconditioner,
            precision: device.precision,
            device_seconds_median: device.seconds_median,
            device_seconds_min: device.seconds_min,
            device_seconds_max: device.seconds_max,
            rival: self.rival.name(),
            rows: self.matrix.n_rows(),
            entries: self.matrix.n_entries(),
            factor_bytes: self.factor_bytes,
            iterations: self.iterations,
            turns: self.turns.len(),
            seconds_median: seconds.map(|seconds| seconds.median),
            seconds_min: seconds.map(|seconds| seconds.min),
            seconds_max: seconds.map(|seconds| seconds.max),
            residual: seconds.map(|_| self.residual),
            ratio_median: ratio.map(|ratio| ratio.median),
            ratio_min: ratio.map(|ratio| ratio.min),
            ratio_max: ratio.map(|ratio| ratio.max),
            note,
        }
    }
}

/// Why conjugate gradients have no solution, where they have none.
fn unsolved(CgReport { iterations, end }: CgReport) -> Option<String> {
    match end {
        CgEnd::Converged => None,
        CgEnd::IterationLimit => Some(format!("not converged in {iterations} iterations")),
        CgEnd::Breakdown => Some(format!("broke down after {iterations} iterations")),
    }
}

/// Of a value of each turn, seconds of device and rival; none without turns.
fn spread(turns: &[[f64; 2]], value: fn([f64; 2]) -> f64) -> Option<Spread> {
    let values: Vec<f64> = turns.iter().copied().map(value).collect();
    (!values.is_empty()).then(|| Spread::of(values))
}

fn ratio([device, rival]: [f64; 2]) -> f64 {
    rival / device
}

#[cfg(test)]
mod tests {
    use super::super::tests::row;
    use super::{CgEnd, CgReport, Contest, Csr, Rival, Spread, ratio, spread, unsolved};

    #[test]
    fn ratios_are_of_the_same_turn() {
        // The medians are 2 s and 4 s.
        let turns = [[1.0, 4.0], [2.0, 2.0], [4.0, 12.0]];
        let expected = Spread {
            median: 3.0,
            min: 1.0,
            max: 4.0,
        };
        assert_eq!(spread(&turns, ratio), Some(expected));
        let one = spread(&[[4.0, 1.0]], ratio);
        assert_eq!(one, Some(Spread::exact(0.25)));
        assert_eq!(spread(&[], ratio), None);
    }

    #[test]
    fn what_did_not_converge_has_a_note_and_no_ratio() {
        let end = |end| {
            unsolved(CgReport {
                iterations: 70,
                end,
            })
        };
        assert_eq!(end(CgEnd::Converged), None);
        let [limit, broken] = [CgEnd::IterationLimit, CgEnd::Breakdown].map(end);
        assert_eq!(limit.as_deref(), Some("not converged in 70 iterations"));
        assert_eq!(broken.as_deref(), Some("broke down after 70 iterations"));

        let matrix = Csr::diagonal_of(&[1.0]);
        let against = |status, left_out: Option<String>| {
            let turns = match left_out {
                None => vec![[2.0, 1.0]],
                Some(_) => Vec::new(),
            };
            let contest = Contest {
                rival: Rival::IncompleteCholesky,
                matrix: &matrix,
                rhs: &[1.0],
                tolerance: 1e-8,
                factor_bytes: 8.0,
                left_out,
                turns,
                iterations: None,
                residual: 0.0,
            };
            contest.row(&row(20, status))
        };
        let fair = against("converged", None);
        assert_eq!((fair.ratio_median, fair.note.as_str()), (Some(0.5), ""));
        for status in ["stagnated", "converged_to_rounding"] {
            let unfair = against(status, None);
            assert_eq!(
                (unfair.seconds_median, unfair.ratio_median),
                (Some(1.0), None)
            );
            assert!(unfair.note.ends_with(status), "{}", unfair.note);
        }
        let left_out = against("converged", limit);
        assert_eq!(
            (left_out.seconds_median, left_out.ratio_median),
            (None, None)
        );
        assert_eq!(left_out.note, "not converged in 70 iterations");
    }
}
