//! Closed triangle meshes of the liquid's surface, by splashsurf.
//!
//! Marching cubes extract one level of a smooth marker density or of the cells' distance. The mesh is then clamped to the
//! walls, freed of degenerate triangles and smoothed.
//!
//! Lengths are in cells. The density is that of smoothed particles with a cubic spline (Monaghan 1992). Each particle is
//! weighted by its volume among its neighbours, so that drops and dense liquid have the same level. Equal markers result in
//! bitwise identical meshes for any number of threads.

use std::collections::HashMap;

use glam::Vec3;
use rayon::prelude::*;
use splashsurf_lib::density_map::DensityMap;
use splashsurf_lib::marching_cubes::triangulate_density_map;
use splashsurf_lib::mesh::TriMesh3d;
use splashsurf_lib::nalgebra::Vector3;
use splashsurf_lib::{
    GridDecompositionParameters, Parameters, ReconstructionError, SpatialDecomposition, UniformGrid,
    reconstruct_surface,
};

use super::closed_mesh::ClosedMesh;
use crate::grid::Grid;
use crate::scene::SurfaceMesh;

/// Support radius of a marker's spline relative to the surface radius of an isolated marker. With the default radius a flat
/// surface of seeded markers lies within 0.05 cells of the region's and is bumpy by 0.04 before smoothing. A larger support
/// costs time with its cube and reduces no bumps.
const REACH: f32 = 1.5;

/// Level: the spline at the radius relative to its centre, 2 (1 - 1/REACH)^3.
const LEVEL: f32 = 2.0 / 27.0;

const CUBE: f32 = 0.5;

/// Distance of the samples of a distance from its zero level, cells, at least.
const OFF_LEVEL: f32 = 1e-6;

/// Half the spacing of markers, eight per cell.
const HALF_SPACING: f32 = 0.25;

pub(super) type SurfaceError = ReconstructionError<i64, f32>;

/// A closed mesh of the liquid's surface, empty without liquid.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct LiquidSurface {
    /// Positions within the domain, m.
    pub(super) vertices: Vec<Vec3>,
    /// Unit vertex normals out of the liquid; at the contact line those of the free surface.
    pub(super) normals: Vec<Vec3>,
    /// Corners, counter-clockwise seen from outside the liquid.
    pub(super) triangles: Vec<[u32; 3]>,
}

impl LiquidSurface {
    /// Surface around markers (m, finite).
    pub(super) fn from_markers(
        markers: &[Vec3],
        grid: &Grid,
        settings: &SurfaceMesh,
    ) -> Result<LiquidSurface, SurfaceError> {
        if markers.is_empty() {
            return Ok(LiquidSurface::default());
        }
        let cells = 1.0 / grid.dx as f32;
        let particles: Vec<Vector3<f32>> =
            markers.iter().map(|&marker| Vector3::from((marker * cells).to_array())).collect();
        let parameters = Parameters {
            iso_surface_threshold: LEVEL,
            // The other decomposition sums in an order that depends on the threads.
            spatial_decomposition: SpatialDecomposition::UniformGrid(GridDecompositionParameters {
                auto_disable: false,
                ..GridDecompositionParameters::default()
            }),
            ..Parameters::new(HALF_SPACING, REACH * settings.radius as f32, CUBE)
        };
        let mesh = reconstruct_surface::<i64, f32>(&particles, &parameters)?.mesh;
        Ok(LiquidSurface::finish(mesh, grid, settings.smoothing))
    }

