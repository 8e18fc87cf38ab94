//! Tetrahedral meshes of solids: generation, placement, checks, surface and element quality.

use glam::DVec3;

use super::disjoint_sets::DisjointSets;
use super::placing::{ensure_size, read_surface};
use super::surface::{Fault, bounds, is_near};
use super::symmetry::cut_by_symmetry;
use super::{tet_fill, tet_read, tet_shapes};
use crate::error::Error;
use crate::scene::{Domain, Scene, Solid, SolidMesh};

/// Linear tetrahedra with det \[x1 - x0, x2 - x0, x3 - x0\] > 0. Every node belongs to an element.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TetMesh {
    /// Positions, m.
    pub nodes: Vec<DVec3>,
    /// Node numbers.
    pub elements: Vec<[u32; 4]>,
}

/// The shape of one element.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ElementShape {
    /// m^3
    pub volume: f64,
    /// 12 (3 V)^(2/3) over the sum of the squared edges: 1 for the regular tetrahedron, 0 for a flat one (Liu and Joe 1994).
    pub mean_ratio: f64,
    /// Smallest angle between two faces, degrees; 70.5 for the regular tetrahedron.
    pub min_dihedral: f64,
    /// Largest angle between two faces, degrees.
    pub max_dihedral: f64,
    /// Longest edge over the smallest height, in units of the regular tetrahedron's: 1 at best.
    pub aspect: f64,
}

/// Faces of an element by the opposite corner, counter-clockwise seen from outside.
pub(super) const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// Least volume relative to the cube of the longest edge: smaller ones are rounding of positions.
const FLAT: f64 = 1e-12;

/// Most elements of a generated mesh: 2^25, with a solver of some 5 GB.
pub(super) const MAX_ELEMENTS: f64 = 33_554_432.0;

/// Rest meshes of all solids of a scene.
pub fn solid_meshes(scene: &Scene) -> Result<Vec<TetMesh>, Error> {
    let solids = scene.solids.iter().enumerate();
    solids
        .map(|(number, solid)| {
            let what = scene.at(&format!("solid[{number}]"));
            TetMesh::within(solid, &what, Some(&scene.domain))
        })
        .collect()
}

/// Map from the coordinates of the mesh file of a solid to its rest positions, m; from its own axes for a generated mesh. The linear part by
/// columns, then the translation.
pub fn rest_from_file(solid: &Solid, what: &str) -> Result<[DVec3; 4], Error> {
    let (unit, [low, high]) = match solid.mesh {
        SolidMesh::Surface { ref file, unit, .. } => {
            let surface = read_surface(file, unit).map_err(|error| error.within(what))?;
            (unit, surface.bounds())
        }
        SolidMesh::File { ref file, unit } => {
            let read = file.contents(tet_read::read);
            let read = read.map_err(|error| error.within(what))?;
            (unit, read.mesh.bounds().map(|x| unit * x))
        }
        _ => (1.0, [DVec3::ZERO; 2]),
    };
    let centre = 0.5 * (low + high);
    let placement = solid.placement.about(centre);
    let column = |axis| placement.scale * unit * (placement.rotate * axis);
    let [x, y, z] = DVec3::AXES.map(column);
    let columns = [x, y, z, placement.put(DVec3::ZERO, centre)];
    Ok(columns.map(|column| solid.stretch * column))
}

impl TetMesh {
    /// The placed mesh of a solid.
    ///
    /// Scale and rotation are about its centre: the origin for boxes, balls and shells, the centre of the bounding box for
    /// files. For a filled surface that is the box of the file, so the position does not depend on the cell size. `what`
    /// names the solid in errors.
    pub fn new(solid: &Solid, what: &str) -> Result<TetMesh, Error> {
        TetMesh::within(solid, what, None)
    }

