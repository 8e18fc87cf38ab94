//! Exact signed distances of the shapes of a scene, negative inside.

use std::fmt;
use std::sync::Arc;

use glam::{DMat3, DVec3};
use parry3d_f64::query::{PointQuery, PointQueryWithLocation};
use parry3d_f64::shape::{TriMesh, TriMeshFlags};
use rayon::prelude::*;

use super::Surface;
use super::placing::{ensure_in_domain, read_surface};
use super::solitary;
use crate::error::Error;
use crate::grid::Grid;
use crate::scene::{Obstacle, Placement, Shape, SolitaryWave};

/// Half width of the narrow band of exact obstacle distances, cells.
pub(super) const BAND: f64 = 3.0;

/// A shape prepared for distance queries.
#[derive(Clone, Debug)]
pub(super) enum Solid {
    /// An axis-aligned box; infinite coordinates stand for removed sides.
    Box {
        min: DVec3,
        max: DVec3,
    },
    Sphere {
        centre: DVec3,
        radius: f64,
    },
    /// A right circular cylinder along a unit axis, between two heights above a point; infinite heights stand for removed
    /// ends.
    Cylinder {
        point: DVec3,
        axis: DVec3,
        radius: f64,
        heights: [f64; 2],
    },
    /// Half space behind a plane.
    HalfSpace {
        point: DVec3,
        normal: DVec3,
    },
    /// Region below a wave.
    Wave {
        level: f64,
        amplitude: f64,
        wave_number: [f64; 2],
        phase: f64,
    },
    /// Region below a solitary wave.
    Solitary(SolitaryWave),
    /// Inside of a closed mesh.
    Mesh(Box<ClosedMesh>),
}

/// A closed mesh, and its triangles off the walls, to which depths are measured.
#[derive(Clone)]
pub(super) struct ClosedMesh {
    all: Arc<TriMesh>,
    free: Free,
}

impl fmt::Debug for ClosedMesh {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ClosedMesh of {} triangles", self.all.indices().len())
    }
}

/// Triangles that do not lie on walls of the domain.
#[derive(Clone)]
enum Free {
    All,
    Some(Arc<TriMesh>),
    None,
}

impl Solid {
    /// A shape without placement.
    pub(super) fn new(shape: &Shape) -> Result<Solid, Error> {
        Ok(match *shape {
            Shape::Box { min, max } => Solid::Box { min, max },
            Shape::Sphere { centre, radius } => Solid::Sphere { centre, radius },
            Shape::Cylinder { base, axis, radius, height } => {
                Solid::Cylinder { point: base, axis, radius, heights: [0.0, height] }
            }
            Shape::HalfSpace { point, normal } => Solid::HalfSpace { point, normal },
            Shape::Wave { level, amplitude, wave_number, phase } => {
                Solid::Wave { level, amplitude, wave_number, phase }
            }
            Shape::Solitary(wave) => Solid::Solitary(wave),
            Shape::Mesh { ref file, unit } => Solid::mesh(&read_surface(file, unit)?),
        })
    }

    /// A placed shape; half spaces and waves have no placement.
    pub(super) fn placed(shape: &Shape, placement: &Placement) -> Result<Solid, Error> {
        if placement.is_none() {
            return Solid::new(shape);
        }
        let Placement { rotate, scale, .. } = *placement;
        Ok(match *shape {
            Shape::Sphere { centre, radius } => {
                Solid::Sphere { centre: placement.put(centre, centre), radius: scale * radius }
            }
            Shape::Cylinder { base, axis, radius, height } => Solid::Cylinder {
                point: placement.put(base, base + 0.5 * height * axis),
                axis: rotate * axis,
                radius: scale * radius,
                heights: [0.0, scale * height],
            },
            Shape::Box { min, max } => {
                let surface = Surface::cuboid(min, max);
                Solid::mesh(&surface.placed(placement, 0.5 * (min + max)))
            }
            Shape::Mesh { ref file, unit } => {
                let surface = read_surface(file, unit)?;
                let centre = surface.centre();
                Solid::mesh(&surface.placed(&placement.about(centre), centre))
            }
            Shape::HalfSpace { .. } | Shape::Wave { .. } | Shape::Solitary(_) => Solid::new(shape)?,
        })
    }

