//! Elastic solids of a frame: surface and mesh edges, coloured by body, stress or change of volume.

use std::collections::HashMap;
use std::path::Path;

use glam::Vec3;
use vtkio::model::{DataSet, IOBuffer, Piece, VertexNumbers};

use super::picture::{self, Picture};
use super::triangles::{Hit, Owner, Triangle, Triangles};
use super::{Colour, DARK, array, points, read_vtk, unreadable};
use crate::Error;
use crate::geometry::TetMesh;

/// Colours of bodies, sRGB, in the order of the scene, repeated.
const BODIES: [u32; 8] = [0x2fa58b, 0xd9534f, 0xe8b73a, 0x7f6bc7, 0x5aa5d6, 0x9bbf4b, 0xd17fb0, 0x9a8478];
/// Colours of stress from 0 to the largest: viridis, sRGB.
const STRESS: [u32; 10] =
    [0x440154, 0x482878, 0x3e4989, 0x31688e, 0x26828e, 0x1f9e89, 0x35b779, 0x6ece58, 0xb5de2b, 0xfde725];
/// Colours of det F from compressed (below 1) to expanded (above 1), sRGB.
const VOLUME: [u32; 5] = [0x2166ac, 0x92c5de, 0xf2f2f2, 0xf4a582, 0xb2182b];
/// Colour of inverted elements, det F <= 0.
const INVERTED: u32 = 0xd000d0;

/// Quantile of values at the end of the scale: the peak of a short impact would compress the rest.
const SCALE_QUANTILE: f64 = 0.99;

/// Height of a triangle, pixels, from which on its sides are drawn, and at which they are darkest.
const SIDES: [f32; 2] = [4.0, 12.0];
/// Share of light that drawn sides absorb.
const SIDE_DARKNESS: f32 = 0.35;

pub(super) struct SolidFrame {
    /// Positions of the nodes, m.
    nodes: Vec<Vec3>,
    elements: Vec<[u32; 4]>,
    /// Body of each element.
    body: Vec<i32>,
    /// Coloured quantity of each element; empty for colours by body.
    values: Vec<f32>,
}

impl SolidFrame {
    /// Reads a .vtu file with the data of a colour.
    pub(super) fn read(path: &Path, colour: Colour) -> Result<SolidFrame, Error> {
        let missing = |what: &str| unreadable(path, format!("no {what}"));
        let DataSet::UnstructuredGrid { pieces, .. } = read_vtk(path)? else {
            return Err(missing("tetrahedra"));
        };
        let Some(Piece::Inline(piece)) = pieces.into_iter().next() else {
            return Err(missing("inline data"));
        };
        let nodes = points(piece.points).ok_or_else(|| missing("f32 points"))?;
        let VertexNumbers::XML { connectivity, .. } = piece.cells.cell_verts else {
            return Err(missing("tetrahedra"));
        };
        let known = connectivity.iter().all(|&node| (node as usize) < nodes.len());
        if !known || connectivity.len() % 4 != 0 {
            return Err(missing("such node"));
        }
        let elements: Vec<[u32; 4]> =
            connectivity.chunks_exact(4).map(|corners| [0, 1, 2, 3].map(|c| corners[c] as u32)).collect();
        let body = array(&piece.data.cell, "solid").and_then(IOBuffer::into_vec);
        let values = match colour.field() {
            Some(field) => array(&piece.data.cell, field).and_then(IOBuffer::into_vec),
            None => Some(Vec::new()),
        };
        let frame = SolidFrame {
            nodes,
            body: body.ok_or_else(|| missing("numbers of solids"))?,
            values: values.ok_or_else(|| missing(colour.field().unwrap_or_default()))?,
            elements,
        };
        let n = frame.elements.len();
        let whole = frame.body.len() == n && (frame.values.len() == n || colour == Colour::Solid);
        if whole { Ok(frame) } else { Err(missing("values of all tetrahedra")) }
    }
}

/// Surface of the solids, the same in all frames.
pub(super) struct SolidSurface {
    elements: Vec<[u32; 4]>,
    triangles: Vec<[u32; 3]>,
    /// The element behind each triangle.
    behind: Vec<usize>,
}

