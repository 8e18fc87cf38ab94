//! Shapes, clipping, open face areas and the distance to obstacles, on the CPU in f64. parry lives here only.
//!
//! - [`Surface`]: closed triangle surfaces, from shapes and from mesh files ([`read_mesh`])
//! - [`clip`] and [`open_fractions`]: patches of a surface in the cells, and the open areas that close every cut cell
//! - [`cut_cells`]: what the obstacles of a scene leave of the grid
//! - [`SolidClip`]: what deforming solids leave of it in every sub-step, and [`Coupling`], their patches as lists to gather from
//! - [`TetMesh`], [`solid_meshes`]: the tetrahedra of solids, from shapes, files and closed surfaces
//! - [`Regions`], [`liquid_distance`], [`seed_markers`], [`initial_state`]: the liquid at the start

mod clip;
mod coupling;
mod distance;
mod icosahedron;
mod inside;
mod liquid;
mod mesh_file;
mod msh;
mod nearest;
mod parts;
mod solid_clip;
mod surface;
mod tet_fill;
mod tet_mesh;
mod tet_read;
mod tet_shapes;
mod vtu;

pub use clip::{Clipping, OpenFractions, Patch, clip, open_fractions};
pub use coupling::{CellNode, Coupling};
pub use inside::inside;
pub use liquid::{
    Regions, empty_regions, estimate_markers, initial_state, liquid_distance, seed_markers,
};
pub use mesh_file::{parse as parse_mesh, read as read_mesh};
pub use solid_clip::{MovedMesh, Nearest, Overlap, SolidClip};
pub use surface::{Fault, Surface};
pub use tet_fill::fill;
pub use tet_mesh::{ElementShape, TetMesh, solid_meshes};
pub use tet_read::{TetFile, parse as parse_tets, read as read_tets};

use crate::error::Error;
use crate::grid::{Axis, Grid};
use crate::scene::Scene;
use distance::{BAND, Body};

/// What the obstacles leave of the grid. Static: computed once.
#[derive(Clone, Debug)]
pub struct CutCells {
    /// Open fraction of every face per axis (host face layout, 0 to 1): clamped, domain walls closed.
    pub open: [Vec<f64>; 3],
    /// Signed distance of every cell centre to the obstacles, m; negative inside, exact within 3 cells of a surface and
    /// clipped to +-3 dx beyond. 3 dx everywhere without obstacles.
    pub solid_distance: Vec<f64>,
}

/// What the obstacles leave of the grid, and what of it other bodies add to.
#[derive(Clone, Debug)]
pub struct ObstacleCut {
    /// Open fraction of every face per axis, neither clamped nor closed at the walls.
    raw: [Vec<f64>; 3],
    /// The same, clamped and closed, with the distance.
    pub cut: CutCells,
}

impl ObstacleCut {
    /// What no obstacles leave: everything but the walls.
    pub fn none(grid: &Grid) -> ObstacleCut {
        let raw = Axis::ALL.map(|axis| vec![1.0; grid.n_faces(axis)]);
        let mut open = raw.clone();
        close_walls(grid, &mut open);
        let solid_distance = vec![BAND * grid.dx; grid.n_cells()];
        let cut = CutCells {
            open,
            solid_distance,
        };
        ObstacleCut { raw, cut }
    }
}

/// Largest difference between the start and the end of a line of open fractions that rounding explains.
const CLOSURE_TOLERANCE: f64 = 1e-12;

/// Open areas and distances of all obstacles of a scene. Their contributions to the open fractions add; the distance is that
/// of their union.
pub fn cut_cells(scene: &Scene, grid: &Grid) -> Result<CutCells, Error> {
    Ok(obstacle_cut(scene, grid)?.cut)
}

