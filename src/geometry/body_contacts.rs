//! Contact candidates between surfaces of different bodies, or of one: nodes beside faces, and edges beside edges.
//!
//! A pair is a local minimum of the distance between the surfaces: a node has the nearest point of the other surface, two convex edges that
//! cross have theirs. The normal lies in the normal cones of both surfaces, to a slack. So a node beside the edge of a body that slides over it
//! has no pair. Edges between nearly coplanar faces have none of their own: nodes beside faces represent them.
//!
//! Of one body, features that share a node or are joined by an edge of the surface are no pair: between them is one element, whose stiffness
//! keeps them apart. All others count, however near they are at rest. A feature deeper behind another than a part of an edge is on the other
//! side of the body, not in contact.
//!
//! Bodies may overlap deeper: the edges of crushed ones no longer meet these conditions. They have pairs of the deepest nodes inside each other, and
//! of the deepest points of edges.
//!
//! Continuous collision detection ([`contact_hits`]) finds the nodes that cross faces, and the edges that cross edges, in a motion along
//! straight lines: four points are coplanar at the roots of a cubic in time (Provot 1997). Two bodies without any have the pairs that
//! overlap more at the end than at the start.

use std::ops::Range;

use glam::DVec3;
use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::partitioning::{Bvh, BvhBuildStrategy};
use parry3d_f64::query::{PointQuery, PointQueryWithLocation, Ray, RayCast};
use parry3d_f64::shape::{TriMesh, TriMeshFlags, TrianglePointLocation};
use rayon::prelude::*;

/// Cosine between the normals of two faces above which their common edge is flat: 0.8 degrees, an overlap of 0.4 % of the edge.
const FLAT_EDGE: f64 = 0.9999;
/// Cosine between the normal of a face and the direction to a node above which the node is before the face, not beside its edge; and between the
/// normals of two faces above which a motion may make a concave edge convex.
const BEFORE: f64 = 0.99;
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
/// Intervals between the sample points of an edge.
const PARTS: u32 = 8;
/// Depth inside another body, over the length of an edge, that is not that of touching bodies.
const DEEP: f64 = 2e-3;
/// Direction in which faces are counted: along no edge of a regular mesh.
const OBLIQUE: DVec3 = DVec3::new(0.9129, 0.3719, 0.1685);
/// Part of an overlap by which it may grow in a motion: turning bodies change it by as much.
const OVERLAP_GROWTH: f64 = 1e-2;
/// Depth of following meetings of a body with itself over that of leading ones.
const LATER: f64 = 10.0;
/// Largest overlap of a body with itself, relative to its shortest edge.
const SELF_DEPTH: f64 = 1e-2;
/// Least cosine between the normal of a face and the direction to a node of the same body.
const FACING: f64 = 0.4;

/// Two points of surfaces that may touch.
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
    /// Nearly coplanar faces, or slightly concave ones: nodes beside them stand for it in all but a motion in which nothing else meets.
    flat: bool,
}

/// Nodes of a surface, ascending, each with its neighbours along the surface.
type Nodes = Vec<(u32, Vec<u32>)>;

