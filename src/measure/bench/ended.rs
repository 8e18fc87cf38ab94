//! End of a solve: its reproducible part, and its name in tables.

use std::fmt;

use crate::Error;
use crate::solver::CoupledOutcome;
use crate::state::{SolveReport, SolveStatus};

/// Name of a solve with a residual between the tolerance and its rounding error.
const TO_ROUNDING: &str = "converged_to_rounding";

/// Whether a name means a solve within the tolerance or its rounding error.
pub fn is_solved(name: &str) -> bool {
    [SolveStatus::Converged.name(), TO_ROUNDING].contains(&name)
}

/// End of a solve. The same solve on the same device has a bitwise identical one.
#[derive(Clone, Copy, Debug)]
pub struct Ended {
    /// Status.
    pub status: SolveStatus,
    /// Iterations over all refinement steps; 0 for a direct solve.
    pub iterations: u32,
    /// True relative residuals of the rows of pressures and of velocities; 0 for rows that the system lacks.
    pub residuals: [f64; 2],
}

impl From<&CoupledOutcome> for Ended {
    fn from(CoupledOutcome { parts: [p, v], .. }: &CoupledOutcome) -> Ended {
        Ended { status: p.status, iterations: p.iterations, residuals: [p.residual, v.residual] }
    }
}

impl Ended {
    /// End of the solves of a sub-step: the first status other than converged, the most iterations (in a coupled solve each report has all), the
    /// residuals of the first two. Without reports: converged.
    pub fn new(reports: &[SolveReport]) -> Ended {
        let mut statuses = reports.iter().map(|report| report.status);
        let failed = statuses.find(|status| *status != SolveStatus::Converged);
        let residual = |part: usize| reports.get(part).map_or(0.0, |report| report.residual);
        let iterations = reports.iter().map(|report| report.iterations);
        Ended {
            status: failed.unwrap_or(SolveStatus::Converged),
            iterations: iterations.max().unwrap_or(0),
            residuals: [0, 1].map(residual),
        }
    }

    /// Refuses a repeat with another end. `what`: the system.
    pub fn ensure_repeated(self, again: Ended, what: &str) -> Result<(), Error> {
        let bits = |residual: f64| {
            if residual.is_nan() { 0 } else { residual.to_bits() }
        };
        let key = |ended: Ended| (ended.status, ended.iterations, ended.residuals.map(bits));
        if key(self) == key(again) {
            return Ok(());
        }
        Err(Error::Check(format!(
            "{what}: the same solve ended {self}, then {again}\n  cure: use another adapter (--adapter) or driver: this one is not reproducible"
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
        write!(f, "{status} after {} iterations with residuals {first:e} and {second:e}", self.iterations)
    }
}
