//! The picture of one frame: rays from the camera to floor, obstacles, solids and liquid.
//!
//! Lengths in the look (depth of colour, floor lines, fade) follow the size of the domain, so a beaker and a lake look alike.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::liquid::{Entry, Liquid};
use super::picture::Picture;
use super::solids::{Look, Scale};
use super::triangles::{Hit, Owner, Triangles};
use crate::scene::CameraKeyframe;

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
const OBSTACLE: Vec3 = Vec3::new(0.66, 0.34, 0.13);
const CONTAINER: Vec3 = Vec3::new(0.62, 0.60, 0.57);
const HORIZON: Vec3 = Vec3::new(0.80, 0.84, 0.88);
const ZENITH: Vec3 = Vec3::new(0.36, 0.52, 0.72);
const SUN: Vec3 = Vec3::new(0.78, 0.74, 0.68);
const SHADOW: Vec3 = Vec3::new(0.16, 0.34, 0.48);
const AMBIENT: Vec3 = Vec3::new(0.42, 0.46, 0.52);

/// Half the angle of the sun, rad: far larger than it is, for shadows with soft edges.
const SUN_RADIUS: f32 = 0.04;

/// Where on the sun's disc rays go: a spiral.
const ON_SUN: [(f32, f32); 8] = [
    (0.25, 0.0),
    (-0.319, 0.292),
    (0.049, -0.557),
    (0.402, 0.525),
    (-0.739, -0.131),
    (0.700, -0.445),
    (-0.234, 0.871),
    (-0.446, -0.861),
];

/// How far bodies keep the sky's light from what is beside them, in depths of the domain, and how much of it at most.
const SKY_REACH: f32 = 0.12;
const SKY_TAKEN: f32 = 0.75;

