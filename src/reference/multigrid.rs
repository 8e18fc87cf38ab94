//! One symmetric V-cycle of aggregation multigrid: H ~ A^-1, the preconditioner of the pressure solve in f64.
//!
//! A coarse cell aggregates 2 x 2 x 2 cells. Its face weight is half the sum of the four fine ones, its Dirichlet term
//! half the sum of the eight. The half is over-correction. In three dimensions, piecewise constant corrections of a
//! smooth error are about half as large as they should be (Stueben 2001, Shao et al. 2022). Restriction sums over an
//! aggregate, prolongation injects into it. Two Jacobi sweeps with scheduled weights (Yang and Mittal 2014) precede the
//! correction. The same sweeps in reversed order follow it, so that the cycle is symmetric, as conjugate gradients
//! require.

use rayon::prelude::*;

use super::pressure_system::Stencil;
use crate::grid::{Axis, Grid};
use crate::linalg::LinearOperator;

/// Weights of the sweeps before the coarse correction, reversed after it. Together they damp errors of the upper
/// spectrum of D^-1 A in (0, 2] below 0.35.
const SWEEPS: [f64; 2] = [1.7319, 0.5695];
/// Repetitions of the pair of sweeps on the coarsest level, which has one cell. From a zero guess any sequence of
/// sweeps is symmetric.
const COARSEST_PAIRS: usize = 4;

/// The levels of the hierarchy, finest first.
#[derive(Clone, Debug)]
pub struct Multigrid {
    levels: Vec<Stencil>,
}

impl Multigrid {
    /// Builds the hierarchy down to one cell.
    pub fn new(finest: &Stencil) -> Multigrid {
        let mut levels = vec![finest.clone()];
        while levels[levels.len() - 1].grid.cells != [1; 3] {
            levels.push(coarsen(&levels[levels.len() - 1]));
        }
        Multigrid { levels }
    }

    /// The levels, finest first.
    pub fn levels(&self) -> &[Stencil] {
        &self.levels
    }

    /// Approximates the solution of A x = b on a level from a zero guess.
    fn cycle(&self, level: usize, b: &[f64]) -> Vec<f64> {
        let stencil = &self.levels[level];
        let mut x = vec![0.0; b.len()];
        if level + 1 == self.levels.len() {
            for weight in SWEEPS.repeat(COARSEST_PAIRS) {
                x = sweep(stencil, weight, b, &x);
            }
            return x;
        }
        for weight in SWEEPS {
            x = sweep(stencil, weight, b, &x);
        }
        let correction = self.cycle(level + 1, &restrict(stencil, &self.levels[level + 1].grid, b, &x));
        prolong(stencil, &self.levels[level + 1].grid, &correction, &mut x);
        for &weight in SWEEPS.iter().rev() {
            x = sweep(stencil, weight, b, &x);
        }
        x
    }
}

impl LinearOperator for Multigrid {
    fn size(&self) -> usize {
        self.levels[0].size()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        y.copy_from_slice(&self.cycle(0, x));
    }
}

/// The next coarser level.
fn coarsen(fine: &Stencil) -> Stencil {
    let grid = Grid { cells: fine.grid.cells.map(|n| n.div_ceil(2)), dx: 2.0 * fine.grid.dx };
    let mut dirichlet = vec![0.0; grid.n_cells()];
    for (cell, value) in fine.dirichlet.iter().enumerate() {
        dirichlet[aggregate(&fine.grid, &grid, cell)] += 0.5 * value;
    }
    let weight = Axis::ALL.map(|axis| {
        let mut coarse = vec![0.0; grid.n_faces(axis)];
        for (face, value) in fine.weight[axis.index()].iter().enumerate() {
            let ijk = fine.grid.face_at(axis, face);
            // Faces inside an aggregate vanish; those between two aggregates have even indices.
            if ijk[axis.index()].is_multiple_of(2) {
                coarse[grid.face(axis, ijk.map(|n| n / 2))] += 0.5 * value;
            }
        }
        coarse
    });
    Stencil::new(grid, weight, dirichlet)
}

/// The coarse cell of a fine cell.
fn aggregate(fine: &Grid, coarse: &Grid, cell: usize) -> usize {
    coarse.cell(fine.cell_at(cell).map(|n| n / 2))
}

/// One weighted Jacobi sweep: x + weight (b - A x) / diagonal, 0 in inactive cells.
fn sweep(stencil: &Stencil, weight: f64, b: &[f64], x: &[f64]) -> Vec<f64> {
    per_active_cell(stencil, |cell| x[cell] + weight * (b[cell] - stencil.product(x, cell)) / stencil.diagonal[cell])
}

/// Sums the residual b - A x over the aggregates.
fn restrict(fine: &Stencil, coarse: &Grid, b: &[f64], x: &[f64]) -> Vec<f64> {
    let residual = per_active_cell(fine, |cell| b[cell] - fine.product(x, cell));
    let mut sums = vec![0.0; coarse.n_cells()];
    for (cell, value) in residual.iter().enumerate() {
        sums[aggregate(&fine.grid, coarse, cell)] += value;
    }
    sums
}

/// Adds the coarse corrections to their active cells.
fn prolong(fine: &Stencil, coarse: &Grid, correction: &[f64], x: &mut [f64]) {
    x.par_iter_mut().with_min_len(4096).enumerate().filter(|(cell, _)| fine.active(*cell)).for_each(|(cell, value)| {
        *value += correction[aggregate(&fine.grid, coarse, cell)];
    });
}

fn per_active_cell(stencil: &Stencil, value: impl Fn(usize) -> f64 + Sync) -> Vec<f64> {
    let cells = (0..stencil.grid.n_cells()).into_par_iter().with_min_len(4096);
    cells.map(|cell| if stencil.active(cell) { value(cell) } else { 0.0 }).collect()
}
