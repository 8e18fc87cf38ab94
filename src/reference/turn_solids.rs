//! `move_solid`, first part: rotation correction. Nodes of rotating bodies move on circles instead of tangents, so
//! that the body is not stretched.

use glam::{DMat3, DVec3};

use crate::elastic::{Pivot, RotatingBody, Solids};

/// Smallest determinant of an inertia tensor over the cube of its trace, and smallest moment about a hinge over the
/// trace. Bodies on a line have no inertia about it.
const LEAST_INERTIA: f64 = 1e-5;

/// Iterations of Newton's method for the midpoint angular velocity, and the squared relative residual of the angular
/// momentum that it allows.
const ROUNDS: usize = 5;
const LEFT: f64 = 1e-6;

/// Nodes move by dt v along tangents. A body that rotates by theta in a sub-step becomes longer by theta^2 / 2: two
/// hundredths at a fifth of a radian. In all but soft bodies that is more elastic than kinetic energy. For each free
/// or hinged body and each body on rollers (`Solids::rotating_bodies`) the rigid part of the motion therefore follows
/// circles.
///
/// Let c be the centroid, which moves with v_c, and r = x - c. With inertia I = sum m (|r|^2 1 - r r^T), angular
/// momentum L = sum m r x (v - v_c) and w = I^-1 L:
///
/// ```text
/// y + dt/2 (I^-1 y) x y = L,  theta = dt I^-1 y,  k = 1 / (1 + |theta|^2 / 4)
/// u += s,  s = (theta - dt w) x r + k (theta x (theta x r) / 2 - |theta|^2 theta x r / 4)
/// ```
///
/// Then r + dt w x r + s is r rotated by the Cayley transform of theta. The angle is 2 atan(|theta| / 2), the axis
/// that of the implicit midpoint rule. That conserves the energy of a tumbling rigid body (Austin, Krishnaprasad &
/// Wang 1993). With w itself bars rotated ever faster, finally about their length.
///
/// The velocity is unchanged, which stretches a rotating body, except for the angular momentum lost by nodes on
/// shorter arms:
///
/// ```text
/// v += dw x r',  dw = (sum m (|r'|^2 1 - r' r'^T))^-1 sum m (v - v_c) x s,  r' = r + dt (v - v_c) + s
/// ```
///
/// Momentum, angular momentum about any point and the path of the centroid are unchanged. A body at rest is bitwise
/// unchanged. Both corrections are of second order in the angle. A body constrained at a point rotates about it: c is
/// the point and v_c = 0. A body constrained along a line of direction e, a hinge, has e e^T / (e . I e) in place of
/// I^-1, and theta = dt w; the hinge supports the rest of L. So has a body whose nodes are constrained along a
/// coordinate axis e alone, as in plane strain, about its centroid. Prescribed components do not change.
///
/// `displacement` (m) and `velocity` (m/s) of all nodes are updated in place.
pub fn turn_solids(solids: &Solids, dt: f64, displacement: &mut [[f64; 3]], velocity: &mut [[f64; 3]]) {
    for RotatingBody { nodes, pivot } in solids.rotating_bodies() {
        let nodes = || nodes.clone();
        let mean = |of: &dyn Fn(usize) -> DVec3| {
            let sum = nodes().map(|node| solids.mass[node] * of(node));
            sum.sum::<DVec3>() / nodes().map(|node| solids.mass[node]).sum::<f64>()
        };
        let x = |node: usize| solids.rest[node] + DVec3::from(displacement[node]);
        let (c, v_c) = match pivot {
            Pivot::Hinge([hinge, _]) => (x(hinge), DVec3::ZERO),
            Pivot::Centroid | Pivot::Axis(_) => (mean(&x), mean(&|node| DVec3::from(velocity[node]))),
        };
        let hinge = match pivot {
            Pivot::Centroid => None,
            Pivot::Axis(axis) => Some(DVec3::AXES[axis]),
            Pivot::Hinge([a, b]) => (x(b) - x(a)).try_normalize(),
        };
        let arms: Vec<[DVec3; 2]> = nodes().map(|node| [x(node) - c, DVec3::from(velocity[node]) - v_c]).collect();
        let masses = &solids.mass[nodes()];
        let momentum: DVec3 = masses.iter().zip(&arms).map(|(mass, [r, v])| mass * r.cross(*v)).sum();
        let Some(inverse) = inverse_inertia(hinge, masses.iter().zip(arms.iter().map(|[r, _]| *r))) else {
            continue;
        };
        let w = inverse * momentum;
        let theta = match hinge {
            Some(_) => dt * w,
            None => dt * midway(inverse, momentum, dt),
        };
        let square = theta.length_squared();
        let k = 1.0 / (1.0 + 0.25 * square);
        let shift = |r: DVec3| {
            let tangent = theta.cross(r);
            (theta - dt * w).cross(r) + k * (0.5 * theta.cross(tangent) - 0.25 * square * tangent)
        };
        let after = || {
            arms.iter().map(|&[r, v]| {
                let s = shift(r);
                (r + dt * v + s, s, v)
            })
        };
        let lost: DVec3 = masses.iter().zip(after()).map(|(mass, (_, s, v))| mass * v.cross(s)).sum();
        let inverse = inverse_inertia(hinge, masses.iter().zip(after().map(|(r, ..)| r)));
        let dw = inverse.map_or(DVec3::ZERO, |inverse| inverse * lost);
        let after: Vec<_> = after().collect();
        // Both corrections are 0 along the axis of rollers.
        let moving = |(node, _): &(usize, _)| solids.prescribed[*node] != [true; 3];
        for (node, (r, s, _)) in nodes().zip(after).filter(moving) {
            let dv = dw.cross(r);
            // The following move adds dt dv too.
            displacement[node] = (DVec3::from(displacement[node]) + s - dt * dv).to_array();
            velocity[node] = (DVec3::from(velocity[node]) + dv).to_array();
        }
    }
}

