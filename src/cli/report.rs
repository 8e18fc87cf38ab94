//! `cutwater report`

use std::path::{Path, PathBuf};

use clap::Args;
use cutwater::Error;
use cutwater::measure::agreement::{Row, TABLE, agreement};
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
        if !self.into.is_empty() {
            return self.write_tables();
        }
        if let Some(other) = &self.against {
            return self.compare(other);
        }
        if self.dir.is_file() {
            super::ensure_run(&self.dir, "report")?;
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

    fn write_tables(&self) -> Result<(), Error> {
        let inserted = insert(&self.dir, &self.into)?;
        for (document, tables) in self.into.iter().zip(inserted) {
            let Inserted {
                written,
                empty,
                left,
            } = tables;
            say!("{}: {written} tables written", document.display());
            for file in empty {
                say!("  without rows: none of {file} is as the table wants it");
            }
            for file in left {
                say!("  left as it was: {file} is not in {}", self.dir.display());
            }
        }
        Ok(())
    }

    /// Says which tables only one folder has, and which columns differ or are not judged in some rows.
    fn compare(&self, other: &Path) -> Result<(), Error> {
        let found = agreement(&self.dir, other)?;
        for table in &found.missing {
            say!("{}: no such table", table.display());
        }
        for row in &found.columns {
            if row.differ + row.unjudged == 0 {
                continue;
            }
            let by = match (row.ratio_least, row.ratio_most) {
                (Some(least), Some(most)) => format!(": {least:.3} to {most:.3} times"),
                _ => String::new(),
            };
            say!(
                "{}: {}: {} rows judged, of which {} differ, {} not judged{by}",
                row.file,
                row.column,
                row.judged(),
                row.differ,
                row.unjudged
            );
        }
        let sum = |count: fn(&Row) -> usize| found.columns.iter().map(count).sum::<usize>();
        say!(
            "{} columns: {} rows judged, of which {} differ, {} not judged: {}",
            found.columns.len(),
            sum(Row::judged),
            sum(|row| row.differ),
            sum(|row| row.unjudged),
            self.dir.join(TABLE).display()
        );
        found.verdict()
    }
}
