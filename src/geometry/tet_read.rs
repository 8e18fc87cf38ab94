//! Meshes of solids from files of tetrahedra: Gmsh's .msh and VTK's .vtu.

use std::collections::HashMap;
use std::path::Path;

use glam::DVec3;

use super::mesh_file::{self, Problem};
use super::tet_mesh::{MAX_ELEMENTS, TetMesh};
use super::{msh, vtu};
use crate::error::Error;

/// A mesh from a file and the changes to it.
#[derive(Clone, Debug, PartialEq)]
pub struct TetFile {
    /// The mesh, m.
    pub mesh: TetMesh,
    /// The file's element numbers: tags in .msh files, cell numbers from 0 in .vtu files.
    pub numbers: Vec<u64>,
    /// Ignored, dropped or reoriented entities.
    pub notes: Vec<String>,
}

/// Unchecked contents of a file. Corners of elements are existing nodes.
#[derive(Debug, Default)]
pub(super) struct RawTets {
    /// m
    pub(super) nodes: Vec<DVec3>,
    pub(super) elements: Vec<[u32; 4]>,
    /// Numbers of the nodes in the file.
    pub(super) node_names: Vec<u64>,
    /// Numbers of the elements in the file.
    pub(super) element_names: Vec<u64>,
    /// The format's terms for elements and nodes.
    pub(super) words: [&'static str; 2],
    /// Number of elements of lower dimension.
    pub(super) ignored: usize,
}

/// Distance of coincident nodes, relative to the extent of the mesh.
const COINCIDENT: f64 = 1e-10;

/// Reads 4-node tetrahedra from a .msh (Gmsh 4.1) or .vtu file.
///
/// Ignores elements of lower dimension, drops unused nodes, and reorients a mesh of inverted elements only. Other volume
/// elements, and meshes of no solid, are errors.
pub fn read(file: &Path) -> Result<TetFile, Error> {
    parse(&mesh_file::load(file)?, file)
}

/// Parses the contents of a file; the extension of its name is the format.
pub fn parse(bytes: &[u8], file: &Path) -> Result<TetFile, Error> {
    let extension = mesh_file::extension(file);
    let raw = match extension.as_str() {
        "msh" => msh::read(bytes, &file.display().to_string()),
        "vtu" => vtu::read(bytes),
        "obj" | "stl" | "ply" => Err(Problem::new(
            "a surface, not tetrahedra",
            "fill it: mesh = { surface = { file = .., cell_size = .. } } in a scene, --cell-size on the command line",
        )),
        _ => Err(Problem::new("unknown kind of mesh file", "use .msh (Gmsh 4.1) or .vtu")),
    };
    raw.and_then(check).map_err(|problem| problem.in_file(file))
}

fn check(raw: RawTets) -> Result<TetFile, Problem> {
    let RawTets { nodes, elements, node_names, element_names, words: [element_word, node_word], ignored } = raw;
    if elements.len() as f64 > MAX_ELEMENTS {
        return Err(Problem::new(
            format!("{} tetrahedra, allowed are {MAX_ELEMENTS:.0}", elements.len()),
            "mesh with a larger size",
        ));
    }
    let mut notes = Vec::new();
    let mut note = |n: usize, what: String| {
        if n > 0 {
            notes.push(format!("{n} {what}"));
        }
    };
    note(ignored, format!("{element_word}s of fewer dimensions ignored"));
    let element_name = |number: usize| format!("{element_word} {}", element_names[number]);
    for (number, element) in elements.iter().enumerate() {
        let again = (1..4).find(|&corner| element[..corner].contains(&element[corner]));
        if let Some(corner) = again {
            let node = node_names[element[corner] as usize];
            return Err(Problem::new(
                format!("{} has {node_word} {node} twice", element_name(number)),
                "remove collapsed elements in the mesh tool, and export the mesh again",
            ));
        }
    }
    let mut mesh = TetMesh { nodes, elements };
    let kept = mesh.drop_unused_nodes();
    note(node_names.len() - kept.len(), format!("{node_word}s dropped, which no tetrahedron uses"));
    let node_name = |node: usize| format!("{node_word} {}", node_names[kept[node]]);
    let inverted = mesh.elements.iter().all(|&element| mesh.determinant(element) < 0.0);
    if inverted {
        note(mesh.elements.len(), "tetrahedra turned: all were inverted".to_owned());
        for element in &mut mesh.elements {
            element.swap(2, 3);
        }
    }
    if let Some(fault) = mesh.fault_named(&element_name, &node_name) {
        return Err(fault.into());
    }
    if let Some([a, b]) = coincident(&mesh) {
        return Err(Problem::new(
            format!("{} and {} are both at {}", node_name(a), node_name(b), mesh.nodes[a]),
            "merge double nodes, else the parts come apart (gmsh: Mesh.RemoveDuplicateNodes, ParaView: Clean to Grid); bodies that \
             only touch belong in files of their own",
        ));
    }
    Ok(TetFile { mesh, numbers: element_names, notes })
}

/// Two nodes at the same position, if there are any.
fn coincident(mesh: &TetMesh) -> Option<[usize; 2]> {
    let [low, high] = mesh.bounds();
    let near = COINCIDENT * (high - low).max_element();
    // Buckets are far wider than the distance, so that most nodes query only one.
    let cell = |x: DVec3| ((x - low) / (1e4 * near)).floor().as_i64vec3();
    let mut seen: HashMap<_, Vec<usize>> = HashMap::new();
    for (node, &x) in mesh.nodes.iter().enumerate() {
        let mut cells = Vec::with_capacity(1);
        for corner in 0..8 {
            let side = |bit: usize| if corner & bit == 0 { -near } else { near };
            let cell = cell(x + DVec3::new(side(1), side(2), side(4)));
            if !cells.contains(&cell) {
                cells.push(cell);
            }
        }
        let others = cells.iter().filter_map(|cell| seen.get(cell)).flatten();
        let mut others = others.copied();
        if let Some(other) = others.find(|&other| mesh.nodes[other].distance(x) <= near) {
            return Some([other, node]);
        }
        seen.entry(cell(x)).or_default().push(node);
    }
    None
}
