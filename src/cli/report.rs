//! `cutwater report`

use std::path::PathBuf;

use clap::Args;
use cutwater::Error;
use cutwater::measure::insert::{Inserted, insert};
use cutwater::measure::report::{Contents, PAGE, report};

/// Gather what benches and runs wrote into one HTML page
#[derive(Debug, Args)]
pub(super) struct Report {
    /// Folder of a run or a bench, or one that holds such folders
    dir: PathBuf,
    /// Write the tables of Markdown files anew from the results instead, where comments in these ask for them
    #[arg(long, value_name = "FILE", num_args = 1..)]
    into: Vec<PathBuf>,
}

impl Report {
    pub(super) fn run(&self) -> Result<(), Error> {
        for document in &self.into {
            let Inserted { written, left } = insert(&self.dir, document)?;
            say!("{}: {written} tables written", document.display());
            for file in left {
                say!("  left as it was: {file} is not in {}", self.dir.display());
            }
        }
        if !self.into.is_empty() {
            return Ok(());
        }
        let Contents {
            folders,
            tables,
            pictures,
        } = report(&self.dir)?;
        say!("{folders} folders, {tables} tables, {pictures} pictures");
        say!("page: {}", self.dir.join(PAGE).display());
        Ok(())
    }
}