/// Surface of a body.
struct Skin {
    mesh: TriMesh,
    /// Of the vertices of the mesh.
    nodes: Nodes,
    /// Convex and flat edges.
    edges: Vec<Edge>,
    edge_tree: Bvh,
    /// Largest overlap with itself, m.
    self_depth: f64,
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
        let edges = contact_edges(positions, triangles);
        let ends = |edge: &Edge| super::bounds(edge.nodes.iter().map(|&node| positions[node as usize]));
        let sides = nodes.iter().flat_map(|(node, others)| others.iter().map(|other| [*node, *other]));
        let lengths = sides.map(|side| side.map(|node| positions[node as usize])).map(|[a, b]| a.distance(b));
        let self_depth = SELF_DEPTH * lengths.fold(f64::INFINITY, f64::min);
        Some(Skin { mesh, edge_tree: tree(edges.iter().map(ends)), edges, nodes, self_depth, low, high })
    }

    /// Whether the box of some points is within `reach` (m) of the body's.
    fn is_near(&self, points: &[DVec3], reach: f64) -> bool {
        let [low, high] = super::bounds(points.iter().copied());
        low.cmple(self.high + reach).all() && high.cmpge(self.low - reach).all()
    }

    /// The pair of a node of another body and the nearest point of this surface, inside the body or within `reach` (m) of it, unless neighbours of
    /// the node are nearer, or deeper inside.
    fn beside(&self, (node, neighbours): &(u32, Vec<u32>), positions: &[DVec3], reach: f64) -> Option<ContactPair> {
        let mesh = &self.mesh;
        let x = positions[*node as usize];
        let most = if self.is_near(&[x], 0.0) { f64::MAX } else { reach };
        let (nearest, (face, at)) = mesh.project_local_point_and_get_location_with_max_dist(x, false, most)?;
        let (arm, distance) = (x - nearest.point, x.distance(nearest.point));
        if distance > reach && !(nearest.is_inside && self.contains(x)) {
            return None;
        }
        let sign = if nearest.is_inside { -1.0 } else { 1.0 };
        let across = mesh.triangle(face).normal()?;
        let normal = match distance > NO_DIRECTION * reach {
            true => sign / distance * arm,
            false => across,
        };
        let slack = match nearest.is_inside {
            true => INSIDE_SLACK,
            false if normal.dot(across) >= BEFORE => FACE_SLACK,
            false => NODE_SLACK,
        };
        // A deep node stands back only for neighbours that are deeper: others are behind the far side of this body.
        let counts = |&other: &DVec3| {
            let deep = nearest.is_inside && distance > DEEP * x.distance(other);
            let deeper = || {
                let to = mesh.project_local_point(other, false);
                to.is_inside && other.distance(to.point) > distance
            };
            !deep || deeper()
        };
        let neighbours = neighbours.iter().map(|&other| positions[other as usize]);
        if !is_foremost(x, neighbours.filter(counts), -normal, slack) {
            return None;
        }
        let points = self.face_points(face, at)?.chain([(*node, 1.0)]);
        Some(ContactPair::new(points, normal, sign * distance))
    }

    /// The nodes of a point of a face, weights negative.
    fn face_points(&self, face: u32, at: TrianglePointLocation) -> Option<impl Iterator<Item = (u32, f64)>> {
        let corners = self.mesh.indices()[face as usize].map(|vertex| self.nodes[vertex as usize].0);
        let weights = at.barycentric_coordinates()?;
        Some(corners.into_iter().zip(weights.map(|weight| -weight)))
    }

    /// Whether a point is inside, by the number of faces before it: the side of the nearest face may be wrong where faces are folded.
    fn contains(&self, x: DVec3) -> bool {
        let way = (self.high - self.low).length() * OBLIQUE;
        let [low, high] = super::bounds([x, x + way].into_iter());
        let ray = Ray::new(x, way);
        let around = Aabb::new(low, high);
        let faces = self.mesh.bvh().intersect_aabb(&around);
        faces.filter(|&face| self.mesh.triangle(face).intersects_local_ray(&ray, 1.0)).count() % 2 == 1
    }

    /// The pair of the deepest point of an edge of another body inside this one, if it is deeper than the ends of the edge.
    fn deep_inside(&self, edge: [u32; 2], positions: &[DVec3]) -> Option<ContactPair> {
        let [a, b] = edge.map(|node| positions[node as usize]);
        self.is_near(&[a, b], 0.0).then_some(())?;
        // Part of the edge, way to the surface, and place there.
        let inside = |part: u32| {
            let s = f64::from(part) / f64::from(PARTS);
            let x = a.lerp(b, s);
            let near = self.is_near(&[x], 0.0);
            let (nearest, at) = near.then(|| self.mesh.project_local_point_and_get_location(x, false))?;
            nearest.is_inside.then_some((s, nearest.point - x, at))
        };
        let ends = [0, PARTS].map(inside);
        if ends.iter().all(Option::is_none) {
            let [low, high] = super::bounds([a, b].into_iter());
            self.mesh.bvh().intersect_aabb(&Aabb::new(low, high)).next()?;
        }
        let between = (1..PARTS).filter_map(inside);
        let (s, arm, (face, at)) = between.max_by(|a, b| a.1.length().total_cmp(&b.1.length()))?;
        let of_ends = ends.iter().flatten().fold(0.0, |most, (_, arm, _)| f64::max(most, arm.length()));
        let deep = arm.length() > of_ends + DEEP * a.distance(b) && self.contains(a.lerp(b, s));
        let points = deep.then(|| self.face_points(face, at))??.chain([(edge[0], 1.0 - s), (edge[1], s)]);
        Some(ContactPair::new(points, arm.normalize(), -arm.length()))
    }

    /// The pair of a node and the nearest face of the same body before which it is, within `reach` (m), or behind which it is a little.
    fn beside_itself(
        &self,
        (node, neighbours): &(u32, Vec<u32>),
        positions: &[DVec3],
        reach: f64,
    ) -> Option<ContactPair> {
        let x = positions[*node as usize];
        let around = Aabb::from_half_extents(x, DVec3::splat(reach.max(self.self_depth)));
        let pair = |face: u32| {
            let corners = self.mesh.indices()[face as usize].map(|vertex| self.nodes[vertex as usize].0);
            if joined(&self.nodes, &[*node], &corners) {
                return None;
            }
            let triangle = self.mesh.triangle(face);
            let across = triangle.normal()?;
            let (nearest, at) = triangle.project_local_point_and_get_location(x, false);
            let weights = at.barycentric_coordinates()?;
            let arm = x - nearest.point;
            let gap = if arm.dot(across) < 0.0 { -arm.length() } else { arm.length() };
            let normal = if gap.abs() > NO_DIRECTION * reach { arm / gap } else { across };
            let faces = normal.dot(across);
            let slack = if faces >= BEFORE { FACE_SLACK } else { NODE_SLACK };
            let others = neighbours.iter().map(|&other| positions[other as usize]);
            let meets = gap >= -self.self_depth && gap <= reach && faces >= FACING;
            let points = corners.into_iter().zip(weights.map(|weight| -weight)).chain([(*node, 1.0)]);
            (meets && is_foremost(x, others, -normal, slack)).then(|| ContactPair::new(points, normal, gap))
        };
        let mut faces: Vec<u32> = self.mesh.bvh().intersect_aabb(&around).collect();
        faces.sort_unstable();
        let pairs = faces.into_iter().filter_map(pair);
        pairs.min_by(|a, b| a.gap.abs().total_cmp(&b.gap.abs()))
    }
}

