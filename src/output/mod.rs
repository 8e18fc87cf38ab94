//! Results of runs: frames that open in ParaView, tables, the manifest, pictures, charts and the report page.
//!
//! ```text
//! DIR/manifest.json              scene, options, adapter, progress
//! DIR/steps.csv, DIR/probes.csv  a row per sub-step
//! DIR/checkpoint.npz             state from which the run resumes
//! DIR/frames/NAME_000042.vtp     markers                 NAME_markers.pvd   the same with times
//! DIR/frames/NAME_000042.vti     cell fields             NAME_fields.pvd    the same with times
//! DIR/frames/NAME_000042.vtu     solids                  NAME_solids.pvd    the same with times
//! DIR/frames/NAME_000042.ply     the liquid's surface
//! DIR/frames/NAME_surface_000042.vtp  the same         NAME_surface.pvd   the same with times
//! DIR/frames/NAME_SOLID_000042.ply  skin of a solid   NAME_SOLID.glb     the same, animated
//! DIR/frames/NAME_000042.obj, NAME_SOLID_000042.obj  the liquid's surface, and skins
//! DIR/frames/NAME_obstacles.vtp  surfaces of the obstacles at the start
//! DIR/frames/NAME_obstacles_000042.vtp  moving obstacles NAME_obstacles.pvd  the same with times
//! DIR/preview/NAME_000042.png    shaded pictures         NAME.png           the animation (APNG)
//! ```
//!
//! Files are written atomically. Frames and tables contain finite numbers only.

mod atomic;
pub mod checkpoint;
mod closed_mesh;
pub mod drawing;
pub mod frames;
pub mod manifest;
mod mesh;
mod obj;
pub mod plot;
mod ply;
pub mod preview;
pub mod report;
pub mod skin;
mod surface;
pub mod tables;
mod vtk;

pub use atomic::{FolderLock, is_partial, write_atomically};
pub use mesh::write_mesh;
