//! Warnings before a run: bodies that the grid or mesh does not resolve, and materials for which the methods are
//! known to fail.

use glam::DVec3;

use super::solids_of;
use crate::Error;
use crate::elastic::{Body, Solids};
use crate::error::rounded;
use crate::geometry::{self, TetMesh, ThinWall};
use crate::grid::Grid;
use crate::scene::{Scene, Solid, SolidMesh};

/// Poisson's ratios above which linear tetrahedra lock in bending, with the elements across the thickness that
/// bending then needs. In the cantilever of docs/scene.md two layers leave 32 % of the deflection at 0.45, and four
/// leave 30 % at 0.49.
const LOCKS: [(f64, f64); 2] = [(0.47, 8.0), (0.4, 4.0)];
/// Length over thickness above which a body counts as bending.
const SLENDER: f64 = 4.0;
/// Young's modulus over the surrounding pressure below which a body collapses.
const SOFT: f64 = 2.0;

/// The warnings of a scene, one line each.
///
/// # Errors
/// [`Error::Input`] when a mesh is unusable, or a pin or load matches no node.
pub fn warnings(scene: &Scene) -> Result<Vec<String>, Error> {
    let grid = scene.grid();
    let mut warnings = Vec::new();
    if !scene.removed.is_empty() {
        let removed = scene.removed.join(", ");
        warnings.push(format!("--without also removes what refers to it: {removed}"));
    }
    for (key, length) in geometry::large_meshes(scene)? {
        warnings.push(format!(
            "{key} is {} m long, the domain {} m: is it in mm or cm? Then write units = \"mm\" or \"cm\" beside its file",
            rounded(length),
            scene.domain.size.max_element()
        ));
    }
    obstacle_warnings(scene, &grid, &mut warnings)?;
    if !scene.solids.is_empty() {
        let solids = solids_of(scene)?;
        place_warnings(scene, &solids, &grid, &mut warnings);
        material_warnings(scene, &solids, &grid, &mut warnings)?;
    }
    Ok(warnings)
}

fn thin(what: &str, wall: &ThinWall, passes: &str) -> String {
    format!(
        "{what} is {:.2} cells thick: {passes} through it, since a wall in this direction is tight from {:.2} cells on. Use more cells, or make it thicker",
        wall.thickness, wall.needed
    )
}

fn obstacle_warnings(scene: &Scene, grid: &Grid, warnings: &mut Vec<String>) -> Result<(), Error> {
    let passes = match (scene.liquid.is_some(), !scene.solids.is_empty()) {
        (true, true) => "liquid leaks and solids pass",
        (true, false) => "liquid leaks",
        (false, _) => "solids pass",
    };
    for wall in geometry::thin_obstacles(scene, grid)? {
        warnings.push(thin(&format!("obstacle[{}]", wall.body), &wall, passes));
    }
    for number in geometry::covered_probes(scene, grid)? {
        let name = &scene.probes[number].name;
        warnings.push(format!("probe \"{name}\" lies in an obstacle and cannot measure the liquid. Move it"));
    }
    Ok(())
}

fn place_warnings(scene: &Scene, solids: &Solids, grid: &Grid, warnings: &mut Vec<String>) {
    let (displacement, _) = solids.initial_state(scene);
    let moved = solids.moved(&displacement);
    let name = |number: usize| &scene.solids[number].name;
    if scene.liquid.is_some() {
        for wall in geometry::thin_solids(&moved, grid) {
            let what = format!("solid \"{}\"", name(wall.body));
            warnings.push(thin(&what, &wall, "liquid leaks"));
        }
    }
    let overlaps = geometry::solid_overlaps(&moved);
    for overlap in &overlaps {
        let [a, b] = overlap.solids;
        let [x, y, z] = overlap.at.to_array().map(rounded);
        warnings.push(format!(
            "solids \"{}\" and \"{}\" overlap by {} m at [{x}, {y}, {z}], and no contact force separates them. Place them apart",
            name(a),
            name(b),
            rounded(overlap.depth)
        ));
    }
    if scene.solver.solid_contact {
        return;
    }
    let reach: Vec<[DVec3; 2]> =
        (0..solids.bodies.len()).map(|number| reach(scene, solids, number, &moved.nodes)).collect();
    let meet = |a: usize, b: usize| {
        let [low, high] = reach[a];
        low.cmplt(reach[b][1]).all()
            && reach[b][0].cmplt(high).all()
            && solids.may_touch(a, b)
            && overlaps.iter().all(|overlap| overlap.solids != [a, b])
    };
    let n = reach.len();
    let mut pairs = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b)));
    let mut pairs = pairs.by_ref().filter(|&(a, b)| meet(a, b));
    if let Some((a, b)) = pairs.next() {
        let more = match pairs.count() {
            0 => String::new(),
            1 => ", one more pair too".to_owned(),
            n => format!(", {n} more pairs too"),
        };
        warnings.push(format!(
            "solids \"{}\" and \"{}\" may meet{more}: they pass through each other, since solver.solid_contact is off. It needs coupling \"strong\" and a precision other than \"f32\"",
            name(a),
            name(b)
        ));
    }
}

