//! The inside of a closed surface, filled with tetrahedra: parry's `volume_mesh` gives the elements of a body-centred cubic lattice
//! that the solid reaches, smoothed; then their outer nodes are moved onto the surface.

use glam::{DMat3, DVec3};
use parry3d_f64::query::PointQueryWithLocation;
use parry3d_f64::shape::{TriMesh, TriMeshFlags};
use parry3d_f64::transformation::{VolumeMeshParameters, volume_mesh};

use super::Surface;
use super::surface::Fault;
use super::tet_mesh::{MAX_ELEMENTS, TetMesh};

/// Rounds of parry's smoothing. Without any the lattice stands out by half a cell; after 16 hardly a node still moves.
const SMOOTHING: u32 = 16;

/// How near to the surface parry pulls nodes, in cells; nearer, 16 rounds do not arrive.
const GUARD: f64 = 0.05;

/// How the lattice is turned against the surface, in radians, if one before did not cover it. Where faces lie in planes of the
/// lattice, rounding decides which elements they touch, and parry then takes the inside for the outside, or the reverse: of a plate
/// 16 by 3.2 by 16 cells only a skin was left. Faces that are turned even slightly cross the lattice.
const TURNS: [f64; 4] = [0.0, 0.003, 0.02, 0.1];

/// Farthest that an outer node of a cover may lie from the surface, in cells: an element that the surface reaches is no longer
/// than one cell.
const COVER: f64 = 1.5;

/// Rounds of moving nodes onto the surface; in later ones hardly a node still moves.
const ROUNDS: usize = 10;

/// Moving an outer node onto the surface must leave its elements this mean ratio, or the one they have.
const FLOOR: f64 = 0.3;

/// Nodes whose elements are worse than this also slide along the surface, or inside the mesh, to where they are better.
const GOOD: f64 = 0.5;

/// Fills a surface without fault ([`Surface::fault`]) with tetrahedra whose edges are about `cell_size` (m) long, their outer nodes on
/// the surface as far as elements stay good. Chords round its edges off: the volume is smaller where it is convex, by an amount that
/// falls with the square of the cell size. What is thinner than a cell is meshed with one layer of elements.
pub fn fill(surface: &Surface, cell_size: f64) -> Result<TetMesh, Fault> {
    let [low, high] = surface.bounds();
    let size = high - low;
    let fault = |problem, cure| Err(Fault { problem, cure });
    if !(cell_size > 0.0 && cell_size <= size.max_element()) {
        return fault(
            format!("cell_size is {cell_size} m, the surface extends over {size} m"),
            "a positive cell_size, at most the longest extent",
        );
    }
    // Twelve elements per cell of the bounding box with a cell around it.
    let elements = 12.0 * (size / cell_size + 2.0).element_product();
    if elements > MAX_ELEMENTS {
        return fault(
            format!(
                "cell_size {cell_size} m makes {elements:.0} elements in the bounding box, allowed are {MAX_ELEMENTS:.0}"
            ),
            "give a larger cell_size; a file in mm takes units = \"mm\" in a scene, --scale 0.001 on the command line",
        );
    }
    let boundary = Boundary::new(surface, cell_size);
    match TURNS.iter().find_map(|&turn| boundary.cover(surface, turn)) {
        Some(mut mesh) => {
            boundary.fit(&mut mesh);
            Ok(mesh)
        }
        None => fault(
            format!("elements of cell_size {cell_size} m cannot cover the surface"),
            "repair the surface in a mesh tool (parts that cut each other, for one), or give another cell_size",
        ),
    }
}

/// The surface that is filled.
struct Boundary {
    triangles: TriMesh,
    /// m
    cell_size: f64,
    /// Middle of its box, m.
    centre: DVec3,
    /// Longest extent, m.
    extent: f64,
}

impl Boundary {
    fn new(surface: &Surface, cell_size: f64) -> Boundary {
        let [low, high] = surface.bounds();
        let triangles = TriMesh::with_flags(
            surface.vertices.clone(),
            surface.triangles.clone(),
            TriMeshFlags::ORIENTED,
        );
        Boundary {
            triangles: triangles.expect("a surface without fault has triangles"),
            cell_size,
            centre: 0.5 * (low + high),
            extent: (high - low).max_element(),
        }
    }

