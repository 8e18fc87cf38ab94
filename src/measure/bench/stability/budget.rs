//! Bounds of energies and speeds of a run in which only gravity does work: no case has an inflow or a scripted part.
//!
//! - Total energy: that of the start, and the gain of the marker update. Liquid at rest has most of it, so a light solid can gain many times its
//!   own unseen.
//! - Energy of motion and strain, kinetic and elastic: what there was of it at the start and what gravity can release, potential energy at the
//!   start less the least that there can be: all solids on the floor, and the markers, eight to a cell, below them as if nothing were in their
//!   way; and that of a step in the surface by half a cell, which markers do not tell from a level one. A pool at rest can release
//!   next to nothing. Markers that wander, which potential energy sees, do not count here.
//! - Speeds: v^2 = v_0^2 + 2 g H + 2 W / m, of the fastest at the start, a fall through the domain's height H and the strain energy W of the start
//!   in each kg of the solids, and g dt more. Solids may have [`OF_SOLIDS`] times that, liquid [`OF_LIQUID`] times.
//!
//! Gain of the marker update: markers fall with the velocities of before, and gain g v dt / 2 per kg, g dt / 2 times their momentum. The momentum of a
//! mass m with the kinetic energy K is sqrt(2 K m) at most.

use glam::DVec3;

use crate::elastic::Solids;
use crate::grid::Grid;
use crate::reference::max_speed;
use crate::scene::Scene;
use crate::state::{SolidDiagnosis, State};

/// Energy over its bound, at most: a tenth for the errors of the sums.
pub const MOST_ENERGY: f64 = 1.1;
/// Liquid that sets out with a speed takes a ball along with 3 rho / (2 rho_s + rho) of it, three times where the ball weighs nothing. A wave doubles
/// the speed of a free end, and a blow by what is heavier that of what is light.
const OF_SOLIDS: f64 = 3.0;
/// Jets are faster than what makes them: a body that comes down on a film of a length L and thickness h squeezes it out at L / (2 h) times its
/// speed, eight times where a block of four cells is a quarter of a cell above the floor. Nothing that is thinner keeps speed: its
/// pressure, which goes with the square, stops the body.
const OF_LIQUID: f64 = 10.0;

/// Of a cell full of liquid.
const MARKERS: f64 = 8.0;

/// Energies and speeds of a state.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// J
    pub liquid_kinetic: f64,
    /// J
    pub solid_kinetic: f64,
    /// J
    pub elastic: f64,
    /// J, from the corner of the domain where gravity would take everything.
    pub potential: f64,
    /// Of a node, a component, m/s.
    pub solid_speed: f64,
    /// Of a face, m/s.
    pub liquid_speed: f64,
}

impl Moment {
    /// Kinetic and elastic energy, J.
    pub fn motion(&self) -> f64 {
        self.liquid_kinetic + self.solids()
    }

    /// Kinetic and elastic energy of the solids, J.
    pub fn solids(&self) -> f64 {
        self.solid_kinetic + self.elastic
    }

    /// J
    pub fn energy(&self) -> f64 {
        self.motion() + self.potential
    }
}

/// Energies and speeds at the start of a run.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    grid: Grid,
    gravity: DVec3,
    /// Of a marker, kg.
    marker: f64,
    /// Of the solids, kg.
    solids: f64,
    /// Of liquid and solids, kg.
    mass: f64,
    /// Potential energy of a kg where gravity would take it, J.
    lowest: f64,
    /// Of the domain, along gravity, m.
    height: f64,
    /// Of the start, J.
    pub energy: f64,
    /// Energy of motion and strain of the start, and what gravity can add, J.
    available: f64,
    /// Speed of the fastest after a fall through the domain, m/s.
    fall: f64,
}

impl Budget {
    /// Budget of a scene, its solids, and their state at the start.
    pub fn new(scene: &Scene, solids: &Solids, state: &State, diagnosis: &SolidDiagnosis) -> Self {
        let density = scene.liquid.as_ref().map_or(0.0, |liquid| liquid.density);
        let (gravity, size) = (scene.domain.gravity, scene.domain.size);
        let liquid = density * state.volume_0;
        let of_solids = solids.mass.iter().sum::<f64>();
        let mut budget = Budget {
            grid: scene.grid(),
            gravity,
            marker: liquid / state.markers.len().max(1) as f64,
            solids: of_solids,
            mass: liquid + of_solids,
            // Of the corners of the domain.
            lowest: -(gravity * size).max(DVec3::ZERO).element_sum(),
            height: gravity.normalize_or_zero().abs().dot(size),
            energy: 0.0,
            available: 0.0,
            fall: 0.0,
        };
        let start = budget.moment(state, diagnosis, max_speed(&state.velocity));
        // A layer of them along each wall that gravity pulls them to has its middle at half of the height that it fills.
        let cells = state.markers.len() as f64 / MARKERS;
        let filled = cells / budget.grid.n_cells() as f64;
        let least = 0.5 * liquid * filled * (gravity * size).abs().element_sum();
        let released = (start.potential - least).max(0.0);
        let (g, half) = (gravity.length(), 0.5 * budget.grid.dx);
        let (area, all) = (
            size.element_product() / budget.height.max(half),
            liquid * g * half,
        );
        let level = all.min(0.5 * density * g * area * half.powi(2));
        let fastest = start.liquid_speed.max(start.solid_speed);
        let strain = match of_solids > 0.0 {
            true => start.elastic / of_solids,
            false => 0.0,
        };
        budget.energy = start.energy();
        budget.available = start.motion() + released + level;
        budget.fall = (fastest.powi(2) + 2.0 * g * budget.height + 2.0 * strain).sqrt();
        budget
    }

    /// Energies and speeds of a state, the liquid's energy by its markers; `liquid_speed`: largest of a face, m/s.
    pub fn moment(&self, state: &State, solids: &SolidDiagnosis, liquid_speed: f64) -> Moment {
        let (mut kinetic, mut potential) = (0.0, 0.0);
        for &x in &state.markers {
            let x = DVec3::from(x);
            kinetic += 0.5 * self.grid.velocity_at(&state.velocity, x).length_squared();
            potential -= self.gravity.dot(x) + self.lowest;
        }
        Moment {
            liquid_kinetic: self.marker * kinetic,
            solid_kinetic: solids.kinetic_energy,
            elastic: solids.elastic_energy,
            potential: self.marker * potential + solids.potential_energy
                - self.solids * self.lowest,
            solid_speed: solids.max_speed,
            liquid_speed,
        }
    }

    /// All energy over that of the start, in sub-steps of up to `dt` s.
    pub fn energy_bound(&self, dt: f64) -> f64 {
        let g = self.gravity.length();
        let gained = 0.5 * self.mass * g * (2.0 * g * self.height).sqrt() * dt;
        MOST_ENERGY + gained / self.energy
    }

    /// Energy of motion and strain, J.
    pub fn motion_bound(&self, dt: f64) -> f64 {
        let momentum = (2.0 * self.available * self.mass).sqrt();
        MOST_ENERGY * self.available + 0.5 * self.gravity.length() * dt * momentum
    }

    /// Of a node, m/s.
    pub fn solid_speed_bound(&self, dt: f64) -> f64 {
        OF_SOLIDS * (self.fall + self.gravity.length() * dt)
    }

    /// Of a face, m/s.
    pub fn liquid_speed_bound(&self, dt: f64) -> f64 {
        OF_LIQUID * (self.fall + self.gravity.length() * dt)
    }
}
