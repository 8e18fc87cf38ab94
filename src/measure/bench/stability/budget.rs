//! Bounds of energies and speeds of a run in which only gravity does work: no case has an inflow or a scripted part.
//!
//! - Total energy: that of the start and the gain of the advection. Most of it is in the liquid at rest, so a light solid may gain many times its
//!   own energy within this bound.
//! - Energy of motion and strain: kinetic and elastic energy of the start, and the potential energy that gravity can release. The least potential
//!   energy has all solids on the floor, and all liquid below them without obstruction. A step of half a cell in the surface adds to the release: the
//!   grid does not resolve it. A pool at rest can release next to nothing.
//! - Speeds: v + g dt with v^2 = v_0^2 + 2 g H + 2 W / m. v_0 is the largest speed at the start, H the height of the domain, W / m the strain energy
//!   of the start per mass of the solids. Factors: [`SOLID_FACTOR`], [`LIQUID_FACTOR`].
//!
//! Gain of the advection: liquid falls with the velocities of the last sub-step. It gains g v dt / 2 per kg, g dt / 2 times its momentum. The momentum
//! of a mass m with the kinetic energy K is at most sqrt(2 K m).

use glam::DVec3;

use crate::elastic::Solids;
use crate::scene::Scene;
use crate::state::{Diagnosis, SolidDiagnosis};

/// Largest energy over that of the start: a tenth for the errors of the sums.
pub const MOST_ENERGY: f64 = 1.1;
/// Liquid accelerates a ball to 3 rho / (2 rho_s + rho) of its own speed, three times for a weightless ball. A wave doubles the speed of a free end, and
/// a heavy body that of a light one.
const SOLID_FACTOR: f64 = 3.0;
/// A body that descends on a film of length L and thickness h squeezes it out at L / (2 h) times its speed: eight times for a block of four cells a
/// quarter of a cell above the floor. The pressure of a thinner film, which grows with the square, stops the body.
const LIQUID_FACTOR: f64 = 10.0;

/// Energies and speeds of a state.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// Kinetic energy of the liquid, J.
    pub liquid: f64,
    /// Kinetic and elastic energy of the solids, J.
    pub solids: f64,
    /// Elastic energy, J.
    pub elastic: f64,
    /// J, from the lowest corner of the domain.
    pub potential: f64,
    /// Largest component of a node's velocity, m/s.
    pub solid_speed: f64,
    /// Largest face velocity, m/s.
    pub liquid_speed: f64,
}

impl Moment {
    /// Kinetic and elastic energy, J.
    pub fn motion(&self) -> f64 {
        self.liquid + self.solids
    }

    /// J
    pub fn energy(&self) -> f64 {
        self.motion() + self.potential
    }
}

/// Energies and speeds at the start of a run.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    gravity: DVec3,
    /// Density of the liquid, kg/m^3.
    density: f64,
    /// Volume of the liquid at the start, m^3.
    volume: f64,
    /// Mass of the solids, kg.
    solids: f64,
    /// Mass of liquid and solids, kg.
    mass: f64,
    /// Potential energy per kg in the lowest corner of the domain, J.
    lowest: f64,
    /// Height of the domain along gravity, m.
    height: f64,
    /// Energy of the start, J.
    pub energy: f64,
    /// Energy of motion and strain of the start, and the energy that gravity can add, J.
    available: f64,
    /// Largest speed after a fall through the domain, m/s.
    fall: f64,
}

impl Budget {
    /// Budget of a scene, its solids, and the diagnoses of the start.
    pub fn new(scene: &Scene, solids: &Solids, liquid: &Diagnosis, solid: &SolidDiagnosis) -> Self {
        let density = scene.liquid.as_ref().map_or(0.0, |liquid| liquid.density);
        let (gravity, size) = (scene.domain.gravity, scene.domain.size);
        let liquid_mass = density * liquid.volume;
        let solid_mass = solids.mass.iter().sum::<f64>();
        let mut budget = Budget {
            gravity,
            density,
            volume: liquid.volume,
            solids: solid_mass,
            mass: liquid_mass + solid_mass,
            lowest: -(gravity * size).max(DVec3::ZERO).element_sum(),
            height: gravity.normalize_or_zero().abs().dot(size),
            energy: 0.0,
            available: 0.0,
            fall: 0.0,
        };
        let start = budget.moment(liquid, solid);
        // The centre of liquid along the walls that gravity pulls to is at half of the filled height.
        let filled = liquid.volume / size.element_product();
        let least = 0.5 * liquid_mass * filled * (gravity * size).abs().element_sum();
        let released = (start.potential - least).max(0.0);
        let (g, half) = (gravity.length(), 0.5 * scene.grid().dx);
        let area = size.element_product() / budget.height.max(half);
        let all = liquid_mass * g * half;
        let step = all.min(0.5 * density * g * area * half.powi(2));
        let fastest = start.liquid_speed.max(start.solid_speed);
        let strain = if solid_mass > 0.0 { start.elastic / solid_mass } else { 0.0 };
        budget.energy = start.energy();
        budget.available = start.motion() + released + step;
        budget.fall = (fastest.powi(2) + 2.0 * g * budget.height + 2.0 * strain).sqrt();
        budget
    }

    /// Energies and speeds of liquid and solids. Liquid of a larger volume than at the start has the mass of the start: spheres around flying
    /// markers cover more than their share.
    pub fn moment(&self, liquid: &Diagnosis, solids: &SolidDiagnosis) -> Moment {
        let share = if liquid.volume > self.volume { self.volume / liquid.volume } else { 1.0 };
        let potential = liquid.potential_energy - self.density * liquid.volume * self.lowest;
        Moment {
            liquid: share * liquid.kinetic_energy,
            solids: solids.kinetic_energy + solids.elastic_energy,
            elastic: solids.elastic_energy,
            potential: share * potential + solids.potential_energy - self.solids * self.lowest,
            solid_speed: solids.max_speed,
            liquid_speed: liquid.max_speed,
        }
    }

    /// Share of the liquid of the start that is missing. `outflow`: volume that left less that which entered, m^3.
    pub fn missing(&self, liquid: &Diagnosis, outflow: f64) -> f64 {
        if self.volume > 0.0 { 1.0 - (liquid.volume + outflow) / self.volume } else { 0.0 }
    }

    /// Bounds for sub-steps up to `dt` s: total energy over that of the start; energy of motion and strain, J; speeds of a node and of a face, m/s.
    pub fn bounds(&self, dt: f64) -> [f64; 4] {
        let g = self.gravity.length();
        let gained = 0.5 * self.mass * g * (2.0 * g * self.height).sqrt() * dt;
        let momentum = (2.0 * self.available * self.mass).sqrt();
        let speed = self.fall + g * dt;
        [
            MOST_ENERGY + gained / self.energy,
            MOST_ENERGY * self.available + 0.5 * g * dt * momentum,
            SOLID_FACTOR * speed,
            LIQUID_FACTOR * speed,
        ]
    }
}
