//! `cutwater report`

use std::path::{Path, PathBuf};

use clap::Args;
use cutwater::Error;
use cutwater::measure::agreement::{TABLE, agreement};
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
    /// Compare the tables with those of another run of the same commands instead
    #[arg(long, value_name = "OTHER", conflicts_with = "into")]
    against: Option<PathBuf>,
}

impl Report {
    pub(super) fn run(&self) -> Result<(), Error> {
        for document in &self.into {
            let Inserted {
                written,
                empty,
                left,
            } = insert(&self.dir, document)?;
            say!("{}: {written} tables written", document.display());
            for file in empty {
                say!("  without rows: none of {file} is as the table wants it");
            }
            for file in left {
                say!("  left as it was: {file} is not in {}", self.dir.display());
            }
        }
        if !self.into.is_empty() {
            return Ok(());
        }
        if let Some(other) = &self.against {
            return self.compare(other);
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

    /// Says which columns do not agree in all rows.
    fn compare(&self, other: &Path) -> Result<(), Error> {
        let columns = agreement(&self.dir, other)?;
        let differ: Vec<_> = columns.iter().filter(|column| !column.agrees()).collect();
        for column in &differ {
            let by = match (column.ratio_least, column.ratio_most) {
                (Some(least), Some(most)) => format!(", {least:.3} to {most:.3} times"),
                _ => String::new(),
            };
            say!(
                "{}: {} differs in {} of {} rows{by}",
                column.file,
                column.column,
                column.rows - column.agree.unwrap_or(column.rows),
                column.rows
            );
        }
        say!(
            "{} of {} columns agree in all rows: {}",
            columns.len() - differ.len(),
            columns.len(),
            self.dir.join(TABLE).display()
        );
        match differ.is_empty() {
            true => Ok(()),
            false => Err(Error::Check(format!(
                "{} columns differ by more than their spread",
                differ.len()
            ))),
        }
    }
}