pub(super) struct Appearance {
    /// Linear colour of its body.
    body: Vec3,
    /// Coloured quantity at the corners.
    values: [f32; 3],
}

impl SolidSurface {
    pub(super) fn none() -> SolidSurface {
        SolidSurface { elements: Vec::new(), triangles: Vec::new(), behind: Vec::new() }
    }

    pub(super) fn coloured(&mut self, frame: &SolidFrame, colour: Colour) -> (Triangles, Vec<Appearance>) {
        if self.elements != frame.elements {
            *self = SolidSurface::new(frame);
        }
        let at_nodes = match colour {
            Colour::Stress => means(frame),
            Colour::Solid | Colour::DetF => Vec::new(),
        };
        let appearances = self.triangles.iter().zip(&self.behind);
        let appearances = appearances.map(|(corners, &element)| Appearance {
            body: linear(BODIES[frame.body[element].unsigned_abs() as usize % BODIES.len()]),
            values: match colour {
                Colour::Solid => [0.0; 3],
                Colour::Stress => corners.map(|node| at_nodes[node as usize]),
                // A mean would hide an inverted element.
                Colour::DetF => [frame.values[element]; 3],
            },
        });
        let triangles = (0..).zip(&self.triangles);
        let triangles = triangles.map(|(number, corners)| Triangle {
            corners: corners.map(|node| frame.nodes[node as usize]),
            owner: Owner::Solid(number),
        });
        (Triangles::new(triangles.collect()), appearances.collect())
    }

    fn new(frame: &SolidFrame) -> SolidSurface {
        let mesh =
            TetMesh { nodes: frame.nodes.iter().map(|x| x.as_dvec3()).collect(), elements: frame.elements.clone() };
        let triangles = mesh.surface();
        let sorted = |mut corners: [u32; 3]| {
            corners.sort_unstable();
            corners
        };
        let place = (0..).zip(&triangles);
        let place: HashMap<[u32; 3], usize> = place.map(|(at, &corners)| (sorted(corners), at)).collect();
        let mut behind = vec![0; triangles.len()];
        for (element, [a, b, c, d]) in frame.elements.iter().copied().enumerate() {
            for face in [[a, b, c], [a, b, d], [a, c, d], [b, c, d]] {
                if let Some(&at) = place.get(&sorted(face)) {
                    behind[at] = element;
                }
            }
        }
        SolidSurface { elements: mesh.elements, triangles, behind }
    }
}

/// Mean of each node over its elements.
fn means(frame: &SolidFrame) -> Vec<f32> {
    let mut sums = vec![(0.0_f32, 0.0_f32); frame.nodes.len()];
    for (corners, value) in frame.elements.iter().zip(&frame.values) {
        for &node in corners {
            let (sum, n) = &mut sums[node as usize];
            *sum += value;
            *n += 1.0;
        }
    }
    sums.into_iter().map(|(sum, n)| sum / n.max(1.0)).collect()
}

pub(super) enum Scale {
    Bodies,
    /// Stress from 0 to this, Pa.
    Stress(f32),
    /// det F from 1 less this to 1 and this.
    Volume(f32),
}

