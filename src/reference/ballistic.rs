//! Ballistic liquid and bodies. Liquid: a component of active cells without a face at a wall, a solid or a source.
//! Bodies: without constraints and loads, out of the liquid, and away from walls and obstacles.
//!
//! A sub-step moves everything by dt v and then adds dt g to v. Free fall is then late by dt g / 2 times the time.
//! Ballistic liquid and bodies move by dt v + dt^2 g / 2, which is exact.

use glam::DVec3;

use super::active_cells::components;
use super::pressure_system::Stencil;
use crate::elastic::Solids;
use crate::geometry::{Coupling, bounds};
use crate::grid::{Axis, Grid};

/// Whether each cell is in a component of active cells that touches nothing. `open`: apertures of the faces for the
/// pressure; one below 1 touches.
pub fn ballistic_cells(open: &[Vec<f64>; 3], stencil: &Stencil) -> Vec<bool> {
    let grid = &stencil.grid;
    let touches = |cell: &usize| {
        let faces = Axis::ALL.into_iter().flat_map(|axis| {
            let here = grid.cell_at(*cell);
            let mut next = here;
            next[axis.index()] += 1;
            [here, next].map(|at| open[axis.index()][grid.face(axis, at)])
        });
        faces.into_iter().any(|aperture| aperture < 1.0)
    };
    let mut ballistic = vec![false; grid.n_cells()];
    for component in components(stencil) {
        if !component.iter().any(touches) {
            component.iter().for_each(|&cell| ballistic[cell] = true);
        }
    }
    ballistic
}

/// Whether each body is ballistic in a sub-step of dt (s): where dt v + dt^2 g / 2 takes it no node is beyond a wall of the
/// domain or in an obstacle. `distance`: to obstacles, per cell, m; empty without any. `wet`: whether the liquid touches a
/// node.
pub fn ballistic_bodies(
    solids: &Solids,
    grid: &Grid,
    distance: &[f64],
    wet: &[bool],
    (gravity, dt): (DVec3, f64),
    displacement: &[[f64; 3]],
    velocity: &[[f64; 3]],
) -> Vec<bool> {
    let touches = |node: usize| {
        let [u, v] = [displacement, velocity].map(|of| DVec3::from(of[node]));
        let end = solids.rest[node] + u + dt * (v + 0.5 * dt * gravity);
        let inside = end.cmpgt(DVec3::ZERO).all() && end.cmplt(grid.size()).all();
        wet[node] || !inside || (!distance.is_empty() && grid.sample_cells(distance, end) <= 0.0)
    };
    let mut ballistic = vec![false; solids.bodies.len()];
    for (body, mut nodes) in solids.free_bodies() {
        ballistic[body] = !nodes.any(touches);
    }
    ballistic
}

/// Unmarks ballistic bodies whose boxes come within a cell (`dx`, m) of those of others in a sub-step of dt (s): they may touch.
pub fn hold_near_others(
    solids: &Solids,
    dx: f64,
    dt: f64,
    displacement: &[[f64; 3]],
    velocity: &[[f64; 3]],
    ballistic: &mut [bool],
) {
    let end = |node: usize| solids.rest[node] + DVec3::from(displacement[node]) + dt * DVec3::from(velocity[node]);
    let boxes = solids.bodies.iter();
    let boxes: Vec<[DVec3; 2]> = boxes.map(|body| bounds(body.nodes.clone().map(end))).collect();
    for (number, [low, high]) in boxes.iter().enumerate() {
        let near = |(other, [from, to]): (usize, &[DVec3; 2])| {
            other != number && from.cmple(*high + dx).all() && to.cmpge(*low - dx).all()
        };
        ballistic[number] &= !boxes.iter().enumerate().any(near);
    }
}

/// Whether liquid in the filled cells touches each of n nodes.
pub fn wet_nodes(coupling: &Coupling, filled: &[bool], n: usize) -> Vec<bool> {
    let mut wet = vec![false; n];
    for pair in coupling.pairs().iter().filter(|pair| filled[pair.cell]) {
        wet[pair.node] = true;
    }
    wet
}

