//! Contact candidates between surfaces of different bodies: nodes beside faces, and edges beside edges.
//!
//! A pair is a local minimum of the distance between the surfaces: a node has the nearest point of the other surface, two convex edges that
//! cross have theirs. The normal lies in the normal cones of both surfaces, to a slack. So a node beside the edge of a body that slides over it
//! has no pair. Edges between nearly coplanar faces have none of their own: nodes beside faces represent them.
//!
//! Continuous collision detection ([`contact_hits`]) finds the nodes that cross faces, and the edges that cross edges, in a motion along
//! straight lines: four points are coplanar at the roots of a cubic in time (Provot 1997).

use std::ops::Range;

use glam::DVec3;
use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::partitioning::{Bvh, BvhBuildStrategy};
use parry3d_f64::query::{PointQueryWithLocation, Ray, RayCast};
use parry3d_f64::shape::{TriMesh, TriMeshFlags};
use rayon::prelude::*;

/// Cosine between the normals of two faces above which their common edge counts as flat.
const FLAT: f64 = 0.99;
/// Part of an edge at its ends where its nodes stand for it.
const ENDS: f64 = 1e-3;
/// Squared sine of the angle below which edges count as parallel.
const PARALLEL: f64 = 1e-4;
/// Distance over reach below which the direction to the nearest point is that of the normal.
const NO_DIRECTION: f64 = 1e-9;
/// Halvings of an interval in the search for a root.
const BISECTIONS: u32 = 50;
/// Slack of the local minimum between edges: sine of an angle.
const SLACK: f64 = 1e-2;
/// The same for a node: below it flat edges at the node do not matter.
const NODE_SLACK: f64 = 0.15;
/// The same for a node beside the inside of a face: surfaces may be inclined to each other.
const FACE_SLACK: f64 = 0.5;
/// The same for a node inside the other body, which needs a pair.
const INSIDE_SLACK: f64 = 0.9;

/// Two points of different bodies that may touch.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactPair {
    /// Nodes and weights: 1 in all on the one body, -1 in all on the other. Ascending nodes; weights are not 0.
    pub points: Vec<(u32, f64)>,
    /// Unit normal from the second body to the first.
    pub normal: DVec3,
    /// Distance along the normal, m; negative where the bodies overlap.
    pub gap: f64,
}

/// An edge of a surface with its two faces.
#[derive(Clone, Copy, Debug)]
struct Edge {
    nodes: [u32; 2],
    /// Outward unit normals of the faces.
    normals: [DVec3; 2],
    /// Unit directions from the edge into the faces, along them.
    inwards: [DVec3; 2],
}

/// Nodes of a surface, ascending, each with its neighbours along the surface.
type Nodes = Vec<(u32, Vec<u32>)>;

/// Surface of a body.
struct Skin {
    mesh: TriMesh,
    /// Of the vertices of the mesh.
    nodes: Nodes,
    /// Convex edges.
    edges: Vec<Edge>,
    low: DVec3,
    high: DVec3,
}

impl Skin {
    /// `positions` of all nodes, m; `triangles` counter-clockwise from outside.
    fn new(positions: &[DVec3], triangles: &[[u32; 3]]) -> Option<Skin> {
        let nodes = nodes_of(triangles);
        let vertices: Vec<DVec3> = nodes.iter().map(|(node, _)| positions[*node as usize]).collect();
        let local = |node: u32| nodes.partition_point(|(other, _)| *other < node) as u32;
        let faces = triangles.iter().map(|triangle| triangle.map(local)).collect();
        let [low, high] = super::bounds(vertices.iter().copied());
        let mesh = TriMesh::with_flags(vertices, faces, TriMeshFlags::ORIENTED).ok()?;
        Some(Skin { mesh, edges: sharp_edges(positions, triangles), nodes, low, high })
    }

    /// Whether the box of some points is within `reach` (m) of the body's.
    fn is_near(&self, points: &[DVec3], reach: f64) -> bool {
        let [low, high] = super::bounds(points.iter().copied());
        low.cmple(self.high + reach).all() && high.cmpge(self.low - reach).all()
    }

