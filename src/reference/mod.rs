//! The f64 path on the CPU: a twin of every stage, written from the equations, and the same step as on the GPU.
//!
//! Stages are pure functions over host arrays ([`crate::grid`]). Sums run in a fixed order, so a run repeats bit for bit
//! whatever the number of threads. This room never uses `gpu`, `stages` or `solver`, and they never use it.

mod active_cells;
mod advect_markers;
mod advect_velocity;
mod ballistic;
pub mod base_block;
pub mod base_scene;
mod boundary;
mod condition;
mod coupled_system;
mod diagnose;
mod diagnose_solid;
mod exchange;
mod extrapolate;
mod forces;
mod liquid_distance;
mod move_solid;
mod multigrid;
mod node_forces;
mod patch_pressure;
mod path;
mod prepare;
mod pressure_system;
mod probe;
mod refine;
mod right_hand_side;
mod sample;
mod slivers;
mod solid_contacts;
mod solid_matrices;
mod solid_right_hand_side;
mod solid_system;
mod solve;
mod solve_coupled;
mod solve_solid;
mod step;
mod stress_variables;
mod surface_distance;
mod time_step;
mod turn_solids;
mod write_back;

pub use active_cells::{ActiveCells, active_cells, theta};
pub(crate) use advect_markers::Layer;
pub use advect_markers::{Lost, Surface, advect_markers, volume_without};
pub use advect_velocity::advect_velocity;
pub use ballistic::{Ballistic, ballistic_bodies, ballistic_cells, wet_nodes};
pub use condition::{Condition, Conditions, conditions};
pub use coupled_system::{Blocks, CoupledSystem, SQUEEZE, TwoField};
pub use diagnose::{diagnose, divergence, larger, liquid_volume, max_speed, open_volumes};
pub use diagnose_solid::diagnose_solid;
pub use exchange::{
    Passed, Seeded, carry_faces, empty_sinks, exchanged_volume, hold_faces, seed_markers,
    sink_markers,
};
pub use extrapolate::{MovingWalls, extrapolate, n_layers};
pub use forces::forces;
pub use liquid_distance::liquid_distance;
pub use move_solid::move_solid;
pub use multigrid::Multigrid;
pub use node_forces::node_forces;
pub use patch_pressure::{patch_pressure, pressure_gradient};
pub use path::Reference;
pub use prepare::prepare;
pub use pressure_system::{PressureSystem, Stencil, remove_means};
pub use probe::probe;
pub use refine::EPSILON;
pub(crate) use refine::{Correction, LinearSystem, part_left, refine_parts};
pub use right_hand_side::{RightHandSide, VolumeSource, right_hand_side, volume_rate};
pub use sample::gradient;
pub use slivers::{is_sliver, shown_to_whole};
pub use solid_contacts::{
    ActiveSurfaces, ContactSearch, Contacts, Freedom, MAX_SOLVES, MOST_HALVINGS, SearchStep,
    Violations,
};
pub use solid_matrices::{BlockMatrix, BlockPattern, SolidMatrices, solid_matrices};
pub use solid_right_hand_side::{SolidRightHandSide, solid_right_hand_side};
pub use solid_system::SolidSystem;
pub use solve::{DIRECT_UNKNOWNS, solve, solve_direct, solve_iterative};
pub use solve_coupled::{
    CoupledSolution, Formulation, SIGMA, solve_coupled, solve_coupled_in_contact,
    solve_damping_only, solve_weak,
};
pub use solve_solid::{Chebyshev, SolidSolver};
pub use step::StepSystem;
pub use stress_variables::{StressSystem, StressVariables};
pub use surface_distance::surface_distance;
pub use time_step::{StepLimits, TimeStep};
pub use turn_solids::turn_solids;
pub use write_back::write_back;
