//! The outer loop of every solve: corrections are added until the true residual passes (design section 5).

use std::ops::Range;

use super::diagnose::larger;
use crate::linalg::{CgEnd, norm};
use crate::scene::Solver;
use crate::state::{SolveReport, SolveStatus};

/// A residual below this part of the scale of the right-hand side is rounding of the right-hand side itself and passes.
pub const EPSILON: f64 = 1e-14;
/// A round asks the recurrence for this part of the reduction that is left, because its residual drifts from the true one.
const MARGIN: f64 = 0.9;
/// The recurrence of one round is not asked for more than this; the next round starts from the true residual.
const ROUND_TOLERANCE: f64 = 1e-10;
/// A round that does not reduce the true residual by at least this factor is the last.
const STAGNATION: f64 = 0.5;
/// The share of what another part puts on a part's rows that counts as their right-hand side, where they have less of their own.
const OF_OTHER: f64 = 0.01;

/// A system A x = b that is judged on its true residual, as a whole or in parts.
pub(crate) trait Judged {
    /// b.
    fn rhs(&self) -> &[f64];

    /// What rounding of b is a part of.
    fn rhs_scale(&self) -> f64;

    fn n_unknowns(&self) -> usize;

    /// b - A x.
    fn residual(&self, x: &[f64]) -> Vec<f64>;

    /// Takes out of x what A does not see.
    fn project(&self, _x: &mut [f64]) {}

    /// The parts of the vectors that have to pass each for itself, with their unknowns and what their rounding is a part of.
    fn parts(&self, _x: &[f64]) -> Vec<Part> {
        vec![Part {
            range: 0..self.rhs().len(),
            unknowns: self.n_unknowns(),
            scale: self.rhs_scale(),
            acts: 0.0,
        }]
    }
}

/// What is judged for itself.
pub(crate) struct Part {
    pub(super) range: Range<usize>,
    pub(super) unknowns: usize,
    pub(super) scale: f64,
    /// Norm of what another part puts on its rows.
    pub(super) acts: f64,
}

impl Part {
    /// What its residual is relative to.
    fn acting(&self, rhs_norm: f64) -> f64 {
        rhs_norm.max(OF_OTHER * self.acts)
    }
}

/// An answer to A x = r.
pub(crate) struct Correction {
    pub(crate) x: Vec<f64>,
    pub(crate) iterations: u32,
    pub(crate) end: CgEnd,
}

/// The norms of the parts of a residual against what they may be.
struct Verdict {
    norms: Vec<f64>,
    targets: Vec<f64>,
}

impl Verdict {
    fn new(parts: &[Part], rhs_norms: &[f64], tolerance: f64, residual: &[f64]) -> Verdict {
        let targets = parts.iter().zip(rhs_norms);
        Verdict {
            norms: parts
                .iter()
                .map(|part| norm(&residual[part.range.clone()]))
                .collect(),
            targets: targets
                .map(|(part, &rhs_norm)| {
                    (tolerance * part.acting(rhs_norm)).max(EPSILON * part.scale)
                })
                .collect(),
        }
    }

    fn pairs(&self) -> impl Iterator<Item = (f64, f64)> {
        self.norms.iter().copied().zip(self.targets.iter().copied())
    }

    fn passes(&self) -> bool {
        self.pairs().all(|(norm, target)| norm <= target)
    }

    /// The part of the reduction that is left, at most 1.
    fn left(&self) -> f64 {
        let parts = self.pairs().filter(|(norm, target)| norm > target);
        parts.fold(1.0, |left, (norm, target)| left.min(MARGIN * target / norm))
    }

    /// How many times larger than allowed the worst part is; not a number where a residual is not finite.
    fn excess(&self) -> f64 {
        let parts = self.pairs().filter(|(norm, _)| *norm != 0.0);
        parts.fold(0.0, |worst, (norm, target)| larger(worst, norm / target))
    }
}

/// Adds corrections until the true residual passes; the iterate with the least is kept. `correct` solves A x = r to a relative tolerance
/// within a number of iterations.
pub(super) fn refine(
    system: &impl Judged,
    settings: &Solver,
    correct: impl FnMut(&[f64], f64, u32) -> Correction,
) -> (Vec<f64>, SolveReport) {
    let (x, reports) = refine_parts(system, settings, correct);
    (x, reports[0])
}

/// The part of the reduction that is left where x is all there is, at most 1; `None` where its true residual passes.
pub(crate) fn part_left(system: &impl Judged, tolerance: f64, mut x: Vec<f64>) -> Option<f64> {
    system.project(&mut x);
    let parts = system.parts(&x);
    let norm_of = |part: &Part| norm(&system.rhs()[part.range.clone()]);
    let rhs_norms: Vec<f64> = parts.iter().map(norm_of).collect();
    let verdict = Verdict::new(&parts, &rhs_norms, tolerance, &system.residual(&x));
    (!verdict.passes()).then(|| verdict.left())
}

/// The same as `refine`, with a report for each part; all tell the iterations and the end of the whole.
pub(crate) fn refine_parts(
    system: &impl Judged,
    settings: &Solver,
    mut correct: impl FnMut(&[f64], f64, u32) -> Correction,
) -> (Vec<f64>, Vec<SolveReport>) {
    let mut x = vec![0.0; system.rhs().len()];
    let parts = system.parts(&x);
    let of_parts = parts.iter().map(|part| part.range.clone());
    let rhs_norms: Vec<f64> = of_parts.map(|range| norm(&system.rhs()[range])).collect();
    let (mut iterations, mut status) = (0, SolveStatus::Converged);
    let mut residual = system.rhs().to_vec();
    let mut verdict = Verdict::new(&parts, &rhs_norms, settings.tolerance, &residual);
    if !rhs_norms.iter().all(|norm| norm.is_finite()) {
        verdict.norms.fill(f64::NAN);
        return (
            x,
            reports(&parts, &rhs_norms, &verdict, 0, SolveStatus::NonFinite),
        );
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

/// What is told of each part.
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
