//! `right_hand_side` of liquid that fills a cavity of a solid: the cavity keeps its volume.
//!
//! The solve conserves the volume to first order. A sub-step that deforms a cavity at the rate G loses the share (dt G)^2. With V the volume after
//! the move and V_0 that when liquid filled the cavity for the first time, the liquid in it gets the source
//!
//! ```text
//! (V_0 - V) / dt V_c / sum of V_c
//! ```
//!
//! per cell of open volume V_c. V_0 / V - 1 is limited to +-0.1, and reduced by a dead band of 1e-5: the rounding of the
//! nodes' positions would strain stiff solids.
//!
//! Liquid fills a cavity if it has no free surface, has a cell whose patches belong to this cavity alone, and its open volume is V to
//! a fifth. The last condition excludes a pocket of a cavity with air, and liquid that leaks through thin walls.

use super::active_cells::ActiveCells;
use super::right_hand_side::RightHandSide;
use crate::elastic::Cavities;
use crate::geometry::Coupling;

/// Largest relative change in a sub-step.
const LARGEST: f64 = 0.1;
/// Relative change without effect.
const DEAD_BAND: f64 = 1e-5;
/// Open volume of the liquid that fills a cavity, over V. Clipped cells differ from the mesh by less.
pub const FILLS: [f64; 2] = [0.8, 1.2];

/// Source of a cavity, m^3/s. `target` and `volume` in m^3, the target 0 for none; `dt` in s.
pub fn cavity_source(target: f64, volume: f64, dt: f64) -> f64 {
    if target <= 0.0 || volume <= 0.0 {
        return 0.0;
    }
    let off = target / volume - 1.0;
    off.signum() * (off.abs() - DEAD_BAND).clamp(0.0, LARGEST) * volume / dt
}

/// A move of the solids.
#[derive(Clone, Copy, Debug)]
pub struct CavityMotion<'a> {
    /// Volume of each cavity after it, m^3.
    pub volumes: &'a [f64],
    /// Targets, m^3; 0 or absent before the first filling.
    pub targets: &'a [f64],
    /// Length of the sub-step, s.
    pub dt: f64,
}

/// Adds the sources of the liquid that fills cavities to the right-hand side. `coupling` covers all cells; `open_volumes` per cell, m^3. Returns the
/// targets for the next sub-step: liquid that fills a cavity for the first time has its volume.
pub fn fill_cavities(
    cavities: &Cavities,
    coupling: &Coupling,
    active: &ActiveCells,
    motion: CavityMotion,
    open_volumes: &[f64],
    rhs: &mut RightHandSide,
) -> Vec<f64> {
    let of_node = cavities.of_node();
    let cavity_beside = |&cell: &usize| {
        let mut pairs = coupling.cell_pairs(cell).iter().map(|pair| of_node[pair.node]);
        let first = pairs.next().unwrap_or(0);
        if pairs.all(|next| next == first) { first } else { 0 }
    };
    let fill = |(number, &volume): (u32, &f64)| {
        let target = motion.targets.get(number as usize - 1).copied().unwrap_or(0.0);
        let mut components = active.sealed.iter();
        let Some(cells) = components.find(|cells| cells.iter().any(|cell| cavity_beside(cell) == number)) else {
            return target;
        };
        let whole: f64 = cells.iter().map(|&cell| open_volumes[cell]).sum();
        if !(FILLS[0] * volume..=FILLS[1] * volume).contains(&whole) {
            return target;
        }
        let rate = cavity_source(target, volume, motion.dt) / whole;
        cells.iter().for_each(|&cell| rhs.values[cell] += rate * open_volumes[cell]);
        if target > 0.0 { target } else { volume }
    };
    (1..).zip(motion.volumes).map(fill).collect()
}
