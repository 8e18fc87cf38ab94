//! Elastic solids in f64: linear tetrahedra, lumped masses, isotropic corotational linear elasticity (thesis, chapter 3).
//!
//! All solids of a scene are one mesh, [`Solids`], with consecutive nodes, elements and surface triangles per [`Body`]. The
//! state is the displacement from rest (m) and the velocity (m/s) per node.

mod bounds;
mod cavities;
mod element;
mod incidence;
mod loads;
mod probe;
mod rotation;
mod script;
mod solids;

pub use bounds::Bounds;
pub use cavities::Cavities;
pub use element::{
    Deformation, energy_density, forces, lame_parameters, rest_shape, stiffness_block, stress, von_mises,
};
pub use incidence::{Corner, Incidence, Joint};
pub use loads::TimedLoad;
pub use probe::{NodeReadback, ProbedPart};
pub use rotation::rotation;

use std::ops::Range;

use glam::DVec3;

use crate::scene::{ElasticModel, Keyframe};

/// All solids of a scene at rest, with a common numbering of nodes.
#[derive(Clone, Debug, Default)]
pub struct Solids {
    /// Solids in the order of the scene.
    pub bodies: Vec<Body>,
    /// Rest positions, m.
    pub rest: Vec<DVec3>,
    /// Lumped masses of the nodes, kg: a quarter of each element's.
    pub mass: Vec<f64>,
    /// Node numbers of the elements; det \[X1 - X0, X2 - X0, X3 - X0\] > 0.
    pub elements: Vec<[u32; 4]>,
    /// Gradients of the four shape functions of each element at rest, 1/m; they sum to 0.
    pub gradients: Vec<[DVec3; 4]>,
    /// Rest volumes of the elements, m^3.
    pub volume: Vec<f64>,
    /// Surface triangles, node numbers, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Constrained or scripted components of each node.
    pub prescribed: Vec<[bool; 3]>,
    /// Motions of scripted nodes.
    pub scripts: Vec<Script>,
    /// Forces on the nodes, N, without gravity. With loads over time their means over the last sub-step.
    pub load: Vec<DVec3>,
    /// The constant part of `load`, N.
    constant_load: Vec<DVec3>,
    /// Loads that change over time.
    pub timed_loads: Vec<TimedLoad>,
    /// Nodes and elements of each probe of the scene.
    pub probed: Vec<ProbedPart>,
}

/// One of the solids.
#[derive(Clone, Debug)]
pub struct Body {
    /// Name.
    pub name: String,
    /// Nodes.
    pub nodes: Range<usize>,
    /// Elements.
    pub elements: Range<usize>,
    /// Surface triangles.
    pub triangles: Range<usize>,
    /// kg/m^3
    pub density: f64,
    /// First Lame parameter, Pa.
    pub lambda: f64,
    /// Shear modulus, Pa.
    pub mu: f64,
    /// Strain measure.
    pub model: ElasticModel,
    /// tau_M, 1/s.
    pub mass_damping: f64,
    /// tau_K, s.
    pub stiffness_damping: f64,
    /// Coefficient of friction.
    pub friction: f64,
    /// Whether it touches other solids.
    pub contact: bool,
    /// Indices of bodies that it does not touch.
    pub no_contact_with: Vec<usize>,
    /// Whether its surface touches itself.
    pub self_contact: bool,
}

/// A body whose nodes move along circles when it rotates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RotatingBody {
    /// Nodes.
    pub nodes: Range<usize>,
    /// Centre and axis of the rotation.
    pub pivot: Pivot,
}

/// Centre and axis of a body's rotation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pivot {
    /// The centroid of a free body, any axis.
    Centroid,
    /// The centroid, and this coordinate axis (0 to 2): rollers constrain that component of some nodes, and nothing else.
    Axis(usize),
    /// Two nodes of a hinge, or twice the node of a point.
    Hinge([usize; 2]),
}

/// Prescribed motion of some nodes.
#[derive(Clone, Debug)]
pub struct Script {
    /// Nodes, ascending.
    pub nodes: Vec<u32>,
    /// Prescribed components.
    pub components: [bool; 3],
    /// Centre of rotation, m.
    pub centre: DVec3,
    /// Keyframes, ascending in time; at least one.
    pub keyframes: Vec<Keyframe>,
}