/// The same, for solids to be clipped on top of it.
pub fn obstacle_cut(scene: &Scene, grid: &Grid) -> Result<ObstacleCut, Error> {
    let mut solid_distance = vec![BAND * grid.dx; grid.n_cells()];
    let mut clippings = Vec::new();
    let mut start = 1.0;
    let mut tolerance = CLOSURE_TOLERANCE;
    for body in bodies(scene, grid) {
        let body = body?;
        start += body.at_infinity();
        clippings.push(clip(&body.surface, grid));
        for (union, body) in solid_distance.iter_mut().zip(body.distance(grid)) {
            *union = union.min(body);
        }
        // Positions carry their rounding into areas: 1e-12 is for bodies within 200 cells of the origin.
        let [low, high] = body.surface.bounds();
        let reach = low.abs().max(high.abs()).max_element() / (200.0 * grid.dx);
        tolerance = f64::max(tolerance, CLOSURE_TOLERANCE * reach);
    }
    let OpenFractions {
        faces: raw,
        closure_defect,
    } = open_fractions(grid, start, &clippings);
    if closure_defect > tolerance {
        return Err(Error::input(
            format!("{}: obstacle", scene.file.display()),
            format!(
                "along a grid line the open areas end {closure_defect:e} from where they start, allowed {tolerance:e}: a surface is not closed"
            ),
            "repair the surfaces of mesh obstacles, and keep bodies near the domain",
        ));
    }
    let clamped = |open: &f64| clamp_open(*open, scene.solver.area_clamp);
    let mut open = raw
        .each_ref()
        .map(|open| open.iter().map(clamped).collect());
    close_walls(grid, &mut open);
    let cut = CutCells {
        open,
        solid_distance,
    };
    Ok(ObstacleCut { raw, cut })
}

/// The surfaces of all obstacles, for pictures. Normals point to the liquid.
pub fn obstacle_surfaces(scene: &Scene, grid: &Grid) -> Result<Vec<Surface>, Error> {
    bodies(scene, grid).map(|body| Ok(body?.surface)).collect()
}

/// The obstacles thinner than a cell, by number, with their thickness in cells. Liquid leaks through them: the distance between
/// two centres on both sides of a plate is never negative, so markers do not see it. Containers have no thickness.
pub fn thin_obstacles(scene: &Scene, grid: &Grid) -> Result<Vec<(usize, f64)>, Error> {
    let mut thin = Vec::new();
    for (number, body) in bodies(scene, grid).enumerate() {
        let thickness = body?.thickness() / grid.dx;
        if thickness < 1.0 - 1e-6 {
            thin.push((number, thickness));
        }
    }
    Ok(thin)
}

/// The solids thinner than a cell, by number, with their thickness in cells: what is true of obstacles is of solids.
pub fn thin_solids(mesh: &MovedMesh, grid: &Grid) -> Vec<(usize, f64)> {
    let Some(closed) = mesh.closed() else {
        return Vec::new();
    };
    let bodies = mesh.triangles_of_bodies().into_iter().enumerate();
    bodies
        .map(|(number, triangles)| (number, closed.thickness_at(triangles.into_iter()) / grid.dx))
        .filter(|(_, thickness)| *thickness < 1.0 - 1e-6)
        .collect()
}

fn bodies(scene: &Scene, grid: &Grid) -> impl Iterator<Item = Result<Body, Error>> {
    let file = scene.file.display();
    let obstacles = scene.obstacles.iter().enumerate();
    obstacles.map(move |(number, obstacle)| {
        Body::new(obstacle, &format!("{file}: obstacle[{number}]"), grid)
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

/// Closes the faces on the walls of the domain.
fn close_walls(grid: &Grid, open: &mut [Vec<f64>; 3]) {
    for (axis, open) in Axis::ALL.into_iter().zip(open) {
        for (face, open) in open.iter_mut().enumerate() {
            let at = grid.face_at(axis, face)[axis.index()];
            if at == 0 || at == grid.cells[axis.index()] {
                *open = 0.0;
            }
        }
    }
}
