//! `redistance`: restores the level to a distance, and moves the surface as little as possible.
//!
//! An interface cell has a neighbour of the other sign. Its value changes in (c) alone, where its gradient is far from 1. Redistancing that moves the surface a little in
//! every sub-step amplifies or damps small waves (Russo and Smereka 2000 fix this in part).
//!
//! ```text
//! (a) |D| = |phi| at interface cells; elsewhere |grad D| = 1, first order (Rouy and Tourin 1992), nine Jacobi passes
//! (b) f = phi where |phi| < 3.5, and |D| < 2.5 or the cell is in a body or air beside it, else D
//! (c) where |f| < 2.5, not at the interface:  f -= 0.4 sign(f) (|grad f| - 1)    Godunov's gradient, one step
//! ```
//!
//! Paths of D lead through bodies, because the level continues into them. Step (b) therefore preserves the level beside a body if a surface is near,
//! on either side of the body. After liquid has met a body, D is large, and (b) removes the rest of the surface inside. That rest would drift and
//! open as a gap without pressure. Air within 2.5 cells of a body keeps its level: liquid thinner than a cell may lie on the body.
//!
//! Step (c) changes no cell at a body where |grad f| < 1/2, or where a slope of Godunov's gradient is one to a cell of a body, and above 0.1. That cell has the
//! extension of its neighbour's own value: without this rule, differences from a plane grew by 1.4 in every sub-step, and water
//! beside a floating ball reached 12 m/s. (c) is the relaxation of Sussman et al. (1994). An interface cell changes, f -= 0.4 (f - phi / m),
//! only if its gradient m is above 1.4, or below 0.7 without a kink at it or at a neighbour across the interface. A kink has
//! one-sided slopes of opposite sign, both steeper than 0.1. It is the edge of a sheet or a collision, where a small m means nothing. A
//! large one does: a film of one cell that separates from thicker liquid retains the level of that liquid, and counts as too thick.
//!
//! Liquid that leaves a wall has its surface between a cell and the wall ([`separation_bounds`](super::separation_bounds)). That cell is at the interface, and
//! its value does not change.
//!
//! Cells with their centre in a body have an extended level. Gradients and distances include them, so that liquid under an overhang has
//! its depth. They are never at the interface, and their value does not change.

use rayon::prelude::*;

use super::level_cells::{LevelCells, REACH};
use crate::grid::Axis;

/// Jacobi passes of the distance.
const PASSES: usize = 9;
/// Distance within which the level is relaxed instead of replaced, cells.
const NEAR: f64 = 2.5;
/// Level beyond which it is replaced within that distance too, cells.
const FAR: f64 = 3.5;
/// Step of the relaxation, cells.
const STEP: f64 = 0.4;
/// Gradients of interface cells that stay; at kinks only the upper limit holds.
const GRADIENTS: [f64; 2] = [0.7, 1.4];
/// Slope below which the interface is hidden behind a body.
const LEAST_SLOPE: f64 = 0.5;
/// Steepness of both sides of a kink, and of a slope to a cell of a body that counts.
const STEEP: f64 = 0.1;

/// The redistanced level, cells. `separated`: from [`separation_bounds`](super::separation_bounds); empty for none.
pub fn redistance(cells: LevelCells, separated: &[f64], level: &[f64]) -> Vec<f64> {
    let leaves_wall = |cell: usize| level[cell] < 0.0 && separated.get(cell).is_some_and(|bound| bound.is_finite());
    let distance = distance(cells, leaves_wall, level);
    let mixed = |cell: usize| {
        let (phi, d) = (level[cell], distance[cell]);
        let body = cells.cut.solid_distance[cell];
        let extended = body < 0.0;
        let air_at_body = phi >= 0.0 && body < NEAR * cells.grid.dx;
        let near = d.abs() < NEAR || extended || air_at_body;
        if near && phi.abs() < FAR { phi } else { d }
    };
    let mixed: Vec<f64> = (0..level.len()).map(mixed).collect();
    let relax = |cell: usize| match cells.is_open(cell) && !leaves_wall(cell) {
        true => relaxed(cells, &mixed, cell),
        false => level[cell],
    };
    (0..level.len()).into_par_iter().map(relax).collect()
}

/// Whether a neighbour has the other sign.
fn at_interface(cells: LevelCells, level: &[f64], cell: usize) -> bool {
    let inside = level[cell] < 0.0;
    let all = Axis::ALL.into_iter();
    let mut beside = all.flat_map(|axis| cells.beside(cell, axis));
    cells.is_open(cell) && beside.any(|other| (level[other] < 0.0) != inside)
}

