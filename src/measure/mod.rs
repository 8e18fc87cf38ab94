//! Measurements: benches, comparisons, reports. Speed is claimed here only, as medians with their spread.

pub mod bandwidth;
pub mod base_scene;
pub mod bench_accuracy;
pub mod bench_device;
pub mod bench_effects;
pub mod bench_solids;
pub mod bench_solve;
pub mod bench_stability;
pub mod bench_step;
pub mod bench_thesis;
pub mod bounds;
mod chart;
pub mod compare;
pub mod export;
pub mod output_cost;
pub mod plane_strain;
pub mod plot;
pub mod report;
mod solid_bytes;
pub mod statistics;
mod stored;
pub mod sweep;
pub mod table;

pub use chart::ink;
