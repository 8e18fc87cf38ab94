//! 8-bit sRGB pictures: lines and letters on them, PNG files, and the animation (APNG).

use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::{Path, PathBuf};

use glam::Vec3;
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use crate::Error;
use crate::output::write_atomically;

/// Largest width of the animation, pixels.
const ANIMATION_WIDTH: usize = 640;

/// A linear colour, 1 is white, as sRGB bytes.
pub(super) fn srgb(colour: Vec3) -> [u8; 3] {
    let byte = |x: f32| {
        let x = x.clamp(0.0, 1.0);
        let encoded = if x <= 0.003_130_8 {
            12.92 * x
        } else {
            1.055 * x.powf(1.0 / 2.4) - 0.055
        };
        (255.0 * encoded + 0.5) as u8
    };
    colour.to_array().map(byte)
}

/// Letters of Noto Sans Mono, each pixel `scale` wide.
#[derive(Clone, Copy)]
pub(super) struct Letters {
    height: RasterHeight,
    scale: usize,
}

impl Letters {
    /// Width and height of a text of so many letters, pixels.
    pub(super) fn extent(self, letters: usize) -> [usize; 2] {
        let width = get_raster_width(FontWeight::Regular, self.height);
        [letters * width, self.height.val()].map(|pixels| pixels * self.scale)
    }
}

/// Rows of RGB bytes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Picture {
    pub(super) size: [usize; 2],
    pub(super) bytes: Vec<u8>,
}

impl Picture {
    /// From linear colours, 1 is white.
    pub(super) fn from_linear(size: [usize; 2], colours: &[Vec3]) -> Picture {
        let bytes = colours.iter().flat_map(|&colour| srgb(colour)).collect();
        Picture { size, bytes }
    }

    fn at(&self, x: usize, y: usize) -> [i16; 3] {
        let start = 3 * (x + self.size[0] * y);
        [0, 1, 2].map(|channel| i16::from(self.bytes[start + channel]))
    }

    /// Largest difference of a channel to the four neighbours.
    pub(super) fn contrast(&self, x: usize, y: usize) -> i16 {
        let here = self.at(x, y);
        let [width, height] = self.size;
        let neighbours = [
            (x.max(1) - 1, y),
            ((x + 1).min(width - 1), y),
            (x, y.max(1) - 1),
            (x, (y + 1).min(height - 1)),
        ];
        let to = |(x, y)| {
            (0..3)
                .map(|channel| (self.at(x, y)[channel] - here[channel]).abs())
                .max()
                .unwrap_or(0)
        };
        neighbours.into_iter().map(to).max().unwrap_or(0)
    }

    /// Mixes a colour into a pixel; nothing outside.
    fn mix(&mut self, x: i64, y: i64, colour: [u8; 3], alpha: f32) {
        let [width, height] = self.size;
        if (0..width as i64).contains(&x) && (0..height as i64).contains(&y) {
            let start = 3 * (x as usize + width * y as usize);
            for (byte, colour) in self.bytes[start..start + 3].iter_mut().zip(colour) {
                *byte =
                    (f32::from(*byte) + (f32::from(colour) - f32::from(*byte)) * alpha + 0.5) as u8;
            }
        }
    }

    /// A line one pixel wide, smooth; `alpha` tells its strength at a fraction of its length and a pixel.
    pub(super) fn line(
        &mut self,
        a: [f32; 2],
        b: [f32; 2],
        colour: [u8; 3],
        alpha: impl Fn(f32, i64, i64) -> f32,
    ) {
        let along = usize::from((b[1] - a[1]).abs() > (b[0] - a[0]).abs());
        let across = 1 - along;
        let (a, b, turned) = if a[along] <= b[along] {
            (a, b, false)
        } else {
            (b, a, true)
        };
        let length = b[along] - a[along];
        let first = a[along].max(0.0).round() as i64;
        let last = b[along].min(self.size[along] as f32).round() as i64;
        for step in first..last {
            let t = if length > 0.0 {
                ((step as f32 + 0.5 - a[along]) / length).clamp(0.0, 1.0)
            } else {
                0.0
            };
            let centre = a[across] + (b[across] - a[across]) * t - 0.5;
            let low = centre.floor();
            for (offset, weight) in [(0, 1.0 - (centre - low)), (1, centre - low)] {
                let other = low as i64 + offset;
                let (x, y) = if along == 0 {
                    (step, other)
                } else {
                    (other, step)
                };
                let strength = alpha(if turned { 1.0 - t } else { t }, x, y);
                self.mix(x, y, colour, weight * strength);
            }
        }
    }

