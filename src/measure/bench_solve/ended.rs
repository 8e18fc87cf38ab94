//! How solves end: what of it repeats, and what tables call it.

use std::fmt;

use crate::Error;
use crate::solver::{CoupledOutcome, Outcome};
use crate::state::{SolveReport, SolveStatus};

const TO_ROUNDING: &str = "converged_to_rounding";

/// Whether a solve is one of the system, by the word for tables: to the tolerance, or as far as rounding lets it.
pub(in crate::measure) fn is_solved(word: &str) -> bool {
    [SolveStatus::Converged.name(), TO_ROUNDING].contains(&word)
}

/// How a solve ended. The same solve on the same device repeats it to the bit.
#[derive(Clone, Copy, Debug)]
pub(in crate::measure) struct Ended {
    status: SolveStatus,
    iterations: u32,
    /// True relative residuals; the second is 0 where one system is solved.
    residuals: [f64; 2],
}

impl Ended {
    /// Of one system.
    pub(in crate::measure) fn alone(outcome: &Outcome) -> Ended {
        Ended {
            status: outcome.status,
            iterations: outcome.iterations,
            residuals: [outcome.residual, 0.0],
        }
    }

    /// Of liquid and solids.
    pub(super) fn together(outcome: &CoupledOutcome) -> Ended {
        Ended {
            status: outcome.status,
            iterations: outcome.iterations,
            residuals: outcome.residuals,
        }
    }

    /// Of what a sub-step or the f64 path reports: of one system, or of liquid and solids. The status is the first other than
    /// [`SolveStatus::Converged`], the iterations are the most: of a solve for both each report tells those of the whole. Residuals are relative;
    /// no report is a solve of nothing, which converged. Of more than two reports only the residuals of the first two are judged.
    pub(in crate::measure) fn of_reports(reports: &[SolveReport]) -> Ended {
        let mut statuses = reports.iter().map(|report| report.status);
        let failed = statuses.find(|status| *status != SolveStatus::Converged);
        let iterations = reports.iter().map(|report| report.iterations).max();
        let residual = |part: usize| reports.get(part).map_or(0.0, |report| report.residual);
        Ended {
            status: failed.unwrap_or(SolveStatus::Converged),
            iterations: iterations.unwrap_or(0),
            residuals: [0, 1].map(residual),
        }
    }

    /// In all rounds; 0 of a direct solve.
    pub(super) fn iterations(self) -> u32 {
        self.iterations
    }

    /// True relative residuals of the pressures' rows and of the velocities'.
    pub(super) fn residuals(self) -> [f64; 2] {
        self.residuals
    }

    /// Refuses a repeat that ended otherwise. `what`: was solved.
    ///
    /// # Errors
    /// [`Error::Check`].
    pub(in crate::measure) fn ensure_repeated(self, again: Ended, what: &str) -> Result<(), Error> {
        let pairs = self.residuals.into_iter().zip(again.residuals);
        let mut same = pairs.map(|(a, b)| a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan()));
        if same.all(|same| same)
            && (self.status, self.iterations) == (again.status, again.iterations)
        {
            return Ok(());
        }
        Err(Error::Check(format!(
            "{what}: the same solve ended {self}, then {again}\n  cure: use another adapter (--adapter) or driver: this one does not repeat"
        )))
    }

    /// The word for tables. A solve passes, too, whose residual is above the tolerance and below what rounding makes of it: that it is not
    /// within the tolerance is said.
    pub(in crate::measure) fn name(self, tolerance: f64) -> &'static str {
        match self.status {
            SolveStatus::Converged if self.residuals.iter().any(|&r| r > tolerance) => TO_ROUNDING,
            status => status.name(),
        }
    }
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [first, second] = self.residuals;
        let (status, iterations) = (self.status.name(), self.iterations);
        write!(
            f,
            "{status} after {iterations} iterations with residuals {first:e} and {second:e}"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::{Ended, is_solved};
    use crate::state::{SolveReport, SolveStatus};

    const CONVERGED: Ended = Ended {
        status: SolveStatus::Converged,
        iterations: 12,
        residuals: [1e-9, 2e-9],
    };

    #[test]
    fn what_is_not_a_number_repeats_and_what_differs_is_refused() {
        let broken = Ended {
            status: SolveStatus::NonFinite,
            residuals: [f64::NAN; 2],
            ..CONVERGED
        };
        for ended in [CONVERGED, broken] {
            ended.ensure_repeated(ended, "a solve").unwrap();
        }
        let others = [
            broken,
            Ended {
                status: SolveStatus::Stagnated,
                ..CONVERGED
            },
            Ended {
                iterations: 13,
                ..CONVERGED
            },
            Ended {
                residuals: [1e-9, 2e-9_f64.next_up()],
                ..CONVERGED
            },
        ];
        for other in others {
            let refused = CONVERGED.ensure_repeated(other, "a solve").unwrap_err();
            assert_eq!(refused.exit_code(), 1);
            let told = refused.to_string();
            assert!(
                told.contains("a solve: ") && told.contains(&other.to_string()),
                "{told}"
            );
        }
    }

    #[test]
    fn a_residual_above_the_tolerance_is_no_convergence_to_it() {
        assert_eq!(CONVERGED.name(2e-9), "converged");
        assert_eq!(CONVERGED.name(1.5e-9), "converged_to_rounding");
        let stagnated = Ended {
            status: SolveStatus::Stagnated,
            ..CONVERGED
        };
        assert_eq!(stagnated.name(1.5e-9), "stagnated");
    }

    #[test]
    fn reports_of_both_parts_are_one_end() {
        let report = |residual, status| SolveReport {
            unknowns: 10,
            iterations: 7,
            residual,
            status,
        };
        let passed = |residual| report(residual, SolveStatus::Converged);
        let both = Ended::of_reports(&[passed(1e-9), passed(3e-8)]);
        assert_eq!((both.iterations(), both.residuals()), (7, [1e-9, 3e-8]));
        // Whichever part is above the tolerance.
        assert_eq!(both.name(1e-7), "converged");
        assert_eq!(both.name(1e-8), "converged_to_rounding");
        let other = Ended::of_reports(&[passed(3e-8), passed(1e-9)]);
        assert_eq!(other.name(1e-8), "converged_to_rounding");
        let alone = Ended::of_reports(&[passed(1e-9)]);
        assert_eq!((alone.name(1e-8), alone.residuals()[1]), ("converged", 0.0));
        let failed = Ended::of_reports(&[passed(1e-9), report(1.0, SolveStatus::Breakdown)]);
        assert_eq!(failed.name(1e-8), SolveStatus::Breakdown.name());
        assert!(is_solved(both.name(1e-7)) && is_solved(both.name(1e-12)));
        assert!(!is_solved(failed.name(1e-8)));
    }
}
