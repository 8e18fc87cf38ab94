//! Separation: liquid that leaves walls, obstacles and solids instead of being pulled along (Batty et al. 2007).
//!
//! With w_c (m^3/s) the rate at which a cell opens, and Gamma the cells that touch a wall or a body,
//!
//! ```text
//! w = B p + J v - E u*,    0 <= p_c, 0 <= w_c and p_c w_c = 0 in Gamma,    w_c = 0 elsewhere
//! ```
//!
//! A primal-dual active set solves it. The separated cells A have p = 0 at their centres and are no unknowns. Each round solves
//! for the other cells, separates cells of Gamma with p < 0, and lets cells of A with w < 0 back. B is an M-matrix, so
//! without solids a cell enters A at most once. J S^-1 J^T breaks that: cells let back in late rounds do not separate again.
//!
//! p_c w_c = 0 makes the correction of the velocity orthogonal to the result, so separation adds no kinetic energy.

use glam::DVec3;

use super::patch_pressure::PatchForces;
use super::pressure_system::{PressureSystem, Stencil};
use super::solve::solve;
use crate::Error;
use crate::geometry::SolidClip;
use crate::grid::{Axis, Grid};
use crate::scene::Solver;
use crate::state::{SeparationReport, SolveReport, SolveStatus};

/// Largest number of rounds.
const MAX_ROUNDS: u32 = 12;
/// First round whose cells, once let back, do not separate again.
const LOCK_ROUND: u32 = 6;
/// Fraction of the largest pressure below which a negative one is rounding.
const ROUNDING: f64 = 1e-6;

/// The cells that may separate and those that do.
#[derive(Clone, Debug)]
pub struct Separation {
    /// Gamma.
    candidates: Vec<bool>,
    /// Cells that join Gamma beside separated ones, and the face apertures, where liquid separates from air only.
    beyond: Option<(Vec<bool>, [Vec<f64>; 3])>,
    /// A.
    cells: Vec<bool>,
    /// Whether the last solution satisfies the conditions of its set.
    settled: bool,
    /// Sum of w over A, m^3/s.
    rate: f64,
    /// On the right-hand side of solids, also from cells of A.
    patch_forces: PatchForces,
    /// Cells that were in A in any round. They exert no such force, also when let back: a force that comes and goes with A keeps the search from settling.
    relieved: Vec<bool>,
    report: SeparationReport,
}

/// Where liquid may separate, and what did in the last sub-step.
#[derive(Clone, Copy, Debug)]
pub struct Candidates<'a> {
    /// Cells that touch a wall or a body, from [`touching_cells`].
    pub touching: &'a [bool],
    /// Face apertures where only cells beside air, and beside cells that separate, may separate.
    pub from_air: Option<&'a [Vec<f64>; 3]>,
    /// Cells that separated in the last sub-step; empty for none.
    pub before: &'a [bool],
}

/// Solution of a round.
pub(super) struct Round<S> {
    pub(super) solution: S,
    /// Pa.
    pub(super) pressure: Vec<f64>,
    /// J v of all nodes, m^3/s per cell; empty without solids.
    pub(super) flux: Vec<f64>,
}

impl Separation {
    /// The first active set: what separated before, and the cells of [`PressureSystem::take_growing`].
    pub fn new(system: &PressureSystem, with: Candidates, receding: &[usize]) -> Separation {
        let stencil = &system.stencil;
        let mut may = vec![true; with.touching.len()];
        let enclosed = system.closed.iter().chain(&system.sealed);
        enclosed.flatten().for_each(|&cell| may[cell] = false);
        let mut before = with.before.to_vec();
        before.resize(may.len(), false);
        receding.iter().for_each(|&cell| before[cell] = true);
        let separated = |cell: usize| before[cell];
        let candidates: Vec<bool> = (0..may.len())
            .map(|cell| {
                let air = |open| beside_air(stencil, open, separated, cell);
                let touches = with.touching[cell] && stencil.active(cell);
                may[cell] && touches && with.from_air.is_none_or(air)
            })
            .collect();
        let beyond = with.from_air.map(|open| {
            let joins = |cell: usize| may[cell] && with.touching[cell] && stencil.active(cell);
            ((0..may.len()).map(joins).collect(), open.clone())
        });
        let cells: Vec<bool> = (0..may.len()).map(|cell| candidates[cell] && before[cell]).collect();
        Separation {
            candidates,
            beyond,
            relieved: cells.clone(),
            cells,
            settled: true,
            rate: 0.0,
            patch_forces: PatchForces::default(),
            report: SeparationReport::default(),
        }
    }