impl Scale {
    /// The scale of all drawn frames, so that colours are comparable.
    pub(super) fn over<'a>(colour: Colour, files: impl Iterator<Item = &'a Path>) -> Result<Scale, Error> {
        if colour == Colour::Solid {
            return Ok(Scale::Bodies);
        }
        let mut values = Vec::new();
        for file in files {
            let frame = SolidFrame::read(file, colour)?;
            values.extend(frame.values.into_iter().map(|value| match colour {
                Colour::DetF => (value - 1.0).abs(),
                _ => value,
            }));
        }
        let last = values.len().saturating_sub(1);
        let place = (SCALE_QUANTILE * last as f64) as usize;
        let high = match values.is_empty() {
            true => 0.0,
            false => *values.select_nth_unstable_by(place, f32::total_cmp).1,
        };
        let high = if high > 0.0 { round_up(high) } else { 1.0 };
        Ok(match colour {
            Colour::DetF => Scale::Volume(high.min(1.0)),
            _ => Scale::Stress(high),
        })
    }

    fn colour(&self, value: f32) -> Vec3 {
        match *self {
            Scale::Bodies => Vec3::ONE,
            Scale::Stress(high) => between(&STRESS, value / high),
            Scale::Volume(_) if value <= 0.0 => linear(INVERTED),
            Scale::Volume(reach) => between(&VOLUME, 0.5 + 0.5 * (value - 1.0) / reach),
        }
    }

    /// Draws the legend into the upper right corner.
    pub(super) fn draw(&self, picture: &mut Picture) {
        let (title, low, high) = match *self {
            Scale::Bodies => return,
            Scale::Stress(high) => ("von Mises, Pa", 0.0, high),
            Scale::Volume(reach) => ("det F", 1.0 - reach, 1.0 + reach),
        };
        let [width, height] = picture.size;
        let [letter, line] = picture.font().extent(1);
        let margin = line / 2;
        let right = |length: usize| width.saturating_sub(margin + length);
        let at = |x: usize, y: usize| (x as i64, y as i64);
        let (x, y) = at(right(letter * title.len()), margin);
        picture.text(x, y, title, DARK, |_, _| true);
        let (top, tall, wide) = (margin + 2 * line, 2 * height / 5, letter);
        for row in 0..tall {
            let share = 1.0 - (row as f32 + 0.5) / tall as f32;
            let colour = picture::srgb(self.colour(low + (high - low) * share));
            picture.fill([right(wide), top + row], [wide, 1], colour);
        }
        for (share, value) in [(0.0, high), (0.5, 0.5 * (low + high)), (1.0, low)] {
            let label = label(value);
            let middle = top as f32 + share * tall as f32;
            let x = right(wide + letter / 2 + letter * label.len());
            let (x, y) = at(x, (middle - 0.5 * line as f32) as usize);
            picture.text(x, y, &label, DARK, |_, _| true);
        }
    }
}

impl Appearance {
    /// Linear colour at a ray intersection; a pixel is `pixel` m wide there.
    pub(super) fn colour(&self, scale: &Scale, hit: &Hit, pixel: f32) -> Vec3 {
        let base = match scale {
            Scale::Bodies => self.body,
            _ => {
                let value = self.values.iter().zip(hit.weights);
                scale.colour(value.map(|(value, weight)| value * weight).sum())
            }
        };
        let [a, b, c] = hit.corners;
        let area = (b - a).cross(c - a).length();
        let heights = [c - b, a - c, b - a].map(|side| area / side.length().max(f32::MIN_POSITIVE));
        let least = heights.into_iter().fold(f32::INFINITY, f32::min) / pixel;
        let away = (0..3).map(|corner| hit.weights[corner] * heights[corner]).fold(f32::INFINITY, f32::min) / pixel;
        let strength = ((least - SIDES[0]) / (SIDES[1] - SIDES[0])).clamp(0.0, 1.0);
        base * (1.0 - SIDE_DARKNESS * strength * (1.2 - away).clamp(0.0, 1.0))
    }
}

/// Linear colour of 0xRRGGBB.
fn linear(code: u32) -> Vec3 {
    let channel = |shift: u32| {
        let x = (code >> shift & 0xff) as f32 / 255.0;
        if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
    };
    Vec3::new(channel(16), channel(8), channel(0))
}

/// Interpolated linear colour at a fraction of a list.
fn between(codes: &[u32], share: f32) -> Vec3 {
    let at = share.clamp(0.0, 1.0) * (codes.len() - 1) as f32;
    let low = (at as usize).min(codes.len() - 2);
    linear(codes[low]).lerp(linear(codes[low + 1]), at - low as f32)
}

/// Least number of 1, 2 or 5 times a power of ten that is not below a value.
fn round_up(value: f32) -> f32 {
    let power = 10f32.powf(value.log10().floor());
    let steps = [1.0, 2.0, 5.0].map(|step| step * power);
    let step = steps.into_iter().find(|step| *step >= value);
    step.unwrap_or(10.0 * power)
}

/// A number with up to three digits.
pub(super) fn label(value: f32) -> String {
    // Rounds off binary digits such as those of 1 - 0.2.
    let value: f64 = format!("{value:.2e}").parse().unwrap_or_default();
    if value == 0.0 || (1e-2..1e4).contains(&value.abs()) { format!("{value}") } else { format!("{value:e}") }
}
