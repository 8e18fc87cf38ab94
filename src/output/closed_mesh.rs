//! Closed triangle meshes within the walls of a box: removal of degenerate triangles and coincident vertices, and smoothing of
//! the free part at constant volume. Lengths are in cells.
//!
//! Edge collapses under the link condition (Dey et al. 1999, "Topology preserving edge contraction") and edge flips remove
//! degenerate triangles. Every edge then still has exactly two triangles. A smoothing iteration is a forward and a backward
//! step of the umbrella operator. It multiplies a wave of eigenvalue k by 1 - (lambda k)^2, so no wave grows. Source: Taubin
//! 1995, "A signal processing approach to fair surface design", with lambda = -mu. Walls are mirrors. An offset of each
//! component restores its volume.

use std::collections::HashSet;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::geometry::DisjointSets;

/// Least length of an edge and least height of a triangle. Coordinates of 512 cells are 1/30 of this apart.
const SHORT: f32 = 1e-3;
/// Cosine of the largest rotation of a triangle by a collapse or a flip.
const LEAST_COSINE: f32 = 0.7;
/// Most passes over all triangles, and most restarts; most meshes need three passes.
const PASSES: usize = 10;
/// Least volume of a component; smaller ones were flattened by walls. An isolated marker has 2.
const LEAST_VOLUME: f64 = 1e-3;
/// Smoothing step. An iteration reduces waves of ten edges by a hundredth, those of five by a twentieth, ripples most.
const STEP: f32 = 0.65;
/// Largest offset per iteration of the volume correction: Newton's method would overshoot in small drops.
const MOST_OFFSET: f64 = 0.25;
const OFFSET_ITERATIONS: usize = 12;

/// Vertices within the walls. Every edge belongs to two triangles, in opposite directions.
pub(super) struct ClosedMesh {
    pub(super) vertices: Vec<Vec3>,
    pub(super) triangles: Vec<[u32; 3]>,
}

/// Walls through a point: bits 0 to 2 for lower, 3 to 5 for upper ones.
fn walls(x: Vec3, size: Vec3) -> u8 {
    let bits = |equal: glam::BVec3| equal.bitmask() as u8;
    bits(x.cmpeq(Vec3::ZERO)) | bits(x.cmpeq(size)) << 3
}

/// Walls through all corners of a triangle.
fn common_walls(walls: &[u8], triangle: [u32; 3]) -> u8 {
    let corners = triangle.iter();
    corners.fold(!0, |all, &corner| all & walls[corner as usize])
}

/// Twice the area, along the normal.
fn area_vector([a, b, c]: [Vec3; 3]) -> Vec3 {
    (b - a).cross(c - a)
}

/// Least height of a triangle, and index of the first corner of its longest edge.
fn height([a, b, c]: [Vec3; 3]) -> (f32, usize) {
    let lengths = [a.distance(b), b.distance(c), c.distance(a)];
    let longest = [2, 1, 0].into_iter().max_by(|&one: &usize, &two| lengths[one].total_cmp(&lengths[two])).unwrap_or(0);
    let height = match lengths[longest] {
        0.0 => 0.0,
        length => area_vector([a, b, c]).length() / length,
    };
    (height, longest)
}

impl ClosedMesh {
    fn corners(&self, triangle: [u32; 3]) -> [Vec3; 3] {
        triangle.map(|corner| self.vertices[corner as usize])
    }

    /// Connected component of each vertex, and their number.
    fn components(&self) -> (Vec<u32>, usize) {
        let mut components = DisjointSets::new(self.vertices.len());
        for &[a, b, c] in &self.triangles {
            components.merge(a, b);
            components.merge(a, c);
        }
        components.labels()
    }

    /// Volume of each component by the divergence theorem; negative for cavities.
    fn volumes(&self, component: &[u32], n: usize) -> Vec<f64> {
        let mut volumes = vec![0.0; n];
        for &triangle in &self.triangles {
            let [a, b, c] = self.corners(triangle).map(Vec3::as_dvec3);
            volumes[component[triangle[0] as usize] as usize] += a.dot(b.cross(c)) / 6.0;
        }
        volumes
    }

    /// Removes components without volume, triangles without area and coincident vertices.
    pub(super) fn remove_degenerate(&mut self, size: Vec3) {
        let (component, n) = self.components();
        let volumes = self.volumes(&component, n);
        self.triangles.retain(|[a, _, _]| volumes[component[*a as usize] as usize].abs() > LEAST_VOLUME);
        for _ in 0..PASSES {
            let mut cleaner = Cleaner::new(self, size);
            for _ in 0..PASSES {
                if !cleaner.pass() {
                    break;
                }
            }
            self.compact();
            if !self.separate(size) {
                break;
            }
        }
    }

