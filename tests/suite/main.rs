//! All integration tests, in one binary so that the dependencies are linked once.

mod cli;
mod common;
mod components;
mod geometry;
mod gpu;
mod layout;
mod linalg;
mod output;
mod pages;
mod physics;
mod reference;
mod reference_physics;
mod reference_stages;
mod rooms;
mod scene;
mod shaders;
mod solver;
