//! Lattice points near moving triangles: nearest triangles, and points inside tetrahedra.

use glam::{DMat3, DVec3};
use parry3d_f64::query::PointQueryWithLocation;
use parry3d_f64::shape::Triangle;
use rayon::prelude::*;

use super::counting_sort;

/// The points (i + offset, j + offset, k + offset) dx.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice {
    /// Points along x, y, z; x is fastest in memory.
    pub(super) n: [usize; 3],
    /// Cells from the origin to the first point, along each axis.
    pub(super) offset: f64,
    /// m
    pub(super) dx: f64,
}

impl Lattice {
    fn len(&self) -> usize {
        self.n.iter().product()
    }

    pub(super) fn point(&self, index: usize) -> DVec3 {
        let [nx, ny, _] = self.n;
        self.at([index % nx, index / nx % ny, index / (nx * ny)])
    }

    fn at(&self, ijk: [usize; 3]) -> DVec3 {
        (DVec3::from(ijk.map(|i| i as f64)) + self.offset) * self.dx
    }

    /// Index range along an axis of the points from `low` to `high` (m).
    fn range(&self, axis: usize, low: f64, high: f64) -> std::ops::Range<usize> {
        let n = self.n[axis] as f64;
        // With a margin, so that rounding excludes no end point.
        let first = (low / self.dx - self.offset - ROUNDING).ceil().clamp(0.0, n);
        let last = (high / self.dx - self.offset + ROUNDING).floor().clamp(-1.0, n - 1.0);
        first as usize..(last + 1.0) as usize
    }
}

/// Rounding of positions, cells, and of barycentric coordinates.
const ROUNDING: f64 = 1e-9;

/// Marks the absence of a triangle.
const NONE: u32 = u32::MAX;

/// Rounding of the squared distance of a point to a box, cells^2: far more than that of positions.
const BOX_SLACK: f64 = 1e-9;

/// Rows along x per task; results do not depend on it.
const ROWS: usize = 4;

/// Nearest triangle of each lattice point within a distance; of equals the first.
#[derive(Clone, Debug)]
pub(super) struct NearestTriangles {
    pub(super) lattice: Lattice,
    /// m
    reach: f64,
    triangle: Vec<u32>,
    /// Squared distance, m^2.
    square: Vec<f64>,
    /// Points with a triangle, ascending.
    pub(super) near: Vec<usize>,
}

impl NearestTriangles {
    pub(super) fn new(lattice: Lattice, reach: f64) -> NearestTriangles {
        NearestTriangles {
            lattice,
            reach,
            triangle: vec![NONE; lattice.len()],
            square: vec![f64::INFINITY; lattice.len()],
            near: Vec::new(),
        }
    }

    /// Unsigned distance of a point to its nearest triangle, m; infinite beyond reach.
    pub(super) fn distance(&self, point: usize) -> f64 {
        self.square[point].sqrt()
    }

    /// Nearest triangle of a point, and barycentric coordinates of the nearest point.
    pub(super) fn nearest(&self, point: usize, corners: impl Fn(usize) -> [DVec3; 3]) -> Option<(usize, [f64; 3])> {
        let triangle = self.triangle[point];
        if triangle == NONE {
            return None;
        }
        let [a, b, c] = corners(triangle as usize);
        let (_, place) = Triangle::new(a, b, c).project_local_point_and_get_location(self.lattice.point(point), true);
        let weights = place.barycentric_coordinates()?;
        Some((triangle as usize, weights))
    }

    pub(super) fn update(&mut self, corners: &[[DVec3; 3]]) {
        for &point in &self.near {
            self.triangle[point] = NONE;
            self.square[point] = f64::INFINITY;
        }
        let (lattice, reach) = (self.lattice, self.reach);
        let triangles: Vec<BoundedTriangle> =
            corners.par_iter().map(|&corners| BoundedTriangle::new(&lattice, reach, corners)).collect();
        let [nx, ny, _] = lattice.n;
        let n_tasks = (self.triangle.len() / nx).div_ceil(ROWS);
        let (start, tasks) = by_task(&triangles, ny, n_tasks);
        let rows = self.triangle.chunks_mut(ROWS * nx).zip(self.square.chunks_mut(ROWS * nx));
        let rows = rows.enumerate().filter(|(task, _)| start[*task] < start[task + 1]);
        let rows: Vec<_> = rows.collect();
        let near_points = |(task, (nearest, squares)): (usize, (&mut [u32], &mut [f64]))| {
            let first = ROWS * nx * task;
            let of_task = &tasks[start[task]..start[task + 1]];
            for &triangle in of_task {
                let nearby = &triangles[triangle as usize];
                nearby.each_near_point(&lattice, reach, ROWS * task..ROWS * (task + 1), |point, square| {
                    let at = point - first;
                    if square < squares[at] {
                        squares[at] = square;
                        nearest[at] = triangle;
                    }
                    squares[at]
                });
            }
            let points = nearest.iter().enumerate();
            let near = points.filter(|(_, triangle)| **triangle != NONE);
            near.map(|(at, _)| at + first).collect::<Vec<usize>>()
        };
        let near: Vec<Vec<usize>> = rows.into_par_iter().map(near_points).collect();
        self.near = near.concat();
    }
}

