//! The one error type. Every variant names what a user needs to find the cause: file, line, key, stage, buffer or limit.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

/// What can go wrong. [`Error::exit_code`] gives the exit code of the command line.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A scene file says something that cannot be simulated.
    #[error("{}:{line}: {key}: {problem}\n  cure: {cure}", file.display())]
    Scene {
        /// The scene file.
        file: PathBuf,
        /// Line in the file, from 1; where a key is missing, the line of its table, or the last.
        line: usize,
        /// Dotted key, such as `liquid.region[1].box.min`.
        key: String,
        /// What is wrong.
        problem: String,
        /// What would be right.
        cure: String,
    },
    /// A file or an argument that the user gave cannot be used.
    #[error("{what}: {problem}\n  cure: {cure}")]
    Input {
        /// The file, with its line where known, or the argument.
        what: String,
        /// What is wrong.
        problem: String,
        /// What would be right.
        cure: String,
    },
    /// A result cannot be written.
    #[error("cannot write {}: {problem}\n  cure: {cure}", path.display())]
    Output {
        /// The file or folder, or `standard output`.
        path: PathBuf,
        /// What the system said.
        problem: String,
        /// What the user can do.
        cure: &'static str,
    },
    /// No adapter fits.
    #[error("no suitable GPU adapter: {problem}\n  cure: {cure}")]
    Adapter {
        /// What was looked for and found.
        problem: String,
        /// What to install or choose.
        cure: String,
    },
    /// The adapter is too small for the scene.
    #[error("{what} needs {needed} {unit}, the adapter allows {available}\n  cure: {cure}")]
    Limit {
        /// The buffer or kernel.
        what: String,
        /// What is needed.
        needed: u64,
        /// What the adapter allows.
        available: u64,
        /// Unit of both, with the limit's name.
        unit: &'static str,
        /// What the user can do.
        cure: String,
    },
    /// The machine is too small for the scene.
    #[error(
        "this scene takes at least {:.1} GiB of the machine's memory, of which {:.1} GiB are free\n  cure: {cure}",
        gibibytes(*needed), gibibytes(*available)
    )]
    Memory {
        /// Bytes that are needed.
        needed: u64,
        /// Bytes that are free.
        available: u64,
        /// What the user can do.
        cure: String,
    },
    /// A shader does not compile.
    #[error("{file}:{line}: {problem}")]
    Shader {
        /// The WGSL file.
        file: String,
        /// Line in that file, from 1.
        line: usize,
        /// What naga said.
        problem: String,
    },
    /// The device reported an error: validation, memory, or the device is lost.
    #[error("GPU error in {during}: {problem}")]
    Gpu {
        /// The buffer, kernel or stage at work.
        during: String,
        /// What the device said.
        problem: String,
    },
    /// A stage of the step failed; frames and rows written before stay valid.
    #[error("step {step}, stage {stage}: {problem}")]
    Stage {
        /// The stage, by its canonical noun.
        stage: &'static str,
        /// The sub-step, from 0.
        step: u64,
        /// What happened.
        problem: String,
    },
    /// A check of the simulator against itself found a breach.
    #[error("check failed: {0}")]
    Check(String),
    /// The user interrupted; frames and rows written before stay valid.
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
        Error::Output {
            path: path.to_owned(),
            problem: problem.to_string(),
            cure: "choose a folder that can be written and has room",
        }
    }

    /// An [`Error::Output`] from what the system said of it.
    pub fn unwritten(path: &Path, problem: &io::Error) -> Error {
        let cure = match problem.kind() {
            ErrorKind::StorageFull => "make room on that disk, or choose a folder on another",
            ErrorKind::QuotaExceeded => {
                "remove files of yours from that disk, or choose a folder on another"
            }
            ErrorKind::FileTooLarge => "raise the limit for file sizes (`ulimit -f unlimited`)",
            ErrorKind::InvalidFilename => {
                "the name is too long for the file system: give the scene's file or the folder a shorter one"
            }
            _ => "choose a folder that can be written and has room",
        };
        Error::Output {
            path: path.to_owned(),
            problem: problem.to_string(),
            cure,
        }
    }

    /// The error; of a file that cannot be used, with the place that names the file before it.
    pub fn within(self, place: &str) -> Error {
        match self {
            Error::Input {
                what,
                problem,
                cure,
            } => Error::input(format!("{place}: {what}"), problem, cure),
            other => other,
        }
    }

    /// An [`Error::Input`].
    pub fn input(
        what: impl Into<String>,
        problem: impl Into<String>,
        cure: impl Into<String>,
    ) -> Error {
        Error::Input {
            what: what.into(),
            problem: problem.into(),
            cure: cure.into(),
        }
    }
}

/// A number that was computed, as messages show it: six digits of it.
pub(crate) fn rounded(x: f64) -> f64 {
    format!("{x:.5e}").parse().unwrap_or(x)
}

fn gibibytes(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 30)
}
