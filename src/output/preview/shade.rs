//! Renders one frame: rays from the camera to floor, obstacles, solids and liquid.
//!
//! Lengths of the appearance (absorption, floor grid, fade) scale with the domain, so a beaker and a lake look alike.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::liquid::{Entry, Liquid};
use super::picture::Picture;
use super::solids::{Appearance, Scale};
use super::triangles::{Hit, Owner, Triangles};
use crate::scene::CameraKeyframe;

/// Refractive index. Water's 1.33 shows a sunken body twice, through the surface and through each wall; this value appearances wet
/// and moves nothing.
const REFRACTION: f32 = 1.08;

/// Absorption of red, green and blue light per depth of the domain, nepers.
const ABSORPTION: Vec3 = Vec3::new(10.0, 3.6, 1.8);

/// Colour of scattered light in deep liquid.
const DEEP: Vec3 = Vec3::new(0.010, 0.165, 0.29);

/// Least absorbed share of light, which makes the edges of thin liquid visible.
const VEIL: f32 = 0.30;

const FLOOR: Vec3 = Vec3::new(0.62, 0.62, 0.60);
const OBSTACLE: Vec3 = Vec3::new(0.66, 0.34, 0.13);
const SEPARATED: Vec3 = Vec3::new(0.75, 0.05, 0.04);
const CONTAINER: Vec3 = Vec3::new(0.62, 0.60, 0.57);
const HORIZON: Vec3 = Vec3::new(0.80, 0.84, 0.88);
const ZENITH: Vec3 = Vec3::new(0.36, 0.52, 0.72);
const SUN: Vec3 = Vec3::new(0.78, 0.74, 0.68);
const SHADOW: Vec3 = Vec3::new(0.16, 0.34, 0.48);
const AMBIENT: Vec3 = Vec3::new(0.42, 0.46, 0.52);

/// Angular radius of the sun, rad: far larger than the real one, for soft shadows.
const SUN_RADIUS: f32 = 0.04;

/// Sample points on the sun's disc: a spiral.
const SUN_SAMPLES: [(f32, f32); 8] = [
    (0.25, 0.0),
    (-0.319, 0.292),
    (0.049, -0.557),
    (0.402, 0.525),
    (-0.739, -0.131),
    (0.700, -0.445),
    (-0.234, 0.871),
    (-0.446, -0.861),
];

/// Range of ambient occlusion in depths of the domain, and its largest share.
const OCCLUSION_RANGE: f32 = 0.12;
const MAX_OCCLUSION: f32 = 0.75;

/// Sample directions of the sky around a normal, which is z.
const SKY_SAMPLES: [Vec3; 9] = [
    Vec3::new(0.0, 0.0, 1.0),
    Vec3::new(0.55, 0.15, 0.82),
    Vec3::new(-0.15, 0.55, 0.82),
    Vec3::new(-0.55, -0.15, 0.82),
    Vec3::new(0.15, -0.55, 0.82),
    Vec3::new(0.66, 0.66, 0.36),
    Vec3::new(-0.66, 0.66, 0.36),
    Vec3::new(-0.66, -0.66, 0.36),
    Vec3::new(0.66, -0.66, 0.36),
];

/// Reflectance from which reflections show bodies rather than the sky alone.
const MIRROR: f32 = 0.05;

/// Distance of coincident surfaces, in depths of the domain: far above rounding, far below a cell.
const SAME_PLANE: f32 = 1e-5;

/// Channel difference between neighbours, of 255, from which a pixel is supersampled.
const EDGE: i16 = 10;

/// Supersampling positions: a rotated 2x2 grid.
const OFFSETS: [(f32, f32); 4] = [(-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125)];

pub(super) struct View {
    pub(super) eye: Vec3,
    forward: Vec3,
    right: Vec3,
    up: Vec3,
    /// Half the height of the picture at distance 1.
    scale: f32,
    pub(super) size: [usize; 2],
}