    /// The inside of a closed surface.
    fn mesh(surface: &Surface) -> Solid {
        let Surface { vertices, triangles } = surface.clone();
        Solid::Mesh(Box::new(ClosedMesh::new(vertices, triangles)))
    }

    /// Signed distance at a point, m. Exact except for waves: height difference over the length of its gradient, accurate
    /// to first order near the surface.
    pub(super) fn distance(&self, x: DVec3) -> f64 {
        match *self {
            Solid::Box { min, max } => {
                let sides = (min - x).max(x - max);
                from_sides(sides.max_element(), sides.max(DVec3::ZERO).length())
            }
            Solid::Sphere { centre, radius } => (x - centre).length() - radius,
            Solid::Cylinder { point, axis, radius, heights: [low, high] } => {
                let height = (x - point).dot(axis);
                let round = (x - point - height * axis).length() - radius;
                let flat = (low - height).max(height - high);
                from_sides(round.max(flat), round.max(0.0).hypot(flat.max(0.0)))
            }
            Solid::HalfSpace { point, normal } => (x - point).dot(normal),
            Solid::Wave { level, amplitude, wave_number: [kx, kz], phase } => {
                let (sin, cos) = (kx * x.x + kz * x.z + phase).sin_cos();
                let slope = amplitude * sin * kx.hypot(kz);
                (x.y - level - amplitude * cos) / 1.0_f64.hypot(slope)
            }
            Solid::Solitary(ref wave) => solitary::distance(wave, x),
            Solid::Mesh(ref mesh) => mesh.distance(x, f64::MAX).expect("every point has a nearest triangle"),
        }
    }

    /// Velocity field of a solitary wave, m/s; 0 for other shapes.
    pub(super) fn velocity(&self, x: DVec3) -> DVec3 {
        match self {
            Solid::Solitary(wave) => solitary::velocity(wave, x),
            _ => DVec3::ZERO,
        }
    }

    /// The solid without flat sides on or beyond a wall of the domain, once placed around `centre` (m). Distances ignore
    /// those sides: nothing leaves the solid there.
    pub(super) fn beyond_walls(self, grid: &Grid, placement: &Placement, centre: DVec3) -> Solid {
        let on_wall = |x, out| on_wall(grid, placement.put(x, centre), placement.rotate * out);
        match self {
            Solid::Box { min, max } => {
                let walls = |corner, sign: f64| DVec3::AXES.map(|axis| on_wall(corner, sign * axis)).into();
                Solid::Box {
                    min: DVec3::select(walls(min, -1.0), DVec3::NEG_INFINITY, min),
                    max: DVec3::select(walls(max, 1.0), DVec3::INFINITY, max),
                }
            }
            Solid::Cylinder { point, axis, radius, heights: [low, high] } => Solid::Cylinder {
                point,
                axis,
                radius,
                heights: [
                    if on_wall(point + low * axis, -axis) { f64::NEG_INFINITY } else { low },
                    if on_wall(point + high * axis, axis) { f64::INFINITY } else { high },
                ],
            },
            Solid::Mesh(mesh) => Solid::Mesh(Box::new(mesh.beyond_walls(on_wall))),
            other => other,
        }
    }
}

/// Whether a flat side through a point (m), with this unit outward normal, lies on or beyond the wall in that direction.
fn on_wall(grid: &Grid, x: DVec3, out: DVec3) -> bool {
    // Far above the rounding of scene values, far below the resolution of a cell.
    let near = 1e-6 * grid.dx;
    let size = grid.size();
    (0..3).any(|a| (out[a] > 1.0 - 1e-12 && x[a] >= size[a] - near) || (out[a] < -1.0 + 1e-12 && x[a] <= near))
}

