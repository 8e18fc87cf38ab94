//! The error type. Every variant identifies the cause: file, line, key, stage, buffer or limit.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

/// Errors of the library, with the exit code of the command line ([`Error::exit_code`]).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An invalid value in a scene file.
    #[error("{}:{line}: {key}: {problem}\n  cure: {cure}", file.display())]
    Scene {
        /// The scene file.
        file: PathBuf,
        /// Line in the file, from 1. For a missing key: the line of its table, or the last line.
        line: usize,
        /// Dotted key, such as `liquid.region[1].box.min`.
        key: String,
        /// Problem.
        problem: String,
        /// Cure.
        cure: String,
    },
    /// An unusable file or argument.
    #[error("{what}: {problem}\n  cure: {cure}")]
    Input {
        /// The file, with its line if known, or the argument.
        what: String,
        /// Problem.
        problem: String,
        /// Cure.
        cure: String,
    },
    /// A result cannot be written.
    #[error("cannot write {}: {problem}\n  cure: {cure}", path.display())]
    Output {
        /// The file or folder, or `standard output`.
        path: PathBuf,
        /// Message of the system.
        problem: String,
        /// Cure.
        cure: &'static str,
    },
    /// No suitable adapter.
    #[error("no suitable GPU adapter: {problem}\n  cure: {cure}")]
    Adapter {
        /// Requested and present adapters.
        problem: String,
        /// Cure.
        cure: String,
    },
    /// A limit of the adapter is too small for the scene.
    #[error("{what} needs {needed} {unit}, the adapter allows {available}\n  cure: {cure}")]
    Limit {
        /// The buffer or kernel.
        what: String,
        /// Required value.
        needed: u64,
        /// Limit of the adapter.
        available: u64,
        /// Unit of both, with the limit's name.
        unit: &'static str,
        /// Cure.
        cure: String,
    },
    /// Too little free memory for the scene.
    #[error(
        "this scene needs at least {:.1} GiB of the machine's memory, of which {:.1} GiB are free\n  cure: {cure}",
        gibibytes(*needed), gibibytes(*available)
    )]
    Memory {
        /// Required bytes.
        needed: u64,
        /// Free bytes.
        available: u64,
        /// Cure.
        cure: String,
    },
    /// A shader that does not compile.
    #[error("{file}:{line}: {problem}")]
    Shader {
        /// The WGSL file.
        file: String,
        /// Line in that file, from 1.
        line: usize,
        /// Message of naga.
        problem: String,
    },
    /// An error of the device: validation, memory, or a lost device.
    #[error("GPU error in {during}: {problem}")]
    Gpu {
        /// The current buffer, kernel or stage.
        during: String,
        /// Message of the device.
        problem: String,
    },
    /// A failed stage of a sub-step; frames and rows written before remain valid.
    #[error("step {step}, stage {stage}: {problem}")]
    Stage {
        /// The stage, by its canonical noun.
        stage: &'static str,
        /// The sub-step, from 0.
        step: u64,
        /// Problem.
        problem: String,
    },
    /// A failed check of the simulator against itself.
    #[error("check failed: {0}")]
    Check(String),
    /// An interruption by the user; frames and rows written before remain valid.
    #[error("interrupted")]
    Interrupted,
}

impl Error {
    /// Exit code: 1 a check failed, 2 bad input, 3 no suitable adapter or limit, 4 the simulation failed, 130 interrupted.
    pub fn exit_code(&self) -> u8 {
        match self {
            Error::Check(_) => 1,
            Error::Scene { .. } | Error::Input { .. } | Error::Output { .. } => 2,
            Error::Adapter { .. } | Error::Limit { .. } | Error::Memory { .. } => 3,
            Error::Shader { .. } | Error::Gpu { .. } | Error::Stage { .. } => 4,
            Error::Interrupted => 130,
        }
    }

    /// An [`Error::Output`] of a file or folder.
    pub fn output(path: &Path, problem: impl std::fmt::Display) -> Error {
        Error::Output { path: path.to_owned(), problem: problem.to_string(), cure: WRITABLE_FOLDER }
    }

    /// An [`Error::Output`] from an error of the system.
    pub fn unwritten(path: &Path, problem: &io::Error) -> Error {
        let cure = match problem.kind() {
            ErrorKind::StorageFull => "make room on that disk, or choose a folder on another",
            ErrorKind::QuotaExceeded => "remove files of yours from that disk, or choose a folder on another",
            ErrorKind::FileTooLarge => "raise the limit for file sizes (`ulimit -f unlimited`)",
            ErrorKind::InvalidFilename => {
                "use a shorter name for the scene file or the folder: the file system limits names"
            }
            _ => WRITABLE_FOLDER,
        };
        Error::Output { path: path.to_owned(), problem: problem.to_string(), cure }
    }

    /// Prefixes an [`Error::Input`] with the place that names the file.
    pub fn within(self, place: &str) -> Error {
        match self {
            Error::Input { what, problem, cure } => Error::input(format!("{place}: {what}"), problem, cure),
            other => other,
        }
    }

    /// An [`Error::Input`].
    pub fn input(what: impl Into<String>, problem: impl Into<String>, cure: impl Into<String>) -> Error {
        Error::Input { what: what.into(), problem: problem.into(), cure: cure.into() }
    }
}

const WRITABLE_FOLDER: &str = "choose a writable folder with enough space";

/// A computed number, rounded to six digits for messages.
pub(crate) fn rounded(x: f64) -> f64 {
    format!("{x:.5e}").parse().unwrap_or(x)
}

fn gibibytes(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 30)
}
