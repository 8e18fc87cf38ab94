//! Walls that are too thin for the grid.
//!
//! The distance to a body is known at the centres of cells. A flat wall has a centre inside wherever it is crossed if it is at least
//! dx (|n_x| + |n_y| + |n_z|) thick, n its normal: that is how far apart along n the planes are that bound a cell. A thinner one leaks.

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

/// A body with a wall that is thinner than the grid needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThinWall {
    /// Number of the body.
    pub body: usize,
    /// Thickness of the wall, cells.
    pub thickness: f64,
    /// Thickness from which on such a wall holds, cells: 1 along an axis, 1.73 along the diagonal of a cell.
    pub needed: f64,
}

/// Most triangles at which the thickness of a mesh is measured.
const SAMPLES: usize = 8192;

/// Rounding of a thickness, as a part of it.
const ROUNDING: f64 = 1e-6;

/// Widths within which a ball as wide as needed makes a thin place an edge, and no wall.
const EDGE_REACH: f64 = 2.0;

/// The same of a tip, which is narrow in all directions across: nothing leaks through it, and the few triangles of a coarse mesh make
/// it slender.
const TIP_REACH: f64 = 5.0;

/// Widths across below which a thin place is narrow.
const NARROW: f64 = 2.0;

/// Places on the way out at which the search for such a ball starts again, as parts of the way. Rough surfaces end a climb early.
const STARTS: [f64; 3] = [0.25, 0.5, 0.75];

/// Largest turn between two poses at which a moving wall is looked at, rad.
const TURN: f64 = 0.05;

/// Most poses between two keyframes.
const MAX_POSES: usize = 256;

/// A thickness and the one that is needed, m.
type Wall = [f64; 2];

fn ratio([thickness, needed]: &Wall) -> f64 {
    thickness / needed
}

/// The obstacles with walls that leak, in the order of the scene. Containers have no thickness.
///
/// # Errors
/// [`Error::Input`] when a mesh file cannot be used.
pub fn thin_obstacles(scene: &Scene, grid: &Grid) -> Result<Vec<ThinWall>, Error> {
    let mut thin = Vec::new();
    for (number, body) in bodies(scene, grid).enumerate() {
        let turns = turns(&scene.obstacles[number], scene.time.duration);
        let wall = thinnest_of(&body?, &turns, grid.dx);
        thin.extend(thin_wall(number, wall, grid.dx));
    }
    Ok(thin)
}

/// The solids with walls that leak, as they lie at the start.
pub fn thin_solids(mesh: &MovedMesh, grid: &Grid) -> Vec<ThinWall> {
    let needed = |normal: DVec3| grid.dx * one_norm(normal);
    let closed = mesh.closed_bodies().into_iter().enumerate();
    closed
        .filter_map(|(number, body)| thin_wall(number, body.thinnest_wall(needed), grid.dx))
        .collect()
}

fn thin_wall(body: usize, wall: Option<Wall>, dx: f64) -> Option<ThinWall> {
    let wall = wall.filter(|wall| ratio(wall) < 1.0 - ROUNDING)?;
    let [thickness, needed] = wall.map(|part| part / dx);
    Some(ThinWall {
        body,
        thickness,
        needed,
    })
}

fn one_norm(x: DVec3) -> f64 {
    x.abs().element_sum()
}

/// The turns of an obstacle on its way, up to a time (s); one without a motion.
fn turns(obstacle: &Obstacle, end: f64) -> Vec<DMat3> {
    let mut turns = vec![DMat3::IDENTITY];
    let Some(motion) = &obstacle.motion else {
        return turns;
    };
    let turn = |time: f64| Keyframe::pose(&motion.keyframes, time).0;
    for pair in motion.keyframes.windows(2) {
        let [from, to] = [pair[0].time.min(end), pair[1].time.min(end)];
        let angle = (turn(to) - turn(from)).length();
        let n = ((angle / TURN).ceil() as usize).min(MAX_POSES);
        let times = (0..=n).map(|i| from + (to - from) * i as f64 / n.max(1) as f64);
        turns.extend(times.map(|time| DMat3::from_quat(DQuat::from_scaled_axis(turn(time)))));
    }
    turns
}

/// The wall of a body, turned in each of these ways, that has the smallest part of the thickness that it needs.
fn thinnest_of(body: &Body, turns: &[DMat3], dx: f64) -> Option<Wall> {
    let placement = body.placement();
    let most = |value: &dyn Fn(&DMat3) -> f64| turns.iter().map(value).fold(0.0, f64::max);
    let flat = |normal: DVec3| dx * most(&|turn| one_norm(*turn * normal));
    // The largest |n|_1 of the unit vectors n across an axis: that of the projection of a vector of signs.
    let round = |axis: DVec3| {
        let widest = |turn: &DMat3| {
            let axis = *turn * axis;
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
            axes.map(|(axis, side)| [scale * side, flat(placement.rotate * axis)])
                .collect()
        }
        Solid::Sphere { radius, .. } => vec![[scale * 2.0 * radius, 3.0_f64.sqrt() * dx]],
        Solid::Cylinder {
            axis,
            radius,
            heights: [low, high],
            ..
        } => {
            let axis = placement.rotate * *axis;
            vec![
                [scale * (high - low), flat(axis)],
                [scale * 2.0 * radius, round(axis)],
            ]
        }
        Solid::HalfSpace { .. } | Solid::Wave { .. } | Solid::Solitary(_) => Vec::new(),
        Solid::Mesh(mesh) => mesh.thinnest_wall(flat).into_iter().collect(),
    };
    let thinner = |a: &Wall, b: &Wall| ratio(a).total_cmp(&ratio(b));
    walls.into_iter().min_by(thinner)
}

