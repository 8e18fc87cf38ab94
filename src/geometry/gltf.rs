//! Meshes from glTF 2.0, `.glb` or `.gltf` with its buffers inside: the triangles of all nodes of the scene, transformed by their nodes.
//!
//! Skins and morph targets are not applied. A file with buffers beside it is refused: the hash of a run would miss them.

use std::collections::HashMap;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat3, DMat4, DVec3};
use gltf::accessor::{DataType, Dimensions};
use gltf::buffer::Source;
use gltf::mesh::Mode;
use gltf::{Accessor, Document, Gltf, Node, Primitive};

use super::mesh_file::Problem;
use super::render_mesh::RenderMesh;

const DAMAGED: &str = "export the mesh again: the file is damaged or cut off";
const EMBEDDED: &str = "export as glTF Binary (.glb), which holds everything in one file";
const PLAIN: &str = "export plain triangles: no compression, no sparse data, positions in 32 bits";

/// Reads the default scene, or the first one.
pub(super) fn read(bytes: &[u8]) -> Result<RenderMesh, Problem> {
    let refused = |problem: gltf::Error| Problem::new(format!("no glTF: {problem}"), DAMAGED);
    let Gltf { document, blob } = Gltf::from_slice_without_validation(bytes).map_err(refused)?;
    let json = document.into_json();
    // The validation of gltf 1.4 panics at these numbers.
    let primitives = json.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let mut accessors = primitives.flat_map(|primitive| primitive.attributes.values());
    if let Some(accessor) = accessors.find(|accessor| accessor.value() >= json.accessors.len()) {
        let problem = format!("no glTF: no accessor {}", accessor.value());
        return Err(Problem::new(problem, DAMAGED));
    }
    let file = Document::from_json(json).map_err(refused)?;
    let mut buffers = Vec::new();
    for buffer in file.buffers() {
        let data = match buffer.source() {
            Source::Bin => blob.clone(),
            Source::Uri(uri) => match uri.split_once(";base64,") {
                Some((kind, data)) if kind.starts_with("data:") => STANDARD.decode(data).ok(),
                _ => {
                    let problem = format!("its data are in another file, `{uri}`");
                    return Err(Problem::new(problem, EMBEDDED));
                }
            },
        };
        let data = data.filter(|data| data.len() >= buffer.length());
        let number = buffer.index();
        buffers.push(data.ok_or_else(|| Problem::new(format!("buffer {number} is incomplete"), DAMAGED))?);
    }
    let scene = file.default_scene().or_else(|| file.scenes().next());
    let scene = scene.ok_or_else(|| Problem::new("no scene", DAMAGED))?;
    let mut mesh = RenderMesh::default();
    // Whether all primitives so far have texture coordinates and normals.
    let mut complete = [true; 2];
    let mut nodes: Vec<(Node, DMat4)> = scene.nodes().map(|node| (node, DMat4::IDENTITY)).collect();
    nodes.reverse();
    let mut visits = HashMap::new();
    while let Some((node, parent)) = nodes.pop() {
        // A node has one parent, so a second visit is a cycle.
        if visits.insert(node.index(), ()).is_some() {
            let problem = format!("node {} has two parents", node.index());
            return Err(Problem::new(problem, DAMAGED));
        }
        let columns = node.transform().matrix();
        let placed = parent * DMat4::from_cols_array_2d(&columns.map(|column| column.map(f64::from)));
        for primitive in node.mesh().iter().flat_map(|mesh| mesh.primitives()) {
            push(&mut mesh, &mut complete, &primitive, placed, &buffers)?;
        }
        let children: Vec<Node> = node.children().collect();
        nodes.extend(children.into_iter().rev().map(|child| (child, placed)));
    }
    if !complete[0] {
        mesh.texture.clear();
    }
    if !complete[1] {
        mesh.normals.clear();
    }
    Ok(mesh)
}

