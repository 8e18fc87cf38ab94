//! Lines to standard output and standard error. A reader that has had enough (`cutwater run .. | head`) ends no command, as the
//! macros of the standard library would. Nor does a full disk: what could not be written is told once the work is done.

use std::fmt::Arguments;
use std::io::{self, ErrorKind, IsTerminal, Write};
use std::sync::OnceLock;

use cutwater::Error;

/// Why standard output did not take a line, the first time.
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
    keep(writeln!(io::stdout(), "{line}"));
}

pub(super) fn to_stderr(line: Arguments) {
    // There is nowhere else to tell of it.
    let _ = writeln!(io::stderr(), "{line}");
}

/// Notes where standard output goes to: of a terminal that was closed since, the system cannot tell.
pub(super) fn note_terminal() {
    let _ = TERMINAL.set(io::stdout().is_terminal());
}

/// Whether nobody reads any more: a pipe without a reader, or a terminal that was closed.
fn has_left(problem: &io::Error) -> bool {
    const EIO: i32 = 5;
    let closed = cfg!(unix) && problem.raw_os_error() == Some(EIO) && TERMINAL.get() == Some(&true);
    problem.kind() == ErrorKind::BrokenPipe || closed
}

fn keep(written: io::Result<()>) {
    if let Err(problem) = written
        && !has_left(&problem)
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
            cure: match problem.kind() {
                ErrorKind::FileTooLarge => {
                    "raise the limit for file sizes (`ulimit -f unlimited`); files of the command are whole"
                }
                _ => "redirect it to where there is room; files of the command are whole",
            },
        }),
    }
}
