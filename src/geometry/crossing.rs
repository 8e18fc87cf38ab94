//! Checks that a closed surface neither folds over nor crosses itself.
//!
//! The winding number of the surface is 0 outside and 1 inside a solid. Other values mean doubly enclosed or inverted regions,
//! in which volumes by the divergence theorem differ from sampled ones. Folds have no volume, but they break the sign of the
//! distance.

use std::collections::HashMap;

use glam::DVec3;
use parry3d_f64::partitioning::BvhNode;
use parry3d_f64::shape::TriMesh;

use super::surface::{Fault, Surface, edges};

/// Angle (rad) within which the normals of folded neighbours are opposite. Blades of solids are far blunter, and single
/// precision tilts coplanar triangles by less, down to a hundredth of the extent.
const FOLD: f64 = 1e-5;

/// Least height of a folded triangle and least depth of a crossing, relative to the extent. Meshers and single precision leave
/// smaller ones, which hardly change areas and distances.
const DEPTH: f64 = 1e-4;

/// Number of area-distributed sample points, and approximate number of sampled triangle centres, for the winding number.
const SAMPLES: usize = 2048;

/// The first two folded neighbours: triangles on each other with opposite normals. `users` are the triangles of each directed
/// edge.
pub(super) fn fold(surface: &Surface, users: &HashMap<[u32; 2], usize>) -> Option<Fault> {
    let [low, high] = surface.bounds();
    let least_height = DEPTH * low.distance(high);
    for (number, triangle) in surface.triangles.iter().enumerate() {
        for [from, to] in edges(triangle) {
            let other = users[&[to, from]];
            let [a, b] = [from, to].map(|vertex| surface.vertices[vertex as usize]);
            let normals = [number, other].map(|triangle| 2.0 * surface.area_vector(triangle));
            let is_flat = |normal: DVec3| normal.length() < least_height * a.distance(b);
            if other < number || normals.into_iter().any(is_flat) {
                continue;
            }
            let [one, two] = normals.map(DVec3::normalize);
            if one.dot(two) < 0.0 && one.cross(two).length() < FOLD {
                return Some(Fault {
                    problem: format!(
                        "the surface folds over itself: triangles {} and {} lie on each other at the edge from {a} to {b}",
                        number + 1,
                        other + 1
                    ),
                    cure: "cut concave polygons into triangles that lie in them, and remove inner or doubled faces, in a mesh tool",
                });
            }
        }
    }
    None
}

/// The first sample point whose outer side does not face the outside.
pub(super) fn crossing(surface: &Surface) -> Option<Fault> {
    let mesh = TriMesh::new(surface.vertices.clone(), surface.triangles.clone());
    let mesh = mesh.expect("a closed surface has triangles");
    let [low, high] = surface.bounds();
    let least_depth = DEPTH * low.distance(high);
    let mut samples = samples(surface).into_iter();
    let crossed = samples.find(|&(triangle, x)| {
        let hits = hits(&mesh, surface, triangle, x);
        let around: i32 = hits.iter().filter(|(t, _)| *t > 0.0).map(|(_, sign)| sign).sum();
        around != 0 && hits.iter().all(|(t, _)| t.abs() > least_depth)
    });
    crossed.map(|(triangle, x)| Fault {
        problem: format!(
            "the surface crosses itself: at {x} the outer side of triangle {} lies inside, or the part around it is inside out",
            triangle + 1
        ),
        cure: "remove the crossing in a mesh tool (boolean union, or remesh), and make the normals consistent",
    })
}

fn samples(surface: &Surface) -> Vec<(usize, DVec3)> {
    let n = surface.triangles.len();
    let middle = |triangle: usize| {
        let [a, b, c] = surface.corners(triangle);
        (triangle, (a + b + c) / 3.0)
    };
    let mut samples: Vec<_> = (0..n).step_by(n.div_ceil(SAMPLES)).map(middle).collect();
    let step = surface.area() / SAMPLES as f64;
    let mut area = 0.0;
    for triangle in 0..n {
        let [a, b, c] = surface.corners(triangle);
        area += surface.area_vector(triangle).length();
        while samples.len() < SAMPLES * 2 && area > step {
            area -= step;
            // Low-discrepancy sequence in the square, folded into the triangle (Roberts 2018).
            let k = samples.len() as f64;
            let [u, v] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_2].map(|ratio| (k * ratio).fract());
            let [u, v] = if u + v > 1.0 { [1.0 - u, 1.0 - v] } else { [u, v] };
            samples.push((triangle, a + u * (b - a) + v * (c - a)));
        }
    }
    samples
}

/// Other triangles on the line through a point of a triangle: approximate signed distance along its normal, and 1 for an exit,
/// -1 for an entry.
fn hits(mesh: &TriMesh, surface: &Surface, triangle: usize, x: DVec3) -> Vec<(f64, i32)> {
    let normal = surface.area_vector(triangle).normalize();
    // Oblique, so that lines miss the edges of regular meshes; the next tilt if one hits an edge.
    let tilts = [[0.131, 0.223], [-0.197, 0.103], [0.071, -0.241], [-0.113, -0.167]];
    let (u, v) = normal.any_orthonormal_pair();
    let lines = tilts.map(|[along_u, along_v]| (normal + along_u * u + along_v * v).normalize());
    let hits = lines.iter().find_map(|&direction| line_hits(mesh, surface, triangle, x, direction));
    hits.unwrap_or_default()
}

/// Hits along a unit direction; `None` if the line meets an edge. The deciding areas are equal and opposite for both triangles
/// at an edge (Woop, Benthin and Wald 2013), so no line slips between them.
fn line_hits(
    mesh: &TriMesh,
    surface: &Surface,
    triangle: usize,
    x: DVec3,
    direction: DVec3,
) -> Option<Vec<(f64, i32)>> {
    let (u, v) = direction.any_orthonormal_pair();
    let mut hits = Vec::new();
    let near = |node: &BvhNode| meets(node.mins() - x, node.maxs() - x, direction);
    for leaf in mesh.bvh().leaves(near) {
        let other = leaf as usize;
        if other == triangle {
            continue;
        }
        let corners = surface.corners(other).map(|corner| corner - x);
        let [a, b, c] = corners.map(|corner| [corner.dot(u), corner.dot(v)]);
        let cross = |p: [f64; 2], q: [f64; 2]| p[0] * q[1] - p[1] * q[0];
        // Twice the areas opposite to each corner, seen along the line.
        let areas = [cross(b, c), cross(c, a), cross(a, b)];
        if areas.contains(&0.0) && (areas.iter().all(|&area| area >= 0.0) || areas.iter().all(|&area| area <= 0.0)) {
            return None;
        }
        let sign = if areas.iter().all(|&area| area > 0.0) {
            1
        } else if areas.iter().all(|&area| area < 0.0) {
            -1
        } else {
            continue;
        };
        let weighted: f64 = (areas.iter().zip(corners)).map(|(area, corner)| area * corner.dot(direction)).sum();
        hits.push((weighted / areas.iter().sum::<f64>(), sign));
    }
    Some(hits)
}

/// Whether a line through the origin meets a box, with a margin above rounding.
fn meets(low: DVec3, high: DVec3, direction: DVec3) -> bool {
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    let half = half + 1e-12 * (low.abs().max(high.abs())).max_element();
    // The separating axes of a line and a box.
    let [m, h, d] = [middle, half, direction.abs()];
    let distance = m.cross(direction).abs();
    distance.x <= h.y * d.z + h.z * d.y && distance.y <= h.z * d.x + h.x * d.z && distance.z <= h.x * d.y + h.y * d.x
}
