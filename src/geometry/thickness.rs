//! Detection of walls too thin for the grid.
//!
//! Distances to bodies are known at cell centres. The extent of a cell along a unit vector n is dx (|n_x| + |n_y| + |n_z|). A
//! flat wall with normal n and at least this thickness contains a centre wherever a grid line crosses it. Thinner walls leak.

use std::f64::consts::PI;

use glam::{DMat3, DQuat, DVec2, DVec3};
use parry3d_f64::query::{Ray, RayCast};
use parry3d_f64::shape::TriMesh;
use rayon::prelude::*;

use super::distance::{Body, ClosedMesh, Solid};
use super::{MovedMesh, TetMesh, bodies};
use crate::error::Error;
use crate::grid::Grid;
use crate::scene::{Keyframe, Obstacle, Scene};

/// A body with a wall too thin for the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThinWall {
    /// Number of the body.
    pub body: usize,
    /// Thickness of the wall, cells.
    pub thickness: f64,
    /// Least thickness without leaks, cells: 1 along an axis, 1.73 along the diagonal of a cell.
    pub needed: f64,
}

/// Most triangles of a mesh that are sampled.
const SAMPLES: usize = 8192;

/// Relative rounding of a thickness.
const ROUNDING: f64 = 1e-6;

/// Distance from a thin place, in required widths, within which a ball of the required width identifies an edge rather than a
/// wall.
const EDGE_REACH: f64 = 2.0;

/// The same distance for tips, which are narrow in all directions: nothing leaks through them, and the few triangles of coarse
/// meshes make them slender.
const TIP_REACH: f64 = 5.0;

/// Width, in required widths, below which a thin place is narrow.
const NARROW: f64 = 2.0;

/// Starting points of the ball search along a ray to the surface, as fractions of its length. Rough surfaces end a climb early.
const STARTS: [f64; 3] = [0.25, 0.5, 0.75];

/// Largest rotation between two tested poses of a moving wall, rad.
const MAX_ROTATION: f64 = 0.05;

/// Most poses between two keyframes.
const MAX_POSES: usize = 256;

/// Thickness and required thickness, m.
type Wall = [f64; 2];

fn ratio([thickness, needed]: &Wall) -> f64 {
    thickness / needed
}

/// Obstacles with leaking walls, in the order of the scene. Containers have no thickness.
pub fn thin_obstacles(scene: &Scene, grid: &Grid) -> Result<Vec<ThinWall>, Error> {
    let mut thin = Vec::new();
    for (number, body) in bodies(scene, grid).enumerate() {
        let rotations = rotations(&scene.obstacles[number], scene.time.duration);
        let wall = thinnest_of(&body?, &rotations, grid.dx);
        thin.extend(thin_wall(number, wall, grid.dx));
    }
    Ok(thin)
}

/// Solids with leaking walls in their initial positions.
pub fn thin_solids(mesh: &MovedMesh, grid: &Grid) -> Vec<ThinWall> {
    let needed = |normal: DVec3| grid.dx * one_norm(normal);
    let closed = mesh.closed_bodies().into_iter().enumerate();
    closed.filter_map(|(number, body)| thin_wall(number, body.thinnest_wall(needed), grid.dx)).collect()
}

fn thin_wall(body: usize, wall: Option<Wall>, dx: f64) -> Option<ThinWall> {
    let wall = wall.filter(|wall| ratio(wall) < 1.0 - ROUNDING)?;
    let [thickness, needed] = wall.map(|part| part / dx);
    Some(ThinWall { body, thickness, needed })
}

fn one_norm(x: DVec3) -> f64 {
    x.abs().element_sum()
}

/// Rotations of an obstacle up to a time (s).
fn rotations(obstacle: &Obstacle, end: f64) -> Vec<DMat3> {
    let mut rotations = vec![DMat3::IDENTITY];
    let Some(motion) = &obstacle.motion else {
        return rotations;
    };
    let rotation = |time: f64| Keyframe::pose(&motion.keyframes, time).0;
    for pair in motion.keyframes.windows(2) {
        let [from, to] = [pair[0].time.min(end), pair[1].time.min(end)];
        let angle = (rotation(to) - rotation(from)).length();
        let n = ((angle / MAX_ROTATION).ceil() as usize).min(MAX_POSES);
        let times = (0..=n).map(|i| from + (to - from) * i as f64 / n.max(1) as f64);
        rotations.extend(times.map(|time| DMat3::from_quat(DQuat::from_scaled_axis(rotation(time)))));
    }
    rotations
}

