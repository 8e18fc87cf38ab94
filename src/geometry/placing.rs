//! Places and sizes of bodies before the first sub-step: whether a mesh reaches the domain, whether it is in another unit than m,
//! and which solids lie in each other.

use std::path::Path;

use glam::DVec3;
use rayon::prelude::*;

use super::liquid::Regions;
use super::{MovedMesh, Surface, mesh_file};
use crate::error::{Error, rounded};
use crate::grid::Grid;
use crate::scene::{Obstacle, Placement, Scene, Shape};

/// A mesh so many times as long as the domain is likely in another unit: 1 m of a domain is 39 in, 100 cm or 1000 mm.
const OTHER_UNIT: f64 = 20.0;

/// The question after the unit, for a mesh that is far too large.
const UNIT_CURE: &str = "is it in mm? then write units = \"mm\" beside its file (\"cm\" and \"in\" are units too), else make it \
                         smaller with placement.scale";

/// Reads a closed surface whose coordinates are in a unit (m).
pub(super) fn read_surface(file: &Path, unit: f64) -> Result<Surface, Error> {
    Ok(mesh_file::read(file)?.map(|x| unit * x))
}

impl Surface {
    /// Middle of the bounding box, m.
    pub(super) fn centre(&self) -> DVec3 {
        let [low, high] = self.bounds();
        0.5 * (low + high)
    }
}

/// A point as it stands in a message.
fn point(x: DVec3) -> DVec3 {
    DVec3::from(x.to_array().map(rounded))
}

/// Whether a box (m) and the domain have a point inside both.
pub(super) fn reaches([low, high]: [DVec3; 2], size: DVec3) -> bool {
    high.cmpgt(DVec3::ZERO).all() && low.cmplt(size).all()
}

/// The error of a mesh with these bounds (m) that lies outside the domain.
pub(super) fn outside([low, high]: [DVec3; 2], size: DVec3, name: &str) -> Error {
    let cure = match (high - low).max_element() > OTHER_UNIT * size.max_element() {
        true => UNIT_CURE,
        false => "move it with placement.at, the place of its middle, so that a part lies inside",
    };
    Error::input(
        name,
        format!(
            "lies outside the domain: its mesh goes from {} to {} m, the domain from the origin to {size} m",
            point(low),
            point(high)
        ),
        cure,
    )
}

/// Refuses a mesh obstacle that lies outside the domain, and does not come in. `surface`: where its placement puts it.
pub(super) fn ensure_in_domain(
    obstacle: &Obstacle,
    surface: &Surface,
    name: &str,
    size: DVec3,
) -> Result<(), Error> {
    let [low, high] = surface.bounds();
    let frames = obstacle.motion.iter().flat_map(|motion| &motion.keyframes);
    // A turn may take it in from anywhere.
    let comes_in = frames.into_iter().any(|frame| {
        frame.angle != 0.0 || reaches([low + frame.translate, high + frame.translate], size)
    });
    match comes_in || reaches([low, high], size) {
        true => Ok(()),
        false => Err(outside([low, high], size, name)),
    }
}

/// Refuses the file of a solid whose bounding box (m) is far larger than the domain.
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
    let problem = format!(
        "its mesh is {} m long, the domain {} m",
        rounded(extent),
        size.max_element()
    );
    Err(Error::input(name, problem, UNIT_CURE))
}

/// The meshes of obstacles and of regions that are far larger than the domain: their key and length, m.
///
/// # Errors
/// [`Error::Input`] when a mesh file cannot be used.
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
            let surface =
                read_surface(file, *unit).map_err(|error| error.within(&scene.at(&key)))?;
            let [low, high] = surface.bounds();
            let extent = scale * (high - low).max_element();
            if extent > OTHER_UNIT * scene.domain.size.max_element() {
                large.push((key, extent));
            }
        }
    }
    Ok(large)
}

/// Cells that [`liquid_height`] looks at, about.
const HEIGHT_SAMPLES: usize = 1 << 18;

/// Height of the liquid at the start along gravity, m: from its deepest to its highest cell. 0 without gravity or liquid.
///
/// # Errors
/// [`Error::Input`] when a mesh file cannot be used.
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

/// Two solids that lie in each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidOverlap {
    /// Numbers of the solids.
    pub solids: [usize; 2],
    /// Greatest depth found of a point of one in the other, m.
    pub depth: f64,
    /// That point, m.
    pub at: DVec3,
}

/// Depth of an overlap that counts, as a part of the longest side of the smaller body: bodies that touch are off by rounding, and round
/// ones by their chords.
const OVERLAP: f64 = 1e-3;

/// The pairs of solids that lie in each other, found by their nodes and the middles of their elements.
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
        let depths = [(a, b), (b, a)].into_iter().flat_map(|(of, within)| {
            let near = points(of).filter(|x| x.cmpge(low).all() && x.cmple(high).all());
            near.map(|x| (closed[within].depth(x), x))
                .collect::<Vec<_>>()
        });
        let (depth, at) = depths.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let solids = [a, b];
        (depth > least).then_some(SolidOverlap { solids, depth, at })
    };
    let pairs = (0..closed.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
    pairs.filter_map(|(a, b)| overlap(a, b)).collect()
}