    /// Drops unused vertices and triangles marked as removed.
    fn compact(&mut self) {
        self.triangles.retain(|[a, b, _]| a != b);
        let mut numbers = vec![u32::MAX; self.vertices.len()];
        for corner in self.triangles.as_flattened() {
            numbers[*corner as usize] = 0;
        }
        let mut kept = Vec::with_capacity(self.vertices.len());
        for (number, &x) in numbers.iter_mut().zip(&self.vertices) {
            if *number == 0 {
                *number = kept.len() as u32;
                kept.push(x);
            }
        }
        self.vertices = kept;
        for corner in self.triangles.as_flattened_mut() {
            *corner = numbers[*corner as usize];
        }
    }

    /// Moves coincident vertices and apices of flat triangles slightly into the liquid, each by a different amount; sheets
    /// that touch without a common vertex have them. Returns whether there were any.
    fn separate(&mut self, size: Vec3) -> bool {
        let mut places: HashSet<[i32; 3]> = HashSet::with_capacity(self.vertices.len());
        let mut moved: Vec<u32> = Vec::new();
        for (vertex, x) in (0..).zip(&self.vertices) {
            let place = (*x / (0.1 * SHORT)).round().as_ivec3().to_array();
            if !places.insert(place) {
                moved.push(vertex);
            }
        }
        for &triangle in &self.triangles {
            let (height, longest) = height(self.corners(triangle));
            if height < 0.1 * SHORT {
                moved.push(triangle[(longest + 2) % 3]);
            }
        }
        if moved.is_empty() {
            return false;
        }
        moved.sort_unstable();
        moved.dedup();
        let mut normals = vec![Vec3::ZERO; self.vertices.len()];
        for &triangle in &self.triangles {
            let area = area_vector(self.corners(triangle));
            for corner in triangle {
                normals[corner as usize] += area;
            }
        }
        for vertex in moved {
            let x = &mut self.vertices[vertex as usize];
            let from_walls = Vec3::select(x.cmpeq(Vec3::ZERO), Vec3::ONE, Vec3::ZERO)
                - Vec3::select(x.cmpeq(size), Vec3::ONE, Vec3::ZERO);
            let inwards = from_walls - normals[vertex as usize].normalize_or_zero();
            // Additive recurrence of the golden ratio: neighbours differ most.
            let share = Vec3::from([1, 2, 3].map(|axis| (0.618_034 * (vertex * axis) as f32).fract()));
            *x = (*x + 2.0 * SHORT * inwards * (share + 0.5)).clamp(Vec3::ZERO, size);
        }
        true
    }

    /// Smooths the free part and preserves the volume of each component.
    pub(super) fn smooth(&mut self, rounds: u32, size: Vec3) {
        if rounds == 0 || self.triangles.is_empty() {
            return;
        }
        let (component, n) = self.components();
        let volumes = self.volumes(&component, n);
        let walls: Vec<u8> = self.vertices.iter().map(|&x| walls(x, size)).collect();
        let neighbours = Neighbours::new(self, &walls);
        let mut next = self.vertices.clone();
        for _ in 0..rounds {
            for step in [STEP, -STEP] {
                next.par_iter_mut().enumerate().for_each(|(vertex, next)| {
                    let x = self.vertices[vertex];
                    *next = x + step * neighbours.umbrella(vertex, x, &self.vertices);
                });
                std::mem::swap(&mut self.vertices, &mut next);
            }
        }
        for x in &mut self.vertices {
            *x = x.clamp(Vec3::ZERO, size);
        }
        self.restore(&volumes, &component, &walls, size);
    }

    /// Offsets the free surface of each component along its normals to its target volume.
    fn restore(&mut self, targets: &[f64], component: &[u32], walls: &[u8], size: Vec3) {
        for _ in 0..OFFSET_ITERATIONS {
            let volumes = self.volumes(component, targets.len());
            let close = |(target, volume): (&f64, &f64)| (target - volume).abs() < 1e-6 * target.abs();
            if targets.iter().zip(&volumes).all(close) {
                break;
            }
            let mut areas = vec![0.0; targets.len()];
            let mut normals = vec![DVec3::ZERO; self.vertices.len()];
            for &triangle in &self.triangles {
                if common_walls(walls, triangle) != 0 {
                    continue;
                }
                let area = 0.5 * area_vector(self.corners(triangle)).as_dvec3();
                areas[component[triangle[0] as usize] as usize] += area.length();
                for corner in triangle {
                    normals[corner as usize] += area;
                }
            }
            for (vertex, x) in self.vertices.iter_mut().enumerate() {
                let label = component[vertex] as usize;
                let Some(normal) = normals[vertex].try_normalize() else {
                    continue;
                };
                let offset = (targets[label] - volumes[label]) / areas[label];
                let offset = offset.clamp(-MOST_OFFSET, MOST_OFFSET);
                // Beside a wall the offset is longer along the wall than along the normal.
                let along = normal * free_axes(walls[vertex]).as_dvec3();
                let direction = along / along.length_squared().max(0.25);
                *x = (*x + (offset * direction).as_vec3()).clamp(Vec3::ZERO, size);
            }
        }
    }
}

