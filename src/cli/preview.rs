//! `cutwater preview`

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use cutwater::Error;
use cutwater::output::preview::{PreviewOptions, preview};
use indicatif::{ProgressBar, ProgressDrawTarget};

/// Draw the frames of a run as pictures and an animation
#[derive(Debug, clap::Args)]
pub(super) struct Preview {
    /// Folder of the run
    run: PathBuf,
}

impl Preview {
    pub(super) fn run(&self) -> Result<(), Error> {
        draw(&self.run)
    }
}

/// Draws a run's pictures, behind a progress bar on a terminal, and says where they are.
pub(super) fn draw(run: &Path) -> Result<(), Error> {
    let bar = ProgressBar::no_length();
    if !std::io::stderr().is_terminal() {
        bar.set_draw_target(ProgressDrawTarget::hidden());
    }
    let report = preview(run, &PreviewOptions::default(), &mut |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    println!(
        "{} pictures: {}",
        report.pictures.len(),
        run.join("preview").display()
    );
    if let Some(animation) = report.animation {
        println!("animation: {}", animation.display());
    }
    Ok(())
}
