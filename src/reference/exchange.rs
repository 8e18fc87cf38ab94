//! `exchange`: sinks take markers away, sources make some; and what both do in other stages.
//!
//! Every cell of a source that runs has eighths to keep full ([`Taps::eighths`]): 8 within the source. In each sub-step it is filled up to as many
//! markers in them, at jittered places. The jitter is a function of
//! the scene's seed, the sub-step's number, the cell and the marker's number in it, so a run repeats and goes on from a state bit for bit.
//!
//! Cells with their centre in a body get none: `advect_markers` would put them out of the body, and the cell would be filled anew in every
//! sub-step. Where a body covers less of a cell, almost all that is put out of it stays in the cell.

use glam::DVec3;

use super::advect_markers::volume_without;
use crate::geometry::{PER_CELL, Running, Taps};
use crate::grid::Grid;
use crate::state::Exchange;

/// Share of an eighth of a cell, on each side, that jitter leaves free.
const MARGIN: f64 = 0.02;

/// Markers that sources made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Seeded {
    /// All.
    pub emitted: u64,
    /// Those that the cells of sources that start lacked, whether a body covers them or not.
    pub filled: u64,
}

/// Removes the markers (m) in cells of sinks; the others in order, and the number removed.
pub fn sink_markers(grid: &Grid, taps: &Taps, markers: Vec<[f64; 3]>) -> (Vec<[f64; 3]>, u64) {
    if taps.sink_cells.is_empty() {
        return (markers, 0);
    }
    let before = markers.len();
    let mut kept = markers;
    kept.retain(|&x| taps.sink_cells.binary_search(&cell_of(grid, x)).is_err());
    let sunk = (before - kept.len()) as u64;
    (kept, sunk)
}

/// Adds markers (m) behind the others until every cell of the sources that run has 8, but for those with their centre in a body.
/// `solid_distance`: per cell, m.
pub fn seed_markers(
    grid: &Grid,
    taps: &Taps,
    sources: Running,
    solid_distance: &[f64],
    markers: &mut Vec<[f64; 3]>,
) -> Seeded {
    let mut counts = vec![0; taps.source_cells.len()];
    for &x in markers.iter() {
        let cell = cell_of(grid, x);
        if let Ok(found) = taps
            .source_cells
            .binary_search_by_key(&cell, |&(cell, _)| cell)
        {
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

/// Where a cell that holds `count` markers in its eighths gets its marker with a number, m.
fn place(
    grid: &Grid,
    sources: &Running,
    (cell, eighths): (usize, u8),
    count: usize,
    number: usize,
) -> DVec3 {
    let of_cell = [sources.seed, sources.step, cell as u32]
        .into_iter()
        .fold(0, |bits, part| scatter(bits ^ part));
    let turn = (number + of_cell as usize) % eighths.count_ones() as usize;
    let mut full = (0..PER_CELL).filter(|eighth| eighths >> eighth & 1 == 1);
    let eighth = full.nth(turn).expect("the turn is below the count");
    let mut bits = scatter(of_cell ^ (number - count + 1) as u32);
    let within = DVec3::from([0, 1, 2].map(|axis| {
        bits = scatter(bits);
        // The upper 24 bits, as a number in [0, 1).
        let jitter = f64::from(bits >> 8) / f64::from(1 << 24);
        let part = (eighth >> axis & 1) as f64;
        0.5 * (part + MARGIN + (1.0 - 2.0 * MARGIN) * jitter)
    }));
    let corner = DVec3::from(grid.cell_at(cell).map(|n| n as f64));
    (corner + within) * grid.dx
}

/// A bijection of 32-bit integers that scatters neighbours (Wellons 2018, lowbias32).
fn scatter(x: u32) -> u32 {
    let x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    let x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

fn cell_of(grid: &Grid, x: [f64; 3]) -> usize {
    grid.cell(std::array::from_fn(|a| {
        ((x[a] / grid.dx) as usize).min(grid.cells[a] - 1)
    }))
}

/// The eighth of its cell that a point lies in.
fn eighth_of(grid: &Grid, x: [f64; 3]) -> usize {
    let at = grid.cell_at(cell_of(grid, x));
    let upper = |a: usize| usize::from(x[a] / grid.dx - at[a] as f64 >= 0.5);
    (0..3).map(|a| upper(a) << a).sum()
}

/// In `forces`: u* on the faces of sources (m/s). Closed faces stay as they are.
pub fn hold_faces(taps: &Taps, open: &[Vec<f64>; 3], running: u32, velocity: &mut [Vec<f64>; 3]) {
    for face in &taps.faces {
        let a = face.axis.index();
        if let Some(held) = face.held(running).filter(|_| open[a][face.face] > 0.0) {
            velocity[a][face.face] = held.velocity;
        }
    }
}

/// In `write_back`: the same once more, for faces that the pressure has passed over, which have a velocity now.
pub fn carry_faces(
    taps: &Taps,
    open: &[Vec<f64>; 3],
    running: u32,
    velocity: &mut [Vec<f64>; 3],
    valid: &mut [Vec<bool>; 3],
) {
    hold_faces(taps, open, running, velocity);
    for face in &taps.faces {
        let a = face.axis.index();
        valid[a][face.face] |= face.held(running).is_some() && open[a][face.face] > 0.0;
    }
}

/// In `liquid_distance`: cells of sinks are air (m).
pub fn empty_sinks(taps: &Taps, dx: f64, liquid_distance: &mut [f64]) {
    for &cell in &taps.sink_cells {
        liquid_distance[cell] = dx;
    }
}

/// Markers that came and went in a sub-step, and those that were there before and still are.
#[derive(Clone, Copy, Debug, Default)]
pub struct Passed {
    /// Through open sides.
    pub left: u64,
    /// In sinks.
    pub sunk: u64,
    /// Of sources.
    pub seeded: Seeded,
    /// Neither of these, nor dropped.
    pub kept: usize,
}

/// The volumes to hold in a sub-step and after it, m^3, and what it tells of them. `inflow`: what sources emitted beyond filling themselves, m^3.
///
/// What left or sank takes its share of the volume along, as [`volume_without`] says. What fills a source that starts adds an eighth of a
/// cell per marker, after the sub-step.
pub fn exchanged_volume(
    grid: &Grid,
    volume_0: f64,
    inflow: f64,
    passed: Passed,
) -> ([f64; 2], Exchange) {
    let Passed {
        left,
        sunk,
        seeded,
        kept,
    } = passed;
    let held = volume_without(volume_0 + inflow, left + sunk, kept);
    let gone = volume_0 + inflow - held;
    let filled = seeded.filled as f64 * grid.cell_volume() / PER_CELL as f64;
    let share = |n: u64| gone * n as f64 / (left + sunk).max(1) as f64;
    let exchange = Exchange {
        left,
        sunk,
        emitted: seeded.emitted,
        volume_left: share(left),
        volume_sunk: share(sunk),
        volume_emitted: inflow + filled,
    };
    ([held, held + filled], exchange)
}