impl View {
    pub(super) fn new(pose: &CameraKeyframe, up: DVec3, size: [usize; 2]) -> View {
        let forward = (pose.target - pose.eye).as_vec3().normalize_or(-Vec3::Z);
        let right = forward.cross(up.as_vec3()).normalize_or(forward.any_orthonormal_vector());
        let eye = pose.eye.as_vec3();
        let scale = (0.5 * pose.fov.to_radians()).tan() as f32;
        View { eye, forward, right, up: right.cross(forward), scale, size }
    }

    /// Width of a pixel at distance 1.
    pub(super) fn pixel(&self) -> f32 {
        2.0 * self.scale / self.size[1] as f32
    }

    /// Unit direction through a point of the picture, in pixels from the upper left corner.
    fn direction(&self, x: f32, y: f32) -> Vec3 {
        let [width, height] = self.size.map(|n| n as f32);
        let unit = 2.0 * self.scale / height;
        let direction = self.forward + self.right * ((x - 0.5 * width) * unit) - self.up * ((y - 0.5 * height) * unit);
        // Avoids zero components, whose reciprocals are infinite.
        let direction = direction.normalize();
        Vec3::select(direction.abs().cmplt(Vec3::splat(1e-12)), Vec3::splat(1e-12), direction)
    }

    /// Pixel and depth of a point in front of the eye.
    pub(super) fn project(&self, x: Vec3) -> Option<(f32, f32, f32)> {
        let offset = x - self.eye;
        let depth = offset.dot(self.forward);
        let [width, height] = self.size.map(|n| n as f32);
        let unit = 0.5 * height / (self.scale * depth);
        (depth > 1e-6)
            .then(|| (0.5 * width + offset.dot(self.right) * unit, 0.5 * height - offset.dot(self.up) * unit, depth))
    }

    /// Depth of a point on a ray.
    fn depth(&self, direction: Vec3, t: f32) -> f32 {
        t * direction.dot(self.forward)
    }
}

pub(super) struct PictureScene {
    pub(super) liquid: Option<Liquid>,
    pub(super) obstacles: Triangles,
    /// Cubes in the separated cells, where they are shown.
    pub(super) separated: Triangles,
    /// Surfaces of elastic solids, with an appearance per triangle.
    pub(super) solids: Triangles,
    pub(super) appearances: Vec<Appearance>,
    pub(super) scale: Scale,
    /// Width of a pixel at distance 1.
    pub(super) pixel: f32,
    /// Extents of the domain, m.
    pub(super) domain: Vec3,
    /// Axis against gravity.
    pub(super) up: Vec3,
    /// Spacing of the floor grid, m.
    pub(super) floor_lines: f32,
    /// Unit direction to the sun.
    pub(super) sun: Vec3,
}

/// First opaque intersection of a ray.
struct Intersection {
    /// Distance along the ray, m.
    t: f32,
    target: Target,
}

enum Target {
    Floor,
    Body(Hit),
}

impl PictureScene {
    /// Direction to the sun for a view: high, from behind and to the left of the camera.
    pub(super) fn sun_for(view: &View, up: Vec3) -> Vec3 {
        let flat = |v: Vec3| (v - up * v.dot(up)).normalize_or(up.any_orthonormal_vector());
        (up * 1.5 - flat(view.right) * 0.8 - flat(view.forward) * 0.25).normalize()
    }

    /// The picture and the depth of each pixel.
    pub(super) fn render(&self, view: &View) -> (Picture, Vec<f32>) {
        let [width, height] = view.size;
        let submerged = self.liquid.as_ref().is_some_and(|liquid| liquid.contains(view.eye));
        let mut depths = vec![f32::INFINITY; width * height];
        let mut colours = vec![Vec3::ZERO; width * height];
        let rows = colours.par_chunks_mut(width).zip(depths.par_chunks_mut(width)).enumerate();
        rows.for_each(|(y, (colours, depths))| {
            for (x, (colour, depth)) in colours.iter_mut().zip(depths).enumerate() {
                (*colour, *depth) = self.trace(view, submerged, x as f32 + 0.5, y as f32 + 0.5);
            }
        });
        let once = Picture::from_linear(view.size, &colours);
        let again: Vec<(usize, Vec3)> = (0..width * height)
            .into_par_iter()
            .filter(|&pixel| once.contrast(pixel % width, pixel / width) > EDGE)
            .map(|pixel| {
                let (x, y) = ((pixel % width) as f32 + 0.5, (pixel / width) as f32 + 0.5);
                let sum: Vec3 =
                    OFFSETS.iter().map(|&(dx, dy)| clip(self.trace(view, submerged, x + dx, y + dy).0)).sum();
                (pixel, sum / OFFSETS.len() as f32)
            })
            .collect();
        for (pixel, colour) in again {
            colours[pixel] = colour;
        }
        (Picture::from_linear(view.size, &colours), depths)
    }