    /// The pair of a node of another body and the nearest point of this surface within `reach` (m), unless neighbours of the node are nearer,
    /// or deeper inside.
    fn beside(&self, (node, neighbours): &(u32, Vec<u32>), positions: &[DVec3], reach: f64) -> Option<ContactPair> {
        let mesh = &self.mesh;
        let x = positions[*node as usize];
        let (nearest, (face, at)) = mesh.project_local_point_and_get_location_with_max_dist(x, false, reach)?;
        let weights = at.barycentric_coordinates()?;
        let sign = if nearest.is_inside { -1.0 } else { 1.0 };
        let (arm, distance) = (x - nearest.point, x.distance(nearest.point));
        let across = mesh.triangle(face).normal()?;
        let normal = match distance > NO_DIRECTION * reach {
            true => sign / distance * arm,
            false => across,
        };
        let slack = match nearest.is_inside {
            true => INSIDE_SLACK,
            false if normal.dot(across) >= FLAT => FACE_SLACK,
            false => NODE_SLACK,
        };
        let mut neighbours = neighbours.iter().map(|&other| positions[other as usize]);
        if !is_foremost(x, &mut neighbours, -normal, slack) {
            return None;
        }
        let corners = mesh.indices()[face as usize].map(|vertex| self.nodes[vertex as usize].0);
        let others = corners.into_iter().zip(weights.map(|weight| -weight));
        let points = others.chain([(*node, 1.0)]);
        Some(ContactPair::new(points, normal, sign * distance))
    }
}

/// Nodes of triangles.
fn nodes_of(triangles: &[[u32; 3]]) -> Nodes {
    let sides = triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)]);
    let mut sides: Vec<(u32, u32)> = sides.collect();
    sides.sort_unstable();
    sides.dedup();
    let of_node = sides.chunk_by(|a, b| a.0 == b.0);
    of_node.map(|sides| (sides[0].0, sides.iter().map(|side| side.1).collect())).collect()
}

/// Whether no neighbour of a node at x (m) along its surface lies farther in a direction, to a slack: the sine of an angle.
fn is_foremost(x: DVec3, mut neighbours: impl Iterator<Item = DVec3>, direction: DVec3, slack: f64) -> bool {
    neighbours.all(|other| direction.dot((other - x).normalize_or_zero()) <= slack)
}

impl ContactPair {
    fn new(points: impl Iterator<Item = (u32, f64)>, normal: DVec3, gap: f64) -> ContactPair {
        let mut points: Vec<_> = points.filter(|(_, weight)| *weight != 0.0).collect();
        points.sort_by_key(|(node, _)| *node);
        ContactPair { points, normal, gap }
    }

    fn key(&self) -> Vec<u32> {
        self.points.iter().map(|(node, _)| *node).collect()
    }
}

/// Whether two bodies of these numbers may touch.
pub type MayTouch<'a> = &'a dyn Fn(usize, usize) -> bool;

/// The pairs within `reach` (m) of all bodies that may touch, one per set of nodes, in the order of their nodes. `positions` of all nodes,
/// m; `bodies`: ranges of `triangles`.
pub fn contact_pairs(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    (bodies, may_touch): (&[Range<usize>], MayTouch),
    reach: f64,
) -> Vec<ContactPair> {
    let skins = bodies.iter().enumerate();
    let skins = skins.filter_map(|(number, body)| Some((number, Skin::new(positions, &triangles[body.clone()])?)));
    let skins: Vec<(usize, Skin)> = skins.collect();
    let mut pairs = Vec::new();
    for (number, skin) in &skins {
        for (other_number, other) in &skins {
            let apart = !other.is_near(&[skin.low, skin.high], reach);
            if other_number == number || apart || !may_touch(*number, *other_number) {
                continue;
            }
            let beside = |node: &(u32, Vec<u32>)| {
                let near = other.is_near(&[positions[node.0 as usize]], reach);
                near.then(|| other.beside(node, positions, reach))?
            };
            pairs.par_extend(skin.nodes.par_iter().filter_map(beside));
            if number < other_number {
                edge_pairs(positions, skin, other, reach, &mut pairs);
            }
        }
    }
    pairs.sort_by_cached_key(ContactPair::key);
    pairs.dedup_by_key(|pair| pair.key());
    pairs
}