/// Distance of a convex solid: the largest distance to its sides, or outside the length of the positive ones.
fn from_sides(largest: f64, outside: f64) -> f64 {
    if largest > 0.0 { outside } else { largest }
}

impl ClosedMesh {
    /// At least one triangle, counter-clockwise seen from outside.
    pub(super) fn new(vertices: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> ClosedMesh {
        let all = TriMesh::with_flags(vertices, triangles, TriMeshFlags::ORIENTED);
        ClosedMesh { all: Arc::new(all.expect("a closed surface has triangles")), free: Free::All }
    }

    pub(super) fn contains(&self, x: DVec3) -> bool {
        self.all.contains_local_point(x)
    }

    /// The mesh without triangles on walls, selected by a corner and the unit normal.
    fn beyond_walls(self, on_wall: impl Fn(DVec3, DVec3) -> bool) -> ClosedMesh {
        let all = self.all;
        let is_free = |triangle: &&[u32; 3]| {
            let [a, b, c] = triangle.map(|vertex| all.vertices()[vertex as usize]);
            !on_wall(a, (b - a).cross(c - a).normalize_or_zero())
        };
        let free: Vec<[u32; 3]> = all.indices().iter().filter(is_free).copied().collect();
        let free = if free.len() == all.indices().len() {
            Free::All
        } else if free.is_empty() {
            Free::None
        } else {
            let mesh = TriMesh::new(all.vertices().to_vec(), free);
            Free::Some(Arc::new(mesh.expect("there are triangles")))
        };
        ClosedMesh { all, free }
    }

    /// Signed distance if it is at most `reach`, with the sign by angle-weighted pseudo-normals (Baerentzen and Aanaes
    /// 2005). Outside the mesh, a point of the domain is never nearest to a triangle on a wall only.
    fn distance(&self, x: DVec3, reach: f64) -> Option<f64> {
        let nearest = |mesh: &TriMesh| {
            let nearest = mesh.project_local_point_and_get_location_with_max_dist(x, false, reach);
            nearest.map(|(nearest, _)| nearest)
        };
        let surface = nearest(&self.all)?;
        let length = (x - surface.point).length();
        if !surface.is_inside {
            return Some(length);
        }
        match &self.free {
            Free::All => Some(-length),
            Free::Some(mesh) => nearest(mesh).map(|free| -(x - free.point).length()),
            Free::None => Some(f64::NEG_INFINITY),
        }
    }

    /// Triangles off the walls; `None` without any.
    pub(super) fn free_triangles(&self) -> Option<&TriMesh> {
        match &self.free {
            Free::All => Some(&self.all),
            Free::Some(mesh) => Some(mesh),
            Free::None => None,
        }
    }

    /// Nearest point of these triangles to a point inside; `None` outside.
    pub(super) fn nearest_wall(&self, x: DVec3) -> Option<DVec3> {
        let nearest = |mesh: &TriMesh| mesh.project_local_point_and_get_location(x, false).0;
        let surface = nearest(&self.all);
        match &self.free {
            _ if !surface.is_inside => None,
            Free::All => Some(surface.point),
            Free::Some(mesh) => Some(nearest(mesh).point),
            Free::None => None,
        }
    }

    /// Depth of a point, m; negative outside.
    pub(super) fn depth(&self, x: DVec3) -> f64 {
        -self.distance(x, f64::MAX).expect("every point has a nearest triangle")
    }

    /// Low and high corner of the bounding box, m.
    pub(super) fn bounds(&self) -> [DVec3; 2] {
        let bounds = self.all.local_aabb();
        [bounds.mins, bounds.maxs]
    }
}

/// An obstacle at one time: boundary and signed distance.
#[derive(Clone, Debug)]
pub(super) struct Body {
    /// Boundary with normals out of the solid.
    pub(super) surface: Surface,
    solid: Solid,
    /// Centre of rotation and scaling of `placement`, m.
    centre: DVec3,
    placement: Placement,
    inside_out: bool,
}

/// A rigid displacement: x = pivot + rotation (X - pivot) + translate.
#[derive(Clone, Copy, Debug)]
pub(super) struct RigidDisplacement {
    pub(super) pivot: DVec3,
    pub(super) rotation: DMat3,
    pub(super) translate: DVec3,
}

impl RigidDisplacement {
    /// Displaced point, m.
    fn put(&self, x: DVec3) -> DVec3 {
        self.pivot + self.rotation * (x - self.pivot) + self.translate
    }
}

impl Body {
    /// The placed body of an obstacle, tessellated for the cells of the grid; `name` is for errors.
    pub(super) fn new(obstacle: &Obstacle, name: &str, grid: &Grid) -> Result<Body, Error> {
        Ok(Body::before_walls(obstacle, name, grid)?.beyond_walls(grid))
    }