/// 1 along the axes free of these walls, else 0.
fn free_axes(walls: u8) -> Vec3 {
    let fixed = walls | walls >> 3;
    Vec3::from([0, 1, 2].map(|axis| f32::from(1 - (fixed >> axis & 1))))
}

struct Neighbours {
    starts: Vec<usize>,
    /// Neighbour and its weight in the mean.
    shares: Vec<(u32, f32)>,
    free: Vec<Vec3>,
}

impl Neighbours {
    fn new(mesh: &ClosedMesh, walls: &[u8]) -> Neighbours {
        let n = mesh.vertices.len();
        // At the contact line the neighbours are those in the free surface.
        let in_wall = |triangle: &[u32; 3]| common_walls(walls, *triangle) != 0;
        let mut on_free = vec![false; n];
        for triangle in mesh.triangles.iter().filter(|triangle| !in_wall(triangle)) {
            for corner in triangle {
                on_free[*corner as usize] = true;
            }
        }
        let mut edges = Vec::with_capacity(6 * mesh.triangles.len());
        for triangle in &mesh.triangles {
            let wall = in_wall(triangle);
            for corner in 0..3 {
                let vertex = triangle[corner];
                if wall && on_free[vertex as usize] {
                    continue;
                }
                edges.push((vertex, triangle[(corner + 1) % 3]));
                edges.push((vertex, triangle[(corner + 2) % 3]));
            }
        }
        edges.par_sort_unstable();
        edges.dedup();
        let mut starts = vec![0; n + 1];
        for &(vertex, _) in &edges {
            starts[vertex as usize + 1] += 1;
        }
        for vertex in 0..n {
            starts[vertex + 1] += starts[vertex];
        }
        // Number of mirror images of the neighbour in the walls of the vertex.
        let weight = |&(vertex, other): &(u32, u32)| -> f32 {
            let mirrors = walls[vertex as usize] & !walls[other as usize];
            (1u32 << mirrors.count_ones()) as f32
        };
        let mut shares = Vec::with_capacity(edges.len());
        for vertex in 0..n {
            let around = &edges[starts[vertex]..starts[vertex + 1]];
            let sum: f32 = around.iter().map(weight).sum();
            shares.extend(around.iter().map(|edge| (edge.1, weight(edge) / sum)));
        }
        let free = walls.iter().map(|&walls| free_axes(walls)).collect();
        Neighbours { starts, shares, free }
    }

    /// Mean of the neighbours minus the vertex, along its free axes.
    fn umbrella(&self, vertex: usize, x: Vec3, vertices: &[Vec3]) -> Vec3 {
        let around = &self.shares[self.starts[vertex]..self.starts[vertex + 1]];
        let mean = around.iter().map(|&(other, share)| share * (vertices[other as usize] - x)).sum::<Vec3>();
        mean * self.free[vertex]
    }
}

struct Cleaner<'a> {
    mesh: &'a mut ClosedMesh,
    walls: Vec<u8>,
    /// Triangles of each vertex.
    around: Vec<Vec<u32>>,
}

