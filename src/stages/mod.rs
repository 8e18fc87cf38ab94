//! The stages of the liquid step on the GPU, one file each, named as in the list in [`crate`]; the pressure system and its
//! solve are in [`crate::solver`]. Every kernel has an f64 twin in [`crate::reference`].
//!
//! A stage is a struct of kernels bound to buffers with `record(&self, &mut Recorder)`, one compute pass labelled with the
//! stage's name; it owns no fields. [`LiquidBuffers`] owns the fields and no kernels. [`Step`] is written before a
//! submission, [`Report`] read after it.
//!
//! Work follows the liquid: fields live on the [`Band`], the quads (4 cells along x) in and around the liquid. Outside it
//! velocities are zero and the liquid distance says air; what leaves it is put back to that, tile by tile. All that goes through the
//! whole domain are the tiles, and the flags per quad when they are counted into lists.

mod advect_markers;
mod advect_velocity;
mod band;
mod buffers;
mod clip;
mod diagnose;
mod diagnose_coupling;
mod diagnose_solid;
mod element_rotations;
mod exchange;
mod extrapolate;
mod forces;
mod liquid_distance;
mod move_solid;
mod node_forces;
mod probe;
mod report;
mod right_hand_side;
mod solid_buffers;
mod write_back;

pub use advect_markers::AdvectMarkers;
pub use advect_velocity::AdvectVelocity;
pub use band::{Band, Tiles};
pub use buffers::{LiquidBuffers, LiquidPlan, MarkerBuffers, ObstacleBuffers, Step};
pub use clip::{Clip, ClipBuffers, ClipSize, Clipped, CutQuad};
pub use diagnose::Diagnose;
pub use diagnose_coupling::DiagnoseCoupling;
pub use diagnose_solid::DiagnoseSolid;
pub use element_rotations::ElementRotations;
pub use exchange::{DeviceSourceFace, EXCHANGE, Region, Sinks, SourceStep, Sources, tap_buffers};
pub use extrapolate::Extrapolate;
pub use forces::Forces;
pub use liquid_distance::{LiquidDistance, Volume};
pub use move_solid::MoveSolid;
pub use node_forces::NodeForces;
pub use probe::{Probe, ProbePoint};
pub use report::{CouplingReport, Report, SolidReport};
pub use right_hand_side::RightHandSide;
pub use solid_buffers::{SolidBuffers, SolidPlan, SolidStep};
pub use write_back::WriteBack;

use crate::gpu::{Binding, Buffer};

/// The unknowns of the projection, as the solver finds them; the words are explained in `common/active.wgsl`.
#[derive(Clone, Copy, Debug)]
pub struct Active<'a> {
    /// Per quad: active lanes, and lanes in components without a free surface.
    pub flags: &'a Buffer<u32>,
    /// Active quads, tagged in the highest bit.
    pub list: &'a Buffer<u32>,
    /// Workgroups and length of the list, first.
    pub args: &'a Buffer<u32>,
}

/// Faces count as reached from the liquid within this many layers, each a cell wide along axes and diagonals: one cell beyond
/// what a point crosses along each axis in a sub-step, of which markers near the surface take half, and one for the trilinear sample.
pub fn extrapolation_layers(cfl: f64) -> usize {
    cfl.ceil() as usize + 2
}

/// The bindings that every kernel over the band has.
fn over_band(buffers: &LiquidBuffers) -> [(&'static str, Binding<'_>); 3] {
    [
        ("level", (&buffers.level).into()),
        ("args", (&buffers.band_args).into()),
        ("list", (&buffers.band_list).into()),
    ]
}