    /// The body including its sides on walls.
    pub(super) fn before_walls(obstacle: &Obstacle, name: &str, grid: &Grid) -> Result<Body, Error> {
        let Obstacle { ref shape, placement, inside_out, .. } = *obstacle;
        // The placement scales the tessellation.
        let dx = grid.dx / placement.scale;
        let surface = match *shape {
            Shape::Box { min, max } => Surface::cuboid(min, max),
            Shape::Sphere { centre, radius } => Surface::sphere(centre, radius, dx),
            Shape::Cylinder { base, axis, radius, height } => Surface::cylinder(base, axis, radius, height, dx),
            Shape::Mesh { ref file, unit } => read_surface(file, unit).map_err(|error| error.within(name))?,
            Shape::HalfSpace { .. } | Shape::Wave { .. } | Shape::Solitary(_) => {
                return Err(Error::input(
                    name,
                    "half spaces and waves have no closed surface",
                    "use a box, sphere, cylinder or mesh",
                ));
            }
        };
        let centre = shape.centre().unwrap_or_else(|| surface.centre());
        let placement = placement.about(centre);
        let surface = surface.placed(&placement, centre);
        if let Shape::Mesh { .. } = shape {
            ensure_in_domain(obstacle, &surface, name, grid.size())?;
        }
        // A mesh is placed as a whole; for other shapes query points are transformed back.
        let (solid, centre, placement) = match shape {
            Shape::Mesh { .. } => (Solid::mesh(&surface), DVec3::ZERO, Placement::default()),
            _ => (Solid::new(shape)?, centre, placement),
        };
        Ok(Body {
            surface: if inside_out { surface.inside_out() } else { surface },
            solid,
            centre,
            placement,
            inside_out,
        })
    }

    /// The body without its sides on walls.
    pub(super) fn beyond_walls(self, grid: &Grid) -> Body {
        let solid = self.solid.beyond_walls(grid, &self.placement, self.centre);
        Body { solid, ..self }
    }

    pub(super) fn moved(&self, rigid: &RigidDisplacement) -> Body {
        let Placement { translate, rotate, .. } = self.placement;
        Body {
            surface: self.surface.clone().map(|x| rigid.put(x)),
            solid: self.solid.clone(),
            placement: Placement {
                translate: rigid.put(self.centre + translate) - self.centre,
                rotate: rigid.rotation * rotate,
                ..self.placement
            },
            ..*self
        }
    }

    /// Contribution to the aperture far outside: -1 for a container.
    pub(super) fn at_infinity(&self) -> f64 {
        if self.inside_out { -1.0 } else { 0.0 }
    }

    pub(super) fn solid(&self) -> &Solid {
        &self.solid
    }

    pub(super) fn placement(&self) -> &Placement {
        &self.placement
    }

    /// Whether everything outside the shape is solid.
    pub(super) fn is_container(&self) -> bool {
        self.inside_out
    }

    /// Signed distance at a point, m, negative in the solid.
    pub(super) fn signed_distance(&self, x: DVec3) -> f64 {
        match self.inside_out {
            true => -self.shape_distance(x),
            false => self.shape_distance(x),
        }
    }

