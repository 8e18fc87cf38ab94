//! `cutwater preview`

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use cutwater::Error;
use cutwater::output::preview::{self, PreviewOptions, preview};
use indicatif::{ProgressBar, ProgressDrawTarget};

/// Draw the frames of a run as pictures and an animation
#[derive(Debug, clap::Args)]
pub(super) struct Preview {
    /// Folder of the run
    run: PathBuf,
    /// What the colours of elastic solids stand for
    #[arg(long, value_enum, default_value_t = Colour::Solid)]
    colour: Colour,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
#[value(rename_all = "snake_case")]
enum Colour {
    /// The body
    Solid,
    /// Von Mises stress
    Stress,
    /// Volume over volume at rest
    DetF,
}

impl Preview {
    pub(super) fn run(&self) -> Result<(), Error> {
        let colour = match self.colour {
            Colour::Solid => preview::Colour::Solid,
            Colour::Stress => preview::Colour::Stress,
            Colour::DetF => preview::Colour::DetF,
        };
        let options = PreviewOptions {
            colour,
            ..PreviewOptions::default()
        };
        draw(&self.run, &options, &AtomicBool::new(false))
    }
}

/// Draws a run's pictures, behind a progress bar on a terminal, and says where they are. A true `interrupt` ends it after the
/// picture at work.
pub(super) fn draw(
    run: &Path,
    options: &PreviewOptions,
    interrupt: &AtomicBool,
) -> Result<(), Error> {
    let bar = ProgressBar::no_length();
    if !std::io::stderr().is_terminal() {
        bar.set_draw_target(ProgressDrawTarget::hidden());
    }
    let report = preview(run, options, &mut |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
        !interrupt.load(Ordering::Relaxed)
    })?;
    bar.finish_and_clear();
    say!(
        "{} pictures: {}",
        report.pictures.len(),
        run.join("preview").display()
    );
    if let Some(animation) = report.animation {
        say!("animation: {}", animation.display());
    }
    Ok(())
}
