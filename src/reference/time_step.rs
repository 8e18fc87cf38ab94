//! `time_step`: the largest sub-step that velocities, accelerations and frame times allow.
//!
//! A free surface that moves with the velocity of the sub-step before is stable while w dt < 2, w the frequency of its
//! shortest waves. On a grid w^2 is at most a / dx times a number, which makes that dt sqrt(a / dx) < 0.97 in three
//! dimensions. Near it a surface roughens.

use crate::elastic::Solids;
use crate::geometry::ObstacleCut;
use crate::scene::{SHORTEST_STEP, Scene, Surface};

/// Largest dt sqrt(a / dx) of a surface in motion.
const WAVE_CFL: f64 = 0.9;
/// The first sub-step over the longest for the surface: liquid at rest starts with the acceleration of its first solve.
const FIRST: f64 = 0.25;
/// Largest growth of dt from one sub-step to the next, because markers move with velocities of the last dt.
const GROWTH: f64 = 1.5;
/// Times of control in the time sqrt(L / a) that a fall along the domain takes.
const CONTROLS: f64 = 8.0;
/// Relative rounding that must not add a sub-step.
const ROUNDING: f64 = 1e-9;

/// The length of a sub-step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeStep {
    /// Length, s.
    pub dt: f64,
    /// Whether the velocities require less than dt: less than the shortest sub-step, or than a fixed one.
    pub floored: bool,
    /// See [`StepLimits::control_time`], s.
    pub control_time: f64,
}

impl TimeStep {
    /// No time passes.
    pub const NONE: TimeStep = TimeStep {
        dt: 0.0,
        floored: false,
        control_time: f64::INFINITY,
    };
}

/// Limits of the sub-steps of a scene.
#[derive(Clone, Copy, Debug)]
pub struct StepLimits {
    dx: f64,
    cfl: f64,
    fixed_step: Option<f64>,
    /// Length, s.
    shortest: f64,
    longest: f64,
    /// Largest acceleration, m/s^2.
    acceleration: f64,
    /// Whether a free surface moves.
    surface: bool,
    /// Longest edge of the domain, m.
    edge: f64,
}

impl StepLimits {
    /// Limits of a scene with these obstacles and solids.
    pub fn new(scene: &Scene, obstacles: Option<&ObstacleCut>, solids: Option<&Solids>) -> Self {
        let (grid, time) = (scene.grid(), &scene.time);
        let obstacles = obstacles.map_or(0.0, |cut| cut.max_acceleration(time.duration));
        let scripts = solids.map_or(0.0, |solids| solids.max_script_acceleration(time.duration));
        let liquid = scene.liquid.as_ref();
        StepLimits {
            dx: grid.dx,
            cfl: time.cfl,
            fixed_step: time.fixed_step,
            shortest: SHORTEST_STEP * time.duration,
            longest: time.max_step.unwrap_or(f64::INFINITY),
            acceleration: scene.domain.gravity.length().max(obstacles).max(scripts),
            surface: liquid.is_some_and(|liquid| liquid.surface == Surface::Markers),
            edge: grid.size().max_element(),
        }
    }

    /// dt = T / ceil(T / min(cfl dx / speed, c sqrt(dx / a), `max_step`, 1.5 dt_last)), at least 1e-7 of the duration. a: the
    /// largest of gravity and the prescribed accelerations of obstacles and solids. c = 0.9 with a free surface in
    /// motion, else cfl; such a surface starts with a quarter of that.
    ///
    /// `speed`: largest magnitude of a velocity component, m/s; `time_left`: T to the next frame, s; `dt_last`: 0 before
    /// the first sub-step. A fixed step divides T into equal parts of about its length, whatever the speed.
    pub fn time_step(&self, speed: f64, time_left: f64, dt_last: f64) -> TimeStep {
        let control_time = self.control_time(speed);
        if let Some(fixed) = self.fixed_step {
            let dt = time_left / (time_left / fixed).round().max(1.0);
            return TimeStep {
                dt,
                floored: speed * dt > self.cfl * self.dx * (1.0 + ROUNDING),
                control_time,
            };
        }
        // Without accelerations and motion both are infinite, and the frame is one sub-step.
        let crossing = self.cfl * self.dx / speed;
        let wave_cfl = if self.surface { WAVE_CFL } else { self.cfl };
        let wave = wave_cfl * (self.dx / self.acceleration).sqrt();
        let from_last = match dt_last {
            0.0 if self.surface => FIRST * wave,
            0.0 => f64::INFINITY,
            _ => GROWTH * dt_last,
        };
        let required = crossing.min(wave).min(from_last).min(self.longest);
        TimeStep {
            dt: time_left
                / (time_left / required.max(self.shortest) * (1.0 - ROUNDING))
                    .ceil()
                    .max(1.0),
            floored: required < self.shortest,
            control_time,
        }
    }

    /// dt sqrt(a / dx); 0 without accelerations.
    pub fn wave_cfl(&self, dt: f64) -> f64 {
        dt * (self.acceleration / self.dx).sqrt()
    }

    /// The time over which volume is controlled, s: sqrt(L / a) / 8, L the longest edge of the domain; without
    /// accelerations L / (8 speed), infinite at rest.
    pub fn control_time(&self, speed: f64) -> f64 {
        match self.acceleration {
            0.0 => self.edge / (CONTROLS * speed),
            a => (self.edge / a).sqrt() / CONTROLS,
        }
    }
}