    /// Zero level of the distance at cell centres (m, x fastest, negative in liquid), constant from the outermost centres
    /// to the walls.
    pub(super) fn from_distance(distance: &[f32], grid: &Grid) -> Result<LiquidSurface, SurfaceError> {
        // A layer of copies around the cells and a layer of air around those, which closes the mesh beyond the walls.
        const LAYERS: usize = 2;
        let n = grid.cells.map(|n| n + 2 * LAYERS);
        let samples =
            UniformGrid::<i64, f32>::new(&Vector3::from_element(0.5 - LAYERS as f32), &n.map(|n| n as i64 - 1), 1.0)?;
        let mut depths = Vec::with_capacity(n.iter().product());
        // The last index of a point is the fastest.
        for i in 0..n[0] {
            for j in 0..n[1] {
                for k in 0..n[2] {
                    let ijk = [i, j, k];
                    let outermost = (0..3).any(|axis| ijk[axis] == 0 || ijk[axis] == n[axis] - 1);
                    let inner = [0, 1, 2].map(|axis| ijk[axis].clamp(LAYERS, n[axis] - 1 - LAYERS) - LAYERS);
                    let depth = match outermost {
                        true => -1.0,
                        false => -distance[grid.cell(inner)] / grid.dx as f32,
                    };
                    // Marching cubes by splashsurf fail where a sample is the level.
                    depths.push(if depth == 0.0 { -OFF_LEVEL } else { depth });
                }
            }
        }
        let mesh = triangulate_density_map(&samples, &DensityMap::from(depths), 0.0)?;
        Ok(LiquidSurface::finish(mesh, grid, 0))
    }

    /// Zero level of a level set outside bodies: of the larger of the liquid distance and minus the distance to bodies (m), so that it
    /// lies against them.
    pub(super) fn from_level(
        distance: &[f32],
        solid_distance: &[f32],
        grid: &Grid,
    ) -> Result<LiquidSurface, SurfaceError> {
        let pairs = distance.iter().zip(solid_distance);
        let outside: Vec<f32> = pairs.map(|(&phi, &solid)| phi.max(-solid)).collect();
        LiquidSurface::from_distance(&outside, grid)
    }

    /// Adds a drop at each of the centres (m), a regular icosahedron of an eighth of a cell, within the walls.
    pub(super) fn add_spray(&mut self, centres: &[Vec3], grid: &Grid) {
        let (size, radius) = (grid.size().as_vec3(), DROP_RADIUS * grid.dx as f32);
        let centred = |centre: Vec3| centre.min(size - radius).max(Vec3::splat(radius));
        for centre in centres.iter().map(|&centre| centred(centre)) {
            let first = self.vertices.len() as u32;
            let corners = icosahedron();
            self.vertices.extend(corners.map(|normal| centre + radius * normal));
            self.normals.extend(corners);
            let triangles = ICOSAHEDRON.iter();
            self.triangles.extend(triangles.map(|of| of.map(|corner| first + corner)));
        }
    }

    /// Sorts, clamps to the walls, removes degenerate triangles and smooths.
    fn finish(mesh: TriMesh3d<f32>, grid: &Grid, smoothing: u32) -> LiquidSurface {
        let mesh = sorted(mesh);
        let size = Vec3::from_array(grid.cells.map(|n| n as f32));
        let vertices = mesh.vertices.iter().map(|x| Vec3::new(x[0], x[1], x[2]));
        let triangles = mesh.triangles.iter();
        let mut mesh = ClosedMesh {
            vertices: vertices.map(|x| x.clamp(Vec3::ZERO, size)).collect(),
            triangles: triangles.map(|corners| corners.map(|corner| corner as u32)).collect(),
        };
        mesh.remove_degenerate(size);
        if smoothing > 0 {
            mesh.smooth(smoothing, size);
            mesh.remove_degenerate(size);
        }
        let ClosedMesh { vertices, triangles } = mesh;
        LiquidSurface {
            normals: normals(&vertices, &triangles, size),
            vertices: vertices.iter().map(|&x| x * grid.dx as f32).collect(),
            triangles,
        }
    }
}

/// Corners of a drop.
pub(super) const DROP_CORNERS: usize = 12;

/// Radius of an icosahedron's corners with the volume of a marker, an eighth of a cell: the volume is 2.536151 times its cube. Cells.
const DROP_RADIUS: f32 = 0.366_644;

