//! `time_step`: the largest sub-step that velocities, accelerations and frame times allow.
//!
//! A free surface that moves with the velocity of the last sub-step is stable for w dt < 2, w the frequency of its
//! shortest waves. On a grid w^2 is at most a constant times a / dx. In three dimensions this means dt sqrt(a / dx) <
//! 0.97. Near this limit a surface roughens.

use crate::elastic::Solids;
use crate::scene::{Acceleration, Domain, SHORTEST_STEP, Scene, Surface};

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
    /// dt sqrt(a / dx), a the largest acceleration.
    pub wave_cfl: f64,
    /// Courant number of the surface, dt speed / dx + dt sqrt(a / dx): cells that it moves at most.
    pub courant: f64,
}

impl TimeStep {
    /// No time passes.
    pub const NONE: TimeStep =
        TimeStep { dt: 0.0, floored: false, control_time: f64::INFINITY, wave_cfl: 0.0, courant: 0.0 };

    /// Cells that the surface moves at most, up to one. What smooths the surface in every sub-step is scaled with it, so that
    /// short sub-steps do not smooth more.
    pub fn motion(&self) -> f64 {
        self.courant.min(1.0)
    }

    /// Largest slope by which the velocity of a liquid with a level continues beyond its surface, m/s per cell: dx / (2 dt), dt at least the limit of
    /// waves. Waves have less. A steeper one is an impact's, whose jets would gain energy, the more the shorter the sub-steps.
    pub fn largest_slope(&self, dx: f64) -> f64 {
        0.5 * dx * (self.wave_cfl / WAVE_CFL).min(1.0) / self.dt.max(f64::MIN_POSITIVE)
    }
}

/// Limits of the sub-steps of a scene.
#[derive(Clone, Debug)]
pub struct StepLimits {
    dx: f64,
    cfl: f64,
    fixed_step: Option<f64>,
    /// Length, s.
    shortest: f64,
    longest: f64,
    /// Gravity.
    domain: Domain,
    /// Of obstacles and solids.
    prescribed: Vec<Acceleration>,
    /// Whether a free surface moves.
    surface: bool,
    /// Longest edge of the domain, m.
    edge: f64,
}

impl StepLimits {
    /// Limits of a scene with these prescribed accelerations of its obstacles and solids.
    pub fn new(scene: &Scene, obstacles: Vec<Acceleration>, solids: Option<&Solids>) -> Self {
        let (grid, time) = (scene.grid(), &scene.time);
        let scripts = solids.into_iter().flat_map(Solids::accelerations);
        let liquid = scene.liquid.as_ref();
        StepLimits {
            dx: grid.dx,
            cfl: time.cfl,
            fixed_step: time.fixed_step,
            shortest: SHORTEST_STEP * time.duration,
            longest: time.max_step.unwrap_or(f64::INFINITY),
            domain: scene.domain.clone(),
            prescribed: obstacles.into_iter().chain(scripts).collect(),
            surface: liquid.is_some_and(|liquid| liquid.surface != Surface::Fixed),
            edge: grid.size().max_element(),
        }
    }

    /// dt = T / ceil(T / min(cfl dx / speed, c sqrt(dx / a), `max_step`, 1.5 dt_last)), at least 1e-7 of the duration. a: the
    /// largest of gravity and the prescribed accelerations of obstacles and solids in such a sub-step. c = 0.9 with a free
    /// surface in motion, else cfl; such a surface starts with a quarter of that. 2 dt_last where that reaches the frame.
    ///
    /// `speed`: largest magnitude of a velocity component, m/s; `[time, left]`: s, and T to the next frame; `dt_last`: 0
    /// before the first sub-step; `contact`: [`State::contact_step`](crate::state::State::contact_step), s. A fixed step
    /// divides T into equal parts of about its length, whatever the speed.
    pub fn time_step(&self, speed: f64, [time, left]: [f64; 2], [dt_last, contact]: [f64; 2]) -> TimeStep {
        let of_length = |dt: f64, floored: bool| {
            let wave_cfl = dt * (self.acceleration(time, dt) / self.dx).sqrt();
            TimeStep {
                dt,
                floored,
                control_time: self.control_time(speed),
                wave_cfl,
                courant: dt * speed / self.dx + wave_cfl,
            }
        };
        if let Some(fixed) = self.fixed_step {
            let dt = left / (left / fixed).round().max(1.0);
            let dt = if contact > 0.0 && dt > contact * (1.0 + ROUNDING) { parts_of(left, contact) } else { dt };
            return of_length(dt, speed * dt > self.cfl * self.dx * (1.0 + ROUNDING));
        }
        let wave_cfl = if self.surface { WAVE_CFL } else { self.cfl };
        let wave = |span: f64| wave_cfl * (self.dx / self.acceleration(time, span)).sqrt();
        // Without accelerations and motion all are infinite, and the frame is one sub-step.
        let mut longest = (self.cfl * self.dx / speed).min(self.longest).min(wave(0.0));
        if dt_last > 0.0 {
            // Two equal parts of a frame would never grow into one.
            let whole = 2.0 * dt_last * (1.0 + ROUNDING) >= left;
            longest = longest.min(if whole { 2.0 } else { GROWTH } * dt_last);
        }
        if contact > 0.0 {
            longest = longest.min(contact);
        }
        // Accelerations that begin within the sub-step count.
        let wave = wave(longest.min(left));
        longest = longest.min(wave);
        if dt_last == 0.0 && self.surface {
            longest = longest.min(FIRST * wave);
        }
        of_length(parts_of(left, longest.max(self.shortest)), longest < self.shortest)
    }

    /// Largest acceleration between a time and `span` (both s) later, m/s^2.
    fn acceleration(&self, time: f64, span: f64) -> f64 {
        let during = |of: &&Acceleration| of.times[0] <= time + span && of.times[1] >= time;
        let sizes = self.prescribed.iter().filter(during).map(|of| of.size);
        sizes.fold(self.domain.strongest_gravity([time, time + span]), f64::max)
    }

    /// The time over which volume is controlled, s: sqrt(L / a) / 8, L the longest edge of the domain, a the largest gravity, or without
    /// it the largest prescribed acceleration; without any L / (8 speed), infinite at rest.
    pub fn control_time(&self, speed: f64) -> f64 {
        let prescribed = self.prescribed.iter().map(|of| of.size);
        let acceleration = match self.domain.strongest_gravity([0.0, f64::MAX]) {
            0.0 => prescribed.fold(0.0, f64::max),
            gravity => gravity,
        };
        match acceleration {
            0.0 => self.edge / (CONTROLS * speed),
            _ => (self.edge / acceleration).sqrt() / CONTROLS,
        }
    }
}

/// The fewest equal parts of `left` that are at most `longest`, all s.
fn parts_of(left: f64, longest: f64) -> f64 {
    let parts = left / longest * (1.0 - ROUNDING);
    left / parts.ceil().max(1.0)
}
