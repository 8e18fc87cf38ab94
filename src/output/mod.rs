//! Everything a run leaves behind: frames that open in ParaView, tables, the manifest, and pictures of them.
//!
//! ```text
//! DIR/manifest.json              what ran, on what, with which options, and how far it came
//! DIR/steps.csv, DIR/probes.csv  a row per sub-step
//! DIR/checkpoint.npz             what the run goes on from
//! DIR/frames/NAME_000042.vtp     markers                 NAME_markers.pvd   the same with times
//! DIR/frames/NAME_000042.vti     cell fields             NAME_fields.pvd    the same with times
//! DIR/frames/NAME_000042.vtu     solids                  NAME_solids.pvd    the same with times
//! DIR/frames/NAME_000042.ply     the liquid's surface
//! DIR/frames/NAME_surface_000042.vtp  the same         NAME_surface.pvd   the same with times
//! DIR/frames/NAME_obstacles.vtp  surfaces of the obstacles at the start
//! DIR/frames/NAME_obstacles_000042.vtp  and, where some move, in a frame; NAME_obstacles.pvd the same with times
//! DIR/preview/NAME_000042.png    shaded pictures         NAME.png           the animation (APNG)
//! ```
//!
//! No file ever stands half written under its final name, and no frame or table holds a number that is not finite.

mod atomic;
pub mod checkpoint;
mod clean;
pub mod frames;
pub mod manifest;
mod mesh;
mod ply;
pub mod preview;
mod surface;
pub mod tables;

pub use atomic::{FolderLock, is_partial, write_atomically};
pub use mesh::write_mesh;
