//! The stages of the liquid on the GPU, one file each, named as in [`SCHEDULE`](crate::step::SCHEDULE). The pressure
//! system and its solve are in [`crate::solver`]. Every kernel has an f64 twin in [`crate::reference`].
//!
//! A stage is a list of dispatches, recorded as one compute pass under the stage's name. Its kernels bind the arrays
//! of [`crate::fields`] by the names of their variables.
//!
//! Fields live on the narrow [`band`](band()) of quads (runs of four cells along x) around the liquid. Outside the
//! band velocities are zero and the liquid distance is that of air; tiles that leave the band are reset. Only the
//! tiles, and flags per quad during compaction, cover the whole domain.

mod active_cells;
mod advect_level;
mod advect_markers;
mod advect_velocity;
mod ballistic;
mod band;
mod bound_level;
mod cavities;
mod clip;
mod closed_components;
mod diagnose;
mod element_rotations;
mod excess;
mod exchange;
mod extrapolate;
mod filter_level;
mod forces;
mod landing;
mod level_exchange;
mod liquid_components;
mod liquid_distance;
mod marker_band;
mod move_solid;
mod occupancy;
mod patch_pressure;
mod probe;
mod redistance;
mod right_hand_side;
mod separation;
mod spray;
mod volume_shift;
mod write_back;

pub use active_cells::{ActiveSettings, Everywhere, FreeSurface, PressureSystem, Within};
pub use advect_level::advect_level;
pub use advect_markers::advect_markers;
pub use advect_velocity::advect_velocity;
pub use ballistic::{ballistic_bodies, wet_bodies};
pub use band::band;
pub use bound_level::bound_level;
pub use cavities::{Cavity, FilledCavities};
pub use clip::clip;
pub use closed_components::{Components, Seal};
pub use diagnose::{diagnose, diagnose_coupling, diagnose_solid};
pub use element_rotations::element_rotations;
pub use excess::excess;
pub use extrapolate::extrapolate;
pub use filter_level::filter_level;
pub use forces::{forces, node_forces};
pub use landing::landing;
pub use level_exchange::exchange_level;
pub use liquid_components::{liquid_components, settle_flights};
pub use liquid_distance::{liquid_distance, measure_volume};
pub use marker_band::{marker_band, seed_rest};
pub use move_solid::move_solid;
pub use occupancy::occupancy;
pub use patch_pressure::{OpenFaces, PatchPressure, PressureSlope};
pub use probe::{Probe, ProbePoint, ProbeRectangle};
pub use redistance::redistance;
pub use right_hand_side::right_hand_side;
pub use separation::{MAX_ROUNDS, RoundSums, Separation, SeparationRound, SeparationSettings, separated_flux};
pub use spray::spray;
pub use volume_shift::volume_shift;
pub use write_back::write_back;

use crate::Error;
use crate::fields::{ExchangeBuffers, LevelBuffers, LiquidBuffers, SolverBuffers};
use crate::gpu::{Dispatches, Gpu};

/// The stages of the liquid that do not depend on the clipping, so all but `extrapolate` and `diagnose`. Stages
/// without an active effect are empty.
pub fn liquid_stages(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    solver: &SolverBuffers,
    level: Option<&LevelBuffers>,
    (free_surface, taps): (FreeSurface, ExchangeBuffers),
) -> Result<Vec<Dispatches>, Error> {
    let mut stages = vec![
        advect_markers(gpu, liquid, solver, level)?,
        band(gpu, liquid, level)?,
        advect_velocity(gpu, liquid, solver, level, taps.sources)?,
        forces(gpu, liquid)?,
        liquid_distance(gpu, liquid, level, taps.sinks)?,
        right_hand_side(gpu, liquid, level, solver)?,
        write_back(gpu, liquid, solver, free_surface)?,
    ];
    if let Some(level) = level {
        stages.extend(level_stages(gpu, liquid, solver, level, taps)?);
    }
    if let Some(sinks) = taps.sinks {
        stages.push(sinks.exchange(gpu, liquid, level)?);
    }
    if let Some(sources) = taps.sources {
        stages.extend(sources.stages(gpu, liquid)?);
    }
    Ok(stages)
}

fn level_stages(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    solver: &SolverBuffers,
    level: &LevelBuffers,
    taps: ExchangeBuffers,
) -> Result<Vec<Dispatches>, Error> {
    let mut stages = vec![
        advect_level(gpu, liquid, solver, level)?,
        occupancy(gpu, liquid, level)?,
        bound_level(gpu, liquid, level)?,
        redistance(gpu, liquid, level)?,
        filter_level(gpu, liquid, level)?,
        liquid_components(gpu, liquid, level, taps)?,
        volume_shift(gpu, liquid, level)?,
        excess(gpu, liquid, level)?,
        marker_band(gpu, liquid, level)?,
        landing(gpu, liquid, level)?,
        spray(gpu, liquid, level)?,
    ];
    stages.extend(exchange_level(gpu, liquid, level, taps)?);
    Ok(stages)
}
