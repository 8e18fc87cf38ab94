//! `exchange`: sinks delete markers and sources emit them. Also the effects of both in other stages.
//!
//! Each cell of a source has eighths to fill ([`SourcesAndSinks::eighths`]): all 8 inside the source. While the source runs,
//! every sub-step adds markers at jittered positions until each of these eighths has one. The jitter is a hash of the
//! scene's seed, the number of the sub-step, the cell and the marker's number. Runs therefore repeat and resume bit
//! for bit.
//!
//! With a level the markers of a source are the sites of a lattice that moves with its velocity ([`Lattice`]). Each cell of the
//! lattice has one site at a hashed place. A sub-step emits the sites that enter the eighths to fill. So the density of the
//! markers is exact at any length of the sub-steps, while refilling would emit more in shorter ones.
//!
//! Cells with their centre in a body receive none: `advect_markers` would push them out and the cell would refill in
//! every sub-step. In cells that a body covers less, almost all markers pushed out stay in the cell.

use glam::DVec3;

use super::advect_markers::volume_without;
use super::marker_band::cell_of;
use crate::geometry::{Lattice, MARKERS_PER_CELL, OCTANT_UNITS, Running, SourcesAndSinks};
use crate::grid::Grid;
use crate::state::Exchange;

/// Margin without jitter on each side, as a fraction of an eighth's edge.
const MARGIN: f64 = 0.02;

/// Numbers of emitted markers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Seeded {
    /// Total.
    pub emitted: u64,
    /// Markers missing in cells of starting sources, including those that a body covers.
    pub filled: u64,
}

/// Removes the markers (m) in cells of sinks. Returns the others in order, and the number removed.
pub fn sink_markers(grid: &Grid, taps: &SourcesAndSinks, markers: Vec<[f64; 3]>) -> (Vec<[f64; 3]>, u64) {
    if taps.sink_cells.is_empty() {
        return (markers, 0);
    }
    let before = markers.len();
    let mut kept = markers;
    kept.retain(|&x| taps.sink_cells.binary_search(&cell_of(grid, x)).is_err());
    let sunk = (before - kept.len()) as u64;
    (kept, sunk)
}

/// Appends markers (m) until every cell of the running sources has 8, except cells with their centre in a body.
/// `solid_distance` per cell, m.
pub fn seed_markers(
    grid: &Grid,
    taps: &SourcesAndSinks,
    sources: Running,
    solid_distance: &[f64],
    markers: &mut Vec<[f64; 3]>,
) -> Seeded {
    let mut counts = vec![0; taps.source_cells.len()];
    for &x in markers.iter() {
        let cell = cell_of(grid, x);
        if let Ok(found) = taps.source_cells.binary_search_by_key(&cell, |&(cell, _)| cell) {
            counts[found] += usize::from(taps.eighths[found] >> eighth_of(grid, x) & 1);
        }
    }
    let mut seeded = Seeded::default();
    let cells = taps.source_cells.iter().zip(&taps.eighths);
    for ((&(cell, source), &eighths), &count) in cells.zip(&counts) {
        let full = eighths.count_ones() as usize;
        if sources.running >> source & 1 == 0 || count >= full {
            continue;
        }
        let lacks = (full - count) as u64;
        seeded.filled += lacks * u64::from(sources.starting >> source & 1);
        if solid_distance[cell] < 0.0 {
            continue;
        }
        let place = |number| place(grid, &sources, (cell, eighths), count, number);
        let places = (count..full).map(place);
        markers.extend(places.map(|x| x.to_array()));
        seeded.emitted += lacks;
    }
    seeded
}

/// Appends the markers (m) that sources emit with a level; `lattices`: per source. Returns their number.
pub fn emit_markers(
    grid: &Grid,
    taps: &SourcesAndSinks,
    sources: Running,
    lattices: &[Lattice],
    solid_distance: &[f64],
    markers: &mut Vec<[f64; 3]>,
) -> u64 {
    let before = markers.len();
    for (&(cell, source), &eighths) in taps.source_cells.iter().zip(&taps.eighths) {
        if sources.running >> source & 1 == 0 || solid_distance[cell] < 0.0 {
            continue;
        }
        let starts = sources.starting >> source & 1 == 1;
        let lattice = &lattices[source as usize];
        for eighth in (0..MARKERS_PER_CELL).filter(|eighth| eighths >> eighth & 1 == 1) {
            let at = grid.cell_at(cell);
            let octant = [0, 1, 2].map(|a| (2 * at[a] + (eighth >> a & 1)) as i64);
            // Up to eight cells of the lattice meet an octant.
            for corner in 0..8 {
                let site = site(sources.seed, lattice, octant, corner);
                let within = |x: &i64| (0..OCTANT_UNITS).contains(x);
                let origin: [i64; 3] = std::array::from_fn(|a| {
                    octant[a] + (site[a] - i64::from(lattice.moved[a])).div_euclid(OCTANT_UNITS)
                });
                if site.iter().all(within) && (starts || !taps.fills_octant(grid, source, origin)) {
                    let place = |a: usize| octant[a] as f64 + site[a] as f64 / OCTANT_UNITS as f64;
                    markers.push([0, 1, 2].map(|a| 0.5 * grid.dx * place(a)));
                }
            }
        }
    }
    (markers.len() - before) as u64
}