    /// Colour and depth at a point of the picture; `submerged` is whether the eye is in liquid.
    fn trace(&self, view: &View, submerged: bool, x: f32, y: f32) -> (Vec3, f32) {
        let direction = view.direction(x, y);
        let nearest = self.nearest(view.eye, direction);
        let limit = nearest.as_ref().map_or(f32::INFINITY, |nearest| nearest.t);
        // The liquid's mesh reaches slightly into bodies. With a body's side in a wall both surfaces coincide, and the
        // body is visible.
        let before = limit - SAME_PLANE * self.domain.length();
        let entry = self.liquid.as_ref().and_then(|liquid| {
            let entry = match submerged {
                true => Some(Entry { t: 0.0, normal: -direction }),
                false => liquid.entry(view.eye, direction, before),
            };
            Some((liquid, entry?))
        });
        let Some((liquid, entry)) = entry else {
            return (self.colour(view.eye, direction, nearest), view.depth(direction, limit));
        };

        let at = view.eye + direction * entry.t;
        let normal = entry.normal;
        let cosine = -normal.dot(direction);
        let bent = refract(direction, normal, cosine);
        let nearest = self.nearest(at, bent);
        let limit = nearest.as_ref().map_or(f32::INFINITY, |nearest| nearest.t);
        let depth_unit = self.domain.length();
        let length = liquid.length(at, bent, limit);
        let through = transmittance(length / depth_unit) * (1.0 - VEIL);
        let behind = self.colour(at, bent, nearest);

        // Scattered light: sunlight through the liquid above, and skylight from all sides.
        let inside = at + bent * (0.25 * length).min(0.04 * depth_unit);
        let above = liquid.length(inside, self.sun, f32::INFINITY);
        let facing = 0.35 + 0.65 * normal.dot(self.sun).max(0.0);
        let light =
            transmittance(above / depth_unit) * SUN * facing * 1.5 + AMBIENT * (0.8 + 0.2 * normal.dot(self.up));
        let scattered = DEEP * light * (Vec3::ONE - through) * 1.6;

        let mirrored = direction + normal * (2.0 * cosine);
        let fresnel = 0.02 + 0.98 * (1.0 - cosine.clamp(0.0, 1.0)).powi(5);
        let glint = mirrored.dot(self.sun).max(0.0).powi(180) * 2.5;
        let start = at + normal * (1e-4 * depth_unit);
        let bodies = (fresnel > MIRROR).then(|| self.body(start, mirrored, f32::INFINITY));
        let reflected = match bodies.flatten() {
            Some(hit) => self.matt(start + mirrored * hit.t, &hit),
            None => self.sky(mirrored) + SUN * glint * f32::from(glint > 1e-3),
        };
        let colour = (behind * through + scattered).lerp(reflected, fresnel.min(0.75));
        let seen = if submerged { limit } else { entry.t };
        (colour + SUN * glint * 0.25, view.depth(direction, seen))
    }

    /// Depth of the floor at a pixel; infinite beside it.
    pub(super) fn floor_depth(&self, view: &View, x: usize, y: usize) -> f32 {
        let direction = view.direction(x as f32 + 0.5, y as f32 + 0.5);
        let distance = self.floor_distance(view.eye, direction);
        view.depth(direction, distance.unwrap_or(f32::INFINITY))
    }

