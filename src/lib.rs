//! cutwater: two-way coupling between inviscid free-surface liquids and elastic solids on the GPU, without a window.
//!
//! One step of the simulator (Zarifi's thesis, algorithm 4), with the room that holds each line. The GPU stages live in
//! [`stages`] and [`solver`], their f64 twins under the same names in [`mod@reference`]:
//!
//! 1. `time_step`: the largest step that the velocities allow and that lands on the frame times ([`sim`])
//! 2. `clip`: open face areas and the distance to the obstacles, on the CPU ([`geometry`]); once, and with solids in liquid in
//!    every sub-step, after they have moved
//! 3. `move_solid`: nodes of the solids, on circles where nothing holds their body, then out of walls and obstacles
//! 4. `advect_markers`: midpoint rule through the MAC field, then out of the domain through open sides, else out of solids and
//!    walls; on the GPU `band` then lists the
//!    quads near the liquid, which all other stages of the liquid work on
//! 5. `exchange`: sinks take markers away, sources make some, where the scene has any
//! 6. `advect_velocity`: semi-Lagrangian on the faces
//! 7. `forces`: gravity on faces and nodes, and what prescribed nodes move with
//! 8. `liquid_distance`: union of spheres, extended into the solids
//! 9. `active_cells`: the unknowns, compacted, and the levels of the multigrid hierarchy; `closed_components`: those among
//!    them that no free surface reaches
//! 10. `solid_matrices`: rotations of the elements, elastic forces, stiffness
//! 11. `right_hand_side`: negative divergence and volume control; forces of the solids
//! 12. `solve`: the pressure and the velocities of the solids ([`solver`])
//! 13. `write_back`: the divergence-free face velocities
//! 14. `extrapolate`: velocities beyond the liquid
//! 15. `diagnose`: volume, momentum, energies, the worst element and the solver's report
//! 16. `probe`: what the scene measures at points, above points and at the front
//!
//! What a scene is: [`scene`]; what it calls for: [`effects`]; where things are on the grid: [`grid`].
#![deny(clippy::print_stdout)]

pub mod effects;
pub mod elastic;
pub mod error;
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

pub use error::Error;
