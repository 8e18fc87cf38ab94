//! `move_solid`, first part: what a body that turns needs besides its tangents, so that moving along them does not stretch it.

use glam::{DMat3, DVec3};

use crate::elastic::{Solids, Turning};

/// Of the cube of its trace, the determinant that a tensor of inertia has to exceed, and of its trace the moment about a hinge: bodies on a
/// line turn about it as fast as they like.
const LEAST_INERTIA: f64 = 1e-5;

/// Of Newton's method for the angular velocity midway, and the squared share of the angular momentum that it may leave.
const ROUNDS: usize = 5;
const LEFT: f64 = 1e-6;

/// Nodes move by dt v, along tangents. A body that turns by an angle theta in a sub-step is longer by theta^2 / 2 afterwards: two hundredths
/// at a fifth of a radian, which is more elastic energy than motion in all but soft bodies. For each body that nothing holds
/// ([`Solids::turning`]) this puts its part that moves as a rigid body on circles. With r = x - c from the centroid c, which moves with v_c,
/// the inertia I = sum m (|r|^2 1 - r r^T), the angular momentum L = sum m r x (v - v_c) and w = I^-1 L:
///
/// ```text
/// y + dt/2 (I^-1 y) x y = L,  theta = dt I^-1 y,  k = 1 / (1 + |theta|^2 / 4)
/// u += s,  s = (theta - dt w) x r + k (theta x (theta x r) / 2 - |theta|^2 theta x r / 4)
/// ```
///
/// so that r + dt w x r + s is r turned, by the Cayley transform of theta, by 2 atan(|theta| / 2), about the axis of the implicit midpoint. That
/// keeps the energy of a rigid body that tumbles (Austin, Krishnaprasad & Wang 1993), where w itself turned bars ever faster, about their
/// length in the end. The velocity stays as it is, which is what stretches a body that spins, but for the angular momentum that nodes on
/// smaller arms lose:
///
/// ```text
/// v += dw x r',  dw = (sum m (|r'|^2 1 - r' r'^T))^-1 sum m (v - v_c) x s,  r' = r + dt (v - v_c) + s
/// ```
///
/// Momentum, angular momentum about any point, and the way of the centroid are those without it; a body at rest stays where it is to the
/// last bit. Both corrections vanish with the square of the angle. What is held in a point turns about it, with c there and v_c = 0. What is
/// held along a line, a hinge of direction e, has e e^T / (e . I e) in the place of I^-1, and theta = dt w: the hinge takes up the rest of L.
/// Held nodes stay. `displacement` (m) and `velocity` (m/s): of all nodes, in place.
pub fn turn_solids(
    solids: &Solids,
    dt: f64,
    displacement: &mut [[f64; 3]],
    velocity: &mut [[f64; 3]],
) {
    for Turning { nodes, about } in solids.turning() {
        let nodes = || nodes.clone();
        let mean = |of: &dyn Fn(usize) -> DVec3| {
            let sum = nodes().map(|node| solids.mass[node] * of(node));
            sum.sum::<DVec3>() / nodes().map(|node| solids.mass[node]).sum::<f64>()
        };
        let x = |node: usize| solids.rest[node] + DVec3::from(displacement[node]);
        let (c, v_c) = match about {
            Some([hinge, _]) => (x(hinge), DVec3::ZERO),
            None => (mean(&x), mean(&|node| DVec3::from(velocity[node]))),
        };
        let hinge = about.and_then(|[a, b]| (x(b) - x(a)).try_normalize());
        let arms: Vec<[DVec3; 2]> = nodes()
            .map(|node| [x(node) - c, DVec3::from(velocity[node]) - v_c])
            .collect();
        let masses = &solids.mass[nodes()];
        let momentum: DVec3 = masses
            .iter()
            .zip(&arms)
            .map(|(mass, [r, v])| mass * r.cross(*v))
            .sum();
        let Some(inverse) = inverse_inertia(hinge, masses.iter().zip(arms.iter().map(|[r, _]| *r)))
        else {
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
        let lost: DVec3 = masses
            .iter()
            .zip(after())
            .map(|(mass, (_, s, v))| mass * v.cross(s))
            .sum();
        let inverse = inverse_inertia(hinge, masses.iter().zip(after().map(|(r, ..)| r)));
        let dw = inverse.map_or(DVec3::ZERO, |inverse| inverse * lost);
        let after: Vec<_> = after().collect();
        let moving = |(node, _): &(usize, _)| solids.prescribed[*node] == [false; 3];
        for (node, (r, s, _)) in nodes().zip(after).filter(moving) {
            let dv = dw.cross(r);
            // The move that follows adds dt dv too.
            displacement[node] = (DVec3::from(displacement[node]) + s - dt * dv).to_array();
            velocity[node] = (DVec3::from(velocity[node]) + dv).to_array();
        }
    }
}

/// The angular velocity of the implicit midpoint: w = I^-1 y, y + dt/2 w x y = L, with I the inertia at the start; by Newton's method, and
/// I^-1 L where that does not find it.
fn midway(inverse: DMat3, momentum: DVec3, dt: f64) -> DVec3 {
    let turns =
        |w: DVec3| DMat3::from_cols(w.cross(DVec3::X), w.cross(DVec3::Y), w.cross(DVec3::Z));
    let left = |y: DVec3| y + 0.5 * dt * (inverse * y).cross(y) - momentum;
    let mut y = momentum;
    for _ in 0..ROUNDS {
        let w = inverse * y;
        let slope = DMat3::IDENTITY + 0.5 * dt * (turns(w) - turns(y) * inverse);
        y -= slope.inverse() * left(y);
    }
    let found = left(y).length_squared() <= LEFT * momentum.length_squared();
    inverse * if found { y } else { momentum }
}

/// The inverse of sum m (|r|^2 I - r r^T), about a hinge alone where there is one; none for what lies on a line or in a point, or along
/// the hinge, and for numbers that are not finite.
fn inverse_inertia<'a>(
    hinge: Option<DVec3>,
    of: impl Iterator<Item = (&'a f64, DVec3)>,
) -> Option<DMat3> {
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