    /// First intersection with obstacles, solids or floor.
    fn nearest(&self, origin: Vec3, direction: Vec3) -> Option<Intersection> {
        let floor = self.floor_distance(origin, direction).map(|t| Intersection { t, target: Target::Floor });
        let limit = floor.as_ref().map_or(f32::INFINITY, |floor| floor.t);
        let hit = self.body(origin, direction, limit);
        hit.map(|hit| Intersection { t: hit.t, target: Target::Body(hit) }).or(floor)
    }

    /// First intersection with obstacles, solids or cubes of separated cells before `limit`.
    fn body(&self, origin: Vec3, direction: Vec3, limit: f32) -> Option<Hit> {
        let obstacle = self.obstacles.hit(origin, direction, limit);
        let limit = obstacle.as_ref().map_or(limit, |hit| hit.t);
        let solid = self.solids.hit(origin, direction, limit).or(obstacle);
        let limit = solid.as_ref().map_or(limit, |hit| hit.t);
        self.separated.hit(origin, direction, limit).or(solid)
    }

    fn colour(&self, origin: Vec3, direction: Vec3, nearest: Option<Intersection>) -> Vec3 {
        let Some(Intersection { t, target }) = nearest else {
            return self.sky(direction);
        };
        let at = origin + direction * t;
        match target {
            Target::Floor => self.floor(at, direction, t),
            Target::Body(hit) => self.matt(at, &hit),
        }
    }

    /// Colour of a body, diffuse.
    fn matt(&self, at: Vec3, hit: &Hit) -> Vec3 {
        let base = match hit.owner {
            // Containers are translucent.
            Owner::Container => {
                let facing = hit.normal.dot(self.sun);
                return CONTAINER * (AMBIENT + SUN * (0.35 + 0.25 * facing));
            }
            Owner::Solid(number) => self.appearances[number].colour(&self.scale, hit, self.pixel * hit.t),
            Owner::Separated => SEPARATED,
            Owner::Obstacle | Owner::Liquid(_) => OBSTACLE,
        };
        base * self.light(at, hit.normal)
    }

    /// Distance to the floor, the domain's lowest side, from above.
    fn floor_distance(&self, origin: Vec3, direction: Vec3) -> Option<f32> {
        let down = direction.dot(self.up);
        let height = self.domain.dot(self.up).min(0.0);
        let t = (height - origin.dot(self.up)) / down;
        (down < 0.0 && t > 0.0).then_some(t)
    }

    /// The floor with its grid, fading into the horizon.
    fn floor(&self, at: Vec3, direction: Vec3, t: f32) -> Vec3 {
        let centre = 0.5 * self.domain;
        let away = (at - centre) - self.up * (at - centre).dot(self.up);
        let extent = self.domain.length();
        let fade = smooth(0.9 * extent, 3.2 * extent, away.length());
        let mut base = FLOOR;
        // Lines about a pixel wide, fainter where they are dense.
        let width = (t * 1.2e-3 / direction.dot(self.up).abs().max(0.05).sqrt()).max(4e-4 * extent);
        for axis in 0..3 {
            if self.up[axis] == 0.0 {
                let nearest = (at[axis] / self.floor_lines).round() * self.floor_lines;
                let line = 1.0 - smooth(0.5 * width, 1.5 * width, (at[axis] - nearest).abs());
                base *= 1.0 - 0.14 * line * (1.0 - smooth(0.05, 0.4, width / self.floor_lines));
            }
        }
        let light = if fade < 1.0 { self.light(at, self.up) } else { SUN };
        (base * light).lerp(self.sky(direction), fade)
    }

