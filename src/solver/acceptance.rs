//! Acceptance rule of the outer loop, one for all systems, on the host; `shaders/refine_accept.wgsl` is the same rule on the device.
//!
//! A block of the unknowns passes where
//!
//! ```text
//!   |r|^2 <= max(tolerance^2 max(|b|^2, share^2 |coupling terms|^2), rounding^2 |terms of b|^2, (eps/2)^2 |D x|^2)
//! ```
//!
//! and all must. A correction is accepted where the largest quotient of both sides falls.

use crate::gpu::{Real, Variant};
use crate::scene::{Precision, Solver};

use super::refine::HostResidual;

/// Slots of the norms: `shaders/common/refine.wgsl`.
pub(super) const SCALE: usize = 1;
pub(super) const RESIDUAL: usize = 0;
pub(super) const RHS: usize = 1;
pub(super) const TERMS: usize = 2;
pub(super) const REFERENCE: usize = 3;
const NORMS_OF_STATE: usize = 3;
const NORMS_OF_BLOCK: usize = 4;

/// Slot of a norm of a block.
pub(super) fn norm_slot(block: usize, norm: usize) -> usize {
    NORMS_OF_STATE + NORMS_OF_BLOCK * block + norm
}

/// First slot of the evaluation of a block other than the first.
pub(super) fn evaluation_slot(block: usize, n_blocks: usize) -> usize {
    norm_slot(n_blocks + block - 1, 0)
}

/// Norms of a system of so many blocks.
pub(super) fn n_norms(n_blocks: usize) -> usize {
    evaluation_slot(n_blocks, n_blocks)
}

/// Least reduction by a correction in f32: recurrences fall where the true residual of a correction stays (4e-5 at 80^3).
const FLOOR_F32: f32 = 5e-5;
/// Inner tolerance relative to the allowed error, for one block: rounding does not make the correction miss by a hair.
const MARGIN: f64 = 0.5;
/// For two blocks: the norm of conjugate gradients is not that of the residuals.
const MARGIN_COUPLED: f64 = 0.3;
/// Factor of the inner tolerance after a rejected correction of two blocks: with a poor polynomial for a stiff solid, conjugate gradients
/// may end too early for the residual that counts.
const RETRY_COUPLED: f64 = 0.03;
/// See `shaders/refine_accept.wgsl`.
const ROUNDING_OF_X: f64 = 0.5;
const STRICTEST: f64 = 1e-5;
/// Least positive square.
const SMALLEST: f64 = 1e-300;

/// Share of the coupling terms that residuals are relative to where it is more than the right-hand side.
pub const COUPLING_SHARE: f64 = 0.01;

/// Settings of the outer loop, as `shaders/common/refine.wgsl` has them.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct RefineSettings {
    /// Bound of |r| relative to the right-hand side.
    pub tolerance: f32,
    /// Rounding error of |r| relative to the terms of the right-hand side.
    pub rounding: f32,
    /// Least reduction by a correction.
    pub floor: f32,
    /// 1 where the correction holds a guess before the first refinement step, else 0.
    pub guess: f32,
    /// Blocks of the unknowns.
    pub n_blocks: u32,
    /// Nothing.
    pub pad_0: u32,
    /// Nothing.
    pub pad_1: u32,
    /// Nothing.
    pub pad_2: u32,
}

impl RefineSettings {
    pub(super) fn new(solver: &Solver, variant: Variant, guesses: bool, n_blocks: usize) -> RefineSettings {
        RefineSettings {
            tolerance: solver.tolerance as f32,
            rounding: rounding(solver) as f32,
            floor: match variant.inner {
                Real::F32 => FLOOR_F32,
                // Corrections as precise as the residual: one does it all.
                Real::F64 => 0.0,
            },
            guess: if guesses { 1.0 } else { 0.0 },
            n_blocks: n_blocks as u32,
            ..bytemuck::Zeroable::zeroed()
        }
    }
}

/// Rounding error of the residual, relative to the terms that the right-hand side sums.
pub fn rounding(solver: &Solver) -> f64 {
    match solver.precision {
        Precision::F32 => 1e-7,
        Precision::Mixed | Precision::F64 => 1e-14,
    }
}

/// The rule, and how strict the inner tolerance has become.
#[derive(Debug)]
pub(super) struct Acceptance {
    tolerance: f64,
    rounding: f64,
    floor: f64,
    margin: f64,
    retry: f64,
    strictness: f64,
}

impl Acceptance {
    pub(super) fn new(solver: &Solver, settings: &RefineSettings) -> Acceptance {
        let coupled = settings.n_blocks > 1;
        Acceptance {
            tolerance: solver.tolerance,
            rounding: rounding(solver),
            floor: settings.floor.into(),
            margin: if coupled { MARGIN_COUPLED } else { MARGIN },
            retry: if coupled { RETRY_COUPLED } else { 0.0 },
            strictness: 1.0,
        }
    }

    /// Largest |r|^2 over the allowed error of a block; not a number where one of them is none.
    pub(super) fn worst(&self, residuals: &[HostResidual], norms: &[f64]) -> f64 {
        let fraction = |(block, residual): (usize, &HostResidual)| {
            let of_x = ROUNDING_OF_X * f64::EPSILON;
            let terms = norms[norm_slot(block, TERMS)];
            let of_terms = (self.rounding.powi(2) * terms).max(of_x.powi(2) * residual.dd);
            let allowed = self.tolerance.powi(2) * reference(block, residual, norms);
            residual.rr / allowed.max(of_terms).max(SMALLEST)
        };
        let fractions = residuals.iter().enumerate().map(fraction);
        fractions.fold(0.0, |worst, fraction| if worst > fraction || worst.is_nan() { worst } else { fraction })
    }

    /// Part of the squared residual at which conjugate gradients end.
    pub(super) fn inner_tolerance(&self, worst: f64) -> f64 {
        let part = (self.margin.powi(2) / worst).max(self.floor.powi(2));
        self.strictness * self.strictness * part
    }

    /// After a rejected correction: whether another is worth it.
    pub(super) fn retry(&mut self) -> bool {
        self.strictness *= self.retry;
        self.strictness >= STRICTEST
    }
}

/// Squared norm that the residual of a block is relative to.
pub(super) fn reference(block: usize, residual: &HostResidual, norms: &[f64]) -> f64 {
    norms[norm_slot(block, RHS)].max(COUPLING_SHARE.powi(2) * residual.coupling)
}

/// sqrt(rr / bb), and 0 where b is nothing: its squares may be below what f32 can tell from 0, and then the unknowns that are 0 solve it.
pub(super) fn relative(rr: f64, bb: f64) -> f64 {
    if bb == 0.0 { 0.0 } else { (rr / bb).sqrt() }
}
