//! Elastic solids in f64: linear tetrahedra, lumped masses, isotropic linear elasticity in the frame that turns with each element
//! (thesis, chapter 3).
//!
//! All solids of a scene are one mesh, [`Solids`]: their nodes, elements and surface triangles stand one after another, and a
//! [`Body`] says which are whose. State is kept as the displacement from rest (m) and the velocity (m/s) per node.

mod bounds;
mod element;
mod incidence;
mod probe;
mod rotation;
mod script;
mod solids;

pub use bounds::Bounds;
pub use element::{
    Deformation, energy_density, forces, lame_parameters, rest_shape, stiffness_block, stress,
    von_mises,
};
pub use incidence::{Corner, Incidence, Joint};
pub use rotation::rotation;

use std::ops::Range;

use glam::DVec3;

use crate::scene::{ElasticModel, Keyframe};

/// All solids of a scene at rest. Indices of nodes run over all solids.
#[derive(Clone, Debug, Default)]
pub struct Solids {
    /// The solids in the order of the scene.
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
    /// Which components of a node's velocity are prescribed.
    pub prescribed: Vec<[bool; 3]>,
    /// Motions of prescribed nodes that are not held still.
    pub scripts: Vec<Script>,
    /// Constant forces on the nodes, N. Gravity is not among them.
    pub load: Vec<DVec3>,
}

/// One solid among all.
#[derive(Clone, Debug)]
pub struct Body {
    /// Its name.
    pub name: String,
    /// Its nodes.
    pub nodes: Range<usize>,
    /// Its elements.
    pub elements: Range<usize>,
    /// Its surface triangles.
    pub triangles: Range<usize>,
    /// kg/m^3
    pub density: f64,
    /// First Lame parameter, Pa.
    pub lambda: f64,
    /// Shear modulus, Pa.
    pub mu: f64,
    /// How strain is measured.
    pub model: ElasticModel,
    /// tau_M, 1/s.
    pub mass_damping: f64,
    /// tau_K, s.
    pub stiffness_damping: f64,
}

/// A body that moves on circles where it turns.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Turning {
    /// Its nodes.
    pub nodes: Range<usize>,
    /// Two nodes of the hinge that it turns about; twice the same where it is a point. None where nothing holds it.
    pub about: Option<[usize; 2]>,
}

/// The motion of some prescribed nodes.
#[derive(Clone, Debug)]
pub struct Script {
    /// The nodes, ascending.
    pub nodes: Vec<u32>,
    /// Prescribed components.
    pub components: [bool; 3],
    /// What turns turn about, m.
    pub centre: DVec3,
    /// Times and placements, ascending in time; at least one.
    pub keyframes: Vec<Keyframe>,
}