/// Triangles of each task of [`ROWS`] rows, ascending: the start of each task, one more than there are tasks, and the
/// triangles.
fn by_task(triangles: &[BoundedTriangle], ny: usize, n_tasks: usize) -> (Vec<usize>, Vec<u32>) {
    let tasks_of = |nearby: &BoundedTriangle| {
        let [_, js, ks] = nearby.ranges.clone();
        ks.flat_map(move |k| {
            let (first, end) = (js.start + ny * k, js.end + ny * k);
            if js.is_empty() { 0..0 } else { first / ROWS..(end - 1) / ROWS + 1 }
        })
    };
    // A task with rows of two planes lists a triangle once.
    let mut last = vec![NONE; n_tasks];
    let mut of_tasks = Vec::new();
    for (number, nearby) in (0..).zip(triangles) {
        for task in tasks_of(nearby) {
            if last[task] != number {
                last[task] = number;
                of_tasks.push((task, number));
            }
        }
    }
    let (start, order) = counting_sort(n_tasks, of_tasks.iter().map(|(task, _)| *task));
    (start, order.into_iter().map(|at| of_tasks[at].1).collect())
}

/// A triangle with the lattice points in its enlarged bounding box.
struct BoundedTriangle {
    triangle: Triangle,
    normal: DVec3,
    /// Bounding box, m.
    low: DVec3,
    high: DVec3,
    /// Index ranges per axis.
    ranges: [std::ops::Range<usize>; 3],
}

impl BoundedTriangle {
    fn new(lattice: &Lattice, reach: f64, [a, b, c]: [DVec3; 3]) -> BoundedTriangle {
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        // A triangle without area is covered by its neighbours.
        let normal = (b - a).cross(c - a).try_normalize();
        BoundedTriangle {
            triangle: Triangle::new(a, b, c),
            normal: normal.unwrap_or(DVec3::ZERO),
            low,
            high,
            ranges: [0, 1, 2].map(|axis| match normal {
                Some(_) => lattice.range(axis, low[axis] - reach, high[axis] + reach),
                None => 0..0,
            }),
        }
    }

    /// Calls `visit` with the points within reach in some rows along x and their squared distances. `visit` returns the
    /// square above which further distances of the point are irrelevant.
    fn each_near_point(
        &self,
        lattice: &Lattice,
        reach: f64,
        rows: std::ops::Range<usize>,
        mut visit: impl FnMut(usize, f64) -> f64,
    ) {
        let [is, js, ks] = self.ranges.clone();
        let [nx, ny, _] = lattice.n;
        let slack = BOX_SLACK * lattice.dx * lattice.dx;
        for row in rows {
            let (j, k) = (row % ny, row / ny);
            if !(js.contains(&j) && ks.contains(&k)) {
                continue;
            }
            for i in is.clone() {
                let (x, point) = (lattice.at([i, j, k]), i + nx * row);
                let height = (x - self.triangle.a).dot(self.normal);
                let most = visit(point, f64::INFINITY).min(reach * reach);
                if height * height >= most {
                    continue;
                }
                // No point of the triangle is nearer than its box.
                let beyond = (self.low - x).max(x - self.high).max(DVec3::ZERO);
                if beyond.length_squared() > most + slack {
                    continue;
                }
                let (nearest, _) = self.triangle.project_local_point_and_get_location(x, true);
                let square = x.distance_squared(nearest.point);
                if square < most {
                    visit(point, square);
                }
            }
        }
    }
}

/// Lattice points in tetrahedra with the body of each tetrahedron, ascending, without repetitions. Points on a side, to
/// rounding, are inside. Inverted tetrahedra count like others, flat ones contain no points.
pub(super) fn inside_tetrahedra(
    lattice: &Lattice,
    elements: &[[u32; 4]],
    body_of: impl Fn(usize) -> u32 + Sync,
    nodes: &[DVec3],
) -> Vec<(usize, u32)> {
    let element_points = |(number, corners): (usize, &[u32; 4])| {
        let [a, b, c, d] = corners.map(|node| nodes[node as usize]);
        let (low, high) = (a.min(b).min(c).min(d), a.max(b).max(c).max(d));
        let [is, js, ks] = [0, 1, 2].map(|axis| lattice.range(axis, low[axis], high[axis]));
        let edges = DMat3::from_cols(b - a, c - a, d - a);
        let inverse = edges.inverse();
        let body = body_of(number);
        let mut inside = Vec::new();
        if !inverse.is_finite() {
            return inside;
        }
        for k in ks {
            for j in js.clone() {
                for i in is.clone() {
                    let weights = inverse * (lattice.at([i, j, k]) - a);
                    let first = 1.0 - weights.element_sum();
                    if weights.min_element().min(first) >= -ROUNDING {
                        inside.push((i + lattice.n[0] * (j + lattice.n[1] * k), body));
                    }
                }
            }
        }
        inside
    };
    let mut inside: Vec<(usize, u32)> = elements.par_iter().enumerate().flat_map_iter(element_points).collect();
    inside.par_sort_unstable();
    inside.dedup();
    inside
}
