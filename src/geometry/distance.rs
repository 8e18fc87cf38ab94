//! Signed distances of the shapes of a scene: exact, negative inside.

use glam::{DMat3, DVec3};
use parry3d_f64::query::{PointQueryWithLocation, Ray, RayCast};
use parry3d_f64::shape::{TriMesh, TriMeshFlags};
use rayon::prelude::*;

use super::Surface;
use super::mesh_file;
use crate::error::Error;
use crate::grid::Grid;
use crate::scene::{Obstacle, Placement, Shape};

/// Half the width of the band in which obstacle distances are exact, cells.
pub(super) const BAND: f64 = 3.0;

/// Most rays that look for the thickness of a mesh.
const THICKNESS_RAYS: usize = 1024;

/// A shape with its signed distance.
pub(super) enum Solid {
    /// Axis-aligned; a side at infinity is no side.
    Box { min: DVec3, max: DVec3 },
    /// A ball.
    Sphere { centre: DVec3, radius: f64 },
    /// A right circular cylinder along a unit axis, between two heights above a point; a height at infinity is no side.
    Cylinder {
        point: DVec3,
        axis: DVec3,
        radius: f64,
        heights: [f64; 2],
    },
    /// Behind a plane.
    HalfSpace { point: DVec3, normal: DVec3 },
    /// Below a wave.
    Wave {
        level: f64,
        amplitude: f64,
        wave_number: [f64; 2],
        phase: f64,
    },
    /// Inside a closed mesh.
    Mesh(Box<TriMesh>),
}

impl Solid {
    /// The solid of a shape; reads the file of a mesh.
    pub(super) fn new(shape: &Shape) -> Result<Solid, Error> {
        Ok(match *shape {
            Shape::Box { min, max } => Solid::Box { min, max },
            Shape::Sphere { centre, radius } => Solid::Sphere { centre, radius },
            Shape::Cylinder {
                base,
                axis,
                radius,
                height,
            } => Solid::Cylinder {
                point: base,
                axis,
                radius,
                heights: [0.0, height],
            },
            Shape::HalfSpace { point, normal } => Solid::HalfSpace { point, normal },
            Shape::Wave {
                level,
                amplitude,
                wave_number,
                phase,
            } => Solid::Wave {
                level,
                amplitude,
                wave_number,
                phase,
            },
            Shape::Mesh { ref file } => Solid::mesh(&mesh_file::read(file)?),
        })
    }

    /// The inside of a closed surface.
    fn mesh(surface: &Surface) -> Solid {
        let mesh = TriMesh::with_flags(
            surface.vertices.clone(),
            surface.triangles.clone(),
            TriMeshFlags::ORIENTED,
        )
        .expect("a surface without fault has triangles");
        Solid::Mesh(Box::new(mesh))
    }

    /// Signed distance at a point, m. Exact but for waves: their value over the length of its gradient, which is right to
    /// first order near the surface and has the right sign everywhere.
    pub(super) fn distance(&self, x: DVec3) -> f64 {
        match *self {
            Solid::Box { min, max } => {
                let sides = (min - x).max(x - max);
                from_sides(sides.max_element(), sides.max(DVec3::ZERO).length())
            }
            Solid::Sphere { centre, radius } => (x - centre).length() - radius,
            Solid::Cylinder {
                point,
                axis,
                radius,
                heights: [low, high],
            } => {
                let height = (x - point).dot(axis);
                let round = (x - point - height * axis).length() - radius;
                let flat = (low - height).max(height - high);
                from_sides(round.max(flat), round.max(0.0).hypot(flat.max(0.0)))
            }
            Solid::HalfSpace { point, normal } => (x - point).dot(normal),
            Solid::Wave {
                level,
                amplitude,
                wave_number: [kx, kz],
                phase,
            } => {
                let (sin, cos) = (kx * x.x + kz * x.z + phase).sin_cos();
                let slope = amplitude * sin * kx.hypot(kz);
                (x.y - level - amplitude * cos) / 1.0_f64.hypot(slope)
            }
            Solid::Mesh(ref mesh) => {
                mesh_distance(mesh, x, f64::MAX).expect("every point has a nearest triangle")
            }
        }
    }

