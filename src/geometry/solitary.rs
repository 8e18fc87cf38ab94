//! Solitary wave to third order in e = height / depth: surface and velocity.
//!
//! Source: R. Grimshaw, *The solitary wave in water of variable depth, part 2*, Journal of Fluid Mechanics 46, 1971, as given
//! by J. Fenton, *A ninth-order solution for the solitary wave*, Journal of Fluid Mechanics 53, 1972. Lengths are in depths and
//! velocities in sqrt(g depth): X is the distance from the crest along the wave's direction, z the height above the floor, a =
//! sech^2(k X), k = sqrt(3 e / 4) (1 - 5/8 e + 71/128 e^2). Divergence, curl and surface conditions are satisfied to order e^4.

use glam::DVec3;

use crate::scene::SolitaryWave;

/// Local coordinates of a point.
struct Local {
    /// height / depth
    e: f64,
    /// Wave number times depth.
    k: f64,
    /// sech^2(k X)
    a: f64,
    /// tanh(k X)
    t: f64,
}

impl Local {
    fn new(wave: &SolitaryWave, x: DVec3) -> Local {
        let e = wave.height / wave.depth;
        let k = (0.75 * e).sqrt() * (1.0 - 0.625 * e + 71.0 / 128.0 * e * e);
        let along = (x.x - wave.crest[0]) * wave.direction[0] + (x.z - wave.crest[1]) * wave.direction[1];
        let t = (k * along / wave.depth).tanh();
        Local { e, k, a: 1.0 - t * t, t }
    }
}

/// Signed distance to the surface, m, negative below: the height difference over the length of its gradient. It is accurate to
/// first order near the surface and has the correct sign everywhere.
pub(super) fn distance(wave: &SolitaryWave, x: DVec3) -> f64 {
    let Local { e, k, a, t } = Local::new(wave, x);
    let above = e * a - 0.75 * e * e * a * (1.0 - a) + e.powi(3) * a * (1.0 - a) * (0.625 - 1.2625 * a);
    let by_a =
        e - 0.75 * e * e * (1.0 - 2.0 * a) + e.powi(3) * (0.625 * (1.0 - 2.0 * a) - 1.2625 * a * (2.0 - 3.0 * a));
    let slope = -2.0 * k * a * t * by_a;
    (x.y - wave.depth * (1.0 + above)) / 1.0_f64.hypot(slope)
}

/// Approximate largest speed of the liquid, m/s: at the crest.
pub(super) fn fastest(wave: &SolitaryWave) -> f64 {
    let [x, z] = wave.crest;
    velocity(wave, DVec3::new(x, wave.depth + wave.height, z)).length()
}

/// Velocity of the liquid at a point, m/s.
pub(super) fn velocity(wave: &SolitaryWave, x: DVec3) -> DVec3 {
    let Local { e, a, t, .. } = Local::new(wave, x);
    let z = x.y / wave.depth;
    let (z2, z4, a2, a3) = (z * z, z.powi(4), a * a, a.powi(3));
    let along = e * a
        - e * e * (-0.25 * a + a2 + z2 * (1.5 * a - 2.25 * a2))
        - e.powi(3)
            * (19.0 / 40.0 * a + 0.2 * a2 - 1.2 * a3
                + z2 * (-1.5 * a - 3.75 * a2 + 7.5 * a3)
                + z4 * (-0.375 * a + 45.0 / 16.0 * (a2 - a3)));
    let up = (3.0 * e).sqrt()
        * z
        * t
        * (e * a
            - e * e * (0.375 * a + 2.0 * a2 + z2 * (0.5 * a - 1.5 * a2))
            - e.powi(3)
                * (49.0 / 640.0 * a - 0.85 * a2 - 3.6 * a3
                    + z2 * (-13.0 / 16.0 * a - 25.0 / 16.0 * a2 + 7.5 * a3)
                    + z4 * (-0.075 * a + 1.125 * a2 - 27.0 / 16.0 * a3)));
    let speed = (wave.gravity * wave.depth).sqrt();
    speed * DVec3::new(along * wave.direction[0], up, along * wave.direction[1])
}
