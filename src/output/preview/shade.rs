//! The picture of one frame: rays from the camera to floor, obstacles, solids and liquid.
//!
//! Lengths in the look (depth of colour, floor lines, fade) follow the size of the domain, so a beaker and a lake look alike.

use glam::Vec3;
use rayon::prelude::*;

use super::liquid::LiquidField;
use super::picture::Picture;
use super::solids::{Look, Scale};
use super::triangles::{Hit, Owner, Triangles};

/// Refractive index of the picture's liquid. Water's 1.33 would show a sunken body once through the surface and once more,
/// elsewhere, through each wall; this bends enough to look wet and leaves things where they are.
const REFRACTION: f32 = 1.08;

/// What liquid takes from red, green and blue light over one depth of the domain, nepers.
const ABSORPTION: Vec3 = Vec3::new(10.0, 3.6, 1.8);

/// What it gives back of it: the colour of deep liquid.
const DEEP: Vec3 = Vec3::new(0.010, 0.165, 0.29);

/// Share of the light that even the thinnest liquid takes, so that its edges are seen.
const VEIL: f32 = 0.30;

/// Linear colours of the rest.
const FLOOR: Vec3 = Vec3::new(0.62, 0.62, 0.60);
const OBSTACLE: Vec3 = Vec3::new(0.88, 0.50, 0.20);
const CONTAINER: Vec3 = Vec3::new(0.62, 0.60, 0.57);
const HORIZON: Vec3 = Vec3::new(0.80, 0.84, 0.88);
const ZENITH: Vec3 = Vec3::new(0.36, 0.52, 0.72);
const SUN: Vec3 = Vec3::new(0.78, 0.74, 0.68);
const SHADOW: Vec3 = Vec3::new(0.16, 0.34, 0.48);
const AMBIENT: Vec3 = Vec3::new(0.42, 0.46, 0.52);

/// Colour difference between neighbours, of 255, from which a pixel gets more rays.
const EDGE: i16 = 10;

/// Where a pixel with an edge gets its rays: a rotated 2x2 grid.
const OFFSETS: [(f32, f32); 4] = [
    (-0.125, -0.375),
    (0.375, -0.125),
    (0.125, 0.375),
    (-0.375, 0.125),
];

/// A pinhole camera, ready to make rays.
pub(super) struct View {
    pub(super) eye: Vec3,
    forward: Vec3,
    right: Vec3,
    up: Vec3,
    /// Half the picture's height at distance 1.
    scale: f32,
    pub(super) size: [usize; 2],
}

impl View {
    pub(super) fn new(eye: Vec3, target: Vec3, up: Vec3, degrees: f32, size: [usize; 2]) -> View {
        let forward = (target - eye).normalize_or(-Vec3::Z);
        let right = forward
            .cross(up)
            .normalize_or(forward.any_orthonormal_vector());
        let scale = (0.5 * degrees.to_radians()).tan();
        View {
            eye,
            forward,
            right,
            up: right.cross(forward),
            scale,
            size,
        }
    }

    /// Width of a pixel at distance 1.
    pub(super) fn pixel(&self) -> f32 {
        2.0 * self.scale / self.size[1] as f32
    }

    /// Unit direction through a point of the picture, in pixels from the upper left corner.
    fn direction(&self, x: f32, y: f32) -> Vec3 {
        let [width, height] = self.size.map(|n| n as f32);
        let unit = 2.0 * self.scale / height;
        let direction = self.forward + self.right * ((x - 0.5 * width) * unit)
            - self.up * ((y - 0.5 * height) * unit);
        // No component is exactly 0, so that its reciprocal is a number.
        let direction = direction.normalize();
        Vec3::select(
            direction.abs().cmplt(Vec3::splat(1e-12)),
            Vec3::splat(1e-12),
            direction,
        )
    }

    /// Pixel and distance along the view of a point, if in front of the eye.
    pub(super) fn project(&self, x: Vec3) -> Option<(f32, f32, f32)> {
        let offset = x - self.eye;
        let depth = offset.dot(self.forward);
        let [width, height] = self.size.map(|n| n as f32);
        let unit = 0.5 * height / (self.scale * depth);
        (depth > 1e-6).then(|| {
            (
                0.5 * width + offset.dot(self.right) * unit,
                0.5 * height - offset.dot(self.up) * unit,
                depth,
            )
        })
    }

    /// Distance along the view of a point on a ray.
    fn depth(&self, direction: Vec3, t: f32) -> f32 {
        t * direction.dot(self.forward)
    }
}

/// Everything in the picture.
pub(super) struct Stage<'a> {
    pub(super) liquid: Option<LiquidField>,
    pub(super) obstacles: &'a Triangles,
    /// Surfaces of elastic solids; each triangle has its look.
    pub(super) solids: Triangles,
    pub(super) looks: Vec<Look>,
    /// What the colours of solids stand for.
    pub(super) scale: &'a Scale,
    /// Width of a pixel at distance 1.
    pub(super) pixel: f32,
    /// Extents of the domain, m.
    pub(super) domain: Vec3,
    /// Against gravity: an axis.
    pub(super) up: Vec3,
    /// Distance between the lines of the floor, m.
    pub(super) floor_lines: f32,
    /// Unit direction to the sun.
    pub(super) sun: Vec3,
}

