//! Lines to standard output and standard error. A closed pipe (`cutwater run .. | head`) or a full disk ends no command, unlike with the
//! macros of the standard library. Unwritten lines are an error at the end of the command.

use std::fmt::Arguments;
use std::io::{self, ErrorKind, IsTerminal, Write};
use std::sync::OnceLock;

use crate::Error;

/// First error of standard output.
static REFUSED: OnceLock<io::Error> = OnceLock::new();

/// Whether standard output was a terminal when the program started.
static TERMINAL: OnceLock<bool> = OnceLock::new();

/// As `println!`.
macro_rules! say {
    ($($part:tt)*) => { $crate::cli::say::to_stdout(format_args!($($part)*)) };
}

/// As `eprintln!`.
macro_rules! warn {
    ($($part:tt)*) => { $crate::cli::say::to_stderr(format_args!($($part)*)) };
}

pub(super) fn to_stdout(line: Arguments) {
    record(writeln!(io::stdout(), "{line}"));
}

pub(super) fn to_stderr(line: Arguments) {
    // An error cannot be reported anywhere else.
    let _ = writeln!(io::stderr(), "{line}");
}

/// Stores whether standard output is a terminal: the system does not recognise a closed one.
pub(super) fn record_terminal() {
    let _ = TERMINAL.set(io::stdout().is_terminal());
}

/// Whether the reader is gone: a closed pipe or terminal.
fn is_closed(problem: &io::Error) -> bool {
    const EIO: i32 = 5;
    let closed = cfg!(unix) && problem.raw_os_error() == Some(EIO) && TERMINAL.get() == Some(&true);
    problem.kind() == ErrorKind::BrokenPipe || closed
}

fn record(written: io::Result<()>) {
    if let Err(problem) = written
        && !is_closed(&problem)
    {
        // Fails, as it should, if an earlier error is stored.
        let _ = REFUSED.set(problem);
    }
}

/// An error if standard output has not accepted all lines, and is not closed.
pub(super) fn ensure_printed() -> Result<(), Error> {
    record(io::stdout().flush());
    match REFUSED.get() {
        None => Ok(()),
        Some(problem) => Err(Error::Output {
            path: "standard output".into(),
            problem: problem.to_string(),
            cure: match problem.kind() {
                ErrorKind::FileTooLarge => {
                    "raise the limit for file sizes (`ulimit -f unlimited`); files of the command are complete"
                }
                _ => "redirect it to a disk with free space; files of the command are complete",
            },
        }),
    }
}
