//! Shapes, clipping, face apertures and distances to obstacles, on the CPU in f64. The only room that uses parry.
//!
//! - [`Surface`]: closed triangle surfaces, from shapes and from mesh files ([`read_mesh`])
//! - [`clip`] and [`open_fractions`]: patches of a surface in the cells, and apertures that close every cut cell
//! - [`cut_cells`]: apertures and distances of the obstacles of a scene
//! - [`ObstacleCut`]: the same with moving obstacles, in every sub-step
//! - [`SolidClip`]: the same with deforming solids, and [`Coupling`], their patches as sparse lists by cell and by node
//! - [`ContactField`]: distance and motion of the obstacles as nodes of solids meet them
//! - [`contact_pairs`], [`contact_hits`]: contact candidates between the surfaces of bodies, now and in a motion
//! - [`RenderMesh`], [`Embedding`]: meshes of files with their texture coordinates, moved by tetrahedra
//! - [`TetMesh`], [`solid_meshes`]: tetrahedra of solids, from shapes, files and closed surfaces
//! - [`SourcesAndSinks`]: sources and sinks as cells and faces of the grid
//! - [`Regions`], [`LiquidSurface`], [`liquid_distance`], [`seed_markers`], [`initial_state`]: the initial liquid

mod body_contacts;
mod clip;
mod contact_field;
mod counting_sort;
mod coupling;
mod crossing;
mod disjoint_sets;
mod distance;
mod embedding;
mod gltf;
mod icosahedron;
mod inside;
mod liquid;
mod mesh_file;
mod msh;
mod nearest;
mod obj;
mod obstacles;
mod parts;
mod placing;
mod ply;
mod polygon;
mod render_mesh;
mod solid_clip;
mod solitary;
mod sources_sinks;
mod stl;
mod surface;
mod symmetry;

mod tet_fill;
mod tet_mesh;
mod tet_read;
mod tet_shapes;
mod thickness;
mod vtu;

pub use body_contacts::{ContactPair, Reach, contact_hits, contact_pairs};
pub use clip::{Clipping, OpenFractions, Patch, clip, open_fractions};
pub use contact_field::{ContactField, RigidVelocity, SurfaceFriction};
pub use coupling::{CellNode, Coupling};
pub use embedding::Embedding;
pub use inside::inside;
pub use liquid::{
    LiquidSurface, Regions, empty_regions, estimate_markers, initial_speed, initial_state, liquid_distance,
    seed_markers,
};
pub use mesh_file::{parse as parse_mesh, read as read_mesh};
pub use obstacles::{ObstacleCut, ObstacleSurfaces, deepest_obstacle, obstacle_cut};
pub use placing::{SolidOverlap, large_meshes, liquid_height, solid_overlaps};
pub use render_mesh::{RenderMesh, read_render_mesh};
pub use solid_clip::{MovedMesh, MovingWall, Nearest, Overlap, SolidClip};
pub use sources_sinks::{
    Fill, Lattice, MARKERS_PER_CELL, MOST_SITES, OCTANT_UNITS, PrescribedFace, Running, SourceFace, SourceFlow,
    SourcesAndSinks,
};
pub use surface::{Fault, Surface};
pub use tet_fill::fill;
pub use tet_mesh::{ElementShape, TetMesh, rest_from_file, solid_meshes};
pub use tet_read::{TetFile, parse as parse_tets, read as read_tets};
pub use thickness::{ThinWall, layers_across, thin_obstacles, thin_solids};

pub(crate) use counting_sort::counting_sort;
pub(crate) use disjoint_sets::DisjointSets;
pub(crate) use surface::bounds;

use glam::{DMat3, DVec3};

use crate::error::Error;
use crate::grid::{Axis, Grid, Sides};
use crate::scene::{ProbeKind, Scene};
use distance::Body;

/// The grid cut by obstacles, and by solids in liquid.
#[derive(Clone, Debug, Default)]
pub struct CutCells {
    /// Face apertures per axis (host face layout, 0 to 1), clamped; 0 on the walls of the domain.
    pub open: [Vec<f64>; 3],
    /// Signed distance of every cell centre to the bodies, m, negative inside: exact within 3 cells of a surface, elsewhere +-3 dx.
    pub solid_distance: Vec<f64>,
}

/// Apertures and distances of the obstacles at the start.
pub fn cut_cells(scene: &Scene, grid: &Grid) -> Result<CutCells, Error> {
    Ok(obstacle_cut(scene, grid)?.cut)
}

/// Numbers of the probes of pressure and velocity with a point in an obstacle at the start.
pub fn covered_probes(scene: &Scene, grid: &Grid) -> Result<Vec<usize>, Error> {
    let probes = scene.probes.iter().enumerate();
    let points = probes.filter_map(|(number, probe)| match probe.kind {
        ProbeKind::Pressure { point } | ProbeKind::Velocity { point } => Some((number, point)),
        _ => None,
    });
    let points: Vec<(usize, DVec3)> = points.collect();
    if points.is_empty() || scene.obstacles.is_empty() {
        return Ok(Vec::new());
    }
    let distance = cut_cells(scene, grid)?.solid_distance;
    let covered = points.into_iter().filter(|&(_, point)| grid.sample_cells(&distance, point) < 0.0);
    Ok(covered.map(|(number, _)| number).collect())
}

/// The obstacles as placed, before their motion.
fn bodies(scene: &Scene, grid: &Grid) -> impl Iterator<Item = Result<Body, Error>> {
    let obstacles = scene.obstacles.iter().enumerate();
    obstacles.map(move |(number, obstacle)| Body::new(obstacle, &scene.at(&format!("obstacle[{number}]")), grid))
}

/// a b^T
pub(crate) fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// Open volume fraction of a cell, 0 to 1, from the obstacle distance at its centre (m).
pub fn open_volume(solid_distance: f64, dx: f64) -> f64 {
    (0.5 + solid_distance / dx).clamp(0.0, 1.0)
}

/// An aperture in \[0, 1\]: 0 below `area_clamp`, 1 above 1 - `area_clamp`.
fn clamp_open(open: f64, area_clamp: f64) -> f64 {
    if open < area_clamp {
        0.0
    } else if open > 1.0 - area_clamp {
        1.0
    } else {
        open
    }
}

/// Closes the faces on the walls of the domain; faces on open sides remain.
fn close_walls(grid: &Grid, open_sides: Sides, open: &mut [Vec<f64>; 3]) {
    for (axis, open) in Axis::ALL.into_iter().zip(open) {
        for (face, open) in open.iter_mut().enumerate() {
            if is_wall(grid, open_sides, axis, grid.face_at(axis, face)) {
                *open = 0.0;
            }
        }
    }
}

/// Whether a face lies on a wall of the domain.
fn is_wall(grid: &Grid, open_sides: Sides, axis: Axis, face: [usize; 3]) -> bool {
    grid.wall(axis, face).is_some_and(|side| !open_sides.has(axis, side))
}
