//! `volume_shift`: moves the level of each liquid component towards its target volume.
//!
//! ```text
//! h_k = clamp(dV_k min(1, dt / t_f) / A_k, -h / 4, h),   h = min(0.16 max(1, C^2 / 9), 2),
//! A_k = sum of open fractions times clamp(1 - |phi|, 0, 1)
//! phi -= h_k + clamp(2 s, 0, 1) max(min(D_k / A_k, 1) - h_k, 0)         the latter only where D_k > 0
//! ```
//!
//! in cells and cell volumes. C is the Courant number of the surface: the errors of its transport are of second order. dV_k is the
//! target less the volume, less a dead band of 0.5 % of the target. The measured volume of a wave changes by that much at constant
//! true volume, and a shift by it would amplify the wave.
//!
//! D_k is the deficit beyond 2.5 % of the target. Landing liquid overlaps the floor by up to its displacement in a sub-step, and this restores
//! that volume at once. The shift is 0 at bodies (s = 0), where an air pocket would get cells of hardly any liquid, which jet. Enclosed components
//! have no surface to move.

use rayon::prelude::*;

use super::liquid_components::Components;
use crate::grid::Grid;

/// Part of the target within which nothing moves.
pub(super) const DEAD_BAND: f64 = 0.005;
/// Deficit beyond which volume returns at once, over the target.
const ALLOWED_DEFICIT: f64 = 0.025;
/// Largest shift at once, cells.
const AT_ONCE: f64 = 1.0;
/// Distance from bodies from which the shift at once is whole, cells.
const BESIDE_BODY: f64 = 0.5;
/// Largest gradual shift outwards in a sub-step, cells.
const LARGEST: f64 = 0.16;
/// Bound of the same in sub-steps of any length, cells: air further from liquid does not move.
const MOST: f64 = 2.0;
/// Largest gradual shift inwards over that outwards. Twice that erases films thinner than a cell.
const INWARDS: f64 = 0.25;
/// Least A_k, cells: a smaller surface is rounding.
const LEAST_AREA: f64 = 1e-6;
/// Courant number above which the largest gradual shift grows with its square.
const LONG: f64 = 3.0;

/// Largest gradual shift outwards in a sub-step with the [Courant number](super::TimeStep::courant) of the surface, cells.
pub fn largest_shift(courant: f64) -> f64 {
    (LARGEST * (courant / LONG).powi(2).max(1.0)).min(MOST)
}

/// Shifts the liquid distance (m). `open_volumes`: of the cells, m^3; `solid_distance`: to bodies, m; `volume_0`: targets, m^3; `control_time` and
/// `dt` in s; `largest` from [`largest_shift`]. Returns the shift of each component away from bodies, cells.
pub fn volume_shift(
    grid: &Grid,
    open_volumes: &[f64],
    solid_distance: &[f64],
    components: &Components,
    volume_0: &[f64],
    ([control_time, dt], largest): ([f64; 2], f64),
    liquid_distance: &mut [f64],
) -> Vec<f64> {
    let mut area = vec![0.0; volume_0.len()];
    for (cell, &label) in components.label.iter().enumerate() {
        if label > 0 {
            let near = (1.0 - (liquid_distance[cell] / grid.dx).abs()).clamp(0.0, 1.0);
            area[label as usize - 1] += open_volumes[cell] * near;
        }
    }
    // h_k, and what returns at once beyond it.
    let shift = |k: usize| {
        let lacks = volume_0[k] - components.volume[k];
        let beyond = |part: f64| lacks.signum() * (lacks.abs() - part * volume_0[k].abs()).max(0.0);
        if components.enclosed[k] || area[k] <= LEAST_AREA * grid.cell_volume() {
            return [0.0; 2];
        }
        let in_time = beyond(DEAD_BAND) * (dt / control_time).min(1.0) / area[k];
        let in_time = in_time.clamp(-INWARDS * largest, largest);
        let at_once = (beyond(ALLOWED_DEFICIT).max(0.0) / area[k]).min(AT_ONCE);
        [in_time, if at_once > 0.0 { (at_once - in_time).max(0.0) } else { 0.0 }]
    };
    let shifts: Vec<[f64; 2]> = (0..volume_0.len()).map(shift).collect();
    let cells = liquid_distance.par_iter_mut().zip(&components.label).zip(solid_distance);
    cells.filter(|((_, label), _)| **label > 0).for_each(|((phi, &label), distance)| {
        let [in_time, at_once] = shifts[label as usize - 1];
        let part = (distance / (BESIDE_BODY * grid.dx)).clamp(0.0, 1.0);
        *phi -= grid.dx * (in_time + part * at_once);
    });
    shifts.into_iter().map(|[in_time, at_once]| in_time + at_once).collect()
}