/// Where the sky's light comes from around a normal, which is z.
const SKY: [Vec3; 9] = [
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

/// Share of light from which a reflection shows bodies; below it shows the sky alone.
const MIRROR: f32 = 0.05;

/// Surfaces that are nearer to each other than this, in depths of the domain, are one: far above rounding, far below a cell.
const SAME_PLANE: f32 = 1e-5;

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
    pub(super) fn new(pose: &CameraKeyframe, up: DVec3, size: [usize; 2]) -> View {
        let forward = (pose.target - pose.eye).as_vec3().normalize_or(-Vec3::Z);
        let right = forward
            .cross(up.as_vec3())
            .normalize_or(forward.any_orthonormal_vector());
        let eye = pose.eye.as_vec3();
        let scale = (0.5 * pose.fov.to_radians()).tan() as f32;
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
pub(super) struct Stage {
    pub(super) liquid: Option<Liquid>,
    pub(super) obstacles: Triangles,
    /// Surfaces of elastic solids; each triangle has its look.
    pub(super) solids: Triangles,
    pub(super) looks: Vec<Look>,
    /// What the colours of solids stand for.
    pub(super) scale: Scale,
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

impl Stage {
    /// Unit direction to the sun for a view: high, from the left, over the shoulder.
    pub(super) fn sun_for(view: &View, up: Vec3) -> Vec3 {
        let flat = |v: Vec3| (v - up * v.dot(up)).normalize_or(up.any_orthonormal_vector());
        (up * 1.5 - flat(view.right) * 0.8 - flat(view.forward) * 0.25).normalize()
    }

    /// The picture, and the distance along the view of what each pixel shows.
    pub(super) fn render(&self, view: &View) -> (Picture, Vec<f32>) {
        let [width, height] = view.size;
        let submerged = self
            .liquid
            .as_ref()
            .is_some_and(|liquid| liquid.holds(view.eye));
        let mut depths = vec![f32::INFINITY; width * height];
        let mut colours = vec![Vec3::ZERO; width * height];
        let rows = colours
            .par_chunks_mut(width)
            .zip(depths.par_chunks_mut(width))
            .enumerate();
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
                let sum: Vec3 = OFFSETS
                    .iter()
                    .map(|&(dx, dy)| clip(self.trace(view, submerged, x + dx, y + dy).0))
                    .sum();
                (pixel, sum / OFFSETS.len() as f32)
            })
            .collect();
        for (pixel, colour) in again {
            colours[pixel] = colour;
        }
        (Picture::from_linear(view.size, &colours), depths)
    }

    /// Colour and distance along the view of what is seen at a point of the picture; `submerged`: whether the eye is in liquid.
    fn trace(&self, view: &View, submerged: bool, x: f32, y: f32) -> (Vec3, f32) {
        let direction = view.direction(x, y);
        let meets = self.meets(view.eye, direction);
        let limit = meets.as_ref().map_or(f32::INFINITY, |meets| meets.t);
        // Where a body's side lies in a wall the liquid's mesh, which reaches a little into the body, lies in it too: the body is seen.
        let before = limit - SAME_PLANE * self.domain.length();
        let entry = self.liquid.as_ref().and_then(|liquid| {
            let entry = match submerged {
                true => Some(Entry {
                    t: 0.0,
                    normal: -direction,
                }),
                false => liquid.entry(view.eye, direction, before),
            };
            Some((liquid, entry?))
        });
        let Some((liquid, entry)) = entry else {
            return (
                self.colour(view.eye, direction, meets),
                view.depth(direction, limit),
            );
        };

        let at = view.eye + direction * entry.t;
        let normal = entry.normal;
        let cosine = -normal.dot(direction);
        let bent = refract(direction, normal, cosine);
        let meets = self.meets(at, bent);
        let limit = meets.as_ref().map_or(f32::INFINITY, |meets| meets.t);
        let depth_unit = self.domain.length();
        let length = liquid.length(at, bent, limit);
        let through = transmittance(length / depth_unit) * (1.0 - VEIL);
        let behind = self.colour(at, bent, meets);

        // Light scattered on the way: the sun's part has come through the liquid above, the sky's from all sides.
        let inside = at + bent * (0.25 * length).min(0.04 * depth_unit);
        let above = liquid.length(inside, self.sun, f32::INFINITY);
        let facing = 0.35 + 0.65 * normal.dot(self.sun).max(0.0);
        let light = transmittance(above / depth_unit) * SUN * facing * 1.5
            + AMBIENT * (0.8 + 0.2 * normal.dot(self.up));
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

    /// Distance along the view of the floor at a pixel; infinite beside it.
    pub(super) fn floor_depth(&self, view: &View, x: usize, y: usize) -> f32 {
        let direction = view.direction(x as f32 + 0.5, y as f32 + 0.5);
        let distance = self.floor_distance(view.eye, direction);
        view.depth(direction, distance.unwrap_or(f32::INFINITY))
    }

    /// The nearest of obstacles, solids and floor on a ray.
    fn meets(&self, origin: Vec3, direction: Vec3) -> Option<Meeting> {
        let floor = self.floor_distance(origin, direction).map(|t| Meeting {
            t,
            surface: Seen::Floor,
        });
        let limit = floor.as_ref().map_or(f32::INFINITY, |floor| floor.t);
        let hit = self.body(origin, direction, limit);
        hit.map(|hit| Meeting {
            t: hit.t,
            surface: Seen::Body(hit),
        })
        .or(floor)
    }

    /// The nearest of obstacles and solids on a ray before `limit`.
    fn body(&self, origin: Vec3, direction: Vec3, limit: f32) -> Option<Hit> {
        let obstacle = self.obstacles.hit(origin, direction, limit);
        let limit = obstacle.as_ref().map_or(limit, |hit| hit.t);
        self.solids.hit(origin, direction, limit).or(obstacle)
    }

    /// Colour of what a ray meets.
    fn colour(&self, origin: Vec3, direction: Vec3, meets: Option<Meeting>) -> Vec3 {
        let Some(Meeting { t, surface }) = meets else {
            return self.sky(direction);
        };
        let at = origin + direction * t;
        match surface {
            Seen::Floor => self.floor(at, direction, t),
            Seen::Body(hit) => self.matt(at, &hit),
        }
    }

    /// Colour of a body.
    fn matt(&self, at: Vec3, hit: &Hit) -> Vec3 {
        let base = match hit.owner {
            // Light comes in through its walls.
            Owner::Container => {
                let facing = hit.normal.dot(self.sun);
                return CONTAINER * (AMBIENT + SUN * (0.35 + 0.25 * facing));
            }
            Owner::Solid(number) => self.looks[number].colour(&self.scale, hit, self.pixel * hit.t),
            Owner::Obstacle | Owner::Liquid(_) => OBSTACLE,
        };
        base * self.light(at, hit.normal)
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

    /// Light on a matt surface: of the sun, as far as bodies leave it in sight, and of the sky, less near bodies.
    fn light(&self, at: Vec3, normal: Vec3) -> Vec3 {
        let extent = self.domain.length();
        let start = at + normal * (1e-4 * extent);
        let facing = normal.dot(self.sun).max(0.0);
        let mut sun = Vec3::ZERO;
        let seen = if facing > 0.0 {
            self.sun_seen(start)
        } else {
            0.0
        };
        if seen > 0.0 {
            let liquid = self.liquid.as_ref();
            let length = liquid.map_or(0.0, |liquid| liquid.length(start, self.sun, f32::INFINITY));
            // Light goes round a liquid too, through its surface and off the floor: its shadow is blue and never black.
            let through = transmittance(0.8 * length / extent);
            sun = SUN * (seen * facing) * (SHADOW + (Vec3::ONE - SHADOW) * through);
        }
        sun + AMBIENT * ((0.75 + 0.25 * normal.dot(self.up)) * self.sky_seen(start, normal))
    }

    /// Whether a body is on a ray before `limit`.
    fn shaded(&self, start: Vec3, direction: Vec3, limit: f32) -> bool {
        self.obstacles.shades(start, direction, limit)
            || self.solids.shades(start, direction, limit)
    }

    /// Whether the ball around obstacles or that around solids, centre and radius, is where it may take light away.
    fn bodies_near(&self, may: impl Fn(Vec3, f32) -> bool) -> bool {
        let bounds = [&self.obstacles, &self.solids].map(Triangles::bounds);
        let mut balls = bounds.into_iter().flatten();
        balls.any(|[low, high]| may(0.5 * (low + high), 0.5 * low.distance(high)))
    }

    /// Share of the sun that bodies leave in sight.
    fn sun_seen(&self, start: Vec3) -> f32 {
        if !self.bodies_near(|centre, radius| {
            let along = (centre - start).dot(self.sun);
            let aside = (centre - start) - self.sun * along;
            along > -radius && aside.length() < radius + SUN_RADIUS * along.max(0.0)
        }) {
            return 1.0;
        }
        let (right, up) = self.sun.any_orthonormal_pair();
        let seen = ON_SUN.iter().filter(|(x, y)| {
            let direction = self.sun + (right * *x + up * *y) * SUN_RADIUS;
            !self.shaded(start, direction, f32::INFINITY)
        });
        seen.count() as f32 / ON_SUN.len() as f32
    }

    /// Share of the sky's light that bodies nearby leave.
    fn sky_seen(&self, start: Vec3, normal: Vec3) -> f32 {
        let reach = SKY_REACH * self.domain.length();
        if !self.bodies_near(|centre, radius| centre.distance(start) < radius + reach) {
            return 1.0;
        }
        let (right, up) = normal.any_orthonormal_pair();
        let taken = SKY.iter().filter(|local| {
            let direction = right * local.x + up * local.y + normal * local.z;
            self.shaded(start, direction, reach)
        });
        1.0 - SKY_TAKEN * taken.count() as f32 / SKY.len() as f32
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
