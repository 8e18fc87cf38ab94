//! Signals that end a command where its files are whole. A signal that was ignored when the program started stays ignored, as `nohup` and
//! the background jobs of scripts need it.

use cutwater::Error;

/// Calls `received` with the number of each signal that asks the program to end, in a thread of its own: SIGINT, SIGTERM and SIGHUP, but
/// for those that were ignored at the start. Once per process.
///
/// # Errors
/// [`Error::Input`] where the system refuses a handler.
#[cfg(unix)]
pub(super) fn on_end(received: impl Fn(i32) + Send + 'static) -> Result<(), Error> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::iterator::Signals;

    let caught: Vec<i32> = match ignored_at_start() {
        Some(ignored) => [SIGINT, SIGTERM, SIGHUP]
            .into_iter()
            .filter(|&signal| !is_ignored(ignored, signal))
            .collect(),
        // SIGHUP keeps its action, which is right both for a command under nohup and for one that is not.
        None => vec![SIGINT, SIGTERM],
    };
    let mut signals = Signals::new(caught).map_err(|problem| refused(&problem))?;
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || signals.forever().for_each(received))
        .map_err(|problem| refused(&problem))?;
    Ok(())
}

/// The same of Ctrl-C alone.
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

/// Makes a write beyond the limit for file sizes (`ulimit -f`) fail with an error, where SIGXFSZ would end the program without a word.
pub(super) fn survive_file_size_limit() {
    #[cfg(unix)]
    {
        // A caught signal lets the write return EFBIG. Without a handler the signal ends the program, as before.
        let _ =
            signal_hook::flag::register(signal_hook::consts::SIGXFSZ, std::sync::Arc::default());
    }
}

/// Bit mask of the signals that this process ignores, bit 0 for signal 1; `None` where the system has no /proc.
#[cfg(unix)]
fn ignored_at_start() -> Option<u64> {
    ignored_in(&std::fs::read_to_string("/proc/self/status").ok()?)
}

/// The line `SigIgn` of /proc/PID/status.
#[cfg(unix)]
fn ignored_in(status: &str) -> Option<u64> {
    let mask = status
        .lines()
        .find_map(|line| line.strip_prefix("SigIgn:"))?;
    u64::from_str_radix(mask.trim(), 16).ok()
}

#[cfg(unix)]
fn is_ignored(mask: u64, signal: i32) -> bool {
    mask >> (signal - 1) & 1 == 1
}

#[cfg(all(test, unix))]
mod tests {
    use super::{ignored_in, is_ignored};

    #[test]
    fn ignored_signals_are_read_from_the_status() {
        let status = "Name:\tsh\nSigBlk:\t0000000000000000\nSigIgn:\t0000000000001003\nSigCgt:\t0000000000004000\n";
        let mask = ignored_in(status).unwrap();
        let ignored: Vec<i32> = (1..=64)
            .filter(|&signal| is_ignored(mask, signal))
            .collect();
        // SIGHUP, SIGINT and SIGPIPE.
        assert_eq!(ignored, [1, 2, 13]);
        assert_eq!(ignored_in("Name:\tsh\n"), None);
    }
}
