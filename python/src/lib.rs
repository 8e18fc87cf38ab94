//! Extension module of the Python package `cutwater`: the library's public API for the classes in `python/cutwater`, which have its documentation.
//!
//! All work is done without the GIL. Panics become exceptions.

mod arrays;
mod errors;
mod frame;
mod scene;
mod simulation;
mod tools;

/// The module `cutwater._core`.
#[pyo3::pymodule]
mod _core {
    #[pymodule_export]
    use super::errors::panic;
    #[pymodule_export]
    use super::frame::{Frame, draw};
    #[pymodule_export]
    use super::scene::{Scene, scene_tree};
    #[pymodule_export]
    use super::simulation::{Simulation, State};
    /// Version of cutwater.
    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "the name in Python")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
    #[pymodule_export]
    use super::tools::{adapters, command_line, compare_stages, plan, run};
}