/// Adds the triangles of a primitive.
fn push(
    mesh: &mut RenderMesh,
    complete: &mut [bool; 2],
    primitive: &Primitive,
    placed: DMat4,
    buffers: &[Vec<u8>],
) -> Result<(), Problem> {
    match primitive.mode() {
        Mode::Triangles => {}
        Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip => return Ok(()),
        Mode::TriangleStrip | Mode::TriangleFan => {
            return Err(Problem::new("strips or fans of triangles", PLAIN));
        }
    }
    let missing = || Problem::new("a primitive without readable positions", PLAIN);
    let accessors = primitive.attributes().map(|(_, accessor)| accessor);
    for accessor in accessors.chain(primitive.indices()) {
        ensure_readable(&accessor)?;
    }
    let positions = primitive.get(&gltf::Semantic::Positions).ok_or_else(missing)?;
    ensure_kind(&positions, Dimensions::Vec3)?;
    let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(Vec::as_slice));
    let first = mesh.vertices.len();
    let put = |x: [f32; 3]| placed.transform_point3(DVec3::from(x.map(f64::from)));
    mesh.vertices.extend(reader.read_positions().ok_or_else(missing)?.map(put));
    let n = mesh.vertices.len() - first;
    let incomplete = |what: &str| Problem::new(format!("{what} of {n} vertices are incomplete"), DAMAGED);
    if let Some(accessor) = primitive.get(&gltf::Semantic::TexCoords(0)) {
        if accessor.dimensions() != Dimensions::Vec2 {
            return Err(incomplete("texture coordinates"));
        }
        let texture = reader.read_tex_coords(0);
        let texture = texture.ok_or_else(|| incomplete("texture coordinates"))?;
        // From the upper left corner in glTF.
        mesh.texture.extend(texture.into_f32().map(|[u, v]| [u, 1.0 - v]));
    } else {
        complete[0] = false;
    }
    let linear = DMat3::from_mat4(placed);
    if let Some(accessor) = primitive.get(&gltf::Semantic::Normals) {
        ensure_kind(&accessor, Dimensions::Vec3)?;
        let cofactor = linear.inverse().transpose();
        let normals = reader.read_normals().ok_or_else(|| incomplete("normals"))?;
        mesh.normals.extend(normals.map(|normal| cofactor * DVec3::from(normal.map(f64::from))));
    } else {
        complete[1] = false;
    }
    for (len, complete, what) in
        [(mesh.texture.len(), complete[0], "texture coordinates"), (mesh.normals.len(), complete[1], "normals")]
    {
        if complete && len != mesh.vertices.len() {
            return Err(incomplete(what));
        }
    }
    let corners: Vec<u32> = match primitive.indices() {
        Some(_) => reader.read_indices().ok_or_else(|| incomplete("triangles"))?.into_u32().collect(),
        None => (0..n as u32).collect(),
    };
    if !corners.len().is_multiple_of(3) || corners.iter().any(|&corner| corner as usize >= n) {
        return Err(incomplete("triangles"));
    }
    // A mirrored node turns the triangles round.
    let [b, c] = if linear.determinant() < 0.0 { [2, 1] } else { [1, 2] };
    let triangles = corners.chunks_exact(3);
    mesh.triangles.extend(triangles.map(|of| [of[0], of[b], of[c]].map(|corner| corner + first as u32)));
    Ok(())
}

/// Refuses an accessor that the reader would skip or read beyond its buffer.
fn ensure_readable(accessor: &Accessor) -> Result<(), Problem> {
    let number = accessor.index();
    let Some(view) = accessor.view().filter(|_| accessor.sparse().is_none()) else {
        return Err(Problem::new(format!("accessor {number} is sparse or empty"), PLAIN));
    };
    let stride = view.stride().unwrap_or(accessor.size());
    let steps = accessor.count().checked_sub(1);
    let end =
        steps.and_then(|steps| steps.checked_mul(stride)?.checked_add(accessor.offset())?.checked_add(accessor.size()));
    let whole = end.is_some_and(|end| end <= view.length())
        && view.offset().checked_add(view.length()).is_some_and(|end| end <= view.buffer().length());
    match whole {
        true => Ok(()),
        false => Err(Problem::new(format!("accessor {number} lies outside its buffer"), DAMAGED)),
    }
}

fn ensure_kind(accessor: &Accessor, dimensions: Dimensions) -> Result<(), Problem> {
    match accessor.data_type() == DataType::F32 && accessor.dimensions() == dimensions {
        true => Ok(()),
        false => Err(Problem::new(format!("accessor {} is quantized", accessor.index()), PLAIN)),
    }
}
