//! `time_step`: the largest step that the velocities allow and that lands on the frame times.

use crate::scene::Time;

/// How much longer a step may be than the one before: markers move with velocities that were solved under the last dt.
const GROWTH: f64 = 1.5;
/// A frame never takes more sub-steps than this by itself.
const LARGEST_COUNT: f64 = 256.0;
/// Relative rounding that must not cost a further sub-step.
const ROUNDING: f64 = 1e-9;

/// The length of a sub-step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeStep {
    /// s
    pub dt: f64,
    /// Whether the velocities asked for less: than 1/256 of a frame, or than a fixed step.
    pub floored: bool,
}

/// dt_cfl = cfl dx / max(speed, sqrt(|g| dx)); dt = T / ceil(T / min(dt_cfl, 1.5 dt_last)), at least about frame / 256.
///
/// `speed`: largest magnitude of a face velocity component, m/s; `fall`: sqrt(|g| dx), m/s; `time_left`: T to the next frame,
/// s; `dt_last`: 0 before the first step. A fixed step divides T into equal parts of about its length, however fast anything is.
pub fn time_step(
    time: &Time,
    dx: f64,
    speed: f64,
    fall: f64,
    time_left: f64,
    dt_last: f64,
) -> TimeStep {
    if let Some(fixed) = time.fixed_step {
        let dt = time_left / (time_left / fixed).round().max(1.0);
        return TimeStep {
            dt,
            floored: speed * dt > time.cfl * dx * (1.0 + ROUNDING),
        };
    }
    let floor = 1.0 / (time.frames_per_second * LARGEST_COUNT);
    // Without gravity a liquid at rest asks for no sub-steps: the quotient is infinite and the frame is one step.
    let mut wanted = time.cfl * dx / speed.max(fall);
    if dt_last > 0.0 {
        wanted = wanted.min(GROWTH * dt_last);
    }
    let floored = wanted < floor;
    TimeStep {
        dt: time_left
            / (time_left / wanted.max(floor) * (1.0 - ROUNDING))
                .ceil()
                .max(1.0),
        floored,
    }
}