    /// Light on a diffuse surface: unshadowed sunlight and unoccluded skylight.
    fn light(&self, at: Vec3, normal: Vec3) -> Vec3 {
        let extent = self.domain.length();
        let start = at + normal * (1e-4 * extent);
        let facing = normal.dot(self.sun).max(0.0);
        let mut sun = Vec3::ZERO;
        let seen = if facing > 0.0 { self.sun_seen(start) } else { 0.0 };
        if seen > 0.0 {
            let liquid = self.liquid.as_ref();
            let length = liquid.map_or(0.0, |liquid| liquid.length(start, self.sun, f32::INFINITY));
            // Light also passes around liquid, so its shadow is blue and never black.
            let through = transmittance(0.8 * length / extent);
            sun = SUN * (seen * facing) * (SHADOW + (Vec3::ONE - SHADOW) * through);
        }
        sun + AMBIENT * ((0.75 + 0.25 * normal.dot(self.up)) * self.sky_seen(start, normal))
    }

    /// Whether a body intersects a ray before `limit`.
    fn shaded(&self, start: Vec3, direction: Vec3, limit: f32) -> bool {
        self.obstacles.shades(start, direction, limit) || self.solids.shades(start, direction, limit)
    }

    /// Whether a bounding ball (centre, radius) of the obstacles or of the solids passes a test.
    fn bodies_near(&self, may: impl Fn(Vec3, f32) -> bool) -> bool {
        let bounds = [&self.obstacles, &self.solids].map(Triangles::bounds);
        let mut balls = bounds.into_iter().flatten();
        balls.any(|[low, high]| may(0.5 * (low + high), 0.5 * low.distance(high)))
    }

    /// Visible share of the sun.
    fn sun_seen(&self, start: Vec3) -> f32 {
        if !self.bodies_near(|centre, radius| {
            let along = (centre - start).dot(self.sun);
            let aside = (centre - start) - self.sun * along;
            along > -radius && aside.length() < radius + SUN_RADIUS * along.max(0.0)
        }) {
            return 1.0;
        }
        let (right, up) = self.sun.any_orthonormal_pair();
        let seen = |first: usize| {
            let samples = SUN_SAMPLES.iter().skip(first).step_by(2);
            let seen = samples.filter(|(x, y)| {
                let direction = self.sun + (right * *x + up * *y) * SUN_RADIUS;
                !self.shaded(start, direction, f32::INFINITY)
            });
            seen.count()
        };
        // Outside penumbras half of the samples suffices.
        let half = SUN_SAMPLES.len() / 2;
        match seen(0) {
            0 => 0.0,
            all if all == half => 1.0,
            some => (some + seen(1)) as f32 / SUN_SAMPLES.len() as f32,
        }
    }

    /// Visible share of the sky, by ambient occlusion.
    fn sky_seen(&self, start: Vec3, normal: Vec3) -> f32 {
        let reach = OCCLUSION_RANGE * self.domain.length();
        if !self.bodies_near(|centre, radius| centre.distance(start) < radius + reach) {
            return 1.0;
        }
        let (right, up) = normal.any_orthonormal_pair();
        let occluded = SKY_SAMPLES.iter().filter(|local| {
            let direction = right * local.x + up * local.y + normal * local.z;
            self.shaded(start, direction, reach)
        });
        1.0 - MAX_OCCLUSION * occluded.count() as f32 / SKY_SAMPLES.len() as f32
    }

    fn sky(&self, direction: Vec3) -> Vec3 {
        let height = direction.dot(self.up);
        HORIZON.lerp(ZENITH, smooth(-0.05, 0.9, height))
    }
}

/// Transmittance of a length in depths of the domain.
fn transmittance(length: f32) -> Vec3 {
    (ABSORPTION * -length).exp()
}

/// Direction of refracted light from air into liquid.
fn refract(direction: Vec3, normal: Vec3, cosine: f32) -> Vec3 {
    let ratio = 1.0 / REFRACTION;
    let inner = (1.0 - ratio * ratio * (1.0 - cosine * cosine)).max(0.0).sqrt();
    let bent = direction * ratio + normal * (ratio * cosine - inner);
    Vec3::select(bent.abs().cmplt(Vec3::splat(1e-12)), Vec3::splat(1e-12), bent.normalize())
}

fn smooth(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Clamps highlights before averaging; else one glint fills a pixel.
fn clip(colour: Vec3) -> Vec3 {
    colour.min(Vec3::ONE)
}
