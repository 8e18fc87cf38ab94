//! Host copy of one moment of a simulation: what the two paths exchange, what is written, and what a run resumes from.

use crate::grid::{Axis, Grid};

/// Everything the next step reads, in f64 on the host. Values that come from the device are f32 and widen exactly.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Simulated time, s.
    pub time: f64,
    /// Sub-steps done.
    pub step: u64,
    /// Frames done.
    pub frame: u64,
    /// Length of the last sub-step, s; 0 before the first.
    pub dt_last: f64,
    /// Face velocities per axis, host layout of the faces, m/s; 0 beyond the extrapolated layers.
    pub velocity: [Vec<f64>; 3],
    /// Marker positions in order, m. Empty with `surface = "fixed"`.
    pub markers: Vec<[f64; 3]>,
    /// Markers dropped so far because they could not be moved out of a solid.
    pub markers_dropped: u64,
    /// Pressure of the last projection at cell centres, Pa; 0 in inactive cells.
    pub pressure: Vec<f64>,
    /// Liquid distance at cell centres, m; negative inside.
    pub liquid_distance: Vec<f64>,
    /// Whether each cell was an unknown of the last projection.
    pub active: Vec<bool>,
    /// Liquid volume to hold, m^3.
    pub volume_0: f64,
}

impl State {
    /// An empty state at rest.
    pub fn at_rest(grid: &Grid) -> State {
        State {
            time: 0.0,
            step: 0,
            frame: 0,
            dt_last: 0.0,
            velocity: Axis::ALL.map(|axis| vec![0.0; grid.n_faces(axis)]),
            markers: Vec::new(),
            markers_dropped: 0,
            pressure: vec![0.0; grid.n_cells()],
            liquid_distance: vec![grid.dx; grid.n_cells()],
            active: vec![false; grid.n_cells()],
            volume_0: 0.0,
        }
    }
}