    /// The mesh in a domain, cut by its planes of symmetry. Refuses a file far larger than the domain before filling it.
    fn within(solid: &Solid, what: &str, domain: Option<&Domain>) -> Result<TetMesh, Error> {
        let sized = |bounds: [DVec3; 2]| match domain {
            Some(domain) => ensure_size(bounds, &solid.placement, what, domain.size),
            None => Ok(()),
        };
        let mut centre = DVec3::ZERO;
        let error = |fault: Fault| Error::input(what, fault.problem, fault.cure);
        let mut mesh = match solid.mesh {
            SolidMesh::Box { size, cells } => tet_shapes::cuboid(size, cells).map_err(error)?,
            SolidMesh::Sphere { radius, cell_size } => tet_shapes::ball(radius, cell_size).map_err(error)?,
            SolidMesh::Shell { radius, thickness, cell_size } => {
                tet_shapes::shell(radius, thickness, cell_size).map_err(error)?
            }
            SolidMesh::Surface { ref file, unit, cell_size } => {
                let surface = read_surface(file, unit).map_err(|error| error.within(what))?;
                sized(surface.bounds())?;
                centre = surface.centre();
                tet_fill::fill(&surface, cell_size).map_err(error)?
            }
            SolidMesh::File { ref file, unit } => {
                let read = file.contents(tet_read::read);
                let read = read.map_err(|error| error.within(what))?;
                let mesh = read.mesh.clone().scaled(unit);
                let [low, high] = mesh.bounds();
                sized([low, high])?;
                centre = 0.5 * (low + high);
                mesh
            }
        };
        let placement = solid.placement.about(centre);
        for x in &mut mesh.nodes {
            *x = solid.stretch * placement.put(*x, centre);
        }
        if let Some(domain) = domain {
            ensure_across(solid, mesh.bounds(), what, domain.size)?;
        }
        if let Some(fault) = mesh.fault() {
            return Err(error(fault));
        }
        let Some(Domain { symmetry, size, .. }) = domain.filter(|domain| domain.symmetry.any()) else {
            return Ok(mesh);
        };
        let cut = cut_by_symmetry(mesh, *symmetry, *size);
        match cut.fault() {
            _ if cut.elements.is_empty() => {
                let names = symmetry.names().collect::<Vec<_>>().join(", ");
                let problem = format!("lies beyond a plane of symmetry ({names})");
                Err(Error::input(
                    what,
                    problem,
                    "move it into the domain with placement.at, the position of its centre",
                ))
            }
            Some(fault) => Err(error(fault)),
            None => Ok(cut),
        }
    }

    /// The mesh with all coordinates times a factor.
    pub fn scaled(mut self, factor: f64) -> TetMesh {
        for x in &mut self.nodes {
            *x *= factor;
        }
        self
    }

    /// Six times the signed volume of an element, m^3.
    pub fn determinant(&self, element: [u32; 4]) -> f64 {
        let [a, b, c, d] = element.map(|node| self.nodes[node as usize]);
        (b - a).cross(c - a).dot(d - a)
    }

    /// Volume of all elements, m^3.
    pub fn volume(&self) -> f64 {
        let elements = self.elements.iter();
        elements.map(|&element| self.determinant(element)).sum::<f64>() / 6.0
    }

    /// Low and high corner of the bounding box, m.
    pub fn bounds(&self) -> [DVec3; 2] {
        bounds(self.nodes.iter().copied())
    }

    /// Faces of one element only, counter-clockwise seen from outside, in the order of the elements and of the opposite
    /// corners.
    pub fn surface(&self) -> Vec<[u32; 3]> {
        let sides = self.sides();
        let groups = sides.chunk_by(|a, b| a.nodes == b.nodes);
        let mut single: Vec<u32> = groups
            .filter_map(|group| match group {
                [side] => Some(side.place),
                _ => None,
            })
            .collect();
        single.sort_unstable();
        single.into_iter().map(|place| self.face(place)).collect()
    }

    /// Number of edges that more than two surface triangles share, along which the surface touches itself.
    pub fn pinched_edges(&self) -> usize {
        let triangles = self.surface();
        let ends = triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let mut edges: Vec<[u32; 2]> = ends.map(|[a, b]| [a.min(b), a.max(b)]).collect();
        edges.sort_unstable();
        edges.chunk_by(|a, b| a == b).filter(|same| same.len() > 2).count()
    }