/// The box (m) that a solid may reach: its own box if the solid is prescribed, enlarged by its length if only part
/// is. Without prescribed nodes it is the domain.
fn reach(scene: &Scene, solids: &Solids, number: usize, nodes: &[DVec3]) -> [DVec3; 2] {
    let body = &solids.bodies[number];
    let [low, high] = bounds(&nodes[body.nodes.clone()]);
    let pins = &scene.solids[number].pins;
    let prescribed = &solids.prescribed[body.nodes.clone()];
    if pins.iter().any(|pin| !pin.keyframes.is_empty()) || prescribed.iter().all(|h| *h == [false; 3]) {
        return [DVec3::ZERO, scene.domain.size];
    }
    let swing = match prescribed.iter().all(|h| *h == [true; 3]) {
        true => 0.0,
        false => (high - low).max_element(),
    };
    [low - swing, high + swing]
}

fn bounds(points: &[DVec3]) -> [DVec3; 2] {
    let none = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    points.iter().fold(none, |[low, high], &x| [low.min(x), high.max(x)])
}

fn material_warnings(scene: &Scene, solids: &Solids, grid: &Grid, warnings: &mut Vec<String>) -> Result<(), Error> {
    let height = geometry::liquid_height(scene, grid)?;
    let density = scene.liquid.as_ref().map_or(0.0, |liquid| liquid.density);
    let least = SOFT * density * scene.domain.largest_gravity().length() * height;
    for (solid, body) in scene.solids.iter().zip(&solids.bodies) {
        let name = &solid.name;
        if solid.young < least {
            warnings.push(format!(
                "solid \"{name}\" has young = {:?} Pa, below twice the pressure under {} m of liquid, {} Pa: it may collapse or invert. Use a stiffer solid, or less depth",
                solid.young,
                rounded(height),
                rounded(least)
            ));
        }
        let locks = LOCKS.iter().find(|(poisson, _)| solid.poisson > *poisson);
        if let Some((_, least)) = locks
            && let Some(layers) = layers(solid, solids, body)
            && layers < least - 0.5
        {
            let layers = match layers.round() {
                n if n <= 1.0 => "one linear element".to_owned(),
                n => format!("{n} linear elements"),
            };
            warnings.push(format!(
                "solid \"{name}\" has poisson = {:?} and about {layers} across its thin side: its deflection is half the correct one or less. If bending matters, use at least {least:.0}, or a smaller poisson",
                solid.poisson
            ));
        }
    }
    Ok(())
}

/// Elements across the thin side of a slender body; `None` for a compact one.
fn layers(solid: &Solid, solids: &Solids, body: &Body) -> Option<f64> {
    if let SolidMesh::Box { size, cells } = solid.mesh {
        let longest = size.max_element();
        let thin = size.to_array().into_iter().zip(cells);
        return thin.filter(|(side, _)| SLENDER * side <= longest).map(|(_, n)| n as f64).reduce(f64::min);
    }
    let nodes = solids.rest[body.nodes.clone()].to_vec();
    let [low, high] = bounds(&nodes);
    let first = body.nodes.start as u32;
    let elements = solids.elements[body.elements.clone()].iter();
    let mesh = TetMesh { nodes, elements: elements.map(|e| e.map(|node| node - first)).collect() };
    let [thickness, layers] = geometry::layers_across(&mesh)?;
    (SLENDER * thickness <= (high - low).max_element()).then_some(layers)
}
