//! Checks of bodies before the first sub-step: positions in the domain, units of mesh files, overlaps of solids.

use glam::DVec3;
use rayon::prelude::*;

use super::liquid::Regions;
use super::{MovedMesh, Surface, mesh_file};
use crate::error::{Error, rounded};
use crate::grid::Grid;
use crate::scene::{MeshFile, Obstacle, Placement, Scene, Shape, box_reaches};

/// A mesh longer than this many domains is probably in another unit: 1 m is 39 in, 100 cm or 1000 mm.
const OTHER_UNIT: f64 = 20.0;

const UNIT_CURE: &str = "is it in mm or cm? then write units = \"mm\" or \"cm\" beside its file (\"in\" is a unit too), else \
                         shrink it with placement.scale";

/// The closed surface of a file (m) with coordinates in `unit` (m).
pub(super) fn read_surface(file: &MeshFile, unit: f64) -> Result<Surface, Error> {
    let surface = file.contents(mesh_file::read)?;
    Ok(Surface::clone(&surface).map(|x| unit * x))
}

/// A point with the digits of a message.
fn point(x: DVec3) -> DVec3 {
    DVec3::from(x.to_array().map(rounded))
}

/// The error of a mesh with these bounds (m) outside the domain.
pub(super) fn outside([low, high]: [DVec3; 2], size: DVec3, name: &str) -> Error {
    let cure = match (high - low).max_element() > OTHER_UNIT * size.max_element() {
        true => UNIT_CURE,
        false => "move it with placement.at, the position of its centre, so that a part lies inside",
    };
    Error::input(
        name,
        format!(
            "lies outside the domain: its mesh extends from {} to {} m, the domain from the origin to {size} m",
            point(low),
            point(high)
        ),
        cure,
    )
}

/// Refuses a mesh obstacle that never reaches the domain; `surface` is placed, before the motion.
pub(super) fn ensure_in_domain(obstacle: &Obstacle, surface: &Surface, name: &str, size: DVec3) -> Result<(), Error> {
    let bounds = surface.bounds();
    let motion = obstacle.motion.as_ref();
    let moves_in = motion.is_some_and(|motion| motion.may_reach(bounds, size));
    match moves_in || box_reaches(bounds, size) {
        true => Ok(()),
        false => Err(outside(bounds, size, name)),
    }
}

/// Refuses the file of a solid with a bounding box (m) far larger than the domain.
pub(super) fn ensure_size(
    [low, high]: [DVec3; 2],
    placement: &Placement,
    name: &str,
    size: DVec3,
) -> Result<(), Error> {
    let extent = placement.scale * (high - low).max_element();
    if extent <= OTHER_UNIT * size.max_element() {
        return Ok(());
    }
    let problem = format!("its mesh is {} m long, the domain {} m", rounded(extent), size.max_element());
    Err(Error::input(name, problem, UNIT_CURE))
}

/// Keys and lengths (m) of the meshes of obstacles and regions that are far larger than the domain.
pub fn large_meshes(scene: &Scene) -> Result<Vec<(String, f64)>, Error> {
    let obstacles = scene.obstacles.iter().enumerate();
    let obstacles = obstacles.map(|(number, obstacle)| {
        let key = format!("obstacle[{number}]");
        (key, &obstacle.shape, obstacle.placement.scale)
    });
    let regions = scene.liquid.iter().flat_map(|liquid| &liquid.regions);
    let regions = regions.enumerate().map(|(number, region)| {
        let key = format!("liquid.region[{number}]");
        (key, &region.shape, region.placement.scale)
    });
    let mut large = Vec::new();
    for (key, shape, scale) in obstacles.chain(regions) {
        if let Shape::Mesh { file, unit } = shape {
            let surface = read_surface(file, *unit).map_err(|error| error.within(&scene.at(&key)))?;
            let [low, high] = surface.bounds();
            let extent = scale * (high - low).max_element();
            if extent > OTHER_UNIT * scene.domain.size.max_element() {
                large.push((key, extent));
            }
        }
    }
    Ok(large)
}

/// Approximate number of cells that [`liquid_height`] samples.
const HEIGHT_SAMPLES: usize = 1 << 18;

/// Initial height of the liquid along gravity, m, from its lowest to its highest cell. 0 without gravity or liquid.
pub fn liquid_height(scene: &Scene, grid: &Grid) -> Result<f64, Error> {
    let (Some(liquid), Some(down)) = (&scene.liquid, scene.domain.gravity.try_normalize()) else {
        return Ok(0.0);
    };
    let regions = Regions::new(liquid, grid.size(), |key| scene.at(key))?;
    let every = (grid.n_cells() / HEIGHT_SAMPLES) | 1;
    let cells = (0..grid.n_cells()).into_par_iter().step_by(every);
    let wet = cells.filter_map(|cell| {
        let x = grid.cell_centre(grid.cell_at(cell));
        (regions.distance(x) < 0.0).then(|| [x.dot(down); 2])
    });
    let none = [f64::INFINITY, f64::NEG_INFINITY];
    let [low, high] = wet.reduce(|| none, |a, b| [a[0].min(b[0]), a[1].max(b[1])]);
    Ok(match low <= high {
        true => high - low + grid.dx,
        false => 0.0,
    })
}

/// Two solids that overlap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidOverlap {
    /// Numbers of the solids.
    pub solids: [usize; 2],
    /// Greatest depth of a sample point of one solid in the other, m.
    pub depth: f64,
    /// That point, m.
    pub at: DVec3,
}

/// Least depth of an overlap, relative to the longest side of the smaller body. Touching bodies overlap by rounding and by chords.
const OVERLAP: f64 = 1e-3;

/// Pairs of overlapping solids. Samples are the nodes and the centres of the elements.
pub fn solid_overlaps(mesh: &MovedMesh) -> Vec<SolidOverlap> {
    let closed = mesh.closed_bodies();
    let bounds: Vec<[DVec3; 2]> = closed.iter().map(|body| body.bounds()).collect();
    let points = |body: usize| {
        let elements = &mesh.elements[mesh.bodies[body].clone()];
        let corners = |element: &[u32; 4]| element.map(|node| mesh.nodes[node as usize]);
        elements.iter().flat_map(move |element| {
            let corners = corners(element);
            let middle = 0.25 * corners.iter().sum::<DVec3>();
            corners.into_iter().chain([middle])
        })
    };
    let overlap = |a: usize, b: usize| {
        let low = bounds[a][0].max(bounds[b][0]);
        let high = bounds[a][1].min(bounds[b][1]);
        if low.cmpgt(high).any() {
            return None;
        }
        let side = |body: usize| (bounds[body][1] - bounds[body][0]).max_element();
        let least = OVERLAP * side(a).min(side(b));
        let depths = [(a, b), (b, a)].into_iter().flat_map(|(body, other)| {
            let near = points(body).filter(|x| x.cmpge(low).all() && x.cmple(high).all());
            near.map(|x| (closed[other].depth(x), x)).collect::<Vec<_>>()
        });
        let (depth, at) = depths.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let solids = [a, b];
        (depth > least).then_some(SolidOverlap { solids, depth, at })
    };
    let pairs = (0..closed.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
    pairs.filter_map(|(a, b)| overlap(a, b)).collect()
}
