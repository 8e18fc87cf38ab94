//! The limit of added mass of weak coupling, in one dimension.
//!
//! A piston of mass m_s and spring k per area, at rest, is pushed against a column of liquid m_a = rho L, p = 0 at its other end. Weak
//! coupling gives it the pressure p = -m_a (v_n - v_(n-1)) / dt of the sub-step before, and the solid's backward Euler then
//! m_s (v_(n+1) - v_n) + dt k x_(n+1) = dt p. With a = k dt^2 / m_s and r = m_a / m_s velocities go as z^n,
//!
//! ```text
//! (1 + a) z^3 + (r - 2) z^2 + (1 - 2 r) z + r = 0,
//! ```
//!
//! of which z = -r is a root where there is no spring, for every dt, and z = -1 where r = 1 + a / 4.

use crate::Error;
use crate::measure::bench::table::{Row, columns, row};
use crate::scene::Scene;
use crate::sim::{Backend, Simulation};

/// Of the growth per sub-step, relative, and of the limit.
const TOLERANCE: f64 = 0.05;
/// Pa: a piston of this much does not give way.
const RIGID: f64 = 1e11;
/// m
const DX: f64 = 0.03;
/// Cells to the end of the piston: the middle of one, where the column of its cell begins.
const PISTON: f64 = 20.5;
/// m
const COLUMN: f64 = 0.9;
/// Of the push, m/s.
const PUSH: f64 = 1e-7;

/// A column of liquid on a piston.
#[derive(Clone, Copy, Debug)]
pub struct Limit {
    /// Frequency of the spring times the sub-step, w dt; 0: no spring.
    omega_dt: f64,
    /// m_a / m_s over the limit 1 + (w dt)^2 / 4.
    over: f64,
    /// s
    dt: f64,
}

columns! {
    LIMIT {
        passed + "" "whether the growth is within the tolerance and on the side of 1 that theory gives";
        name = "" "name";
        ratio + "" "m_a / m_s";
        omega_dt - "" "w dt of the spring";
        dt - "s" "sub-step";
        over_limit - "" "m_a / m_s over the limit 1 + (w dt)^2 / 4: above 1 weak coupling is unstable";
        expected + "" "growth of the velocity per sub-step by the formula, or measured with the longer sub-step";
        got + "" "measured";
        off - "" "relative difference";
        tolerance - "" "bound of `off`";
    }
}

/// Without a spring at two lengths of the sub-step, and with one 5 % below the limit and 5 % above.
pub fn limits() -> Vec<Limit> {
    let mut limits = Vec::new();
    for dt in [0.01, 0.0025] {
        limits.extend([0.5, 0.8, 1.25, 2.0].map(|over| Limit {
            omega_dt: 0.0,
            over,
            dt,
        }));
    }
    for omega_dt in [1.0, 3.2] {
        limits.extend([1.0 - TOLERANCE, 1.0 + TOLERANCE].map(|over| Limit {
            omega_dt,
            over,
            dt: 0.01,
        }));
    }
    limits
}

/// For columns without a spring at two lengths of the sub-step, one growth against the other: shorter sub-steps do not help.
pub(super) fn step_lengths(rows: &[Row]) -> Vec<Row> {
    let pairs = rows.iter().enumerate().filter_map(|(number, long)| {
        let of = |row: &Row| row.only(&["omega_dt", "ratio"]);
        let same = |other: &&Row| {
            other.number("omega_dt") == 0.0
                && of(other) == of(long)
                && other.get("dt") != long.get("dt")
        };
        Some((long, rows[number + 1..].iter().find(same)?))
    });
    let row = |(long, short): (&Row, &Row)| {
        let off = short.number("got") / long.number("got") - 1.0;
        let name = format!("{}_and_{}", long.text("name"), short.number("dt"));
        let passed = off.abs() <= TOLERANCE;
        short
            .clone()
            .with(row! { name: name, expected: long.number("got"), off: off, passed: passed })
    };
    pairs.map(row).collect()
}

impl Limit {
    /// `limit_` and its numbers.
    pub fn name(&self) -> String {
        let Limit { omega_dt, over, dt } = self;
        format!("limit_{over}_w_dt_{omega_dt}_dt_{dt}")
    }

    /// m_a / m_s
    fn ratio(&self) -> f64 {
        self.over * (1.0 + 0.25 * self.omega_dt.powi(2))
    }

