//! `time_step`: the largest sub-step that the velocities allow and that ends on the frame times.

use crate::scene::Time;

/// Largest growth of dt from one sub-step to the next, because markers move with velocities of the last dt.
const GROWTH: f64 = 1.5;
/// Largest number of sub-steps per frame.
const LARGEST_COUNT: f64 = 256.0;
/// Relative rounding that must not add a sub-step.
const ROUNDING: f64 = 1e-9;

/// The length of a sub-step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeStep {
    /// Length, s.
    pub dt: f64,
    /// Whether the velocities require less than dt: less than 1/256 of a frame, or than a fixed step.
    pub floored: bool,
}

/// dt_cfl = cfl dx / max(speed, sqrt(|g| dx)); dt = T / ceil(T / min(dt_cfl, 1.5 dt_last)), at least about frame /
/// 256.
///
/// `speed`: largest magnitude of a face velocity component, m/s; `fall`: sqrt(|g| dx), m/s; `time_left`: T to the
/// next frame, s; `dt_last`: 0 before the first step. A fixed step divides T into equal parts of about its length,
/// independent of the speed.
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
    // Without gravity and motion the quotient is infinite and the frame is one sub-step.
    let mut required = time.cfl * dx / speed.max(fall);
    if dt_last > 0.0 {
        required = required.min(GROWTH * dt_last);
    }
    let floored = required < floor;
    TimeStep {
        dt: time_left
            / (time_left / required.max(floor) * (1.0 - ROUNDING))
                .ceil()
                .max(1.0),
        floored,
    }
}
