//! The pressure-only base block: a fixed, strongly divergent system on which pressure solvers are compared.
//!
//! Unit box of n^3 cells with closed walls and no solids, z up, water below the tilted, wavy surface
//!
//! ```text
//! phi = (z - 0.55 - 0.15 (0.5 - x) - 0.04 sin(6x + 1) cos(5y)) / sqrt(1.04)
//! ```
//!
//! dt = 1/120 s, rho = 1000 kg/m^3, g = -9.81 m/s^2 along z, theta floor 1e-2, and face velocities
//! u* = (0.8 sin(2.1x + 1.3y) cos(1.7z), 0.5 cos(1.9x) sin(2.3y + z), -0.4 sin(3x) cos(2y + 0.5z) + g dt).

use glam::DVec3;

use super::active_cells::active_cells;
use super::pressure_system::PressureSystem;
use super::right_hand_side::right_hand_side;
use crate::grid::{Axis, Grid};

/// Length of the step, s.
pub const DT: f64 = 1.0 / 120.0;
/// Density of the liquid, kg/m^3.
pub const DENSITY: f64 = 1000.0;
/// Gravity along z, m/s^2.
pub const GRAVITY: f64 = -9.81;
/// Floor of theta.
pub const THETA_FLOOR: f64 = 1e-2;

/// Grid, face apertures, liquid distance and face velocities of the block at n^3 cells.
pub struct BaseBlock {
    /// n^3 cells of 1/n m.
    pub grid: Grid,
    /// Face apertures per axis: 1, walls 0.
    pub open: [Vec<f64>; 3],
    /// Liquid distance at cell centres, m.
    pub liquid_distance: Vec<f64>,
    /// u* on the faces per axis, m/s.
    pub velocity: [Vec<f64>; 3],
}

impl BaseBlock {
    /// The block at n^3 cells.
    pub fn new(n: usize) -> BaseBlock {
        BaseBlock::with_step(n, DT)
    }

    /// The block with the velocities of a step of dt (s).
    pub(super) fn with_step(n: usize, dt: f64) -> BaseBlock {
        let grid = Grid { cells: [n; 3], dx: 1.0 / n as f64 };
        let faces = |axis: Axis, value: &dyn Fn([usize; 3]) -> f64| -> Vec<f64> {
            (0..grid.n_faces(axis)).map(|face| value(grid.face_at(axis, face))).collect()
        };
        let open = Axis::ALL.map(|axis| {
            let a = axis.index();
            faces(axis, &|ijk| {
                if (1..n).contains(&ijk[a]) { 1.0 } else { 0.0 }
            })
        });
        let velocity =
            Axis::ALL.map(|axis| faces(axis, &|ijk| velocity(grid.face_centre(axis, ijk), dt)[axis.index()]));
        let liquid_distance =
            (0..grid.n_cells()).map(|cell| liquid_distance(grid.cell_centre(grid.cell_at(cell)))).collect();
        BaseBlock { grid, open, liquid_distance, velocity }
    }

    /// Pressure system of the block.
    pub fn pressure_system(&self) -> PressureSystem {
        let active = active_cells(&self.grid, &self.open, &self.liquid_distance, THETA_FLOOR);
        let rhs = right_hand_side(&self.grid, &self.open, &self.velocity, &active, None);
        PressureSystem::new(active, rhs, DT, DENSITY)
    }
}

fn liquid_distance(DVec3 { x, y, z }: DVec3) -> f64 {
    (z - 0.55 - 0.15 * (0.5 - x) - 0.04 * (6.0 * x + 1.0).sin() * (5.0 * y).cos()) / 1.04_f64.sqrt()
}

fn velocity(DVec3 { x, y, z }: DVec3, dt: f64) -> DVec3 {
    DVec3::new(
        0.8 * (2.1 * x + 1.3 * y).sin() * (1.7 * z).cos(),
        0.5 * (1.9 * x).cos() * (2.3 * y + z).sin(),
        -0.4 * (3.0 * x).sin() * (2.0 * y + 0.5 * z).cos() + GRAVITY * dt,
    )
}
