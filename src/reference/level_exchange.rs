//! Volumes that enter and leave a level set: sources, sinks and open sides.
//!
//! The level moves with the velocity of the last sub-step, and so do these volumes. Through an open side leaves
//!
//! ```text
//! dt A max(u_n, 0) clamp(1/2 - phi, 0, 1)        A the open area of a face, phi the level in its cell
//! ```
//!
//! A sink removes the liquid that entered its cells in the sub-step. These cells are air. Their level is at least 1/2, the
//! distance of their centres from the liquid beside them, so that liquid at their faces remains. A source that starts fills its
//! cells. One that also ran in the last sub-step emits dt times its flux. Each volume belongs to the component in its cell.

use super::level_cells::{BAND, filled};
use crate::geometry::{Fill, Running, SourcesAndSinks};
use crate::grid::{Axis, Grid, Sides};

/// Largest relative difference between the target and the volume of a component in a domain with open sides. The flux through
/// them and the transport of the level differ a little, which would add up in the last liquid of a tank.
const LARGEST_DIFFERENCE: f64 = 0.1;

/// Control times in which liquid that leaves is not controlled.
const RENEWALS: f64 = 20.0;

/// Least level in cells of sinks, cells. With more the interpolation would move the surface away from their faces.
const SINK_LEVEL: f64 = 0.5;

/// A volume (m^3) in a cell.
pub type CellVolume = (usize, f64);

/// Volumes that leave through open sides in a sub-step of dt (s), before the level (cells) moves. `open`: face apertures;
/// `faces` in m/s.
pub fn outflow(
    grid: &Grid,
    open_sides: Sides,
    open: &[Vec<f64>; 3],
    faces: &[Vec<f64>; 3],
    level: &[f64],
    dt: f64,
) -> Vec<CellVolume> {
    let volume = &|axis: Axis, face: usize| {
        let (a, ijk) = (axis.index(), grid.face_at(axis, face));
        let side = grid.wall(axis, ijk)?;
        let cell = grid.face_sides(axis, ijk)[1 - side].filter(|_| open_sides.has(axis, side))?;
        let speed = if side == 1 { 1.0 } else { -1.0 } * faces[a][face];
        let area = grid.dx * grid.dx * open[a][face];
        Some((cell, dt * area * speed.max(0.0) * filled(level[cell])))
    };
    let of_axis = |axis| (0..grid.n_faces(axis)).filter_map(move |face| volume(axis, face));
    Axis::ALL.map(|axis| of_axis(axis).collect::<Vec<_>>()).concat()
}

/// Volumes (m^3) that the transport of the level (cells) to `carried` brought into the cells of sinks. What a shift of the level left there
/// `before` does not count.
pub fn sunk_volumes(
    taps: &SourcesAndSinks,
    open_volumes: &[f64],
    before: Option<&[f64]>,
    carried: &[f64],
) -> Vec<CellVolume> {
    let sunk = taps.sink_cells.iter().map(|&cell| {
        let came = filled(carried[cell]) - before.map_or(0.0, |before| filled(before[cell]));
        (cell, open_volumes[cell] * came.max(0.0))
    });
    sunk.collect()
}

/// Empties the cells of sinks in a level (cells).
pub fn empty_level_sinks(taps: &SourcesAndSinks, level: &mut [f64]) {
    for &cell in &taps.sink_cells {
        level[cell] = level[cell].max(SINK_LEVEL);
    }
}

/// Fills the cells of running sources in a level (cells) after its transport. Returns the volumes that starting sources add,
/// per source cell, m^3.
pub fn fill_sources(
    grid: &Grid,
    taps: &SourcesAndSinks,
    sources: Running,
    open_volumes: &[f64],
    level: &mut [f64],
) -> Vec<f64> {
    let mut first_fill = vec![0.0; taps.source_cells.len()];
    for fill in taps.fills(grid) {
        if sources.running >> fill.source & 1 == 0 {
            continue;
        }
        let before = level[fill.cell];
        level[fill.cell] = match fill.side && before > 0.0 {
            true => fill.level,
            false => before.min(fill.level),
        };
        let starts = sources.starting >> fill.source & 1 == 1;
        if let Some(index) = fill.index.filter(|_| starts) {
            first_fill[index] = open_volumes[fill.cell] * (filled(level[fill.cell]) - filled(before));
        }
    }
    first_fill
}

