//! Signals that end a command with complete files. A signal ignored at the start remains ignored, as `nohup` and background jobs of
//! scripts require.

use crate::Error;

/// Calls `received` in a thread of its own with the number of each SIGINT, SIGTERM and SIGHUP, except those ignored at the start. Once
/// per process.
#[cfg(unix)]
pub(super) fn on_end(received: impl Fn(i32) + Send + 'static) -> Result<(), Error> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::iterator::Signals;

    let caught: Vec<i32> = match ignored_at_start() {
        Some(ignored) => [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|&signal| !is_ignored(ignored, signal)).collect(),
        // The default action of SIGHUP is right with and without nohup.
        None => vec![SIGINT, SIGTERM],
    };
    let mut signals = Signals::new(caught).map_err(|problem| refused(&problem))?;
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || signals.forever().for_each(received))
        .map_err(|problem| refused(&problem))?;
    Ok(())
}

/// Only Ctrl-C elsewhere.
#[cfg(not(unix))]
pub(super) fn on_end(received: impl Fn(i32) + Send + 'static) -> Result<(), Error> {
    ctrlc::set_handler(move || received(2)).map_err(|problem| refused(&problem))
}

fn refused(problem: &dyn std::fmt::Display) -> Error {
    Error::input(
        "the interrupt handler",
        problem.to_string(),
        "raise the limits of processes and open files (`ulimit -u`, `ulimit -n`)",
    )
}

/// Turns SIGXFSZ, which would end the program silently, into errors of writes beyond the limit for file sizes (`ulimit -f`).
pub(super) fn survive_file_size_limit() {
    #[cfg(unix)]
    {
        // With a handler the write returns EFBIG; an error here leaves the default action.
        let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, std::sync::Arc::default());
    }
}

/// Bit mask of the ignored signals, bit 0 for signal 1; `None` on systems without /proc.
#[cfg(unix)]
fn ignored_at_start() -> Option<u64> {
    ignored_in(&std::fs::read_to_string("/proc/self/status").ok()?)
}

/// The line `SigIgn` of /proc/PID/status.
#[cfg(any(unix, test))]
fn ignored_in(status: &str) -> Option<u64> {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"))?;
    u64::from_str_radix(mask.trim(), 16).ok()
}

#[cfg(any(unix, test))]
fn is_ignored(mask: u64, signal: i32) -> bool {
    mask >> (signal - 1) & 1 == 1
}

#[cfg(test)]
mod tests {
    use super::{ignored_in, is_ignored};

    #[test]
    fn ignored_signals_are_read_from_the_status() {
        let status = "Name:\tsh\nSigBlk:\t0000000000000000\nSigIgn:\t0000000000001003\nSigCgt:\t0000000000004000\n";
        let mask = ignored_in(status).unwrap();
        let ignored: Vec<i32> = (1..=64).filter(|&signal| is_ignored(mask, signal)).collect();
        // SIGHUP, SIGINT and SIGPIPE.
        assert_eq!(ignored, [1, 2, 13]);
        assert_eq!(ignored_in("Name:\tsh\n"), None);
    }
}
