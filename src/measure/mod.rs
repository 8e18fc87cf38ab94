//! Measurements: benches, comparisons, reports. Speed is claimed here only, as medians with their spread.

pub mod base_scene;
pub mod bench;
pub mod bounds;
pub mod compare;
pub mod converge;
pub mod export;
pub mod plane_strain;
pub mod probe_statistics;
mod stored;
pub mod sweep;
