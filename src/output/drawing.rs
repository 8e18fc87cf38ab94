//! SVG drawings: colours and files.

use std::path::Path;

use plotters::coord::Shift;
use plotters::prelude::*;

use crate::Error;
use crate::output::write_atomically;

/// Error of a drawing.
pub type Failure = Box<dyn std::error::Error>;
/// A part of a page.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Colour of a line, which can be read on white: twelve, then these again.
pub fn ink(index: usize) -> RGBAColor {
    const READABLE: [usize; 12] = [0, 1, 12, 3, 4, 5, 10, 7, 16, 14, 18, 19];
    Palette99::pick(READABLE[index % READABLE.len()]).to_rgba()
}

/// Writes a drawing on a page of `size` pixels.
///
/// # Errors
/// [`Error::Output`].
pub fn write_svg(path: &Path, size: (u32, u32), draw: impl FnOnce(&Area) -> Result<(), Failure>) -> Result<(), Error> {
    let mut text = String::new();
    let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
    let drawn = root.fill(&WHITE).map_err(Failure::from);
    let drawn = drawn.and_then(|()| draw(&root)).and_then(|()| Ok(root.present()?));
    drop(root);
    drawn.map_err(|problem| Error::output(path, problem))?;
    write_atomically(path, text.as_bytes())
}