/// Whether nodes of a surface are the same as others, or joined to them by an edge.
fn joined(nodes: &Nodes, some: &[u32], others: &[u32]) -> bool {
    some.iter().any(|one| {
        let (_, neighbours) = &nodes[nodes.partition_point(|(node, _)| node < one)];
        others.iter().any(|other| other == one || neighbours.binary_search(other).is_ok())
    })
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

/// Distance within which two bodies of these numbers, or one and itself, are pairs, m; `None` if they never touch.
pub type Reach<'a> = &'a dyn Fn(usize, usize) -> Option<f64>;

/// The pairs within reach of all bodies that may touch, one per set of nodes, in the order of their nodes. `positions` of all nodes, m;
/// `bodies`: ranges of `triangles`.
pub fn contact_pairs(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    bodies: &[Range<usize>],
    reach: Reach,
) -> Vec<ContactPair> {
    let bounds = |body: &Range<usize>| {
        let nodes = triangles[body.clone()].as_flattened().iter();
        super::bounds(nodes.map(|&node| positions[node as usize]))
    };
    let near = near_bodies(&bodies.iter().map(bounds).collect::<Vec<_>>(), reach);
    let skins = each_near(bodies, &near, |body| Skin::new(positions, &triangles[body]));
    let mut pairs = Vec::new();
    for (number, other_number, reach) in near {
        let (Some(skin), Some(other)) = (&skins[number], &skins[other_number]) else {
            continue;
        };
        let beside = |skin: &Skin, other: &Skin, pairs: &mut Vec<ContactPair>| {
            let beside = |node: &(u32, Vec<u32>)| {
                let near = other.is_near(&[positions[node.0 as usize]], reach);
                near.then(|| other.beside(node, positions, reach))?
            };
            pairs.par_extend(skin.nodes.par_iter().filter_map(beside));
            pairs.par_extend(skin.nodes.par_iter().flat_map_iter(|(node, neighbours)| {
                let edges = neighbours.iter().filter(move |end| node < *end).map(move |end| [*node, *end]);
                edges.filter_map(|edge| other.deep_inside(edge, positions))
            }));
        };
        if number == other_number {
            let beside = |node| skin.beside_itself(node, positions, reach);
            pairs.par_extend(skin.nodes.par_iter().filter_map(beside));
        } else {
            beside(skin, other, &mut pairs);
            beside(other, skin, &mut pairs);
        }
        edge_pairs(positions, skin, other, reach, &mut pairs);
    }
    pairs.sort_by_cached_key(ContactPair::key);
    pairs.dedup_by_key(|pair| pair.key());
    pairs
}

/// Numbers of bodies, the smaller first, whose boxes are within reach of each other, and the reach, m.
fn near_bodies(boxes: &[[DVec3; 2]], reach: Reach) -> Vec<(usize, usize, f64)> {
    let pairs = (0..boxes.len()).flat_map(|one| (one..boxes.len()).map(move |other| (one, other)));
    let near = pairs.filter_map(|(one, other)| {
        let reach = reach(one, other)?;
        let [low, high] = boxes[other];
        meet(&boxes[one], &[low - reach, high + reach]).then_some((one, other, reach))
    });
    near.collect()
}

/// Something per body that is near another or may touch itself; `None` elsewhere.
fn each_near<T>(
    bodies: &[Range<usize>],
    near: &[(usize, usize, f64)],
    of: impl Fn(Range<usize>) -> Option<T>,
) -> Vec<Option<T>> {
    let bodies = bodies.iter().enumerate().map(|(number, body)| {
        let needed = near.iter().any(|&(one, other, _)| one == number || other == number);
        needed.then(|| of(body.clone()))?
    });
    bodies.collect()
}

/// The pairs that meet in the motion of all nodes from `positions` along `ways` (both m) and end deep behind each other, in the order of their
/// nodes. Gaps are those of the start, along the normals of the meeting. `depth`: as a reach, the depth that counts; `overlap`: largest overlap at
/// the start that must not grow, m. Other arguments as of [`contact_pairs`].
pub fn contact_hits(
    positions: &[DVec3],
    ways: &[DVec3],
    triangles: &[[u32; 3]],
    (bodies, depth): (&[Range<usize>], Reach),
    overlap: f64,
) -> Vec<ContactPair> {
    let ends: Vec<DVec3> = positions.iter().zip(ways).map(|(x, way)| x + way).collect();
    let motion = Motion { positions, ways, ends: &ends, depth: 0.0, overlap, leading: true };
    let bounds = |body: &Range<usize>| motion.bounds(triangles[body.clone()].as_flattened());
    let near = near_bodies(&bodies.iter().map(bounds).collect::<Vec<_>>(), depth);
    let swept = each_near(bodies, &near, |body| Some(Swept::new(&motion, &triangles[body])));
    let (mut hits, mut apart, mut least) = (Vec::new(), Vec::new(), 0.0);
    for (number, other_number, depth) in near {
        let (Some(body), Some(other)) = (&swept[number], &swept[other_number]) else {
            continue;
        };
        let motion = Motion { depth, ..motion };
        if number == other_number {
            hits.extend(motion.own_hits(body));
            continue;
        }
        let found = motion.hits(body, other, 1.0);
        if found.is_empty() {
            apart.push((number, other_number));
            least = f64::max(least, depth);
        }
        hits.extend(found);
    }
    if !apart.is_empty() {
        let reach = |one, other| apart.contains(&(one, other)).then_some(least);
        hits.extend(motion.deeper(triangles, bodies, &reach, [least, OVERLAP_GROWTH]));
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
    /// Largest overlap at the start that must not grow, m.
    overlap: f64,
    /// Without nodes that follow others through a face, edges that face away from each other, and flat ones.
    leading: bool,
}

/// A surface in a motion, with boxes that contain it.
struct Swept<'a> {
    nodes: Nodes,
    faces: &'a [[u32; 3]],
    /// Boxes of the faces.
    face_tree: Bvh,
    /// Convex and flat edges.
    edges: Vec<Edge>,
    /// Boxes of these.
    edge_tree: Bvh,
    bounds: [DVec3; 2],
}

impl<'a> Swept<'a> {
    fn new(motion: &Motion, triangles: &'a [[u32; 3]]) -> Swept<'a> {
        let edges = contact_edges(motion.positions, triangles);
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

    /// Distance of a pair's points along its normal, m.
    fn gap(&self, pair: &ContactPair, of: &[DVec3]) -> f64 {
        let points = pair.points.iter();
        points.map(|&(node, weight)| weight * of[node as usize].dot(pair.normal)).sum()
    }

    /// The meetings of a body with itself, in the frame of its mean motion. Without any, the pairs that overlap more at the end: a motion that
    /// starts with an overlap, or turns the surfaces, has no other sign of it.
    fn own_hits(&self, body: &Swept) -> Vec<ContactPair> {
        let ways = body.nodes.iter().map(|(node, _)| self.ways[*node as usize]);
        let mean = ways.sum::<DVec3>() / body.nodes.len() as f64;
        let less = |of: &[DVec3]| -> Vec<DVec3> { of.iter().map(|x| x - mean).collect() };
        let relative = Motion { ways: &less(self.ways), ends: &less(self.ends), ..*self };
        let body = Swept::new(&relative, body.faces);
        let found = relative.hits(&body, &body, LATER);
        let whole = 0..body.faces.len();
        match found.is_empty() {
            true => relative.deeper(
                body.faces,
                std::slice::from_ref(&whole),
                &|_, _| Some(self.depth),
                [LATER * self.depth, 0.0],
            ),
            false => found,
        }
    }

    /// The pairs that overlap more at the end than at the start, by more than `least` (m) and a part of the overlap. Other arguments as of
    /// [`contact_pairs`].
    fn deeper(
        &self,
        triangles: &[[u32; 3]],
        bodies: &[Range<usize>],
        reach: Reach,
        [least, part]: [f64; 2],
    ) -> Vec<ContactPair> {
        let pairs = contact_pairs(self.ends, triangles, bodies, reach).into_iter();
        let deeper = pairs.filter_map(|pair| {
            let before = self.gap(&pair, self.positions);
            let overlap = before.min(0.0);
            (pair.gap < (1.0 + part) * overlap - least).then_some(ContactPair { gap: before, ..pair })
        });
        deeper.collect()
    }

    /// The meetings of two bodies, or of a body with itself. Where no leading ones are, nodes that follow others through a face and flat
    /// edges count too, each with what it meets first, if they end `later` times as deep.
    fn hits(&self, body: &Swept, other: &Swept, later: f64) -> Vec<ContactPair> {
        let following = Motion { leading: false, depth: later * self.depth, ..*self };
        let mut found = Vec::new();
        for motion in [*self, following] {
            if found.is_empty() {
                motion.node_hits(body, other, &mut found);
                if !std::ptr::eq(body, other) {
                    motion.node_hits(other, body, &mut found);
                }
                motion.edge_hits(body, other, &mut found);
            }
        }
        found
    }

    /// Of pairs with their parts of the motion: all leading ones, or the first.
    fn counting(&self, pairs: impl Iterator<Item = (f64, ContactPair)>) -> Vec<ContactPair> {
        match self.leading {
            true => pairs.map(|(_, pair)| pair).collect(),
            false => pairs.min_by(|a, b| a.0.total_cmp(&b.0)).into_iter().map(|(_, pair)| pair).collect(),
        }
    }

    /// Adds the nodes of a body that cross faces of another, or of itself.
    fn node_hits(&self, body: &Swept, other: &Swept, hits: &mut Vec<ContactPair>) {
        let same = std::ptr::eq(body, other);
        let nodes = body.nodes.par_iter().map(|node| (node, self.bounds(&[node.0])));
        let nodes = nodes.filter(|(_, bounds)| meet(bounds, &other.bounds));
        hits.par_extend(nodes.flat_map_iter(|(node, bounds)| {
            let faces = meeting(&other.face_tree, &bounds).into_iter().map(|face| other.faces[face]);
            let faces = faces.filter(|face| !(same && joined(&body.nodes, &[node.0], face)));
            self.counting(faces.filter_map(|face| self.node_hit(node, face)))
        }));
    }

    /// Adds the edges of a body that cross those of another, or of itself.
    fn edge_hits(&self, body: &Swept, other: &Swept, hits: &mut Vec<ContactPair>) {
        let same = std::ptr::eq(body, other);
        let counts = |edge: &&Edge| !(edge.flat && self.leading);
        hits.par_extend(body.edges.par_iter().filter(counts).flat_map_iter(|edge| {
            let others = meeting(&other.edge_tree, &self.bounds(&edge.nodes)).into_iter().map(|at| &other.edges[at]);
            // Of a body, each two once.
            let once = |against: &&Edge| {
                !same || edge.nodes < against.nodes && !joined(&body.nodes, &edge.nodes, &against.nodes)
            };
            self.counting(others.filter(counts).filter(once).filter_map(|against| self.edge_hit(edge, against)))
        }));
    }

    /// A node that crosses a face from outside, no later than its neighbours, with the part of the motion at which they meet.
    fn node_hit(&self, (node, neighbours): &(u32, Vec<u32>), face: [u32; 3]) -> Option<(f64, ContactPair)> {
        let node = *node;
        let corners = |part: f64| face.map(|corner| self.at(corner, part));
        let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
        let volume = |part: f64| {
            let corners = corners(part);
            (self.at(node, part) - corners[0]).dot(normal(corners))
        };
        meetings(volume).find_map(|part| {
            let [a, b, c] = corners(part);
            let x = self.at(node, part);
            let n = normal([a, b, c]);
            let area = n.length_squared();
            let weight = |a: DVec3, b: DVec3| (a - x).cross(b - x).dot(n) / area;
            let weights = [weight(b, c), weight(c, a), weight(a, b)];
            // What slides along a surface crosses faces of the other at their borders.
            let border = |side: DVec3| if self.leading { -ENDS } else { self.depth * side.length() / area.sqrt() };
            let inside = weights.iter().zip([c - b, a - c, b - a]).all(|(weight, side)| *weight >= border(side));
            let points = face.into_iter().zip(weights.map(|weight| -weight));
            let n = n / area.sqrt();
            let neighbours = neighbours.iter().map(|&other| self.at(other, part));
            let counts = !self.leading || is_foremost(x, neighbours, -n, FACE_SLACK);
            let meets = area > 0.0 && inside && counts;
            meets.then(|| Some((part, self.pair(points.chain([(node, 1.0)]), n, part)?))).flatten()
        })
    }

    /// Two edges that cross from outside, with the part of the motion at which they meet.
    fn edge_hit(&self, one: &Edge, other: &Edge) -> Option<(f64, ContactPair)> {
        let (a, b) = (one.nodes, other.nodes);
        let ends = |part: f64| [a, b].map(|edge| edge.map(|node| self.at(node, part)));
        let outwards = other.normals[0] + other.normals[1] - one.normals[0] - one.normals[1];
        let volume = |part: f64| {
            let [[a0, a1], [b0, b1]] = ends(part);
            (b0 - a0).dot((a1 - a0).cross(b1 - b0))
        };
        meetings(volume).find_map(|part| {
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
            let before: DVec3 = points.iter().map(|&(node, weight)| weight * self.positions[node as usize]).sum();
            // The first edge leaves the side from which it came, or on which it should be.
            let apart = before.dot(across).abs() > self.overlap * squared.sqrt();
            let side = if apart { before } else { outwards };
            let sign = if side.dot(across) >= 0.0 { 1.0 } else { -1.0 };
            let normal = sign / squared.sqrt() * across;
            // Of those that follow, edges whose faces turn away from the normal: others slide past each other.
            let leaves = |edge: &Edge, way: DVec3| edge.inwards.iter().all(|inwards| way.dot(*inwards) <= FACE_SLACK);
            let faces = match self.leading {
                true => normal.dot(outwards) >= 0.0,
                false => leaves(other, normal) && leaves(one, -normal),
            };
            faces.then(|| Some((part, self.pair(points.into_iter(), normal, part)?))).flatten()
        })
    }

    /// The pair, if its points start apart, or little behind each other, and end deeper.
    fn pair(&self, points: impl Iterator<Item = (u32, f64)>, normal: DVec3, part: f64) -> Option<ContactPair> {
        let pair = ContactPair::new(points, normal, 0.0);
        let [gap, end] = [self.positions, self.ends].map(|of| self.gap(&pair, of));
        let starts = gap >= -self.overlap && (part > 0.0 || gap <= self.overlap);
        (starts && end < gap.min(0.0) - self.depth).then_some(ContactPair { gap, ..pair })
    }
}

/// The parts of a motion at which points may meet: its start, where they may be behind each other, and the roots of a cubic.
fn meetings(cubic: impl Fn(f64) -> f64) -> impl Iterator<Item = f64> {
    [0.0].into_iter().chain(roots(cubic))
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

/// Edges of a surface that are not concave by more than BEFORE.
fn contact_edges(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<Edge> {
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
            [one, two] if one.1.dot(two.1) >= BEFORE || one.1.dot(two.2) < 0.0 => {
                let flat = one.1.dot(two.1) >= FLAT_EDGE || one.1.dot(two.2) >= 0.0;
                Some(Edge { nodes: one.0, normals: [one.1, two.1], inwards: [one.2, two.2], flat })
            }
            _ => None,
        })
        .collect()
}

/// Adds the pairs of edges of two bodies, or of one.
fn edge_pairs(positions: &[DVec3], skin: &Skin, other: &Skin, reach: f64, pairs: &mut Vec<ContactPair>) {
    let same = std::ptr::eq(skin, other);
    let ends = |edge: &Edge| edge.nodes.map(|node| positions[node as usize]);
    let sharp = |edge: &&Edge| !edge.flat;
    let found = skin.edges.par_iter().filter(sharp).flat_map_iter(|a| {
        let [low, high] = super::bounds(ends(a).into_iter());
        let near = meeting(&other.edge_tree, &[low - reach, high + reach]).into_iter().map(|at| &other.edges[at]);
        // Of a body, each two once.
        let once = move |b: &&Edge| !same || a.nodes < b.nodes && !joined(&skin.nodes, &a.nodes, &b.nodes);
        near.filter(sharp).filter(once).filter_map(move |b| edge_pair(ends, (skin, a), (other, b), reach))
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
    let apart = match std::ptr::eq(skin, other) {
        true => distance > skin.self_depth,
        false => !(pierces(a0, u, other) && pierces(b0, v, skin)),
    };
    if sign < 0.0 && apart {
        return None;
    }
    let points = [(a.nodes[0], 1.0 - s), (a.nodes[1], s), (b.nodes[0], t - 1.0), (b.nodes[1], -t)];
    Some(ContactPair::new(points.into_iter(), normal, sign * distance))
}
