//! Iterative refinement, the outer loop of every solve: corrections are added until the true residual is small enough.

use std::ops::Range;

use super::diagnose::larger;
use crate::linalg::{CgEnd, norm};
use crate::scene::Solver;
use crate::state::{SolveReport, SolveStatus};

/// Residuals below this fraction of the right-hand side's scale are rounding of the right-hand side, and pass.
pub const EPSILON: f64 = 1e-14;
/// Safety factor of the inner tolerance, because the recurrence residual drifts from the true one.
const MARGIN: f64 = 0.9;
/// Smallest inner tolerance of one refinement step; the next step starts from the true residual.
const ROUND_TOLERANCE: f64 = 1e-10;
/// A refinement step that does not reduce the true residual by this factor is the last.
const STAGNATION: f64 = 0.5;
/// Fraction of the coupling terms that counts as a part's right-hand side if its own is smaller.
const COUPLING_SHARE: f64 = 0.01;

/// A system A x = b with a stopping criterion on the true residual, for the whole or for each part.
pub(crate) trait LinearSystem {
    /// b.
    fn rhs(&self) -> &[f64];

    /// Scale of the rounding error of b.
    fn rhs_scale(&self) -> f64;

    fn n_unknowns(&self) -> usize;

    /// b - A x.
    fn residual(&self, x: &[f64]) -> Vec<f64>;

    /// Projects x out of the null space of A.
    fn project(&self, _x: &mut [f64]) {}

    /// The parts that must each pass, with their unknowns and the scale of their rounding error.
    fn parts(&self, _x: &[f64]) -> Vec<Part> {
        vec![Part { range: 0..self.rhs().len(), unknowns: self.n_unknowns(), scale: self.rhs_scale(), acts: 0.0 }]
    }
}

/// A part with its own stopping criterion.
pub(crate) struct Part {
    pub(super) range: Range<usize>,
    pub(super) unknowns: usize,
    pub(super) scale: f64,
    /// Norm of the coupling terms in its rows.
    pub(super) acts: f64,
}

impl Part {
    /// Reference norm of its relative residual.
    fn acting(&self, rhs_norm: f64) -> f64 {
        rhs_norm.max(COUPLING_SHARE * self.acts)
    }
}

/// Approximate solution of A x = r.
pub(crate) struct Correction {
    pub(crate) x: Vec<f64>,
    pub(crate) iterations: u32,
    pub(crate) end: CgEnd,
}

/// Norms of the parts of a residual, and their allowed values.
struct Verdict {
    norms: Vec<f64>,
    targets: Vec<f64>,
}

impl Verdict {
    fn new(parts: &[Part], rhs_norms: &[f64], tolerance: f64, residual: &[f64]) -> Verdict {
        let targets = parts.iter().zip(rhs_norms);
        Verdict {
            norms: parts.iter().map(|part| norm(&residual[part.range.clone()])).collect(),
            targets: targets
                .map(|(part, &rhs_norm)| (tolerance * part.acting(rhs_norm)).max(EPSILON * part.scale))
                .collect(),
        }
    }

    fn pairs(&self) -> impl Iterator<Item = (f64, f64)> {
        self.norms.iter().copied().zip(self.targets.iter().copied())
    }

    fn passes(&self) -> bool {
        self.pairs().all(|(norm, target)| norm <= target)
    }

    /// The reduction still required, at most 1.
    fn left(&self) -> f64 {
        let parts = self.pairs().filter(|(norm, target)| norm > target);
        parts.fold(1.0, |left, (norm, target)| left.min(MARGIN * target / norm))
    }

    /// Largest ratio of a norm to its allowed value; NaN if a residual is not finite.
    fn excess(&self) -> f64 {
        let parts = self.pairs().filter(|(norm, _)| *norm != 0.0);
        parts.fold(0.0, |worst, (norm, target)| larger(worst, norm / target))
    }
}

