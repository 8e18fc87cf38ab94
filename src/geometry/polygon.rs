//! Triangulation of planar polygons, convex or concave, independent of the first corner.
//!
//! Polygons with more than four corners have a constrained Delaunay triangulation with exact predicates. Unlike ear clipping it
//! preserves corners in the middle of straight edges, which neighbouring polygons need.

use std::collections::HashMap;

use glam::DVec3;
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation, mitigate_underflow};

use super::mesh_file::Problem;
use super::surface::is_near;

/// Splits a polygon into triangles of the same orientation. Repeated successive corners count once. The error is the end of a
/// sentence about the polygon.
pub(super) fn triangulate(vertices: &[DVec3], polygon: &[u32]) -> Result<Vec<[u32; 3]>, &'static str> {
    let at = |vertex: u32| vertices[vertex as usize];
    let mut corners: Vec<u32> = Vec::with_capacity(polygon.len());
    for &vertex in polygon {
        if corners.last().is_none_or(|&last| at(last) != at(vertex)) {
            corners.push(vertex);
        }
    }
    while corners.len() > 1 && at(corners[0]) == at(corners[corners.len() - 1]) {
        corners.pop();
    }
    let n = corners.len();
    if n < 3 {
        return Err("has fewer than three different corners");
    }
    // Any triangles do for coordinates that are not finite: the check of the surface refuses them.
    if n == 3 || !corners.iter().all(|&vertex| is_near(at(vertex))) {
        let fan = corners[1..].windows(2);
        return Ok(fan.map(|pair| [corners[0], pair[0], pair[1]]).collect());
    }
    // From the lowest corner, so that rounding does not depend on the first corner of the file.
    let key = |corner: usize| [corner, corner + 1, corner + n - 1].map(|corner| at(corners[corner % n]).to_array());
    let first = (0..n).min_by(|&a, &b| key(a).partial_cmp(&key(b)).expect("finite numbers"));
    corners.rotate_left(first.unwrap_or(0));
    let origin = at(corners[0]);
    // Newell's normal: twice the area vector.
    let normal: DVec3 = (corners.windows(2)).map(|pair| (at(pair[0]) - origin).cross(at(pair[1]) - origin)).sum();
    let extent = (corners.iter()).map(|&vertex| at(vertex).distance_squared(origin)).fold(0.0, f64::max);
    if normal.length() <= 1e-14 * extent {
        return Err("has no area");
    }
    match *corners {
        [a, b, c, d] => quadrilateral(vertices, [a, b, c, d], normal),
        _ => constrained_delaunay(vertices, &corners, normal),
    }
}

/// The diagonal with the larger smaller triangle, areas projected along the normal.
fn quadrilateral(vertices: &[DVec3], [a, b, c, d]: [u32; 4], normal: DVec3) -> Result<Vec<[u32; 3]>, &'static str> {
    let area = |triangle: [u32; 3]| {
        let [a, b, c] = triangle.map(|vertex| vertices[vertex as usize]);
        (b - a).cross(c - a).dot(normal)
    };
    let smaller = |[one, other]: [[u32; 3]; 2]| area(one).min(area(other));
    let (ac, bd) = ([[a, b, c], [a, c, d]], [[b, c, d], [b, d, a]]);
    let best = if smaller(bd) > smaller(ac) { bd } else { ac };
    if smaller(best) <= 0.0 {
        return Err(CROSSES);
    }
    Ok(best.to_vec())
}

/// Polygons of a file, which may precede their vertices. `T` identifies a polygon in errors.
pub(super) struct Polygons<T> {
    corners: Vec<u32>,
    /// Last corner of each polygon.
    ends: Vec<(T, usize)>,
}

/// Reason why a polygon has no triangulation.
pub(super) enum Defect {
    /// A corner beyond the last vertex.
    NoVertex(u32),
    /// The end of a sentence about the polygon.
    Shape(&'static str),
}

impl<T> Polygons<T> {
    pub(super) fn new() -> Polygons<T> {
        Polygons { corners: Vec::new(), ends: Vec::new() }
    }

