//! How a solve ended: the part that repeats bitwise, and its name in tables.

use std::fmt;

use crate::Error;
use crate::scene::{Precision, Preconditioner};
use crate::solver::{CoupledOutcome, Outcome};
use crate::state::{SolveReport, SolveStatus};

/// Name of a solve with a residual above the tolerance and below its rounding error.
const TO_ROUNDING: &str = "converged_to_rounding";

/// Whether a name is that of a solve within the tolerance or its rounding error.
pub fn is_solved(name: &str) -> bool {
    [SolveStatus::Converged.name(), TO_ROUNDING].contains(&name)
}

/// End of a solve. The same solve on the same device repeats it bitwise.
#[derive(Clone, Copy, Debug)]
pub struct Ended {
    /// Status.
    pub status: SolveStatus,
    /// Over all refinement steps; 0 of a direct solve.
    pub iterations: u32,
    /// True relative residuals of the pressures' rows and of the velocities'; of one system the second is 0.
    pub residuals: [f64; 2],
}

impl From<&Outcome> for Ended {
    fn from(outcome: &Outcome) -> Ended {
        Ended {
            status: outcome.status,
            iterations: outcome.iterations,
            residuals: [outcome.residual, 0.0],
        }
    }
}

impl From<&CoupledOutcome> for Ended {
    fn from(outcome: &CoupledOutcome) -> Ended {
        Ended {
            status: outcome.status,
            iterations: outcome.iterations,
            residuals: outcome.residuals,
        }
    }
}

impl Ended {
    /// End of the solves of a sub-step or of the f64 path: the first status other than converged, the most iterations (of a solve for liquid and
    /// solids each report has those of the whole), the residuals of the first two. Without reports: converged.
    pub fn of_reports(reports: &[SolveReport]) -> Ended {
        let mut statuses = reports.iter().map(|report| report.status);
        let failed = statuses.find(|status| *status != SolveStatus::Converged);
        let residual = |part: usize| reports.get(part).map_or(0.0, |report| report.residual);
        Ended {
            status: failed.unwrap_or(SolveStatus::Converged),
            iterations: reports
                .iter()
                .map(|report| report.iterations)
                .max()
                .unwrap_or(0),
            residuals: [0, 1].map(residual),
        }
    }

    /// Refuses a repeat that ended otherwise. `what`: the system.
    ///
    /// # Errors
    /// [`Error::Check`].
    pub fn ensure_repeated(self, again: Ended, what: &str) -> Result<(), Error> {
        let bits = |ended: Ended| {
            ended
                .residuals
                .map(|r| if r.is_nan() { 0 } else { r.to_bits() })
        };
        let of = |ended: Ended| (ended.status, ended.iterations, bits(ended));
        if of(self) == of(again) {
            return Ok(());
        }
        Err(Error::Check(format!(
            "{what}: the same solve ended {self}, then {again}\n  cure: use another adapter (--adapter) or driver: this one does not repeat"
        )))
    }

    /// Name in tables.
    pub fn name(self, tolerance: f64) -> &'static str {
        match self.status {
            SolveStatus::Converged if self.residuals.iter().any(|&r| r > tolerance) => TO_ROUNDING,
            status => status.name(),
        }
    }
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([first, second], status) = (self.residuals, self.status.name());
        write!(
            f,
            "{status} after {} iterations with residuals {first:e} and {second:e}",
            self.iterations
        )
    }
}

/// A precision in tables.
pub(super) fn precision_name(precision: Precision) -> &'static str {
    match precision {
        Precision::F32 => "f32",
        Precision::Mixed => "mixed",
        Precision::F64 => "f64",
    }
}

/// A preconditioner in tables.
pub(super) fn preconditioner_name(preconditioner: Preconditioner) -> &'static str {
    match preconditioner {
        Preconditioner::Multigrid => "multigrid",
        Preconditioner::Jacobi => "jacobi",
        Preconditioner::BlockJacobi => "block_jacobi",
    }
}
