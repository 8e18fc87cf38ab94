//! `cutwater report`

use std::path::PathBuf;

use crate::Error;
use crate::output::report::{Contents, PAGE, report};
use clap::Args;

/// Collect the results of benches and runs in one HTML page
#[derive(Debug, Args)]
pub(super) struct Report {
    /// Folder of a run or a bench, or one that contains such folders
    dir: PathBuf,
}

impl Report {
    pub(super) fn run(&self) -> Result<(), Error> {
        if self.dir.is_file() {
            super::ensure_run(&self.dir, "report")?;
        }
        let Contents { folders, tables, pictures } = report(&self.dir)?;
        say!("{folders} folders, {tables} tables, {pictures} pictures");
        say!("page: {}", self.dir.join(PAGE).display());
        Ok(())
    }
}
