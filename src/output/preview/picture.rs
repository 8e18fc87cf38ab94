//! 8-bit sRGB pictures: lines and text, PNG files, and the animation (APNG).

use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::{Path, PathBuf};

use glam::Vec3;
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use rayon::prelude::*;

use crate::Error;
use crate::output::write_atomically;

/// Largest width of the animation, pixels.
const ANIMATION_WIDTH: usize = 640;

/// Converts a linear colour, white at 1, to sRGB bytes.
pub(super) fn srgb(colour: Vec3) -> [u8; 3] {
    let byte = |x: f32| {
        let x = x.clamp(0.0, 1.0);
        let encoded = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
        (255.0 * encoded + 0.5) as u8
    };
    colour.to_array().map(byte)
}

/// Font size: Noto Sans Mono, each pixel `scale` wide.
#[derive(Clone, Copy)]
pub(super) struct Font {
    height: RasterHeight,
    scale: usize,
}

impl Font {
    /// Width and height of a text of `n` characters, pixels.
    pub(super) fn extent(self, n: usize) -> [usize; 2] {
        let width = get_raster_width(FontWeight::Regular, self.height);
        [n * width, self.height.val()].map(|pixels| pixels * self.scale)
    }
}

/// Rows of RGB bytes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Picture {
    pub(super) size: [usize; 2],
    pub(super) bytes: Vec<u8>,
}

impl Picture {
    /// From linear colours, white at 1.
    pub(super) fn from_linear(size: [usize; 2], colours: &[Vec3]) -> Picture {
        let mut bytes = vec![0; 3 * colours.len()];
        let pixels = bytes.par_chunks_exact_mut(3).zip(colours);
        pixels.with_min_len(1024).for_each(|(bytes, &colour)| bytes.copy_from_slice(&srgb(colour)));
        Picture { size, bytes }
    }

    fn at(&self, x: usize, y: usize) -> [i16; 3] {
        let start = 3 * (x + self.size[0] * y);
        [0, 1, 2].map(|channel| i16::from(self.bytes[start + channel]))
    }

    /// Largest channel difference to the four neighbours.
    pub(super) fn contrast(&self, x: usize, y: usize) -> i16 {
        let here = self.at(x, y);
        let [width, height] = self.size;
        let neighbours =
            [(x.max(1) - 1, y), ((x + 1).min(width - 1), y), (x, y.max(1) - 1), (x, (y + 1).min(height - 1))];
        let to = |(x, y)| (0..3).map(|channel| (self.at(x, y)[channel] - here[channel]).abs()).max().unwrap_or(0);
        neighbours.into_iter().map(to).max().unwrap_or(0)
    }

    /// Blends a colour into a pixel, if that is inside.
    fn mix(&mut self, x: i64, y: i64, colour: [u8; 3], alpha: f32) {
        let [width, height] = self.size;
        if (0..width as i64).contains(&x) && (0..height as i64).contains(&y) {
            let start = 3 * (x as usize + width * y as usize);
            for (byte, colour) in self.bytes[start..start + 3].iter_mut().zip(colour) {
                *byte = (f32::from(*byte) + (f32::from(colour) - f32::from(*byte)) * alpha + 0.5) as u8;
            }
        }
    }

    /// An antialiased line one pixel wide; `alpha` is its opacity at a fraction of its length and a pixel.
    pub(super) fn line(&mut self, a: [f32; 2], b: [f32; 2], colour: [u8; 3], alpha: impl Fn(f32, i64, i64) -> f32) {
        let along = usize::from((b[1] - a[1]).abs() > (b[0] - a[0]).abs());
        let across = 1 - along;
        let (a, b, turned) = if a[along] <= b[along] { (a, b, false) } else { (b, a, true) };
        let length = b[along] - a[along];
        let first = a[along].max(0.0).round() as i64;
        let last = b[along].min(self.size[along] as f32).round() as i64;
        for step in first..last {
            let t = if length > 0.0 { ((step as f32 + 0.5 - a[along]) / length).clamp(0.0, 1.0) } else { 0.0 };
            let centre = a[across] + (b[across] - a[across]) * t - 0.5;
            let low = centre.floor();
            for (offset, weight) in [(0, 1.0 - (centre - low)), (1, centre - low)] {
                let other = low as i64 + offset;
                let (x, y) = if along == 0 { (step, other) } else { (other, step) };
                let strength = alpha(if turned { 1.0 - t } else { t }, x, y);
                self.mix(x, y, colour, weight * strength);
            }
        }
    }

