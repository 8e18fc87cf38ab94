//! The pressure in two comparisons: the device's solution against a direct f64 solve of the stored system, and that solve against one of a system
//! assembled in f64 from the same fields.
//!
//! The bounds are rigorous. B is an M-matrix, so |r| <= t in every cell implies |B^-1 r| <= B^-1 t there. One more solve, with the allowed
//! residual as right-hand side, bounds the error of the pressure. In an enclosed component one cell is fixed; this bounds the differences to it.
//! Pressures without the mean are off by at most twice the largest of these.

use super::super::table::number;
use super::{Both, DIRICHLET_ROUNDINGS, EPS, LiquidComparison, largest, unit};
use crate::Error;
use crate::geometry::SolidClip;
use crate::linalg::norm;
use crate::reference::{ActiveCells, PressureSystem, RightHandSide, Stencil, remove_means, solve, solve_iterative};
use crate::scene::{Precision, Solver};
use crate::sim::LiquidSnapshot;
use crate::solver::rounding;

/// Relative residual of the f64 solves: negligible beside the device's.
const EXACT: f64 = 1e-12;
/// Relative residual of the solves for bounds, and a margin for it.
const ROUGH: f64 = 1e-6;
const ROUGH_MARGIN: f64 = 1.01;

impl LiquidComparison<'_> {
    /// Pressure of a potential of 1 m/s, Pa.
    pub(super) fn pascal(&self) -> f64 {
        f64::from(self.step.density) * self.grid.dx / self.dt()
    }

    /// Before `solve` is compared: enclosed components with a separated cell are open. Their right-hand side gets back its mean, as in
    /// [`PressureSystem::take_growing`], and a row says whether their room grows as it must.
    pub(in super::super) fn release(&mut self, after: &LiquidSnapshot, clip: Option<&SolidClip>, both: Option<&Both>) {
        let grid = self.grid;
        let Some(active) = &mut self.twin.active else { return };
        let separates = |component: &Vec<usize>| component.iter().any(|&cell| after.separated.get(cell) == Some(&true));
        let (opened, closed) = std::mem::take(&mut active.closed).into_iter().partition(separates);
        active.closed = closed;
        let mut taken = vec![0.0; grid.n_cells()];
        let obstacles = clip.map_or(&[][..], |clip| clip.obstacles().flux()).iter().copied();
        let sources = self.taps.boundary_flux(&grid, clip.map(|clip| &clip.cut_cells().open), self.running.running);
        obstacles.chain(sources).for_each(|(cell, flux)| taken[cell] += flux / (grid.dx * grid.dx));
        let by_solids = both.map(|both| both.flux(grid.dx, &after.active)).map(|[_, _, constrained]| constrained);
        for component in &opened {
            let sum = |flux: &[f64]| component.iter().map(|&cell| flux[cell]).sum::<f64>();
            let grows = sum(&taken) + by_solids.as_deref().map_or(0.0, sum) > 0.0;
            self.table.whole(["opened components", "flag"], 1.0, number(grows), 0.0);
            let mean = sum(&taken) / component.len() as f64;
            for &cell in component {
                self.twin.rhs[cell] = self.twin.rhs_of_liquid[cell] - mean;
                self.before.rhs[cell] = self.twin.rhs[cell];
            }
        }
        self.twin.opened = vec![false; grid.n_cells()];
        opened.iter().flatten().for_each(|&cell| self.twin.opened[cell] = true);
    }

    /// The unknowns as the device stores them.
    pub(super) fn stored(&self, after: &LiquidSnapshot) -> ActiveCells {
        let mut stored = after.active_cells(&self.grid);
        let opened = &self.twin.opened;
        stored.closed.retain(|component| !component.iter().any(|&cell| opened[cell]));
        stored
    }

    /// Rows `solve` and `assembly`. With solids the right-hand side is b - J v for the computed v. The tolerance then refers to b less the flux of
    /// constrained nodes, from which the solve starts.
    pub(super) fn solve(&mut self, after: &LiquidSnapshot, both: Option<&Both>) -> Result<(), Error> {
        let start = match both.filter(|both| both.touch()) {
            Some(both) => self.subtract_flux(after, both),
            None => 0.0,
        };
        let mut twin_active = self.twin.active.take().expect("active_cells comes before solve");
        // B alone does not determine the pressure level of a component beside solids: it is taken from the device.
        twin_active.closed.append(&mut twin_active.sealed);
        let solver = self.scene.solver;
        let settings = Solver { tolerance: EXACT.min(1e-2 * solver.tolerance), max_iterations: 10_000, ..solver };
        let active = self.stored(after);
        let mut rhs = after.rhs.clone();
        remove_means(&active.closed, &mut rhs);
        // The pressure depends on the data continuously, the set of separated cells does not: it is the device's.
        let stored = unit_system(active, rhs, self.twin.flux).masked(&after.separated);
        let unmasked = unit_system(twin_active, self.twin.rhs.clone(), self.twin.flux);
        let assembled = unmasked.masked(&after.separated);
        // The device sums the free-surface terms beside separated cells again.
        let terms = assembled.stencil.dirichlet.iter().zip(&unmasked.stencil.dirichlet).zip(&after.potential);
        let summed = terms.filter(|((term, before), _)| term != before);
        let summed = summed.map(|((term, _), phi)| DIRICHLET_ROUNDINGS * EPS * term * phi.abs());
        let start = (start, norm(&summed.collect::<Vec<_>>()));
        let (mut solution, _) = solve(&stored, &settings)?;
        let (mut twin, _) = solve(&assembled, &settings)?;
        for component in &stored.closed {
            let potential = component.iter().map(|&cell| after.potential[cell]);
            let mean = potential.clone().sum::<f64>() / component.len() as f64;
            if after.closed[component[0]] {
                let level =
                    if self.effects().separation { potential.clone().fold(f64::INFINITY, f64::min) } else { mean };
                let bound = 4.0 * EPS * largest(potential.map(f64::abs));
                self.table.whole(["level of enclosed liquid", "m/s"], level, 0.0, bound);
            }
            for &cell in component {
                solution[cell] += mean;
                twin[cell] += mean;
            }
        }
        let solve_bounds = self.compare_stored(after, &stored, &solution, start);
        self.compare_assembled(&stored, &solution, &assembled, &twin, solve_bounds);
        self.twin.pressure = twin.iter().map(|phi| self.pascal() * phi).collect();
        self.twin.active =
            Some(ActiveCells { stencil: assembled.stencil, closed: assembled.closed, sealed: Vec::new() });
        Ok(())
    }

    /// Row `E u* - J v`; subtracts J v from the twin's right-hand side. Norm of b less the flux of constrained nodes, m/s.
    fn subtract_flux(&mut self, after: &LiquidSnapshot, both: &Both) -> f64 {
        let grid = self.grid;
        let open: Vec<bool> = (0..grid.n_cells()).map(|cell| after.active[cell] && !after.closed[cell]).collect();
        let [flux, gross, constrained] = both.flux(grid.dx, &open);
        let before = &self.before.rhs;
        let left: Vec<f64> = before.iter().zip(&constrained).map(|(b, constrained)| b - constrained).collect();
        let opened = &self.twin.opened;
        let reassembled = |cell: usize| if opened[cell] { self.twin.rhs_bound } else { 0.0 };
        self.table.cells(["E u* - J v", "m/s"], |cell| {
            let rounded = unit(after.real) * 8.0 * before[cell].abs();
            // Areas over dx^2 are f32, and so is the dx of this grid.
            let bound = (4.0 * EPS + 32.0 * unit(after.real)) * gross[cell] + rounded + reassembled(cell);
            open[cell].then_some((after.rhs[cell], before[cell] - flux[cell], bound))
        });
        for (rhs, flux) in self.twin.rhs.iter_mut().zip(flux) {
            *rhs -= flux;
        }
        self.twin.rhs_bound += 4.0 * EPS * largest(gross);
        norm(&left)
    }

    /// The device's solution against that of the stored system; its bounds per cell, Pa.
    fn compare_stored(
        &mut self,
        after: &LiquidSnapshot,
        stored: &PressureSystem,
        solution: &[f64],
        (start, summed): (f64, f64),
    ) -> Vec<f64> {
        let solver = &self.scene.solver;
        let eps = unit(after.real);
        // The allowed true residual, and the effect of rounding the solution to its scalar type.
        let mut target =
            (solver.tolerance * norm(&stored.rhs).max(start)).max(rounding(solver) * stored.rhs_scale) + summed;
        let residual = norm(&stored.residual(&after.potential));
        let rounded: Vec<f64> = after.potential.iter().map(|x| eps * x.abs()).collect();
        let spread = norm(&magnitudes(&stored.stencil, &rounded));
        if start > 0.0 {
            // The device tested E u* - J v before its rounding.
            target += eps * norm(&stored.rhs);
        }
        if solver.precision == Precision::F32 {
            // Half of this passes as rounding of the unknowns; the device evaluates the residual with such roundings too.
            target = target.max(spread);
        }
        self.table.whole(["true residual", "m/s"], residual, 0.0, target + spread);
        // No entry of a residual exceeds its norm.
        let mask = stored.stencil.active_mask();
        let allowed = mask.iter().map(|&active| if active { target } else { 0.0 });
        let reach = majorant(&stored.stencil, &stored.closed, allowed.collect());
        let pascal = self.pascal();
        let bounds: Vec<f64> = reach.iter().zip(&rounded).map(|(reach, rounded)| pascal * (reach + rounded)).collect();
        self.table.cells(["pressure", "Pa"], |cell| {
            let (gpu, twin) = (pascal * after.potential[cell], pascal * solution[cell]);
            mask[cell].then_some((gpu, twin, bounds[cell]))
        });
        bounds
    }

    /// The solution of the stored system against that of the assembled one. B x is off by the roundings of the free-surface terms and of the right-hand
    /// side.
    fn compare_assembled(
        &mut self,
        stored: &PressureSystem,
        solution: &[f64],
        assembled: &PressureSystem,
        twin: &[f64],
        solve_bounds: Vec<f64>,
    ) {
        let (grid, pascal) = (self.grid, self.pascal());
        let surface = |cell: usize| assembled.stencil.dirichlet[cell] * twin[cell].abs();
        let difference = |cell: usize| match assembled.stencil.active(cell) {
            true => self.twin.rhs_bound + DIRICHLET_ROUNDINGS * EPS * surface(cell),
            false => 0.0,
        };
        let differences = (0..grid.n_cells()).map(difference).collect();
        let reach = majorant(&assembled.stencil, &assembled.closed, differences);
        let bound = |cell: usize| pascal * (reach[cell] + 1e3 * EXACT * twin[cell].abs());
        self.table.stage = "assembly";
        self.table.cells(["pressure", "Pa"], |cell| {
            stored.stencil.active(cell).then_some((pascal * solution[cell], pascal * twin[cell], bound(cell)))
        });
        let cells = (0..grid.n_cells()).filter(|&cell| stored.stencil.active(cell));
        self.twin.pressure_bound = largest(cells.map(|cell| solve_bounds[cell] + bound(cell)));
    }
}

