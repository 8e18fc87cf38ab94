//! The f64 path on the CPU: a twin of every stage, written from the equations, and the same step as on the GPU.
//!
//! Stages are pure functions over host arrays ([`crate::grid`]). Sums have a fixed order, so a run repeats bitwise with
//! any number of threads. This room never uses `gpu`, `stages` or `solver`, and they never use it.

mod active_cells;
mod advect_level;
mod advect_markers;
mod advect_velocity;
mod air_at_bodies;
mod ballistic;
pub mod base_block;
pub mod base_scene;
mod bound_level;
mod boundary;
mod cavities;
mod condition;
mod contact_rows;
mod coupled_system;
mod diagnose;
mod diagnose_solid;
mod excess;
mod exchange;
mod extrapolate;
mod filter_level;
mod forces;
mod landing;
mod level_cells;
mod level_exchange;
mod liquid_components;
mod liquid_distance;
mod marker_band;
mod move_solid;
mod multigrid;
mod node_forces;
mod occupancy;
mod patch_pressure;
mod path;
mod prepare;
mod pressure_system;
mod probe;
mod redistance;
mod refine;
mod right_hand_side;
mod sample;
mod separated_level;
mod separation;
mod slivers;
mod solid_contacts;
mod solid_matrices;
mod solid_right_hand_side;
mod solid_system;
mod solve;
mod solve_coupled;
mod solve_solid;
mod spray;
mod step;
mod stress_variables;
mod surface_distance;
mod time_step;
mod turn_solids;
mod volume_shift;
mod write_back;

pub use active_cells::{ActiveCells, active_cells, theta};
pub use advect_level::{advect_level, carry_level};
pub(crate) use advect_markers::Layer;
pub use advect_markers::{Lost, Surface, advect_level_markers, advect_markers, volume_without};
pub use advect_velocity::{advect_velocity, advect_velocity_maccormack};
pub use air_at_bodies::air_at_bodies;
pub use ballistic::{Ballistic, ballistic_bodies, ballistic_cells, hold_near_others, wet_nodes};
pub use bound_level::{bound_level, thin_liquid};
pub use cavities::{CavityMotion, FILLS, cavity_source, fill_cavities};
pub use condition::{Condition, Conditions, conditions};
pub use contact_rows::{MOST_COUPLED, MOST_MEETINGS, Touching, first_contact_step};
pub use coupled_system::{Blocks, CoupledSystem, SQUEEZE, TwoField};
pub use diagnose::{diagnose, diagnose_liquid, divergence, larger, liquid_volume, max_speed, open_volumes};
pub use diagnose_solid::diagnose_solid;
pub use excess::{add_excess, excess};
pub use exchange::{
    Passed, Seeded, carry_faces, emit_markers, empty_sinks, exchanged_volume, hold_faces, rewind_sources, seed_markers,
    sink_markers,
};
pub use extrapolate::{MovingWalls, extrapolate, extrapolate_one_sided, extrapolate_with_slope, n_layers};
pub use filter_level::filter_level;
pub use forces::forces;
pub use landing::{face_mass, land, landing_faces, take_landing};
pub use level_cells::{BAND, LevelCells, REACH, filled, filled_distance, interpolant_part};
pub use level_exchange::{
    CellVolume, add_sources, closed_to_markers, controlled_part, empty_level_sinks, fill_sources, hold_source_origins,
    limit_targets, outflow, remove_volumes, renewed_volume, sunk_volumes,
};
pub use liquid_components::{
    Before, Components, LARGEST_TARGET, balance, cap_targets, component_origins, label_at, liquid_components,
    shared_volumes,
};
pub use liquid_distance::{extend_level, extend_spheres, liquid_distance, union_of_spheres};
pub use marker_band::{Levels, Markers, cell_of, first_markers, marker_band};
pub use move_solid::move_solid;
pub use multigrid::Multigrid;
pub use node_forces::node_forces;
pub use occupancy::{UNKNOWN, marker_weights, occupancy};
pub use patch_pressure::{PatchForces, patch_pressure, pressure_gradient};
pub use path::Reference;
pub use prepare::prepare;
pub use pressure_system::{PressureSystem, Stencil, remove_means};
pub use probe::probe;
pub use redistance::redistance;
pub use refine::EPSILON;
pub(crate) use refine::{Correction, LinearSystem, part_left, refine_parts};
pub use right_hand_side::{RightHandSide, VolumeSource, right_hand_side, volume_rate};
pub use sample::gradient;
pub use separated_level::{raise_separated, separation_bounds};
pub use separation::{Candidates, Separation, opening, touching_cells};
pub use slivers::{is_sliver, shown_to_whole};
pub use solid_contacts::{
    ActiveSurfaces, ContactSearch, Contacts, Freedom, MAX_SOLVES, MOST_HALVINGS, SearchStep, Violations,
};
pub use solid_matrices::{BlockMatrix, BlockPattern, SolidMatrices, solid_matrices};
pub use solid_right_hand_side::{SolidRightHandSide, solid_right_hand_side};
pub use solid_system::SolidSystem;
pub use solve::{DIRECT_UNKNOWNS, solve, solve_direct, solve_iterative};
pub use solve_coupled::{
    CoupledSolution, Formulation, SIGMA, solve_coupled, solve_coupled_in_contact, solve_damping_only, solve_weak,
};
pub use solve_solid::{Chebyshev, SolidSolver};
pub use spray::{add_spray, move_spray_volume, spray};
pub use step::StepSystem;
pub use stress_variables::{StressSystem, StressVariables};
pub use surface_distance::surface_distance;
pub use time_step::{StepLimits, TimeStep};
pub use turn_solids::turn_solids;
pub use volume_shift::{largest_shift, volume_shift};
pub use write_back::write_back;