    /// Fills a rectangle from its upper left corner.
    pub(super) fn fill(&mut self, [x, y]: [usize; 2], [width, height]: [usize; 2], colour: [u8; 3]) {
        for pixel in 0..width * height {
            let (x, y) = (x + pixel % width, y + pixel / width);
            self.mix(x as i64, y as i64, colour, 1.0);
        }
    }

    pub(super) fn font(&self) -> Font {
        let height = match self.size[1] {
            0..450 => RasterHeight::Size16,
            450..900 => RasterHeight::Size24,
            _ => RasterHeight::Size32,
        };
        Font { height, scale: (self.size[1] / 1440).max(1) }
    }

    /// Draws a text from its upper left corner, where `seen` is true. Characters outside ASCII are blanks.
    pub(super) fn text(&mut self, x: i64, y: i64, text: &str, colour: [u8; 3], seen: impl Fn(usize, usize) -> bool) {
        let font = self.font();
        let [width, _] = font.extent(1);
        for (place, letter) in (0_i64..).zip(text.chars()) {
            let Some(letter) = get_raster(letter, FontWeight::Regular, font.height) else {
                continue;
            };
            for (row, strengths) in (0_i64..).zip(letter.rows()) {
                for (column, &strength) in (0_i64..).zip(strengths.iter()) {
                    let scale = font.scale as i64;
                    for pixel in 0..scale * scale {
                        let px = x + place * width as i64 + column * scale + pixel % scale;
                        let py = y + row * scale + pixel / scale;
                        let within = usize::try_from(px).ok().zip(usize::try_from(py).ok());
                        let within = within.filter(|&(x, y)| x < self.size[0] && y < self.size[1]);
                        if within.is_some_and(|(x, y)| seen(x, y)) {
                            self.mix(px, py, colour, 0.9 * f32::from(strength) / 255.0);
                        }
                    }
                }
            }
        }
    }

    pub(super) fn write(&self, path: &Path) -> Result<(), Error> {
        let mut bytes = Vec::new();
        let mut encode = || -> Result<(), png::EncodingError> {
            let mut encoder = png::Encoder::new(&mut bytes, self.size[0] as u32, self.size[1] as u32);
            encoder.set_color(png::ColorType::Rgb);
            encoder.set_depth(png::BitDepth::Eight);
            // The default takes a sixth of the time of a picture.
            encoder.set_compression(png::Compression::Fast);
            encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
            let mut writer = encoder.write_header()?;
            writer.write_image_data(&self.bytes)?;
            writer.finish()
        };
        encode().map_err(|problem| Error::output(path, problem))?;
        write_atomically(path, &bytes)
    }

    fn read(path: &Path) -> Result<Picture, Error> {
        let failed = |problem: String| {
            let cure = "remove it, and run `cutwater preview` again";
            Error::input(path.display().to_string(), problem, cure)
        };
        let file = File::open(path).map_err(|problem| failed(problem.to_string()))?;
        let mut reader =
            png::Decoder::new(BufReader::new(file)).read_info().map_err(|problem| failed(problem.to_string()))?;
        let size = [reader.info().width as usize, reader.info().height as usize];
        let mut bytes = vec![0; 3 * size[0] * size[1]];
        if reader.output_buffer_size() != Some(bytes.len()) {
            return Err(failed("is not a picture of cutwater".to_owned()));
        }
        reader.next_frame(&mut bytes).map_err(|problem| failed(problem.to_string()))?;
        Ok(Picture { size, bytes })
    }

