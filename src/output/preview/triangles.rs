//! Ray intersections with triangles: a bounding volume hierarchy with median splits, and the Moeller-Trumbore test (1997).
//!
//! The order of the hierarchy selects among equally distant triangles; it depends on the triangles alone.

use glam::Vec3;

const LEAF: usize = 4;

/// Body of a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Owner {
    /// An obstacle, visible from outside.
    Obstacle,
    /// A container, visible from inside and translucent.
    Container,
    /// A separated cell, visible from outside.
    Separated,
    /// An elastic solid with its triangle number, visible from both sides, since it may be inverted.
    Solid(usize),
    /// The liquid with its triangle number, visible from outside.
    Liquid(usize),
}

/// A triangle of a body.
#[derive(Clone, Copy, Debug)]
pub(super) struct Triangle {
    /// Corners, m, counter-clockwise seen from the liquid or the air.
    pub(super) corners: [Vec3; 3],
    pub(super) owner: Owner,
}

pub(super) struct Hit {
    /// Distance along the ray, m.
    pub(super) t: f32,
    /// Unit normal towards the origin of the ray.
    pub(super) normal: Vec3,
    pub(super) owner: Owner,
    pub(super) corners: [Vec3; 3],
    pub(super) weights: [f32; 3],
}

/// The half space normal . x > offset.
#[derive(Clone, Copy, Debug)]
pub(super) struct HalfSpace {
    pub(super) normal: Vec3,
    /// m
    pub(super) offset: f32,
}

impl HalfSpace {
    fn contains(&self, x: Vec3) -> bool {
        self.normal.dot(x) > self.offset
    }
}

/// Triangles in a bounding volume hierarchy.
pub(super) struct Triangles {
    /// Invisible part of space, without shadows.
    cut: Option<HalfSpace>,
    triangles: Vec<Triangle>,
    /// In depth-first order: the left child follows its parent.
    nodes: Vec<Node>,
}

struct Node {
    low: Vec3,
    high: Vec3,
    /// Right child, or first triangle of a leaf.
    next: usize,
    /// Number of triangles of a leaf, else 0.
    count: usize,
    /// Split axis; the left child has the lower coordinates.
    axis: usize,
}

impl Triangles {
    pub(super) fn none() -> Triangles {
        Triangles::new(Vec::new())
    }

    pub(super) fn new(mut triangles: Vec<Triangle>) -> Triangles {
        let mut nodes = Vec::new();
        if !triangles.is_empty() {
            build(&mut triangles, 0, &mut nodes);
        }
        Triangles { cut: None, triangles, nodes }
    }

    pub(super) fn without(self, cut: Option<HalfSpace>) -> Triangles {
        Triangles { cut, ..self }
    }

    /// First visible intersection before `limit`, possibly with the cut face of a body.
    pub(super) fn hit(&self, origin: Vec3, direction: Vec3, limit: f32) -> Option<Hit> {
        let face = self.cut.and_then(|cut| self.cut_face(&cut, origin, direction, limit));
        let limit = face.as_ref().map_or(limit, |face| face.t);
        self.surface(self.cut, origin, direction, limit).or(face)
    }

    /// Intersection with the cut face of a body: beyond the cutting plane the ray next meets the body's surface from
    /// inside. The face has the appearance of that triangle's centre.
    fn cut_face(&self, cut: &HalfSpace, origin: Vec3, direction: Vec3, limit: f32) -> Option<Hit> {
        let speed = cut.normal.dot(direction);
        let t = (cut.offset - cut.normal.dot(origin)) / speed;
        if !(speed < 0.0 && t > 0.0 && t < limit) {
            return None;
        }
        let behind = self.surface(None, origin + direction * t, direction, f32::INFINITY)?;
        let [a, b, c] = behind.corners;
        let from_inside = (b - a).cross(c - a).dot(direction) > 0.0;
        from_inside.then_some(Hit { t, normal: cut.normal, weights: [1.0 / 3.0; 3], ..behind })
    }

    /// First visible intersection before `limit` outside the cut half space.
    fn surface(&self, cut: Option<HalfSpace>, origin: Vec3, direction: Vec3, limit: f32) -> Option<Hit> {
        let gone = |t: f32| cut.is_some_and(|cut| cut.contains(origin + direction * t));
        let mut nearest: Option<Hit> = None;
        self.walk(origin, direction, limit, |triangle, limit| {
            let [a, b, c] = triangle.corners;
            let normal = (b - a).cross(c - a);
            let behind = normal.dot(direction) >= 0.0;
            if behind && !matches!(triangle.owner, Owner::Solid(_)) {
                return limit;
            }
            let Some((t, weights)) = intersect(triangle, origin, direction, limit) else {
                return limit;
            };
            if gone(t) {
                return limit;
            }
            nearest = Some(Hit {
                t,
                normal: normal.normalize_or(-direction) * if behind { -1.0 } else { 1.0 },
                owner: triangle.owner,
                corners: triangle.corners,
                weights,
            });
            t
        });
        nearest
    }

