//! Traffic between host and device: submissions, dispatches, waits, bytes, and the device's idle time.

use std::sync::Mutex;
use std::time::Instant;

/// Counts since the device was opened. The difference of two readings is the traffic between them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Traffic {
    /// Number of times that the host waited for submitted work. A readback that is already mapped does not count.
    pub waits: u64,
    /// Command buffers submitted to the queue.
    pub submissions: u64,
    /// Dispatches, including indirect ones with zero workgroups.
    pub dispatches: u64,
    /// Bytes written by the host.
    pub bytes_up: u64,
    /// Bytes copied to host-visible buffers, including timestamps.
    pub bytes_down: u64,
    /// Seconds between the end of a wait and the next submission, when the queue is empty.
    pub idle_seconds: f64,
}

impl Traffic {
    /// Traffic since an earlier reading.
    pub fn since(self, earlier: Traffic) -> Traffic {
        Traffic {
            waits: self.waits - earlier.waits,
            submissions: self.submissions - earlier.submissions,
            dispatches: self.dispatches - earlier.dispatches,
            bytes_up: self.bytes_up - earlier.bytes_up,
            bytes_down: self.bytes_down - earlier.bytes_down,
            idle_seconds: self.idle_seconds - earlier.idle_seconds,
        }
    }
}

/// A stage and one of its kernels.
pub type StageKernel = (&'static str, &'static str);

/// Dispatches and waits by stage, in order.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// Stage and kernel of every dispatch.
    pub dispatches: Vec<StageKernel>,
    /// For every wait, the last stage submitted before it.
    pub waits: Vec<&'static str>,
}

/// Counters of a device.
#[derive(Debug, Default)]
pub(super) struct Meter(Mutex<Counters>);

#[derive(Debug, Default)]
struct Counters {
    traffic: Traffic,
    /// End of the last wait, until the next submission.
    idle_since: Option<Instant>,
    /// Last stage submitted.
    stage: &'static str,
    /// Present between [`Meter::start_trace`] and [`Meter::take_trace`].
    trace: Option<Trace>,
}

impl Counters {
    fn idle_seconds(&self) -> f64 {
        let now = self.idle_since.map_or(0.0, |start| start.elapsed().as_secs_f64());
        self.traffic.idle_seconds + now
    }
}

impl Meter {
    /// Applies an update. After a panic elsewhere (poisoned lock) the counts no longer matter.
    fn with<R: Default>(&self, update: impl FnOnce(&mut Counters) -> R) -> R {
        self.0.lock().map_or_else(|_| R::default(), |mut counters| update(&mut counters))
    }

    pub(super) fn traffic(&self) -> Traffic {
        self.with(|counters| Traffic { idle_seconds: counters.idle_seconds(), ..counters.traffic })
    }

    pub(super) fn start_trace(&self) {
        self.with(|counters| counters.trace = Some(Trace::default()));
    }

    pub(super) fn take_trace(&self) -> Trace {
        self.with(|counters| counters.trace.take()).unwrap_or_default()
    }

    pub(super) fn uploaded(&self, bytes: u64) {
        self.with(|counters| counters.traffic.bytes_up += bytes);
    }

    pub(super) fn submitted(&self, dispatches: &[StageKernel], bytes_down: u64) {
        self.with(|counters| {
            counters.traffic.idle_seconds = counters.idle_seconds();
            counters.idle_since = None;
            counters.traffic.submissions += 1;
            counters.traffic.dispatches += dispatches.len() as u64;
            counters.traffic.bytes_down += bytes_down;
            if let Some((stage, _)) = dispatches.last() {
                counters.stage = stage;
            }
            if let Some(trace) = &mut counters.trace {
                trace.dispatches.extend_from_slice(dispatches);
            }
        });
    }

    /// Records that the queue is empty after a wait.
    pub(super) fn waited(&self) {
        self.with(|counters| {
            if counters.idle_since.is_some() {
                return;
            }
            counters.idle_since = Some(Instant::now());
            if counters.traffic.submissions == 0 {
                return;
            }
            counters.traffic.waits += 1;
            let stage = counters.stage;
            if let Some(trace) = &mut counters.trace {
                trace.waits.push(stage);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use std::thread::sleep;
    use std::time::Duration;

    use super::{Meter, Traffic};

    #[test]
    fn only_a_wait_for_new_work_counts() {
        let meter = Meter::default();
        // Nothing submitted yet.
        meter.waited();
        meter.uploaded(12);
        meter.start_trace();
        meter.submitted(&[("forces", "add_gravity"), ("solve", "pcg")], 8);
        meter.submitted(&[], 4);
        meter.waited();
        meter.waited();
        let traffic = meter.traffic();
        let expected = Traffic {
            waits: 1,
            submissions: 2,
            dispatches: 2,
            bytes_up: 12,
            bytes_down: 12,
            idle_seconds: traffic.idle_seconds,
        };
        assert_eq!(traffic, expected);
        let trace = meter.take_trace();
        assert_eq!(trace.waits, ["solve"]);
        assert_eq!(trace.dispatches.len(), 2);
        assert!(meter.take_trace().dispatches.is_empty());
    }

    #[test]
    fn the_device_is_idle_between_a_wait_and_the_next_submission() {
        let meter = Meter::default();
        let pause = Duration::from_millis(20);
        meter.submitted(&[], 0);
        // The queue is not empty.
        sleep(pause);
        assert_eq!(meter.traffic().idle_seconds, 0.0);
        meter.waited();
        let start = meter.traffic();
        sleep(pause);
        assert!(meter.traffic().since(start).idle_seconds >= pause.as_secs_f64());
        meter.submitted(&[], 0);
        let idle = meter.traffic().idle_seconds;
        sleep(pause);
        assert_eq!(meter.traffic().idle_seconds, idle);
    }
}