    /// Starts an animation with this as its first frame.
    fn animation<'a>(
        &self,
        bytes: &'a mut Vec<u8>,
        pictures: usize,
        [numerator, denominator]: [u16; 2],
    ) -> Result<png::Writer<&'a mut Vec<u8>>, png::EncodingError> {
        let [width, height] = self.size.map(|n| n as u32);
        let mut encoder = png::Encoder::new(bytes, width, height);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::High);
        encoder.set_animated(pictures as u32, 0)?;
        encoder.set_frame_delay(numerator, denominator)?;
        encoder.set_blend_op(png::BlendOp::Over)?;
        encoder.set_dispose_op(png::DisposeOp::None)?;
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&patch(None, self).bytes)?;
        Ok(writer)
    }

    /// Box-filtered to a width of at most [`ANIMATION_WIDTH`].
    fn reduced(&self) -> Picture {
        let factor = self.size[0].div_ceil(ANIMATION_WIDTH);
        let size = self.size.map(|n| (n / factor).max(1));
        let mut bytes = Vec::with_capacity(3 * size[0] * size[1]);
        for y in 0..size[1] {
            for x in 0..size[0] {
                for channel in 0..3 {
                    let sum: i32 = (0..factor * factor)
                        .map(|pixel| {
                            let at = [x * factor + pixel % factor, y * factor + pixel / factor];
                            i32::from(self.at(at[0].min(self.size[0] - 1), at[1].min(self.size[1] - 1))[channel])
                        })
                        .sum();
                    let n = (factor * factor) as i32;
                    bytes.push(((sum + n / 2) / n) as u8);
                }
            }
        }
        Picture { size, bytes }
    }
}

/// Writes an endless animated PNG of pictures with their durations in s. Pictures are reduced and store changed pixels only;
/// they are read one by one.
pub(super) fn animate(path: &Path, pictures: &[(PathBuf, f64)]) -> Result<(), Error> {
    let Some((first, seconds)) = pictures.first() else {
        return Ok(());
    };
    let failed = |problem: png::EncodingError| Error::output(path, problem);
    let mut bytes = Vec::new();
    let mut before = Picture::read(first)?.reduced();
    let mut writer = before.animation(&mut bytes, pictures.len(), fraction(*seconds)).map_err(failed)?;
    for (picture, seconds) in &pictures[1..] {
        let now = Picture::read(picture)?.reduced();
        let patch = patch(Some(&before), &now);
        patch.write(&mut writer, fraction(*seconds)).map_err(failed)?;
        before = now;
    }
    writer.finish().map_err(failed)?;
    write_atomically(path, &bytes)
}

/// Shortest delay that browsers play at its speed, hundredths of a second.
const SHORTEST_DELAY: u16 = 2;

/// Writes an endless animated GIF of pictures with their durations in s. Each picture has a palette of its own.
pub(super) fn animate_gif(path: &Path, pictures: &[(PathBuf, f64)]) -> Result<(), Error> {
    let mut bytes = Vec::new();
    let mut encoder: Option<gif::Encoder<&mut Vec<u8>>> = None;
    let mut unused = Some(&mut bytes);
    let (mut time, mut shown) = (0.0, 0);
    for (picture, seconds) in pictures {
        let picture = Picture::read(picture)?.reduced();
        let [width, height] = picture.size.map(|n| n as u16);
        // Ends are rounded, so that the animation keeps the speed of the run.
        time += 100.0 * seconds;
        let delay = ((time.round() as u64).saturating_sub(shown)).clamp(SHORTEST_DELAY.into(), u16::MAX.into());
        shown += delay;
        // Speed 10 of 1 to 30: the quantizer samples a tenth of the pixels.
        let mut frame = gif::Frame::from_rgb_speed(width, height, &picture.bytes, 10);
        frame.delay = delay as u16;
        if let Some(bytes) = unused.take() {
            let mut new =
                gif::Encoder::new(bytes, width, height, &[]).map_err(|problem| Error::output(path, problem))?;
            new.set_repeat(gif::Repeat::Infinite).map_err(|problem| Error::output(path, problem))?;
            encoder = Some(new);
        }
        if let Some(encoder) = &mut encoder {
            encoder.write_frame(&frame).map_err(|problem| Error::output(path, problem))?;
        }
    }
    // Writes the trailer.
    drop(encoder);
    write_atomically(path, &bytes)
}

/// Reads a PNG file to its end and verifies its checksums.
pub(crate) fn ensure_whole_png(bytes: &[u8]) -> Result<(), png::DecodingError> {
    png::Decoder::new(Cursor::new(bytes)).read_info()?.finish()
}