    /// The same with the forces of [`patch_pressure`](super::patch_pressure) on solids, which relieved cells do not exert.
    pub fn beside_solids(self, patch_forces: &PatchForces) -> Separation {
        Separation { patch_forces: patch_forces.clone(), ..self }
    }

    /// Minus the forces of the relieved cells, to be added to the right-hand side of solids, N, three numbers per node; `None` where they are 0.
    pub(super) fn relief(&self) -> Option<Vec<f64>> {
        let relieved = |cell: usize| self.relieved[cell];
        let forces = || self.patch_forces.sum_over(relieved).into_iter();
        self.patch_forces.has(relieved).then(|| forces().flat_map(|force| (-force).to_array()).collect())
    }

    /// The forces on solids that are left, N per node.
    pub fn patch_forces(&self) -> Vec<DVec3> {
        self.patch_forces.sum_over(|cell| !self.relieved[cell])
    }

    /// Gamma.
    pub fn candidates(&self) -> &[bool] {
        &self.candidates
    }

    /// A.
    pub fn cells(&self) -> &[bool] {
        &self.cells
    }

    /// Solves for the pressure alone. `system` has all cells as unknowns.
    ///
    /// # Errors
    /// As [`solve`].
    pub fn solve(&mut self, system: &PressureSystem, settings: &Solver) -> Result<(Vec<f64>, SolveReport), Error> {
        let mut iterations = 0;
        let last = self.search(system, settings.tolerance, |masked, _| {
            let (pressure, mut solution) = solve(masked, settings)?;
            iterations += solution.iterations;
            solution.iterations = iterations;
            Ok(Round { solution, pressure, flux: Vec::new() })
        })?;
        Ok((last.pressure, last.solution))
    }

    /// Repeats a solve until the set is unchanged. Returns the last round, whose set stays in `cells`. `solve` gets the system of a round and
    /// [`Separation::relief`].
    pub(super) fn search<S>(
        &mut self,
        system: &PressureSystem,
        tolerance: f64,
        mut solve: impl FnMut(&PressureSystem, Option<Vec<f64>>) -> Result<Round<S>, Error>,
    ) -> Result<Round<S>, Error> {
        let mut locked = vec![false; self.cells.len()];
        for round in 1.. {
            let solved = solve(&system.masked(&self.cells), self.relief())?;
            let opening = opening(system, &solved.pressure, &solved.flux);
            let largest = |values: &[f64]| values.iter().fold(0.0, |max: f64, x| max.max(x.abs()));
            let least_pressure = -ROUNDING * largest(&solved.pressure);
            let least_opening = -tolerance * largest(&system.rhs).max(largest(&solved.flux));
            let all = 0..self.cells.len();
            let [added, returned]: [Vec<usize>; 2] = [
                all.clone()
                    .filter(|&cell| self.candidates[cell] && !self.cells[cell] && !locked[cell])
                    .filter(|&cell| solved.pressure[cell] < least_pressure)
                    .collect(),
                all.clone().filter(|&cell| self.cells[cell] && opening[cell] < least_opening).collect(),
            ];
            self.report.rounds += 1;
            self.settled = added.is_empty() && returned.is_empty();
            if self.settled || round == MAX_ROUNDS {
                let mut open = system.stencil.active_mask();
                system.closed.iter().chain(&system.sealed).flatten().for_each(|&cell| open[cell] = false);
                let pressures = all.clone().filter(|&cell| open[cell]).map(|cell| solved.pressure[cell]);
                self.report.least_pressure = pressures.reduce(f64::min).unwrap_or_default();
                let separated = all.filter(|&cell| self.cells[cell]);
                self.rate = separated.map(|cell| opening[cell]).sum();
                return Ok(solved);
            }
            self.report.returned += returned.len();
            for cell in added {
                self.cells[cell] = true;
                self.relieved[cell] = true;
            }
            for cell in returned {
                self.cells[cell] = false;
                locked[cell] |= round >= LOCK_ROUND;
            }
            if round < LOCK_ROUND {
                self.grow(&system.stencil);
            }
        }
        unreachable!("the last round returns")
    }

