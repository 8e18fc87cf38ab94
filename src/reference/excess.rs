//! `excess`: density of the markers below the surface less that of liquid, a source of volume.
//!
//! ```text
//! e = G^2 ((F - 1) w) / G^2 w    w = clamp(d, 0, 1) where phi < -1 and F is known, else 0
//! ```
//!
//! where phi < 0 and the denominator exceeds 0.05, and 0 elsewhere. d is the distance to bodies, cells: the noise of fewer
//! markers beside bodies would excite waves. |e| is reduced by a dead band of 0.06, several deviations of the noise of
//! jittered markers. Where e would take the volume of a component further from its target it decreases linearly to 0 at the edge of the
//! dead band of [`volume_shift`](super::volume_shift). Otherwise, below the target, this sink would contract the liquid with its markers while the shift
//! adds liquid without markers: a pool lost markers and 15 % of its volume that way.
//!
//! The right-hand side has a divergence of clamp(e, +-1) / max(2.5 t_f, 1.5 dt) for it. So markers that
//! crowd in a splash expand. Enclosed components have no such source, since its volume could not leave. Liquid that leaves
//! soon has a part of it (`level_exchange`).

use super::level_cells::LevelCells;
use super::level_exchange::controlled_part;
use super::liquid_components::Components;
use super::occupancy::UNKNOWN;
use super::right_hand_side::RightHandSide;
use super::volume_shift::DEAD_BAND as VOLUME_BAND;

/// Depth below which the density counts, cells.
const DEPTH: f64 = 1.0;
/// Least weight.
const LEAST_WEIGHT: f64 = 0.05;
/// Density differences without effect.
const DEAD_BAND: f64 = 0.06;
/// Time in which an excess expands, in times of control and in sub-steps.
const TIMES: [f64; 2] = [2.5, 1.5];

/// e per cell. `targets`: of the components' volumes, m^3. `renewed`: see [`renewed_volume`](super::renewed_volume), m^3. `level` in cells.
pub fn excess(
    cells: LevelCells,
    (components, targets): (&Components, &[f64]),
    renewed: f64,
    occupancy: &[f64],
    level: &[f64],
) -> Vec<f64> {
    let counts = |cell: usize| level[cell] < -DEPTH && occupancy[cell] != UNKNOWN;
    let all = || 0..level.len();
    let weight = all().map(|cell| match counts(cell) {
        true => (cells.cut.solid_distance[cell] / cells.grid.dx).clamp(0.0, 1.0),
        false => 0.0,
    });
    let weight: Vec<f64> = weight.collect();
    let density = all().map(|cell| weight[cell] * (occupancy[cell] - 1.0));
    let density = cells.smooth(&cells.smooth(&density.collect::<Vec<_>>()));
    let weight = cells.smooth(&cells.smooth(&weight));
    let excess = |cell: usize| {
        let label = components.label[cell];
        let moves = label > 0 && !components.enclosed[label as usize - 1];
        if !moves || level[cell] >= 0.0 || weight[cell] <= LEAST_WEIGHT {
            return 0.0;
        }
        let e = density[cell] / weight[cell];
        let k = label as usize - 1;
        let lacks = targets[k] - components.volume[k];
        let against = if e * lacks < 0.0 { lacks.abs() / (VOLUME_BAND * targets[k].abs()) } else { 0.0 };
        let part = controlled_part(components.volume[k], renewed) * (1.0 - against).max(0.0);
        part * e.signum() * (e.abs() - DEAD_BAND).max(0.0)
    };
    all().map(excess).collect()
}

/// Adds the source of an excess to the right-hand side of the active cells (m^3/s). `open_volumes` in m^3; `control_time` and
/// `dt` in s.
pub fn add_excess(
    excess: &[f64],
    open_volumes: &[f64],
    active: impl Iterator<Item = usize>,
    [control_time, dt]: [f64; 2],
    rhs: &mut RightHandSide,
) {
    let time = (TIMES[0] * control_time).max(TIMES[1] * dt);
    for cell in active {
        rhs.values[cell] += excess[cell].clamp(-1.0, 1.0) / time * open_volumes[cell];
    }
}