/// The wall of a body with the smallest ratio of thickness to required thickness, over all rotations.
fn thinnest_of(body: &Body, rotations: &[DMat3], dx: f64) -> Option<Wall> {
    let placement = body.placement();
    let most = |value: &dyn Fn(&DMat3) -> f64| rotations.iter().map(value).fold(0.0, f64::max);
    let flat = |normal: DVec3| dx * most(&|rotation| one_norm(*rotation * normal));
    // Largest |n|_1 of unit vectors n normal to an axis: that of the projection of a vector of signs.
    let round = |axis: DVec3| {
        let widest = |rotation: &DMat3| {
            let axis = *rotation * axis;
            let signs = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];
            let across = signs.map(|[y, z]| DVec3::new(1.0, y, z).reject_from_normalized(axis));
            across.into_iter().map(DVec3::length).fold(0.0, f64::max)
        };
        dx * most(&widest)
    };
    let scale = placement.scale;
    let walls = match body.solid() {
        _ if body.is_container() => Vec::new(),
        Solid::Box { min, max } => {
            let axes = DVec3::AXES.into_iter().zip((*max - *min).to_array());
            axes.map(|(axis, side)| [scale * side, flat(placement.rotate * axis)]).collect()
        }
        Solid::Sphere { radius, .. } => vec![[scale * 2.0 * radius, 3.0_f64.sqrt() * dx]],
        Solid::Cylinder { axis, radius, heights: [low, high], .. } => {
            let axis = placement.rotate * *axis;
            vec![[scale * (high - low), flat(axis)], [scale * 2.0 * radius, round(axis)]]
        }
        Solid::HalfSpace { .. } | Solid::Wave { .. } | Solid::Solitary(_) => Vec::new(),
        Solid::Mesh(mesh) => mesh.thinnest_wall(flat).into_iter().collect(),
    };
    let thinner = |a: &Wall, b: &Wall| ratio(a).total_cmp(&ratio(b));
    walls.into_iter().min_by(thinner)
}

impl ClosedMesh {
    /// The wall with the smallest ratio of thickness (m) to required thickness, if that is below 1.
    ///
    /// The thickness is the length of the chord along the normal from the centre of a triangle. Tips, edges and corners are
    /// no walls: a ball of the required width lies near them.
    fn thinnest_wall(&self, needed: impl Fn(DVec3) -> f64 + Sync) -> Option<Wall> {
        let mesh = self.free_triangles()?;
        let mut chords: Vec<(Wall, Chord)> = chords(mesh)
            .into_par_iter()
            .map(|chord| ([chord.length, needed(chord.normal)], chord))
            .filter(|(wall, _)| ratio(wall) < 1.0 - ROUNDING)
            .collect();
        chords.sort_by(|(a, _), (b, _)| ratio(a).total_cmp(&ratio(b)));
        let wall = |(wall, chord): &(Wall, Chord)| !self.contains_ball(chord, wall[1]);
        chords.into_iter().find(wall).map(|(wall, _)| wall)
    }

