//! Shapes, clipping, open face areas and the distance to obstacles, on the CPU in f64. parry lives here only.
//!
//! - [`Surface`]: closed triangle surfaces, from shapes and from mesh files ([`read_mesh`])
//! - [`clip`] and [`open_fractions`]: patches of a surface in the cells, and the open areas that close every cut cell
//! - [`cut_cells`]: what the obstacles of a scene leave of the grid
//! - [`ObstacleCut`]: the same with obstacles that move, in every sub-step
//! - [`SolidClip`]: what deforming solids leave of that, and [`Coupling`], their patches as lists to gather from
//! - [`TetMesh`], [`solid_meshes`]: the tetrahedra of solids, from shapes, files and closed surfaces
//! - [`Taps`]: sources and sinks as cells and faces of the grid
//! - [`Regions`], [`liquid_distance`], [`seed_markers`], [`initial_state`]: the liquid at the start

mod clip;
mod coupling;
mod crossing;
mod distance;
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
mod solid_clip;
mod solitary;
mod stl;
mod surface;
mod taps;
mod tet_fill;
mod tet_mesh;
mod tet_read;
mod tet_shapes;
mod thickness;
mod vtu;

pub use clip::{Clipping, OpenFractions, Patch, clip, open_fractions};
pub use coupling::{CellNode, Coupling};
pub use inside::inside;
pub use liquid::{
    Regions, empty_regions, estimate_markers, initial_speed, initial_state, liquid_distance,
    seed_markers,
};
pub use mesh_file::{parse as parse_mesh, read as read_mesh};
pub use obstacles::{ObstacleCut, ObstacleSurfaces, deepest_obstacle, obstacle_cut};
pub use placing::{SolidOverlap, large_meshes, liquid_height, solid_overlaps};
pub use solid_clip::{MovedMesh, Nearest, Overlap, Place, SolidClip};
pub use surface::{Fault, Surface};
pub use taps::{PER_CELL, PrescribedFace, Running, SourceFace, SourceFlow, Taps};
pub use tet_fill::fill;
pub use tet_mesh::{ElementShape, TetMesh, solid_meshes};
pub use tet_read::{TetFile, parse as parse_tets, read as read_tets};
pub use thickness::{ThinWall, layers_across, thin_obstacles, thin_solids};

use glam::DVec3;

use crate::error::Error;
use crate::grid::{Axis, Grid, Sides};
use crate::scene::{ProbeKind, Scene};
use distance::Body;

/// What obstacles, and solids in liquid, leave of the grid.
#[derive(Clone, Debug, Default)]
pub struct CutCells {
    /// Open fraction of every face per axis (host face layout, 0 to 1): clamped, domain walls closed but for open sides.
    pub open: [Vec<f64>; 3],
    /// Signed distance of every cell centre to the obstacles, m; negative inside, exact within 3 cells of a surface and
    /// clipped to +-3 dx beyond. 3 dx everywhere without obstacles.
    pub solid_distance: Vec<f64>,
}

/// Open areas and distances of all obstacles of a scene. Their contributions to the open fractions add; the distance is that
/// of their union.
pub fn cut_cells(scene: &Scene, grid: &Grid) -> Result<CutCells, Error> {
    Ok(obstacle_cut(scene, grid)?.cut)
}

/// The probes of pressure and velocity whose point lies in an obstacle at the start, by number.
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
    let covered = points
        .into_iter()
        .filter(|&(_, point)| grid.sample_cells(&distance, point) < 0.0);
    Ok(covered.map(|(number, _)| number).collect())
}

/// Obstacles where their placements put them.
fn bodies(scene: &Scene, grid: &Grid) -> impl Iterator<Item = Result<Body, Error>> {
    let obstacles = scene.obstacles.iter().enumerate();
    obstacles.map(move |(number, obstacle)| {
        Body::new(obstacle, &scene.at(&format!("obstacle[{number}]")), grid)
    })
}

/// Share of a cell's volume that obstacles leave open, 0 to 1, from the obstacle distance at its centre (m).
pub fn open_volume(solid_distance: f64, dx: f64) -> f64 {
    (0.5 + solid_distance / dx).clamp(0.0, 1.0)
}

/// An open fraction in \[0, 1\]: 0 below `area_clamp`, 1 above 1 - `area_clamp`.
fn clamp_open(open: f64, area_clamp: f64) -> f64 {
    if open < area_clamp {
        0.0
    } else if open > 1.0 - area_clamp {
        1.0
    } else {
        open
    }
}

/// Closes the faces on the walls of the domain. Those of open sides stay as bodies leave them.
fn close_walls(grid: &Grid, open_sides: Sides, open: &mut [Vec<f64>; 3]) {
    for (axis, open) in Axis::ALL.into_iter().zip(open) {
        for (face, open) in open.iter_mut().enumerate() {
            if is_wall(grid, open_sides, axis, grid.face_at(axis, face)) {
                *open = 0.0;
            }
        }
    }
}

/// Whether a face lies on a side of the domain that is a wall.
fn is_wall(grid: &Grid, open_sides: Sides, axis: Axis, face: [usize; 3]) -> bool {
    grid.wall(axis, face)
        .is_some_and(|side| !open_sides.has(axis, side))
}
