//! The f64 path on the CPU: a twin of every stage, written from the equations, and the same step as on the GPU.
//!
//! Stages are pure functions over host arrays ([`crate::grid`]). Sums run in a fixed order, so a run repeats bit for bit
//! whatever the number of threads. This room never uses `gpu`, `stages` or `solver`, and they never use it.

mod active_cells;
pub mod base_block;
mod multigrid;
mod pressure_system;
mod right_hand_side;
mod solve;

pub use active_cells::{ActiveCells, active_cells, theta};
pub use multigrid::Multigrid;
pub use pressure_system::{PressureSystem, Stencil};
pub use right_hand_side::{RightHandSide, VolumeSource, right_hand_side, volume_rate};
pub use solve::{DIRECT_UNKNOWNS, EPSILON, solve, solve_direct, solve_iterative};