/// What a ray meets that it cannot pass.
struct Meeting {
    /// Distance along the ray, m.
    t: f32,
    surface: Seen,
}

enum Seen {
    Floor,
    Body(Hit),
}

impl Stage<'_> {
    /// Unit direction to the sun for a view: high, from the left, over the shoulder.
    pub(super) fn sun_for(view: &View, up: Vec3) -> Vec3 {
        let flat = |v: Vec3| (v - up * v.dot(up)).normalize_or(up.any_orthonormal_vector());
        (up * 1.5 - flat(view.right) * 0.8 - flat(view.forward) * 0.25).normalize()
    }

    /// The picture, and the distance along the view of what each pixel shows.
    pub(super) fn render(&self, view: &View) -> (Picture, Vec<f32>) {
        let [width, height] = view.size;
        let mut depths = vec![f32::INFINITY; width * height];
        let mut colours = vec![Vec3::ZERO; width * height];
        let rows = colours
            .par_chunks_mut(width)
            .zip(depths.par_chunks_mut(width))
            .enumerate();
        rows.for_each(|(y, (colours, depths))| {
            for (x, (colour, depth)) in colours.iter_mut().zip(depths).enumerate() {
                (*colour, *depth) = self.trace(view, x as f32 + 0.5, y as f32 + 0.5);
            }
        });
        let once = Picture::from_linear(view.size, &colours);
        let again: Vec<(usize, Vec3)> = (0..width * height)
            .into_par_iter()
            .filter(|&pixel| once.contrast(pixel % width, pixel / width) > EDGE)
            .map(|pixel| {
                let (x, y) = ((pixel % width) as f32 + 0.5, (pixel / width) as f32 + 0.5);
                let sum: Vec3 = OFFSETS
                    .iter()
                    .map(|&(dx, dy)| clip(self.trace(view, x + dx, y + dy).0))
                    .sum();
                (pixel, sum / OFFSETS.len() as f32)
            })
            .collect();
        for (pixel, colour) in again {
            colours[pixel] = colour;
        }
        (Picture::from_linear(view.size, &colours), depths)
    }

    /// Colour and distance along the view of what is seen at a point of the picture.
    fn trace(&self, view: &View, x: f32, y: f32) -> (Vec3, f32) {
        let direction = view.direction(x, y);
        let meets = self.meets(view.eye, direction);
        let limit = meets.as_ref().map_or(f32::INFINITY, |meets| meets.t);
        let entry = self.liquid.as_ref().and_then(|liquid| {
            let entry = liquid.entry(view.eye, direction, limit)?;
            Some((liquid, entry))
        });
        let Some((liquid, entry)) = entry else {
            return (
                self.colour(view.eye, direction, meets),
                view.depth(direction, limit),
            );
        };

        let at = view.eye + direction * entry.t;
        let normal = if entry.normal.dot(direction) < 0.0 {
            entry.normal
        } else {
            -direction
        };
        let cosine = -normal.dot(direction);
        let bent = refract(direction, normal, cosine);
        let meets = self.meets(at, bent);
        let limit = meets.as_ref().map_or(f32::INFINITY, |meets| meets.t);
        let depth_unit = self.domain.length();
        let length = liquid.length(at, bent, limit, 3.0 * depth_unit);
        let through = transmittance(length / depth_unit) * (1.0 - VEIL);
        let behind = self.colour(at, bent, meets);

        // Light scattered on the way: the sun's part has come through the liquid above, the sky's from all sides.
        let inside = at + bent * (0.25 * length).min(0.04 * depth_unit);
        let above = liquid.length(inside, self.sun, f32::INFINITY, depth_unit);
        let facing = 0.35 + 0.65 * normal.dot(self.sun).max(0.0);
        let light = transmittance(above / depth_unit) * SUN * facing * 1.5
            + AMBIENT * (0.8 + 0.2 * normal.dot(self.up));
        let scattered = DEEP * light * (Vec3::ONE - through) * 1.6;

        let mirrored = direction + normal * (2.0 * cosine);
        let fresnel = 0.02 + 0.98 * (1.0 - cosine.clamp(0.0, 1.0)).powi(5);
        let glint = mirrored.dot(self.sun).max(0.0).powi(180) * 2.5;
        let reflected = self.sky(mirrored) + SUN * glint * f32::from(glint > 1e-3);
        let colour = (behind * through + scattered).lerp(reflected, fresnel.min(0.75));
        (colour + SUN * glint * 0.25, view.depth(direction, entry.t))
    }

    /// The nearest of obstacles, solids and floor on a ray.
    fn meets(&self, origin: Vec3, direction: Vec3) -> Option<Meeting> {
        let floor = self.floor_distance(origin, direction).map(|t| Meeting {
            t,
            surface: Seen::Floor,
        });
        let limit = floor.as_ref().map_or(f32::INFINITY, |floor| floor.t);
        let obstacle = self.obstacles.hit(origin, direction, limit);
        let limit = obstacle.as_ref().map_or(limit, |hit| hit.t);
        let hit = self.solids.hit(origin, direction, limit).or(obstacle);
        hit.map(|hit| Meeting {
            t: hit.t,
            surface: Seen::Body(hit),
        })
        .or(floor)
    }

    /// Colour of what a ray meets.
    fn colour(&self, origin: Vec3, direction: Vec3, meets: Option<Meeting>) -> Vec3 {
        let Some(Meeting { t, surface }) = meets else {
            return self.sky(direction);
        };
        let at = origin + direction * t;
        match surface {
            Seen::Floor => self.floor(at, direction, t),
            Seen::Body(hit) => {
                let base = match hit.owner {
                    Owner::Obstacle => OBSTACLE,
                    Owner::Container => CONTAINER,
                    Owner::Solid(number) => {
                        self.looks[number].colour(self.scale, &hit, self.pixel * t)
                    }
                };
                base * self.light(at, hit.normal)
            }
        }
    }

    /// Distance along a ray to the plane of the floor, the domain's face that gravity points to; only from above.
    fn floor_distance(&self, origin: Vec3, direction: Vec3) -> Option<f32> {
        let down = direction.dot(self.up);
        let height = self.domain.dot(self.up).min(0.0);
        let t = (height - origin.dot(self.up)) / down;
        (down < 0.0 && t > 0.0).then_some(t)
    }

    /// The floor with its lines, fading into the horizon.
    fn floor(&self, at: Vec3, direction: Vec3, t: f32) -> Vec3 {
        let centre = 0.5 * self.domain;
        let away = (at - centre) - self.up * (at - centre).dot(self.up);
        let extent = self.domain.length();
        let fade = smooth(0.9 * extent, 3.2 * extent, away.length());
        let mut base = FLOOR;
        // Lines as wide as a pixel or so, lighter where they are closer than that.
        let width = (t * 1.2e-3 / direction.dot(self.up).abs().max(0.05).sqrt()).max(4e-4 * extent);
        for axis in 0..3 {
            if self.up[axis] == 0.0 {
                let nearest = (at[axis] / self.floor_lines).round() * self.floor_lines;
                let line = 1.0 - smooth(0.5 * width, 1.5 * width, (at[axis] - nearest).abs());
                base *= 1.0 - 0.14 * line * (1.0 - smooth(0.05, 0.4, width / self.floor_lines));
            }
        }
        let light = if fade < 1.0 {
            self.light(at, self.up)
        } else {
            SUN
        };
        (base * light).lerp(self.sky(direction), fade)
    }

    /// Light on a matt surface: the sun, where nothing is in between, and the sky.
    fn light(&self, at: Vec3, normal: Vec3) -> Vec3 {
        let facing = normal.dot(self.sun).max(0.0);
        let start = at + normal * (1e-4 * self.domain.length());
        let mut sun = Vec3::ZERO;
        let shades = |bodies: &Triangles| bodies.shades(start, self.sun);
        if facing > 0.0 && !shades(self.obstacles) && !shades(&self.solids) {
            let extent = self.domain.length();
            let length = self.liquid.as_ref().map_or(0.0, |liquid| {
                liquid.length(start, self.sun, f32::INFINITY, extent)
            });
            // Light goes round a liquid too, through its surface and off the floor: its shadow is blue and never black.
            let through = transmittance(0.8 * length / extent);
            sun = SUN * facing * (SHADOW + (Vec3::ONE - SHADOW) * through);
        }
        sun + AMBIENT * (0.75 + 0.25 * normal.dot(self.up))
    }

    fn sky(&self, direction: Vec3) -> Vec3 {
        let height = direction.dot(self.up);
        HORIZON.lerp(ZENITH, smooth(-0.05, 0.9, height))
    }
}

/// What is left of light after a length in depths of the domain.
fn transmittance(length: f32) -> Vec3 {
    (ABSORPTION * -length).exp()
}

/// Direction in the liquid of light that comes in from air.
fn refract(direction: Vec3, normal: Vec3, cosine: f32) -> Vec3 {
    let ratio = 1.0 / REFRACTION;
    let inner = (1.0 - ratio * ratio * (1.0 - cosine * cosine))
        .max(0.0)
        .sqrt();
    let bent = direction * ratio + normal * (ratio * cosine - inner);
    Vec3::select(
        bent.abs().cmplt(Vec3::splat(1e-12)),
        Vec3::splat(1e-12),
        bent.normalize(),
    )
}

fn smooth(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Highlights count as white when rays are averaged; else one glint fills a pixel.
fn clip(colour: Vec3) -> Vec3 {
    colour.min(Vec3::ONE)
}