/// Adds corrections until the true residual passes; returns the iterate with the smallest. `correct` solves A x = r
/// to a relative tolerance within a number of iterations.
pub(super) fn refine(
    system: &impl LinearSystem,
    settings: &Solver,
    correct: impl FnMut(&[f64], f64, u32) -> Correction,
) -> (Vec<f64>, SolveReport) {
    let (x, reports) = refine_parts(system, settings, correct);
    (x, reports[0])
}

/// The reduction still required from x, at most 1; `None` if its true residual passes.
pub(crate) fn part_left(system: &dyn LinearSystem, tolerance: f64, mut x: Vec<f64>) -> Option<f64> {
    system.project(&mut x);
    let parts = system.parts(&x);
    let norm_of = |part: &Part| norm(&system.rhs()[part.range.clone()]);
    let rhs_norms: Vec<f64> = parts.iter().map(norm_of).collect();
    let verdict = Verdict::new(&parts, &rhs_norms, tolerance, &system.residual(&x));
    (!verdict.passes()).then(|| verdict.left())
}

/// As `refine`, with a report per part; iterations and status are those of the whole.
pub(crate) fn refine_parts(
    system: &dyn LinearSystem,
    settings: &Solver,
    mut correct: impl FnMut(&[f64], f64, u32) -> Correction,
) -> (Vec<f64>, Vec<SolveReport>) {
    let mut x = vec![0.0; system.rhs().len()];
    let parts = system.parts(&x);
    let ranges = parts.iter().map(|part| part.range.clone());
    let rhs_norms: Vec<f64> = ranges.map(|range| norm(&system.rhs()[range])).collect();
    let (mut iterations, mut status) = (0, SolveStatus::Converged);
    let mut residual = system.rhs().to_vec();
    let mut verdict = Verdict::new(&parts, &rhs_norms, settings.tolerance, &residual);
    if !rhs_norms.iter().all(|norm| norm.is_finite()) {
        verdict.norms.fill(f64::NAN);
        return (x, reports(&parts, &rhs_norms, &verdict, 0, SolveStatus::NonFinite));
    }
    while !verdict.passes() {
        let tolerance = verdict.left().max(ROUND_TOLERANCE);
        let correction = correct(&residual, tolerance, settings.max_iterations - iterations);
        iterations += correction.iterations;
        let sums = x.iter().zip(&correction.x);
        let mut improved: Vec<f64> = sums.map(|(x, d)| x + d).collect();
        system.project(&mut improved);
        let improved_residual = system.residual(&improved);
        let parts = system.parts(&improved);
        let judged = Verdict::new(&parts, &rhs_norms, settings.tolerance, &improved_residual);
        let (before, after) = (verdict.excess(), judged.excess());
        if after < before {
            (x, residual, verdict) = (improved, improved_residual, judged);
        }
        if verdict.passes() {
            break;
        }
        status = match correction.end {
            _ if !after.is_finite() => SolveStatus::NonFinite,
            CgEnd::Breakdown => SolveStatus::Breakdown,
            _ if iterations >= settings.max_iterations => SolveStatus::IterationLimit,
            _ if after > STAGNATION * before => SolveStatus::Stagnated,
            _ => continue,
        };
        break;
    }
    let parts = system.parts(&x);
    let reports = reports(&parts, &rhs_norms, &verdict, iterations, status);
    (x, reports)
}

/// Report of each part.
fn reports(
    parts: &[Part],
    rhs_norms: &[f64],
    verdict: &Verdict,
    iterations: u32,
    status: SolveStatus,
) -> Vec<SolveReport> {
    let norms = parts.iter().zip(rhs_norms).zip(&verdict.norms);
    let report = |((part, &rhs_norm), &norm): ((&Part, &f64), &f64)| SolveReport {
        unknowns: part.unknowns,
        iterations,
        residual: match norm {
            0.0 => 0.0,
            norm => norm / part.acting(rhs_norm),
        },
        status,
    };
    norms.map(report).collect()
}