/// The system in the units of the device: potential and right-hand side in m/s.
pub(super) fn unit_system(active: ActiveCells, values: Vec<f64>, scale: f64) -> PressureSystem {
    PressureSystem { scale: 1.0, ..PressureSystem::new(active, RightHandSide { values, scale }, 1.0, 1.0) }
}

/// |B| |x| per cell.
fn magnitudes(stencil: &Stencil, x: &[f64]) -> Vec<f64> {
    let magnitude = |cell: usize| {
        let others = stencil.neighbours(cell).into_iter().map(|(at, weight)| weight * x[at].abs());
        stencil.diagonal[cell] * x[cell].abs() + others.sum::<f64>()
    };
    (0..x.len()).map(magnitude).collect()
}

/// Bound of |B^-1 r| per cell, given a bound of |r|.
fn majorant(stencil: &Stencil, closed: &[Vec<usize>], r: Vec<f64>) -> Vec<f64> {
    let mut dirichlet = stencil.dirichlet.clone();
    for component in closed {
        dirichlet[component[0]] += 1.0;
    }
    let stencil = Stencil::new(stencil.grid, stencil.weight.clone(), dirichlet);
    let active = ActiveCells { stencil, closed: Vec::new(), sealed: Vec::new() };
    let settings = Solver { tolerance: ROUGH, max_iterations: 10_000, ..Solver::default() };
    let (mut bound, _) = solve_iterative(&unit_system(active, r, 0.0), &settings);
    for component in closed {
        let most = largest(component.iter().map(|&cell| bound[cell]));
        component.iter().for_each(|&cell| bound[cell] = 2.0 * most);
    }
    bound.iter_mut().for_each(|bound| *bound *= ROUGH_MARGIN);
    bound
}
