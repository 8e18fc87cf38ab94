//! Condition numbers of the matrices of a coupled system. For the 2-norm they are the largest eigenvalue by Lanczos's method over the smallest by
//! inverse iteration. For the 1-norm, which the thesis has, they are Hager's estimate. The inverse of each matrix is applied through the
//! Schur-complement form, (B + J S^-1 J^T) p = e + J S^-1 w. It is solved by conjugate gradients with multigrid on B and a factor of S:
//!
//! ```text
//! [B J; J^T -S] [p; v] = [e; w]                                     v = S^-1 (J^T p - w)
//! A [p; v] = [f; g] of thesis (5.25)  <=>  w = -Z1 Z2^-1 g, e = f + J Z2^-1 g
//! diag(1, alpha) A diag(1, alpha)     as thesis (5.36) scales
//! ```

use super::{Blocks, CoupledSystem, Multigrid};
use crate::Error;
use crate::linalg::{
    CgEnd, Cholesky, Csr, LinearOperator, Solve, SymbolicCholesky, conjugate_gradient, eigenvalues, inverse_one_norm,
    largest_magnitude, smallest_magnitude,
};

/// Tolerance of the recurrence of a solve.
const TOLERANCE: f64 = 1e-10;
const MOST_ITERATIONS: usize = 2000;
/// Rows of a matrix of which all eigenvalues are computed, too: some seconds.
const EXACT_UP_TO: usize = 2000;

/// Logarithms to base 10 of the condition numbers of a matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Condition {
    /// For the 2-norm.
    pub two_norm: f64,
    /// The same from all eigenvalues, up to 2,000 rows: shows the error of the iterations.
    pub two_norm_exact: Option<f64>,
    /// For the 1-norm, a lower bound.
    pub one_norm: f64,
}

/// Condition numbers of both forms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions {
    /// Matrix diag(1, alpha) \[B J; J^T -S\] diag(1, alpha).
    pub indefinite: Condition,
    /// Matrix of thesis (5.36).
    pub two_field: Condition,
}

/// Condition numbers of a system with the share sigma of the mass in Z1, and the factor alpha (Pa s/m) of the velocities' rows and columns.
///
/// # Errors
/// When a factor does not fit into memory, or an iteration does not converge.
pub fn conditions(system: &CoupledSystem, sigma: f64, alpha: f64) -> Result<Conditions, Error> {
    let blocks = system.blocks();
    let of_s = SymbolicCholesky::new(&blocks.s)?;
    let inverse = Inverse {
        multigrid: Multigrid::new(&system.pressure.stencil),
        scale: system.pressure.scale,
        factor: of_s.factorise(&blocks.s)?,
        transposed: blocks.j.transpose(),
        blocks: &blocks,
    };
    let n_cells = blocks.cells.len();
    let scaled = |x: &[f64], factor: f64| {
        let (of_p, of_v) = x.split_at(n_cells);
        let of_v: Vec<f64> = of_v.iter().map(|x| factor * x).collect();
        (of_p.to_vec(), of_v)
    };
    let joined = |(mut p, mut v): (Vec<f64>, Vec<f64>)| {
        v.iter_mut().for_each(|v| *v /= alpha);
        p.append(&mut v);
        p
    };
    let condition = |matrix: Csr, solve: Solve| {
        let n = matrix.n_rows();
        let scales: Vec<f64> = (0..n).map(|row| if row < n_cells { 1.0 } else { alpha }).collect();
        let matrix = matrix.scaled(&scales, &scales);
        let two_norm = largest_magnitude(&matrix)? / smallest_magnitude(n, solve)?;
        // In a symmetric matrix rows and columns have the same sums.
        let one_norm = matrix.infinity_norm() * inverse_one_norm(n, solve)?;
        let all = (n <= EXACT_UP_TO).then(|| eigenvalues(&matrix)).transpose()?;
        let exact = all.map(|all| {
            let sizes = all.iter().map(|value| value.abs());
            sizes.clone().fold(0.0, f64::max) / sizes.fold(f64::INFINITY, f64::min)
        });
        Ok::<Condition, Error>(Condition {
            two_norm: two_norm.log10(),
            two_norm_exact: exact.map(f64::log10),
            one_norm: one_norm.log10(),
        })
    };
    let z2 = blocks.z2(sigma);
    let of_z2 = SymbolicCholesky::new(&z2)?;
    let z2_factor = of_z2.factorise(&z2)?;
    let z1 = blocks.z1(sigma);
    Ok(Conditions {
        indefinite: condition(blocks.indefinite(), &mut |x| {
            let (e, w) = scaled(x, 1.0 / alpha);
            Ok(joined(inverse.solve(&e, &w)?))
        })?,
        two_field: condition(blocks.two_field(sigma)?, &mut |x| {
            let (mut e, mut over_z2) = scaled(x, 1.0 / alpha);
            z2_factor.solve(&mut over_z2);
            inverse.add_flux(&over_z2, &mut e);
            let w: Vec<f64> = over_z2.iter().zip(&z1).map(|(x, z1)| -z1 * x).collect();
            Ok(joined(inverse.solve(&e, &w)?))
        })?,
    })
}

