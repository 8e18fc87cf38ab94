//! The pressure: the device's answer against a direct f64 solve of the system that it stored, and that system's answer against the
//! one of a system assembled in f64 from the same fields.
//!
//! The bounds are rigorous. B is an M-matrix, so |r| <= t in every cell makes |B^-1 r| <= B^-1 t there: one more solve, with the
//! allowed residual for its right-hand side, says how far off the pressure may be. In a component without a free surface one
//! cell is held; differences to it are bounded so, and pressures without the mean by twice the largest of them.

use super::{Both, DIRICHLET_ROUNDINGS, EPS, LiquidJudge, unit};
use crate::Error;
use crate::linalg::norm;
use crate::reference::{
    ActiveCells, PressureSystem, Stencil, remove_means, solve, solve_iterative,
};
use crate::scene::{Precision, Solver};
use crate::sim::LiquidSnapshot;
use crate::solver::rounding;

/// Relative residual of the f64 solves: negligible beside the device's.
const EXACT: f64 = 1e-12;
/// Relative residual of the solves for bounds, and what it may cost them.
const ROUGH: f64 = 1e-6;
const ROUGH_MARGIN: f64 = 1.01;

impl LiquidJudge<'_> {
    /// m/s of potential as pressure, Pa.
    pub(super) fn in_pascal(&self, potential: &[f64]) -> Vec<f64> {
        let scale = self.pascal();
        potential
            .iter()
            .map(|potential| scale * potential)
            .collect()
    }

    /// Pressure of a potential of 1 m/s, Pa.
    pub(super) fn pascal(&self) -> f64 {
        f64::from(self.step.density) * self.grid.dx / self.dt()
    }

    /// Rows `solve` and `assembly`. With solids the right-hand side is what they leave of it, b - J v for the velocity found, and its size
    /// for the tolerance what held nodes alone leave, from which the solve starts.
    pub(super) fn solve(
        &mut self,
        after: &LiquidSnapshot,
        both: Option<&Both>,
    ) -> Result<(), Error> {
        let grid = self.grid;
        let mut start = 0.0;
        if let Some(both) = both.filter(|both| both.touch()) {
            let open: Vec<bool> = (0..grid.n_cells())
                .map(|cell| after.active[cell] && !after.closed[cell])
                .collect();
            let [flux, gross] = both.flux(grid.dx, &open);
            let held = both.flux_of_held(grid.dx, &open);
            let left = self.before.rhs.iter().zip(&held);
            start = norm(&left.map(|(b, held)| b - held).collect::<Vec<f64>>());
            let (row, before) = (["solve", "E u* - J v", "m/s"], &self.before.rhs);
            self.table.cells(&grid, row, |cell| {
                let rounded = unit(after.real) * 8.0 * before[cell].abs();
                // Areas over dx^2 are f32, and so is the dx of this grid.
                let bound = (4.0 * EPS + 32.0 * unit(after.real)) * gross[cell] + rounded;
                open[cell].then_some((after.rhs[cell], before[cell] - flux[cell], bound))
            });
            for (rhs, flux) in self.twin.rhs.iter_mut().zip(flux) {
                *rhs -= flux;
            }
            self.twin.rhs_bound += 4.0 * EPS * gross.into_iter().fold(0.0, f64::max);
        }
        let mut twin_active = self
            .twin
            .active
            .take()
            .expect("active_cells comes before solve");
        // B alone does not know the level that a solid gives a component: it is taken from the device.
        let sealed = std::mem::take(&mut twin_active.sealed);
        twin_active.closed.extend(sealed.iter().cloned());
        let settings = Solver {
            tolerance: EXACT.min(1e-2 * self.scene.solver.tolerance),
            max_iterations: 10_000,
            ..self.scene.solver
        };
        let active = after.active_cells(&grid);
        let mut rhs = after.rhs.clone();
        remove_means(&active.closed, &mut rhs);
        let stored = unit_system(active, rhs, self.twin.flux);
        let assembled = unit_system(twin_active, self.twin.rhs.clone(), self.twin.flux);
        let (mut answer, _) = solve(&stored, &settings)?;
        let (mut twin, _) = solve(&assembled, &settings)?;
        for component in &sealed {
            let level = component.iter().map(|&cell| after.potential[cell]);
            let level = level.sum::<f64>() / component.len() as f64;
            for &cell in component {
                answer[cell] += level;
                twin[cell] += level;
            }
        }

        // What the true residual may be, and what rounding the answer to its scalar type adds to it.
        let mut target = (self.scene.solver.tolerance * norm(&stored.rhs).max(start))
            .max(rounding(&self.scene.solver) * stored.rhs_scale);
        let residual = norm(&stored.residual(&after.potential));
        let stored_as: Vec<f64> = after
            .potential
            .iter()
            .map(|x| unit(after.real) * x.abs())
            .collect();
        let spread = norm(&magnitudes(&stored.stencil, &stored_as));
        if start > 0.0 {
            // The verdict was on E u* - J v before its rounding.
            target += unit(after.real) * norm(&stored.rhs);
        }
        if self.scene.solver.precision == Precision::F32 {
            // Half of this passes as rounding of the unknowns; the device evaluates the residual with such roundings too.
            target = target.max(spread);
        }
        let pascal = self.pascal();
        let row = ["solve", "true residual", "m/s"];
        self.table.whole(row, residual, 0.0, target + spread);
        // No entry of a residual is larger than its norm.
        let allowed: Vec<f64> = stored
            .stencil
            .active_mask()
            .iter()
            .map(|&active| if active { target } else { 0.0 })
            .collect();
        let reach = majorant(&stored.stencil, &stored.closed, allowed);
        let cells = || (0..grid.n_cells()).filter(|&cell| stored.stencil.active(cell));
        let solve_bound = |cell: usize| pascal * (reach[cell] + stored_as[cell]);
        let in_system = |cell, numbers| stored.stencil.active(cell).then_some(numbers);
        let row = ["solve", "pressure", "Pa"];
        self.table.cells(&grid, row, |cell| {
            let (gpu, twin) = (pascal * after.potential[cell], pascal * answer[cell]);
            in_system(cell, (gpu, twin, solve_bound(cell)))
        });

        // B x is off by the roundings of the free-surface terms and of the right-hand side.
        let difference: Vec<f64> = (0..grid.n_cells())
            .map(|cell| {
                if !assembled.stencil.active(cell) {
                    return 0.0;
                }
                let surface = assembled.stencil.dirichlet[cell] * twin[cell].abs();
                self.twin.rhs_bound + DIRICHLET_ROUNDINGS * EPS * surface
            })
            .collect();
        let reach_of_assembly = majorant(&assembled.stencil, &assembled.closed, difference);
        let assembly_bound =
            |cell: usize| pascal * (reach_of_assembly[cell] + 1e3 * EXACT * twin[cell].abs());
        let row = ["assembly", "pressure", "Pa"];
        self.table.cells(&grid, row, |cell| {
            let (stored, twin) = (pascal * answer[cell], pascal * twin[cell]);
            in_system(cell, (stored, twin, assembly_bound(cell)))
        });
        self.twin.pressure_bound = cells()
            .map(|cell| solve_bound(cell) + assembly_bound(cell))
            .fold(0.0, f64::max);
        self.twin.pressure = self.in_pascal(&twin);
        self.twin.active = Some(ActiveCells {
            stencil: assembled.stencil,
            closed: assembled.closed,
            sealed: Vec::new(),
        });
        Ok(())
    }
}