    /// Whether the mesh contains a ball of this width (m) near the centre of a chord: at the end of a climb from there, or
    /// from a point visible from there.
    fn contains_ball(&self, chord: &Chord, width: f64) -> bool {
        let (start, most) = (chord.middle, TIP_REACH * width);
        let (u, v) = chord.normal.any_orthonormal_pair();
        // A rod between two of these directions is longer than five times its thickness in both.
        let across = (0..16).map(|n| DVec2::from_angle(f64::from(n) * PI / 16.0));
        let across = across.map(|direction| direction.x * u + direction.y * v);
        let widths = across.map(|direction| {
            let rays = [direction, -direction];
            let [there, back] = rays.map(|direction| self.ray_length(start, direction, most));
            there + back
        });
        let widths: Vec<f64> = widths.collect();
        let [low, high] = self.bounds();
        if widths.iter().all(|across| *across < width) && (high - low).max_element() > most {
            // A flap of a rough surface, smaller than the wall's thickness in every direction.
            return true;
        }
        let narrow = widths.iter().any(|across| *across < NARROW * width);
        let reach = if narrow { most } else { EDGE_REACH * width };
        let reaches_ball = |x: DVec3| self.climb_reaches_ball(x, (start, reach), width);
        if reaches_ball(start) {
            return true;
        }
        let steps = || [-1.0, 0.0, 1.0].into_iter();
        let steps = steps().flat_map(|z| steps().flat_map(move |y| steps().map(move |x| DVec3::new(x, y, z))));
        let directions = steps.filter_map(DVec3::try_normalize);
        let starts = directions.flat_map(|direction| {
            let free = self.ray_length(start, direction, reach);
            STARTS.map(|part| start + part * free * direction)
        });
        let starts: Vec<DVec3> = starts.collect();
        starts.into_par_iter().any(reaches_ball)
    }

    /// Whether a climb away from the nearest surface point meets a ball of this width (m), within a distance (m) of
    /// `start`.
    fn climb_reaches_ball(&self, mut x: DVec3, (start, reach): (DVec3, f64), width: f64) -> bool {
        let radius = 0.5 * width;
        let (mut best, mut last) = (0.0, 0.0);
        for iteration in 1..=256 {
            let Some(nearest) = self.nearest_wall(x) else {
                return false;
            };
            let depth = x.distance(nearest);
            if depth >= (1.0 - ROUNDING) * radius {
                return true;
            }
            best = f64::max(best, depth);
            // Between parallel walls the depth stagnates; towards the thick end of a wedge it grows all the way.
            if iteration % 16 == 0 {
                if best < 1.05 * last {
                    return false;
                }
                last = best;
            }
            let step = f64::min(0.5 * depth, 0.2 * radius);
            x += step * (x - nearest).normalize_or_zero();
            if x.distance(start) > reach {
                return false;
            }
        }
        false
    }

    /// Distance from an inner point to the surface along a direction, m, at most `most`.
    fn ray_length(&self, start: DVec3, direction: DVec3, most: f64) -> f64 {
        let ray = Ray::new(start, direction);
        let hit = self.free_triangles().and_then(|mesh| mesh.cast_local_ray(&ray, most, false));
        hit.unwrap_or(most)
    }
}

/// A chord of a mesh along the normal from the centre of a triangle.
struct Chord {
    /// m
    length: f64,
    /// Outward normal of the triangle.
    normal: DVec3,
    /// Centre of the chord, m.
    middle: DVec3,
}

fn chords(mesh: &TriMesh) -> Vec<Chord> {
    let size = mesh.local_aabb().extents().length();
    let n = mesh.indices().len();
    let every = n.div_ceil(SAMPLES).max(1);
    let triangles = (0..n as u32).into_par_iter().step_by(every);
    let chord = |triangle: u32| {
        let triangle = mesh.triangle(triangle);
        let normal = triangle.scaled_normal().try_normalize()?;
        // From just below the triangle, so that the ray does not hit it.
        let start = triangle.center() - 1e-9 * size * normal;
        let length = mesh.cast_local_ray(&Ray::new(start, -normal), size, false)?;
        let middle = start - 0.5 * length * normal;
        Some(Chord { length, normal, middle })
    };
    triangles.filter_map(chord).collect()
}

/// Typical thickness of a body, m, and its number of element layers: the median chord, divided by the edge of the regular
/// tetrahedron with the mean element volume.
pub fn layers_across(mesh: &TetMesh) -> Option<[f64; 2]> {
    let surface = ClosedMesh::new(mesh.nodes.clone(), mesh.surface());
    let mut lengths: Vec<f64> = chords(surface.free_triangles()?).iter().map(|c| c.length).collect();
    lengths.sort_by(f64::total_cmp);
    let thickness = *lengths.get(lengths.len() / 2)?;
    let volume = mesh.volume() / mesh.elements.len() as f64;
    let edge = (72.0_f64.sqrt() * volume).cbrt();
    Some([thickness, thickness / edge])
}
