//! Fills a closed surface with tetrahedra. parry's `volume_mesh` returns the smoothed elements of a body-centred cubic lattice
//! that cover the solid. Their outer nodes are then moved onto the surface.

use glam::{DMat3, DVec3};
use parry3d_f64::query::PointQueryWithLocation;
use parry3d_f64::shape::{TriMesh, TriMeshFlags};
use parry3d_f64::transformation::{VolumeMeshParameters, volume_mesh};

use super::Surface;
use super::surface::Fault;
use super::tet_mesh::{MAX_ELEMENTS, TetMesh};

/// Iterations of parry's smoothing. Without it the lattice protrudes by half a cell; after 16 nodes hardly move.
const SMOOTHING: u32 = 16;

/// Distance to the surface to which parry pulls nodes, cells; a smaller one is not reached in 16 iterations.
const GUARD: f64 = 0.05;

/// Rotations of the lattice against the surface, rad, tried until the elements cover the solid.
///
/// With faces in planes of the lattice, rounding decides which elements they touch, and parry confuses inside and outside: of a
/// plate of 16 by 3.2 by 16 cells only a skin remained. Slightly rotated faces cross the lattice.
const TURNS: [f64; 4] = [0.0, 0.003, 0.02, 0.1];

/// Greatest distance of an outer node of a cover from the surface, cells: elements that the surface reaches are at most one
/// cell long.
const COVER: f64 = 1.5;

/// Fitting iterations; later ones hardly move a node.
const ROUNDS: usize = 10;

/// Least mean ratio of elements after moving an outer node, unless it was lower before.
const FLOOR: f64 = 0.3;

/// Mean ratio below which nodes are also smoothed along the surface or inside the mesh.
const GOOD: f64 = 0.5;

/// Fills a surface without fault ([`Surface::fault`]) with tetrahedra of edges of about `cell_size` (m).
///
/// Outer nodes lie on the surface as far as element quality allows. Chords cut convex edges off, so the volume is smaller by an
/// amount proportional to the square of the cell size. Parts thinner than a cell have one layer of elements.
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
    // Twelve elements per cell of the bounding box, which is enlarged by a cell on each side.
    let elements = 12.0 * (size / cell_size + 2.0).element_product();
    if elements > MAX_ELEMENTS {
        return fault(
            format!(
                "cell_size {cell_size} m results in {elements:.0} elements in the bounding box, allowed are {MAX_ELEMENTS:.0}"
            ),
            "give a larger cell_size; a file in mm needs units = \"mm\" in a scene, --scale 0.001 on the command line",
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

struct Boundary {
    triangles: TriMesh,
    /// m
    cell_size: f64,
    /// Centre of the bounding box, m.
    centre: DVec3,
    /// Longest extent, m.
    extent: f64,
}

impl Boundary {
    fn new(surface: &Surface, cell_size: f64) -> Boundary {
        let [low, high] = surface.bounds();
        let triangles =
            TriMesh::with_flags(surface.vertices.clone(), surface.triangles.clone(), TriMeshFlags::ORIENTED);
        Boundary {
            triangles: triangles.expect("a surface without fault has triangles"),
            cell_size,
            centre: 0.5 * (low + high),
            extent: (high - low).max_element(),
        }
    }

    /// The nearest point of the surface, and whether `x` lies inside.
    fn nearest(&self, x: DVec3) -> (DVec3, bool) {
        let (nearest, _) = self.triangles.project_local_point_and_get_location(x, false);
        (nearest.point, nearest.is_inside)
    }

    /// Lattice elements that cover the solid, in axes rotated by an angle (rad) about (1, 2, 3); `None` if they do not
    /// cover it.
    fn cover(&self, surface: &Surface, turn: f64) -> Option<TetMesh> {
        let axis = DVec3::new(1.0, 2.0, 3.0).normalize();
        let rotation = DMat3::from_axis_angle(axis, turn);
        let parameters = VolumeMeshParameters {
            cover_smoothing: SMOOTHING,
            cover_guard: GUARD,
            ..VolumeMeshParameters::new(self.cell_size)
        };
        let turned = surface.clone().map(|x| rotation * (x - self.centre) + self.centre);
        let cover = volume_mesh(&turned.vertices, &turned.triangles, &parameters)?;
        let back = rotation.transpose();
        let mesh = TetMesh {
            nodes: cover.vertices.into_iter().map(|x| back * (x - self.centre) + self.centre).collect(),
            elements: cover.cells,
        };
        let rounding = 1e-9 * self.extent;
        let outer = mesh.surface();
        let covers = outer.iter().flatten().all(|&node| {
            let x = mesh.nodes[node as usize];
            let (nearest, inside) = self.nearest(x);
            let distance = x.distance(nearest);
            distance <= if inside { rounding } else { COVER * self.cell_size }
        });
        covers.then_some(mesh)
    }

    /// Moves outer nodes onto the surface, and smooths nodes of bad elements: Gauss-Seidel in the order of the nodes.
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
                    let to = if is_outer { self.nearest(half_way).0 } else { half_way };
                    step(mesh, node, to, |mesh| worst(mesh, node) > now);
                }
            }
        }
    }
}

/// Moves a node to a point, or half or a quarter of the way; the first allowed position wins.
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

/// Nodes that share a simplex with each of `n` nodes, ascending.
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
