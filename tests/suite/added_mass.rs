//! The added-mass limit of weak coupling, in one dimension, for the suite and for the validation.
//!
//! A piston of mass m_s and spring k per area is pushed from rest against a column of liquid m_a = rho L. The column has p = 0 at its other end.
//! Weak coupling applies the pressure of the last sub-step, p = -m_a (v_n - v_(n-1)) / dt. Backward Euler of the solid is m_s (v_(n+1) - v_n) + dt
//! k x_(n+1) = dt p. With a = k dt^2 / m_s and r = m_a / m_s the velocities are proportional to z^n,
//!
//! ```text
//! (1 + a) z^3 + (r - 2) z^2 + (1 - 2 r) z + r = 0,
//! ```
//!
//! Without a spring z = -r is a root for every dt; z = -1 is a root if r = 1 + a / 4.

use cutwater::scene::Scene;
use cutwater::sim::{Backend, Simulation};

/// Distance of the closest columns from the limit.
pub(crate) const DISTANCE: f64 = 0.05;
/// Young's modulus of a rigid piston, Pa.
const RIGID: f64 = 1e11;
/// Cell size, m.
const DX: f64 = 0.03;
/// Cells to the end of the piston: the centre of one, where the column of its cell begins.
const PISTON: f64 = 20.5;
/// Length of the column, m.
const COLUMN: f64 = 0.9;

/// A column of liquid on a piston.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Column {
    /// Frequency of the spring times the sub-step, w dt; 0 without a spring.
    pub(crate) omega_dt: f64,
    /// m_a / m_s over the limit 1 + (w dt)^2 / 4.
    pub(crate) over: f64,
    /// s
    pub(crate) dt: f64,
}

/// Without a spring at two lengths of the sub-step, and with one 5 % below the limit and 5 % above.
pub(crate) fn columns() -> Vec<Column> {
    let mut columns = Vec::new();
    for dt in [0.01, 0.0025] {
        columns.extend([0.5, 0.8, 1.25, 2.0].map(|over| Column { omega_dt: 0.0, over, dt }));
    }
    for omega_dt in [1.0, 3.2] {
        columns.extend([1.0 - DISTANCE, 1.0 + DISTANCE].map(|over| Column { omega_dt, over, dt: 0.01 }));
    }
    columns
}

impl Column {
    /// m_a / m_s
    pub(crate) fn ratio(&self) -> f64 {
        self.over * (1.0 + 0.25 * self.omega_dt.powi(2))
    }

    /// Growth of the velocity per sub-step by theory: magnitude of the negative root, by bisection.
    pub(crate) fn growth(&self) -> f64 {
        let (a, r) = (self.omega_dt.powi(2), self.ratio());
        let cubic = |z: f64| (((1.0 + a) * z + r - 2.0) * z + 1.0 - 2.0 * r) * z + r;
        // Below zero the cubic rises from minus infinity to r > 0 at z = 0.
        let (mut low, mut high) = (-10.0 - r, 0.0);
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if cubic(middle) < 0.0 { low = middle } else { high = middle }
        }
        -low
    }

    fn scene(&self) -> Scene {
        let length = PISTON * DX;
        let mass = 1000.0 * COLUMN / self.ratio();
        let spring = mass * (self.omega_dt / self.dt).powi(2);
        // A spring of one layer of bricks has half of its mass at the fixed end. A free piston starts off the wall, which would constrain it.
        let (density, young, start) = match self.omega_dt > 0.0 {
            true => (2.0 * mass / length, spring * length, 0.0),
            false => (mass / (0.5 * length), RIGID, 0.5 * length),
        };
        let middle = start + 0.5 * (length - start);
        let mut overrides = vec![
            format!("time.frames_per_second={:?}", 1.0 / self.dt),
            format!("time.fixed_step={:?}", self.dt),
            format!("liquid.region[1].half_space.point=[{middle:?}, 0, 0]"),
            format!("solid[0].mesh.box.size[0]={:?}", length - start),
            format!("solid[0].placement.translate[0]={:?}", 0.5 * (start + length)),
            format!("solid[0].density={density:?}"),
            format!("solid[0].young={young:?}"),
        ];
        if self.omega_dt > 0.0 {
            let pin = |x, components| {
                format!(
                    "{{ region = {{ box = {{ min = [0, 0, 0], max = [{x:?}, 0.12, 0.12] }} }}, components = \"{components}\" }}"
                )
            };
            let pins = [pin(length, "yz"), pin(0.001, "x")].join(", ");
            overrides.push(format!("solid[0].pin=[{pins}]"));
        }
        Scene::parse("added_mass.toml".as_ref(), include_str!("added_mass.toml"), &overrides, 1.0).unwrap()
    }

    /// Computed growth of the velocity per sub-step.
    pub(crate) fn measure(&self, backend: &Backend) -> f64 {
        // Until the other roots have decayed: without a spring the only one is 1, with a constant velocity.
        let (steps, over) = if self.omega_dt > 0.0 { (40, 8) } else { (10, 6) };
        let mut simulation = Simulation::new(&self.scene(), backend).unwrap();
        let end = PISTON * DX;
        let mut velocities = Vec::new();
        for _ in 0..steps {
            simulation.step().unwrap();
            let state = simulation.state().unwrap();
            let nodes = simulation.solids().rest.iter().zip(&state.node_velocity);
            let at_end: Vec<f64> = nodes.filter(|(x, _)| (x.x - end).abs() < 1e-6).map(|(_, v)| v[0]).collect();
            velocities.push(at_end.iter().sum::<f64>() / at_end.len() as f64);
        }
        let changes: Vec<f64> = velocities.windows(2).map(|v| v[1] - v[0]).collect();
        let last = changes.len() - 1;
        (changes[last] / changes[last - over]).abs().powf(1.0 / over as f64)
    }
}

#[test]
fn weak_coupling_grows_by_the_ratio_of_added_mass_whatever_the_sub_step() {
    let Some(_) = crate::common::gpu() else { return };
    let backend = Backend::Gpu(crate::common::adapter());
    for over in [0.8, 2.0] {
        let growth = [0.01, 0.0025].map(|dt| Column { omega_dt: 0.0, over, dt }.measure(&backend));
        assert!(growth.iter().all(|got| (got / over - 1.0).abs() <= 5e-3), "{growth:?} where {over}");
    }
}

/// 5 % below the limit m_a / m_s = 1 + (w dt)^2 / 4 motion decays, 5 % above it grows.
#[test]
fn weak_coupling_has_its_limit_within_5_percent() {
    let springs = columns().into_iter().filter(|column| column.omega_dt > 0.0);
    let springs: Vec<Column> = springs.collect();
    assert_eq!(springs.len(), 4);
    for column in springs {
        let (got, expected) = (column.measure(&Backend::Cpu), column.growth());
        assert!((got / expected - 1.0).abs() <= 5e-3, "{column:?}: {got} where {expected}");
        assert_eq!(got > 1.0, column.over > 1.0, "{column:?}: {got}");
    }
}