    /// The solid with its flat sides that lie on or beyond a wall of the domain moved away to infinity, so that its distance
    /// does not see them.
    pub(super) fn beyond_walls(self, grid: &Grid) -> Solid {
        // Far above the rounding of a scene's numbers and far below anything that a cell can tell.
        let near = 1e-6 * grid.dx;
        let size = grid.size();
        match self {
            Solid::Box { min, max } => Solid::Box {
                min: DVec3::select(min.cmple(DVec3::splat(near)), DVec3::NEG_INFINITY, min),
                max: DVec3::select(max.cmpge(size - near), DVec3::INFINITY, max),
            },
            Solid::Cylinder {
                point,
                axis,
                radius,
                heights,
            } => {
                // The way out through each flat side, and whether that side lies on the wall in that direction.
                let on_wall = |height: f64, out: DVec3| {
                    let centre = point + height * axis;
                    (0..3).any(|a| {
                        (out[a] > 1.0 - 1e-12 && centre[a] >= size[a] - near)
                            || (out[a] < -1.0 + 1e-12 && centre[a] <= near)
                    })
                };
                let [low, high] = heights;
                Solid::Cylinder {
                    point,
                    axis,
                    radius,
                    heights: [
                        if on_wall(low, -axis) {
                            f64::NEG_INFINITY
                        } else {
                            low
                        },
                        if on_wall(high, axis) {
                            f64::INFINITY
                        } else {
                            high
                        },
                    ],
                }
            }
            other => other,
        }
    }
}

/// The distance of a convex solid from the largest of the distances to its sides and, outside, the length of those above 0.
fn from_sides(largest: f64, outside: f64) -> f64 {
    if largest > 0.0 { outside } else { largest }
}

/// Signed distance to a closed mesh if it is at most `reach`; the sign by angle-weighted pseudo-normals (Baerentzen and
/// Aanaes 2005).
fn mesh_distance(mesh: &TriMesh, x: DVec3, reach: f64) -> Option<f64> {
    let (nearest, _) = mesh.project_local_point_and_get_location_with_max_dist(x, false, reach)?;
    let distance = (x - nearest.point).length();
    Some(if nearest.is_inside {
        -distance
    } else {
        distance
    })
}

impl Surface {
    /// As [`Body::thickness`], `mesh` being the same surface.
    fn thickness(&self, mesh: &TriMesh) -> f64 {
        let [low, high] = self.bounds();
        let size = (high - low).length();
        let every = self.triangles.len().div_ceil(THICKNESS_RAYS);
        let ways = self.triangles.iter().step_by(every).filter_map(|triangle| {
            let [a, b, c] = triangle.map(|vertex| self.vertices[vertex as usize]);
            let inwards = -(b - a).cross(c - a).try_normalize()?;
            // From just below the triangle, so that it is not hit itself.
            let start = (a + b + c) / 3.0 + 1e-9 * size * inwards;
            mesh.cast_local_ray(&Ray::new(start, inwards), size, false)
        });
        ways.fold(f64::INFINITY, f64::min)
    }
}

/// An obstacle: its boundary and its signed distance.
pub(super) struct Body {
    /// Its boundary, normals out of the solid.
    pub(super) surface: Surface,
    solid: Solid,
    centre: DVec3,
    placement: Placement,
    inside_out: bool,
}

impl Body {
    /// The body of an obstacle, tessellated for cells of size `dx`; `name` is for errors.
    pub(super) fn new(obstacle: &Obstacle, name: &str, dx: f64) -> Result<Body, Error> {
        let Obstacle {
            ref shape,
            placement,
            inside_out,
        } = *obstacle;
        // The tessellation is scaled with the placement.
        let dx = dx / placement.scale;
        let surface = match *shape {
            Shape::Box { min, max } => Surface::cuboid(min, max),
            Shape::Sphere { centre, radius } => Surface::sphere(centre, radius, dx),
            Shape::Cylinder {
                base,
                axis,
                radius,
                height,
            } => Surface::cylinder(base, axis, radius, height, dx),
            Shape::Mesh { ref file } => mesh_file::read(file)?,
            Shape::HalfSpace { .. } | Shape::Wave { .. } => {
                return Err(Error::input(
                    name,
                    "half spaces and waves have no closed surface",
                    "use a box, sphere, cylinder or mesh",
                ));
            }
        };
        let [low, high] = surface.bounds();
        let centre = shape.centre().unwrap_or(0.5 * (low + high));
        let surface = surface.placed(&placement, centre);
        // A mesh is turned as a whole; the other shapes turn the point back.
        let solid = match shape {
            Shape::Mesh { .. } => Solid::mesh(&surface),
            _ => Solid::new(shape)?,
        };
        Ok(Body {
            surface: if inside_out {
                surface.inside_out()
            } else {
                surface
            },
            solid,
            centre,
            placement,
            inside_out,
        })
    }

