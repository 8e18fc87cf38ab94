//! `cutwater plot`

use std::path::PathBuf;

use crate::Error;
use crate::output::plot::{plot, plot_probes, with_sweeps};
use clap::Args;

/// Draw the probes and the step table of runs as charts
#[derive(Debug, Args)]
pub(super) struct Plot {
    /// Folders of runs, or of a sweep for all its finished runs; several are drawn over one another
    #[arg(required = true)]
    runs: Vec<PathBuf>,
    /// Probes or columns of probes.csv to draw, such as tip,load_x; without it all, and the step table
    #[arg(long, value_name = "NAME,..", value_delimiter = ',')]
    probes: Vec<String>,
    /// Folder of the charts; without it `plots` in the folder of the run or the sweep
    #[arg(long)]
    out: Option<PathBuf>,
}

impl Plot {
    pub(super) fn run(&self) -> Result<(), Error> {
        let runs = with_sweeps(&self.runs)?;
        for run in &runs {
            super::ensure_run(run, "plot")?;
        }
        let out = match (&self.out, &self.runs[..]) {
            (Some(out), _) => out.clone(),
            (None, [run]) => run.join("plots"),
            (None, _) => {
                let cure = "add --out FOLDER";
                return Err(Error::input("plot", "several runs need a folder for their charts", cure));
            }
        };
        let files = match self.probes[..] {
            [] => plot(&runs, &out)?,
            _ => vec![plot_probes(&runs, &self.probes, &out)?],
        };
        for file in files {
            say!("{}", file.display());
        }
        Ok(())
    }
}
