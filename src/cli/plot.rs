//! `cutwater plot`

use std::path::PathBuf;

use crate::Error;
use crate::output::plot::plot;
use clap::Args;

/// Draw the probes and the step table of runs as charts
#[derive(Debug, Args)]
pub(super) struct Plot {
    /// Folders of runs; several are drawn over one another
    #[arg(required = true)]
    runs: Vec<PathBuf>,
    /// Folder of the charts; without it `plots` in the folder of the run
    #[arg(long)]
    out: Option<PathBuf>,
}

impl Plot {
    pub(super) fn run(&self) -> Result<(), Error> {
        for run in &self.runs {
            super::ensure_run(run, "plot")?;
        }
        let out = match (&self.out, &self.runs[..]) {
            (Some(out), _) => out.clone(),
            (None, [run]) => run.join("plots"),
            (None, _) => {
                let cure = "add --out FOLDER";
                return Err(Error::input(
                    "plot",
                    "several runs need a folder for their charts",
                    cure,
                ));
            }
        };
        for file in plot(&self.runs, &out)? {
            say!("{}", file.display());
        }
        Ok(())
    }
}