/// The pairs of different bodies that meet in the motion of all nodes from `positions` along `ways` (both m) and end more than `depth` (m)
/// behind each other, in the order of their nodes. Gaps are those of the start, along the normals of the meeting. Other arguments as of
/// [`contact_pairs`].
pub fn contact_hits(
    positions: &[DVec3],
    ways: &[DVec3],
    triangles: &[[u32; 3]],
    (bodies, may_touch): (&[Range<usize>], MayTouch),
    depth: f64,
) -> Vec<ContactPair> {
    let ends: Vec<DVec3> = positions.iter().zip(ways).map(|(x, way)| x + way).collect();
    let motion = Motion { positions, ways, ends: &ends, depth };
    let swept: Vec<Swept> = (bodies.iter()).map(|body| Swept::new(&motion, &triangles[body.clone()])).collect();
    let mut hits = Vec::new();
    for (number, body) in swept.iter().enumerate() {
        for (other_number, other) in swept.iter().enumerate() {
            let apart = !meet(&body.bounds, &other.bounds);
            if other_number == number || apart || !may_touch(number, other_number) {
                continue;
            }
            let nodes = body.nodes.par_iter().map(|node| (node, motion.bounds(&[node.0])));
            let nodes = nodes.filter(|(_, bounds)| meet(bounds, &other.bounds));
            hits.par_extend(nodes.flat_map_iter(|(node, bounds)| {
                let faces = meeting(&other.face_tree, &bounds).into_iter();
                faces.filter_map(move |face| motion.node_hit(node, other.faces[face]))
            }));
            if number < other_number {
                hits.par_extend(body.edges.par_iter().flat_map_iter(|edge| {
                    let others = meeting(&other.edge_tree, &motion.bounds(&edge.nodes)).into_iter();
                    others.filter_map(move |at| motion.edge_hit(edge, &other.edges[at]))
                }));
            }
        }
    }
    hits.sort_by_cached_key(ContactPair::key);
    hits
}

/// A motion along straight lines.
#[derive(Clone, Copy)]
struct Motion<'a> {
    positions: &'a [DVec3],
    ways: &'a [DVec3],
    ends: &'a [DVec3],
    depth: f64,
}

/// A surface in a motion, with boxes that contain it.
struct Swept<'a> {
    nodes: Nodes,
    faces: &'a [[u32; 3]],
    /// Boxes of the faces.
    face_tree: Bvh,
    /// Convex edges.
    edges: Vec<Edge>,
    /// Boxes of these.
    edge_tree: Bvh,
    bounds: [DVec3; 2],
}

impl<'a> Swept<'a> {
    fn new(motion: &Motion, triangles: &'a [[u32; 3]]) -> Swept<'a> {
        let edges = sharp_edges(motion.positions, triangles);
        Swept {
            bounds: motion.bounds(triangles.as_flattened()),
            faces: triangles,
            face_tree: tree(triangles.iter().map(|face| motion.bounds(face))),
            edge_tree: tree(edges.iter().map(|edge| motion.bounds(&edge.nodes))),
            edges,
            nodes: nodes_of(triangles),
        }
    }
}

/// Tree of boxes.
fn tree(boxes: impl Iterator<Item = [DVec3; 2]>) -> Bvh {
    let boxes: Vec<Aabb> = boxes.map(|[low, high]| Aabb::new(low, high)).collect();
    Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes)
}

/// Numbers of the boxes of a tree that have a point in common with a box, ascending.
fn meeting(tree: &Bvh, [low, high]: &[DVec3; 2]) -> Vec<usize> {
    let wanted = Aabb::new(*low, *high);
    let mut found: Vec<usize> = tree.intersect_aabb(&wanted).map(|at| at as usize).collect();
    found.sort_unstable();
    found
}

/// Whether two boxes have a point in common.
fn meet(a: &[DVec3; 2], b: &[DVec3; 2]) -> bool {
    a[0].cmple(b[1]).all() && b[0].cmple(a[1]).all()
}