/// Corners of the triangles of an icosahedron, counter-clockwise seen from outside.
const ICOSAHEDRON: [[u32; 3]; 20] = [
    [0, 2, 8],
    [0, 9, 2],
    [0, 4, 6],
    [0, 8, 4],
    [0, 6, 9],
    [1, 10, 3],
    [1, 3, 11],
    [1, 6, 4],
    [1, 4, 10],
    [1, 11, 6],
    [2, 7, 5],
    [2, 5, 8],
    [2, 9, 7],
    [3, 5, 7],
    [3, 10, 5],
    [3, 7, 11],
    [4, 8, 10],
    [5, 10, 8],
    [6, 11, 9],
    [7, 9, 11],
];

/// Corners of an icosahedron on the unit sphere: cyclic permutations of (0, +-1, +-the golden ratio).
fn icosahedron() -> [Vec3; DROP_CORNERS] {
    let (one, ratio) = (0.525_731_1, 0.850_650_8);
    std::array::from_fn(|number| {
        let sign = |bit: usize| if number >> bit & 1 == 0 { 1.0 } else { -1.0 };
        let (short, long) = (one * sign(1), ratio * sign(0));
        match number / 4 {
            0 => Vec3::new(0.0, short, long),
            1 => Vec3::new(short, long, 0.0),
            _ => Vec3::new(long, 0.0, short),
        }
    })
}

/// Whether a triangle lies in a wall of the domain.
pub(super) fn in_wall([a, b, c]: [Vec3; 3], size: Vec3) -> bool {
    let flat = |wall: Vec3| a.cmpeq(wall) & b.cmpeq(wall) & c.cmpeq(wall);
    (flat(Vec3::ZERO) | flat(size)).any()
}

/// Area-weighted vertex normals, of the triangles off the walls if the vertex has any.
fn normals(vertices: &[Vec3], triangles: &[[u32; 3]], size: Vec3) -> Vec<Vec3> {
    let mut sums = vec![[Vec3::ZERO; 2]; vertices.len()];
    for corners in triangles {
        let points = corners.map(|corner| vertices[corner as usize]);
        let [a, b, c] = points;
        let area = (b - a).cross(c - a);
        let kind = usize::from(in_wall(points, size));
        for corner in corners {
            sums[*corner as usize][kind] += area;
        }
    }
    let unit = |[free, wall]: [Vec3; 2]| {
        let normal = free.try_normalize().or_else(|| wall.try_normalize());
        normal.unwrap_or(Vec3::Y)
    };
    sums.into_iter().map(unit).collect()
}

/// Sorts vertices and triangles by their positions: splashsurf's order of mesh parts depends on the threads.
fn sorted(mesh: TriMesh3d<f32>) -> TriMesh3d<f32> {
    /// Keys of the corners, rotated to the least first, and the corners.
    type Placed = ([[u32; 3]; 3], [usize; 3]);
    let place = |corner: usize| mesh.vertices[corner].data.0[0].map(ordered);
    let mut placed: Vec<Placed> = mesh
        .triangles
        .par_iter()
        .map(|&[a, b, c]| {
            let turns = [[a, b, c], [b, c, a], [c, a, b]].map(|corners| (corners.map(place), corners));
            let [first, second, third] = turns;
            first.min(second).min(third)
        })
        .collect();
    placed.par_sort_unstable();
    // Corners of degenerate triangles are ambiguous; other triangles number them first.
    let mut numbers = HashMap::with_capacity(mesh.vertices.len());
    let mut vertices = Vec::with_capacity(mesh.vertices.len());
    for extended in [true, false] {
        for ([a, b, c], corners) in &placed {
            if (a != b && b != c && c != a) == extended {
                for &corner in corners {
                    numbers.entry(corner).or_insert_with(|| {
                        vertices.push(mesh.vertices[corner]);
                        vertices.len() - 1
                    });
                }
            }
        }
    }
    let mut triangles: Vec<[usize; 3]> = placed
        .into_iter()
        .map(|(_, corners)| {
            let [a, b, c] = corners.map(|corner| numbers[&corner]);
            [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap_or([a, b, c])
        })
        .collect();
    triangles.par_sort_unstable();
    TriMesh3d { vertices, triangles }
}

/// An integer with the order of the floating-point number.
fn ordered(x: f32) -> u32 {
    let bits = x.to_bits();
    match bits >> 31 {
        0 => bits | 1 << 31,
        _ => !bits,
    }
}
