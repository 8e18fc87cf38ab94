//! `cutwater preview`

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;

use cutwater::Error;
use cutwater::output::preview::{self, Pictures, PreviewOptions};

use super::bar::progress_bar;

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
        draw(
            Pictures::new(&self.run, &options)?,
            &self.run,
            &AtomicBool::new(false),
        )
    }
}

/// Draws the pictures that a run lacks and the animation, behind a progress bar on a terminal, and says where they are. A true
/// `interrupt` ends it after the picture at work.
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
            "warning: files of {} frames are gone or not whole, frame {first} the first: they have no picture",
            report.missing.len()
        );
    }
    Ok(())
}

/// Draws the pictures of a run while it goes on, each time it is told that a frame may have been written, until nothing more is to
/// come or, after the picture at work, `stop` is true. Nothing was drawn where it was told nothing.
pub(super) fn follow(
    run: &Path,
    told: &Receiver<()>,
    stop: &AtomicBool,
) -> Result<Option<Pictures>, Error> {
    let mut pictures: Option<Pictures> = None;
    while told.recv().is_ok() {
        // What was told meanwhile is drawn with this.
        while told.try_recv().is_ok() {}
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