    /// The nearest point of the surface, and whether `x` lies inside.
    fn nearest(&self, x: DVec3) -> (DVec3, bool) {
        let (nearest, _) = self
            .triangles
            .project_local_point_and_get_location(x, false);
        (nearest.point, nearest.is_inside)
    }

    /// Lattice elements that contain the solid, made in axes that are turned by an angle (radians) about (1, 2, 3); None where they
    /// do not contain it.
    fn cover(&self, surface: &Surface, turn: f64) -> Option<TetMesh> {
        let axis = DVec3::new(1.0, 2.0, 3.0).normalize();
        let rotation = DMat3::from_axis_angle(axis, turn);
        let parameters = VolumeMeshParameters {
            cover_smoothing: SMOOTHING,
            cover_guard: GUARD,
            ..VolumeMeshParameters::new(self.cell_size)
        };
        let turned = surface
            .clone()
            .map(|x| rotation * (x - self.centre) + self.centre);
        let cover = volume_mesh(&turned.vertices, &turned.triangles, &parameters)?;
        let back = rotation.transpose();
        let mesh = TetMesh {
            nodes: cover
                .vertices
                .into_iter()
                .map(|x| back * (x - self.centre) + self.centre)
                .collect(),
            elements: cover.cells,
        };
        let rounding = 1e-9 * self.extent;
        let outer = mesh.surface();
        let covers = outer.iter().flatten().all(|&node| {
            let x = mesh.nodes[node as usize];
            let (nearest, inside) = self.nearest(x);
            let distance = x.distance(nearest);
            distance
                <= if inside {
                    rounding
                } else {
                    COVER * self.cell_size
                }
        });
        covers.then_some(mesh)
    }

    /// Moves outer nodes onto the surface, and nodes of bad elements to where these are better. In the order of the nodes, each from
    /// where the last ones have gone.
    fn fit(&self, mesh: &mut TetMesh) {
        let n = mesh.nodes.len();
        let mut elements_of = vec![Vec::new(); n];
        for (number, element) in (0_u32..).zip(&mesh.elements) {
            for &node in element {
                elements_of[node as usize].push(number);
            }
        }
        let outer = neighbours(n, &mesh.surface());
        let all = neighbours(n, &mesh.elements);
        let worst = |mesh: &TetMesh, node: usize| {
            let elements = elements_of[node].iter();
            let ratios = elements.map(|&number| mesh.mean_ratio(mesh.elements[number as usize]));
            ratios.fold(f64::INFINITY, f64::min)
        };
        for _ in 0..ROUNDS {
            for node in 0..n {
                let is_outer = !outer[node].is_empty();
                if is_outer {
                    let (onto, _) = self.nearest(mesh.nodes[node]);
                    let least = worst(mesh, node).min(FLOOR);
                    step(mesh, node, onto, |mesh| worst(mesh, node) >= least);
                }
                let now = worst(mesh, node);
                if now < GOOD {
                    let others = if is_outer { &outer[node] } else { &all[node] };
                    let sum: DVec3 = others.iter().map(|&other| mesh.nodes[other as usize]).sum();
                    let half_way = 0.5 * (mesh.nodes[node] + sum / others.len() as f64);
                    let to = if is_outer {
                        self.nearest(half_way).0
                    } else {
                        half_way
                    };
                    step(mesh, node, to, |mesh| worst(mesh, node) > now);
                }
            }
        }
    }
}

/// Moves a node to a point, or half or a quarter of the way, where it is allowed; else it stays.
fn step(mesh: &mut TetMesh, node: usize, to: DVec3, allowed: impl Fn(&TetMesh) -> bool) {
    let from = mesh.nodes[node];
    for share in [1.0, 0.5, 0.25] {
        mesh.nodes[node] = from + share * (to - from);
        if allowed(mesh) {
            return;
        }
    }
    mesh.nodes[node] = from;
}

/// The nodes that share a simplex with each of `n` nodes, ascending.
fn neighbours<const CORNERS: usize>(n: usize, simplices: &[[u32; CORNERS]]) -> Vec<Vec<u32>> {
    let mut lists = vec![Vec::new(); n];
    for simplex in simplices {
        for &node in simplex {
            lists[node as usize].extend(simplex.iter().filter(|&&other| other != node));
        }
    }
    for list in &mut lists {
        list.sort_unstable();
        list.dedup();
    }
    lists
}