/// The inverse of \[B J; J^T -S\].
struct Inverse<'a> {
    blocks: &'a Blocks,
    /// J^T.
    transposed: Csr,
    factor: Cholesky<'a>,
    multigrid: Multigrid,
    /// B over the multigrid's matrix.
    scale: f64,
}

impl Inverse<'_> {
    fn solve(&self, e: &[f64], w: &[f64]) -> Result<(Vec<f64>, Vec<f64>), Error> {
        let mut free = w.to_vec();
        self.factor.solve(&mut free);
        let mut rhs = e.to_vec();
        self.add_flux(&free, &mut rhs);
        let mut p = vec![0.0; rhs.len()];
        let preconditioner = OnCells(self);
        let report = conjugate_gradient(self, &preconditioner, &rhs, &mut p, TOLERANCE, MOST_ITERATIONS);
        if report.end != CgEnd::Converged {
            let n = e.len() + w.len();
            return Err(Error::input(
                format!("condition of a coupled system of {n} unknowns"),
                format!("inverse iteration cannot solve with it: {report:?}"),
                "use a coarser grid",
            ));
        }
        let mut v = vec![0.0; w.len()];
        self.transposed.multiply(&p, &mut v);
        v.iter_mut().zip(w).for_each(|(v, w)| *v -= w);
        self.factor.solve(&mut v);
        Ok((p, v))
    }

    /// Adds J v.
    fn add_flux(&self, v: &[f64], to: &mut [f64]) {
        let mut flux = vec![0.0; to.len()];
        self.blocks.j.multiply(v, &mut flux);
        to.iter_mut().zip(flux).for_each(|(to, flux)| *to += flux);
    }
}

/// B + J S^-1 J^T.
impl LinearOperator for Inverse<'_> {
    fn size(&self) -> usize {
        self.blocks.cells.len()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        let mut v = vec![0.0; self.transposed.n_rows()];
        self.transposed.multiply(x, &mut v);
        self.factor.solve(&mut v);
        self.blocks.b.multiply(x, y);
        self.add_flux(&v, y);
    }
}

/// The V-cycle on the active cells alone.
struct OnCells<'a>(&'a Inverse<'a>);

impl LinearOperator for OnCells<'_> {
    fn size(&self) -> usize {
        self.0.size()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        let (cells, n) = (&self.0.blocks.cells, self.0.multigrid.size());
        let (mut all, mut product) = (vec![0.0; n], vec![0.0; n]);
        for (&cell, x) in cells.iter().zip(x) {
            all[cell] = x / self.0.scale;
        }
        self.0.multigrid.apply(&all, &mut product);
        for (&cell, y) in cells.iter().zip(y) {
            *y = product[cell];
        }
    }
}
