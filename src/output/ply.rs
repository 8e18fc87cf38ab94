//! The liquid's surface as a binary little-endian PLY file.

use std::path::Path;

use ply_rs_bw::ply::{
    Addable, ElementDef, Encoding, Ply, PropertyAccess, PropertyDef, PropertyType, ScalarType,
};
use ply_rs_bw::writer::Writer;

use super::atomic::write_atomically;
use super::frames::MovingSurface;
use crate::Error;

/// Position (m), normal, velocity (m/s), with the names of Blender, MeshLab and trimesh.
const VERTEX_PROPERTIES: [&str; 9] = ["x", "y", "z", "nx", "ny", "nz", "vx", "vy", "vz"];
const FACE_PROPERTY: &str = "vertex_indices";

enum Element {
    Vertex([f32; 9]),
    Face([i32; 3]),
}

impl PropertyAccess for Element {
    fn new() -> Element {
        Element::Face([0; 3])
    }

    fn get_float(&self, name: &str) -> Option<f32> {
        let place = VERTEX_PROPERTIES.iter().position(|known| *known == name)?;
        match self {
            Element::Vertex(values) => Some(values[place]),
            Element::Face(_) => None,
        }
    }

    fn get_list_int(&self, name: &str) -> Option<&[i32]> {
        match self {
            Element::Face(corners) if name == FACE_PROPERTY => Some(corners),
            _ => None,
        }
    }
}

pub(super) fn write(path: &Path, surface: &MovingSurface) -> Result<(), Error> {
    let mesh = &surface.mesh;
    let mut vertex = ElementDef::new("vertex".to_owned());
    for name in VERTEX_PROPERTIES {
        let kind = PropertyType::Scalar(ScalarType::Float);
        vertex
            .properties
            .add(PropertyDef::new(name.to_owned(), kind));
    }
    let mut face = ElementDef::new("face".to_owned());
    let kind = PropertyType::List(ScalarType::UChar, ScalarType::Int);
    face.properties
        .add(PropertyDef::new(FACE_PROPERTY.to_owned(), kind));
    let vertices = mesh
        .vertices
        .iter()
        .zip(&mesh.normals)
        .zip(&surface.velocity);
    let vertices = vertices.map(|((x, normal), velocity)| {
        let mut values = [0.0; 9];
        for (part, vector) in values.chunks_exact_mut(3).zip([x, normal, velocity]) {
            part.copy_from_slice(&vector.to_array());
        }
        Element::Vertex(values)
    });
    let corners = mesh.triangles.iter();
    let faces = corners.map(|corners| Element::Face(corners.map(|corner| corner as i32)));
    let mut ply = Ply::new();
    ply.header.encoding = Encoding::BinaryLittleEndian;
    ply.header.comments.push("m, m/s".to_owned());
    for (element, payload) in [
        (vertex, vertices.collect()),
        (face, faces.collect::<Vec<_>>()),
    ] {
        ply.payload.insert(element.name.clone(), payload);
        ply.header.elements.add(element);
    }
    let mut bytes = Vec::new();
    Writer::new()
        .write_ply(&mut bytes, &mut ply)
        .map_err(|problem| Error::output(path, problem))?;
    write_atomically(path, &bytes)
}
