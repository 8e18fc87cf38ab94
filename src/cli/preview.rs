//! `cutwater preview`

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;

use crate::Error;
use crate::output::preview::{self, Pictures, PreviewOptions};
use crate::scene::CameraCut;
use glam::DVec3;

use super::bar::progress_bar;

/// Draw the frames of a run as pictures and an animation
#[derive(Debug, clap::Args)]
pub(super) struct Preview {
    /// Folder of the run
    run: PathBuf,
    /// Quantity that colours elastic solids
    #[arg(long, alias = "colour", value_enum, default_value_t = Colour::Solid)]
    colour_by: Colour,
    /// Show cells where liquid separates from walls and solids as red cubes
    #[arg(long)]
    separated: bool,
    /// Width and height of the pictures, pixels; the scene's by default
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    size: Option<[usize; 2]>,
    /// Draw every Nth frame
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    every: u64,
    /// Write the animation as GIF as well
    #[arg(long)]
    gif: bool,
    /// Position of the camera, m
    #[arg(long, value_name = "X,Y,Z", value_parser = vector)]
    camera_eye: Option<DVec3>,
    /// Point in the middle of the picture, m
    #[arg(long, value_name = "X,Y,Z", value_parser = vector)]
    camera_target: Option<DVec3>,
    /// Direction that is up in the picture
    #[arg(long, value_name = "X,Y,Z", value_parser = vector)]
    camera_up: Option<DVec3>,
    /// Vertical field of view, degrees
    #[arg(long, value_name = "DEGREES")]
    camera_fov: Option<f64>,
    /// Plane that cuts solids open, such as z=0.5
    #[arg(long, value_name = "AXIS=METRES", value_parser = cut)]
    camera_cut: Option<CameraCut>,
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

fn size(text: &str) -> Result<[usize; 2], String> {
    let sides = text.split_once(['x', 'X']);
    let sides = sides.and_then(|(width, height)| Some([width.parse().ok()?, height.parse().ok()?]));
    sides.ok_or_else(|| "write WIDTHxHEIGHT in pixels, such as 640x360".to_owned())
}

fn vector(text: &str) -> Result<DVec3, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    let numbers: Option<[f64; 3]> = numbers.and_then(|numbers| numbers.try_into().ok());
    numbers.map(DVec3::from).ok_or_else(|| "write three numbers X,Y,Z, such as 2,1.5,3".to_owned())
}

fn cut(text: &str) -> Result<CameraCut, String> {
    let cut = text.split_once('=').and_then(|(axis, at)| {
        let axis = ["x", "y", "z"].iter().position(|known| *known == axis)?;
        let at = at.parse().ok()?;
        Some(CameraCut { axis, at })
    });
    cut.ok_or_else(|| "write AXIS=METRES, such as z=0.5".to_owned())
}

impl Preview {
    pub(super) fn run(&self) -> Result<(), Error> {
        let colour = match self.colour_by {
            Colour::Solid => preview::Colour::Solid,
            Colour::Stress => preview::Colour::Stress,
            Colour::DetF => preview::Colour::DetF,
        };
        let options = PreviewOptions {
            colour,
            separated: self.separated,
            size: self.size,
            every: self.every as usize,
            animation: true,
            gif: self.gif,
            eye: self.camera_eye,
            target: self.camera_target,
            up: self.camera_up,
            fov: self.camera_fov,
            cut: self.camera_cut,
        };
        super::ensure_run(&self.run, "preview")?;
        draw(Pictures::new(&self.run, &options)?, &self.run, &AtomicBool::new(false))
    }
}

/// Draws missing pictures and the animation with a progress bar, and prints their paths. A true `interrupt` ends it after the current
/// picture.
pub(super) fn draw(mut pictures: Pictures, run: &Path, interrupt: &AtomicBool) -> Result<(), Error> {
    let bar = progress_bar("{wide_bar} {pos}/{len}");
    pictures.draw(&mut |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
        !interrupt.load(Ordering::Relaxed)
    })?;
    let report = pictures.finish()?;
    bar.finish_and_clear();
    say!("{} pictures: {}", report.pictures.len(), run.join("preview").display());
    if let Some(animation) = &report.animation {
        say!("animation: {}", animation.display());
    }
    if let Some(gif) = &report.gif {
        say!("animation: {}", gif.display());
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
pub(super) fn follow(run: &Path, frames: &Receiver<()>, stop: &AtomicBool) -> Result<Option<Pictures>, Error> {
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
