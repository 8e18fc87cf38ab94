//! Lines to standard output and standard error. A reader that has had enough (`cutwater run .. | head`) ends no command, as the
//! macros of the standard library would. Nor does a full disk: what could not be written is told once the work is done.

use std::fmt::Arguments;
use std::io::{self, ErrorKind, Write};
use std::sync::OnceLock;

use cutwater::Error;

/// Why standard output did not take a line, the first time.
static REFUSED: OnceLock<io::Error> = OnceLock::new();

/// As `println!`.
macro_rules! say {
    ($($part:tt)*) => { $crate::cli::say::to_stdout(format_args!($($part)*)) };
}

/// As `eprintln!`.
macro_rules! warn {
    ($($part:tt)*) => { $crate::cli::say::to_stderr(format_args!($($part)*)) };
}

pub(super) fn to_stdout(line: Arguments) {
    keep(writeln!(io::stdout(), "{line}"));
}

pub(super) fn to_stderr(line: Arguments) {
    // There is nowhere else to tell of it.
    let _ = writeln!(io::stderr(), "{line}");
}

fn keep(written: io::Result<()>) {
    if let Err(problem) = written
        && problem.kind() != ErrorKind::BrokenPipe
    {
        // Where there is one, it is the first.
        let _ = REFUSED.set(problem);
    }
}

/// # Errors
/// [`Error::Output`] where standard output did not take all lines, though its reader had not left.
pub(super) fn ensure_said() -> Result<(), Error> {
    keep(io::stdout().flush());
    match REFUSED.get() {
        None => Ok(()),
        Some(problem) => Err(Error::Output {
            path: "standard output".into(),
            problem: problem.to_string(),
            cure: "redirect it to where there is room; files of the command are whole",
        }),
    }
}
