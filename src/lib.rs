//! cutwater: two-way coupling between inviscid free-surface liquids and elastic solids on the GPU, without a window.
//!
//! A program loads a scene, computes sub-steps and reads the state. This one needs no GPU; `Backend::Gpu(AdapterChoice::Best)`
//! ([`gpu::AdapterChoice`]) is the same on the best adapter:
//!
//! ```
//! use std::path::Path;
//!
//! use cutwater::scene::Scene;
//! use cutwater::sim::{Backend, Simulation};
//! use cutwater::state::SolveStatus;
//!
//! # fn main() -> Result<(), cutwater::Error> {
//! // As `--set liquid.density=800 --scale 0.25` on the command line.
//! let overrides = ["liquid.density=800".to_owned()];
//! let scene = Scene::load(Path::new("scenes/dam_break_liquid.toml"), &overrides, 0.25)?;
//! let mut simulation = Simulation::new(&scene, &Backend::Cpu)?;
//! while simulation.clock().frame < 6 {
//!     let report = simulation.step()?;
//!     let liquid = report.liquid.expect("the scene has liquid");
//!     println!(
//!         "{:.4} s: residual {:.0e} after {} iterations, {:.4} m^3, {:.2} J",
//!         simulation.clock().time,
//!         liquid.solve.residual,
//!         liquid.solve.iterations,
//!         liquid.diagnosis.volume,
//!         liquid.diagnosis.kinetic_energy,
//!     );
//!     assert_eq!(liquid.solve.status, SolveStatus::Converged);
//! }
//!
//! // Positions of the markers in m, velocities of faces in m/s, pressures of cells in Pa.
//! let state = simulation.state()?;
//! let front = state.markers.iter().fold(0.0, |front: f64, marker| front.max(marker[0]));
//! let pressure = state.pressure.iter().fold(0.0, |most: f64, p| most.max(*p));
//! println!("{:.2} s: the water is at x = {front:.2} m, the pressure {pressure:.0} Pa at most", state.time);
//! // It began as a column 0.375 m wide.
//! assert!((0.5..0.8).contains(&front));
//! # Ok(())
//! # }
//! ```
//!
//! [`sim::run`] computes all frames and writes them, with tables and checkpoints, into a folder, as `cutwater run` does. [`grid`]
//! numbers faces and cells.
//!
//! # One step
//!
//! The rows of [`step::SCHEDULE`] are the stages of a sub-step, in order (Zarifi's thesis, algorithm 4). The GPU stages live in
//! [`stages`] and [`solver`], their f64 twins under the same names in [`mod@reference`].
//!
//! Scenes: [`scene`]. Active effects of a scene: [`effects`]. The staggered grid: [`grid`]. The command line: [`cli`].
#![deny(clippy::print_stdout)]

pub mod cli;
pub mod effects;
pub mod elastic;
pub mod error;
pub mod fields;
pub mod geometry;
pub mod gpu;
pub mod grid;
pub mod linalg;
pub mod measure;
pub mod output;
pub mod reference;
pub mod scene;
pub mod sim;
pub mod solver;
pub mod stages;
pub mod state;
pub mod step;

pub use error::Error;