    /// Number of parts without common nodes.
    pub fn components(&self) -> usize {
        let mut parts = DisjointSets::new(self.nodes.len());
        for &[first, ref rest @ ..] in &self.elements {
            for &node in rest {
                parts.merge(first, node);
            }
        }
        parts.labels().1
    }

    pub(super) fn mean_ratio(&self, element: [u32; 4]) -> f64 {
        let x = element.map(|node| self.nodes[node as usize]);
        let edges = (0..4).flat_map(|i| (0..i).map(move |j| (i, j)));
        let squares: f64 = edges.map(|(i, j)| x[i].distance_squared(x[j])).sum();
        let determinant = self.determinant(element);
        12.0 * (0.5 * determinant).cbrt().powi(2).copysign(determinant) / squares
    }

    /// The shape of an element.
    pub fn shape(&self, element: [u32; 4]) -> ElementShape {
        let x = element.map(|node| self.nodes[node as usize]);
        // Area vectors of the faces, twice their areas long, outwards.
        let normals = FACES.map(|[a, b, c]| (x[b] - x[a]).cross(x[c] - x[a]));
        let mut angles = [f64::INFINITY, f64::NEG_INFINITY];
        let mut longest = 0.0_f64;
        for i in 0..4 {
            for j in i + 1..4 {
                longest = longest.max(x[i].distance_squared(x[j]));
                let [m, n] = [normals[i], normals[j]];
                let angle = f64::atan2(m.cross(n).length(), -m.dot(n)).to_degrees();
                angles = [angles[0].min(angle), angles[1].max(angle)];
            }
        }
        let determinant = self.determinant(element);
        let base = normals.map(DVec3::length).into_iter().fold(0.0, f64::max);
        ElementShape {
            volume: determinant / 6.0,
            mean_ratio: self.mean_ratio(element),
            min_dihedral: angles[0],
            max_dihedral: angles[1],
            aspect: (2.0_f64 / 3.0).sqrt() * longest.sqrt() * base / determinant.abs(),
        }
    }

    /// The element with the smallest mean ratio, the first of equals.
    pub fn worst_element(&self) -> Option<(usize, ElementShape)> {
        let shapes = self.elements.iter().map(|&element| self.shape(element));
        let smaller = |a: (usize, ElementShape), b: (usize, ElementShape)| {
            if b.1.mean_ratio < a.1.mean_ratio { b } else { a }
        };
        shapes.enumerate().reduce(smaller)
    }

    /// The first reason why this is no mesh of a solid. Elements and nodes are counted from 0.
    pub fn fault(&self) -> Option<Fault> {
        self.fault_named(&|element| format!("element {element}"), &|node| format!("node {node}"))
    }

    /// As [`TetMesh::fault`], with the file's names of elements and nodes.
    pub(super) fn fault_named(
        &self,
        element_name: &dyn Fn(usize) -> String,
        node_name: &dyn Fn(usize) -> String,
    ) -> Option<Fault> {
        let fault = |problem, cure| Some(Fault { problem, cure });
        if self.elements.is_empty() {
            return fault("no tetrahedra".to_owned(), "give a mesh with 4-node tetrahedra");
        }
        if let Some(node) = self.nodes.iter().position(|&x| !is_near(x)) {
            return fault(
                format!("{} is at {}", node_name(node), self.nodes[node]),
                "coordinates must be finite numbers, of at most 1e60 m",
            );
        }
        for (number, &element) in self.elements.iter().enumerate() {
            let x = element.map(|node| self.nodes[node as usize]);
            let edges = (0..4).flat_map(|i| (0..i).map(move |j| (i, j)));
            let longest = edges.map(|(i, j)| x[i].distance(x[j])).fold(0.0, f64::max);
            let determinant = self.determinant(element);
            if determinant.abs() <= FLAT * longest.powi(3) {
                return fault(
                    format!(
                        "{} with the corners {}, {}, {}, {} has no volume",
                        element_name(number),
                        x[0],
                        x[1],
                        x[2],
                        x[3]
                    ),
                    "remove or merge the nodes of flat elements, or optimise the mesh (gmsh: -optimize_netgen), and export it again",
                );
            }
            if determinant < 0.0 {
                return fault(
                    format!(
                        "{} is inverted (volume {:e} m^3), others are not",
                        element_name(number),
                        determinant / 6.0
                    ),
                    "give all elements the same orientation in the mesh tool, and export again",
                );
            }
        }
        let sides = self.sides();
        for group in sides.chunk_by(|a, b| a.nodes == b.nodes) {
            let names = |group: &[Side]| {
                let names = group.iter().map(|side| element_name(side.place as usize / 4));
                names.collect::<Vec<_>>().join(", ")
            };
            if group.len() > 2 {
                return fault(
                    format!("{} share one face", names(group)),
                    "a face belongs to one or two elements: remove doubled elements, and parts that overlap, in the mesh tool",
                );
            }
            if let [first, second] = group
                && first.even == second.even
            {
                return fault(
                    format!("{} overlap: both lie on the same side of their common face", names(group)),
                    "remove doubled elements, and parts that overlap, in the mesh tool",
                );
            }
        }
        None
    }

