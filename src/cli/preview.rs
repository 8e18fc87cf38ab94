//! `cutwater preview`

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;

use crate::Error;
use crate::output::preview::{self, Pictures, PreviewOptions};

use super::bar::progress_bar;

/// Draw the frames of a run as pictures and an animation
#[derive(Debug, clap::Args)]
pub(super) struct Preview {
    /// Folder of the run
    run: PathBuf,
    /// Quantity that colours elastic solids
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
        super::ensure_run(&self.run, "preview")?;
        draw(
            Pictures::new(&self.run, &options)?,
            &self.run,
            &AtomicBool::new(false),
        )
    }
}

/// Draws missing pictures and the animation with a progress bar, and prints their paths. A true `interrupt` ends it after the current
/// picture.
pub(super) fn draw(
    mut pictures: Pictures,
    run: &Path,
    interrupt: &AtomicBool,
) -> Result<(), Error> {
    let bar = progress_bar("{wide_bar} {pos}/{len}");
    pictures.draw(&mut |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
        !interrupt.load(Ordering::Relaxed)
    })?;
    let report = pictures.finish()?;
    bar.finish_and_clear();
    say!(
        "{} pictures: {}",
        report.pictures.len(),
        run.join("preview").display()
    );
    if let Some(animation) = &report.animation {
        say!("animation: {}", animation.display());
    }
    if let [first, ..] = report.missing[..] {
        warn!(
            "warning: {} frames have no picture, frame {first} first: their files are missing or incomplete",
            report.missing.len()
        );
    }
    Ok(())
}

/// Draws the pictures of a running simulation at each message in `frames`, until the sender is dropped. A true `stop` ends it
/// after the current picture. `None` without a message.
pub(super) fn follow(
    run: &Path,
    frames: &Receiver<()>,
    stop: &AtomicBool,
) -> Result<Option<Pictures>, Error> {
    let mut pictures: Option<Pictures> = None;
    while frames.recv().is_ok() {
        // Draws all frames written so far.
        while frames.try_recv().is_ok() {}
        let pictures = match &mut pictures {
            Some(pictures) => pictures,
            None => pictures.insert(Pictures::new(run, &PreviewOptions::default())?),
        };
        match pictures.draw(&mut |_, _| !stop.load(Ordering::Relaxed)) {
            Err(Error::Interrupted) => break,
            drawn => drawn?,
        }
    }
    Ok(pictures)
}