/// D: the distance from the interface cells with the sign of the level, cells.
fn distance(cells: LevelCells, leaves_wall: impl Fn(usize) -> bool + Sync, level: &[f64]) -> Vec<f64> {
    let all = || (0..level.len()).into_par_iter();
    let kept: Vec<bool> = all().map(|cell| at_interface(cells, level, cell) || leaves_wall(cell)).collect();
    let start = |cell: usize| match kept[cell] {
        true => level[cell].abs().min(REACH),
        false => REACH,
    };
    let mut distance: Vec<f64> = all().map(start).collect();
    for _ in 0..PASSES {
        let next = |cell: usize| match kept[cell] {
            true => distance[cell],
            false => eikonal(cells, &distance, cell),
        };
        distance = all().map(next).collect();
    }
    let sign = |(d, phi): (f64, &f64)| if *phi < 0.0 { -d } else { d };
    distance.into_iter().zip(level).map(sign).collect()
}

/// The solution of |grad D| = 1 at a cell from its smaller neighbours along each axis.
fn eikonal(cells: LevelCells, distance: &[f64], cell: usize) -> f64 {
    let mut low = Axis::ALL.map(|axis| {
        let ijk = cells.grid.cell_at(cell);
        let beside = [0, 1].map(|side| {
            let mut face = ijk;
            face[axis.index()] += side;
            cells.grid.face_sides(axis, face)[side]
        });
        beside.into_iter().flatten().map(|other| distance[other]).fold(REACH, f64::min)
    });
    low.sort_by(f64::total_cmp);
    let [a, b, c] = low;
    let mut d = a + 1.0;
    if d > b {
        d = 0.5 * (a + b + (2.0 - (a - b) * (a - b)).max(0.0).sqrt());
    }
    if d > c {
        let (sum, squares) = (a + b + c, a * a + b * b + c * c);
        d = (sum + (sum * sum - 3.0 * (squares - 1.0)).max(0.0).sqrt()) / 3.0;
    }
    d.min(REACH)
}

/// Differences to both sides along an axis.
fn slopes(cells: LevelCells, f: &[f64], cell: usize, axis: Axis) -> [f64; 2] {
    let [minus, plus] = cells.across(cell, axis);
    [f[cell] - f[minus], f[plus] - f[cell]]
}

/// Godunov's slope along an axis, at least 0, and whether it is a steep one to a cell of a body. sign: -1 inside liquid, else 1.
fn upwind(cells: LevelCells, f: &[f64], cell: usize, axis: Axis, sign: f64) -> (f64, bool) {
    let [low, high] = slopes(cells, f, cell, axis).map(|slope| sign * slope);
    let [low, high] = [low.max(0.0), (-high).max(0.0)];
    let (slope, side) = if low >= high { (low, 0) } else { (high, 1) };
    let body = !cells.is_open(cells.across(cell, axis)[side]);
    (slope, body && slope > STEEP)
}

fn at_kink(cells: LevelCells, f: &[f64], cell: usize) -> bool {
    Axis::ALL.into_iter().any(|axis| {
        let [low, high] = slopes(cells, f, cell, axis);
        low * high < 0.0 && low.abs().min(high.abs()) > STEEP
    })
}

/// Step (c) at a cell.
fn relaxed(cells: LevelCells, f: &[f64], cell: usize) -> f64 {
    let phi = f[cell];
    if phi.abs() >= NEAR {
        return phi;
    }
    let inside = phi < 0.0;
    if !at_interface(cells, f, cell) {
        let sign = if inside { -1.0 } else { 1.0 };
        let upwind = Axis::ALL.map(|axis| upwind(cells, f, cell, axis, sign));
        let gradient = upwind.iter().map(|(slope, _)| slope * slope).sum::<f64>().sqrt();
        let through_body = upwind.iter().any(|(_, through_body)| *through_body);
        let behind_body = gradient < LEAST_SLOPE && cells.cut.solid_distance[cell] < cells.grid.dx;
        return match through_body || behind_body {
            true => phi,
            false => phi - STEP * sign * (gradient - 1.0),
        };
    }
    let mut across =
        Axis::ALL.into_iter().flat_map(|axis| cells.beside(cell, axis)).filter(|&other| (f[other] < 0.0) != inside);
    let m = steepness(cells, f, cell);
    let keep = m > GRADIENTS[0] || at_kink(cells, f, cell) || across.any(|other| at_kink(cells, f, other));
    match keep && m < GRADIENTS[1] {
        true => phi,
        false => phi - STEP * (phi - phi / m.max(1e-9)),
    }
}

/// |grad f|: the central slope along axes where both one-sided ones agree in sign, else the largest.
fn steepness(cells: LevelCells, f: &[f64], cell: usize) -> f64 {
    let squares = Axis::ALL.map(|axis| {
        let [low, high] = slopes(cells, f, cell, axis);
        let central = 0.5 * (low + high).abs();
        match low * high > 0.0 {
            true => central,
            false => low.abs().max(high.abs()).max(central),
        }
        .powi(2)
    });
    squares.iter().sum::<f64>().sqrt()
}