impl Motion<'_> {
    fn bounds(&self, nodes: &[u32]) -> [DVec3; 2] {
        let ends = nodes.iter().flat_map(|&node| [self.positions, self.ends].map(|points| points[node as usize]));
        super::bounds(ends)
    }

    /// Position at a part of the motion.
    fn at(&self, node: u32, part: f64) -> DVec3 {
        self.positions[node as usize] + part * self.ways[node as usize]
    }

    /// The first part of the motion at which a function, a cubic in it, is 0 and `here` agrees.
    fn first<T>(&self, cubic: impl Fn(f64) -> f64, here: impl Fn(f64) -> Option<T>) -> Option<T> {
        roots(cubic).into_iter().find_map(here)
    }

    /// A node that crosses a face from outside, no later than its neighbours.
    fn node_hit(&self, (node, neighbours): &(u32, Vec<u32>), face: [u32; 3]) -> Option<ContactPair> {
        let node = *node;
        let corners = |part: f64| face.map(|corner| self.at(corner, part));
        let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
        let volume = |part: f64| {
            let corners = corners(part);
            (self.at(node, part) - corners[0]).dot(normal(corners))
        };
        if volume(0.0) < 0.0 {
            return None;
        }
        self.first(volume, |part| {
            let [a, b, c] = corners(part);
            let x = self.at(node, part);
            let n = normal([a, b, c]);
            let area = n.length_squared();
            let weight = |a: DVec3, b: DVec3| (a - x).cross(b - x).dot(n) / area;
            let weights = [weight(b, c), weight(c, a), weight(a, b)];
            let inside = weights.iter().all(|weight| *weight >= -ENDS);
            let points = face.into_iter().zip(weights.map(|weight| -weight));
            let n = n / area.sqrt();
            let neighbours = neighbours.iter().map(|&other| self.at(other, part));
            let meets = area > 0.0 && inside && is_foremost(x, neighbours, -n, FACE_SLACK);
            meets.then(|| self.pair(points.chain([(node, 1.0)]), n)).flatten()
        })
    }

    /// Two edges that cross from outside.
    fn edge_hit(&self, one: &Edge, other: &Edge) -> Option<ContactPair> {
        let (a, b) = (one.nodes, other.nodes);
        let ends = |part: f64| [a, b].map(|edge| edge.map(|node| self.at(node, part)));
        let outwards = other.normals[0] + other.normals[1] - one.normals[0] - one.normals[1];
        let volume = |part: f64| {
            let [[a0, a1], [b0, b1]] = ends(part);
            (b0 - a0).dot((a1 - a0).cross(b1 - b0))
        };
        self.first(volume, |part| {
            let [[a0, a1], [b0, b1]] = ends(part);
            let (u, v, w) = (a1 - a0, b1 - b0, b0 - a0);
            let across = u.cross(v);
            let squared = across.length_squared();
            if squared <= PARALLEL * u.length_squared() * v.length_squared() {
                return None;
            }
            let (s, t) = (w.cross(v).dot(across) / squared, w.cross(u).dot(across) / squared);
            let inside = ENDS..1.0 - ENDS;
            if !inside.contains(&s) || !inside.contains(&t) {
                return None;
            }
            let points = [(a[0], 1.0 - s), (a[1], s), (b[0], t - 1.0), (b[1], -t)];
            // The first edge leaves the side from which it came.
            let before: DVec3 = (points.iter()).map(|&(node, weight)| weight * self.positions[node as usize]).sum();
            let sign = if before.dot(across) >= 0.0 { 1.0 } else { -1.0 };
            let normal = sign / squared.sqrt() * across;
            (normal.dot(outwards) >= 0.0).then(|| self.pair(points.into_iter(), normal)).flatten()
        })
    }

    /// The pair, if the motion ends behind it.
    fn pair(&self, points: impl Iterator<Item = (u32, f64)>, normal: DVec3) -> Option<ContactPair> {
        let pair = ContactPair::new(points, normal, 0.0);
        let along = |of: &[DVec3]| -> f64 {
            let points = pair.points.iter();
            points.map(|&(node, weight)| weight * of[node as usize].dot(normal)).sum()
        };
        let [gap, end] = [along(self.positions), along(self.ends)];
        (end < -self.depth).then_some(ContactPair { gap, ..pair })
    }
}

/// The roots of a cubic in 0..=1, ascending, between its extrema.
fn roots(cubic: impl Fn(f64) -> f64) -> Vec<f64> {
    // a t^3 + b t^2 + c t + d from four values.
    let [d, f1, f2, f3] = [0.0, 1.0, 0.5, -1.0].map(&cubic);
    let b = 0.5 * (f1 + f3) - d;
    // a + c and a / 8 + c / 2.
    let (sum, half) = (f1 - d - b, f2 - d - 0.25 * b);
    let a = (half - 0.5 * sum) / (0.125 - 0.5);
    let c = sum - a;
    let value = |t: f64| ((a * t + b) * t + c) * t + d;
    let mut stops = vec![0.0];
    let discriminant = b * b - 3.0 * a * c;
    if discriminant >= 0.0 {
        // Stable where a is small.
        let q = -(b + b.signum() * discriminant.sqrt());
        let mut turns = [q / (3.0 * a), c / q];
        turns.sort_by(f64::total_cmp);
        stops.extend(turns.into_iter().filter(|t| *t > 0.0 && *t < 1.0));
    }
    stops.push(1.0);
    let brackets = stops.windows(2).filter_map(|pair| {
        let (mut low, mut high) = (pair[0], pair[1]);
        let rises = value(low) < 0.0;
        if (value(high) < 0.0) == rises {
            return None;
        }
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            match (value(middle) < 0.0) == rises {
                true => low = middle,
                false => high = middle,
            }
        }
        Some(0.5 * (low + high))
    });
    brackets.collect()
}

