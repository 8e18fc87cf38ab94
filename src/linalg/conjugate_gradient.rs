//! Matrix-free preconditioned conjugate gradients (Hestenes and Stiefel 1952) and stabilised biconjugate gradients (van der
//! Vorst 1992), by faer.

use std::fmt;

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::matrix_free::bicgstab::{self as bicg, BicgParams};
use faer::matrix_free::conjugate_gradient::{self as cg, CgError, CgParams};
use faer::matrix_free::{IdentityPrecond, InitialGuessStatus, LinOp, Precond};
use faer::{ColRef, MatMut, MatRef, Par};

/// A symmetric linear map: a matrix or a preconditioner.
pub trait LinearOperator: Sync {
    /// Number of unknowns.
    fn size(&self) -> usize;

    /// y = A x.
    fn apply(&self, x: &[f64], y: &mut [f64]);
}

/// Reason for the end of an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CgEnd {
    /// The recurrence's residual fell below the tolerance.
    Converged,
    /// All iterations were used.
    IterationLimit,
    /// The operator or the preconditioner is not positive definite, or a number is not finite.
    Breakdown,
}

/// Result of an iteration. Callers evaluate the true residual: that of the recurrence proves nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CgReport {
    /// Products with the operator.
    pub iterations: usize,
    /// How it ended.
    pub end: CgEnd,
}

/// Solves A x = b from a zero guess until ||r|| < tolerance ||b|| for the residual of the recurrence; x is overwritten.
pub fn conjugate_gradient(
    operator: &dyn LinearOperator,
    preconditioner: &dyn LinearOperator,
    b: &[f64],
    x: &mut [f64],
    tolerance: f64,
    max_iterations: usize,
) -> CgReport {
    let n = prepare(operator, preconditioner, b, x);
    let mut iterations = 0;
    let params = CgParams {
        // faer 0.24.4 leaves its residual uninitialised with `Zero`, which would save one product.
        initial_guess: InitialGuessStatus::MaybeNonZero,
        rel_tolerance: tolerance,
        max_iters: max_iterations,
        ..CgParams::default()
    };
    let (operator, preconditioner) = (Wrapped(operator), Wrapped(preconditioner));
    let scratch = cg::conjugate_gradient_scratch(&preconditioner, &operator, 1, Par::Seq);
    let result = cg::conjugate_gradient(
        MatMut::from_column_major_slice_mut(x, n, 1),
        &preconditioner,
        &operator,
        MatRef::from_column_major_slice(b, n, 1),
        params,
        |_| iterations += 1,
        // One thread, so that sums do not depend on the number of threads. Operators may use more.
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(scratch)),
    );
    let end = match result {
        Ok(_) => CgEnd::Converged,
        Err(CgError::NoConvergence { .. }) => CgEnd::IterationLimit,
        Err(_) => CgEnd::Breakdown,
    };
    CgReport::new(iterations, end, x)
}

/// Conjugate gradients with a stopping test by the caller.
///
/// Whenever the residual of the recurrence reaches the tolerance, `test` returns a factor by which to reduce it further, or
/// `None` to stop. The search directions continue; a restart would have to rebuild them (van der Sluis and van der Vorst 1986).
/// faer's conjugate gradients cannot resume.
pub fn conjugate_gradient_with_test(
    operator: &dyn LinearOperator,
    preconditioner: &dyn LinearOperator,
    b: &[f64],
    x: &mut [f64],
    tolerance: f64,
    max_iterations: usize,
    mut test: impl FnMut(&[f64]) -> Option<f64>,
) -> CgReport {
    let n = prepare(operator, preconditioner, b, x);
    let (mut r, mut z, mut q) = (b.to_vec(), vec![0.0; n], vec![0.0; n]);
    preconditioner.apply(&r, &mut z);
    let mut p = z.clone();
    let mut rz = fast_dot(&r, &z);
    let mut target = tolerance * fast_dot(b, b).sqrt();
    for iterations in 0.. {
        let residual = fast_dot(&r, &r).sqrt();
        if residual <= target {
            match test(x) {
                // A zero residual cannot be reduced.
                Some(factor) if residual > 0.0 => target = factor * residual,
                _ => return CgReport::new(iterations, CgEnd::Converged, x),
            }
        }
        if iterations == max_iterations {
            return CgReport::new(iterations, CgEnd::IterationLimit, x);
        }
        operator.apply(&p, &mut q);
        let pq = fast_dot(&p, &q);
        if !(rz > 0.0 && pq > 0.0) {
            return CgReport::new(iterations, CgEnd::Breakdown, x);
        }
        let alpha = rz / pq;
        add(alpha, &p, x);
        add(-alpha, &q, &mut r);
        preconditioner.apply(&r, &mut z);
        let rz_before = std::mem::replace(&mut rz, fast_dot(&r, &z));
        let beta = rz / rz_before;
        for (p, z) in p.iter_mut().zip(&z) {
            *p = z + beta * *p;
        }
    }
    unreachable!("the iterations are limited")
}