    /// All intersections of a ray in order: distance, and whether the ray enters.
    pub(super) fn crossings(&self, origin: Vec3, direction: Vec3) -> Vec<(f32, bool)> {
        let mut crossings = Vec::new();
        self.walk(origin, direction, f32::INFINITY, |triangle, limit| {
            if let Some((t, _)) = intersect(triangle, origin, direction, limit) {
                let [a, b, c] = triangle.corners;
                crossings.push((t, (b - a).cross(c - a).dot(direction) < 0.0));
            }
            limit
        });
        crossings.sort_unstable_by(|(a, entering_a), (b, entering_b)| a.total_cmp(b).then(entering_a.cmp(entering_b)));
        crossings
    }

    /// Bounding box, m; `None` without triangles.
    pub(super) fn bounds(&self) -> Option<[Vec3; 2]> {
        self.nodes.first().map(|root| [root.low, root.high])
    }

    /// Whether a body other than a container shadows a point from the light before `limit`.
    pub(super) fn shades(&self, origin: Vec3, direction: Vec3, limit: f32) -> bool {
        let gone = |t: f32| {
            let cut = self.cut.as_ref();
            cut.is_some_and(|cut| cut.contains(origin + direction * t))
        };
        let mut shaded = false;
        self.walk(origin, direction, limit, |triangle, limit| {
            let open = triangle.owner == Owner::Container;
            match intersect(triangle, origin, direction, limit) {
                Some((t, _)) if !open && !gone(t) => {
                    shaded = true;
                    0.0
                }
                _ => limit,
            }
        });
        shaded
    }

    /// Calls `visit` for the triangles near a ray; it returns the new limit.
    fn walk<'a>(
        &'a self,
        origin: Vec3,
        direction: Vec3,
        mut limit: f32,
        mut visit: impl FnMut(&'a Triangle, f32) -> f32,
    ) {
        let inverse = direction.recip();
        // The depth of a median split is at most the number of bits.
        let mut stack = [0; usize::BITS as usize + 1];
        let mut waiting = usize::from(!self.nodes.is_empty());
        while waiting > 0 {
            waiting -= 1;
            let index = stack[waiting];
            let node = &self.nodes[index];
            let (low, high) = ((node.low - origin) * inverse, (node.high - origin) * inverse);
            let (near, far) = (low.min(high).max_element(), low.max(high).min_element());
            if near > far || far < 0.0 || near > limit {
                continue;
            }
            if node.count == 0 {
                // Visits the nearer child first, to shorten the ray early.
                let children = [node.next, index + 1];
                let first = usize::from(direction[node.axis] < 0.0);
                stack[waiting] = children[first];
                stack[waiting + 1] = children[1 - first];
                waiting += 2;
            }
            for triangle in &self.triangles[node.next..node.next + node.count] {
                limit = visit(triangle, limit);
            }
        }
    }
}

fn build(triangles: &mut [Triangle], first: usize, nodes: &mut Vec<Node>) {
    let corners = || triangles.iter().flat_map(|triangle| triangle.corners);
    let low = corners().fold(Vec3::INFINITY, Vec3::min);
    let high = corners().fold(Vec3::NEG_INFINITY, Vec3::max);
    let index = nodes.len();
    if triangles.len() <= LEAF {
        nodes.push(Node { low, high, next: first, count: triangles.len(), axis: 0 });
        return;
    }
    let axis = (high - low).max_position();
    nodes.push(Node { low, high, next: 0, count: 0, axis });
    let middle = triangles.len() / 2;
    let centre = |triangle: &Triangle| triangle.corners.iter().map(|corner| corner[axis]).sum::<f32>();
    triangles.select_nth_unstable_by(middle, |a, b| centre(a).total_cmp(&centre(b)));
    let (left, right) = triangles.split_at_mut(middle);
    build(left, first, nodes);
    nodes[index].next = nodes.len();
    build(right, first + middle, nodes);
}

/// Distance along a ray and barycentric coordinates.
fn intersect(triangle: &Triangle, origin: Vec3, direction: Vec3, limit: f32) -> Option<(f32, [f32; 3])> {
    let [a, b, c] = triangle.corners;
    let (ab, ac) = (b - a, c - a);
    let across = direction.cross(ac);
    let determinant = ab.dot(across);
    // Edge-on or degenerate.
    if determinant.abs() < 1e-20 {
        return None;
    }
    let from_a = origin - a;
    let u = from_a.dot(across) / determinant;
    let turned = from_a.cross(ab);
    let v = direction.dot(turned) / determinant;
    let t = ac.dot(turned) / determinant;
    let inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
    (inside && t > 1e-6 && t < limit).then_some((t, [1.0 - u - v, u, v]))
}
