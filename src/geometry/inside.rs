//! Points inside a shape.

use glam::DVec3;

use super::distance::Solid;
use super::surface::bounds;
use crate::error::Error;
use crate::scene::Shape;

/// Distance of points on a surface, relative to the extent of all points: far above the rounding of coordinates.
const TOLERANCE: f64 = 1e-9;

/// Whether each point (m) lies inside a shape or on it, within 1e-9 of the diagonal of the points' bounding box.
pub fn inside(shape: &Shape, points: &[DVec3]) -> Result<Vec<bool>, Error> {
    let solid = Solid::new(shape)?;
    let [low, high] = bounds(points.iter().copied());
    let tolerance = TOLERANCE * high.distance(low);
    let distances = points.iter().map(|&x| solid.distance(x));
    Ok(distances.map(|distance| distance <= tolerance).collect())
}
