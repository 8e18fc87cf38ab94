//! Which points a shape holds.

use glam::DVec3;

use super::distance::Solid;
use crate::error::Error;
use crate::scene::Shape;

/// Points that lie on a surface by construction are off by the rounding of their coordinates, far below this part of the
/// extent of all points.
const TOLERANCE: f64 = 1e-9;

/// Whether each point (m) lies inside a shape or on it, within 1e-9 of the diagonal of the points' bounding box; reads the file
/// of a mesh.
pub fn inside(shape: &Shape, points: &[DVec3]) -> Result<Vec<bool>, Error> {
    let solid = Solid::new(shape)?;
    let none = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    let [low, high] = points
        .iter()
        .fold(none, |[low, high], &x| [low.min(x), high.max(x)]);
    let tolerance = TOLERANCE * high.distance(low);
    let distances = points.iter().map(|&x| solid.distance(x));
    Ok(distances.map(|distance| distance <= tolerance).collect())
}