    /// A filled rectangle, its upper left corner and its size given.
    pub(super) fn fill(
        &mut self,
        [x, y]: [usize; 2],
        [width, height]: [usize; 2],
        colour: [u8; 3],
    ) {
        for pixel in 0..width * height {
            let (x, y) = (x + pixel % width, y + pixel / width);
            self.mix(x as i64, y as i64, colour, 1.0);
        }
    }

    /// Letters that suit the picture's size.
    pub(super) fn letters(&self) -> Letters {
        let height = match self.size[1] {
            0..450 => RasterHeight::Size16,
            450..900 => RasterHeight::Size24,
            _ => RasterHeight::Size32,
        };
        Letters {
            height,
            scale: (self.size[1] / 1440).max(1),
        }
    }

    /// A caption, its upper left corner given, where its pixels are `seen`. Letters other than those of ASCII are blanks.
    pub(super) fn text(
        &mut self,
        x: i64,
        y: i64,
        text: &str,
        colour: [u8; 3],
        seen: impl Fn(usize, usize) -> bool,
    ) {
        let letters = self.letters();
        let [width, _] = letters.extent(1);
        for (place, letter) in (0_i64..).zip(text.chars()) {
            let Some(letter) = get_raster(letter, FontWeight::Regular, letters.height) else {
                continue;
            };
            for (row, strengths) in (0_i64..).zip(letter.rows()) {
                for (column, &strength) in (0_i64..).zip(strengths.iter()) {
                    let scale = letters.scale as i64;
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

    /// Writes a PNG file.
    pub(super) fn write(&self, path: &Path) -> Result<(), Error> {
        let mut bytes = Vec::new();
        let mut encode = || -> Result<(), png::EncodingError> {
            let mut encoder =
                png::Encoder::new(&mut bytes, self.size[0] as u32, self.size[1] as u32);
            encoder.set_color(png::ColorType::Rgb);
            encoder.set_depth(png::BitDepth::Eight);
            encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
            let mut writer = encoder.write_header()?;
            writer.write_image_data(&self.bytes)?;
            writer.finish()
        };
        encode().map_err(|problem| Error::output(path, problem))?;
        write_atomically(path, &bytes)
    }

    /// Reads a file that [`Picture::write`] wrote.
    fn read(path: &Path) -> Result<Picture, Error> {
        let failed = |problem: String| {
            let cure = "remove it, and run `cutwater preview` again";
            Error::input(path.display().to_string(), problem, cure)
        };
        let file = File::open(path).map_err(|problem| failed(problem.to_string()))?;
        let mut reader = png::Decoder::new(BufReader::new(file))
            .read_info()
            .map_err(|problem| failed(problem.to_string()))?;
        let size = [reader.info().width as usize, reader.info().height as usize];
        let mut bytes = vec![0; 3 * size[0] * size[1]];
        if reader.output_buffer_size() != Some(bytes.len()) {
            return Err(failed("is not a picture of cutwater".to_owned()));
        }
        reader
            .next_frame(&mut bytes)
            .map_err(|problem| failed(problem.to_string()))?;
        Ok(Picture { size, bytes })
    }

    /// An animation of so many pictures, of which this is the first.
    fn animation<'a>(
        &self,
        bytes: &'a mut Vec<u8>,
        pictures: usize,
        (numerator, denominator): (u16, u16),
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

    /// Averaged over squares so that it is at most [`ANIMATION_WIDTH`] wide.
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
                            i32::from(
                                self.at(at[0].min(self.size[0] - 1), at[1].min(self.size[1] - 1))
                                    [channel],
                            )
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

/// Writes an animated PNG of pictures, each shown for its `seconds`, for ever; kept small: reduced pictures, of which only the changed
/// pixels are stored. The pictures are read one by one.
pub(super) fn animate(path: &Path, pictures: &[(PathBuf, f64)]) -> Result<(), Error> {
    let Some((first, seconds)) = pictures.first() else {
        return Ok(());
    };
    let failed = |problem: png::EncodingError| Error::output(path, problem);
    let mut bytes = Vec::new();
    let mut before = Picture::read(first)?.reduced();
    let mut writer = before
        .animation(&mut bytes, pictures.len(), delay(*seconds))
        .map_err(failed)?;
    for (picture, seconds) in &pictures[1..] {
        let now = Picture::read(picture)?.reduced();
        let patch = patch(Some(&before), &now);
        patch.write(&mut writer, delay(*seconds)).map_err(failed)?;
        before = now;
    }
    writer.finish().map_err(failed)?;
    write_atomically(path, &bytes)
}

/// Reads a PNG file to its end, comparing checksums.
///
/// # Errors
/// Where it is none, ends too early or was changed.
pub(crate) fn ensure_whole_png(bytes: &[u8]) -> Result<(), png::DecodingError> {
    png::Decoder::new(Cursor::new(bytes)).read_info()?.finish()
}

/// Seconds that a picture is shown for, as a fraction: APNG has no other. From 10 ms, below which browsers take longer, to 10 s.
fn delay(seconds: f64) -> (u16, u16) {
    let seconds = seconds.clamp(0.01, 10.0);
    // Convergents of the continued fraction; the last that fits, or the first that is the number to rounding.
    let (mut last, mut now) = ([0_u64, 1], [1_u64, 0]);
    let mut rest = seconds;
    loop {
        let whole = rest.floor();
        let next = [0, 1].map(|n| {
            (whole as u64)
                .saturating_mul(now[n])
                .saturating_add(last[n])
        });
        let (Ok(numerator), Ok(denominator)) = (u16::try_from(next[0]), u16::try_from(next[1]))
        else {
            // Of 0.01 to 10 the first two fit.
            return (now[0] as u16, now[1] as u16);
        };
        (last, now) = (now, next);
        let off = (f64::from(numerator) / f64::from(denominator) - seconds).abs();
        if off <= 1e-9 * seconds || rest == whole {
            return (numerator, denominator);
        }
        rest = 1.0 / (rest - whole);
    }
}

/// A rectangle of RGBA bytes with its place.
struct Patch {
    at: [usize; 2],
    size: [usize; 2],
    bytes: Vec<u8>,
}

impl Patch {
    /// As the next image, which stays for so long.
    fn write(
        &self,
        writer: &mut png::Writer<&mut Vec<u8>>,
        (numerator, denominator): (u16, u16),
    ) -> Result<(), png::EncodingError> {
        let [x, y] = self.at.map(|n| n as u32);
        let [width, height] = self.size.map(|n| n as u32);
        writer.set_frame_delay(numerator, denominator)?;
        // Smaller first: a rectangle may never reach beyond the picture.
        writer.set_frame_dimension(1, 1)?;
        writer.set_frame_position(x, y)?;
        writer.set_frame_dimension(width, height)?;
        writer.write_image_data(&self.bytes)
    }
}

/// The rectangle of changed pixels; unchanged ones in it are transparent. At least one pixel.
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
    Patch {
        at: low,
        size,
        bytes,
    }
}

#[cfg(test)]
mod tests {
    use super::delay;

    #[test]
    fn frames_are_shown_for_their_exact_time() {
        for rate in [12_u16, 24, 25, 30, 48, 60] {
            // Times of frames are quotients, and their differences off by rounding.
            let at = |frame: u16| f64::from(frame) / f64::from(rate);
            assert_eq!(delay(at(100) - at(99)), (1, rate));
        }
        assert_eq!(delay(1001.0 / 24000.0), (1001, 24000));
        assert_eq!((delay(1e-9), delay(1e9)), ((1, 100), (10, 1)));
        for seconds in [0.012_345_678_9, std::f64::consts::PI, 9.999_999] {
            let (numerator, denominator) = delay(seconds);
            let shown = f64::from(numerator) / f64::from(denominator);
            assert!((shown / seconds - 1.0).abs() < 1e-6, "{seconds}: {shown}");
        }
    }
}