    /// Drops the nodes that no element uses. Returns the old numbers of the others, in order.
    pub(super) fn drop_unused_nodes(&mut self) -> Vec<usize> {
        let mut used = vec![false; self.nodes.len()];
        for &node in self.elements.iter().flatten() {
            used[node as usize] = true;
        }
        let kept: Vec<usize> = (0..used.len()).filter(|&node| used[node]).collect();
        let mut number = vec![0; used.len()];
        for (new, &old) in (0..).zip(&kept) {
            number[old] = new;
        }
        for node in self.elements.iter_mut().flatten() {
            *node = number[*node as usize];
        }
        self.nodes = kept.iter().map(|&node| self.nodes[node]).collect();
        kept
    }

    /// Corners of a face with the index 4 * element + opposite corner.
    fn face(&self, place: u32) -> [u32; 3] {
        let element = self.elements[place as usize / 4];
        FACES[place as usize % 4].map(|corner| element[corner])
    }

    /// All faces of all elements, sorted by their nodes.
    fn sides(&self) -> Vec<Side> {
        let mut sides: Vec<Side> = (0..4 * self.elements.len() as u32)
            .map(|place| {
                let [a, b, c] = self.face(place);
                let mut nodes = [a, b, c];
                nodes.sort_unstable();
                // Rotating a triangle preserves its orientation, so the corner after the smallest node decides.
                let next = match nodes[0] {
                    first if first == a => b,
                    first if first == b => c,
                    _ => a,
                };
                Side { nodes, place, even: next == nodes[1] }
            })
            .collect();
        sides.sort_unstable();
        sides
    }
}

/// A face of an element.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Side {
    /// Ascending.
    nodes: [u32; 3],
    /// 4 * element + opposite corner.
    place: u32,
    /// Whether the ascending order is counter-clockwise seen from outside the element.
    even: bool,
}

/// Refuses the mesh of a file that leaves a gap to the walls of a slab. `bounds`, stretched, and `size` of the domain, m.
fn ensure_across(solid: &Solid, [low, high]: [DVec3; 2], what: &str, size: DVec3) -> Result<(), Error> {
    let file = matches!(solid.mesh, SolidMesh::File { .. } | SolidMesh::Surface { .. });
    let gap = |axis: &usize| (low[*axis].abs()).max((high[*axis] - size[*axis]).abs()) > 1e-6 * size[*axis];
    let mut across = (0..3).filter(|&axis| file && solid.stretch[axis] != 1.0);
    match across.find(gap) {
        Some(axis) => {
            let (name, stretch) = (["x", "y", "z"][axis], solid.stretch[axis]);
            Err(Error::input(
                what,
                format!(
                    "leaves a gap to the walls of the slab: along {name} it extends from {} to {} m",
                    low[axis] / stretch,
                    high[axis] / stretch
                ),
                format!("scale and move it so that it extends from 0 to {} m along {name}", size[axis] / stretch),
            ))
        }
        None => Ok(()),
    }
}