    /// Adds the cells to Gamma that now have a separated one beside them.
    fn grow(&mut self, stencil: &Stencil) {
        let Separation { candidates, beyond, cells, .. } = self;
        let Some((joins, open)) = beyond else {
            return;
        };
        for (cell, candidate) in candidates.iter_mut().enumerate().filter(|(cell, _)| joins[*cell]) {
            *candidate = *candidate || beside_air(stencil, open, |at| cells[at], cell);
        }
    }

    /// The report of a solve, with the status `Unsettled` where the rounds ended too early.
    pub fn flagged(&self, report: SolveReport) -> SolveReport {
        let status = match report.status {
            SolveStatus::Converged if !self.settled => SolveStatus::Unsettled,
            status => status,
        };
        SolveReport { status, ..report }
    }

    /// The report of a sub-step of dt (s).
    pub fn report(&self, dt: f64) -> SeparationReport {
        SeparationReport {
            cells: self.cells.iter().filter(|separated| **separated).count(),
            opened: dt * self.rate,
            ..self.report
        }
    }
}

/// w = B p + J v - E u* per cell, m^3/s. `flux`: J v; empty without solids.
pub fn opening(system: &PressureSystem, pressure: &[f64], flux: &[f64]) -> Vec<f64> {
    let mut opening = system.residual(pressure);
    opening.iter_mut().for_each(|w| *w = -*w);
    opening.iter_mut().zip(flux).for_each(|(w, flux)| *w += flux);
    opening
}

/// Cells with a face at a wall, a body or a source, or with a patch of a solid's surface. `open`: face apertures for the pressure, 0
/// on walls of the domain and on sources, 1 on open sides.
pub fn touching_cells(grid: &Grid, open: &[Vec<f64>; 3], clip: Option<&SolidClip>) -> Vec<bool> {
    let beside = |cell: usize| {
        Axis::ALL.into_iter().any(|axis| {
            let here = grid.cell_at(cell);
            let mut next = here;
            next[axis.index()] += 1;
            [here, next].map(|at| open[axis.index()][grid.face(axis, at)]) != [1.0; 2]
        })
    };
    let mut touching: Vec<bool> = (0..grid.n_cells()).map(beside).collect();
    if let Some(clip) = clip {
        let patches = clip.coupling().cells();
        patches.for_each(|(cell, _)| touching[cell] = true);
    }
    touching
}

/// Whether a cell has air, or a cell that separated before, among the 26 neighbours that it reaches through open faces.
fn beside_air(stencil: &Stencil, open: &[Vec<f64>; 3], separated: impl Fn(usize) -> bool, cell: usize) -> bool {
    let grid = &stencil.grid;
    let here = grid.cell_at(cell);
    let ranges: [_; 3] = std::array::from_fn(|b| here[b].saturating_sub(1)..=(here[b] + 1).min(grid.cells[b] - 1));
    let [is, js, ks] = ranges;
    let around = ks.flat_map(|k| {
        let is = &is;
        js.clone().flat_map(move |j| is.clone().map(move |i| [i, j, k]))
    });
    let has_air = |at: [usize; 3]| {
        let cell = grid.cell(at);
        (!stencil.active(cell) || separated(cell)) && reaches(grid, open, here, at)
    };
    stencil.dirichlet[cell] > 0.0 || around.into_iter().any(has_air)
}

/// Whether open faces lead from a cell to another one beside it, one axis after another.
fn reaches(grid: &Grid, open: &[Vec<f64>; 3], from: [usize; 3], to: [usize; 3]) -> bool {
    let crosses = |axis: Axis| {
        let a = axis.index();
        let (mut face, mut next) = (from, from);
        face[a] = from[a].max(to[a]);
        next[a] = to[a];
        from[a] != to[a] && open[a][grid.face(axis, face)] > 0.0 && reaches(grid, open, next, to)
    };
    from == to || Axis::ALL.into_iter().any(crosses)
}