    /// Signed distance of the placed shape at a point, m; for a container its outside is not yet solid. Exact except beside
    /// removed sides on walls.
    fn shape_distance(&self, x: DVec3) -> f64 {
        let scale = self.placement.scale;
        scale * self.solid.distance(self.back(x))
    }

    /// The point x (m) in the coordinates of the shape.
    fn back(&self, x: DVec3) -> DVec3 {
        let Placement { translate, rotate, scale, .. } = self.placement;
        let back: DMat3 = rotate.transpose();
        self.centre + back * (x - self.centre - translate) / scale
    }

    /// Whether a point lies in the solid.
    pub(super) fn contains(&self, x: DVec3) -> bool {
        (self.shape_distance(x) < 0.0) != self.inside_out
    }

    /// Signed distance at all cell centres, m, clipped to [`BAND`] cells.
    pub(super) fn distance(&self, grid: &Grid) -> Vec<f64> {
        let [nx, ny, _] = grid.cells;
        let mut field = vec![0.0; grid.n_cells()];
        let rows = field.par_chunks_mut(nx).enumerate();
        rows.for_each(|(row, values)| self.row(grid, [0, row % ny, row / ny], values));
        field
    }

    /// Clipped signed distances along a row of cells that starts at [i, j, k].
    fn row(&self, grid: &Grid, [i, j, k]: [usize; 3], values: &mut [f64]) {
        let band = BAND * grid.dx;
        let centres = (i..i + values.len()).map(|i| grid.cell_centre([i, j, k]));
        match self.solid {
            Solid::Mesh(ref mesh) => mesh_row(mesh, band, centres.map(|x| self.back(x)), values),
            _ => {
                for (value, x) in values.iter_mut().zip(centres) {
                    *value = self.shape_distance(x);
                }
            }
        }
        for value in values {
            let distance = value.clamp(-band, band);
            *value = if self.inside_out { -distance } else { distance };
        }
    }

    /// Cells within [`BAND`] cells or inside, with their distances, in the order of cells.
    pub(super) fn near(&self, grid: &Grid) -> Vec<(usize, f64)> {
        let [low, high] = self.surface.bounds();
        let reach = BAND + 1.0;
        let range = |axis: usize| {
            let n = grid.cells[axis] as f64;
            let first = (low[axis] / grid.dx - reach).clamp(0.0, n) as usize;
            let end = (high[axis] / grid.dx + reach).ceil().clamp(0.0, n) as usize;
            match self.inside_out {
                true => 0..grid.cells[axis],
                false => first..end.max(first),
            }
        };
        let [is, js, ks] = [range(0), range(1), range(2)];
        let slab_cells = |k: usize| {
            let mut near = Vec::new();
            let mut row = vec![0.0; is.len()];
            for j in js.clone() {
                self.row(grid, [is.start, j, k], &mut row);
                let cells = is.clone().map(|i| grid.cell([i, j, k]));
                let here = cells.zip(row.iter().copied());
                near.extend(here.filter(|(_, distance)| *distance < BAND * grid.dx));
            }
            near
        };
        let slabs: Vec<Vec<(usize, f64)>> = ks.into_par_iter().map(slab_cells).collect();
        slabs.concat()
    }
}

/// Signed distances to a mesh along a row of cell centres, exact within the band and +-band beyond. The band is wider than a
/// cell, so no surface lies between two centres of which one is outside the band: the sign persists.
fn mesh_row(mesh: &ClosedMesh, band: f64, centres: impl Iterator<Item = DVec3>, values: &mut [f64]) {
    let mut last: Option<f64> = None;
    for (x, value) in centres.zip(values) {
        *value = mesh.distance(x, band).unwrap_or_else(|| {
            let signed = last.or_else(|| mesh.distance(x, f64::MAX));
            band.copysign(signed.expect("every point has a nearest triangle"))
        });
        last = Some(*value);
    }
}