/// Angular velocity of the implicit midpoint rule: w = I^-1 y, y + dt/2 w x y = L, with I the initial inertia.
/// Newton's method; I^-1 L if it does not converge.
fn midway(inverse: DMat3, momentum: DVec3, dt: f64) -> DVec3 {
    let turns = |w: DVec3| DMat3::from_cols(w.cross(DVec3::X), w.cross(DVec3::Y), w.cross(DVec3::Z));
    let left = |y: DVec3| y + 0.5 * dt * (inverse * y).cross(y) - momentum;
    let mut y = momentum;
    for _ in 0..ROUNDS {
        let w = inverse * y;
        let slope = DMat3::IDENTITY + 0.5 * dt * (turns(w) - turns(y) * inverse);
        y -= slope.inverse() * left(y);
    }
    let converged = left(y).length_squared() <= LEFT * momentum.length_squared();
    inverse * if converged { y } else { momentum }
}

/// Inverse of sum m (|r|^2 I - r r^T), about the hinge alone if there is one. `None` for bodies on a line or in a
/// point, or along the hinge, and for non-finite numbers.
pub(super) fn inverse_inertia<'a>(hinge: Option<DVec3>, of: impl Iterator<Item = (&'a f64, DVec3)>) -> Option<DMat3> {
    let inertia = of.fold(DMat3::ZERO, |sum, (mass, r)| {
        let square = DMat3::from_cols(r.x * r, r.y * r, r.z * r);
        sum + *mass * (r.length_squared() * DMat3::IDENTITY - square)
    });
    let trace: f64 = (0..3).map(|axis| inertia.col(axis)[axis]).sum();
    if let Some(e) = hinge {
        let about = e.dot(inertia * e);
        let outer = DMat3::from_cols(e.x * e, e.y * e, e.z * e);
        return (about > LEAST_INERTIA * trace).then(|| outer * about.recip());
    }
    (inertia.determinant() > LEAST_INERTIA * trace.powi(3)).then(|| inertia.inverse())
}