impl ClosedMesh {
    /// The wall with the smallest part of the thickness (m) that its normal needs, among those with less than that. The thickness is the
    /// way from the middle of a triangle straight through. Tips, edges and corners are no walls: a ball as wide as needed lies near.
    fn thinnest_wall(&self, needed: impl Fn(DVec3) -> f64 + Sync) -> Option<Wall> {
        let mesh = self.seen()?;
        let mut chords: Vec<(Wall, Chord)> = chords(mesh)
            .into_par_iter()
            .map(|chord| ([chord.length, needed(chord.normal)], chord))
            .filter(|(wall, _)| ratio(wall) < 1.0 - ROUNDING)
            .collect();
        chords.sort_by(|(a, _), (b, _)| ratio(a).total_cmp(&ratio(b)));
        let wall = |(wall, chord): &(Wall, Chord)| !self.holds_ball(chord, wall[1]);
        chords.into_iter().find(wall).map(|(wall, _)| wall)
    }

    /// Whether a ball of this width (m) lies in the mesh near the middle of a chord: at the end of a climb from there or from a place
    /// that is seen from there.
    fn holds_ball(&self, chord: &Chord, width: f64) -> bool {
        let (start, most) = (chord.middle, TIP_REACH * width);
        let (u, v) = chord.normal.any_orthonormal_pair();
        // A rod along the middle between two of them is longer than five times its thickness in both.
        let across = (0..16).map(|n| DVec2::from_angle(f64::from(n) * PI / 16.0));
        let across = across.map(|way| way.x * u + way.y * v);
        let widths = across.map(|way| {
            let [there, back] = [way, -way].map(|way| self.way_out(start, way, most));
            there + back
        });
        let widths: Vec<f64> = widths.collect();
        let [low, high] = self.bounds();
        if widths.iter().all(|across| *across < width) && (high - low).max_element() > most {
            // A flap of a rough surface, smaller than a wall's thickness in every direction.
            return true;
        }
        let narrow = widths.iter().any(|across| *across < NARROW * width);
        let reach = if narrow { most } else { EDGE_REACH * width };
        let holds = |place: DVec3| self.climb_holds_ball(place, (start, reach), width);
        if holds(start) {
            return true;
        }
        let steps = || [-1.0, 0.0, 1.0].into_iter();
        let ways = steps()
            .flat_map(|z| steps().flat_map(move |y| steps().map(move |x| DVec3::new(x, y, z))));
        let places = ways.filter_map(DVec3::try_normalize).flat_map(|way| {
            let free = self.way_out(start, way, reach);
            STARTS.map(|part| start + part * free * way)
        });
        let places: Vec<DVec3> = places.collect();
        places.into_par_iter().any(holds)
    }

    /// Whether a ball of this width (m) is met on the way from a place of the mesh away from the nearest place of its surface, within
    /// a reach (m) of `start`.
    fn climb_holds_ball(&self, place: DVec3, (start, reach): (DVec3, f64), width: f64) -> bool {
        let radius = 0.5 * width;
        let (mut x, mut best, mut last) = (place, 0.0, 0.0);
        for round in 1..=256 {
            let Some(nearest) = self.nearest_wall(x) else {
                return false;
            };
            let depth = x.distance(nearest);
            if depth >= (1.0 - ROUNDING) * radius {
                return true;
            }
            best = f64::max(best, depth);
            // Between parallel walls it gains nothing; towards the thick end of a wedge it gains all the way.
            if round % 16 == 0 {
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

    /// Length of the way (m) from a point inside to the surface, at most `most`.
    fn way_out(&self, start: DVec3, way: DVec3, most: f64) -> f64 {
        let ray = Ray::new(start, way);
        let hit = self
            .seen()
            .and_then(|mesh| mesh.cast_local_ray(&ray, most, false));
        hit.unwrap_or(most)
    }
}

/// A way straight through a mesh from the middle of a triangle.
struct Chord {
    /// m
    length: f64,
    /// Of the triangle, out of the mesh.
    normal: DVec3,
    /// m
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
        // From just below the triangle, so that it is not hit itself.
        let start = triangle.center() - 1e-9 * size * normal;
        let length = mesh.cast_local_ray(&Ray::new(start, -normal), size, false)?;
        let middle = start - 0.5 * length * normal;
        Some(Chord {
            length,
            normal,
            middle,
        })
    };
    triangles.filter_map(chord).collect()
}

/// Typical thickness (m) of a body, and how many layers of elements it has: the median way through, by the edge of the regular
/// tetrahedron with the mean volume of the elements.
pub fn layers_across(mesh: &TetMesh) -> Option<[f64; 2]> {
    let surface = ClosedMesh::new(mesh.nodes.clone(), mesh.surface());
    let mut lengths: Vec<f64> = chords(surface.seen()?).iter().map(|c| c.length).collect();
    lengths.sort_by(f64::total_cmp);
    let thickness = *lengths.get(lengths.len() / 2)?;
    let volume = mesh.volume() / mesh.elements.len() as f64;
    let edge = (72.0_f64.sqrt() * volume).cbrt();
    Some([thickness, thickness / edge])
}