/// Convex edges of a surface.
fn sharp_edges(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<Edge> {
    let at = |node: u32| positions[node as usize];
    let mut sides: Vec<([u32; 2], DVec3, DVec3)> = Vec::new();
    for triangle in triangles {
        let [a, b, c] = triangle.map(at);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        for side in 0..3 {
            let [from, to] = [triangle[side], triangle[(side + 1) % 3]];
            // Counter-clockwise, the face lies to the left of its sides.
            let inwards = normal.cross(at(to) - at(from)).normalize_or_zero();
            sides.push(([from.min(to), from.max(to)], normal, inwards));
        }
    }
    sides.sort_by_key(|(nodes, ..)| *nodes);
    let edges = sides.chunk_by(|a, b| a.0 == b.0);
    edges
        .filter_map(|faces| match faces {
            [one, two] if one.1.dot(two.1) < FLAT && one.1.dot(two.2) < 0.0 => {
                Some(Edge { nodes: one.0, normals: [one.1, two.1], inwards: [one.2, two.2] })
            }
            _ => None,
        })
        .collect()
}

/// Adds the pairs of edges of two bodies.
fn edge_pairs(positions: &[DVec3], skin: &Skin, other: &Skin, reach: f64, pairs: &mut Vec<ContactPair>) {
    let ends = |edge: &Edge| edge.nodes.map(|node| positions[node as usize]);
    let near = |edges: &[Edge], body: &Skin| -> Vec<Edge> {
        let near = |edge: &&Edge| body.is_near(&ends(edge), reach);
        edges.iter().filter(near).copied().collect()
    };
    let [ours, theirs] = [near(&skin.edges, other), near(&other.edges, skin)];
    let found = ours.par_iter().flat_map_iter(|a| {
        let pair = |b: &Edge| edge_pair(ends, (skin, a), (other, b), reach);
        theirs.iter().filter_map(pair)
    });
    pairs.par_extend(found);
}

/// The pair of the nearest points of two edges, if they are inside the edges and the surfaces are not nearer beside them.
fn edge_pair(
    ends: impl Fn(&Edge) -> [DVec3; 2],
    (skin, a): (&Skin, &Edge),
    (other, b): (&Skin, &Edge),
    reach: f64,
) -> Option<ContactPair> {
    let ([a0, a1], [b0, b1]) = (ends(a), ends(b));
    let (u, v, w) = (a1 - a0, b1 - b0, a0 - b0);
    let apart = (a0.max(a1) + reach).cmplt(b0.min(b1)).any() || (b0.max(b1) + reach).cmplt(a0.min(a1)).any();
    let (uu, uv, vv) = (u.length_squared(), u.dot(v), v.length_squared());
    let determinant = uu * vv - uv * uv;
    if apart || determinant <= PARALLEL * uu * vv {
        return None;
    }
    let s = (uv * v.dot(w) - vv * u.dot(w)) / determinant;
    let t = (uu * v.dot(w) - uv * u.dot(w)) / determinant;
    let inside = ENDS..1.0 - ENDS;
    if !inside.contains(&s) || !inside.contains(&t) {
        return None;
    }
    let arm = (a0 + s * u) - (b0 + t * v);
    let distance = arm.length();
    if distance > reach {
        return None;
    }
    let outwards = b.normals[0] + b.normals[1] - a.normals[0] - a.normals[1];
    let direction = match distance > NO_DIRECTION * reach {
        true => arm / distance,
        false => {
            let across = u.cross(v).normalize();
            across * across.dot(outwards).signum()
        }
    };
    // Of bodies apart the arm leaves b and ends at a, of overlapping ones it leads back into both.
    let leaves = |edge: &Edge, way: DVec3| edge.inwards.iter().all(|inwards| way.dot(*inwards) <= SLACK);
    let sign = if direction.dot(outwards) >= 0.0 { 1.0 } else { -1.0 };
    let normal = sign * direction;
    if !leaves(b, normal) || !leaves(a, -normal) {
        return None;
    }
    // Edges of slim bodies may face away from each other: of bodies that overlap here, each edge goes through the other's surface.
    let pierces = |from: DVec3, way: DVec3, body: &Skin| body.mesh.intersects_local_ray(&Ray::new(from, way), 1.0);
    if sign < 0.0 && !(pierces(a0, u, other) && pierces(b0, v, skin)) {
        return None;
    }
    let points = [(a.nodes[0], 1.0 - s), (a.nodes[1], s), (b.nodes[0], t - 1.0), (b.nodes[1], -t)];
    Some(ContactPair::new(points.into_iter(), normal, sign * distance))
}
