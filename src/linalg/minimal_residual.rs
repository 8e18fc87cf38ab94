//! Preconditioned MINRES (Paige and Saunders 1975; Elman, Silvester and Wathen 2014, algorithm 4.1) for indefinite symmetric
//! matrices, which faer lacks.

use super::conjugate_gradient::prepare;
use super::{CgEnd, CgReport, LinearOperator, dot};

/// Solves A x = b, A symmetric, from a zero guess; x is overwritten.
///
/// Stops when the residual of the recurrence, in the norm of the positive definite preconditioner, has fallen by `tolerance`.
pub fn minimal_residual(
    operator: &dyn LinearOperator,
    preconditioner: &dyn LinearOperator,
    b: &[f64],
    x: &mut [f64],
    tolerance: f64,
    max_iterations: usize,
) -> CgReport {
    let n = prepare(operator, preconditioner, b, x);
    // Lanczos vectors v of the preconditioned operator, previous and current; z = H v; gamma are their norms in H.
    let (mut v_last, mut v) = (vec![0.0; n], b.to_vec());
    let mut z = vec![0.0; n];
    preconditioner.apply(&v, &mut z);
    let squared = dot(&z, &v);
    if squared == 0.0 {
        return CgReport::new(0, CgEnd::Converged, x);
    }
    let (mut gamma_last, mut gamma) = (1.0, squared.sqrt());
    let target = tolerance * gamma;
    let mut eta = gamma;
    // Cosines and sines of the Givens rotations of the tridiagonal matrix.
    let ([mut c_last, mut c], [mut s_last, mut s]) = ([1.0; 2], [0.0; 2]);
    let (mut w_last, mut w) = (vec![0.0; n], vec![0.0; n]);
    let mut product = vec![0.0; n];
    for iterations in 1..=max_iterations {
        z.iter_mut().for_each(|z| *z /= gamma);
        operator.apply(&z, &mut product);
        let delta = dot(&product, &z);
        for i in 0..n {
            let next = product[i] - delta / gamma * v[i] - gamma / gamma_last * v_last[i];
            v_last[i] = v[i];
            v[i] = next;
        }
        let z_now = z.clone();
        preconditioner.apply(&v, &mut z);
        let squared = dot(&z, &v);
        // The preconditioner is not positive definite, or a value is not finite.
        if squared.is_nan() || squared < 0.0 {
            return CgReport::new(iterations, CgEnd::Breakdown, x);
        }
        let gamma_next = squared.sqrt();
        let alpha_0 = c * delta - c_last * s * gamma;
        let alpha_1 = alpha_0.hypot(gamma_next);
        let alpha_2 = s * delta + c_last * c * gamma;
        let alpha_3 = s_last * gamma;
        if alpha_1 == 0.0 {
            return CgReport::new(iterations, CgEnd::Breakdown, x);
        }
        (c_last, s_last) = (c, s);
        (c, s) = (alpha_0 / alpha_1, gamma_next / alpha_1);
        for i in 0..n {
            let next = (z_now[i] - alpha_3 * w_last[i] - alpha_2 * w[i]) / alpha_1;
            w_last[i] = w[i];
            w[i] = next;
            x[i] += c * eta * next;
        }
        eta *= -s;
        if eta.abs() <= target {
            return CgReport::new(iterations, CgEnd::Converged, x);
        }
        (gamma_last, gamma) = (gamma, gamma_next);
    }
    CgReport::new(max_iterations, CgEnd::IterationLimit, x)
}
