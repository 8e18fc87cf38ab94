//! One linear tetrahedron: rest shape, deformation, stress, forces and stiffness.
//!
//! ```text
//! H = sum_{a=1..3} (u_a - u_0) g_a^T,  F = I + H,  R = rotation(F), or I in the linear model
//! eps = sym(R^T F) - I,  P = 2 mu eps + lambda tr(eps) I,  energy = V (mu eps : eps + lambda/2 tr(eps)^2)
//! (K x* - b)_a = V R P g_a,  K_ab = V (lambda h_a h_b^T + mu h_b h_a^T + mu (h_a . h_b) I) with h_a = R g_a
//! ```
//!
//! The force is the exact gradient of the energy: R is the nearest rotation, so its variation does no work. K omits this
//! variation, and so is positive semi-definite for every deformation.

use glam::{DMat3, DVec3};

use super::rotation;
use crate::geometry::outer;
use crate::scene::ElasticModel;

/// Gradients of the shape functions (1/m) and volume (m^3) of a tetrahedron with these corners (m).
pub fn rest_shape([a, b, c, d]: [DVec3; 4]) -> ([DVec3; 4], f64) {
    let edges = DMat3::from_cols(b - a, c - a, d - a);
    let determinant = edges.determinant();
    // Rows of the inverse of the edges.
    let gradients =
        [edges.y_axis.cross(edges.z_axis), edges.z_axis.cross(edges.x_axis), edges.x_axis.cross(edges.y_axis)];
    let [g1, g2, g3] = gradients.map(|gradient| gradient / determinant);
    ([-(g1 + g2 + g3), g1, g2, g3], determinant / 6.0)
}

/// First Lame parameter and shear modulus, Pa, from Young's modulus (Pa) and Poisson's ratio.
pub fn lame_parameters(young: f64, poisson: f64) -> [f64; 2] {
    let lambda = young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson));
    [lambda, young / (2.0 * (1.0 + poisson))]
}

/// Deformation of an element.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deformation {
    /// H = F - I, the gradient of the displacement.
    pub gradient: DMat3,
    /// R.
    pub rotation: DMat3,
    /// eps, in the frame of the element at rest.
    pub strain: DMat3,
}

impl Deformation {
    /// `gradients`: of the shape functions at rest, 1/m. `u`: displacements of the corners, m.
    pub fn new(gradients: &[DVec3; 4], u: [DVec3; 4], model: ElasticModel) -> Deformation {
        let gradient = (1..4).map(|a| outer(u[a] - u[0], gradients[a])).fold(DMat3::ZERO, |sum, part| sum + part);
        let rotation = match model {
            ElasticModel::Corotational => rotation(DMat3::IDENTITY + gradient),
            ElasticModel::Linear => DMat3::IDENTITY,
        };
        // sym(R^T F) - I without cancellation.
        let turned_back = rotation.transpose() * (gradient + (DMat3::IDENTITY - rotation));
        Deformation { gradient, rotation, strain: 0.5 * (turned_back + turned_back.transpose()) }
    }

    /// det F: 1 at rest, 0 for a flat element, negative for an inverted one.
    pub fn determinant(&self) -> f64 {
        (DMat3::IDENTITY + self.gradient).determinant()
    }
}

/// P = 2 mu eps + lambda tr(eps) I, Pa.
pub fn stress(strain: DMat3, lambda: f64, mu: f64) -> DMat3 {
    2.0 * mu * strain + DMat3::from_diagonal(DVec3::splat(lambda * trace(strain)))
}

/// mu eps : eps + lambda/2 tr(eps)^2, J/m^3.
pub fn energy_density(strain: DMat3, lambda: f64, mu: f64) -> f64 {
    mu * contraction(strain, strain) + 0.5 * lambda * trace(strain).powi(2)
}

/// Von Mises stress sqrt(3/2 dev(P) : dev(P)) of a symmetric stress, Pa.
pub fn von_mises(stress: DMat3) -> f64 {
    let deviator = stress - DMat3::from_diagonal(DVec3::splat(trace(stress) / 3.0));
    (1.5 * contraction(deviator, deviator)).sqrt()
}

/// (K x* - b) at the corners, N: minus the elastic forces on the nodes. They sum to 0.
pub fn forces(gradients: &[DVec3; 4], volume: f64, deformation: &Deformation, lambda: f64, mu: f64) -> [DVec3; 4] {
    let turned = volume * deformation.rotation * stress(deformation.strain, lambda, mu);
    let [f1, f2, f3] = [1, 2, 3].map(|corner| turned * gradients[corner]);
    [-(f1 + f2 + f3), f1, f2, f3]
}

/// K_ab / V of rotated gradients h_a and h_b; rows belong to corner a, columns to corner b.
pub fn stiffness_block(a: DVec3, b: DVec3, lambda: f64, mu: f64) -> DMat3 {
    lambda * outer(a, b) + mu * outer(b, a) + DMat3::from_diagonal(DVec3::splat(mu * a.dot(b)))
}

fn trace(m: DMat3) -> f64 {
    m.x_axis.x + m.y_axis.y + m.z_axis.z
}

/// a : b
fn contraction(a: DMat3, b: DMat3) -> f64 {
    a.x_axis.dot(b.x_axis) + a.y_axis.dot(b.y_axis) + a.z_axis.dot(b.z_axis)
}
