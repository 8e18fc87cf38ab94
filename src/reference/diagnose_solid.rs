//! `diagnose`, for solids: momentum, energies and the worst element.

use glam::DVec3;

use super::diagnose::larger;
use crate::elastic::{Deformation, Solids, energy_density};
use crate::state::SolidDiagnosis;

/// Diagnostics of the solids: sums over nodes of mass m at x = X + u with velocity v, and over elements of volume V.
///
/// ```text
/// momentum = sum m v,  angular momentum = sum m x cross v,  kinetic energy = sum m |v|^2 / 2
/// potential energy = - sum m g . x,  elastic energy = sum V (mu eps : eps + lambda/2 tr(eps)^2)
/// ```
///
/// `deformations`: of all elements under `displacement` (m); `velocity` in m/s, of all nodes; `gravity` in m/s^2.
pub fn diagnose_solid(
    solids: &Solids,
    deformations: &[Deformation],
    displacement: &[[f64; 3]],
    velocity: &[[f64; 3]],
    gravity: DVec3,
) -> SolidDiagnosis {
    let (mut momentum, mut angular_momentum) = (DVec3::ZERO, DVec3::ZERO);
    let (mut kinetic_energy, mut potential_energy, mut max_speed) = (0.0, 0.0, 0.0);
    for (node, &mass) in solids.mass.iter().enumerate() {
        let x = solids.rest[node] + DVec3::from(displacement[node]);
        let v = DVec3::from(velocity[node]);
        momentum += mass * v;
        angular_momentum += mass * x.cross(v);
        kinetic_energy += 0.5 * mass * v.length_squared();
        potential_energy -= mass * gravity.dot(x);
        max_speed = velocity[node].iter().fold(max_speed, |max, v| larger(max, v.abs()));
    }
    let (mut elastic_energy, mut min_det, mut inverted) = (0.0, f64::INFINITY, 0);
    for (element, deformation) in deformations.iter().enumerate() {
        let body = solids.body_of_element(element);
        let density = energy_density(deformation.strain, body.lambda, body.mu);
        elastic_energy += solids.volume[element] * density;
        let determinant = deformation.determinant();
        min_det = -larger(-min_det, -determinant);
        inverted += usize::from(determinant <= 0.0);
    }
    SolidDiagnosis {
        momentum: momentum.to_array(),
        angular_momentum: angular_momentum.to_array(),
        kinetic_energy,
        elastic_energy,
        potential_energy,
        max_speed,
        min_det,
        inverted,
    }
}
