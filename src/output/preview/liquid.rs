//! The liquid of a picture: ray intersections with its surface mesh.

use glam::Vec3;

use super::triangles::{Owner, Triangle, Triangles};
use crate::output::surface::{LiquidSurface, in_wall};

pub(super) struct Liquid {
    triangles: Triangles,
    /// Normals at the corners of each triangle, out of the liquid.
    normals: Vec<[Vec3; 3]>,
}

/// First entry of a ray into the liquid.
pub(super) struct Entry {
    /// Distance along the ray, m.
    pub(super) t: f32,
    /// Unit normal, out of the liquid.
    pub(super) normal: Vec3,
}

impl Liquid {
    /// The liquid with this surface in a domain of this size (m); `None` without triangles.
    pub(super) fn new(surface: &LiquidSurface, size: Vec3) -> Option<Liquid> {
        let corners = |corners: &[u32; 3]| corners.map(|corner| surface.vertices[corner as usize]);
        let triangles = (0..).zip(&surface.triangles);
        let triangles = triangles.map(|(number, of)| Triangle { corners: corners(of), owner: Owner::Liquid(number) });
        let normals = surface.triangles.iter().map(|of| {
            let points = corners(of);
            match in_wall(points, size) {
                true => {
                    let [a, b, c] = points;
                    [(b - a).cross(c - a).normalize_or(Vec3::Y); 3]
                }
                false => of.map(|corner| surface.normals[corner as usize]),
            }
        });
        (!surface.triangles.is_empty())
            .then(|| Liquid { normals: normals.collect(), triangles: Triangles::new(triangles.collect()) })
    }

    /// The first entry of a ray from air before `limit`.
    pub(super) fn entry(&self, origin: Vec3, direction: Vec3, limit: f32) -> Option<Entry> {
        let hit = self.triangles.hit(origin, direction, limit)?;
        let Owner::Liquid(number) = hit.owner else {
            return None;
        };
        let [a, b, c] = self.normals[number];
        let [wa, wb, wc] = hit.weights;
        let normal = (a * wa + b * wb + c * wc).normalize_or(hit.normal);
        // The interpolated normal may turn away from the ray before its triangle does.
        let normal = match normal.dot(direction) < -1e-3 {
            true => normal,
            false => hit.normal,
        };
        Some(Entry { t: hit.t, normal })
    }

    /// Whether a point is in the liquid.
    pub(super) fn contains(&self, x: Vec3) -> bool {
        let crossings = self.triangles.crossings(x, Vec3::new(0.0123, 1.0, 0.0321));
        crossings.first().is_some_and(|&(_, entering)| !entering)
    }

    /// Length of the ray in liquid before `limit`, m.
    pub(super) fn length(&self, origin: Vec3, direction: Vec3, limit: f32) -> f32 {
        let crossings = self.triangles.crossings(origin, direction);
        let begins_inside = crossings.first().is_some_and(|&(_, entering)| !entering);
        let (mut length, mut since) = (0.0, begins_inside.then_some(0.0));
        for (t, entering) in crossings {
            if t >= limit {
                break;
            }
            // A ray through a common edge enters or leaves twice.
            if !entering {
                length += since.take().map_or(0.0, |since| t - since);
            } else if since.is_none() {
                since = Some(t);
            }
        }
        match since {
            Some(since) if limit.is_finite() => length + (limit - since),
            _ => length,
        }
    }
}