/// Checks the sizes and clears x; returns the number of unknowns.
pub(super) fn prepare(
    operator: &dyn LinearOperator,
    preconditioner: &dyn LinearOperator,
    b: &[f64],
    x: &mut [f64],
) -> usize {
    let n = operator.size();
    assert!(
        preconditioner.size() == n && b.len() == n && x.len() == n,
        "operator, preconditioner and vectors have one size"
    );
    x.fill(0.0);
    n
}

/// faer's dot product, in a fixed order of its own.
fn fast_dot(x: &[f64], y: &[f64]) -> f64 {
    ColRef::from_slice(x).transpose() * ColRef::from_slice(y)
}

/// y += a x.
fn add(a: f64, x: &[f64], y: &mut [f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += a * x;
    }
}

/// Solves A x = b, A symmetric or not, from a zero guess until ||r|| < tolerance ||b|| for the residual of the recurrence; x is
/// overwritten. An iteration needs two products.
pub fn stabilised_biconjugate_gradient(
    operator: &dyn LinearOperator,
    preconditioner: &dyn LinearOperator,
    b: &[f64],
    x: &mut [f64],
    tolerance: f64,
    max_iterations: usize,
) -> CgReport {
    let n = prepare(operator, preconditioner, b, x);
    let mut iterations = 0;
    let params = BicgParams {
        initial_guess: InitialGuessStatus::MaybeNonZero,
        rel_tolerance: tolerance,
        max_iters: max_iterations,
        ..BicgParams::default()
    };
    let (operator, preconditioner) = (Wrapped(operator), Wrapped(preconditioner));
    let identity = IdentityPrecond { dim: n };
    let scratch = bicg::bicgstab_scratch(&preconditioner, identity, &operator, 1, Par::Seq);
    let result = bicg::bicgstab(
        MatMut::from_column_major_slice_mut(x, n, 1),
        &preconditioner,
        identity,
        &operator,
        MatRef::from_column_major_slice(b, n, 1),
        params,
        |_| iterations += 1,
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(scratch)),
    );
    let end = match result {
        Ok(_) => CgEnd::Converged,
        Err(_) => CgEnd::IterationLimit,
    };
    CgReport::new(iterations, end, x)
}

impl CgReport {
    pub(super) fn new(iterations: usize, end: CgEnd, x: &[f64]) -> CgReport {
        CgReport { iterations, end: if x.iter().all(|v| v.is_finite()) { end } else { CgEnd::Breakdown } }
    }
}

/// Adapter of an operator for faer.
pub(super) struct Wrapped<'a>(pub(super) &'a dyn LinearOperator);

impl fmt::Debug for Wrapped<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "operator of size {}", self.0.size())
    }
}

impl LinOp<f64> for Wrapped<'_> {
    fn apply_scratch(&self, _rhs_ncols: usize, _par: Par) -> StackReq {
        StackReq::EMPTY
    }

    fn nrows(&self) -> usize {
        self.0.size()
    }

    fn ncols(&self) -> usize {
        self.0.size()
    }

    fn apply(&self, mut out: MatMut<'_, f64>, rhs: MatRef<'_, f64>, _par: Par, _stack: &mut MemStack) {
        for j in 0..rhs.ncols() {
            let x = rhs.col(j).try_as_col_major().expect("faer's work matrices are column major").as_slice();
            let y = out.as_mut().col_mut(j).try_as_col_major_mut().expect("faer's work matrices are column major");
            self.0.apply(x, y.as_slice_mut());
        }
    }

    fn conj_apply(&self, out: MatMut<'_, f64>, rhs: MatRef<'_, f64>, par: Par, stack: &mut MemStack) {
        self.apply(out, rhs, par, stack);
    }
}

impl Precond<f64> for Wrapped<'_> {}
