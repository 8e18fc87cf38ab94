//! `cutwater export`

use std::path::PathBuf;

use crate::Error;
use crate::measure::export::{Options, export};

use super::{BackendArgs, SceneArgs};

/// Write the system of a sub-step, of the pressure, the solids or both, for other solvers
#[derive(Debug, clap::Args)]
pub(super) struct Export {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    backend: BackendArgs,
    /// Sub-step to export, from 0 as in steps.csv
    #[arg(long)]
    step: u64,
    /// Folder of the files; an earlier export in it is replaced
    #[arg(long)]
    out: PathBuf,
}

impl Export {
    pub(super) fn run(&self) -> Result<(), Error> {
        let options = Options { backend: self.backend.backend(), step: self.step, start: None, out: self.out.clone() };
        let meta = export(&self.scene.load()?, &options)?;
        say!(
            "{} unknowns, {} entries, residual {:.1e}: {}",
            meta.unknowns,
            meta.entries,
            meta.residual,
            self.out.display()
        );
        Ok(())
    }
}