/// The system in the units of the device: potential and right-hand side in m/s.
fn unit_system(active: ActiveCells, rhs: Vec<f64>, rhs_scale: f64) -> PressureSystem {
    PressureSystem {
        stencil: active.stencil,
        scale: 1.0,
        rhs,
        rhs_scale,
        closed: active.closed,
        sealed: active.sealed,
        taken: Vec::new(),
    }
}

/// |B| |x| per cell.
fn magnitudes(stencil: &Stencil, x: &[f64]) -> Vec<f64> {
    (0..x.len())
        .map(|cell| {
            let others = stencil.neighbours(cell);
            let sum: f64 = others
                .iter()
                .map(|&(other, weight)| weight * x[other].abs())
                .sum();
            stencil.diagonal[cell] * x[cell].abs() + sum
        })
        .collect()
}

/// Bound of |B^-1 r| per cell, given a bound of |r|.
fn majorant(stencil: &Stencil, closed: &[Vec<usize>], r: Vec<f64>) -> Vec<f64> {
    let mut dirichlet = stencil.dirichlet.clone();
    closed
        .iter()
        .for_each(|component| dirichlet[component[0]] += 1.0);
    let held = Stencil::new(stencil.grid, stencil.weight.clone(), dirichlet);
    let active = ActiveCells {
        stencil: held,
        closed: Vec::new(),
        sealed: Vec::new(),
    };
    let settings = Solver {
        tolerance: ROUGH,
        max_iterations: 10_000,
        ..Solver::default()
    };
    let (mut bound, _) = solve_iterative(&unit_system(active, r, 0.0), &settings);
    for component in closed {
        let largest = component
            .iter()
            .map(|&cell| bound[cell])
            .fold(0.0, f64::max);
        component
            .iter()
            .for_each(|&cell| bound[cell] = 2.0 * largest);
    }
    bound.iter_mut().for_each(|bound| *bound *= ROUGH_MARGIN);
    bound
}