    pub(super) fn push_corner(&mut self, vertex: u32) {
        self.corners.push(vertex);
    }

    /// Ends a polygon after the corners pushed since the previous one.
    pub(super) fn end(&mut self, id: T) {
        self.ends.push((id, self.corners.len()));
    }

    /// The triangles of all polygons, in order.
    pub(super) fn triangles(
        self,
        vertices: &[DVec3],
        problem: impl Fn(T, Defect) -> Problem,
    ) -> Result<Vec<[u32; 3]>, Problem> {
        let mut triangles = Vec::new();
        let mut start = 0;
        for (id, end) in self.ends {
            let polygon = &self.corners[start..end];
            start = end;
            let mut corners = polygon.iter().copied();
            if let Some(vertex) = corners.find(|&vertex| vertex as usize >= vertices.len()) {
                return Err(problem(id, Defect::NoVertex(vertex)));
            }
            match triangulate(vertices, polygon) {
                Ok(parts) => triangles.extend(parts),
                Err(reason) => return Err(problem(id, Defect::Shape(reason))),
            }
        }
        Ok(triangles)
    }
}

const CROSSES: &str = "crosses or touches itself, seen along its normal";

/// Triangulates the projection along the dominant axis of the normal, which is free of rounding.
fn constrained_delaunay(vertices: &[DVec3], corners: &[u32], normal: DVec3) -> Result<Vec<[u32; 3]>, &'static str> {
    let axis = normal.abs().max_position();
    let mut plane = ConstrainedDelaunayTriangulation::<Point2<f64>>::new();
    // Corners by their vertex in the plane. Bridges to holes visit a point twice.
    let mut numbers = HashMap::new();
    let mut points = Vec::with_capacity(corners.len());
    for &corner in corners {
        let x = vertices[corner as usize];
        let point = Point2::new(x[(axis + 1) % 3], x[(axis + 2) % 3]);
        let point = plane.insert(mitigate_underflow(point));
        let point = point.map_err(|_| CROSSES)?;
        numbers.entry(point).or_insert(corner);
        points.push(point);
    }
    // Number of passes of each edge; two for a bridge to a hole.
    let mut passes: HashMap<_, u32> = HashMap::new();
    for (number, &from) in points.iter().enumerate() {
        let to = points[(number + 1) % points.len()];
        if from == to || !plane.can_add_constraint(from, to) {
            return Err(CROSSES);
        }
        plane.add_constraint(from, to);
        // Absent if another corner splits the edge.
        let edge = (plane.get_edge_from_neighbors(from, to)).ok_or(CROSSES)?;
        *passes.entry(edge.fix().as_undirected()).or_default() += 1;
    }
    // Flood fill from outside: an edge with an odd number of passes separates inside and outside.
    let mut inside: Vec<Option<bool>> = vec![None; plane.num_all_faces()];
    inside[plane.outer_face().fix().index()] = Some(false);
    let mut stack: Vec<_> =
        (plane.convex_hull()).map(|edge| if edge.is_outer_edge() { edge } else { edge.rev() }).collect();
    while let Some(edge) = stack.pop() {
        let here = inside[edge.face().fix().index()].expect("edges of faces that were reached");
        let face = edge.rev().face();
        let Some(inner) = face.as_inner().filter(|face| inside[face.fix().index()].is_none()) else {
            continue;
        };
        let odd = passes.get(&edge.fix().as_undirected()).is_some_and(|n| n % 2 == 1);
        inside[inner.fix().index()] = Some(here != odd);
        stack.extend(inner.adjacent_edges());
    }
    let mirrored = normal[axis] < 0.0;
    let triangles: Vec<[u32; 3]> = (plane.inner_faces())
        .filter(|face| inside[face.fix().index()] == Some(true))
        .map(|face| {
            let [a, b, c] = face.vertices().map(|point| numbers[&point.fix()]);
            if mirrored { [a, c, b] } else { [a, b, c] }
        })
        .collect();
    if triangles.len() != corners.len() - 2 {
        return Err(CROSSES);
    }
    Ok(triangles)
}