/// Nearest fraction with 16-bit numerator and denominator to a time, s, as APNG stores it: the last fitting convergent of the
/// continued fraction.
fn fraction(seconds: f64) -> [u16; 2] {
    let most = f64::from(u16::MAX);
    if seconds >= most {
        return [u16::MAX, 1];
    }
    let (mut before, mut now) = ([0.0, 1.0], [1.0, 0.0]);
    let mut rest = seconds;
    loop {
        let whole = rest.floor();
        let next = [0, 1].map(|part| whole * now[part] + before[part]);
        if next.iter().any(|&part| part > most) {
            break;
        }
        (before, now) = (now, next);
        // Further digits are rounding.
        if (now[0] / now[1] - seconds).abs() <= 1e-12 * seconds {
            break;
        }
        rest = 1.0 / (rest - whole);
    }
    // The shortest representable time.
    match now.map(|part| part as u16) {
        [0, _] => [1, u16::MAX],
        fraction => fraction,
    }
}

/// A rectangle of RGBA bytes with its position.
struct Patch {
    at: [usize; 2],
    size: [usize; 2],
    bytes: Vec<u8>,
}

impl Patch {
    /// Writes the patch as the next frame of this duration, s.
    fn write(
        &self,
        writer: &mut png::Writer<&mut Vec<u8>>,
        [numerator, denominator]: [u16; 2],
    ) -> Result<(), png::EncodingError> {
        let [x, y] = self.at.map(|n| n as u32);
        let [width, height] = self.size.map(|n| n as u32);
        writer.set_frame_delay(numerator, denominator)?;
        // Shrinks first: a rectangle must never exceed the picture.
        writer.set_frame_dimension(1, 1)?;
        writer.set_frame_position(x, y)?;
        writer.set_frame_dimension(width, height)?;
        writer.write_image_data(&self.bytes)
    }
}

/// The bounding rectangle of changed pixels, at least one; unchanged ones are transparent.
fn patch(before: Option<&Picture>, now: &Picture) -> Patch {
    let [width, height] = now.size;
    let changed = |x: usize, y: usize| before.is_none_or(|before| before.at(x, y) != now.at(x, y));
    let (mut low, mut high) = ([width, height], [0, 0]);
    for y in 0..height {
        for x in (0..width).filter(|&x| changed(x, y)) {
            low = [low[0].min(x), low[1].min(y)];
            high = [high[0].max(x + 1), high[1].max(y + 1)];
        }
    }
    if high == [0, 0] {
        (low, high) = ([0, 0], [1, 1]);
    }
    let size = [high[0] - low[0], high[1] - low[1]];
    let mut bytes = Vec::with_capacity(4 * size[0] * size[1]);
    for y in low[1]..high[1] {
        for x in low[0]..high[0] {
            if changed(x, y) {
                let start = 3 * (x + width * y);
                bytes.extend_from_slice(&now.bytes[start..start + 3]);
                bytes.push(255);
            } else {
                bytes.extend_from_slice(&[0; 4]);
            }
        }
    }
    Patch { at: low, size, bytes }
}

#[cfg(test)]
mod tests {
    use super::fraction;

    #[test]
    fn delays_are_exact_fractions() {
        for rate in [1.0, 12.0, 24.0, 25.0, 30.0, 50.0, 60.0, 100.0, 384.0, 1000.0] {
            assert_eq!(fraction(1.0 / rate), [1, rate as u16], "{rate} frames/s");
        }
        assert_eq!(fraction(1001.0 / 30_000.0), [1001, 30_000]);
        assert_eq!(fraction(2.0 / 30.0), [1, 15]);
        assert_eq!(fraction(1.0 / 12.5), [2, 25]);
        assert_eq!(fraction(3600.0), [3600, 1]);
        // The nearest fraction.
        assert_eq!(fraction(1e9), [u16::MAX, 1]);
        assert_eq!(fraction(1e-9), [1, u16::MAX]);
        let [numerator, denominator] = fraction(0.1 * std::f64::consts::PI);
        let off = f64::from(numerator) / f64::from(denominator) - 0.1 * std::f64::consts::PI;
        // The next convergent is closer than 1/(this denominator x its own), which does not fit.
        let bound = 1.0 / (f64::from(denominator) * f64::from(u16::MAX));
        assert!(off.abs() < bound, "{off} s");
    }
}
