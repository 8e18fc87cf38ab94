//! Lines to standard output and standard error. A reader that has had enough (`cutwater run .. | head`) ends no command, as the
//! macros of the standard library would: what cannot be written is not written.

use std::fmt::Arguments;
use std::io::Write;

/// As `println!`.
macro_rules! say {
    ($($part:tt)*) => { $crate::cli::say::line(std::io::stdout(), format_args!($($part)*)) };
}

/// As `eprintln!`.
macro_rules! warn {
    ($($part:tt)*) => { $crate::cli::say::line(std::io::stderr(), format_args!($($part)*)) };
}

pub(super) fn line(mut to: impl Write, line: Arguments) {
    let _ = writeln!(to, "{line}");
}
