//! 8-bit sRGB pictures: lines and letters on them, PNG files, and the animation.

use std::path::Path;

use glam::Vec3;

use crate::Error;
use crate::output::write_atomically;

/// Largest width of the animation, pixels.
const ANIMATION_WIDTH: usize = 640;

/// The letters of captions: 7 rows of 5 pixels, the left one in bit 4.
const LETTERS: [(char, [u8; 7]); 27] = [
    ('0', [0x0e, 0x11, 0x13, 0x15, 0x19, 0x11, 0x0e]),
    ('1', [0x04, 0x0c, 0x04, 0x04, 0x04, 0x04, 0x0e]),
    ('2', [0x0e, 0x11, 0x01, 0x02, 0x04, 0x08, 0x1f]),
    ('3', [0x1f, 0x02, 0x04, 0x02, 0x01, 0x11, 0x0e]),
    ('4', [0x02, 0x06, 0x0a, 0x12, 0x1f, 0x02, 0x02]),
    ('5', [0x1f, 0x10, 0x1e, 0x01, 0x01, 0x11, 0x0e]),
    ('6', [0x06, 0x08, 0x10, 0x1e, 0x11, 0x11, 0x0e]),
    ('7', [0x1f, 0x01, 0x02, 0x04, 0x08, 0x08, 0x08]),
    ('8', [0x0e, 0x11, 0x11, 0x0e, 0x11, 0x11, 0x0e]),
    ('9', [0x0e, 0x11, 0x11, 0x0f, 0x01, 0x02, 0x0c]),
    ('.', [0x00, 0x00, 0x00, 0x00, 0x00, 0x0c, 0x0c]),
    ('e', [0x00, 0x00, 0x0e, 0x11, 0x1f, 0x10, 0x0e]),
    ('-', [0x00, 0x00, 0x00, 0x1f, 0x00, 0x00, 0x00]),
    ('i', [0x04, 0x00, 0x0c, 0x04, 0x04, 0x04, 0x0e]),
    ('l', [0x0c, 0x04, 0x04, 0x04, 0x04, 0x04, 0x0e]),
    ('n', [0x00, 0x00, 0x16, 0x19, 0x11, 0x11, 0x11]),
    ('m', [0x00, 0x00, 0x1a, 0x15, 0x15, 0x11, 0x11]),
    ('s', [0x00, 0x00, 0x0e, 0x10, 0x0e, 0x01, 0x1e]),
    ('a', [0x00, 0x00, 0x0e, 0x01, 0x0f, 0x11, 0x0f]),
    ('d', [0x01, 0x01, 0x0d, 0x13, 0x11, 0x11, 0x0f]),
    ('o', [0x00, 0x00, 0x0e, 0x11, 0x11, 0x11, 0x0e]),
    ('t', [0x08, 0x08, 0x1c, 0x08, 0x08, 0x09, 0x06]),
    ('v', [0x00, 0x00, 0x11, 0x11, 0x11, 0x0a, 0x04]),
    ('F', [0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x10]),
    ('M', [0x11, 0x1b, 0x15, 0x15, 0x11, 0x11, 0x11]),
    ('P', [0x1e, 0x11, 0x11, 0x1e, 0x10, 0x10, 0x10]),
    (',', [0x00, 0x00, 0x00, 0x00, 0x0c, 0x04, 0x08]),
];

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

    /// A caption, its upper left corner given; letters are `7 scale` pixels high. Unknown letters are blanks.
    pub(super) fn text(&mut self, x: usize, y: usize, scale: usize, text: &str, colour: [u8; 3]) {
        for (place, letter) in text.chars().enumerate() {
            let rows = LETTERS
                .iter()
                .find(|(known, _)| *known == letter)
                .map_or([0; 7], |&(_, rows)| rows);
            for (row, bits) in rows.into_iter().enumerate() {
                for column in (0..5).filter(|column| bits >> (4 - column) & 1 == 1) {
                    for pixel in 0..scale * scale {
                        let px = x + (6 * place + column) * scale + pixel % scale;
                        let py = y + row * scale + pixel / scale;
                        self.mix(px as i64, py as i64, colour, 0.85);
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

/// The frames of an animated PNG, kept small: reduced pictures, of which only the changed pixels are stored.
pub(super) struct Animation {
    frames: Vec<Picture>,
}

/// A rectangle of RGBA bytes with its place.
struct Patch {
    at: [usize; 2],
    size: [usize; 2],
    bytes: Vec<u8>,
}

impl Animation {
    pub(super) fn new() -> Animation {
        Animation { frames: Vec::new() }
    }

    pub(super) fn push(&mut self, picture: &Picture) {
        self.frames.push(picture.reduced());
    }

    /// Writes all frames, each shown for its `seconds`, for ever.
    pub(super) fn write(&self, path: &Path, seconds: &[f64]) -> Result<(), Error> {
        let mut bytes = Vec::new();
        self.encode(&mut bytes, seconds)
            .map_err(|problem| Error::output(path, problem))?;
        write_atomically(path, &bytes)
    }

    fn encode(&self, bytes: &mut Vec<u8>, seconds: &[f64]) -> Result<(), png::EncodingError> {
        let [width, height] = self.frames[0].size;
        let mut encoder = png::Encoder::new(bytes, width as u32, height as u32);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::High);
        encoder.set_animated(self.frames.len() as u32, 0)?;
        let milliseconds = |seconds: f64| (1000.0 * seconds).round().clamp(10.0, 10_000.0) as u16;
        encoder.set_frame_delay(milliseconds(seconds[0]), 1000)?;
        encoder.set_blend_op(png::BlendOp::Over)?;
        encoder.set_dispose_op(png::DisposeOp::None)?;
        let mut writer = encoder.write_header()?;
        let mut before: Option<&Picture> = None;
        for (frame, &seconds) in self.frames.iter().zip(seconds) {
            let Patch { at, size, bytes } = patch(before, frame);
            if before.is_some() {
                writer.set_frame_delay(milliseconds(seconds), 1000)?;
                // Smaller first: a rectangle may never reach beyond the picture.
                writer.set_frame_dimension(1, 1)?;
                writer.set_frame_position(at[0] as u32, at[1] as u32)?;
                writer.set_frame_dimension(size[0] as u32, size[1] as u32)?;
            }
            writer.write_image_data(&bytes)?;
            before = Some(frame);
        }
        writer.finish()
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