/// Site in one of the cells of a lattice that may meet an octant, relative to its low corner, units.
fn site(seed: u32, lattice: &Lattice, octant: [i64; 3], corner: usize) -> [i64; 3] {
    let below = [0, 1, 2].map(|a| (corner >> a & 1) as i64);
    let of_cell = (0..3)
        .fold(scatter(seed), |bits, a| scatter(bits ^ (octant[a] - i64::from(lattice.whole[a]) - below[a]) as u32));
    let mut bits = of_cell;
    [0, 1, 2].map(|a| {
        bits = scatter(bits);
        i64::from(lattice.rest[a]) - OCTANT_UNITS * below[a] + i64::from(bits >> 16)
    })
}

/// Position of marker `number` in a cell with `count` markers in its eighths, m.
fn place(grid: &Grid, sources: &Running, (cell, eighths): (usize, u8), count: usize, number: usize) -> DVec3 {
    let cell_hash = [sources.seed, sources.step, cell as u32].into_iter().fold(0, |bits, part| scatter(bits ^ part));
    let turn = (number + cell_hash as usize) % eighths.count_ones() as usize;
    let mut full = (0..MARKERS_PER_CELL).filter(|eighth| eighths >> eighth & 1 == 1);
    let eighth = full.nth(turn).expect("the turn is below the count");
    let mut bits = scatter(cell_hash ^ (number - count + 1) as u32);
    let within = DVec3::from([0, 1, 2].map(|axis| {
        bits = scatter(bits);
        // The upper 24 bits, scaled to [0, 1).
        let jitter = f64::from(bits >> 8) / f64::from(1 << 24);
        let part = (eighth >> axis & 1) as f64;
        0.5 * (part + MARGIN + (1.0 - 2.0 * MARGIN) * jitter)
    }));
    let corner = DVec3::from(grid.cell_at(cell).map(|n| n as f64));
    (corner + within) * grid.dx
}

/// A bijective hash of 32-bit integers (Wellons 2018, lowbias32).
fn scatter(x: u32) -> u32 {
    let x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    let x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// The eighth of its cell that contains a point.
fn eighth_of(grid: &Grid, x: [f64; 3]) -> usize {
    let at = grid.cell_at(cell_of(grid, x));
    let upper = |a: usize| usize::from(x[a] / grid.dx - at[a] as f64 >= 0.5);
    (0..3).map(|a| upper(a) << a).sum()
}

/// In `forces`: sets u* (m/s) on the faces of running sources. Closed faces are unchanged.
pub fn hold_faces(taps: &SourcesAndSinks, open: &[Vec<f64>; 3], running: u32, velocity: &mut [Vec<f64>; 3]) {
    rewind_sources(taps, open, running, DVec3::ZERO, velocity);
}

/// In `advect_velocity` of liquid with a level, first: subtracts half a sub-step of gravity, `fall` = dt g / 2, from the velocities (m/s) of the
/// faces of running sources. For `forces` then adds that of the whole sub-step, and liquid leaves a source in the middle of it on average.
/// Closed faces are unchanged.
pub fn rewind_sources(
    taps: &SourcesAndSinks,
    open: &[Vec<f64>; 3],
    running: u32,
    fall: DVec3,
    velocity: &mut [Vec<f64>; 3],
) {
    for face in &taps.faces {
        let a = face.axis.index();
        if let Some(source) = face.prescribed(running).filter(|_| open[a][face.face] > 0.0) {
            velocity[a][face.face] = source.velocity - fall[a];
        }
    }
}

/// In `write_back`: sets the same velocities again, since the projection excludes these faces, and flags them as
/// valid.
pub fn carry_faces(
    taps: &SourcesAndSinks,
    open: &[Vec<f64>; 3],
    running: u32,
    velocity: &mut [Vec<f64>; 3],
    valid: &mut [Vec<bool>; 3],
) {
    hold_faces(taps, open, running, velocity);
    for face in &taps.faces {
        let a = face.axis.index();
        valid[a][face.face] |= face.prescribed(running).is_some() && open[a][face.face] > 0.0;
    }
}

/// In `liquid_distance`: sets the cells of sinks to air (m).
pub fn empty_sinks(taps: &SourcesAndSinks, dx: f64, liquid_distance: &mut [f64]) {
    for &cell in &taps.sink_cells {
        liquid_distance[cell] = dx;
    }
}

/// Numbers of markers removed and added in a sub-step, and of those that remain.
#[derive(Clone, Copy, Debug, Default)]
pub struct Passed {
    /// Left through open sides.
    pub left: u64,
    /// Deleted in sinks.
    pub sunk: u64,
    /// Emitted by sources.
    pub seeded: Seeded,
    /// Remaining: neither removed, added nor dropped.
    pub kept: usize,
}

/// Controlled volumes in a sub-step and after it, m^3, and the report of the sub-step. `inflow`: volume that sources
/// emitted beyond their own cells, m^3.
///
/// Markers that left or were deleted reduce the volume as in [`volume_without`]. Each marker that fills a starting
/// source adds an eighth of a cell after the sub-step.
pub fn exchanged_volume(grid: &Grid, volume_0: f64, inflow: f64, passed: Passed) -> ([f64; 2], Exchange) {
    let Passed { left, sunk, seeded, kept } = passed;
    let controlled = volume_without(volume_0 + inflow, left + sunk, kept);
    let removed = volume_0 + inflow - controlled;
    let filled = seeded.filled as f64 * grid.cell_volume() / MARKERS_PER_CELL as f64;
    let share = |n: u64| removed * n as f64 / (left + sunk).max(1) as f64;
    let exchange = Exchange {
        left,
        sunk,
        emitted: seeded.emitted,
        volume_left: share(left),
        volume_sunk: share(sunk),
        volume_emitted: inflow + filled,
    };
    ([controlled, controlled + filled], exchange)
}