/// Distance from a plane of cell centres below which a position may have the cells of both sides around it, cells. Also in
/// `common/ballistic.wgsl`.
const BESIDE_PLANE: f64 = 1e-3;

/// Ballistic liquid during a move.
#[derive(Clone, Copy, Debug)]
pub struct Ballistic<'a> {
    /// Cells with liquid in the last solve.
    filled: &'a [bool],
    /// Ballistic cells; empty if there are none.
    cells: &'a [bool],
    /// dt^2 g / 2, m.
    shift: DVec3,
    /// Added to positions, cells.
    offset: DVec3,
}

impl<'a> Ballistic<'a> {
    /// For a move of dt (s) under gravity (m/s^2).
    pub fn new(filled: &'a [bool], cells: &'a [bool], gravity: DVec3, dt: f64) -> Ballistic<'a> {
        let cells = if cells.contains(&true) { cells } else { &[] };
        Ballistic { filled, cells, shift: 0.5 * dt * dt * gravity, offset: DVec3::ZERO }
    }

    /// No ballistic liquid.
    pub const NONE: Ballistic<'static> = Ballistic { filled: &[], cells: &[], shift: DVec3::ZERO, offset: DVec3::ZERO };

    /// Whether no cell is ballistic.
    pub fn is_none(&self) -> bool {
        self.cells.is_empty()
    }

    /// The same for positions that are off by so much, cells; for bounds of comparisons.
    pub fn off_by(self, offset: DVec3) -> Ballistic<'a> {
        Ballistic { offset, ..self }
    }

    /// How far liquid that starts at x (m) falls beyond the way of its velocity, m: not at all unless all filled cells with
    /// centres around x are ballistic, and there are any.
    pub fn shift_from(&self, grid: &Grid, x: DVec3) -> DVec3 {
        self.shift_beside(grid, x, 0.0)
    }

    /// The same for a position that may be on planes of cell centres, where rounding must not decide: the cells on both
    /// sides of such a plane count.
    pub fn shift_about(&self, grid: &Grid, x: DVec3) -> DVec3 {
        self.shift_beside(grid, x, BESIDE_PLANE)
    }

    fn shift_beside(&self, grid: &Grid, x: DVec3, margin: f64) -> DVec3 {
        if self.cells.is_empty() {
            return DVec3::ZERO;
        }
        let at = x / grid.dx + self.offset - 0.5;
        let [is, js, ks] = [0, 1, 2].map(|axis| {
            let last = (grid.cells[axis] - 1) as f64;
            let [low, high] = [at[axis] - margin, at[axis] + margin].map(f64::floor);
            let [low, high] = [low, high + 1.0].map(|index| index.clamp(0.0, last) as usize);
            low..=high
        });
        let rows = ks.flat_map(move |k| js.clone().map(move |j| (j, k)));
        let around = rows.flat_map(move |(j, k)| is.clone().map(move |i| grid.cell([i, j, k])));
        let mut liquid = around.filter(|&cell| self.filled[cell]).peekable();
        let falls = liquid.peek().is_some() && liquid.all(|cell| self.cells[cell]);
        if falls { self.shift } else { DVec3::ZERO }
    }

    /// The departure point of what a trace along the velocity leads back to x (m).
    pub fn origin(&self, grid: &Grid, x: DVec3) -> DVec3 {
        let from = x - self.shift;
        match self.shift_from(grid, from) {
            DVec3::ZERO => x,
            _ => from,
        }
    }

    /// The same where planes of cell centres must not decide.
    pub fn origin_about(&self, grid: &Grid, x: DVec3) -> DVec3 {
        let from = x - self.shift;
        match self.shift_about(grid, from) {
            DVec3::ZERO => x,
            _ => from,
        }
    }
}