    /// What the body adds to the open fraction far outside everything: -1 where it fills the outside.
    pub(super) fn at_infinity(&self) -> f64 {
        if self.inside_out { -1.0 } else { 0.0 }
    }

    /// Least thickness, m: of a mesh the shortest way from the middle of a triangle straight through to the other side, at
    /// about a thousand triangles. Infinite for a container.
    pub(super) fn thickness(&self) -> f64 {
        let scale = self.placement.scale;
        match self.solid {
            _ if self.inside_out => f64::INFINITY,
            Solid::Box { min, max } => scale * (max - min).min_element(),
            Solid::Sphere { radius, .. } => scale * 2.0 * radius,
            Solid::Cylinder {
                radius,
                heights: [low, high],
                ..
            } => scale * (high - low).min(2.0 * radius),
            Solid::HalfSpace { .. } | Solid::Wave { .. } => f64::INFINITY,
            Solid::Mesh(ref mesh) => self.surface.thickness(mesh),
        }
    }

    /// Signed distance at a point, m, of the shape as placed, the right way out. Exact.
    fn of_shape(&self, x: DVec3) -> f64 {
        let Placement {
            translate,
            rotate,
            scale,
        } = self.placement;
        // The surface of a mesh is placed as a whole.
        if let Solid::Mesh(_) = self.solid {
            return self.solid.distance(x);
        }
        let back: DMat3 = rotate.transpose();
        let turned = back * (x - self.centre - translate) / scale;
        scale * self.solid.distance(self.centre + turned)
    }

    /// Whether a point lies in the solid.
    pub(super) fn holds(&self, x: DVec3) -> bool {
        (self.of_shape(x) < 0.0) != self.inside_out
    }

    /// Signed distance at all cell centres, m, clipped to [`BAND`] cells.
    pub(super) fn distance(&self, grid: &Grid) -> Vec<f64> {
        let band = BAND * grid.dx;
        let mut field = vec![0.0; grid.n_cells()];
        field
            .par_chunks_mut(grid.cells[0])
            .enumerate()
            .for_each(|(row, values)| {
                let [nx, ny, _] = grid.cells;
                let centre = |i| grid.cell_centre([i, row % ny, row / ny]);
                match self.solid {
                    Solid::Mesh(ref mesh) => mesh_row(mesh, band, (0..nx).map(centre), values),
                    _ => {
                        for (i, value) in values.iter_mut().enumerate() {
                            *value = self.of_shape(centre(i));
                        }
                    }
                }
                for value in values {
                    let distance = value.clamp(-band, band);
                    *value = if self.inside_out { -distance } else { distance };
                }
            });
        field
    }
}

/// Distance to a mesh along a row of cell centres: exact within the band, beyond it +-band. Between two neighbouring centres
/// of which one is further from the surface than the band, and the band is wider than a cell, there is no surface: the sign
/// stays.
fn mesh_row(mesh: &TriMesh, band: f64, centres: impl Iterator<Item = DVec3>, values: &mut [f64]) {
    let mut last: Option<f64> = None;
    for (x, value) in centres.zip(values) {
        *value = mesh_distance(mesh, x, band).unwrap_or_else(|| {
            let signed = last.or_else(|| mesh_distance(mesh, x, f64::MAX));
            band.copysign(signed.expect("every point has a nearest triangle"))
        });
        last = Some(*value);
    }
}