/// Liquid in the cells of running sources stays there: the component before the sub-step of such a cell is its own. Behind a source
/// there may be liquid of another component. `label`: components before the sub-step; `origins`: see
/// [`component_origins`](super::component_origins).
pub fn hold_source_origins(grid: &Grid, taps: &SourcesAndSinks, sources: Running, label: &[u32], origins: &mut [u32]) {
    let running = |fill: &Fill| fill.index.is_some() && sources.running >> fill.source & 1 == 1;
    for fill in taps.fills(grid).into_iter().filter(running) {
        origins[fill.cell] = label.get(fill.cell).copied().unwrap_or(0);
    }
}

/// Subtracts volumes (m^3) from the targets (m^3) of the components in their cells.
pub fn remove_volumes(label: &[u32], volumes: &[CellVolume], targets: &mut [f64]) {
    for &(cell, volume) in volumes {
        let target = label.get(cell).and_then(|&label| {
            let component = (label as usize).checked_sub(1)?;
            targets.get_mut(component)
        });
        if let Some(target) = target {
            *target -= volume;
        }
    }
}

/// Adds the volumes of sources to the targets (m^3) of the components in their cells: first fillings (m^3, per source cell),
/// and `inflows` (m^3, per source) by the number of cells that each component has in the source.
pub fn add_sources(taps: &SourcesAndSinks, first_fill: &[f64], inflows: &[f64], label: &[u32], targets: &mut [f64]) {
    let labelled = |&&(cell, _): &&(usize, u32)| label[cell] > 0;
    let mut counts = vec![0.0; inflows.len()];
    for &(_, source) in taps.source_cells.iter().filter(labelled) {
        counts[source as usize] += 1.0;
    }
    let cells = taps.source_cells.iter().zip(first_fill);
    for (&(cell, source), &volume) in cells.filter(|(cell, _)| labelled(cell)) {
        let source = source as usize;
        targets[label[cell] as usize - 1] += volume + inflows[source] / counts[source];
    }
}

/// Volume R (m^3) that sources renew in 20 control times (s) in a domain with open sides; `rate`: what they emit, m^3/s.
///
/// The volume of a component up to R is not controlled, between R and 2 R in part. Its errors leave with it. They arise in
/// thin liquid, such as the sheet of a jet on a plate, and control would move them to all of it, such as the jet.
pub fn renewed_volume(rate: f64, control_time: f64) -> f64 {
    match rate > 0.0 {
        true => RENEWALS * control_time * rate,
        false => 0.0,
    }
}

/// Part of the volume control that acts on a component of some volume, of 1; see [`renewed_volume`]. Volumes in m^3.
pub fn controlled_part(volume: f64, renewed: f64) -> f64 {
    match renewed > 0.0 {
        true => (volume / renewed - 1.0).clamp(0.0, 1.0),
        false => 1.0,
    }
}

/// Limits targets (m^3) in a domain with open sides to the surroundings of the volumes of their components (m^3), which shrink
/// with the controlled part. `renewed`: see [`renewed_volume`]. Returns the change of their sum, m^3.
pub fn limit_targets(volumes: &[f64], renewed: f64, targets: &mut [f64]) -> f64 {
    let limit = |(target, &volume): (&mut f64, &f64)| {
        let largest = controlled_part(volume, renewed) * LARGEST_DIFFERENCE;
        let [low, high] = [-largest, largest].map(|d| (1.0 + d) * volume);
        let before = *target;
        // NaN stays for the check of the solve, where `clamp` would panic.
        *target = target.max(low).min(high);
        *target - before
    };
    targets.iter_mut().zip(volumes).map(limit).sum()
}

/// Distance (m) with the cells below the band of markers in it, where sources emit no markers: `marker_band` would delete them.
/// Both distances in m.
pub fn closed_to_markers(solid_distance: &[f64], liquid_distance: &[f64], dx: f64) -> Vec<f64> {
    let pairs = solid_distance.iter().zip(liquid_distance);
    pairs.map(|(&solid, &phi)| if phi < -BAND * dx { -dx } else { solid }).collect()
}