impl<'a> Cleaner<'a> {
    fn new(mesh: &'a mut ClosedMesh, size: Vec3) -> Cleaner<'a> {
        let mut around = vec![Vec::with_capacity(6); mesh.vertices.len()];
        for (number, triangle) in (0..).zip(&mesh.triangles) {
            for corner in triangle {
                around[*corner as usize].push(number);
            }
        }
        let walls = mesh.vertices.iter().map(|&x| walls(x, size)).collect();
        Cleaner { mesh, walls, around }
    }

    fn triangle(&self, number: u32) -> [u32; 3] {
        self.mesh.triangles[number as usize]
    }

    /// Visits all triangles once; returns whether any changed.
    fn pass(&mut self) -> bool {
        let mut changed = false;
        for number in 0..self.mesh.triangles.len() as u32 {
            let triangle = self.triangle(number);
            if triangle[0] == triangle[1] {
                continue;
            }
            let corners = self.mesh.corners(triangle);
            let (height, longest) = height(corners);
            let mut edges = [0, 1, 2].map(|edge| {
                let [a, b] = [edge, (edge + 1) % 3];
                (corners[a].distance(corners[b]), triangle[a], triangle[b])
            });
            edges.sort_by(|one, two| one.0.total_cmp(&two.0));
            if height >= SHORT && edges[0].0 >= SHORT {
                continue;
            }
            let flat = edges[0].0 >= SHORT;
            changed |= flat && self.flip(number, longest)
                || edges
                    .iter()
                    .take(if flat { 2 } else { 1 })
                    .any(|&(_, a, b)| self.collapse(a, b) || self.collapse(b, a));
        }
        changed
    }

    /// Neighbours of a vertex, ascending.
    fn ring(&self, vertex: u32) -> Vec<u32> {
        let mut ring: Vec<u32> = self.around[vertex as usize]
            .iter()
            .flat_map(|&number| self.triangle(number))
            .filter(|&other| other != vertex)
            .collect();
        ring.sort_unstable();
        ring.dedup();
        ring
    }

    /// Whether a triangle may become another: it is not reversed and not flattened.
    fn allowed(&self, old: [Vec3; 3], new: [Vec3; 3]) -> bool {
        let (before, _) = height(old);
        let (after, _) = height(new);
        if before < SHORT {
            return true;
        }
        let [old, new] = [old, new].map(|corners| area_vector(corners).normalize_or_zero());
        after >= SHORT && old.dot(new) >= LEAST_COSINE
    }

    /// Collapses an edge into a vertex that lies in all walls of the other; returns whether that is possible.
    fn collapse(&mut self, from: u32, to: u32) -> bool {
        if self.walls[from as usize] & !self.walls[to as usize] != 0 {
            return false;
        }
        let [ring, other] = [from, to].map(|vertex| self.ring(vertex));
        let common = ring.iter().filter(|vertex| other.binary_search(vertex).is_ok());
        // Link condition; a tetrahedron would vanish.
        if common.count() != 2 || (ring.len() == 3 && other.len() == 3) {
            return false;
        }
        let moved = |triangle: [u32; 3]| triangle.map(|corner| if corner == from { to } else { corner });
        let fan = std::mem::take(&mut self.around[from as usize]);
        let fits = fan.iter().all(|&number| {
            let triangle = self.triangle(number);
            triangle.contains(&to) || self.allowed(self.mesh.corners(triangle), self.mesh.corners(moved(triangle)))
        });
        if !fits {
            self.around[from as usize] = fan;
            return false;
        }
        for number in fan {
            let triangle = self.triangle(number);
            if triangle.contains(&to) {
                for corner in triangle {
                    self.around[corner as usize].retain(|&other| other != number);
                }
                self.mesh.triangles[number as usize] = [to; 3];
            } else {
                self.mesh.triangles[number as usize] = moved(triangle);
                self.around[to as usize].push(number);
            }
        }
        true
    }

    /// Flips the longest edge of a flat triangle; returns whether that is possible.
    fn flip(&mut self, number: u32, longest: usize) -> bool {
        let triangle = self.triangle(number);
        let [p, q, r] = [0, 1, 2].map(|corner| triangle[(longest + corner) % 3]);
        let beside =
            self.around[p as usize].iter().copied().find(|&other| other != number && self.triangle(other).contains(&q));
        let Some(beside) = beside else { return false };
        let neighbour = self.triangle(beside);
        let Some(&s) = neighbour.iter().find(|&&corner| corner != p && corner != q) else {
            return false;
        };
        if s == r || self.ring(r).binary_search(&s).is_ok() {
            return false;
        }
        let old = self.mesh.corners(neighbour);
        let flipped = [[p, s, r], [s, q, r]];
        let fits = height(old).0 >= SHORT && flipped.iter().all(|&new| self.allowed(old, self.mesh.corners(new)));
        // Triangles in walls remain in them.
        let kept = common_walls(&self.walls, neighbour);
        if !fits || self.walls[r as usize] & kept != kept {
            return false;
        }
        [self.mesh.triangles[number as usize], self.mesh.triangles[beside as usize]] = flipped;
        self.around[q as usize].retain(|&other| other != number);
        self.around[p as usize].retain(|&other| other != beside);
        self.around[s as usize].push(number);
        self.around[r as usize].push(beside);
        true
    }
}