    /// The root below zero, of the two or more that its magnitude makes of signs that alternate.
    fn growth(&self) -> f64 {
        let (a, r) = (self.omega_dt.powi(2), self.ratio());
        let cubic = |z: f64| (((1.0 + a) * z + r - 2.0) * z + 1.0 - 2.0 * r) * z + r;
        // Below zero the cubic rises from minus infinity to r > 0 at z = 0.
        let (mut low, mut high) = (-10.0 - r, 0.0);
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            match cubic(middle) < 0.0 {
                true => low = middle,
                false => high = middle,
            }
        }
        -low
    }

    fn scene(&self) -> Result<Scene, Error> {
        let length = PISTON * DX;
        let mass = 1000.0 * COLUMN / self.ratio();
        let spring = mass * (self.omega_dt / self.dt).powi(2);
        // A spring of one layer of bricks has half of its mass at the end that is held.
        let (density, young, held) = match self.omega_dt > 0.0 {
            true => (2.0 * mass / length, spring * length, 0.001),
            false => (mass / (0.5 * length), RIGID, 0.0),
        };
        // A free piston begins off the wall, or that would hold it.
        let start = match held > 0.0 {
            true => 0.0,
            false => 0.5 * length,
        };
        let mut text = format!(
            "[domain]
size = [{:?}, {width:?}, {width:?}]
cells = [64, 4, 4]
gravity = [0, 0, 0]
[time]
duration = 10
frames_per_second = {:?}
fixed_step = {:?}
[liquid]
surface = \"fixed\"
[[liquid.region]]
half_space = {{ point = [{:?}, 0, 0], normal = [1, 0, 0] }}
[[liquid.region]]
half_space = {{ point = [{:?}, 0, 0], normal = [1, 0, 0] }}
subtract = true
[[solid]]
name = \"piston\"
mesh = {{ box = {{ size = [{:?}, {width:?}, {width:?}], cells = [1, 4, 4] }} }}
placement = {{ translate = [{:?}, {:?}, {:?}] }}
initial = {{ velocity = [{PUSH:?}, 0, 0] }}
density = {density:?}
young = {young:?}
poisson = 0.0
[[solid.pin]]
region = {{ box = {{ min = [0, 0, 0], max = [{length:?}, {width:?}, {width:?}] }} }}
components = \"yz\"
[solver]
coupling = \"weak\"
tolerance = 1e-10
pressure_on_patches = \"cell\"
",
            64.0 * DX,
            1.0 / self.dt,
            self.dt,
            length + COLUMN,
            start + 0.5 * (length - start),
            length - start,
            0.5 * (start + length),
            2.0 * DX,
            2.0 * DX,
            width = 4.0 * DX,
        );
        if held > 0.0 {
            text += &format!(
                "[[solid.pin]]
region = {{ box = {{ min = [0, 0, 0], max = [{held:?}, {width:?}, {width:?}] }} }}
components = \"x\"
",
                width = 4.0 * DX
            );
        }
        Scene::parse("limit.toml".as_ref(), &text, &[], 1.0)
    }

    /// Measures the growth.
    ///
    /// # Errors
    /// Errors of the simulation.
    pub fn run(&self, backend: &Backend) -> Result<Row, Error> {
        // Until the other roots are gone: without a spring the only one is 1, whose velocity does not change.
        let (steps, over) = match self.omega_dt > 0.0 {
            true => (40, 8),
            false => (10, 6),
        };
        let mut simulation = Simulation::new(&self.scene()?, backend)?;
        let end = PISTON * DX;
        let mut velocities = Vec::new();
        for _ in 0..steps {
            simulation.step()?;
            let state = simulation.state()?;
            let rest = simulation.solids().rest.iter().zip(&state.node_velocity);
            let of_end = rest.filter(|(x, _)| (x.x - end).abs() < 1e-6);
            let (mut sum, mut count) = (0.0, 0);
            for (_, v) in of_end {
                sum += v[0];
                count += 1;
            }
            velocities.push(sum / f64::from(count));
        }
        let changes: Vec<f64> = velocities.windows(2).map(|v| v[1] - v[0]).collect();
        let last = changes.len() - 1;
        let got = (changes[last] / changes[last - over]).abs();
        let got = got.powf(1.0 / over as f64);
        let expected = self.growth();
        let off = got / expected - 1.0;
        let passed = off.abs() <= TOLERANCE && (got > 1.0) == (self.over > 1.0);
        Ok(row! {
            name: self.name(), ratio: self.ratio(), omega_dt: self.omega_dt, dt: self.dt, over_limit: self.over, expected: expected,
            got: got, off: off, tolerance: TOLERANCE, passed: passed,
        })
    }
}
